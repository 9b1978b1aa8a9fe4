"""Quantities of the drives' limits: what the tool can push, and how fast it can move."""

from __future__ import annotations

from typing import Literal

import numpy as np

from pm3dof_pin.capability.tool_capability import ToolCapability, tool_capability
from pm3dof_pin.capability.transmission import drive_values
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.maps.quantity import Dimension, Evaluation, MappedRobot, Quantity
from pm3dof_pin.maps.robot_quantities import drives_hold_tool
from pm3dof_pin.typing import Array

_AXIS = Dimension("axis", lambda mapped: TOOL_COMPONENTS)


def _at(evaluation: Evaluation) -> ToolCapability:
    return tool_capability(evaluation.mapped.robot, evaluation.poses, **evaluation.batch)


def _force_capability(evaluation: Evaluation) -> Array:
    at = _at(evaluation)
    ends = [np.minimum(at.greatest_wrench(axis), at.greatest_wrench(-axis)) for axis in np.eye(6)]
    return np.stack(ends, axis=-1)


def _speed_capability(evaluation: Evaluation) -> Array:
    at = _at(evaluation)
    return np.stack([at.greatest_twist(axis) for axis in np.eye(6)], axis=-1)


def _wrench_margin(evaluation: Evaluation) -> Array:
    return _at(evaluation).effort_left(evaluation.mapped.wrenches)


def _wrench_feasible(evaluation: Evaluation) -> Array:
    margin = _wrench_margin(evaluation)
    return np.where(np.isnan(margin), np.nan, margin >= 0.0)


def _has_limits(name: Literal["effort", "speed"], mapped: MappedRobot) -> bool:
    return drives_hold_tool(mapped) and bool(np.isfinite(drive_values(mapped.robot, name)).all())


CAPABILITY_QUANTITIES = (
    Quantity(
        "force_capability",
        _force_capability,
        "N (x, y, z), N m (rx, ry, rz)",
        "greatest force or torque of the tool along each axis, in the weaker direction",
        (_AXIS,),
        lambda mapped: _has_limits("effort", mapped),
    ),
    Quantity(
        "speed_capability",
        _speed_capability,
        "m/s (x, y, z), rad/s (rx, ry, rz)",
        "greatest speed of the tool along each axis alone",
        (_AXIS,),
        lambda mapped: _has_limits("speed", mapped),
    ),
    Quantity(
        "wrench_margin",
        _wrench_margin,
        "1",
        "share of the drives' efforts left under the wrenches, or the weight alone; negative if one cannot be held",
        exists=lambda mapped: _has_limits("effort", mapped),
    ),
    Quantity(
        "wrench_feasible",
        _wrench_feasible,
        "1",
        "1 where the drives hold each of the wrenches, else 0",
        exists=lambda mapped: _has_limits("effort", mapped),
    ),
)
"""The quantities of a robot whose drives have limits."""
