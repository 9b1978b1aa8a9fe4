"""Random poses within all limits of a robot: candidates for measurements, and poses at which to judge."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from pm3dof_pin.arrays import require_count, with_neighbours
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Mask

_ROUNDS = 40
_TRIAL = 200
_LEAST_RATE = 0.02
_NARROWED_RATE = 0.1  # of draws within limits, below which the box is made smaller
_LATTICE = 4096  # poses by commands, of which the smaller box is made
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
        drawn: float = _TRIAL
        if len(found) < _LEAST_RATE * drawn:
            continue
        if len(found) < _NARROWED_RATE * drawn and draws.cells > _LATTICE and not by_commands:
            drawn *= draws.narrow()
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
        # a declared range is what maps go over; what a joint can do beyond it is reachable too
        whole = tuple(c if c.joint is None else replace(c, lower=None, upper=None) for c in self._coordinates)
        lower, upper = coordinate_ranges(robot, whole)
        self._set_box(lower + margin * (upper - lower), upper - margin * (upper - lower))

    def _set_box(self, lower: Array, upper: Array) -> None:
        self._lower, self._upper = lower, upper
        robot = self._robot
        units = [abs(c.scale) * (robot.characteristic_length if c.unit == "m" else 1.0) for c in self._coordinates]
        self._sizes = np.maximum(np.ceil((upper - lower) / (_NEAR * np.array(units))), 1.0).astype(int)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return math.prod(self._sizes.tolist())

    def narrow(self) -> float:
        """Leave out of the box of coordinates what no commands lead to: to find that a pose is out of reach takes long.

        A lattice of commands gives the coordinates that are reached with a neighbour within limits. The box is wider
        than these by the greatest steps between neighbours, twice what they differ by within a cell if nearly linear.
        Returns the part of the box that is left.
        """
        commands = self._robot.command_coordinates
        count = round(_LATTICE ** (1.0 / max(len(commands), 1)))
        if not commands or count < 2:
            return 1.0
        lower, upper = coordinate_ranges(self._robot, commands)
        shares = (np.arange(count) + 0.5) / count
        axes = {c.name: a + (b - a) * shares for c, a, b in zip(commands, lower, upper, strict=True)}
        poses = self._robot.forward(Grid(commands, axes, {}).values, on_failure="nan")
        near = with_neighbours(poses.within_limits) & poses.solved
        values = np.where(near[..., None], poses.coordinates, np.nan)
        differences = [np.abs(np.diff(values, axis=k)).reshape(-1, values.shape[-1]) for k in range(len(commands))]
        if not near.any() or any(np.isnan(steps).all(axis=0).any() for steps in differences):
            return 1.0
        widening = np.sum([np.nanmax(steps, axis=0) for steps in differences], axis=0)
        before = self._upper - self._lower
        lower, upper = values[near].min(axis=0) - widening, values[near].max(axis=0) + widening
        self._set_box(np.maximum(self._lower, lower), np.minimum(self._upper, upper))
        return float(np.prod((self._upper - self._lower) / before))

    def within_limits(self, count: int, generator: np.random.Generator) -> Array:
        """Return those of so many draws that are within all limits, shape=(n, nq)."""
        shares = generator.uniform(size=(count, len(self._coordinates)))
        values = self._lower + shares * (self._upper - self._lower)
        if _DRAWS_A_CELL * self.cells > count:
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
        return starts, with_neighbours(middles.within_limits)
