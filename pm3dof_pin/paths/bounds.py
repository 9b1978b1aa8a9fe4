"""Bounds of the motion along a path: feed, speeds, accelerations and forces of the drives, limits of axes, corners."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from pm3dof_pin.capability.transmission import drive_values
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.paths.follower import Follower, Motion
from pm3dof_pin.paths.time_law import corner_speed
from pm3dof_pin.paths.tool_path import ToolPath
from pm3dof_pin.typing import Array, Indices, Mask, Matrix, Vector

_NEAR = 1e-5  # share of a move that gives the direction of its end
_BLOCK = 16384  # moves at a time
_SHARE = 0.5  # of what a drive can do, for acceleration along the path; the rest is for its curvature


class DriveForces(NamedTuple):
    """Forces of the drives along a path: at rest, by the square of the speed, and by the acceleration, shape=(n, u)."""

    at_rest: Matrix  #: gravity and forces on the tool [N, N m]
    by_square: Matrix  #: [N s^2/m^2]
    by_acceleration: Matrix  #: [N s^2/m]


Loads: TypeAlias = Callable[[Motion, Indices, Array, Vector, Matrix, Matrix], DriveForces]
"""The forces of the drives by the motion, moves, shares, feed, and derivatives of all joints by the path's length."""


@dataclass(frozen=True)
class MotionLimits:
    """Limits of the motion in time. Of a path with times, none applies."""

    acceleration: float = 1.0  #: of the tool point, along the path and across it [m/s^2]
    #: feed of moves that have none, and of rapids; the drives' speed limits bound it anyway [m/s]
    rapid: float = 0.2
    feed: float | None = None  #: instead of the path's feeds [m/s]
    jerk: float | None = None  #: of the tool point along the path, unbounded by default [m/s^3]
    drive_speed: Vector | None = None  #: of the actuated joints, the description's by default [m/s, rad/s]
    drive_acceleration: Vector | None = None  #: of the actuated joints, none by default [m/s^2, rad/s^2]
    drive_force: Vector | None = None  #: of the actuated joints, the description's by default [N, N m]
    #: of numbers of the path by name, such as X or A of a program, none by default [m/s, rad/s]
    axis_speed: Mapping[str, float] = field(default_factory=dict)
    axis_acceleration: Mapping[str, float] = field(default_factory=dict)  #: likewise [m/s^2, rad/s^2]

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name in ("acceleration", "rapid", "feed", "jerk"):
            value = getattr(self, name)
            if value is not None and not (np.isfinite(value) and value > 0.0):
                raise InvalidValueError(name, value, "a positive number")


class SpeedBounds(NamedTuple):
    """Bounds at points of a path."""

    metric: Vector  #: how fast the path is travelled per share of a move, see :func:`path_metric`
    turns: Mask  #: whether the tool only turns
    ceiling: Vector  #: greatest feed that the drives permit [m/s]
    bound: Vector  #: greatest speed [m/s]
    tangential: Vector  #: greatest acceleration along the path [m/s^2]


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


class PathBounds:
    """Bounds of the motion of a robot along a path.

    Args:
        follower: the robot on the path.
        limits: limits of the motion.
        tolerance: of corners whose tolerance the path does not say [m].
        loads: the forces of the drives, for their limits; None for no limits.
    """

    def __init__(self, follower: Follower, limits: MotionLimits, tolerance: float, loads: Loads | None) -> None:
        self._follower, self._limits, self._tolerance, self._loads = follower, limits, tolerance, loads
        self._speed = drive_limits(follower.robot, limits.drive_speed, "speed")
        self._acceleration = drive_limits(follower.robot, limits.drive_acceleration)
        self._force = drive_limits(follower.robot, limits.drive_force, "effort")
        names = follower.path.names
        self._axes = [
            np.array([given.get(name, np.inf) for name in names])
            for given in (limits.axis_speed, limits.axis_acceleration)
        ]

    def at(self, moves: Indices, shares: Array, sizes: Vector) -> SpeedBounds:
        """Return the bounds at points of a path."""
        follower, limits, path = self._follower, self._limits, self._follower.path
        motion = follower.motion(moves, shares, sizes)
        metric, change, turns = path_metric(path, motion)
        first, second = along_path(motion, metric, change)
        drives = follower.robot.actuated_indices
        feed = self._feeds(moves, turns)
        ceiling = np.minimum(
            _least(self._speed, first[:, drives]),
            np.sqrt(_least((1.0 - _SHARE) * self._acceleration, second[:, drives])),
        )
        unit = np.where(turns, follower.unit, 1.0)
        greatest = limits.acceleration / unit
        tangential = np.minimum(greatest, _least(_SHARE * self._acceleration, first[:, drives]))
        if self._loads is not None and np.isfinite(self._force).any():
            forces = self._loads(motion, moves, shares, np.minimum(feed * unit, limits.rapid), first, second)
            left = np.maximum(self._force - np.abs(forces.at_rest), 0.0)
            ceiling = np.minimum(ceiling, np.sqrt(_least((1.0 - _SHARE) * left, forces.by_square)))
            holds = (left > 0.0).all(axis=1)
            tangential = np.where(
                holds, np.minimum(tangential, _least(_SHARE * left, forces.by_acceleration)), tangential
            )
        else:
            holds = np.ones(len(moves), dtype=bool)
        with np.errstate(divide="ignore", invalid="ignore"):
            rates = motion.target_slope / metric[:, None]
            across = (motion.tool_second - motion.tool[:, :3] * (change / metric)[:, None]) / metric[:, None] ** 2
        bent = np.where(turns, 0.0, np.nan_to_num(np.linalg.norm(across, axis=1)))
        bound = np.minimum(feed, _least(self._axes[0], rates))
        bound = np.minimum(bound, np.sqrt(_least(np.array([limits.acceleration]), bent[:, None])))
        tangential = np.minimum(tangential, _least(self._axes[1], rates))
        # where the drives do not even hold the tool at rest no feed is permitted, and the motion goes on as if they did
        bound = np.where(holds, np.minimum(bound, ceiling), bound)
        metric = np.where(np.isfinite(metric), metric, sizes[moves])
        return SpeedBounds(metric, turns, np.where(holds, ceiling, 0.0), bound, tangential)

    def _feeds(self, moves: Indices, turns: Mask) -> Vector:
        """Return the feed, shape=(n,) [m/s], or where the tool only turns [rad/s]."""
        path, limits = self._follower.path, self._limits
        unit = np.where(turns, self._follower.unit, 1.0)
        given = np.where(turns, path.turning_feed[moves], path.feed[moves])
        if limits.feed is not None:
            given = np.where(path.rapid[moves], np.nan, limits.feed / unit)
        elif path.has_durations:
            given = np.where(np.isfinite(path.duration[moves]), np.inf, given)
        return np.where(np.isnan(given) | path.rapid[moves], limits.rapid / unit, given)

    def limit_to_durations(self, moves: Indices, length: Vector, bound: Vector) -> None:
        """Lower bounds of moves that have a duration to their mean speed, in place."""
        path = self._follower.path
        if self._limits.feed is not None or not path.has_durations:
            return
        whole = np.bincount(moves, length, minlength=len(path))
        with np.errstate(divide="ignore", invalid="ignore"):
            mean = whole / path.duration
        np.minimum(bound, np.where(np.isfinite(mean), mean, np.inf)[moves], out=bound)

    def corners(self) -> Vector:
        """Return the greatest speed at the end of each move, shape=(number of moves,) [m/s]; the last is zero."""
        path, count = self._follower.path, len(self._follower.path)
        found = np.zeros(count)
        for begin in range(0, count, _BLOCK):
            moves = np.arange(begin, min(begin + _BLOCK + 1, count))
            near = np.full(len(moves), _NEAR)
            directions = []
            for first, last in ((0.0 * near, near), (1.0 - near, 0.0 * near + 1.0)):
                change = (path.values(moves, last) - path.values(moves, first)) * self._follower.scale
                directions.append(change / np.maximum(np.linalg.norm(change, axis=1, keepdims=True), 1e-300))
            cosine = np.einsum("ni,ni->n", directions[1][:-1], directions[0][1:])
            blend = np.nan_to_num(path.blend[moves[:-1]], nan=self._tolerance)
            found[moves[:-1]] = corner_speed(cosine, blend, self._limits.acceleration)
        return found


def drive_limits(robot: Robot, given: Vector | None, described: Literal["effort", "speed"] | None = None) -> Vector:
    """Return limits of the drives: those given, else as described, infinite where there are none, shape=(u,)."""
    if given is None:
        return np.full(len(robot.actuated_joints), np.inf) if described is None else drive_values(robot, described)
    limits = np.broadcast_to(np.asarray(given, dtype=float), len(robot.actuated_joints))
    return np.where(limits > 0.0, limits, np.inf)


def _least(limits: Vector, rates: Matrix) -> Vector:
    """Return the least of limits over absolute rates, infinite where there are none, shape=(n,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        ratios = limits / np.abs(rates)
    return np.asarray(np.where(np.isnan(ratios), np.inf, ratios).min(axis=1, initial=np.inf))
