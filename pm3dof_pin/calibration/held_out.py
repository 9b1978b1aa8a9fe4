"""Accuracy of a calibration on measurements that it was not fitted to."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.fit import MIN_POSES, Fit, compensation_from
from pm3dof_pin.calibration.identification import ROUGHLY, Identification, identify
from pm3dof_pin.calibration.linearisation import Linearisation
from pm3dof_pin.calibration.mistakes import millimetres
from pm3dof_pin.calibration.pseudo_error import control_inverse, pseudo_errors, seen_errors
from pm3dof_pin.calibration.scatter import COVERAGE, Scatter
from pm3dof_pin.calibration.session_effects import session_conditions
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.errors.normal_vectors import norm_quantiles
from pm3dof_pin.errors.pose_error import pose_difference, tip_weights, weighted_energy
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Indices, Mask

_FOLDS = 5
_MOVED = 0.01  # [m, rad]: farther than a machine's errors move its base
_UNSEEN = 1e-9  # relative size of motions of base and tool that no measurement shows
_FLOOR_SEEN = 1e-3  # full poses show all directions, but near a singular pose a useful one can be tiny


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors of measured poses, one per visit, as far as the measurements show them, without outliers.

    Attributes:
        rows: the measurements used, shape=(n,).
        before: tip error of the machine as described, shape=(visits,) [m]. If the instrument's frame or the points seen
            were estimated, this and the next two are errors after a registration of their own each: a frame that suits
            the calibrated machine would be held against the others.
        after: tip error with the corrected commands, the measurements' noise included, shape=(visits,) [m].
        floor: tip error with the best commands, the measurements' noise included, shape=(visits,) [m].
        whole: `before` and `after` with the directions that the measurements do not show, as the model has them,
            shape=(2, visits) [m]. Commands of few drives correct the whole error, and may increase the part that is
            seen.
        noise: tip error due to the measurements' noise, root mean square, shape=(visits,) [m].
        chance: standard deviation, from the measurements' noise, of the mean of after^2 - before^2 [m^2].
        excess: expected difference between the corrected commands and the best ones, root mean square over the
            drives' joints, shape=(visits,) [m, rad]: from the uncertainty of parameters and learned parts, seen or not,
            and from the further scatter. Observing it would add more noise than there is excess. NaN for a method
            without parameters, which would tell the uncertainty, if not all motions of the drives are seen.
        excess_interval: interval of this machine's root mean square of that over the visits, with a probability of
            95 %, see :mod:`pm3dof_pin.calibration.scatter`; None for a learning method, near singular poses, and
            from the noise factor :data:`~pm3dof_pin.calibration.fit.SMOOTH` on.
        scatter: errors of the corrected machine beyond the known uncertainty.
        within: fraction of the visits, poses with outliers included, at which the remaining error is below the bound of
            :data:`COVERAGE`.
        energies: E of (8.15), E_xyz + eta E_orientation, of `before`, `after` and `floor`, shape=(3, visits) [m].
        notes: what to know about their evaluation.
    """

    rows: Indices
    before: Array
    after: Array
    floor: Array
    whole: Array
    noise: Array
    chance: float
    excess: Array
    excess_interval: tuple[float, float] | None
    scatter: Scatter
    within: float
    energies: Array
    notes: tuple[str, ...] = ()

    @classmethod
    def from_cross_validation(cls, calibration: Fit) -> HeldOut:
        """Judge a calibration by cross-validation: the same method, fitted to four fifths of the poses at a time.

        Measurements at the same commands, of several targets or repeated, are held out together. The instrument's
        frame and the targets' offsets come from the remaining measurements.

        Raises:
            InvalidValueError: too few poses.
        """
        options, errors = calibration.options, calibration.compensation.errors
        whole, rows = calibration.identification, calibration.identification.trusted
        measurements = calibration.measurements[rows]
        numbers = measurements.pose_numbers
        count = int(numbers.max(initial=-1)) + 1
        if count <= MIN_POSES:
            raise InvalidValueError(
                "measurements", problem=f"have {count} poses", expected=f"more than {MIN_POSES} for a cross-validation"
            )
        folds = np.random.default_rng(options.seed).permutation(np.arange(count) % min(_FOLDS, count))[numbers]
        parts, starts = [], []
        for fold in range(int(folds.max()) + 1):
            shown, hidden = np.flatnonzero(folds != fold), np.flatnonzero(folds == fold)
            found = identify(
                measurements[shown],
                errors,
                prior=whole.prior.k,
                prior_error=whole.prior.error,
                loss=options.loss,
                nuisances=whole.nuisances,
                start=whole,
                precision=ROUGHLY,
            )
            compensation = compensation_from(
                found.settled,
                errors,
                options,
                found if options.identifies else None,
                similar=calibration.compensation.learned,
            )
            part = measurements[hidden]
            parts.append(_scores_of(compensation, found, found.linearised(part), calibration.compensation))
            starts.append(hidden[part.first_rows])
        units = [command.unit for command in errors.robot.commands]
        scores = _Scores.joined(parts)[np.argsort(np.concatenate(starts))].with_visible_tool()
        seen = (scores.missed, scores.covariances, scores.shown, scores.control, units)
        counted = calibration.compensation.weights > 0.0
        scatter, sure = (Scatter.from_errors(*seen, counted=counted, least=least) for least in (0.0, 1.0))
        judged = _Scores.joined([scores, *_outlying(calibration)])
        scatter = scatter.with_tails(judged.missed, judged.covariances, judged.shown, judged.control)
        return replace(
            _together(calibration, rows, scores, scatter, sure), within=float(np.mean(judged.within(scatter)))
        )

    @classmethod
    def from_validation(cls, calibration: Fit, measurements: Measurements) -> HeldOut:
        """Judge a calibration by other measurements, in base axes or from an instrument with its own frame.

        The frame is the identified one, or if the instrument has clearly moved, one found from these alone.
        """
        compensation = calibration.compensation
        measurements, notes = _of_known_targets(calibration.identification, measurements)
        found = calibration.identification
        linear, moved = _of_their_own_station(calibration, found.linearised(measurements))
        scores = _scores_of(compensation, found, linear, compensation)
        scatter = compensation.scatter
        judged = _together(calibration, np.arange(len(measurements)), scores.with_visible_tool(), scatter, scatter)
        return replace(judged, notes=(*notes, *moved))


def _of_known_targets(found: Identification, measurements: Measurements) -> tuple[Measurements, tuple[str, ...]]:
    """Return measurements whose targets are those of the calibration where they are as near as these are known."""
    sigma = found.measurements.target_sigma
    known = np.unique(found.measurements.points[found.measurements.points.any(axis=1)], axis=0)
    points, notes = measurements.points.copy(), []
    for point in np.unique(points[points.any(axis=1)], axis=0) if sigma > 0.0 else ():
        place = f"target ({millimetres(point)}) mm"
        distances = np.linalg.norm(known - point, axis=1)
        nearest, distance = (int(distances.argmin()), float(distances.min())) if len(known) else (0, np.inf)
        if SAME < distance <= sigma:
            points[(points == point).all(axis=1)] = known[nearest]
            notes.append(
                f"{place} is taken for that of the calibration {1e3 * distance:.3g} mm away, as its place was known to "
                f"{1e3 * sigma:.3g} mm"
            )
        elif distance > sigma:
            notes.append(f"{place} was not measured for the calibration: it is taken to be where the file has it")
    return measurements.with_points(points), tuple(notes)


def _of_their_own_station(calibration: Fit, linear: Linearisation) -> tuple[Linearisation, tuple[str, ...]]:
    """Return linearised measurements, of an instrument that was moved in the base located by the calibrated machine."""
    if linear.measurements.registration is None or not linear.measurements.seen.all():
        return linear, ()
    compensation, settled = calibration.compensation, linear.settled
    reached = compensation.poses(compensation.errors.robot.forward(settled.commands), settled.conditions)
    found = settled.registered_at(reached, compensation.eta)
    difference = pose_difference(np.eye(4), found.base)
    if np.linalg.norm(difference[:3]) < _MOVED and np.linalg.norm(difference[3:]) < _MOVED:
        return linear, ()
    note = (
        f"the validation was measured from another station, {np.linalg.norm(difference[:3]):.3g} m away: its base is "
        "located separately, and errors common to all poses are not judged"
    )
    moved = replace(linear.measurements.in_axes(found), registration=None)
    return calibration.identification.linearised(moved), (note,)


@dataclass(frozen=True, eq=False)
class _Scores:
    """Quantities by which each visit is judged, shape=(visits, ...) each.

    Attributes:
        found: tip-weighted errors before, after and with the best commands, shape=(visits, 3, 6) [m].
        hidden: the first two in the directions that are not shown, as the model has them, shape=(visits, 2, 6) [m].
        noise: covariance of these errors, from the measurements' noise, shape=(visits, 6, 6) [m^2].
        moved: the same by motions of base and tool, shape=(visits, 6, 12).
        missed: errors of the predicted poses, tip-weighted, shape=(visits, 6) [m].
        covariances: their known covariance, shape=(visits, 6, 6) [m^2].
        shown: projections on the directions that are shown, shape=(visits, 6, 6).
        control: tip-weighted motion by the drives' joints, shape=(visits, 6, drives).
        uncertain: covariance of poses predicted by the calibration from all measurements, shape=(visits, 6, 6) [m^2].
        effects: tool motion by a standard deviation in each independent direction of the parameters, shape=(visits,
            6, directions) [m]; no directions for a learning method.
    """

    found: Array
    hidden: Array
    noise: Array
    moved: Array
    missed: Array
    covariances: Array
    shown: Array
    control: Array
    uncertain: Array
    effects: Array

    def __getitem__(self, visits: Indices | Mask) -> _Scores:
        return _Scores(*(values[visits] for values in vars(self).values()))

    @classmethod
    def joined(cls, parts: Sequence[_Scores]) -> _Scores:
        return cls(*map(np.concatenate, zip(*(vars(part).values() for part in parts), strict=True)))

    def with_visible_tool(self) -> _Scores:
        """Return the visits that show something of the tool; all of them if none does."""
        seen = np.asarray(self.shown.any(axis=(1, 2)))
        return self[seen] if seen.any() else self

    def within(self, scatter: Scatter) -> Mask:
        """Tell which visits are within the bounds that a scatter gives, shape=(visits,)."""
        scattered = scatter.tails**2 * scatter.covariances(self.control)
        spread = self.covariances + self.shown @ scattered @ self.shown
        bounds = norm_quantiles(np.zeros_like(self.missed), spread, COVERAGE)
        return np.asarray(np.linalg.norm(self.missed, axis=1) <= bounds)


def _scores_of(
    compensation: Compensation, found: Identification, linear: Linearisation, final: Compensation
) -> _Scores:
    """Score measurements that were linearised at what was found, by the compensation from that."""
    measurements = linear.settled
    if compensation.values is not None:
        measurements = compensation.without_loads(measurements)
    visits, eta = measurements.visits, compensation.eta
    nominal = compensation.errors.robot.forward(visits.commands)
    predicted = compensation.deviations(nominal, visits.conditions, on_failure="nan")
    # near a singular pose no command corrects, and the uncorrected one remains
    predicted[~np.isfinite(predicted).all(axis=1)] = 0.0
    true = pseudo_errors(measurements, nominal, eta)
    best = true.left
    if true.whole:
        with contextlib.suppress(UnreachablePoseError):  # beside a singular pose, in the direction that is hardly seen
            best = pseudo_errors(measurements, nominal, eta, seen=_FLOOR_SEEN).left
    reached = compensation.errors.robot.forward(nominal.commands + predicted, guess=nominal.q, on_failure="nan")
    if not reached.solved.all():
        kept = np.where(reached.solved[:, None], predicted, 0.0)
        reached = compensation.errors.robot.forward(nominal.commands + kept, guess=nominal.q)
    errors = np.stack([true.before, seen_errors(measurements, reached, eta).errors, best], axis=1)
    weights = tip_weights(eta, nominal.robot.tool_motions)
    moved = datum_motions(nominal) * weights[:, None]
    model = compensation.poses(nominal, visits.conditions)
    left = seen_errors(measurements, model, eta)
    modelled = weights * pose_difference(np.stack([nominal.transforms, reached.transforms]), model.transforms)
    hidden = np.einsum("nij,knj->nki", np.eye(6) - left.shown, modelled)
    learned = compensation.learned_covariances(model, visits.conditions)
    signed = compensation.session.signed_effects(session_conditions(visits), model, eta)
    independent = left.shown @ (learned + signed @ np.swapaxes(signed, 1, 2)) @ left.shown
    known = left.covariances + _unknown(compensation, found, left.by(linear.rows)) + independent
    of_all = final.covariances(reached := final.model_poses(nominal), visits.conditions)
    effects = final.standard_effects(reached)
    control = weighted_control(nominal, eta)
    if compensation.values is None:
        blind = np.linalg.matrix_rank(control_inverse(true.control)) < control.shape[2]
        of_all[blind] = np.nan
    noise = true.seen.covariances
    return _Scores(errors, hidden, noise, moved, left.errors, known, left.shown, control, of_all, effects)


def _unknown(compensation: Compensation, found: Identification, effects: Array) -> Array:
    """Return the covariance of errors by all parameters of a fit, machine and set-up, shape=(visits, 6, 6) [m^2].

    What shifts with the place of a plane or a camera was found with it. Of a method without parameters, only those of
    the set-up count.

    Args:
        compensation: of the parameters, as far as they are certain.
        found: the fit.
        effects: the errors by the parameters in their scales, shape=(visits, 6, parameters).
    """
    units, count = found.units, len(found.errors)
    known = found.known_covariance / np.outer(units, units)
    if compensation.values is None:
        machine = len(known) - len(found.nuisances)
        known, effects = known[machine:, machine:], effects[:, :, machine:]
    else:
        left_out = (found.values - compensation.values) / units[:count]
        known[:count, :count] += np.outer(left_out, left_out)
    return np.asarray(effects @ known @ np.swapaxes(effects, 1, 2))


def _outlying(calibration: Fit) -> list[_Scores]:
    """Return the scores of the poses with outliers, which were not fitted, as far as they can be judged."""
    found = calibration.identification
    if not found.outliers:
        return []
    numbers = found.measurements.pose_numbers
    outlying = np.flatnonzero(np.isin(numbers, numbers[list(found.outliers)]))
    with contextlib.suppress(UnreachablePoseError):  # a mistake in the commands
        linear = found.linearised(found.measurements[outlying])
        scores = _scores_of(calibration.compensation, found, linear, calibration.compensation)
        return [scores[np.asarray(scores.shown.any(axis=(1, 2)))]]
    return []


def _together(calibration: Fit, rows: Indices, scores: _Scores, scatter: Scatter, sure: Scatter) -> HeldOut:
    """Combine the errors, with `scatter` for the bounds and the certain part of it, `sure`, for the excess."""
    errors = _registered(scores.found, scores.shown @ scores.moved, calibration.identification)
    before, after, floor = np.linalg.norm(errors, axis=2)
    whole = _registered(scores.found[:, :2] + scores.hidden, scores.moved, calibration.identification)
    energies = np.array([weighted_energy(each) for each in errors])
    gains, left = control_inverse(scores.control), sure.covariances(scores.control)
    excess = np.sqrt(np.einsum("nij,njk,nik->n", gains, scores.uncertain + left, gains) / gains.shape[1])
    within = float(np.mean(scores.within(scatter)))
    interval = sure.excess_interval(scores.effects, scores.control) if calibration.scatters else None
    noise, change = np.sqrt(np.einsum("nii->n", scores.noise)), errors[1] - errors[0]
    chance = 2.0 * float(np.sqrt(np.einsum("ni,nij,nj->", change, scores.noise, change))) / len(before)
    return HeldOut(
        rows,
        before,
        after,
        floor,
        np.linalg.norm(whole, axis=2),
        noise,
        chance,
        excess,
        interval,
        scatter,
        within,
        energies,
    )


def _registered(errors: Array, moved: Array, found: Identification) -> Array:
    """Return errors, each without what motions of an unknown base and of unknown points explain, (k, visits, 6).

    Args:
        errors: tip-weighted, shape=(visits, k, 6) [m].
        moved: the same by motions of base and tool, shape=(visits, 6, 12).
        found: what was identified.
    """
    kinds = {part.kind for part in found.nuisances.parts}
    columns = np.repeat(["frame" in kinds, bool(kinds & {"targets", "tool_point"})], 6)
    each = np.swapaxes(errors, 0, 1).reshape(errors.shape[1], -1)
    if columns.any():
        motions = moved[:, :, columns].reshape(-1, int(columns.sum()))
        each = each - (motions @ np.linalg.lstsq(motions, each.T, rcond=_UNSEEN)[0]).T
    return np.asarray(each.reshape(errors.shape[1], -1, 6))
