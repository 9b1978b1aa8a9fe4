"""Random poses within all limits of a robot: candidates for measurements, and poses at which to judge."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.ndimage import maximum_filter

from pm3dof_pin.arrays import require_count
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Mask

_ROUNDS = 40
_TRIAL = 200
_LEAST_RATE = 0.02
_MOST_DRAWS = 4  # a round, times the poses wanted
_NEAR = 0.2  # edge of the cells that draws are walked to from the middle of [rad, characteristic lengths]
_DRAWS_A_CELL = 1


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
        InvalidValueError: the margin is not between 0 and 0.5, or the count is no whole number.
    """
    require_count("count", count, 0)
    if not 0.0 <= margin < 0.5:
        raise InvalidValueError("margin", margin, "a part of the range, at least 0 and less than 0.5")
    if not robot.coordinates:
        raise UnreachablePoseError(f"{robot.name}: has no coordinates, as it has no actuated joints")
    for by_commands in (False, True):
        if not (robot.command_coordinates if by_commands else _has_ranges(robot)):
            continue
        draws = _Draws(robot, by_commands, margin)
        found = draws.within_limits(_TRIAL, generator)
        drawn = _TRIAL
        if len(found) < _LEAST_RATE * drawn:
            continue
        for _ in range(_ROUNDS):
            if len(found) >= count:
                return robot.at(found[:count])
            batch = min(_MOST_DRAWS * count, int((count - len(found)) * drawn / len(found)) + _TRIAL)
            found = np.concatenate([found, draws.within_limits(batch, generator)])
            drawn += batch
    raise UnreachablePoseError(f"{robot.name}: hardly any random pose is within all joint limits")


def coordinate_ranges(robot: Robot, coordinates: tuple[Coordinate, ...]) -> tuple[Array, Array]:
    """Return the least and greatest values of coordinates; a joint without limits turns once around [m, rad]."""
    lower, upper = np.array([robot.range_of(coordinate) for coordinate in coordinates]).T
    unlimited = np.isinf(lower) | np.isinf(upper)
    return np.where(unlimited, -np.pi, lower), np.where(unlimited, np.pi, upper)


def _has_ranges(robot: Robot) -> bool:
    return all(c.joint is not None or np.isfinite(robot.range_of(c)).all() for c in robot.coordinates)


class _Draws:
    """Values of coordinates or commands at random, evenly over their ranges, and the poses there.

    Many draws are walked to from the middles of cells. Cells of which neither the middle nor that of any neighbour is
    within limits are passed over: what is within limits there is smaller than a cell.
    """

    def __init__(self, robot: Robot, by_commands: bool, margin: float) -> None:
        self._robot = robot
        self._coordinates = robot.command_coordinates if by_commands else robot.coordinates
        self._solve = robot.forward if by_commands else robot.solve
        self._margin = margin
        # a declared range is what maps go over; what a joint can do beyond it is reachable too
        whole = tuple(c if c.joint is None else replace(c, lower=None, upper=None) for c in self._coordinates)
        self._lower, self._upper = coordinate_ranges(robot, whole)
        units = [abs(c.scale) * (robot.characteristic_length if c.unit == "m" else 1.0) for c in self._coordinates]
        self._sizes = np.maximum(np.ceil((self._upper - self._lower) / (_NEAR * np.array(units))), 1.0).astype(int)

    def within_limits(self, count: int, generator: np.random.Generator) -> Array:
        """Return those of so many draws that are within all limits, shape=(n, nq)."""
        shares = generator.uniform(self._margin, 1.0 - self._margin, (count, len(self._coordinates)))
        values = self._lower + shares * (self._upper - self._lower)
        if _DRAWS_A_CELL * math.prod(self._sizes.tolist()) > count:
            poses = self._solve(values, on_failure="nan")
        else:
            starts, is_near = self._cells
            cells = tuple(np.minimum(shares * self._sizes, self._sizes - 1).astype(int).T)
            near = is_near[cells]
            starts = starts[tuple(indices[near] for indices in cells)]
            poses = self._solve(values[near], guess=starts, on_failure="nan")
        return np.asarray(poses.q[poses.within_limits])

    @cached_property
    def _cells(self) -> tuple[Array, Mask]:
        """Where walks in each cell start, and whether it or a neighbour is within limits in its middle."""
        steps = (self._upper - self._lower) / self._sizes
        axes = {
            c.name: first + step * (np.arange(size) + 0.5)
            for c, first, step, size in zip(self._coordinates, self._lower, steps, self._sizes, strict=True)
        }
        middles = self._solve(Grid(self._coordinates, axes, {}).values, on_failure="nan")
        starts = np.where(middles.solved[..., None], middles.q, self._robot.home.q)
        return starts, maximum_filter(middles.within_limits, size=3)
