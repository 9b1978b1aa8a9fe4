"""Verdict on a calibration: what to expect of the machine, what was not seen, and what to do next."""

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

_POSES = 60  # number of poses of the workspace
_WHOLE = 0.995  # fraction of a correction that counts as all
_RICH = 2.0  # noise factor from which the parameters do not describe the machine


@dataclass(frozen=True, eq=False)
class Verdict:
    """Three lines, and the numbers behind them."""

    expect: str  #: what to expect of the machine
    unseen: str  #: what was not seen
    next: str  #: what to do next
    #: with a probability of 95 %, 95 % of the poses of the workspace have a tip error of the corrected machine below
    #: this [m]
    bound: float
    #: interval of this machine's tip error, root mean square over the workspace, with the same probability [m]; None
    #: for a learning method, and for a machine that its parameters do not describe
    interval: tuple[float, float] | None
    budget: Mapping[str, float]  #: contribution of each source to that error, root mean square over the workspace [m]
    systematic: Sequence[Systematic]  #: drift and hysteresis, where rows have times or directions
    repeated: Repeatability | None  #: from poses visited several times; None if there are none


def verdict(calibration: Calibration, held_out: HeldOut | None = None, validation: HeldOut | None = None) -> Verdict:
    """Judge a calibration in words, using its cross-validation and other measurements if available."""
    compensation = calibration.compensation
    poses = reachable_poses(compensation.errors.robot, _POSES, np.random.default_rng(0))
    conditions = {} if compensation.learned is None else compensation.learned.inputs.middle()
    answer = compensation.compensate(poses, conditions, on_failure="nan")
    reached = np.isfinite(answer.error_bound)
    bound = float(np.quantile(answer.error_bound[reached], COVERAGE))
    scope, total = "rms over the workspace", _rms(answer.predicted_error[reached])
    if total > bound:  # a few poses, such as those near singularities of an arm, would dominate
        scope = (
            f"rms over the workspace except for the worst poses, up to {1e6 * np.nanmax(answer.predicted_error):.0f} µm"
        )
        reached &= answer.error_bound <= bound
        total = _rms(answer.predicted_error[reached])
    budget = uncertainty_budget(calibration, poses[reached])
    interval = calibration.tip_interval(poses[reached])
    if interval is not None:
        scope += f", {1e6 * interval[0]:.0f} to {1e6 * interval[1]:.0f} with 95 % probability"
    expect = f"a tip error of {1e6 * total:.0f} µm ({scope}), below {1e6 * bound:.0f} µm at 95 % of the poses"
    if 2.0 * budget["parameters"] ** 2 > total**2 - budget["floor"] ** 2:
        expect += (
            "; most of the uncertainty was not measured and is the same at all poses, so for 95 % of machines such "
            "bounds hold nearly everywhere, and for the others hardly anywhere"
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
        hidden.append(f"{drives - seen} of the {drives} motions of the drives at a pose, known only from the model")
    missing = len(found.identifiability.names) - found.identifiability.rank
    if missing:
        hidden.append(f"{missing} combinations of parameters, listed in the report")
    if (part := calibration.part_corrected) < _WHOLE:
        hidden.append(f"{100.0 * (1.0 - part):.0f} % of the correction, left out because it could also do harm")
    if found.nuisances.columns("frame").size:
        hidden.append("the location of the base, except through the machine's own motion")
    if found.nuisances.columns("targets").size:
        hidden.append("a shift or rotation common to all targets, equivalent to one of the tool")
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
        more = "parameters (method lm+gp), which show what no command corrects, or "
    advice = {
        "floor": "cannot be corrected by commands: use better parts (error-map names them)",
        "instrument": "is measurement noise: measure more poses, or use a better instrument",
        "frame": "is due to the instrument's frame: measure poses all over the workspace, or the base itself",
        "targets": "is due to target positions, drift or hysteresis: measure the targets themselves, or more rows",
        "parameters": "is due to unobserved parameters: measure full poses, or targets away from the tool point",
        "learned": "is due to the learned part: measure more poses",
        "unmodelled": f"is unmodelled: use {more}known temperatures and loads",
        "repeatability": "is repeatability, which no calibration improves",
    }[largest]
    text = f"the largest part, {1e6 * budget[largest]:.0f} µm, {advice}"
    return text if validation is not None else f"{text}; and validate with a second file of measurements (--validation)"
