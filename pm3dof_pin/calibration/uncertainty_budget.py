"""Uncertainty budget of a calibrated machine: the contribution of each source to the variance of the tip.

With the information I on all parameters, the prior information L and C = (I + L)^-1, the covariance is C I C, due to
the instrument's noise, plus C L C, due to what was not measured. The contribution of an unknown frame and of unknown
targets is the difference to a fit in which they are known.
"""

from __future__ import annotations

import numpy as np

from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.repeatability import Repeatability
from pm3dof_pin.errors.command_correction import command_jacobians, nearest_poses
from pm3dof_pin.errors.pose_error import pose_difference, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.typing import Array, Mask


def uncertainty_budget(calibration: Calibration, poses: Poses) -> dict[str, float]:
    """Return each source's contribution to the corrected machine's tip error, root mean square over desired poses [m].

    "floor": what no command corrects, as far as it is known; "instrument"; "frame"; "targets": their positions, with
    drift and hysteresis; "parameters": unobserved ones; "learned"; "unmodelled"; "repeatability". The squares sum up to
    the square of the expected tip error.
    """
    compensation, found = calibration.compensation, calibration.identification
    weights = tip_weights(compensation.eta)
    conditions = {} if compensation.learned is None else compensation.learned.inputs.middle()
    model = compensation.model_poses(poses)
    parts = dict.fromkeys(("floor", "instrument", "frame", "targets", "parameters", "learned"), 0.0)
    if compensation.values is not None:
        nearest = nearest_poses(model, poses.transforms, compensation.eta, on_failure="nan")
        left = pose_difference(poses.transforms, nearest.transforms) * weights
        parts["floor"] = float(np.mean(np.sum(left**2, axis=1)))
        motions = np.concatenate(
            [sensitivities(found.errors, model, found.values).errors, datum_motions(model)], axis=2
        )
        effects = (motions * weights[:, None]).reshape(-1, motions.shape[2])
        square = effects.T @ effects / len(poses)
        parts |= _of_parameters(calibration, square)
        left_out = np.zeros(motions.shape[2])
        left_out[: len(found.values)] = found.values - compensation.values
        parts["parameters"] += float(left_out @ square @ left_out)
    if compensation.learned is not None:
        control = command_jacobians(model) * weights[:, None]
        spread = compensation.learned.uncertainties(model.commands, conditions)
        parts["learned"] = float(np.mean(np.sum((control * spread[:, None, :]) ** 2, axis=(1, 2))))
    repeated = Repeatability.of(calibration)
    scatter = compensation.scatter.tip_error**2
    parts["repeatability"] = 0.0 if repeated is None else min(scatter, repeated.tip_sigma**2)
    parts["unmodelled"] = scatter - parts["repeatability"]
    return {name: float(np.sqrt(max(value, 0.0))) for name, value in parts.items()}


def _of_parameters(calibration: Calibration, square: Array) -> dict[str, float]:
    """Return variances [m^2], given the mean square of the tip's motions by parameters, base and tool."""
    found, count = calibration.identification, len(calibration.identification.errors)
    machine = found.rows.shape[2] - len(found.nuisances)
    scaled = np.sqrt(found.certainties)[:, :, None] * found.rows
    matrix = scaled.reshape(-1, scaled.shape[2])
    units = np.concatenate([found.errors.tolerances, np.ones(machine - count), found.nuisances.scales])
    before = np.concatenate([np.full(count, found.prior), np.ones(machine - count), found.nuisances.sigmas])
    datum = found.seen_map

    def variances(known: Mask) -> tuple[float, float]:
        """Return the tip variances due to noise and to missing information, given that some parameters are known."""
        free = np.flatnonzero(~known)
        information, knowledge = matrix[:, free].T @ matrix[:, free], np.diag(before[free] ** -2.0)
        covariance = np.linalg.pinv(information + knowledge)
        knowledge[free < count] *= (1.0 + found.prior_error) ** 2
        effects = datum[:, free] * units[free]
        tip = effects.T @ square @ effects
        noise, ignorance = (float(np.trace(tip @ covariance @ part @ covariance)) for part in (information, knowledge))
        return noise, ignorance

    columns = np.arange(found.rows.shape[2])
    frame = machine + found.nuisances.columns("frame")
    noise, ignorance = variances(columns >= machine)
    with_frame = sum(variances((columns >= machine) & ~np.isin(columns, frame)))
    total = sum(variances(columns < 0))
    return {
        "instrument": noise,
        "parameters": ignorance,
        "frame": max(0.0, with_frame - noise - ignorance),
        "targets": max(0.0, total - with_frame),
    }
