"""Why a calibration is refused, or doubted: it would not be true of the machine, or would make it worse."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from pm3dof_pin.calibration.causes import change_in_the_middle, likely_cause
from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import PRIOR, Identification
from pm3dof_pin.calibration.linearisation import UNKNOWN
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.calibration.scatter import COVERAGE
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.measuring.measurements import Measurements

STRAIN = 2.0
"""Identified parameters beyond this, root mean square in units of their prior standard deviations, do not belong to a
machine within the given tolerances."""

_LOUD = 3.0  # noise factor
_NOISY = 1.5  # the same, from which a change in the middle is searched for
_COARSE = 3.0  # sigmas of a position: coarser rounding adds to the noise
_SAME_DIGIT = 1e-6
_QUIET = 0.3  # fraction of the noise
_ENOUGH = 10.0  # degrees of freedom in the residuals, needed to tell
_MANY_OUTLIERS = 0.4  # fraction of the rows
_MISPLACED = 8.0  # standard deviations of a target or tool point
_EXACT = 1e-10  # [m]
_OTHER = 6.0  # tolerances
_POSES = 50  # number of poses for judging tolerances


def doubts(calibration: Fit, measurements: Measurements) -> Iterator[str]:
    """Yield what is doubtful about a calibration that is not refused: its noise, and parts far from the description."""
    found, eta = calibration.identification, calibration.options.eta
    shown, poses = found.settled[found.trusted], found.poses[found.trusted]
    noise = _noise_in_words(calibration)
    change = change_in_the_middle(shown, poses, eta) if found.noise_factor > _NOISY else ""
    if change:
        yield f"residuals are {found.noise_factor:.3g} times the noise: most likely {change}"
    elif found.noise_factor > _LOUD:
        yield (
            f"{noise}: {_rounded(found.measurements)}effects that the parameters do not describe, rows of another "
            "state of the machine, or sigmas that are too small"
        )
    elif noise:
        yield noise
    compensation = calibration.compensation
    if compensation.values is None:
        return
    errors = compensation.errors
    parts = [
        f"{name} ({1e3 * value:.3g} m{parameter.unit}, {abs(value) / parameter.tolerance:.0f} tolerances)"
        for name, value, parameter in zip(errors.names, compensation.values, errors.parameters, strict=True)
        if abs(value) > _OTHER * parameter.tolerance
    ]
    if parts:
        cause = ["most likely that change"] if change else likeliest_cause(measurements, errors, eta, 1.0)
        cause = cause or ["none of the usual mistakes explains it"]
        yield f"far from the description: {', '.join(parts)}. Another part, or a mistake? {cause[0].capitalize()}"


def _rounded(measurements: Measurements) -> str:
    """Name the numbers that are rounded by more than the noise; "" if none are."""
    seen = measurements.sigmas[:, :3][measurements.seen[:, :3]]
    words = ""
    for name, numbers in (("commands", measurements.commands), ("positions", measurements.positions)):
        for step in 10.0 ** -np.arange(2, 6):
            digits = numbers / step
            if seen.size and step > _COARSE * np.median(seen) and np.abs(digits - np.round(digits)).max() < _SAME_DIGIT:
                words += f"{name} rounded to {1e3 * step:g} mm or mrad, "
                break
    return words


def _noise_in_words(calibration: Fit) -> str:
    """Say how much larger or smaller than the noise the residuals are; "" if about as large."""
    found = calibration.identification
    if found.noise_factor > _LOUD:
        return f"residuals are {found.noise_factor:.3g} times the noise"
    squares, expected = found.normalized_residuals[found.trusted] ** 2, found.expected_squares[found.trusted]
    groups = np.split(np.arange(squares.shape[1]), [3, found.measurements.tool_columns])
    for name, columns in zip(("positions and distances", "orientations", "encoders"), groups, strict=True):
        freedom = float(expected[:, columns].sum())
        size = float(np.sqrt(np.nansum(squares[:, columns]) / max(freedom, _ENOUGH)))
        if freedom > _ENOUGH and size < _QUIET:
            return f"residuals of {name} are {size:.2g} times the noise: their sigmas are in another unit or too large"
    return ""


def refusals(calibration: Fit, held_out: HeldOut | None) -> list[str]:
    """Return why a calibration and its cross-validation are refused, one sentence each; [] if they are not."""
    found, errors = calibration.identification, calibration.compensation.errors
    reasons = []
    poses = int(found.measurements.pose_numbers.max()) + 1
    if poses < 2:
        reasons.append("only one pose was measured, which tells nothing about others")
    if calibration.options.identifies and (problem := _too_few(found)):
        reasons.append(problem)
    if len(found.outliers) > _MANY_OUTLIERS * len(found.measurements):
        reasons.append(f"{len(found.outliers)} of {len(found.measurements)} rows are outliers relative to the others")
    off = np.abs(found.nuisance_values) / (found.nuisances.scales * found.nuisances.sigmas)
    points = np.concatenate([found.nuisances.columns("targets"), found.nuisances.columns("tool_point")])
    if points.size and off[points].max() > _MISPLACED:
        worst = points[off[points].argmax()]
        reasons.append(
            f"{found.nuisances.names[worst]} is {1e3 * found.nuisance_values[worst]:.3g} mm from where the file "
            f"has it, {off[worst]:.3g} standard deviations"
        )
    left = _misfit(calibration)
    prior = found.prior if np.isfinite(found.prior) else PRIOR
    expected = _possible_error(errors, found.measurements, calibration.options.eta, max(prior, 1.0))
    if left > expected:
        reasons.append(
            f"the residuals left by the parameters, {1e3 * left:.3g} mm (median), are larger than the machine could be "
            f"off, {1e3 * expected:.3g} mm; noise factor {found.noise_factor:.3g}"
        )
    elif (size := strain(calibration)) > STRAIN:
        reasons.append(
            f"the best-fitting parameters are {size * prior:.3g} tolerances (root mean square) from the description: "
            "another machine, or another frame"
        )
    if (chance := calibration.chance_of_harm) > 1.0 - COVERAGE:
        why = _noise_in_words(calibration) or (
            "too much of the tool's motion was not seen; measure full poses, or targets away from the tool point"
        )
        reasons.append(
            f"with {100.0 * chance:.0f} % probability the corrected commands are worse than uncorrected ones: {why}"
        )
    if not found.measurements.shows_poses:
        reasons.append(
            "no row shows the pose of the tool: encoders, or distances between two poses, cannot tell whether "
            "corrected commands are better than uncorrected ones"
        )
    elif held_out is not None and not held_out.before.max() > _EXACT:
        reasons.append("the poses match the description to the last digit: they were planned, not measured")
    elif held_out is not None:
        before, after = (float(np.sqrt(np.mean(values**2))) for values in (held_out.before, held_out.after))
        if after >= before:
            noise = _noise_in_words(calibration)
            noise = f"; {noise}" if noise and not any(noise in reason for reason in reasons) else ""
            reasons.append(
                "on held-out poses the corrected commands are no better than uncorrected ones: "
                f"{1e6 * after:.1f} µm after, {1e6 * before:.1f} µm before{noise}"
            )
    return reasons


def _too_few(found: Identification) -> str:
    """Say that the measurements are too few to contradict what is identified from them; "" if they are not."""
    measured = found.measurements
    rows = np.unique(np.column_stack([measured.pose_numbers, measured.target_numbers]), axis=0, return_index=True)[1]
    equations = int(measured.seen[rows].sum())
    determined = found.identifiability.rank + int(np.sum(found.nuisances.sigmas >= UNKNOWN))
    if equations > determined:
        return ""
    unknowns = found.rows.shape[2]
    counts = f"{len(measured)} rows give {equations} equations for {unknowns} unknowns and determine {determined}"
    return f"{counts}: no redundancy remains to check the result"


def _misfit(calibration: Fit) -> float:
    """Return the tip error that the identified parameters leave, median over the visits [m]."""
    found = calibration.identification
    seen = seen_errors(found.settled, found.poses[found.settled.first_rows], calibration.options.eta)
    return float(np.median(np.linalg.norm(seen.errors, axis=1)))


def strain(calibration: Fit) -> float:
    """Return how far the parameters are from the description, in units of their prior standard deviations.

    Root mean square over the combinations that the measurements determine.
    """
    found = calibration.identification
    if not np.isfinite(found.prior):
        return 0.0
    scaled = found.values / found.errors.tolerances / found.prior
    determined = len(scaled) - float(np.sum(found.shrinkage**2))
    return float(np.sqrt(np.sum(scaled**2) / max(determined, 1.0)))


def likeliest_cause(
    measurements: Measurements, errors: GeometricErrors, eta: float, tolerances: float = PRIOR
) -> list[str]:
    """Describe the most likely of the usual mistakes, given a machine this many tolerances off; [] for none."""
    try:
        usual = _possible_error(errors, measurements, eta, 1.0)
        cause = likely_cause(measurements, errors.robot, eta, least=tolerances * usual, alike=usual)
    except PM3DofError:
        return []
    return [] if cause is None else [f"most likely {cause}"]


def _possible_error(errors: GeometricErrors, measurements: Measurements, eta: float, prior: float) -> float:
    """Return the tip error of a machine this many tolerances off, median over measured poses [m]."""
    sample = errors.robot.forward(measurements.visits.commands[:_POSES])
    return prior * float(np.median(error_map(errors, sample, eta=eta).tip_rms))
