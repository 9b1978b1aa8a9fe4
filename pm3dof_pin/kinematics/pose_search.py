"""Finding poses at values of coordinates: from home or from guesses, with further starts if that fails."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.careful import close_all
from pm3dof_pin.typing import Array, Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.continuation import Continuation
    from pm3dof_pin.kinematics.robot import Robot

_ROUNDING = 1e-9
_FURTHER_STARTS = 16  # for the inverse kinematics of a serial arm


class Solution(NamedTuple):
    """Poses found, and their checks. Where there is none, everything is NaN and `broken_limits` is 1."""

    q: Matrix  #: joint configurations, shape=(n, nq) [m, rad]
    residual: Vector | None = None  #: greatest closure error, shape=(n,) [m, rad]; None if unknown
    #: bit masks, shape=(n,): 1 for an unsolved pose, 2^(k + 1) for limit group k
    broken_limits: NDArray[np.uint32] | None = None
    #: placements of the tool, shape=(n, 4, 4); None also for a mechanism without a tool frame, and after a march
    transforms: Array | None = None


def find_poses(
    robot: Robot,
    coordinates: tuple[Coordinate, ...],
    targets: Matrix,
    guesses: Matrix | None,
    continuation: Continuation | None,
) -> Solution:
    """Find poses at targets, shape=(n, number of coordinates), from guesses, shape=(n, nq), or by default from home.

    By programs, or by Pinocchio if there is no continuation. Without a guess, further starts are tried.
    """
    targets = _within_arms_length(robot, coordinates, targets)
    if guesses is not None:
        return _walked(robot, coordinates, targets, guesses, continuation)
    found = _walked(robot, coordinates, targets, None, continuation)
    missing = np.isnan(found.q).any(axis=1) & np.isfinite(targets).all(axis=1)
    for starts in _further_starts(robot, coordinates, targets) if missing.any() else ():
        failed = np.flatnonzero(missing & np.isnan(found.q[:, 0]))
        if failed.size:
            others = _walked(robot, coordinates, targets[failed], starts[failed], continuation, home_too=False)
            known: list[tuple[Any, Any]] = list(zip(found, others, strict=True))
            for values, other in known:
                if values is not None:
                    values[failed] = other
    turned = _turned_into_limits(robot, coordinates, found.q)
    # the same poses, except for their broken limits
    return found if turned is found.q else found._replace(q=turned, broken_limits=None)


def _within_arms_length(robot: Robot, coordinates: tuple[Coordinate, ...], targets: Matrix) -> Matrix:
    """Return the targets, NaN where their tool positions are farther from an arm's first joint than the arm is long."""
    columns = [index for axis in "xyz" for index, coordinate in enumerate(coordinates) if coordinate.tool == axis]
    if robot.arm_reach is None or len(columns) < len("xyz"):
        return targets
    centre, radius = robot.arm_reach
    distances = np.linalg.norm(targets[:, columns] - centre, axis=1)
    return np.where((distances > radius * (1.0 + _ROUNDING))[:, None], np.nan, targets)


def _walked(
    robot: Robot,
    coordinates: tuple[Coordinate, ...],
    targets: Matrix,
    starts: Matrix | None,
    continuation: Continuation | None,
    *,
    home_too: bool = True,
) -> Solution:
    if continuation is not None:
        return continuation.walk(targets, starts, home_too=home_too)
    given = np.tile(robot.home.q, (len(targets), 1)) if starts is None else starts
    return Solution(close_all(robot, coordinates, targets, given))


def _further_starts(robot: Robot, coordinates: tuple[Coordinate, ...], targets: Matrix) -> Iterator[Matrix]:
    """Yield further starts of walks to targets, for targets not reached from home, shape=(n, nq).

    The inverse kinematics of a serial arm has many, distant solutions. The reachable set of a machine with loops may
    have holes, which walks must go around.
    """
    if robot.closures:
        if (continuation := robot.continuation(coordinates)) is not None:
            yield continuation.waypoints(targets)
    elif any(coordinate.tool is not None for coordinate in coordinates):
        shape = (_FURTHER_STARTS, robot.model.nv)
        for motion in np.random.default_rng(0).uniform(-np.pi, np.pi, shape) * robot.velocity_scale:
            start = pin.integrate(robot.model, robot.home.q, motion)
            yield np.broadcast_to(start, (len(targets), robot.model.nq))


def _turned_into_limits(robot: Robot, coordinates: tuple[Coordinate, ...], q: Matrix) -> Matrix:
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
