# The public names and their modules, for type checkers and lazy_loader.

from . import chapter as chapter
from .calibration.calibrate import calibrate as calibrate
from .calibration.folder import read_compensation as read_compensation
from .calibration.planning import PlanningProblem as PlanningProblem
from .capability.tool_capability import tool_capability as tool_capability
from .description.robots import robot_names as robot_names
from .dynamics.inverse_dynamics import inverse_dynamics as inverse_dynamics
from .dynamics.modes import natural_modes as natural_modes
from .dynamics.statics import holding_forces as holding_forces
from .elastic.batch import compliance as compliance
from .elastic.batch import stiffness as stiffness
from .elastic.elastic_model import ElasticModel as ElasticModel
from .elastic.free_motions import free_motion_stiffness as free_motion_stiffness
from .elastic.loaded import loaded_equilibrium as loaded_equilibrium
from .elastic.loads import Loads as Loads
from .elastic.report import cartesian_compliance as cartesian_compliance
from .errors.error_map import error_map as error_map
from .errors.error_parameters import GeometricErrors as GeometricErrors
from .errors.sensitivity import sensitivities as sensitivities
from .exceptions import PM3DofError as PM3DofError
from .export.formats import export_robot as export_robot
from .kinematics.grid import Grid as Grid
from .kinematics.jacobians import jacobian as jacobian
from .kinematics.mobility import instantaneous_mobility as instantaneous_mobility
from .kinematics.pose_file import read_poses as read_poses
from .kinematics.poses import Poses as Poses
from .kinematics.reachable_poses import reachable_poses as reachable_poses
from .kinematics.robot import Robot as Robot
from .kinematics.robot import load as load
from .kinematics.singularity import singularities as singularities
from .maps.atlas import Atlas as Atlas
from .maps.atlas import compute_atlas as compute_atlas
from .maps.atlas import open_atlas as open_atlas
from .measuring.measurement_file import read_measurements as read_measurements
from .measuring.measurements import Measurements as Measurements
from .mechanism.configuration import Configuration as Configuration
from .simulation.simulated_machine import SimulatedMachine as SimulatedMachine
from .viewer.viewer import Viewer as Viewer

__version__: str
