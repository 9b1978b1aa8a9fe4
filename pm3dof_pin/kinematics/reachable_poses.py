"""Random poses within all limits of a robot: candidates for measurements, and poses for evaluation."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cached_property

import numpy as np

from pm3dof_pin.arrays import require_count, require_kind
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges, require_quick_poses
from pm3dof_pin.kinematics.grid import Grid, with_neighbours
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reference import Reference
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import coordinate_scales
from pm3dof_pin.typing import Array, Mask

_ROUNDS = 40
_TRIAL = 200
_MIN_RATE = 0.02
_NARROWED_RATE = 0.1  # if a smaller share of draws is within limits, the box is narrowed
_LATTICE = 4096  # poses by commands, from which the narrower box is made
_MAX_DRAWS = 4  # per round, relative to the number of poses requested
_NEAR = 0.2  # edge length of the cells from whose centres draws are walked to [rad, characteristic lengths]
_DRAWS_A_CELL = 1
_KEPT = "_random_draws"
_WALKERS = 64
_TO_FORGET_HOME = 16  # steps of a walk, for each dimension
_STEPS_APART = 4  # between poses of one walk, for each dimension
_ALONG = 2.38 / np.sqrt(2.0)  # times the difference of two walks, about the best, in one dimension
_NOWHERE = 1e-5  # part of the ranges: a step that leads out of the limits from everywhere, as from a home outside
_TAKEN = 0.3  # part of the steps that lead to poses within limits, about the best for walks in many dimensions


def reachable_poses(robot: Robot, count: int, generator: np.random.Generator, *, margin: float = 0.0) -> Poses:
    """Draw poses within all limits, uniformly over the coordinates.

    Where the coordinates have no ranges or do not determine the drives, or limits exclude nearly all of them (six
    degrees of freedom with short struts), poses are drawn uniformly over the commands of independent drives instead.
    Where limits exclude nearly all of these too, as with many drives, poses are those of random walks from home that
    turn back at limits: in the long run uniform over these commands, too. None are so near to singular poses that
    Newton's method does not converge.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> poses = pm.reachable_poses(pm.load("pm3dof"), 20, np.random.default_rng(0))
        >>> len(poses), bool(poses.within_limits.all())
        (20, True)

    Args:
        robot: the robot.
        count: number of poses.
        generator: random number generator.
        margin: part of each coordinate's range to exclude at either end.

    Raises:
        ConvergenceError: the loops do not close at home.
        UnreachablePoseError: hardly any pose was found within the limits, or nothing moves.
        InvalidValueError: the margin is not between 0 and 0.5, the count is not an integer, or the robot has more than
            100 joints and no program.
    """
    require_kind("robot", robot, Robot, "pm.load")
    require_count("count", count, 0)
    if not 0.0 <= margin < 0.5:
        raise InvalidValueError("margin", margin, "a part of the range, at least 0 and less than 0.5")
    if not robot.coordinates:
        raise UnreachablePoseError(f"{robot.name}: has no coordinates, since it has no actuated joints")
    require_quick_poses(robot, "random poses")
    for by_commands in (False, True):
        if not (robot.placing_commands if by_commands else _has_ranges(robot)):
            continue
        draws = _Draws.kept(robot, by_commands, margin)
        found = draws.within_limits(_TRIAL, generator)
        drawn: float = _TRIAL
        if len(found) < _MIN_RATE * drawn:
            continue
        if len(found) < _NARROWED_RATE * drawn and draws.cells > _LATTICE and not by_commands:
            draws, left = draws.narrowed
            drawn *= left
        for _ in range(_ROUNDS):
            if len(found) >= count:
                return robot.at(found[:count])
            batch = min(_MAX_DRAWS * count, int((count - len(found)) * drawn / len(found)) + _TRIAL)
            found = np.concatenate([found, draws.within_limits(batch, generator)])
            drawn += batch
    robot.assemble()  # says so if the loops are open at home
    found = _walked(robot, count, generator, margin)
    if len(found) < count:
        raise UnreachablePoseError(f"{robot.name}: hardly any random pose is within all joint limits")
    return robot.at(found)


def _walked(robot: Robot, count: int, generator: np.random.Generator, margin: float) -> Array:
    """Return poses of walks from home that stay where a step would break a limit, shape=(n, nq); none if they cannot.

    Steps are as likely as their opposites, so walks are uniform in the long run (N. Metropolis et al., 1953). Every
    other step of half of the walks is the difference of two of the others, as long in each direction as there is room
    (C. ter Braak, Statistics and Computing 16, 2006).
    """
    draws = _Draws.kept(robot, bool(robot.placing_commands), margin)
    size, width, halves = len(draws.lower), draws.upper - draws.lower, np.split(np.arange(_WALKERS), 2)
    q, values = np.tile(robot.home.q, (_WALKERS, 1)), np.tile(draws.home, (_WALKERS, 1))
    length, taken, poses = 1.0 / np.sqrt(size), 0, np.zeros((0, q.shape[1]))
    along, forgotten = _ALONG / np.sqrt(size), 2 * _TO_FORGET_HOME * size
    for step in range(forgotten + 2 * _STEPS_APART * size * math.ceil(count / _WALKERS)):
        own, others = np.arange(_WALKERS), halves[step // 2 % 2]
        if step % 2:
            own = halves[1 - step // 2 % 2]
            first, second = generator.choice(others, (2, len(own)))
            changes = along * (values[first] - values[second])
        else:
            changes = generator.uniform(-0.5, 0.5, values.shape) * length * width
        further = values[own] + changes
        inside = np.flatnonzero(((draws.lower <= further) & (further <= draws.upper)).all(axis=1))
        found, is_within = draws.solved(further[inside], q[own[inside]])
        moved = own[inside[is_within]]
        q[moved], values[moved] = found[is_within], further[inside[is_within]]
        taken += len(moved) * (1 - step % 2)
        if step < forgotten and not step % 2:  # thereafter the length is fixed
            length *= 1.1 if len(moved) > _TAKEN * _WALKERS else 0.9 if taken else 0.5
            if length < _NOWHERE and not taken:
                break
        if step >= forgotten and (step + 1 - forgotten) % (2 * _STEPS_APART * size) == 0:
            poses = np.concatenate([poses, q])
    return poses[:count]


def _has_ranges(robot: Robot) -> bool:
    """Return whether to draw coordinates: they determine the drives, and have ranges, or the drives are dependent."""
    if len(robot.coordinates) < len(robot.placing_drives):
        return False
    if all(c.joint is not None or np.isfinite(robot.range_of(c)).all() for c in robot.coordinates):
        return True
    return bool(robot.closures) and len(robot.coordinates) < len(robot.command_coordinates)


class _Draws:
    """Uniform random values of coordinates or commands in a box, and the poses there.

    Many draws are walked to from the centres of cells. Where the part within limits holds so many centres that it is
    wider than a cell, a cell is skipped if neither its centre nor any neighbour's is within limits.
    """

    def __init__(self, robot: Robot, coordinates: tuple[Coordinate, ...], lower: Array, upper: Array) -> None:
        self._robot, self._coordinates, self.lower, self.upper = robot, coordinates, lower, upper
        sizes = np.ceil((upper - lower) / (_NEAR * coordinate_scales(robot, coordinates)))
        self._sizes = np.maximum(sizes, 1.0).astype(int)

    @classmethod
    def kept(cls, robot: Robot, by_commands: bool, margin: float) -> _Draws:
        """Return the draws over all ranges of a robot; cached with it, since their cells take long to compute."""
        kept: dict[tuple[bool, float], _Draws] = vars(robot).setdefault(_KEPT, {})
        if (by_commands, margin) not in kept:
            coordinates = robot.placing_commands if by_commands else robot.coordinates
            # declared ranges are for maps; what joints can reach beyond is reachable too
            whole = tuple(c if c.joint is None else replace(c, lower=None, upper=None) for c in coordinates)
            lower, upper = coordinate_ranges(robot, whole)
            spare = margin * (upper - lower)
            kept[by_commands, margin] = cls(robot, coordinates, lower + spare, upper - spare)
        return kept[by_commands, margin]

    @property
    def home(self) -> Array:
        """The values at home."""
        robot = self._robot
        if self._coordinates == robot.coordinates:
            return robot.home_coordinates
        return np.asarray(robot.read(self._coordinates, robot.home.q))

    def solved(self, values: Array, starts: Array) -> tuple[Array, Mask]:
        """Return the poses at values, walked to from starts, shape=(n, nq), and which are within all limits."""
        return _solved(self._robot, self._coordinates, values, starts)

    @property
    def cells(self) -> int:
        """Number of cells."""
        return math.prod(self._sizes.tolist())

    @cached_property
    def narrowed(self) -> tuple[_Draws, float]:
        """The same without what no commands reach, and the remaining part of the box.

        A lattice of commands gives the coordinates that are reached with a neighbour within limits. The box exceeds
        these by the largest steps between neighbours: twice the difference within a cell, if nearly linear.
        """
        commands = self._robot.placing_commands
        count = round(_LATTICE ** (1.0 / max(len(commands), 1)))
        if not commands or count < 2:
            return self, 1.0
        lower, upper = coordinate_ranges(self._robot, commands)
        shares = (np.arange(count) + 0.5) / count
        axes = {c.name: a + (b - a) * shares for c, a, b in zip(commands, lower, upper, strict=True)}
        q, is_within = _solved(self._robot, commands, Grid(commands, axes, {}).values)
        near = with_neighbours(is_within) & np.isfinite(q[..., 0])
        values = np.where(near[..., None], Poses(self._robot, q).coordinates, np.nan)
        differences = [np.abs(np.diff(values, axis=k)).reshape(-1, values.shape[-1]) for k in range(len(commands))]
        if not near.any() or any(np.isnan(steps).all(axis=0).any() for steps in differences):
            return self, 1.0
        widening = np.sum([np.nanmax(steps, axis=0) for steps in differences], axis=0)
        lower = np.maximum(self.lower, values[near].min(axis=0) - widening)
        upper = np.minimum(self.upper, values[near].max(axis=0) + widening)
        left = float(np.prod((upper - lower) / (self.upper - self.lower)))
        return _Draws(self._robot, self._coordinates, lower, upper), left

    def within_limits(self, count: int, generator: np.random.Generator) -> Array:
        """Return those of `count` draws that are within all limits, shape=(n, nq)."""
        shares = generator.uniform(size=(count, len(self._coordinates)))
        values = self.lower + shares * (self.upper - self.lower)
        if _DRAWS_A_CELL * self.cells > count:
            q, is_within = _solved(self._robot, self._coordinates, values)
        else:
            starts, is_near = self._cells
            cells = tuple(np.minimum(shares * self._sizes, self._sizes - 1).astype(int).T)
            near = is_near[cells]
            starts = starts[tuple(indices[near] for indices in cells)]
            q, is_within = _solved(self._robot, self._coordinates, values[near], starts)
        return q[is_within]

    @cached_property
    def _cells(self) -> tuple[Array, Mask]:
        """Starts of walks in each cell, and whether its centre or a neighbour's is within limits."""
        steps = (self.upper - self.lower) / self._sizes
        axes = {
            c.name: first + step * (np.arange(size) + 0.5)
            for c, first, step, size in zip(self._coordinates, self.lower, steps, self._sizes, strict=True)
        }
        q, is_within = _solved(self._robot, self._coordinates, Grid(self._coordinates, axes, {}).values)
        starts = np.where(np.isnan(q[..., :1]), self._robot.home.q, q)
        is_wide = is_within.sum() >= 2**is_within.ndim
        return starts, with_neighbours(is_within) if is_wide else np.ones_like(is_within)


def _solved(
    robot: Robot, coordinates: tuple[Coordinate, ...], values: Array, starts: Array | None = None
) -> tuple[Array, Mask]:
    """Return the poses at values of coordinates, NaN if unsolved, and which are within all limits."""
    shape, rows = values.shape[:-1], values.reshape(-1, values.shape[-1])
    solver = robot.continuation(coordinates)
    if solver is None:
        poses = Poses(robot, Reference(robot, coordinates).walk(rows, starts).q.reshape(*shape, robot.model.nq))
        return poses.q, poses.within_limits
    found = solver.walk(rows, starts, thorough=False)
    assert found.broken_limits is not None
    return found.q.reshape(*shape, robot.model.nq), (found.broken_limits == 0).reshape(shape)
