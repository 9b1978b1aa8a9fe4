"""Commands that bring a robot nearest to a desired pose, in the tip-weighted sense.

With fewer drives than the pose has degrees of freedom, no commands reach the full pose; those that minimise
|translation|^2 + eta^2 |rotation|^2 are taken. The remainder cannot be corrected by commands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache

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


def command_jacobians(poses: Poses) -> Array:
    """Return the tool's motion by the commands, shape=(n, 6, number of commands)."""
    return sensitivities(_no_errors(poses.robot.prototype), poses, engine=poses.robot.engine).commands


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

    Raises:
        UnreachablePoseError: see :func:`descend`.
    """

    def residuals(poses: Poses) -> Array:
        return pose_difference(targets, poses.transforms) * tip_weights(eta, poses.robot.tool_motions)

    scales = command_scales(poses)

    def step(poses: Poses) -> Array:
        difference = pose_difference(targets, poses.transforms)
        return scales * best_commands(command_jacobians(poses) * scales, difference, eta, poses.robot.tool_motions)

    return descend(poses, poses.commands, step, residuals, on_failure=on_failure)[1]


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
