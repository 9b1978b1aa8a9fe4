"""What to expect of a calibrated machine, what was not seen, and what to do next.

The uncertainty budget lists the contribution of each source to the variance of the tip. With the information I on all
parameters, the prior information L and C = (I + L)^-1, the covariance is C I C, due to the instrument's noise, plus
C L C, due to what was not measured. The contribution of an unknown frame and of unknown targets is the difference to a
fit in which they are known. Accuracy and repeatability of repeated poses are as in ISO 9283.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.linearisation import tool_motions_by_drives
from pm3dof_pin.calibration.pseudo_error import motions_seen, seen_errors
from pm3dof_pin.calibration.scatter import COVERAGE
from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.typing import Array, Indices, Mask

_POSES = 2000  # number of poses of the workspace: their rms is known to a percent or two
_FEWEST_POSES, _LARGEST = 300, 350_000  # of machines with many parameters: poses times parameters, at most
_COUNTS = 0.3  # part of the tip error below which it is not worth a word
_AS_MEASURED = {
    "base": "in the frame of the instrument, as the machine's motion places it in the base",
    "tool": "of the tool as its targets show it",
}
_WHOLE_POSES = 6  # drives with which commands correct whole poses
_WHOLE = 0.995  # fraction of a correction that counts as all
_CERTAIN = 1e-3  # probability of harm below which a gain is taken for certain
_POORLY_DESCRIBED = 2.0  # noise factor from which the parameters do not describe the machine
_MIN_VISITS = 3  # of a pose, for a row in the table
_FALSE_ALARM = 1e-3  # probability of reporting drift or hysteresis if there is none


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
    def from_fit(cls, calibration: Fit) -> Repeatability | None:
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
        often = np.flatnonzero(counts >= _MIN_VISITS)
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
    def all_from_fit(cls, calibration: Fit) -> list[Systematic]:
        """Return the effects found from times and directions of approach; none without such data."""
        found = calibration.identification
        drives, weights = tool_motions_by_drives(found.poses), calibration.compensation.weights
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
            sure = bool(scipy.special.gammaincc(0.5 * determined, 0.5 * max(statistic, 0.0)) < _FALSE_ALARM)
            answers.append(cls(kind, tip, sigma, sure))
        return answers


@dataclass(frozen=True, eq=False)
class Expectation:
    """Three lines, and the numbers behind them."""

    text: str  #: what to expect of the machine
    not_seen: str  #: what was not seen
    next: str  #: what to do next
    #: with a probability of 95 %, 95 % of the poses of the workspace have a tip error of the corrected machine below
    #: this [m]
    bound: float
    #: interval of this machine's tip error, root mean square over the workspace, with the same probability [m]; None
    #: for a learning method, and for a machine that its parameters do not describe
    interval: tuple[float, float] | None
    #: the expected tip error if residuals beyond the noise are the instrument's, not the machine's, root mean square
    #: over the workspace [m]; None where they are not much larger than the noise
    if_noise_is_larger: float | None
    budget: Mapping[str, float]  #: contribution of each source to that error, root mean square over the workspace [m]
    #: how far the tip is off on top of that because "base" and "tool" count where the measurements have them; without
    #: those that the measurements locate, root mean square over the workspace [m]
    unlocated: Mapping[str, float]
    systematic: Sequence[Systematic]  #: drift and hysteresis, where rows have times or directions
    repeated: Repeatability | None  #: from poses visited several times; None if there are none

    @classmethod
    def from_fit(
        cls, calibration: Fit, held_out: HeldOut | None = None, validation: HeldOut | None = None
    ) -> Expectation:
        """Judge a calibration in words, using its cross-validation and other measurements if available."""
        compensation = calibration.compensation
        count = min(_POSES, max(_FEWEST_POSES, _LARGEST // max(1, len(compensation.errors))))
        poses = reachable_poses(compensation.errors.robot, count, np.random.default_rng(0))
        conditions = {} if compensation.learned is None else compensation.learned.inputs.middle()
        answer = compensation.compensate(poses, conditions, on_failure="nan", with_deviations=False)
        reached = np.isfinite(answer.error_bound)
        bound = float(np.quantile(answer.error_bound[reached], COVERAGE))
        scope, total = "rms over the workspace", _rms(answer.predicted_error[reached])
        if total > bound:  # a few poses, such as those near singularities of an arm, would dominate
            worst = 1e6 * float(np.nanmax(answer.predicted_error))
            scope = f"rms over the workspace except for the worst poses, up to {worst:.0f} µm"
            reached &= answer.error_bound <= bound
            total = _rms(answer.predicted_error[reached])
        repeated = Repeatability.from_fit(calibration)
        model = compensation.model_poses(poses[reached])
        square = _mean_square(calibration, model)
        budget = _uncertainty_budget(calibration, answer.floor[reached], model, square, repeated)
        unlocated = {} if square is None else _unlocated(calibration, square)
        interval = calibration.tip_interval(poses[reached])
        if interval is not None:
            scope += f", {1e6 * interval[0]:.0f} to {1e6 * interval[1]:.0f} with 95 % probability"
        expect = f"a tip error of {1e6 * total:.0f} µm ({scope}), below {1e6 * bound:.0f} µm at 95 % of the poses"
        if unlocated:
            expect += f", {' and '.join(_AS_MEASURED[part] for part in unlocated)}"
        if 2.0 * budget["parameters"] ** 2 > total**2 - budget["floor"] ** 2:
            expect += (
                "; most of the uncertainty was not measured and is the same at all poses, so for 95 % of machines such "
                "bounds hold nearly everywhere, and for the others hardly anywhere"
            )
        quiet = None
        if not calibration.scatters and budget["unmodelled"] > 0.0:
            factor = calibration.identification.noise_factor
            quiet = float(np.sqrt(max(0.0, total**2 - budget["unmodelled"] ** 2)))
            expect += (
                f"; or of {1e6 * quiet:.0f} µm if it is the sigmas of the measurements that are {factor:.1f} times too "
                "small, and not the machine that scatters, which single measurements cannot tell apart"
            )
        errors, source = (held_out, "held-out poses") if validation is None else (validation, "the validation file")
        if errors is not None:
            before, after = _rms(errors.before), _rms(errors.after)
            expect += (
                f"; on {source} it went from {1e6 * before:.0f} to {1e6 * after:.0f} µm, noise included, and "
                f"{100.0 * errors.within:.0f} % of the poses were within their 95 % bounds"
            )
        return cls(
            expect,
            "; ".join(_unseen(calibration, unlocated)) or "nothing that moves the tool",
            _advice(calibration, validation, budget),
            bound,
            interval,
            quiet,
            budget,
            unlocated,
            Systematic.all_from_fit(calibration),
            repeated,
        )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _unseen(calibration: Fit, unlocated: Mapping[str, float]) -> list[str]:
    found = calibration.identification
    shown = found.settled.visits
    nominal = calibration.compensation.errors.robot.forward(shown.commands)
    seen, possible, _ = motions_seen(found.settled, nominal)
    hidden = []
    if seen < possible:
        hidden.append(f"{possible - seen} of the {possible} motions of the drives at a pose, known only from the model")
    missing = len(found.identifiability.names) - found.identifiability.identified
    if missing:
        hidden.append(f"{missing} combinations of parameters, listed in the report")
    if (part := calibration.part_corrected) < _WHOLE:
        hidden.append(f"{100.0 * (1.0 - part):.0f} % of the correction, left out because it could also do harm")
    if (chance := calibration.chance_of_harm) > _CERTAIN:
        hidden.append(
            f"whether anything is gained: with {100.0 * chance:.1f} % probability the corrected commands are worse "
            "than uncorrected ones"
        )
    if found.nuisances.columns("frame").size:
        hidden.append(f"the location of the base, except through the machine's own motion{_amount(unlocated, 'base')}")
    elif found.measurements.on_datums.all():
        hidden.append("the location of the base, which counts with its tolerances")
    if found.nuisances.columns("targets").size:
        same = "a shift or rotation common to all targets, equivalent to one of the tool"
        hidden.append(f"{same}{_amount(unlocated, 'tool')}")
    counts = np.bincount(found.measurements.visits.pose_numbers)
    if counts.max() < 2:
        hidden.append("repeatability (no pose was measured twice)")
    unapproached = found.measurements.approaches is None
    if found.measurements.times is None:
        hidden.append(f"drift{' and hysteresis' if unapproached else ''} (the file has no times)")
    elif unapproached:
        hidden.append("hysteresis (the measurements have no approaches)")
    return hidden


def _amount(unlocated: Mapping[str, float], part: str) -> str:
    return f" (by the tolerances another {1e6 * unlocated[part]:.0f} µm, rms)" if part in unlocated else ""


def _advice(calibration: Fit, validation: HeldOut | None, budget: Mapping[str, float]) -> str:
    found = calibration.identification
    if found.noise_factor > _POORLY_DESCRIBED:
        return (
            f"find what the parameters do not describe, as residuals are {found.noise_factor:.1f} times the noise: "
            "temperatures, loads, backlash, errors missing in the error file, or sigmas that are too small"
        )
    largest = max(budget, key=lambda name: budget[name])
    more = "a learned part (method lm+gp), or " if calibration.compensation.learned is None else ""
    if calibration.compensation.values is None:
        more = "parameters (method lm+gp), which show what no command corrects, or "
    advice = {
        "floor": "cannot be corrected by commands: use better parts (error-map names them)",
        "instrument": "is measurement noise: measure more poses, or use a better instrument",
        "frame": "is due to the instrument's place: measure poses all over the workspace, or the base itself",
        "targets": "is due to target positions, drift or hysteresis: measure the targets themselves, or more rows",
        "parameters": "is due to unobserved parameters: measure full poses, or targets away from the tool point",
        "learned": "is due to the learned part: measure more poses",
        "drift": "is drift: let the machine warm up, or give compensate the time (--condition time_s=...)",
        "hysteresis": "is hysteresis: arrive from one side, or give compensate the directions (--approach)",
        "unmodelled": f"is unmodelled: use {more}known temperatures and loads",
        "repeatability": "is repeatability, which no calibration improves",
    }[largest]
    if largest == "floor" and len(calibration.compensation.errors.robot.commands) >= _WHOLE_POSES:
        advice = "is of poses near singular ones, where commands do not reach all directions: keep away from them"
    text = f"the largest part, {1e6 * budget[largest]:.0f} µm, {advice}"
    return text if validation is not None else f"{text}; and validate with a second file of measurements (--validation)"


def _mean_square(calibration: Fit, model: Poses) -> Array | None:
    """Return the mean square of the tip's motions by parameters, base and tool, shape=(p + 12, same) [m^2].

    None without parameters.
    """
    found, compensation = calibration.identification, calibration.compensation
    if compensation.values is None:
        return None
    motions = np.concatenate([sensitivities(found.errors, model, found.values).errors, datum_motions(model)], axis=2)
    effects = (motions * compensation.weights[:, None]).reshape(-1, motions.shape[2])
    return np.asarray(effects.T @ effects / len(model))


def _unlocated(calibration: Fit, square: Array) -> dict[str, float]:
    """Return how far the tip is off because base and tool are where the measurements have them, root mean square [m].

    What no measurement locates, errors of the parts move unseen: it is not in the tip error, and comes on top.
    """
    found, count = calibration.identification, len(calibration.identification.errors)
    known = found.seen_covariance
    if len(known) == count:
        return {}
    as_measured, amounts = float(np.sum(square * known)), {}
    for part, own in (("base", slice(count, count + 6)), ("tool", slice(count + 6, None))):
        if not known[own, own].any():
            continue
        others = known.copy()
        others[own], others[:, own] = 0.0, 0.0
        amounts[part] = float(np.sqrt(max(0.0, np.sum(square * others) - as_measured)))
    return {part: amount for part, amount in amounts.items() if amount > _COUNTS * np.sqrt(as_measured)}


def _uncertainty_budget(
    calibration: Fit, floor: Array, model: Poses, square: Array | None, repeated: Repeatability | None
) -> dict[str, float]:
    """Return each source's contribution to the corrected machine's tip error, root mean square over desired poses [m].

    "floor": what no command corrects, as far as it is known; "instrument"; "frame": where the instrument or what is
    measured against is; "targets": their positions, with the uncertainty that drift and hysteresis bring to them, but
    not a shift with the tool, which is none of the tool as they show it; "parameters": unobserved ones; "learned";
    "drift" and "hysteresis": of the machine at work, whose time and directions are not known; "unmodelled";
    "repeatability". The squares sum up to the square of the expected tip error.
    """
    compensation, found = calibration.compensation, calibration.identification
    weights = compensation.weights
    conditions = {} if compensation.learned is None else compensation.learned.inputs.middle()
    parts = dict.fromkeys(("floor", "instrument", "frame", "targets", "parameters", "learned"), 0.0)
    if compensation.values is not None and square is not None:
        parts["floor"] = float(np.mean(floor**2))
        parts |= _of_parameters(calibration, square)
        left_out = np.zeros(len(square))
        left_out[: len(found.values)] = found.values - compensation.values
        parts["parameters"] += float(left_out @ square @ left_out)
    if compensation.learned is not None:
        control = command_jacobians(model) * weights[:, None]
        spread = compensation.learned.uncertainties(model.commands, conditions)
        parts["learned"] = float(np.mean(np.sum((control * spread[:, None, :]) ** 2, axis=(1, 2))))
    scatter = compensation.scatter.tip_error**2
    drift = compensation.session.common_effects({}, model, compensation.eta)
    parts["drift"] = float(np.sum(drift**2)) / len(model)
    left = compensation.session.scatter({}, model, compensation.eta)
    parts["hysteresis"] = float(np.mean(np.einsum("nii->n", left)))
    parts["repeatability"] = 0.0 if repeated is None else min(scatter, repeated.tip_sigma**2)
    parts["unmodelled"] = scatter - parts["repeatability"]
    if compensation.values is not None and square is not None:  # what it may have shifted
        shifts = found.seen_map @ found.beyond.T
        parts["unmodelled"] += float(np.sum((square @ shifts) * shifts))
    return {name: float(np.sqrt(max(value, 0.0))) for name, value in parts.items()}


def _of_parameters(calibration: Fit, square: Array) -> dict[str, float]:
    """Return variances [m^2], given the mean square of the tip's motions by parameters, base and tool."""
    found, count = calibration.identification, len(calibration.identification.errors)
    machine = found.rows.shape[2] - len(found.nuisances)
    scaled = np.sqrt(found.certainties)[:, :, None] * found.rows
    matrix = scaled.reshape(-1, scaled.shape[2])
    before = found.prior.of_all(machine - count, found.nuisances.sigmas)
    widening = np.concatenate([found.prior.widening, np.ones(len(before) - count)])
    datum = found.seen_map

    def variances(known: Mask) -> tuple[float, float]:
        """Return the tip variances due to noise and to missing information, given that some parameters are known."""
        free = np.flatnonzero(~known)
        rows, effects, precision = matrix[:, free], datum[:, free] * found.units[free], before[free] ** -1.0
        total = rows.T @ rows
        total.flat[:: len(free) + 1] += precision**2
        if precision.all():
            spread = scipy.linalg.cho_solve(scipy.linalg.cho_factor(total), effects.T)
        else:  # what has no prior may not have been seen
            spread = np.linalg.pinv(total) @ effects.T
        unmeasured = (precision * widening[free])[:, None] * spread
        noise, ignorance = (np.sum((part @ square) * part) for part in (rows @ spread, unmeasured))
        return float(noise), float(ignorance)

    columns = np.arange(found.rows.shape[2])
    places = ("frame", "stations", *{datum.kind.name for datum in found.measurements.datums})
    frame = machine + np.concatenate([found.nuisances.columns(kind) for kind in places])
    noise, ignorance = variances(columns >= machine)
    with_frame = sum(variances((columns >= machine) & ~np.isin(columns, frame)))
    total = sum(variances(columns < 0))
    return {
        "instrument": noise,
        "parameters": ignorance,
        "frame": max(0.0, with_frame - noise - ignorance),
        "targets": max(0.0, total - with_frame),
    }
