"""Plans of robots without an error file: every machine is assembled at every pose, and the measurements calibrate."""

from __future__ import annotations

import importlib.util
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.assembled import OUT_OF_TOLERANCE
from pm3dof_pin.calibration.measurement_plan import plan_measurements
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.measuring.instrument import Instrument

MACHINES = Path(__file__).parents[1] / "machines"
SCRIPT = Path(__file__).parents[2] / "scripts" / "studies" / "small_robots.py"


@pytest.fixture(scope="module")
def robots(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    spec = importlib.util.spec_from_file_location("small_robots", SCRIPT)
    assert spec is not None
    assert spec.loader is not None
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    found: dict[str, Path] = script.robots(tmp_path_factory.mktemp("robots"))
    assert len(found) >= 24
    return found


@pytest.mark.parametrize("name", ["3-RRS", "five-bar"])
def test_plan_measure_calibrate(robots: dict[str, Path], name: str) -> None:
    everything, generator = pm.GeometricErrors.load(robots[name]), np.random.default_rng(5)
    errors = closable(everything)
    plan = plan_measurements(errors, candidates=300)
    assert plan.can_be_checked
    poses = plan.poses
    for _ in range(15):
        crooked = errors.apply(OUT_OF_TOLERANCE * errors.sample(generator))
        assert crooked.forward(poses.commands, guess=poses.q, on_failure="nan").solved.all()
    machine = errors.apply(errors.sample(generator))
    reached = machine.forward(poses.commands, guess=poses.q).transforms
    noisy = np.array(reached)
    noisy[:, :3, 3] += 7.5e-6 * generator.standard_normal((len(noisy), 3))
    calibration = pm.calibrate(pm.Measurements.from_poses(poses.commands, noisy), everything, "lm")  # not refused
    model = calibration.compensation.model.forward(poses.commands, guess=poses.q).transforms
    assert np.median(tip_error(pose_difference(reached, model))) < 5e-5  # of 300 to 900 µm


def test_a_pose_beyond_the_reach_of_the_described_machine_is_left_out(robots: dict[str, Path]) -> None:
    """The machine itself is assembled there: its links are a little longer than described."""
    errors = closable(pm.GeometricErrors.load(robots["five-bar"]))
    generator, robot = np.random.default_rng(7), errors.robot
    poses = pm.reachable_poses(robot, 40, generator)
    values = 0.5 * errors.sample(generator)
    on_the_way = robot.home.commands + np.linspace(0.0, 1.5, 30_001)[:, None] * [1.0, -1.0]
    machines = [robot, errors.apply(values), errors.apply(-values)]
    described, *real = (int(np.argmin(each.forward(on_the_way, on_failure="nan").solved)) for each in machines)
    assert 0 < described < max(real) - 1
    machine = machines[1 + int(np.argmax(real))]
    rows = np.vstack([poses.commands, on_the_way[(described + max(real)) // 2]])
    measured = np.array(machine.forward(rows).transforms)
    measured[:, :3, 3] += 7.5e-6 * generator.standard_normal((len(rows), 3))
    found = pm.calibrate(pm.Measurements.from_poses(rows, measured), errors, "lm")
    assert any("line" in warning and "left out: so near to a singular pose" in warning for warning in found.warnings)
    assert len(found.measurements) == 40


def test_a_machine_with_too_many_drives_is_measured_and_calibrated(tmp_path: Path, run: Callable[..., Any]) -> None:
    """Its drives contradict each other; near singular poses Gauss-Newton steps alone do not settle."""
    robot = str(shutil.copytree(MACHINES / "four_rrr", tmp_path / "four_rrr"))
    rows, out = str(tmp_path / "rows.csv"), str(tmp_path / "calibration")
    assert run("measure", "--robot", robot, "--poses", "40", "--machine", "3", "--out", rows).returncode == 0
    done = run("calibrate", rows, "--robot", robot, "--method", "lm", "--out", out, "--json")
    assert done.returncode == 0, done.stderr
    assert "left out: so near" not in done.stderr
    errors = json.loads(done.stdout)["held_out"]
    assert errors["tip_error_after_m"]["mean"] < 0.5 * errors["tip_error_before_m"]["mean"]


def test_seven_noisy_poses_are_too_few_to_tell_a_change_in_the_middle() -> None:
    """But not too few to calibrate: residuals of some times the noise are doubted, whatever may explain them."""
    errors = pm.GeometricErrors.load("three_rps")
    generator = np.random.default_rng(3)
    machine = pm.SimulatedMachine.random(errors, generator, everything=False)
    commands = pm.reachable_poses(errors.robot, 7, generator).commands
    usual = Instrument()
    louder = Instrument(position_sigma=3.0 * usual.position_sigma, angle_sigma=3.0 * usual.angle_sigma)
    seen = pm.Measurements.from_poses(commands, machine.measure(commands, generator, instrument=louder))
    calibration = pm.calibrate(seen, errors, "lm")
    assert calibration.identification.noise_factor > 1.5
    assert any("times the noise" in warning for warning in calibration.warnings)


def test_a_calibration_keeps_drives_and_springs_that_its_files_do_not_name(
    tmp_path: Path, run: Callable[..., Any]
) -> None:
    """As --drives and --drive-stiffness name them; without, the commands would be those of other joints, or none."""
    driven = pm.load(MACHINES / "five_bar", drives=["right_motor", "left_motor"], drive_stiffness={"right_motor": 7e3})
    errors = closable(pm.GeometricErrors(driven))
    generator = np.random.default_rng(3)
    machine = pm.SimulatedMachine.random(errors, generator, everything=False)
    commands = pm.reachable_poses(errors.robot, 40, generator).commands
    measurements = pm.Measurements.from_poses(commands, machine.measure(commands, generator))
    folder = pm.calibrate(measurements, errors, "lm").save(tmp_path / "calibration")
    robot = pm.read_compensation(folder).errors.robot
    assert robot.actuated_joints == ("right_motor", "left_motor")
    assert [(spring["joint"], spring["stiffness"]) for spring in robot.springs] == [
        ("left_motor", 5e3),
        ("right_motor", 7e3),
    ]
    # without drives, a file of commands is refused by name
    bare = errors.robot.replace(actuated_joints=(), commands=())
    with pytest.raises(InvalidValueError, match="five_bar has no drives"):
        pm.read_measurements(folder / "measurements.csv", bare)
