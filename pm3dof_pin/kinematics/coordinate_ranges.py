"""Ranges of coordinates: as declared, from limits, or as far as the robot can move."""

from __future__ import annotations

import math

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array

MOST_JOINTS = 100
"""Robots without a program that have more joints are not moved through many poses: each takes up to a second."""

_STEPS = 16  # per characteristic length or half turn
_MAX_DISTANCE = 16.0  # largest distance from home [characteristic lengths]


def require_quick_poses(robot: Robot, what: str) -> None:
    """Refuse many poses of a robot of more than :data:`MOST_JOINTS` without a program (InvalidValueError)."""
    if robot.model.nv > MOST_JOINTS and robot.engine == "program" and robot.continuation(robot.coordinates) is None:
        problem = f"of {robot.name} take minutes, since its {robot.model.nv} joints are closed one pose at a time"
        raise InvalidValueError(what, problem=problem, expected=f"at most {MOST_JOINTS} joints, or a program")


def coordinate_range(robot: Robot, coordinate: Coordinate) -> tuple[float, float]:
    """Return the range of a coordinate [m, rad]; infinite if neither the description nor limits give one.

    A joint that can turn more than once has a range of one turn. A coordinate without its own range goes from home as
    far as all limits permit.

    Raises:
        InvalidValueError: that would take minutes, of a robot of more than :data:`MOST_JOINTS` without a program.
    """
    lower, upper = robot.range_of(coordinate)
    if coordinate.joint is not None and coordinate.unit == "rad" and not upper - lower <= 2.0 * math.pi:
        return -math.pi, math.pi
    if not math.isfinite(upper - lower) and coordinate in robot.coordinates:
        return _span(robot, coordinate) or (lower, upper)
    return lower, upper


def coordinate_ranges(robot: Robot, coordinates: tuple[Coordinate, ...]) -> tuple[Array, Array]:
    """Return the ends of the ranges of coordinates, as :func:`coordinate_range`; -pi and pi where infinite."""
    lower, upper = np.array([coordinate_range(robot, coordinate) for coordinate in coordinates]).T
    unlimited = np.isinf(lower) | np.isinf(upper)
    return np.where(unlimited, -np.pi, lower), np.where(unlimited, np.pi, upper)


def _span(robot: Robot, coordinate: Coordinate) -> tuple[float, float] | None:
    """Return the interval in which a coordinate is within all limits, the others being at home [m, rad].

    It is moved from home in both directions in steps of a sixteenth of the characteristic length or of half a turn,
    until a limit is broken or no pose is found; ends are off by at most one step. None if it has no end or cannot move.
    """
    require_quick_poses(robot, "ranges that are not declared")
    home = float(robot.home_coordinates[robot.coordinates.index(coordinate)])
    step, count = math.pi / _STEPS, _STEPS
    if coordinate.unit == "m":
        step, count = robot.characteristic_length / _STEPS, round(_STEPS * _MAX_DISTANCE)
    ends = []
    for sense in (-1.0, 1.0):
        values = home + sense * step * np.arange(count + 1)
        first, last = sorted((values[0], values[-1]))
        poses = robot.solve(robot.grid(**{coordinate.name: (first, last, count + 1)}), on_failure="nan")
        within = poses.within_limits if sense > 0.0 else poses.within_limits[::-1]
        reached = count if within.all() else int(within.argmin()) - 1
        if reached < 0 or (reached == count and coordinate.unit == "m"):
            return None
        ends.append(values[min(reached + 1, count)])
    return (ends[0], ends[1]) if ends[1] - ends[0] > 2.5 * step else None
