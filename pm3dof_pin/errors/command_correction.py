"""Commands that bring a robot nearest to a desired pose, in the tip-weighted sense.

With fewer drives than the pose has degrees of freedom, no commands reach the full pose; those that minimise
|translation|^2 + eta^2 |rotation|^2 are taken. The remainder cannot be corrected by commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import ROUNDING, SOLVED
from pm3dof_pin.typing import Array, Mask, OnFailure

_SOUND = 1e6  # greatest condition number of the normal equations, the square of the control matrix's
_STEPS = 3  # each reduces the error about a thousandfold
_SHORTER = (0.25, 0.25, 0.25, 0.0)  # factors tried in turn on a step that increases the error
_FARTHEST_TURN = np.pi  # of a drive in one step [rad]: derivatives are meaningless beyond half a turn
_SETTLED = 1e-6  # last of these steps [rad, m], after which nothing is left to be gained
_STRAYED = 1e-2  # share of the error that they leave where damped ones had better start anew
_DAMPED_STEPS = 60
_NEGLIGIBLE = 1e-9  # expected gain of a damped step at which they end [m, tip-weighted]
_DAMPING, _LESS, _MORE = 1e-3, 0.1, 4.0  # at first, relative to squared derivatives, and factors after each step
_LEAST_DAMPING = 1e-10  # with which redundant drives have steps
_AS_EXPECTED = 0.25  # share of the expected gain after which it becomes less


_FOUND: WeakKeyDictionary[Poses, Array] = WeakKeyDictionary()  # poses never change, and are asked for it several times


def command_jacobians(poses: Poses) -> Array:
    """Return the tool's motion by the commands, shape=(n, 6, number of commands), read-only."""
    if poses not in _FOUND:
        _FOUND[poses] = sensitivities(_no_errors(poses.robot.prototype), poses, engine=poses.robot.engine).commands
    return _FOUND[poses]


@lru_cache(maxsize=4)
def _no_errors(robot: Robot) -> GeometricErrors:
    """Return no errors of a robot, which know what its joints move."""
    return GeometricErrors(robot, ())


def command_scales(poses: Poses) -> Array:
    """Return counter units per unit of each drive's joint, shape=(number of commands,).

    Sizes, as for which directions are seen, are compared in joint units, because counters may have any unit.
    """
    return np.array([command.scale for command in poses.robot.commands])


def weighted_control(poses: Poses, eta: float = TIP_LENGTH) -> Array:
    """Return the tip-weighted motion of the tool by the drives' joints, shape=(n, 6, number of commands) [m]."""
    return np.asarray(
        command_jacobians(poses) * command_scales(poses) * tip_weights(eta, poses.robot.tool_motions)[:, None]
    )


def best_commands(
    commands: ArrayLike,
    differences: ArrayLike,
    eta: float = TIP_LENGTH,
    motions: Sequence[ToolComponent] = TOOL_COMPONENTS,
) -> Array:
    """Return the change of commands that undoes most of small pose errors, shape=(n, 6) [m, rad].

    `commands` are the tool's motions, shape=(n, 6, number of commands); eta weighs the orientation [m/rad], and only
    the robot's `tool_motions` count.
    """
    weights = tip_weights(eta, motions)
    control = np.asarray(commands, dtype=float) * weights[:, None]
    weighted = np.asarray(differences, dtype=float) * weights
    change, sound = _normal_solution(control, weighted)
    if not sound.all():
        inverse = np.linalg.pinv(control[~sound], rcond=SOLVED)
        change[~sound] = np.einsum("nij,nj->ni", inverse, weighted[~sound])
    return -change


def _normal_solution(control: Array, targets: Array) -> tuple[Array, Mask]:
    """Solve least squares by the normal equations, faster than by a pseudo-inverse, and flag where that is accurate."""
    transposed = np.swapaxes(control, 1, 2)
    normal = transposed @ control
    try:
        inverse = np.linalg.inv(normal)
    except np.linalg.LinAlgError:  # some are singular
        return np.zeros(normal.shape[:2]), np.zeros(len(control), dtype=bool)
    change = np.einsum("nij,nj->ni", inverse, np.einsum("nij,nj->ni", transposed, targets))
    condition = np.linalg.norm(normal, axis=(1, 2)) * np.linalg.norm(inverse, axis=(1, 2))
    return change, np.asarray(condition < _SOUND)


def nearest_poses(poses: Poses, targets: Array, eta: float = TIP_LENGTH, *, on_failure: OnFailure = "raise") -> Poses:
    """Return the poses of a robot nearest to target transforms, tip-weighted, starting from nearby poses.

    Where Gauss-Newton steps do not settle, as near singularities, damped ones follow. These break no limit.

    Raises:
        UnreachablePoseError: see :func:`descend`.
    """
    weights, scales, steps = tip_weights(eta, poses.robot.tool_motions), command_scales(poses), np.zeros((0, 0))

    def residuals(poses: Poses) -> Array:
        return pose_difference(targets, poses.transforms) * weights

    def step(poses: Poses) -> Array:
        nonlocal steps
        difference = pose_difference(targets, poses.transforms)
        steps = best_commands(command_jacobians(poses) * scales, difference, eta, poses.robot.tool_motions)
        return scales * steps

    found = descend(poses, poses.commands, step, residuals, on_failure=on_failure)[1]
    left = np.linalg.norm(residuals(found), axis=1)
    rows = np.flatnonzero(np.abs(steps).max(axis=1, initial=0.0) > _SETTLED)
    if not rows.size:
        return found
    q = np.array(found.q)
    strayed = left > _STRAYED * np.linalg.norm(residuals(poses), axis=1)
    for start in (np.where(strayed[:, None], poses.q, q), np.array(q)):
        damped = _damped(poses.robot.at(start[rows]), poses.within_limits[rows], targets[rows], eta)
        reached = np.linalg.norm(pose_difference(targets[rows], damped.transforms) * weights, axis=1)
        better = reached <= left[rows] + ROUNDING
        q[rows[better]] = damped.q[better]
        rows = rows[~better]
        if not rows.size:
            break
    return poses.robot.at(q)


def _damped(poses: Poses, limited: Mask, targets: Array, eta: float) -> Poses:
    """Return nearest poses by the method of Levenberg and Marquardt; those that are limited stay within the limits.

    A step that would break a limit is shortened, not turned along it. Drives are measured by the greatest derivatives
    so far (J. J. Moré, The Levenberg-Marquardt algorithm, 1978).
    """
    robot, scales, weights = poses.robot, command_scales(poses), tip_weights(eta, poses.robot.tool_motions)
    drives = np.arange(len(scales))
    q, commands, damping = np.array(poses.q), np.array(poses.commands), np.full(len(poses), _DAMPING)
    error, control = pose_difference(targets, poses.transforms) * weights, weighted_control(poses, eta)
    sizes, rows = np.zeros_like(commands), np.arange(len(poses))
    for _ in range(_DAMPED_STEPS):
        own, before = control[rows], np.sum(error[rows] ** 2, axis=1)
        normal, slope = np.swapaxes(own, 1, 2) @ own, np.einsum("nij,ni->nj", own, error[rows])
        sizes[rows] = np.maximum(sizes[rows], np.einsum("nii->ni", normal))
        largest = sizes[rows].max(axis=1, keepdims=True)
        raised = damping[rows, None] * (sizes[rows] + SOLVED * np.where(largest > 0.0, largest, 1.0))
        normal[:, drives, drives] += raised
        move = -np.linalg.solve(normal, slope[:, :, None])[:, :, 0]
        tried = robot.forward(commands[rows] + scales * move, guess=q[rows], on_failure="nan")
        there = pose_difference(targets[rows], tried.transforms) * weights
        gained = before - np.sum(there**2, axis=1)
        taken = tried.solved & (tried.within_limits | ~limited[rows]) & (gained > 0.0)
        expected = np.sum(move * (raised * move - slope), axis=1)
        good = taken & (gained > _AS_EXPECTED * expected)
        now = rows[taken]
        q[now], error[now], commands[now] = tried.q[taken], there[taken], commands[now] + (scales * move)[taken]
        changed = damping[rows] * np.where(good, _LESS, np.where(taken, 1.0, _MORE))
        damping[rows] = np.maximum(changed, _LEAST_DAMPING)
        if now.size:
            control[now] = weighted_control(tried[taken], eta)
        rows = rows[expected > 2.0 * _NEGLIGIBLE * np.sqrt(before)]
        if not rows.size:
            break
    return robot.at(q)


def descend(
    poses: Poses,
    commands: Array,
    step: Callable[[Poses], Array],
    residuals: Callable[[Poses], Array],
    *,
    on_failure: OnFailure = "raise",
) -> tuple[Array, Poses]:
    """Take Gauss-Newton steps in the commands; shorten or skip a step that increases the error, as near singularities.

    `step` is the first change of the commands of `poses`, `residuals` the function to be minimised, shape=(n,
    anything). A step after which the loops do not close is an error, or for "nan" one that increases the error. Returns
    the change of the commands, and the poses there.

    Raises:
        UnreachablePoseError: the loops do not close after a step, and `on_failure` is "raise".
    """
    deviations, left = np.zeros_like(commands), np.linalg.norm(residuals(poses), axis=1)
    turning = [command.unit == "rad" for command in poses.robot.commands]
    for _ in range(_STEPS):
        move, q, closed = step(poses), np.array(poses.q), np.ones(len(commands), dtype=bool)
        turns = np.abs(move / command_scales(poses)).max(axis=1, initial=0.0, where=turning)
        move /= np.maximum(1.0, turns / _FARTHEST_TURN)[:, None]
        rows = np.arange(len(commands))
        for factor in (1.0, *_SHORTER):
            move[rows] *= factor
            tried = (commands + deviations + move)[rows]
            reached = poses.robot.forward(tried, guess=poses.q[rows], on_failure=on_failure)
            closed[rows] = reached.solved
            q[rows] = np.where(reached.solved[:, None], reached.q, poses.q[rows])
            trial = reached if len(rows) == len(q) and closed.all() else poses.robot.at(q)
            found = np.where(closed, np.linalg.norm(residuals(trial), axis=1), np.inf)
            rows = np.flatnonzero(found > left + ROUNDING)
            if not rows.size:
                break
        poses, left, deviations = trial, np.where(closed, found, left), deviations + move
    return deviations, poses
