"""Random poses within all limits of a robot: candidates for measurements, and poses at which to judge."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Vector

_ROUNDS = 40
_TRIAL = 200
_LEAST_RATE = 0.02
_MOST_DRAWS = 4  # a round, times the poses wanted
_NEAR = 0.2  # edge of the cells that draws are walked to from the middle of [rad, characteristic lengths]
_DRAWS_A_NODE = 4


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
        UnreachablePoseError: hardly any pose was found within the limits, or nothing moves.
        InvalidValueError: the margin is not between 0 and 0.5.
    """
    if not 0.0 <= margin < 0.5:
        raise InvalidValueError("margin", margin, "a part of the range, at least 0 and less than 0.5")
    if not robot.coordinates:
        raise UnreachablePoseError(f"{robot.name}: has no coordinates, as it has no actuated joints")
    for by_commands in (False, True):
        if not (robot.command_coordinates if by_commands else _has_ranges(robot)):
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
    lattice = _lattice(robot, coordinates, lower, upper, count)
    if lattice is None:
        poses = solve(values, on_failure="nan")
    else:  # a walk from home to each point of a lattice, and from there a short one to each of the values
        nodes = solve(lattice.values, on_failure="nan")
        starts = np.where(nodes.solved[..., None], nodes.q, robot.home.q)
        nearest = (
            np.abs(axis - column[:, None]).argmin(axis=1)
            for axis, column in zip(lattice.axes.values(), values.T, strict=True)
        )
        poses = solve(values, guess=starts[tuple(nearest)], on_failure="nan")
    return np.asarray(poses.q[poses.within_limits])


def _lattice(
    robot: Robot, coordinates: tuple[Coordinate, ...], lower: Vector, upper: Vector, count: int
) -> Grid | None:
    """Return points to which it is near from anywhere between the ends; None where they are many for so many draws."""
    units = [abs(c.scale) * (robot.characteristic_length if c.unit == "m" else 1.0) for c in coordinates]
    sizes = np.maximum(np.ceil((upper - lower) / (_NEAR * np.array(units))), 1.0)
    if _DRAWS_A_NODE * np.prod(sizes) > count:
        return None
    steps = (upper - lower) / sizes
    axes = {
        c.name: first + step * (np.arange(size) + 0.5)
        for c, first, step, size in zip(coordinates, lower, steps, sizes, strict=True)
    }
    return Grid(coordinates, axes, {})
