"""What speaks against a calibration: that it would not be true of the machine, or would make it worse."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.causes import likely_cause
from pm3dof_pin.calibration.identification import PRIOR
from pm3dof_pin.calibration.judging import HeldOut
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import CalibrationRefusedError, PM3DofError
from pm3dof_pin.measuring.measurements import Measurements

STRAIN = 2.0
"""Identified parameters beyond this, root mean square in units of their standard deviations before the measurements,
are not those of a machine that the tolerances are about."""

_POSES = 50  # at which tolerances are judged


def objections(calibration: Calibration, held_out: HeldOut | None) -> list[str]:
    """Return what speaks against a calibration, a sentence each; nothing if nothing does.

    Args:
        calibration: the calibration.
        held_out: how good it is on measurements it was not shown; None if that is not known.
    """
    found, errors = calibration.identification, calibration.compensation.errors
    reasons = []
    poses = int(found.measurements.pose_numbers.max()) + 1
    if poses < 2:
        reasons.append("one pose is measured, which says nothing of others")
    unknowns, equations = found.rows.shape[2], int(found.measurements.seen.sum())
    if calibration.options.identifies and equations < unknowns:
        reasons.append(f"{len(found.measurements)} rows give {equations} equations for {unknowns} unknowns")
    left = _misfit(calibration)
    prior = found.prior if np.isfinite(found.prior) else PRIOR
    expected = _possible_error(errors, found.measurements, calibration.options.eta, prior)
    if left > expected:
        reasons.append(
            f"what the parameters leave of the measurements, {1e3 * left:.3g} mm (median), is more than the machine "
            f"could be off, {1e3 * expected:.3g} mm; noise factor {found.noise_factor:.3g}"
        )
    elif (size := strain(calibration)) > STRAIN:
        reasons.append(
            f"the parameters that fit best are {size * prior:.3g} tolerances (root mean square) from the description: "
            "another machine, or another frame"
        )
    if held_out is not None:
        before, after = (float(np.sqrt(np.mean(values**2))) for values in (held_out.before, held_out.after))
        if after >= before:
            reasons.append(
                f"on poses it was not shown the corrected commands do not improve on none: {1e6 * after:.1f} µm after, "
                f"{1e6 * before:.1f} µm before"
            )
    return reasons


def _misfit(calibration: Calibration) -> float:
    """Return the tip error that the identified parameters leave of the measurements, median over the visits [m]."""
    found = calibration.identification
    _, first = np.unique(found.settled.visit_numbers, return_index=True)
    seen = seen_errors(found.settled, found.poses[first], calibration.options.eta)
    return float(np.median(np.linalg.norm(seen.errors, axis=1)))


def strain(calibration: Calibration) -> float:
    """Return how far the parameters are from the description, in units of their standard deviations beforehand.

    Root mean square over the combinations that the measurements tell.
    """
    found = calibration.identification
    if not np.isfinite(found.prior):
        return 0.0
    scaled = found.values / found.errors.tolerances / found.prior
    told = len(scaled) - float(np.sum((found.sigmas / found.errors.tolerances / found.prior) ** 2))
    return float(np.sqrt(np.sum(scaled**2) / max(told, 1.0)))


def refusal(
    reasons: list[str], measurements: Measurements, errors: GeometricErrors, eta: float
) -> CalibrationRefusedError:
    """Return the refusal of a calibration, with the likeliest cause if one of the usual mistakes explains it.

    Args:
        reasons: what speaks against it.
        measurements: as they were read.
        errors: the parameters, with their tolerances.
        eta: weight of the orientation [m/rad].
    """
    try:
        least = _possible_error(errors, measurements, eta, PRIOR)
        cause = likely_cause(measurements, errors.robot, eta, least=least)
    except PM3DofError:
        cause = None
    return CalibrationRefusedError([*reasons, *([] if cause is None else [f"most likely {cause}"])])


def _possible_error(errors: GeometricErrors, measurements: Measurements, eta: float, prior: float) -> float:
    """Return the tip error of a machine that is so many tolerances off, median over measured poses [m]."""
    sample = errors.robot.forward(measurements.visits.commands[:_POSES])
    return prior * float(np.median(error_map(errors, sample, eta=eta).tip_rms))
