"""Points of a path, close enough for its limits and errors between them, and the motion in time over them."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.paths.follower import Follower, Motion
from pm3dof_pin.paths.time_law import Speeds, corner_speed, look_ahead
from pm3dof_pin.paths.tool_path import ToolPath
from pm3dof_pin.typing import Array, Indices, Mask, Matrix, Vector

Result = TypeVar("Result")

BLOCK = 16384
"""Points at a time, to bound the memory."""

_MAX_PARTS = 100_000  # of one move
_NEAR = 1e-5  # share of a move that gives the direction of its end
_SPACINGS, _LEAST_POINTS = 50.0, 2000.0  # of points by default: per characteristic length, and of the whole path


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the motion in time. Of a path with times, none applies."""

    acceleration: float = 1.0  #: of the tool point along the path [m/s^2]
    #: feed of moves that have none, and of rapids; the drives' speed limits bound it anyway [m/s]
    rapid: float = 0.2
    feed: float | None = None  #: instead of the path's feeds [m/s]
    drive_speed: Vector | None = None  #: of the actuated joints, the description's by default [m/s, rad/s]
    drive_acceleration: Vector | None = None  #: of the actuated joints, none by default [m/s^2, rad/s^2]

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("acceleration", "rapid", "feed"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InvalidValueError(name, value, "a positive number")


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
    count = threads or os.cpu_count() or 1
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
    sizes = follower.sizes(np.arange(count))
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

    blocks = [slice(first, min(first + BLOCK, count)) for first in range(0, count, BLOCK)]
    for part, (bent, legal) in in_blocks(bends, blocks, robot.threads):
        moves = np.arange(part.start, part.stop)
        worst = np.where(np.isfinite(bent).all(axis=0), bent.max(axis=0), sizes[moves] ** 2 / (8.0 * follower.unit))
        needed = np.maximum(np.sqrt(worst / tolerance), sizes[moves] / spacing)
        needed = np.minimum(np.ceil(np.nan_to_num(needed, nan=1.0)), _MAX_PARTS).astype(np.int64)
        parts[moves] = np.where((needed > 1) | (legal[0] & ~legal[1] & legal[2]), needed + needed % 2, 1)
    parts = np.where(parts == 0, 2, parts)
    index = np.repeat(np.arange(count), parts)
    within = np.arange(len(index)) - np.repeat(np.cumsum(parts) - parts, parts) + 1
    shares = within / parts[index]
    return PathPoints(frozen(np.insert(index, 0, 0)), frozen(np.insert(shares, 0, 0.0)), frozen(sizes))


def path_metric(path: ToolPath, motion: Motion) -> tuple[Vector, Vector, Mask]:
    """Return how fast the path is travelled per share of a move, its derivative, and whether the tool only turns.

    In m, of the tool point against the workpiece; in rad where it only turns.
    """
    if path.times is not None:
        ones = np.ones(len(motion.tool))
        return ones, np.zeros_like(ones), np.zeros(len(ones), dtype=bool)
    if path.components is not None:
        metric = np.linalg.norm(motion.target_slope[:, :3], axis=1)
        turning = np.linalg.norm(motion.target_slope[:, 3:], axis=1)
        change = np.zeros_like(metric)
    else:
        metric, turning = (np.linalg.norm(part, axis=1) for part in (motion.tool[:, :3], motion.tool[:, 3:]))
        with np.errstate(divide="ignore", invalid="ignore"):
            change = np.einsum("ni,ni->n", motion.tool[:, :3], motion.tool_second) / metric
    only_turns = metric <= 1e-9 * turning
    return np.where(only_turns, turning, metric), np.where(only_turns, 0.0, np.nan_to_num(change)), only_turns


def along_path(motion: Motion, metric: Vector, change: Vector) -> tuple[Matrix, Matrix]:
    """Return the derivatives of all joints by the length of the path: first and second, shape=(n, nv)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first = motion.joints / metric[:, None]
        second = (motion.joints_second - first * change[:, None]) / metric[:, None] ** 2
    at_rest = metric == 0.0
    first[at_rest], second[at_rest] = np.where(np.isfinite(motion.joints[at_rest]), 0.0, np.nan), 0.0
    return first, second


def plan_motion(follower: Follower, points: PathPoints, limits: MotionLimits, tolerance: float) -> TimedPoints:
    """Compute the motion in time over points of a path: by its own times, or by :mod:`pm3dof_pin.paths.time_law`.

    Args:
        follower: the robot on the path.
        points: the points.
        limits: limits of the motion.
        tolerance: of corners whose tolerance the path does not say [m].
    """
    path, n = follower.path, len(points)
    if path.times is not None:
        first, last = path.times[points.moves], path.times[points.moves + 1]
        time = first + points.shares * (last - first)
        step = np.diff(time, prepend=time[0])
        return TimedPoints(points, step, np.full(n, np.inf), Speeds(np.ones(n), np.zeros(n), step), time)
    robot = follower.robot
    speed_limit = drive_limits(follower, limits.drive_speed, robot.model.velocityLimit[robot.actuated_indices])
    drive_limit = drive_limits(follower, limits.drive_acceleration, np.inf)
    metric, ceiling, tangential = np.zeros(n), np.zeros(n), np.zeros(n)
    turns = np.zeros(n, dtype=bool)

    def bound(part: slice) -> None:
        motion = follower.motion(points.moves[part], points.shares[part], points.sizes)
        metric[part], change, turns[part] = path_metric(path, motion)
        first, second = (x[:, robot.actuated_indices] for x in along_path(motion, metric[part], change))
        ceiling[part] = np.minimum(_least(speed_limit, first), np.sqrt(_least(0.5 * drive_limit, second)))
        greatest = np.where(turns[part], limits.acceleration / follower.unit, limits.acceleration)
        tangential[part] = np.minimum(greatest, _least(0.5 * drive_limit, first))

    for _ in in_blocks(bound, points.blocks(), robot.threads):
        pass
    metric = np.where(np.isfinite(metric), metric, points.sizes[points.moves])
    inside = points.moves[1:] == points.moves[:-1]
    mean = np.where(inside, 0.5 * (metric[1:] + metric[:-1]), metric[1:])
    steps = points.shares[1:] - np.where(inside, points.shares[:-1], 0.0)
    length = np.insert(mean * steps, 0, 0.0)
    feed = _feeds(path, points, length, limits, np.where(turns, follower.unit, 1.0))
    at = np.full(n, np.inf)
    ends = np.flatnonzero(points.moves[1:] != points.moves[:-1])
    at[ends] = _corners(follower, limits.acceleration, tolerance)[points.moves[ends]]
    at[:-1][turns[1:] != turns[:-1]] = 0.0
    speeds = look_ahead(length, np.minimum(ceiling, feed), at, tangential)
    waits = np.zeros(n)
    rests = (points.sizes[points.moves] == 0.0) & (points.shares == 1.0)
    waits[rests] = np.nan_to_num(path.duration[points.moves[rests]])
    duration = speeds.duration + waits
    return TimedPoints(points, length, ceiling, speeds._replace(duration=duration), np.cumsum(duration))


def drive_limits(follower: Follower, given: Vector | None, usual: Array | float) -> Vector:
    """Return limits of the drives, infinite where there are none, shape=(u,)."""
    count = len(follower.robot.actuated_joints)
    limits = np.broadcast_to(np.asarray(usual if given is None else given, dtype=float), count)
    return np.where(limits > 0.0, limits, np.inf)


def _least(limits: Vector, rates: Matrix) -> Vector:
    """Return the least of limits over absolute rates, infinite where there are none, shape=(n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = limits / np.abs(rates)
    return np.asarray(np.where(np.isnan(ratios), np.inf, ratios).min(axis=1, initial=np.inf))


def _feeds(path: ToolPath, points: PathPoints, length: Vector, limits: MotionLimits, units: Vector) -> Vector:
    """Return the feed at each point, shape=(n,) [m/s], or where the tool only turns [rad/s]; units are then lengths."""
    moves = points.moves
    given = np.where(units == 1.0, path.feed[moves], path.turning_feed[moves])
    if limits.feed is not None:
        given = np.where(path.rapid[moves], np.nan, limits.feed / units)
    elif np.isfinite(path.duration).any():
        whole = np.bincount(moves, length, minlength=len(path))[moves]
        given = np.where(np.isfinite(path.duration[moves]), whole / path.duration[moves], given)
    return np.where(np.isfinite(given) & ~path.rapid[moves], given, limits.rapid / units)


def _corners(follower: Follower, acceleration: float, tolerance: float) -> Vector:
    """Return the greatest speed at the end of each move, shape=(number of moves,) [m/s]; the last is zero."""
    path, count = follower.path, len(follower.path)
    moves, near = np.arange(count), np.full(count, _NEAR)
    directions = []
    for first, last in ((0.0 * near, near), (1.0 - near, 0.0 * near + 1.0)):
        change = (path.values(moves, last) - path.values(moves, first)) * follower.scale
        directions.append(change / np.maximum(np.linalg.norm(change, axis=1, keepdims=True), 1e-300))
    cosine = np.einsum("ni,ni->n", directions[1][:-1], directions[0][1:])
    blend = np.where(np.isnan(path.blend), tolerance, path.blend)[:-1]
    return np.append(corner_speed(cosine, blend, acceleration), 0.0)
