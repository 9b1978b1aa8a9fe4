"""Points of a path, close enough for its limits and errors between them, and the motion in time over them."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from pm3dof_pin.arrays import large_array
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.paths.bounds import Loads, MotionLimits, PathBounds
from pm3dof_pin.paths.follower import Follower
from pm3dof_pin.paths.time_law import Speeds, look_ahead
from pm3dof_pin.programs.processors import processors
from pm3dof_pin.typing import Indices, Mask, Matrix, Vector

Result = TypeVar("Result")

BLOCK = 4096
"""Points at a time, to bound the memory."""

_MAX_PARTS = 100_000  # of one move
_SPACINGS, _LEAST_POINTS = 50.0, 2000.0  # of points by default: per characteristic length, and of the whole path


@dataclass(frozen=True, eq=False)
class PathPoints:
    """Points along a path, in order: the ends of moves, and as many between them as needed."""

    moves: Indices  #: index of the move of each point, shape=(n,)
    shares: Vector  #: share of the move, 0 to 1, shape=(n,)
    sizes: Vector  #: length of each move, angles times the characteristic length, shape=(number of moves,) [m]

    def __len__(self) -> int:
        """Return the number of points."""
        return len(self.moves)

    def blocks(self) -> list[slice]:
        """Return slices of at most :data:`BLOCK` points that cover all."""
        return [slice(first, min(first + BLOCK, len(self))) for first in range(0, len(self), BLOCK)]


@dataclass(frozen=True, eq=False)
class TimedPoints:
    """The motion in time over points of a path."""

    points: PathPoints
    length: Vector  #: of the path from the point before, shape=(n,) [m]; in moves that only turn the tool [rad]
    ceiling: Vector  #: greatest feed that the drives permit, shape=(n,) [m/s]
    speeds: Speeds
    time: Vector  #: at each point, shape=(n,) [s]


def in_blocks(
    function: Callable[[slice], Result], blocks: Iterable[slice], threads: int | None
) -> Iterator[tuple[slice, Result]]:
    """Yield each block and the function's result in order, computed by threads ahead of the consumer, few at a time.

    The first block is computed alone: it makes what the others share, such as compiled programs.
    """
    waiting: deque[tuple[slice, Future[Result]]] = deque()
    rest = iter(blocks)
    if (first := next(rest, None)) is None:
        return
    yield first, function(first)
    count = threads or processors()
    with ThreadPoolExecutor(count) as pool:
        for part in rest:
            waiting.append((part, pool.submit(function, part)))
            if len(waiting) > count:
                done, future = waiting.popleft()
                yield done, future.result()
        for done, future in waiting:
            yield done, future.result()


def choose_points(follower: Follower, tolerance: float, spacing: float | None = None) -> PathPoints:
    """Choose points such that joints that move evenly between them leave the path by at most a tolerance.

    The second derivative of all joints along each move, at its ends and its middle, bounds how far they are from
    straight lines between two points. What breaks a limit or is out of reach in the middle of a move is found too.

    Args:
        follower: the robot on the path.
        tolerance: greatest deviation [m], of angles times the characteristic length.
        spacing: greatest distance of points [m]; by default a fiftieth of the characteristic length, or a 2000th of the
            path if that is less.

    Raises:
        UnreachablePoseError: the path sets components of the placement that the robot cannot give.
        InvalidValueError: a tolerance or spacing is not positive.
    """
    for name, value in (("tolerance", tolerance), ("spacing", spacing)):
        if value is not None and not (np.isfinite(value) and value > 0.0):
            raise InvalidValueError(name, value, "a positive length")
    path, robot = follower.path, follower.robot
    count = len(path)
    blocks = [slice(first, min(first + BLOCK, count)) for first in range(0, count, BLOCK)]
    sizes = np.concatenate([follower.sizes(np.arange(part.start, part.stop)) for part in blocks])
    if spacing is None:
        spacing = min(follower.unit / _SPACINGS, float(sizes.sum()) / _LEAST_POINTS) or follower.unit
    parts = np.ones(count, dtype=np.int64)
    scale = follower.unit / robot.velocity_scale

    def bends(part: slice) -> tuple[Matrix, Mask]:
        moves = np.arange(part.start, part.stop)
        bent, legal = np.zeros((3, len(moves))), np.zeros((3, len(moves)), dtype=bool)
        for k, share in enumerate((0.0, 0.5, 1.0)):
            motion = follower.motion(moves, np.full(len(moves), share), sizes)
            follower.require_agreement(motion.poses, motion.targets, moves, tolerance)
            bent[k] = np.abs(motion.joints_second * scale).max(axis=1, initial=0.0) / 8.0
            legal[k] = motion.poses.within_limits & (motion.poses.branch == 0)
        return bent, legal

    for part, (bent, legal) in in_blocks(bends, blocks, robot.threads):
        moves = np.arange(part.start, part.stop)
        worst = np.where(np.isfinite(bent).all(axis=0), bent.max(axis=0), sizes[moves] ** 2 / (8.0 * follower.unit))
        needed = np.maximum(np.sqrt(worst / tolerance), sizes[moves] / spacing)
        needed = np.minimum(np.ceil(np.nan_to_num(needed, nan=1.0)), _MAX_PARTS).astype(np.int64)
        parts[moves] = np.where((needed > 1) | (legal[0] & ~legal[1] & legal[2]), needed + needed % 2, 1)
    parts = np.where(parts == 0, 2, parts)
    ends = np.cumsum(parts)
    before = ends - parts
    points = PathPoints(large_array(int(ends[-1]) + 1, np.int32), large_array(int(ends[-1]) + 1), sizes)
    for part in blocks:
        index = np.repeat(np.arange(part.start, part.stop, dtype=np.int32), parts[part])
        here = slice(int(before[part.start]) + 1, int(ends[part.stop - 1]) + 1)
        points.moves[here] = index
        points.shares[here] = (np.arange(here.start, here.stop) - before[index]) / parts[index]
    for array in points.moves, points.shares, points.sizes:
        array.setflags(write=False)
    return points


def plan_motion(
    follower: Follower, points: PathPoints, limits: MotionLimits, tolerance: float, loads: Loads | None = None
) -> TimedPoints:
    """Compute the motion in time over points of a path: by its own times, or by :mod:`pm3dof_pin.paths.time_law`.

    Args:
        follower: the robot on the path.
        points: the points.
        limits: limits of the motion.
        tolerance: of corners whose tolerance the path does not say [m].
        loads: the forces of the drives, for their limits; without it these do not bound the motion.
    """
    path, n = follower.path, len(points)
    length, ceiling, time = (large_array(n) for _ in range(3))
    if path.times is not None:
        for part in points.blocks():
            moves = points.moves[part]
            first, last = path.times[moves], path.times[moves + 1]
            time[part] = first + points.shares[part] * (last - first)
            length[part] = np.diff(time[part], prepend=time[max(part.start - 1, 0)])
        ceiling[:] = np.inf
        return TimedPoints(points, length, ceiling, Speeds(np.ones(n), np.zeros(n), length), time)
    bounds = PathBounds(follower, limits, tolerance, loads)
    metric, bound, at, tangential = (large_array(n) for _ in range(4))
    turns = large_array(n, np.bool_)

    def fill(part: slice) -> None:
        found = bounds.at(points.moves[part], points.shares[part], points.sizes)
        metric[part], turns[part], ceiling[part] = found.metric, found.turns, found.ceiling
        bound[part], tangential[part] = found.bound, found.tangential

    for _ in in_blocks(fill, points.blocks(), follower.robot.threads):
        pass
    for part in reversed(points.blocks()):  # from point to point, at both of which it holds
        before = np.maximum(np.arange(part.start, part.stop) - 1, 0)
        least = np.minimum(tangential[part], tangential[before])
        # of a program, moves that only turn the tool are measured in rad, others in m
        other = (turns[part] != turns[before]) & (path.components is not None)
        tangential[part] = np.where(other, tangential[part], least)
    corners = bounds.corners()
    for part in points.blocks():
        moves, shares = points.moves[part], points.shares[part]
        before = np.append(points.moves[max(part.start - 1, 0)], moves[:-1])
        slower = np.append(metric[max(part.start - 1, 0)], metric[part][:-1])
        inside = moves == before
        shares_before = np.where(inside, np.append(points.shares[max(part.start - 1, 0)], shares[:-1]), 0.0)
        length[part] = np.where(inside, 0.5 * (metric[part] + slower), metric[part]) * (shares - shares_before)
        after = np.append(points.moves[part.start + 1 : part.stop + 1], [] if part.stop < n else [-1])
        ends = moves != after
        at[part] = np.where(ends, corners[moves], np.inf)
        turning = np.append(turns[part.start + 1 : part.stop + 1], [] if part.stop < n else turns[-1:])
        at[part][turning != turns[part]] = 0.0
    length[0] = 0.0
    bounds.limit_to_durations(points.moves, length, bound)
    averaged_over = 0.0 if limits.jerk is None else 2.0 * limits.acceleration / limits.jerk
    speeds = look_ahead(length, bound, at, tangential, averaged_over=averaged_over)
    total = 0.0
    for part in points.blocks():
        moves = points.moves[part]
        rests = (points.sizes[moves] == 0.0) & (points.shares[part] == 1.0)
        speeds.duration[part] += np.where(rests, np.nan_to_num(path.duration[moves]), 0.0)
        time[part] = total + np.cumsum(speeds.duration[part])
        total = float(time[part.stop - 1])
    return TimedPoints(points, length, ceiling, speeds, time)
