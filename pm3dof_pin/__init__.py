"""Kinematics, stiffness maps and calibration of closed-chain robots on Pinocchio.

Names are loaded when they are first used, so that `import pm3dof_pin` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

__version__ = "0.1.0"

if TYPE_CHECKING:
    from pm3dof_pin.calibration.planning import PlanningProblem
    from pm3dof_pin.chapter.chapter_stiffness import chapter_stiffness, global_index
    from pm3dof_pin.chapter.design_derivatives import design_derivatives
    from pm3dof_pin.chapter.direct_kinematics import all_assembly_modes, direct_kinematics
    from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness, spring_contributions
    from pm3dof_pin.chapter.kinematics import (
        actuation_jacobian,
        inverse_kinematics,
        joint_positions,
        link_jacobian,
        passive_joint_angles,
        placement,
    )
    from pm3dof_pin.chapter.limits import Limit, LimitViolation, broken_limits, limit_violations
    from pm3dof_pin.chapter.table_8_3 import table_8_3
    from pm3dof_pin.chapter.tripod import Tripod
    from pm3dof_pin.description.parameters import TripodParameters
    from pm3dof_pin.description.robots import find_robot, robot_names
    from pm3dof_pin.dynamics import holding_forces, inverse_dynamics, natural_modes
    from pm3dof_pin.elastic import (
        ElasticModel,
        buckling_load,
        cartesian_compliance,
        compliance,
        loaded_equilibrium,
        stiffness,
    )
    from pm3dof_pin.elastic.shares import ranking, shares
    from pm3dof_pin.errors.error_map import error_map
    from pm3dof_pin.errors.error_parameters import GeometricErrors
    from pm3dof_pin.errors.sensitivity import sensitivities
    from pm3dof_pin.exceptions import PM3DofError
    from pm3dof_pin.kinematics.mobility import instantaneous_mobility
    from pm3dof_pin.kinematics.reachable_poses import reachable_poses
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.kinematics.singularity import singularities
    from pm3dof_pin.maps.atlas import Atlas, AtlasGrid, compute_atlas, open_atlas
    from pm3dof_pin.maps.grid import PolarGrid, RectangularGrid
    from pm3dof_pin.maps.section import stiffness_section
    from pm3dof_pin.mechanism.configuration import Configuration
    from pm3dof_pin.simulation.simulated_machine import SimulatedMachine
    from pm3dof_pin.viewer.viewer import Viewer

_HOMES = {
    "Atlas": "maps.atlas",
    "AtlasGrid": "maps.atlas",
    "Configuration": "mechanism",
    "ElasticModel": "elastic",
    "GeometricErrors": "errors.error_parameters",
    "Limit": "chapter.limits",
    "LimitViolation": "chapter.limits",
    "Robot": "mechanism",
    "PM3DofError": "exceptions",
    "PlanningProblem": "calibration.planning",
    "PolarGrid": "maps.grid",
    "RectangularGrid": "maps.grid",
    "SimulatedMachine": "simulation.simulated_machine",
    "Tripod": "chapter.tripod",
    "TripodParameters": "description.parameters",
    "Viewer": "viewer.viewer",
    "actuation_jacobian": "chapter.kinematics",
    "all_assembly_modes": "chapter.direct_kinematics",
    "broken_limits": "chapter.limits",
    "buckling_load": "elastic",
    "cartesian_compliance": "elastic",
    "chapter_stiffness": "chapter.chapter_stiffness",
    "compliance": "elastic",
    "compute_atlas": "maps.atlas",
    "design_derivatives": "chapter.design_derivatives",
    "direct_kinematics": "chapter.direct_kinematics",
    "elastic_stiffness": "chapter.elastic_stiffness",
    "error_map": "errors.error_map",
    "find_robot": "description.robots",
    "forward_poses": "kinematics.tool_poses",
    "global_index": "chapter.chapter_stiffness",
    "holding_forces": "dynamics",
    "instantaneous_mobility": "mechanism",
    "inverse_dynamics": "dynamics",
    "inverse_kinematics": "chapter.kinematics",
    "joint_positions": "chapter.kinematics",
    "limit_violations": "chapter.limits",
    "link_jacobian": "chapter.kinematics",
    "loaded_equilibrium": "elastic",
    "natural_modes": "dynamics",
    "open_atlas": "maps.atlas",
    "passive_joint_angles": "chapter.kinematics",
    "placement": "chapter.kinematics",
    "ranking": "elastic.shares",
    "reachable_poses": "kinematics.reachable_poses",
    "robot_names": "description.robots",
    "sensitivities": "errors.sensitivity",
    "shares": "elastic.shares",
    "singularities": "mechanism",
    "spring_contributions": "chapter.elastic_stiffness",
    "stiffness": "elastic",
    "stiffness_section": "maps.section",
    "table_8_3": "chapter.table_8_3",
}

__all__ = [
    "Atlas",
    "AtlasGrid",
    "Configuration",
    "ElasticModel",
    "GeometricErrors",
    "Limit",
    "LimitViolation",
    "PM3DofError",
    "PlanningProblem",
    "PolarGrid",
    "RectangularGrid",
    "Robot",
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
    "compliance",
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
    "stiffness",
    "stiffness_section",
    "table_8_3",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'pm3dof_pin' has no attribute '{name}'")
    return getattr(importlib.import_module(f"pm3dof_pin.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted(__all__)
