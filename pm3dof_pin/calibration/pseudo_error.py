"""The pseudo-error source: all errors of a machine as deviations of its commands, Fig. 8.5 of the chapter.

At command u the machine stands where a model of it stands at u + du. du is found by inverting the model's kinematics at
the pose measured, as far as the measurements show it (:mod:`pm3dof_pin.errors.command_correction`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.errors.command_correction import command_jacobians, command_scales, descend
from pm3dof_pin.errors.pose_error import TIP_LENGTH, tip_weights
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array

SEEN = 0.02
"""Directions with a relative gain below this are treated as unobservable: deviations along them stay 0. On the tripod
positions of the tool point alone show its height only; both tilts turn it on the spot. Near a singular pose an arm has
such directions even where whole poses are measured."""


@dataclass(frozen=True, eq=False)
class PseudoErrors:
    """Pseudo-errors found from measurements against a model of the machine.

    Attributes:
        deviations: du, shape=(n, number of commands) [m, rad].
        covariances: of du, from the measurements' noise, shape=(n, number of commands, same).
        before: tip-weighted residuals of the model at the commands, shape=(n, 3 or 6) [m].
        left: those at the deviated commands: what no command corrects, shape=(n, 3 or 6) [m].
        control: tip-weighted motion of what is seen by the drives' joints, shape=(n, 3 or 6, number of commands).
    """

    deviations: Array
    covariances: Array
    before: Array
    left: Array
    control: Array


def control_inverse(control: Array, seen: float = SEEN) -> Array:
    """Return the pseudo-inverse of tip-weighted motions by the drives' joints, without unobservable directions.

    Args:
        control: shape=(n, 3 or 6, number of commands).
        seen: see :data:`SEEN`.
    """
    return np.asarray(np.linalg.pinv(control, rcond=seen))


def pseudo_errors(
    measurements: Measurements, model: Poses, eta: float = TIP_LENGTH, *, seen: float = SEEN
) -> PseudoErrors:
    """Find the deviations of the commands that explain measurements, by inverting a model's kinematics.

    Args:
        measurements: poses, positions or points.
        model: poses of the model, nominal or calibrated, at the commands of the measurements.
        eta: weight of the orientation [m/rad].
        seen: see :data:`SEEN`.

    Raises:
        UnreachablePoseError: no commands bring the model there.
        SingularConfigurationError: at a command the tool can move while all drives stand still.
    """
    weights = tip_weights(eta)[: measurements.sigmas.shape[1]]
    scales = command_scales(model)

    def residuals(poses: Poses) -> Array:
        return np.asarray(measurements.residuals(poses) * weights)

    def control(poses: Poses) -> Array:
        return np.asarray(measurements.derivatives(poses, command_jacobians(poses) * scales) * weights[:, None])

    def step(poses: Poses) -> Array:
        return np.asarray(scales * np.einsum("nij,nj->ni", control_inverse(control(poses), seen), residuals(poses)))

    deviations, poses = descend(model, measurements.commands, step, residuals)
    reached = control(poses)
    spread = scales[:, None] * control_inverse(reached, seen) * (weights * measurements.sigmas)[:, None, :]
    return PseudoErrors(deviations, spread @ np.swapaxes(spread, 1, 2), residuals(model), residuals(poses), reached)
