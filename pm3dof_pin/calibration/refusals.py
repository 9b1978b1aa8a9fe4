"""Why a calibration is refused, or doubted: it would not be true of the machine, or would make it worse."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from pm3dof_pin.calibration.fit import Fit, Options, fit, roughly
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import ROUGHLY, Identification, identify
from pm3dof_pin.calibration.linearisation import UNKNOWN
from pm3dof_pin.calibration.mistakes import Mistake, changes_in_the_middle, usual_mistakes
from pm3dof_pin.calibration.prior import PRIOR
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.calibration.sag import sag_in_words
from pm3dof_pin.calibration.scatter import COVERAGE
from pm3dof_pin.calibration.ties import noticed_differences
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.exceptions import PM3DofError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array

STRAIN = 2.0
"""Identified parameters beyond this, root mean square in units of their prior standard deviations, do not belong to a
machine within the given tolerances."""

_LOUD = 3.0  # noise factor
_NOISY = 1.5  # the same, from which a change in the middle is searched for
_BY_CHANCE = 3.0  # sigmas
_COARSE = 3.0  # sigmas of a position: coarser rounding adds to the noise
_SAME_DIGIT = 1e-6
_SURELY = 1.0  # standard deviations by which corrected commands must be worse
_QUIET = 0.3  # fraction of the noise
_ENOUGH = 10.0  # degrees of freedom in the residuals, needed to tell
_MANY_OUTLIERS = 0.4  # fraction of the rows
_MISPLACED = 8.0  # standard deviations of a target or tool point
_EXACT = 1e-10  # [m]
_OTHER = 6.0  # tolerances
_POSES = 50  # number of poses for judging tolerances
_EXPLAINS = 0.5  # fraction of the misfit, and of what is far from the description, that a mistake may leave
_OWN = 1.5  # times the possible error of a machine: up to here it needs no mistake
_HALF = 0.5  # of the noise factor, that a change in the middle may leave
_ALIKE = 1.5  # times the misfit left by another mistake: not distinguishable from it
_MAX_FITS = 8  # mistakes tried by a fit
_MAX_ROWS = 300  # examined
_FEW_ROWS = 20  # examined first
_BESIDE = 3.0  # widths of a drive's range
_MAX_REACHED = 0.9  # fraction of the commands


def doubts(calibration: Fit, measurements: Measurements) -> Iterator[str]:
    """Yield what is doubtful about a calibration that is not refused: noise, ties, parts far from the description."""
    found, eta = calibration.identification, calibration.options.eta
    noise = _noise_in_words(calibration)
    noisy = found.noise_factor >= _NOISY
    sag = _sag(calibration) if noisy else ""
    change = _change_in_the_middle(calibration) if noisy and not sag else ""
    if noisy:
        others = (
            f"{_rounded(found.measurements)}effects that the parameters do not describe, rows of another state of the "
            "machine, or sigmas that are too small"
        )
        cause = sag or (f"most likely {change}" if change else others)
        yield f"residuals are {found.noise_factor:.3g} times the noise: {cause}"
    elif noise:
        yield noise
    compensation = calibration.compensation
    if compensation.values is None:
        return
    errors = compensation.errors
    if noticed := noticed_differences(calibration):
        units = dict(zip(errors.names, errors.units, strict=True))
        words = ", ".join(f"{name} by {1e6 * most:.2g} µ{units[name]}" for name, most in noticed.items())
        yield (
            f"bounds are too small if tied parts differ by more than a little, as a standard deviation {words}: list "
            "such parts under `classes` too"
        )
    parts = [
        f"{name} ({1e3 * value:.3g} m{parameter.unit}, {abs(value) / parameter.tolerance:.0f} tolerances)"
        for name, value, parameter in zip(errors.names, compensation.values, errors.parameters, strict=True)
        if abs(value) > _OTHER * parameter.tolerance
    ]
    if parts:
        cause = "most likely that change" if change else likely_cause(measurements, errors, eta, found)
        cause = cause or "none of the usual mistakes explains it"
        yield f"far from the description: {', '.join(parts)}. Another part, or a mistake? {cause[0].upper()}{cause[1:]}"


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
    if calibration.options.identifies and held_out is None and (problem := _too_few(found)):
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
    left = _left_over(calibration)
    prior = found.prior.k if np.isfinite(found.prior.k) else PRIOR
    expected = _possible_error(errors, found.measurements, calibration.options.eta, max(prior, 1.0))
    if left > expected:
        reasons.append(
            f"the residuals left by the parameters, {1e3 * left:.3g} mm (median), are larger than the machine could be "
            f"off, {1e3 * expected:.3g} mm; noise factor {found.noise_factor:.3g}"
        )
    elif _tolerances_off(found, found.prior.sigmas) > STRAIN:
        reasons.append(
            f"the best-fitting parameters are {_tolerances_off(found):.3g} tolerances (root mean square) from the "
            f"description: {_sag(calibration) or 'another machine, or another frame'}"
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
        before, after = np.sqrt(np.mean(held_out.whole**2, axis=1)).tolist()
        if after**2 - before**2 >= _SURELY * held_out.chance:
            noise = _noise_in_words(calibration)
            noise = f"; {noise}" if noise and not any(noise in reason for reason in reasons) else ""
            reasons.append(
                "on held-out poses the corrected commands are no better than uncorrected ones: "
                f"{1e6 * after:.1f} µm after, {1e6 * before:.1f} µm before{noise}"
            )
    return reasons


def _too_few(found: Identification) -> str:
    """Say that the measurements are too few to contradict what is identified from them; "" if they are not.

    With poses held out in turn it does not matter: they contradict it, and tolerances hold what no row tells.
    """
    measured = found.measurements
    rows = np.unique(np.column_stack([measured.pose_numbers, measured.observation_numbers]), axis=0, return_index=True)[
        1
    ]
    equations = int(measured.seen[rows].sum())
    determined = found.identifiability.identified + int(np.sum(found.nuisances.sigmas >= UNKNOWN))
    if equations > determined:
        return ""
    unknowns = found.rows.shape[2]
    counts = f"{len(measured)} rows give {equations} equations for {unknowns} unknowns and determine {determined}"
    return (
        f"{counts}: no redundancy remains to check the result; measure more poses (calibration-plan --poses), or "
        "identify fewer parameters (error-parameters --preset)"
    )


def _left_over(calibration: Fit) -> float:
    """Return the tip error beyond noise that the identified parameters leave, median over the visits [m].

    Noise is taken off along each principal axis, so that a direction that is hardly seen, such as a camera's depth,
    does not count.
    """
    found = calibration.identification
    seen = seen_errors(found.settled, found.poses[found.settled.first_rows], calibration.options.eta)
    finite = np.asarray(np.isfinite(seen.errors).all(axis=1))
    variances, axes = np.linalg.eigh(seen.covariances[finite])
    along = np.abs(np.einsum("nij,ni->nj", axes, seen.errors[finite]))
    sizes = np.full(len(finite), np.inf)
    sizes[finite] = np.linalg.norm(np.maximum(along - _BY_CHANCE * np.sqrt(variances.clip(min=0.0)), 0.0), axis=1)
    return float(np.median(sizes))


def _sag(calibration: Fit) -> str:
    """Say how far the bodies' weight moves the tool at the measured poses, see :func:`sag_in_words`."""
    errors, eta = calibration.compensation.errors, calibration.options.eta
    return sag_in_words(errors, errors.robot.forward(calibration.measurements.visits.commands[:_POSES]), eta)


def _tolerances_off(found: Identification, each: Array | float = 1.0) -> float:
    """Return how far the parameters are from the description, in so many tolerances of each, shape=(parameters,).

    Root mean square over the combinations that the measurements determine.
    """
    scaled = found.values / (each * found.errors.tolerances)
    determined = len(scaled) - float(np.sum(found.shrinkage**2))
    return float(np.sqrt(np.sum(scaled**2) / max(determined, 1.0)))


def likely_cause(
    measurements: Measurements,
    errors: GeometricErrors,
    eta: float = TIP_LENGTH,
    machine: Identification | None = None,
) -> str:
    """Name the mistake that explains why measurements do not fit a machine; "" if no usual one does.

    A mistake is named only if the measurements corrected for it fit the machine to their noise, with parameters within
    their tolerances and rows to spare; and if a `machine` identified from them as they are fits them as well, only if
    its parameters are much farther from the description: it may be a bad machine. Of several, the one that brings the
    machine as described nearest to the measurements is named first, then those as near: if the platform never turns,
    another tool point is equivalent to another frame.
    """
    try:
        measurements, nominal = _reached(measurements[:_MAX_ROWS], errors.robot)
        before, possible = _misfit(measurements, nominal, eta), _possible_error(errors, measurements, eta, 1.0)
    except PM3DofError:
        return ""
    if before < _OWN * possible:
        return ""
    found: list[tuple[float, float, Mistake]] = []
    every = np.arange(len(measurements))
    some = every[:: max(1, len(every) // _FEW_ROWS)]
    for mistake in usual_mistakes(measurements, nominal, eta):
        try:
            for rows in (some, every) if len(some) < len(every) else (every,):
                after = _misfit(*_reached(mistake.corrected[rows], errors.robot, nominal[rows]), eta)
                if after > before:
                    break
        except (PM3DofError, np.linalg.LinAlgError):
            continue
        if after < _EXPLAINS * before:
            found.append((max(after, _OWN * possible), after, mistake))
    found = sorted(found, key=lambda pair: pair[0])[:_MAX_FITS]
    farthest = np.inf if machine is None or machine.noise_factor > _LOUD else _EXPLAINS * _tolerances_off(machine)
    fitting = [(rest, after, mistake.text) for rest, after, mistake in found if _fits(mistake, errors, eta, farthest)]
    if not fitting:
        return ""
    least, after, first = fitting[0]
    others = [text for rest, _, text in fitting[1:] if rest <= _ALIKE * least and not text.startswith(first)]
    return (
        f"most likely {', or '.join([first, *others[:1]])}; that explains all but {1e3 * after:.3g} mm of "
        f"{1e3 * before:.3g} mm"
    )


def _fits(mistake: Mistake, errors: GeometricErrors, eta: float, farthest: float) -> bool:
    """Tell whether a machine within its tolerances, and no `farthest`, fits corrected measurements to their noise."""
    try:
        measurements, options = _reached(mistake.corrected, errors.robot)[0], Options("lm", eta=eta)
        first = roughly(measurements, errors, options)
        if first.noise_factor > 2.0 * _LOUD:
            return False
        found = fit(measurements, errors, options, first=first, quiet=True)
        if mistake.again is not None:
            again = mistake.again(found.identification.measurements, found.identification.poses)
            found = fit(again, errors, options, quiet=True)
        is_near = _tolerances_off(found.identification) <= farthest
        return found.identification.noise_factor < _LOUD and is_near and not refusals(found, None)
    except (PM3DofError, np.linalg.LinAlgError):
        return False


def _change_in_the_middle(calibration: Fit) -> str:
    """Say from which line on the measurements are of another set-up; "" if that does not explain their noise.

    A machine identified from all of them lies between the two set-ups. Two changes that explain it alike are both
    named: if the platform never turns, the instrument may have moved, or the point seen.
    """
    found, options, fitting = calibration.identification, calibration.options, list[tuple[float, str]]()
    shown, poses = found.settled[found.trusted], found.poses[found.trusted]
    for mistake in changes_in_the_middle(shown, poses, options.eta):
        corrected = replace(mistake.corrected, lines=shown.lines)
        again = identify(corrected, found.errors, prior=found.prior.k, loss=options.loss, precision=ROUGHLY)
        if again.noise_factor < _HALF * found.noise_factor:
            fitting.append((again.noise_factor, mistake.text))
    least = min((noise for noise, _ in fitting), default=0.0)
    return ", or ".join(text for noise, text in sorted(fitting) if noise <= _ALIKE * least)


def _reached(measurements: Measurements, robot: Robot, guess: Poses | None = None) -> tuple[Measurements, Poses]:
    """Return the rows whose commands the robot as described can reach, and its poses there.

    Raises:
        UnreachablePoseError: too few such rows, or commands far outside the drives' ranges, which take long to reach.
    """
    lower, upper = np.array([robot.range_of(command) for command in robot.command_coordinates]).T
    beyond = np.maximum(lower - measurements.commands, measurements.commands - upper) > _BESIDE * (upper - lower)
    if np.mean(beyond.any(axis=1)) <= 1.0 - _MAX_REACHED:
        near = measurements[~beyond.any(axis=1)]
        if guess is not None and len(near) == len(guess) and np.array_equal(near.commands, guess.commands):
            return near, guess
        nominal = robot.forward(near.commands, on_failure="nan")
        if np.mean(nominal.solved) >= _MAX_REACHED:
            return near[nominal.solved], nominal[nominal.solved]
    raise UnreachablePoseError("the commands are out of reach")


def _misfit(measurements: Measurements, nominal: Poses, eta: float) -> float:
    """Return the tip error of the machine as described against the measurements, 75th percentile over the rows [m].

    Not the median: a mistake may affect less than half of the rows.
    """
    if measurements.registration is not None:
        measurements = measurements.in_axes(measurements.registered_at(nominal, eta))
    return float(np.quantile(measurements.tip_misfits(nominal, eta), 0.75))


def _possible_error(errors: GeometricErrors, measurements: Measurements, eta: float, prior: float) -> float:
    """Return the tip error of a machine this many tolerances off, median over measured poses [m]."""
    sample = errors.robot.forward(measurements.visits.commands[:_POSES])
    return prior * float(np.median(error_map(errors, sample, eta=eta).tip_rms))
