"""Repeatability from repeated poses; accuracy and repeatability as in ISO 9283."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.special

from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.linearisation import tool_motions_by_drives
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.errors.pose_error import tip_weights
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.typing import Array, Indices

_LEAST_VISITS = 3  # of a pose, for a row in the table
_SURE = 1e-3  # probability of reporting drift or hysteresis if there is none


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Scatter of repeated visits."""

    #: tip error relative to the machine's own mean, without the measurements' noise, root mean square [m]
    tip_sigma: float
    freedom: int  #: repeated visits, without the first of each pose
    poses: Indices  #: numbers of the poses visited three times or more, shape=(k,)
    visits: Indices  #: number of visits of each, shape=(k,)
    accuracy: Array  #: AP of each, distance of the mean position from the commanded one, shape=(k,) [m]
    #: RP of each, mean distance from that mean plus three standard deviations of it, shape=(k,) [m]
    repeatability: Array

    @classmethod
    def of(cls, calibration: Calibration) -> Repeatability | None:
        """Compute the repeatability of a machine; None if no pose was visited twice.

        Identified drift and hysteresis are removed for the scatter, but not for the table.
        """
        found, eta = calibration.identification, calibration.options.eta
        measured, settled = found.measurements[found.trusted], found.settled[found.trusted]
        visits = settled.visits
        numbers = visits.pose_numbers
        counts = np.bincount(numbers)
        if counts.max(initial=0) < 2:
            return None
        nominal = calibration.compensation.errors.robot.forward(visits.commands)
        seen, raw = seen_errors(settled, nominal, eta), seen_errors(measured, nominal, eta).errors
        means = np.array([seen.errors[numbers == k].mean(axis=0) for k in range(len(counts))])
        freedom = int(np.sum(counts - 1))
        scatter = float(np.sum((seen.errors - means[numbers]) ** 2)) / freedom
        noise = float(np.mean(np.einsum("nii->n", seen.covariances)))
        often = np.flatnonzero(counts >= _LEAST_VISITS)
        accuracy, spread = [], []
        for pose in often:
            positions = raw[numbers == pose][:, :3]
            distances = np.linalg.norm(positions - positions.mean(axis=0), axis=1)
            accuracy.append(float(np.linalg.norm(positions.mean(axis=0))))
            spread.append(float(distances.mean() + 3.0 * distances.std(ddof=1)))
        tip_sigma = float(np.sqrt(max(0.0, scatter - noise)))
        return cls(tip_sigma, freedom, often, counts[often], np.array(accuracy), np.array(spread))


@dataclass(frozen=True)
class Systematic:
    """Drift or hysteresis."""

    kind: str  #: "drift" or "hysteresis"
    tip: float  #: tool motion due to it, tip-weighted, root mean square over the measured poses [m]
    tip_sigma: float  #: standard deviation of that by the parameters' covariance [m]
    sure: bool  #: whether it is significant

    @classmethod
    def all_of(cls, calibration: Calibration) -> list[Systematic]:
        """Return the effects found from times and directions of approach; none without such data."""
        found = calibration.identification
        drives, weights = tool_motions_by_drives(found.poses), tip_weights(calibration.options.eta)
        answers = []
        for kind in ("drift", "hysteresis"):
            columns = found.nuisances.columns(kind)
            if not columns.size:
                continue
            values = found.nuisance_values[columns]
            covariance = found.nuisance_covariance(kind)
            base = datum_motions(found.poses)[:, :, : 6 if kind == "drift" else 0]
            effects = np.concatenate([base, drives], axis=2) * weights[:, None]
            tip = float(np.sqrt(np.mean(np.sum((effects @ values) ** 2, axis=1))))
            sigma = float(np.sqrt(np.mean(np.einsum("nij,jk,nik->n", effects, covariance, effects))))
            # information gained beyond the prior, for as many parameters as were determined
            scales = (found.nuisances.scales * found.nuisances.sigmas)[columns]
            gained = np.linalg.pinv(covariance) - np.diag(scales**-2.0)
            determined = max(1.0, len(columns) - float(np.sum(np.diag(covariance) / scales**2)))
            statistic = float(values @ gained @ values)
            sure = bool(scipy.special.gammaincc(0.5 * determined, 0.5 * max(statistic, 0.0)) < _SURE)
            answers.append(cls(kind, tip, sigma, sure))
        return answers
