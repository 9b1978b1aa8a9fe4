"""The general engine: closed-chain mechanisms on Pinocchio, their configurations, assembly, mobility, singularities."""

from __future__ import annotations

from pm3dof_pin.mechanism.actuation import actuation_jacobian, independent_motions, tool_motions
from pm3dof_pin.mechanism.assembly import Assembly, assemble
from pm3dof_pin.mechanism.configuration import Configuration, LimitViolation
from pm3dof_pin.mechanism.freedoms import RankDecision, null_space
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.mechanism.singularity import Singularity, singularities

__all__ = [
    "Assembly",
    "Configuration",
    "LimitViolation",
    "Mechanism",
    "Mobility",
    "RankDecision",
    "Singularity",
    "actuation_jacobian",
    "assemble",
    "generic_configuration",
    "independent_motions",
    "instantaneous_mobility",
    "null_space",
    "singularities",
    "tool_motions",
]
