"""Finding poses at values of coordinates: from home or from guesses, with further starts if that fails."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.units import coordinate_scales
from pm3dof_pin.mechanism.configuration import LIMIT_TOLERANCE
from pm3dof_pin.typing import Array, Indices, Mask, Matrix, Vector

_ROUNDING = 1e-9
_FURTHER_STARTS = 16  # for the inverse kinematics of a serial arm
_NEAREST = 4  # poses of the lattice from which one is sought: a singular pose may lie between it and the nearest
_COMPARED = 2**15  # distances at a time, as many as stay in a processor's cache
_WAYPOINTS = 1000
_FEWEST_ALONG, _MAX_WAYPOINTS = 3, 10_000  # along each coordinate; in all, or there are none
_PROJECTIONS = 30  # onto the limits
_SPARE = 0.05  # greatest distance from a limit, relative to the joint's range; small ones keep paths continuous
_WIDTH = 3.0  # of the waypoint lattice on both sides of home, unless joints end earlier [characteristic lengths]


class Solution(NamedTuple):
    """Poses found, and their checks. Where there is none, everything is NaN and `broken_limits` is 1."""

    q: Matrix  #: joint configurations, shape=(n, nq) [m, rad]
    residual: Vector | None = None  #: greatest closure error, shape=(n,) [m, rad]; None if unknown
    #: bit masks, shape=(n,): 1 for an unsolved pose, 2^(k + 1) for limit group k
    broken_limits: NDArray[np.uint32] | None = None
    #: placements of the tool, shape=(n, 4, 4); None also for a mechanism without a tool frame, and after a march
    transforms: Array | None = None
    #: branch numbers, shape=(n,), see :mod:`~pm3dof_pin.kinematics.branches`; None if unknown
    branch: NDArray[np.int64] | None = None


class Solver(Protocol):
    """What finds poses by walks: compiled programs, or the reference engine."""

    def walk(
        self, targets: Matrix, starts: Matrix | None = None, *, home_too: bool = True, keep_branch: bool = True
    ) -> Solution:
        """Find the poses at targets, each by its own walk from its start, by default home.

        A walk from open loops, or of a serial arm, is tried from home as well if `home_too`. A walk stays on the
        branch of its start, or if `keep_branch` is false ends only where the coordinates are singular.
        """

    def first_order(self, targets: Matrix, starts: Matrix) -> Matrix:
        """Return configurations at targets next to closed starts, to first order in the distance, shape=(n, nq)."""

    @property
    def lattice(self) -> tuple[Matrix, Matrix]:
        """Values of the coordinates, shape=(m, number of coordinates), and poses, shape=(m, nq), all over the reach."""


def find_poses(
    robot: PlacedMechanism,
    coordinates: tuple[Coordinate, ...],
    targets: Matrix,
    guesses: Matrix | None,
    solver: Solver,
    *,
    keep_branch: bool = True,
) -> Solution:
    """Find poses at targets, shape=(n, number of coordinates), from guesses, shape=(n, nq), or by default from home.

    Without a guess, further starts are tried.
    """
    targets = _within_arms_length(robot, coordinates, targets)
    if guesses is not None:
        return solver.walk(targets, guesses, keep_branch=keep_branch)
    found = solver.walk(targets, keep_branch=keep_branch)
    missing = np.isnan(found.q).any(axis=1) & np.isfinite(targets).all(axis=1)
    for starts in _further_starts(robot, coordinates, targets, solver) if missing.any() else ():
        failed = np.flatnonzero(missing & np.isnan(found.q[:, 0]))
        if failed.size:
            others = solver.walk(targets[failed], starts[failed], home_too=False, keep_branch=keep_branch)
            _replace_rows(found, failed, others)
    turned = _turned_into_limits(robot, coordinates, found.q)
    if turned is not found.q:  # the same poses, except for their broken limits
        found = found._replace(q=turned, broken_limits=None)
    return _move_into_limits(robot, coordinates, targets, found, solver)


def waypoints(
    robot: PlacedMechanism,
    coordinates: tuple[Coordinate, ...],
    home: Vector,
    walk: Callable[[Matrix, Matrix], Matrix],
) -> tuple[Matrix, Matrix]:
    """Return values, shape=(m, number of coordinates), and poses, shape=(m, nq), of a lattice all over the reach.

    The cell around home is walked to from there, other points from neighbours, round by round. By which way a point is
    reached depends on what is reachable only, so that engines agree where several poses have the same coordinates.

    Args:
        robot: the robot.
        coordinates: the coordinates of the lattice.
        home: the configuration from which poses are reached.
        walk: returns the poses at targets by walks from starts, shape=(n, nq), NaN where there is none.
    """
    if _FEWEST_ALONG ** len(coordinates) > _MAX_WAYPOINTS:  # poses between home and a target are tried anyway
        return np.empty((0, len(coordinates))), np.empty((0, len(home)))
    transform = robot.configuration(home).tool_placement.homogeneous if any(c.tool for c in coordinates) else None
    origin = robot.read(coordinates, home, transform)
    grid = _waypoint_lattice(robot, coordinates, origin)
    dimensions = len(coordinates)
    values = grid.values.reshape(*grid.shape, dimensions)
    centre = [int(np.abs(axis - x).argmin()) for axis, x in zip(grid.axes.values(), origin, strict=True)]
    offsets = np.moveaxis(np.indices(grid.shape), 0, -1) - centre
    around = np.abs(offsets).max(axis=-1) <= 1
    q = np.full((*grid.shape, len(home)), np.nan)
    q[around] = walk(np.tile(home, (int(around.sum()), 1)), values[around])
    new = np.isfinite(q[..., 0])
    while new.any():
        before = np.isfinite(q[..., 0])
        for dimension in range(dimensions):
            ahead = (*[slice(None)] * dimension, slice(1, None))
            behind = (*[slice(None)] * dimension, slice(None, -1))
            for target, source in ((ahead, behind), (behind, ahead)):
                untried = np.zeros(grid.shape, dtype=bool)
                untried[target] = new[source] & np.isnan(q[target][..., 0])
                if untried.any():
                    starts = np.full_like(q, np.nan)
                    starts[target] = q[source]
                    q[untried] = walk(starts[untried], values[untried])
        new = np.isfinite(q[..., 0]) & ~before
    found = np.isfinite(q[..., 0])
    return values[found], q[found]


def _waypoint_lattice(robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], home: Vector) -> Grid:
    """Return a lattice of about a thousand values around home, along each coordinate as far as its joint goes."""
    size, axes = max(round(_WAYPOINTS ** (1.0 / len(coordinates))), _FEWEST_ALONG), {}
    for coordinate, middle, unit in zip(coordinates, home, coordinate_scales(robot, coordinates), strict=True):
        width = unit * (_WIDTH if coordinate.unit == "m" else np.pi)
        # declared ranges of the tool are for maps, and do not bound the reachable set
        lower, upper = (-np.inf, np.inf) if coordinate.joint is None else robot.range_of(coordinate)
        first = lower if np.isfinite(lower) else middle - width
        last = upper if np.isfinite(upper) else middle + width
        axes[coordinate.name] = np.linspace(first, last, size)
    return Grid(coordinates, axes, {})


def _nearest_poses(
    robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], values: Matrix, q: Matrix, targets: Matrix
) -> Iterator[Matrix]:
    """Yield the poses q whose coordinates are nearest to each target, shape=(n, nq), then those next to it."""
    if not len(q):
        return
    units = coordinate_scales(robot, coordinates)
    known, count = (values / units).T, min(_NEAREST, len(q))
    nearest, size = np.empty((count, len(targets)), dtype=np.intp), max(_COMPARED // len(q), 1)
    for first in range(0, len(targets), size):  # a search tree would take longer to import than this to compare
        part = np.nan_to_num(targets[first : first + size] / units).T
        distances, rows = np.zeros((part.shape[1], len(q))), np.arange(part.shape[1])
        for own, others in zip(part, known, strict=True):
            np.maximum(distances, np.abs(own[:, None] - others), out=distances)
        for chosen in nearest[:, first : first + size]:
            chosen[:] = distances.argmin(axis=1)
            distances[rows, chosen] = np.inf
    yield from (q[chosen] for chosen in nearest)


def _within_arms_length(robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], targets: Matrix) -> Matrix:
    """Return the targets, NaN where their tool positions are farther from an arm's first joint than the arm is long."""
    columns = [index for axis in "xyz" for index, coordinate in enumerate(coordinates) if coordinate.tool == axis]
    if robot.arm_reach is None or len(columns) < len("xyz"):
        return targets
    centre, radius = robot.arm_reach
    distances = np.linalg.norm(targets[:, columns] - centre, axis=1)
    return np.where((distances > radius * (1.0 + _ROUNDING))[:, None], np.nan, targets)


def _further_starts(
    robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], targets: Matrix, solver: Solver
) -> Iterator[Matrix]:
    """Yield further starts of walks to targets, for targets not reached from home, shape=(n, nq).

    The inverse kinematics of a serial arm has many, distant solutions. The reachable set of a machine with loops may
    have holes, which walks must go around.
    """
    if robot.has_branches:
        yield from _nearest_poses(robot, coordinates, *solver.lattice, targets)
    elif any(coordinate.tool is not None for coordinate in coordinates):
        shape = (_FURTHER_STARTS, robot.model.nv)
        for motion in np.random.default_rng(0).uniform(-np.pi, np.pi, shape) * robot.velocity_scale:
            start = pin.integrate(robot.model, robot.home.q, motion)
            yield np.broadcast_to(start, (len(targets), robot.model.nq))


def _turned_into_limits(robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], q: Matrix) -> Matrix:
    """Turn joints of a serial arm by whole turns into their limits, where possible."""
    if robot.has_loops or any(coordinate.tool is None for coordinate in coordinates):
        return q
    joints = [
        robot.single_joint(robot.model.names[k]) for k, joint in enumerate(robot.model.joints) if k and joint.nv == 1
    ]
    turning = [joint.q_index for joint in joints if not (joint.translates or joint.is_continuous)]
    lower, upper, angles = robot.lower_limits[turning], robot.upper_limits[turning], q[:, turning]
    turns = np.where(angles > upper, np.floor((upper - angles) / (2.0 * np.pi)), 0.0)
    turns = np.where(angles < lower, np.ceil((lower - angles) / (2.0 * np.pi)), turns)
    turned = angles + 2.0 * np.pi * turns
    turned = np.where((turned >= lower) & (turned <= upper), turned, angles)
    if np.array_equal(turned, angles, equal_nan=True):
        return q
    found = q.copy()
    found[:, turning] = turned
    return found


def _replace_rows(found: Solution, rows: Indices, others: Solution, which: Mask | slice = slice(None)) -> None:
    """Put some of the other poses, those for these rows, into the rows of the poses found, in place."""
    known: list[tuple[Any, Any]] = list(zip(found, others, strict=True))
    for values, other in known:
        if values is not None:
            values[rows[which]] = other[which]


def _move_into_limits(
    robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], targets: Matrix, found: Solution, solver: Solver
) -> Solution:
    """Move poses of a serial arm with null motions into the limits of its joints, where that is found, in place.

    In turn, joints are put within their limits, and the nearest pose at the target is walked to from there: projections
    onto two sets, whose common points they approach (L. Gurin, B. Polyak and E. Raik, USSR Computational Mathematics
    and Mathematical Physics 7, 1967). Poses that do not arrive stay as they were.
    """
    if robot.has_loops or not robot.has_null_motions(coordinates):
        return found
    lower, upper = robot.lower_limits - LIMIT_TOLERANCE, robot.upper_limits + LIMIT_TOLERANCE
    width = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    rows = np.flatnonzero(((found.q < lower) | (found.q > upper)).any(axis=1))
    q = found.q[rows]
    for spare in np.linspace(0.0, _SPARE, _PROJECTIONS)[:, None] * width:
        if not rows.size:
            break
        walked = solver.walk(targets[rows], np.clip(q, lower + spare, upper - spare), home_too=False)
        arrived = np.asarray(((walked.q >= lower) & (walked.q <= upper)).all(axis=1))
        _replace_rows(found, rows, walked, arrived)
        left = ~arrived & np.isfinite(walked.q).all(axis=1)
        q, rows = walked.q[left], rows[left]
    return found
