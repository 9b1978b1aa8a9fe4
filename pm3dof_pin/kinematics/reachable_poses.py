"""Random poses within all limits of a robot: candidates for measurements, and poses at which to judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array

_ROUNDS = 40
_TRIAL = 200
_LEAST_RATE = 0.02
_MOST_DRAWS = 4  # a round, times the poses wanted


def reachable_poses(robot: Robot, count: int, generator: np.random.Generator, *, margin: float = 0.0) -> Poses:
    """Draw poses within all limits, evenly over the coordinates.

    A robot whose coordinates have no ranges, or whose limits exclude nearly all of these (six degrees of freedom with
    short struts), gets poses evenly over its commands instead.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> poses = pm.reachable_poses(pm.load("pm3dof"), 20, np.random.default_rng(0))
        >>> len(poses), bool(poses.within_limits.all())
        (20, True)

    Args:
        robot: the robot.
        count: number of poses.
        generator: source of the random numbers.
        margin: part of each coordinate's range that is kept free at either end.

    Raises:
        UnreachablePoseError: hardly any pose was found within the limits.
        InvalidValueError: the margin is not between 0 and 0.5.
    """
    if not 0.0 <= margin < 0.5:
        raise InvalidValueError("margin", margin, "a part of the range, at least 0 and less than 0.5")
    for by_commands in (False, True):
        if not by_commands and not _has_ranges(robot):
            continue
        found = _draw(robot, by_commands, _TRIAL, generator, margin)
        drawn = _TRIAL
        if len(found) < _LEAST_RATE * drawn:
            continue
        for _ in range(_ROUNDS):
            if len(found) >= count:
                return robot.at(found[:count])
            batch = min(_MOST_DRAWS * count, int((count - len(found)) * drawn / len(found)) + _TRIAL)
            found = np.concatenate([found, _draw(robot, by_commands, batch, generator, margin)])
            drawn += batch
    raise UnreachablePoseError(f"{robot.name}: hardly any random pose is within all joint limits")


def coordinate_ranges(robot: Robot, coordinates: tuple[Coordinate, ...]) -> tuple[Array, Array]:
    """Return the least and greatest values of coordinates; a joint without limits turns once around [m, rad]."""
    lower, upper = np.array([robot.range_of(coordinate) for coordinate in coordinates]).T
    unlimited = np.isinf(lower) | np.isinf(upper)
    return np.where(unlimited, -np.pi, lower), np.where(unlimited, np.pi, upper)


def _has_ranges(robot: Robot) -> bool:
    return all(c.joint is not None or np.isfinite(robot.range_of(c)).all() for c in robot.coordinates)


def _draw(robot: Robot, by_commands: bool, count: int, generator: np.random.Generator, margin: float) -> Array:
    coordinates = robot.command_coordinates if by_commands else robot.coordinates
    # a declared range is what maps go over; what a joint can do beyond it is reachable too
    whole = tuple(c if c.joint is None else replace(c, lower=None, upper=None) for c in coordinates)
    lower, upper = coordinate_ranges(robot, whole)
    shares = generator.uniform(margin, 1.0 - margin, (count, len(coordinates)))
    values = lower + shares * (upper - lower)
    solve = robot.forward if by_commands else robot.solve
    poses = solve(values, on_failure="nan")
    return np.asarray(poses.q[poses.within_limits])
