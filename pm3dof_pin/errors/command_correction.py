"""Commands that bring a robot nearest to where it is wanted, in the tip-weighted sense.

With fewer drives than a pose has degrees of freedom no commands give the whole pose: the ones taken make
|translation|^2 + eta^2 |rotation|^2 least. What is left is what no command corrects.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array, Mask, OnFailure

CONTROL_TOLERANCE = 1e-9
"""Singular value of the tool's motions by the commands, beside the greatest, below which they move it no further."""

_SOUND = 1e6  # condition of normal equations, the square of that of a control matrix
_STEPS = 3  # each leaves about a thousandth of the error
_SHORTER = (0.25, 0.25, 0.25, 0.0)  # what a step that leads away is multiplied by, one trial after the other
_ROUNDING = 1e-12  # [m]
_FARTHEST_TURN = np.pi  # of a drive in one step [rad]: beyond half a turn it comes back, and no derivative tells where


def command_jacobians(poses: Poses) -> Array:
    """Return how commands move the tool, shape=(n, 6, number of commands)."""
    return sensitivities(GeometricErrors(poses.robot, ()), poses).commands


def command_scales(poses: Poses) -> Array:
    """Return counter units per unit of each drive's joint, shape=(number of commands,).

    What is judged by size, as which directions are seen, is judged in the joints' units: a counter may have any.
    """
    return np.array([command.scale for command in poses.robot.commands])


def weighted_control(poses: Poses, eta: float = TIP_LENGTH) -> Array:
    """Return the tip-weighted motion of the tool by the drives' joints, shape=(n, 6, number of commands) [m]."""
    return np.asarray(command_jacobians(poses) * command_scales(poses) * tip_weights(eta)[:, None])


def best_commands(commands: ArrayLike, differences: ArrayLike, eta: float = TIP_LENGTH) -> Array:
    """Return the change of commands that undoes most of small pose errors, shape=(n, 6) [m, rad].

    The commands move the tool by shape=(n, 6, number of commands); eta weighs the orientation [m/rad].
    """
    weights = tip_weights(eta)
    control = np.asarray(commands, dtype=float) * weights[:, None]
    weighted = np.asarray(differences, dtype=float) * weights
    change, sound = _normal_solution(control, weighted)
    if not sound.all():
        inverse = np.linalg.pinv(control[~sound], rcond=CONTROL_TOLERANCE)
        change[~sound] = np.einsum("nij,nj->ni", inverse, weighted[~sound])
    return -change


def _normal_solution(control: Array, targets: Array) -> tuple[Array, Mask]:
    """Solve least squares by the normal equations, quicker than by a pseudo-inverse, and say where that is sound."""
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
    """Return the poses of a robot that come nearest to target transforms, tip-weighted, from poses near to them.

    Raises:
        UnreachablePoseError: see :func:`descend`.
    """

    def residuals(poses: Poses) -> Array:
        return pose_difference(targets, poses.transforms) * tip_weights(eta)

    scales = command_scales(poses)

    def step(poses: Poses) -> Array:
        difference = pose_difference(targets, poses.transforms)
        return scales * best_commands(command_jacobians(poses) * scales, difference, eta)

    return descend(poses, poses.commands, step, residuals, on_failure=on_failure)[1]


def descend(
    poses: Poses,
    commands: Array,
    step: Callable[[Poses], Array],
    residuals: Callable[[Poses], Array],
    *,
    on_failure: OnFailure = "raise",
) -> tuple[Array, Poses]:
    """Take Gauss-Newton steps in the commands; where one leads away, as near a singularity, a shorter one or none.

    `step` is the first change of the commands of `poses`, `residuals` what is to become small, shape=(n, anything). A
    step after which the loops do not close is an error, or ("nan") one that leads away. Returns the change of the
    commands, and the poses there.

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
            rows = np.flatnonzero(found > left + _ROUNDING)
            if not rows.size:
                break
        poses, left, deviations = trial, np.where(closed, found, left), deviations + move
    return deviations, poses
