"""Paths of a calibrated machine: conditions such as the time count as they do at single poses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.session_effects import SessionEffects
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.paths.evaluation import PathEvaluation, PathOptions, evaluate_path
from pm3dof_pin.paths.tool_path import read_path

DRIFT = np.array([20e-6, -10e-6, 5e-6, 0.0, 30e-6, 0.0])  # of the drives' zeros over a session of 1000 s


@pytest.fixture(scope="module")
def drifting() -> Compensation:
    """A hexapod without errors whose drives' zeros drift."""
    known = np.concatenate([np.zeros(6), DRIFT])
    session = SessionEffects(drift=known, drift_covariance=np.zeros((12, 12)), start=100.0, duration=1000.0)
    return Compensation(pm.GeometricErrors.load("hexapod"), session=session)


def _run(known: Compensation, folder: Path, **conditions: float) -> PathEvaluation:
    program = folder / "line.ngc"
    program.write_text("G21 G0 X0 Y0 Z130\nG1 X10 F600\nM2\n")
    robot = known.errors.robot
    options = PathOptions(calibration=known, conditions=conditions)
    return evaluate_path(robot, read_path(robot, program), options)


def test_drift_is_corrected_at_a_given_time(drifting: Compensation, tmp_path: Path) -> None:
    """At 850 s, a quarter past the middle, the drives are off by a quarter of their drift, and nothing is left."""
    columns = _run(drifting, tmp_path, time_s=850.0).columns
    for k, drift in enumerate(DRIFT, start=1):
        off = columns[f"calibrated_u{k}_m"] - columns[f"u{k}_m"]
        np.testing.assert_allclose(off, -0.25 * drift, atol=1e-12)
    np.testing.assert_allclose(columns["expected_error_m"], 0.0, atol=1e-9)


def test_drift_counts_if_no_time_is_given(drifting: Compensation, tmp_path: Path) -> None:
    """It is uniform over the session: its root mean square is that of its whole over the root of twelve."""
    found = _run(drifting, tmp_path)
    robot, columns = drifting.errors.robot, found.columns
    start = robot.solve([[columns[name][-1] for name in found.coordinate_names]])
    moved = robot.forward(start.commands + DRIFT, guess=start.q)
    shift = moved.positions[0] - start.positions[0]
    turn = moved.rotations[0] @ start.rotations[0].T
    angle = np.arccos(np.clip(0.5 * (np.trace(turn) - 1.0), -1.0, 1.0))
    tip = np.hypot(np.linalg.norm(shift), TIP_LENGTH * angle)
    assert columns["expected_error_m"][-1] == pytest.approx(tip / np.sqrt(12.0), rel=1e-3)
    np.testing.assert_allclose(columns["calibrated_u1_m"], columns["u1_m"], atol=1e-12)


def test_conditions_on_which_nothing_depends_are_refused(drifting: Compensation) -> None:
    """Neither without a calibration, nor by a name that it does not have, nor loads, which the path has."""
    with pytest.raises(InvalidValueError, match="a calibration that depends on them"):
        PathOptions(conditions={"time_s": 1.0})
    for conditions in ({"temperature_K": 1.0}, {"load_fx_N": 1.0}):
        with pytest.raises(InvalidValueError, match=next(iter(conditions))):
            PathOptions(calibration=drifting, conditions=conditions)
