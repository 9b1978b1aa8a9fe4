"""New rows merged into a calibration: of a machine as it was, with another zero, in a frame of their own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.calibration.calibrate import Calibration
from pm3dof_pin.calibration.recheck import read_history
from pm3dof_pin.calibration.updating import updated
from pm3dof_pin.errors.pose_error import pose_difference
from pm3dof_pin.exceptions import CalibrationRefusedError
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements

Case = tuple[pm.SimulatedMachine, Calibration, np.ndarray, np.random.Generator]


@pytest.fixture(scope="module")
def case() -> Case:
    errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(4)
    machine = pm.SimulatedMachine.random(errors, generator, everything=False)
    commands = pm.reachable_poses(errors.robot, 48, generator).commands
    rows = pm.Measurements.from_poses(commands[:40], machine.measure(commands[:40], generator))
    return machine, pm.calibrate(rows, errors, "lm", on_refusal="keep"), commands[40:], generator


@pytest.mark.parametrize(("moved", "own_frame"), [(0.0, False), (2e-4, False), (0.0, True)])
def test_new_rows_are_merged(
    moved: float, own_frame: bool, case: Case, tmp_path: Path, run: Callable[..., Any]
) -> None:
    """The first counter reads more by `moved` in the second session; then its place is where it read less by this."""
    machine, calibration, commands, _ = case
    generator = np.random.default_rng(6)  # the same noise whichever test runs first
    folder = calibration.save(tmp_path / "calibration")
    robot = calibration.compensation.errors.robot
    shift = np.eye(len(robot.commands))[0] * moved
    seen = pm.Measurements.from_poses(commands, machine.measure(commands - shift, generator))
    if own_frame:
        turn = Rotation.from_rotvec([0.2, -1.0, 2.0]).as_matrix()
        seen = replace(seen, positions=seen.positions @ turn.T + [1.0, 2.0, 3.0], rotations=turn @ seen.rotations)
    write_measurements(seen, robot, tmp_path / "new.csv")
    words = ["recheck", "new.csv", "--calibration", "calibration", "--out", "again"]
    done = run(*words, *(["--own-frame"] if own_frame else []), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    again = pm.read_compensation(tmp_path / "again")
    assert ("station1.tx:" in (tmp_path / "again" / "calibration.yaml").read_text()) == own_frame
    assert read_history(tmp_path / "again")[-1]["verdict"] == ("re-zero" if moved else "unchanged")
    tested = pm.reachable_poses(robot, 60, np.random.default_rng(5))
    before = pm.read_compensation(folder)
    off = {}
    for name, known in (("before", before), ("again", again)):
        predicted = known.poses(robot.forward(tested.commands), known.with_usual_conditions({}))
        true = machine.poses(tested.commands - shift)
        off[name] = float(np.sqrt(np.mean(np.sum((predicted.positions - true[:, :3, 3]) ** 2, axis=1))))
    assert off["again"] < (0.4 if moved else 1.1) * off["before"]
    assert len(read_measurements(tmp_path / "again" / "measurements.csv", robot)) == len(calibration.measurements) + 8


def test_present_zeros_are_known_by_the_new_rows_alone(case: Case, tmp_path: Path) -> None:
    """So the tool is known no better than by a machine of which only the zeros are unknown, from these (H. Cramer)."""
    machine, calibration, commands, _ = case
    folder, robot = calibration.save(tmp_path / "calibration"), calibration.compensation.errors.robot
    shifted = commands - [2e-4, -1e-4, 1e-4]
    seen = pm.Measurements.from_poses(commands, machine.measure(shifted, np.random.default_rng(6)))
    again, found = updated(folder, seen)
    assert found.verdict == "re-zero"
    homings = again.measurements.homings
    assert homings is not None
    np.testing.assert_array_equal(homings, np.repeat([1, 0], [40, 8]))
    step, tested = 1e-6, pm.reachable_poses(robot, 30, np.random.default_rng(5)).commands

    def by_drives(at: np.ndarray) -> np.ndarray:
        ends = [[robot.forward(at + s * e).transforms for s in (-step, step)] for e in np.eye(at.shape[1])]
        return np.stack([pose_difference(*pair) for pair in ends], axis=2) / (2.0 * step)

    rows = by_drives(commands) / seen.sigmas[:, :, None]
    known = np.linalg.inv(np.einsum("nik,nil->kl", rows, rows))
    weights = again.compensation.weights
    effects = by_drives(tested) * weights[:, None]
    least = np.einsum("nik,kl,nil->n", effects, known, effects)
    stated = np.einsum("nii->n", again.compensation.covariances(robot.forward(tested)))
    assert (stated > 0.9 * least).all()
    assert stated.mean() < 4.0 * least.mean()


def test_moved_parts_are_not_merged(case: Case, tmp_path: Path) -> None:
    machine, calibration, commands, generator = case
    folder = calibration.save(tmp_path / "calibration")
    source = machine.geometric
    other = replace(machine, geometric=replace(source, values=source.values + 3.0 * source.errors.tolerances))
    seen = pm.Measurements.from_poses(commands, other.measure(commands, generator))
    with pytest.raises(CalibrationRefusedError, match="parts moved"):
        updated(folder, seen)
