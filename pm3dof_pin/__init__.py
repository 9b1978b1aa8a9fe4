"""Kinematics, stiffness maps and calibration of closed-chain robots on Pinocchio.

Names are loaded when they are first used, so that `import pm3dof_pin` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pm3dof_pin.calibration.error_map import error_map
    from pm3dof_pin.calibration.geometry import GeometricErrors
    from pm3dof_pin.calibration.planning import PlanningProblem
    from pm3dof_pin.calibration.reachable_poses import reachable_poses
    from pm3dof_pin.calibration.sensitivity import sensitivities
    from pm3dof_pin.calibration.simulated_machine import SimulatedMachine
    from pm3dof_pin.calibration.tool_poses import forward_poses
    from pm3dof_pin.description.parameters import TripodParameters
    from pm3dof_pin.description.robots import find_robot, robot_names
    from pm3dof_pin.dynamics import holding_forces, inverse_dynamics, natural_modes
    from pm3dof_pin.elastic import (
        ElasticModel,
        buckling_load,
        cartesian_compliance,
        compliance_over,
        loaded_equilibrium,
    )
    from pm3dof_pin.elastic.shares import ranking, shares
    from pm3dof_pin.exceptions import PM3DofError
    from pm3dof_pin.maps.atlas import Atlas, AtlasGrid, compute_atlas, open_atlas
    from pm3dof_pin.maps.grid import PolarGrid, RectangularGrid
    from pm3dof_pin.maps.section import stiffness_section
    from pm3dof_pin.maps.table_8_3 import table_8_3
    from pm3dof_pin.mechanism import Configuration, Mechanism, instantaneous_mobility, singularities
    from pm3dof_pin.tripod.chapter_stiffness import chapter_stiffness, global_index
    from pm3dof_pin.tripod.design_derivatives import design_derivatives
    from pm3dof_pin.tripod.direct_kinematics import all_assembly_modes, direct_kinematics
    from pm3dof_pin.tripod.elastic_stiffness import elastic_stiffness, spring_contributions
    from pm3dof_pin.tripod.kinematics import (
        actuation_jacobian,
        inverse_kinematics,
        joint_positions,
        link_jacobian,
        passive_joint_angles,
        placement,
    )
    from pm3dof_pin.tripod.limits import Limit, LimitViolation, broken_limits, limit_violations
    from pm3dof_pin.tripod.tripod import Tripod
    from pm3dof_pin.viewer.viewer import Viewer

_HOMES = {
    "Atlas": "maps.atlas",
    "AtlasGrid": "maps.atlas",
    "Configuration": "mechanism",
    "ElasticModel": "elastic",
    "GeometricErrors": "calibration.geometry",
    "Limit": "tripod.limits",
    "LimitViolation": "tripod.limits",
    "Mechanism": "mechanism",
    "PM3DofError": "exceptions",
    "PlanningProblem": "calibration.planning",
    "PolarGrid": "maps.grid",
    "RectangularGrid": "maps.grid",
    "SimulatedMachine": "calibration.simulated_machine",
    "Tripod": "tripod.tripod",
    "TripodParameters": "description.parameters",
    "Viewer": "viewer.viewer",
    "actuation_jacobian": "tripod.kinematics",
    "all_assembly_modes": "tripod.direct_kinematics",
    "broken_limits": "tripod.limits",
    "buckling_load": "elastic",
    "cartesian_compliance": "elastic",
    "chapter_stiffness": "tripod.chapter_stiffness",
    "compliance_over": "elastic",
    "compute_atlas": "maps.atlas",
    "design_derivatives": "tripod.design_derivatives",
    "direct_kinematics": "tripod.direct_kinematics",
    "elastic_stiffness": "tripod.elastic_stiffness",
    "error_map": "calibration.error_map",
    "find_robot": "description.robots",
    "forward_poses": "calibration.tool_poses",
    "global_index": "tripod.chapter_stiffness",
    "holding_forces": "dynamics",
    "instantaneous_mobility": "mechanism",
    "inverse_dynamics": "dynamics",
    "inverse_kinematics": "tripod.kinematics",
    "joint_positions": "tripod.kinematics",
    "limit_violations": "tripod.limits",
    "link_jacobian": "tripod.kinematics",
    "loaded_equilibrium": "elastic",
    "natural_modes": "dynamics",
    "open_atlas": "maps.atlas",
    "passive_joint_angles": "tripod.kinematics",
    "placement": "tripod.kinematics",
    "ranking": "elastic.shares",
    "reachable_poses": "calibration.reachable_poses",
    "robot_names": "description.robots",
    "sensitivities": "calibration.sensitivity",
    "shares": "elastic.shares",
    "singularities": "mechanism",
    "spring_contributions": "tripod.elastic_stiffness",
    "stiffness_section": "maps.section",
    "table_8_3": "maps.table_8_3",
}

__all__ = [
    "Atlas",
    "AtlasGrid",
    "Configuration",
    "ElasticModel",
    "GeometricErrors",
    "Limit",
    "LimitViolation",
    "Mechanism",
    "PM3DofError",
    "PlanningProblem",
    "PolarGrid",
    "RectangularGrid",
    "SimulatedMachine",
    "Tripod",
    "TripodParameters",
    "Viewer",
    "actuation_jacobian",
    "all_assembly_modes",
    "broken_limits",
    "buckling_load",
    "cartesian_compliance",
    "chapter_stiffness",
    "compliance_over",
    "compute_atlas",
    "design_derivatives",
    "direct_kinematics",
    "elastic_stiffness",
    "error_map",
    "find_robot",
    "forward_poses",
    "global_index",
    "holding_forces",
    "instantaneous_mobility",
    "inverse_dynamics",
    "inverse_kinematics",
    "joint_positions",
    "limit_violations",
    "link_jacobian",
    "loaded_equilibrium",
    "natural_modes",
    "open_atlas",
    "passive_joint_angles",
    "placement",
    "ranking",
    "reachable_poses",
    "robot_names",
    "sensitivities",
    "shares",
    "singularities",
    "spring_contributions",
    "stiffness_section",
    "table_8_3",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'pm3dof_pin' has no attribute '{name}'")
    return getattr(importlib.import_module(f"pm3dof_pin.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
