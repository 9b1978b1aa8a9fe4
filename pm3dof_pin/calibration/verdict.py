"""A calibration in three lines: what to expect of the machine, what was not seen, and what to do next."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.judging import HeldOut
from pm3dof_pin.calibration.pseudo_error import control_inverse, pseudo_errors
from pm3dof_pin.calibration.repeatability import Repeatability, Systematic, drift_and_hysteresis, repeatability
from pm3dof_pin.calibration.uncertainty_budget import uncertainty_budget
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

_POSES = 60  # of the workspace
_RICH = 2.0  # noise factor from which the machine is richer than its parameters


@dataclass(frozen=True, eq=False)
class Verdict:
    """Three lines, and the numbers behind them."""

    expect: str  #: what to expect of the machine
    unseen: str  #: what was not seen
    next: str  #: what to do next
    #: tip error of the corrected machine that is not exceeded with a probability of 95 %, root mean square over the
    #: workspace [m]
    bound: float
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
    budget = uncertainty_budget(calibration, poses[reached])
    bound = float(np.sqrt(np.mean(answer.error_bound[reached] ** 2)))
    judged, source = (validation, "the validation file") if validation is not None else (held_out, "held-out poses")
    total = float(np.sqrt(np.mean(answer.predicted_error[reached] ** 2)))
    expect = f"a tip error of {1e6 * total:.0f} µm (rms), with a probability of 95 % below {1e6 * bound:.0f} µm"
    if judged is not None:
        before, after = (float(np.sqrt(np.mean(values**2))) for values in (judged.before, judged.after))
        expect += (
            f"; on {source} {1e6 * after:.0f} µm were left of {1e6 * before:.0f} µm, and {100.0 * judged.within:.0f} % "
            "were where they were predicted with 95 %"
        )
    return Verdict(
        expect,
        "; ".join(_unseen(calibration)) or "nothing that moves the tool",
        _advice(calibration, validation, budget),
        bound,
        budget,
        drift_and_hysteresis(calibration),
        repeatability(calibration),
    )


def _unseen(calibration: Calibration) -> list[str]:
    found = calibration.identification
    shown = found.settled.visits
    nominal = calibration.compensation.errors.robot.forward(shown.commands)
    seen = int(np.linalg.matrix_rank(control_inverse(pseudo_errors(found.settled, nominal).control)).max())
    drives, hidden = nominal.commands.shape[1], []
    if seen < drives:
        hidden.append(f"{drives - seen} of {drives} motions of the drives at a pose: of them only the model speaks")
    missing = len(found.identifiability.names) - found.identifiability.rank
    if missing:
        hidden.append(f"{missing} combinations of parameters")
    if found.nuisances.columns("frame").size:
        hidden.append("where the base stands but for the machine's own motion")
    if found.nuisances.columns("targets").size:
        hidden.append("a shift or turn common to all targets, which is one of the tool")
    counts = np.bincount(found.measurements.visits.pose_numbers)
    if counts.max() < 2:
        hidden.append("repeatability, as no pose was taken up twice")
    if found.measurements.times is None:
        hidden.append("drift and hysteresis, without times")
    return hidden


def _advice(calibration: Calibration, validation: HeldOut | None, budget: Mapping[str, float]) -> str:
    found = calibration.identification
    largest = max(budget, key=lambda name: budget[name])
    if found.noise_factor > _RICH:
        return (
            f"find what the parameters do not describe (residuals are {found.noise_factor:.1f} times the noise): the "
            "complete error file, temperatures, loads, backlash, or sigmas that are too small"
        )
    advice = {
        "floor": "better parts, where commands correct nothing: error-map names them",
        "instrument": "more poses, of calibration-plan --strategy tip-optimal, or a better instrument",
        "frame": "more poses all over the workspace, or a base that is measured by itself",
        "targets": "measure where the targets sit, or more targets",
        "parameters": "whole poses, or targets off the tool point: they show what was not seen",
        "learned": "more poses",
        "unmodelled": "a learned part (method lm+gp), or known temperatures and loads",
        "repeatability": "nothing a calibration can do: the machine does not come back better",
    }[largest]
    return advice + ("" if validation is not None else "; and a second file of measurements for --validation")
