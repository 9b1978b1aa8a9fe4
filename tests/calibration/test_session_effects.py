"""Hysteresis and drift that were identified: they count in what is promised, unless commands correct them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.calibration.session_effects import TIME_COLUMN, approaches_along
from pm3dof_pin.errors.normal_vectors import norm_quantiles
from pm3dof_pin.errors.pose_error import pose_difference, tip_error

ROWS, FRESH, DURATION = 40, 2000, 3600.0


class Sloppy:
    """A hexapod whose struts are off by half their backlash, and whose base moves while it is measured."""

    def __init__(self, seed: int, backlash: float, motion: float) -> None:
        self.errors = pm.GeometricErrors.load("hexapod")
        generator = np.random.default_rng(seed)
        self.robot = self.errors.apply(self.errors.sample(generator))
        self.backlash = backlash * generator.choice([-1.0, 1.0], 6) * generator.uniform(0.5, 1.5, 6)
        self.motion = motion * generator.standard_normal(3)
        self.generator = generator

    def poses(self, commands: np.ndarray, sides: np.ndarray, times: np.ndarray | float) -> np.ndarray:
        reached = np.array(self.robot.forward(commands + 0.5 * self.backlash * sides).transforms)
        reached[:, :3, 3] += (np.asarray(times)[..., None] / DURATION - 0.5) * self.motion
        return reached

    def calibrated(self, *, timed: bool) -> pm.Calibration:
        commands = pm.reachable_poses(self.errors.robot, ROWS, self.generator).commands
        sides, times = self.generator.choice([-1.0, 1.0], commands.shape), np.linspace(0.0, DURATION, ROWS)
        seen = self.poses(commands, sides, times)
        seen[:, :3, 3] += 7.5e-6 * self.generator.standard_normal((ROWS, 3))
        turns = Rotation.from_rotvec(7e-5 * self.generator.standard_normal((ROWS, 3))).as_matrix()
        seen[:, :3, :3] = turns @ seen[:, :3, :3]
        rows = replace(pm.Measurements.from_poses(commands, seen), approaches=sides, times=times if timed else None)
        return pm.calibrate(rows, self.errors, "lm")


def left_over(machine: Sloppy, calibration: pm.Calibration, conditions: dict[str, Any], times: Any) -> tuple[Any, Any]:
    wanted = pm.reachable_poses(machine.errors.robot, FRESH, np.random.default_rng(99))
    sides = np.random.default_rng(5).choice([-1.0, 1.0], wanted.commands.shape)
    told = {
        name: sides[:, int(name[-1]) - 1] if name.startswith("approach") else value
        for name, value in conditions.items()
    }
    answer = calibration.compensate(wanted, told)
    reached = machine.poses(answer.commands, sides, times)
    return tip_error(pose_difference(wanted.transforms, reached)), answer


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


SIDES = {f"approach_u{k}": 1.0 for k in range(1, 7)}


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_backlash_counts_unless_it_is_corrected(seed: int) -> None:
    machine = Sloppy(seed, 20e-6, 0.0)
    calibration = machine.calibrated(timed=False)
    uncorrected, answer = left_over(machine, calibration, {}, 0.5 * DURATION)
    interval = calibration.expectation.interval
    assert interval is not None
    assert rms(uncorrected) == pytest.approx(rms(answer.predicted_error), rel=0.15)
    assert 0.95 * interval[0] < rms(uncorrected) < 1.05 * interval[1]
    assert 0.85 < np.mean(uncorrected <= answer.error_bound) <= 1.0
    corrected, answer = left_over(machine, calibration, SIDES, 0.5 * DURATION)
    assert rms(corrected) < 0.6 * rms(uncorrected)
    assert rms(corrected) < 1.6 * rms(answer.predicted_error)
    assert calibration.expectation.budget["hysteresis"] == pytest.approx(rms(uncorrected), rel=0.3)


def test_drift_counts_unless_the_time_is_given() -> None:
    machine = Sloppy(4, 1e-6, 60e-6)
    calibration = machine.calibrated(timed=True)
    late, answer = left_over(machine, calibration, {}, DURATION)
    assert rms(late) < 2.0 * np.sqrt(3.0) * rms(
        answer.predicted_error
    )  # at the end it is half the drift, not d / 12^0.5
    corrected, _ = left_over(machine, calibration, {TIME_COLUMN: DURATION}, DURATION)
    assert rms(corrected) < 0.4 * rms(late)
    assert calibration.expectation.budget["drift"] > 0.5 * np.linalg.norm(machine.motion) / np.sqrt(12.0)


def test_a_folder_keeps_them(run: Callable[..., Any], tmp_path: Path) -> None:
    machine = Sloppy(1, 20e-6, 20e-6)
    calibration = machine.calibrated(timed=True)
    known = pm.read_compensation(calibration.save(tmp_path / "c"))
    wanted = pm.reachable_poses(machine.errors.robot, 3, np.random.default_rng(0))
    told = {**SIDES, TIME_COLUMN: 100.0}
    np.testing.assert_array_equal(
        known.compensate(wanted, told).commands, calibration.compensate(wanted, told).commands
    )
    pose = ["0", "0", "0.13", "0", "0", "0"]
    answers = [
        run("compensate", "--calibration", "c", "--approach", signs, "--json", "--", *pose, cwd=tmp_path)
        for signs in ("+,+,+,+,+,+", "-,-,-,-,-,-", "+,+", "path")
    ]
    assert [answer.returncode for answer in answers] == [0, 0, 2, 2], answers[0].stderr
    assert answers[0].stdout != answers[1].stdout
    assert "6 directions" in answers[2].stderr
    assert "time_s is not given: drift is not corrected" in answers[0].stderr
    header = "x_m,y_m,z_m,rx_deg,ry_deg,rz_deg"
    (tmp_path / "sides.csv").write_text(f"{header},approach_u1\n0,0,0.13,0,0,0,1\n0.001,0,0.13,0,0,0,1\n")
    (tmp_path / "plain.csv").write_text(f"{header}\n0,0,0.13,0,0,0\n0.001,0,0.13,0,0,0\n")
    for name, status in (("sides", 2), ("plain", 0)):
        words = ("--calibration", "c", "--poses", f"{name}.csv", "--approach", "path", "--json")
        done = run("compensate", *words, cwd=tmp_path)
        assert done.returncode == status, done.stderr
        assert ("given twice" in done.stderr) == (name == "sides")


def test_sides_along_a_path() -> None:
    path = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, -1.0], [0.5, 0.0]])
    assert approaches_along(path).tolist() == [[0.0, 0.0], [1.0, 0.0], [1.0, -1.0], [-1.0, 1.0]]


@pytest.mark.parametrize("count", [1, 2, 3, 6])
@pytest.mark.parametrize("size", [0.3, 1.0])
def test_quantiles_with_parts_of_either_sign(count: int, size: float) -> None:
    generator = np.random.default_rng(0)
    signed, half = generator.standard_normal((6, count)), 0.5 * size * generator.standard_normal((6, 3))
    mean = 0.5 * size * generator.standard_normal(6)
    signs = generator.choice([-1.0, 1.0], (40000, count))
    drawn = np.linalg.norm(mean + signs @ signed.T + generator.standard_normal((40000, 3)) @ half.T, axis=1)
    bound = norm_quantiles(mean, signed @ signed.T + half @ half.T, 0.95, signed)
    assert bound == pytest.approx(np.quantile(drawn, 0.95), rel=0.1)
