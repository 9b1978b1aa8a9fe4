"""A calibration in three lines: what to expect of the machine, what was not seen, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.judging import HeldOut
from pm3dof_pin.calibration.pseudo_error import control_inverse, pseudo_errors
from pm3dof_pin.calibration.repeatability import Repeatability, Systematic
from pm3dof_pin.calibration.rms_interval import COVERAGE
from pm3dof_pin.calibration.uncertainty_budget import uncertainty_budget
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.typing import Array

_POSES = 60  # of the workspace
_WHOLE = 0.995  # of a correction
_RICH = 2.0  # noise factor from which the machine is richer than its parameters


@dataclass(frozen=True, eq=False)
class Verdict:
    """Three lines, and the numbers behind them."""

    expect: str  #: what to expect of the machine
    unseen: str  #: what was not seen
    next: str  #: what to do next
    #: tip error of the corrected machine below which, with a probability of 95 % each, 95 % of the poses of the
    #: workspace are [m]
    bound: float
    #: between which, with the same probability, the root mean square of this machine's tip error over the workspace is
    #: [m]; None for a method that learns, and of a machine that is richer than its parameters
    interval: tuple[float, float] | None
    budget: Mapping[str, float]  #: what each source adds to that error, root mean square over the workspace [m]
    systematic: Sequence[Systematic]  #: drift and hysteresis, where rows have times or directions
    repeated: Repeatability | None  #: what poses that were visited several times tell; None if there are none


def verdict(calibration: Calibration, held_out: HeldOut | None = None, validation: HeldOut | None = None) -> Verdict:
    """Judge a calibration in words, by its cross-validation and other measurements, if there are such."""
    compensation = calibration.compensation
    poses = reachable_poses(compensation.errors.robot, _POSES, np.random.default_rng(0))
    conditions = {} if compensation.learned is None else compensation.learned.inputs.middle()
    answer = compensation.compensate(poses, conditions, on_failure="nan")
    reached = np.isfinite(answer.error_bound)
    bound = float(np.quantile(answer.error_bound[reached], COVERAGE))
    scope, total = "rms over the workspace", _rms(answer.predicted_error[reached])
    if total > bound:  # a few poses, as next to singular ones of an arm, would be all that is told
        scope = (
            f"rms over the workspace but for the worst poses, up to {1e6 * np.nanmax(answer.predicted_error):.0f} µm"
        )
        reached &= answer.error_bound <= bound
        total = _rms(answer.predicted_error[reached])
    budget = uncertainty_budget(calibration, poses[reached])
    interval = calibration.tip_interval(poses[reached])
    if interval is not None:
        scope += f", {1e6 * interval[0]:.0f} to {1e6 * interval[1]:.0f} with a probability of 95 %"
    expect = f"a tip error of {1e6 * total:.0f} µm ({scope}), below {1e6 * bound:.0f} µm at 95 % of the poses"
    if 2.0 * budget["parameters"] ** 2 > total**2 - budget["floor"] ** 2:
        expect += (
            "; as most of what is uncertain was not measured and the same at all poses, such bounds hold for 95 % of "
            "machines, of one nearly everywhere or hardly anywhere"
        )
    errors, source = (held_out, "held-out poses") if validation is None else (validation, "the validation file")
    if errors is not None:
        before, after = _rms(errors.before), _rms(errors.after)
        expect += (
            f"; on {source} it went from {1e6 * before:.0f} to {1e6 * after:.0f} µm, noise included, and "
            f"{100.0 * errors.within:.0f} % of the poses were within their 95 % bounds"
        )
    return Verdict(
        expect,
        "; ".join(_unseen(calibration)) or "nothing that moves the tool",
        _advice(calibration, validation, budget),
        bound,
        interval,
        budget,
        Systematic.all_of(calibration),
        Repeatability.of(calibration),
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _unseen(calibration: Calibration) -> list[str]:
    found = calibration.identification
    shown = found.settled.visits
    nominal = calibration.compensation.errors.robot.forward(shown.commands)
    seen = int(np.linalg.matrix_rank(control_inverse(pseudo_errors(found.settled, nominal).control)).max())
    drives, hidden = nominal.commands.shape[1], []
    if seen < drives:
        hidden.append(f"{drives - seen} of the {drives} motions of the drives at a pose: of them only the model speaks")
    missing = len(found.identifiability.names) - found.identifiability.rank
    if missing:
        hidden.append(f"{missing} combinations of parameters, which the report lists")
    if (part := calibration.part_corrected) < _WHOLE:
        hidden.append(f"{100.0 * (1.0 - part):.0f} % of the correction, left out because it could do harm as well")
    if found.nuisances.columns("frame").size:
        hidden.append("where the base stands, other than by the machine's own motion")
    if found.nuisances.columns("targets").size:
        hidden.append("a shift or turn common to all targets, which is one of the tool")
    counts = np.bincount(found.measurements.visits.pose_numbers)
    if counts.max() < 2:
        hidden.append("repeatability (no pose was measured twice)")
    unapproached = found.measurements.approaches is None
    if found.measurements.times is None:
        hidden.append(f"drift{' and hysteresis' if unapproached else ''} (the file has no times)")
    elif unapproached:
        hidden.append("hysteresis (the measurements have no approaches)")
    return hidden


def _advice(calibration: Calibration, validation: HeldOut | None, budget: Mapping[str, float]) -> str:
    found = calibration.identification
    if found.noise_factor > _RICH:
        return (
            f"find what the parameters do not describe, as residuals are {found.noise_factor:.1f} times the noise: "
            "temperatures, loads, backlash, errors missing in the error file, or sigmas that are too small"
        )
    largest = max(budget, key=lambda name: budget[name])
    more = "a learned part (method lm+gp), or " if calibration.compensation.learned is None else ""
    if calibration.compensation.values is None:
        more = "parameters (method lm+gp), which tell what no command corrects, or "
    advice = {
        "floor": "no command corrects: better parts, which error-map names",
        "instrument": "is noise of the measurements: more poses, or a better instrument",
        "frame": "is the instrument's frame: poses all over the workspace, or a base measured by itself",
        "targets": "is where targets sit, drift or hysteresis: targets measured by themselves, or more rows",
        "parameters": "is parameters that were not seen: whole poses, or targets off the tool point",
        "learned": "is what had to be learned: more poses",
        "unmodelled": f"nothing describes: {more}known temperatures and loads",
        "repeatability": "is repeatability, which no calibration improves",
    }[largest]
    text = f"the largest part, {1e6 * budget[largest]:.0f} µm, {advice}"
    return text if validation is not None else f"{text}; and a second file of measurements, to judge by (--validation)"
