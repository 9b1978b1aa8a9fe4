"""Any measurements of any machine: a calibration is refused with its cause, or is no worse than none."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, rotation_matrix, tip_error
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.measurement_file import write_measurements
from pm3dof_pin.measuring.measurements import Measurements

pytestmark = pytest.mark.usefixtures("few_folds")

POSES = 16
POSITION, ANGLE = 1e-5, 5e-5
ORIGIN = np.array([0.3, 0.2, -0.1])


def _rows(machine: Poses, kind: str, rng: np.random.Generator) -> Measurements:
    """Full poses with columns, or in a mix cells, dropped."""
    count, number = len(machine), np.arange(len(machine)) % 4
    positions = machine.positions + rng.normal(0.0, POSITION, (count, 3))
    rotations = rotation_matrix(rng.normal(0.0, ANGLE, (count, 3))) @ machine.rotations
    places, turns, far = {
        "positions": (True, False, False),
        "heights": (True, False, False),
        "distances": (False, False, True),
        "between": (False, False, True),
        "orientations": (False, True, False),
        "mix": (number < 2, number % 2 == 0, number == 3),
    }[kind]
    sigmas = np.full((count, 6), np.inf)
    sigmas[np.broadcast_to(places, count), :3] = POSITION
    sigmas[np.broadcast_to(turns, count), 3:] = ANGLE
    if kind == "heights":
        sigmas[:, :2] = np.inf
    far = np.broadcast_to(far, count)
    sigmas[far, 0] = POSITION
    begins = np.roll(positions, 1, axis=0) if kind == "between" else np.tile(ORIGIN, (count, 1))
    more = {
        "distances": np.where(far, np.linalg.norm(positions - begins, axis=1), np.nan),
        "origins": np.tile(ORIGIN, (count, 1)),
        "partners": np.roll(np.arange(count), 1) if kind == "between" else np.full(count, -1),
    }
    return Measurements(
        machine.commands, positions, rotations, sigmas, np.zeros((count, 3)), **(more if far.any() else {})
    )


# for each robot, the kind least like poses, and the mix
CASES = [
    ("pm3dof", None, ("between", "mix")),
    ("three_rps", None, ("heights", "mix")),
    ("linear_delta", None, ("orientations", "mix")),
    ("hexapod", None, ("positions", "mix")),
    ("ur5", "tool0", ("distances", "mix")),
]


@pytest.mark.parametrize(("name", "frame", "kinds"), CASES, ids=[case[0] for case in CASES])
def test_a_machine_is_not_made_worse(name: str, frame: str | None, kinds: tuple[str, ...], tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    errors = GeometricErrors.load(name, tool_frame=frame)
    sample, wanted = (reachable_poses(errors.robot, count, rng) for count in (POSES, 20))
    truth = errors.apply(errors.sample(rng))
    machine = truth.forward(sample.commands, guess=sample.q)

    def missed(commands: np.ndarray) -> float:
        reached = truth.forward(commands, guess=wanted.q)
        return float(np.sqrt(np.mean(tip_error(pose_difference(wanted.transforms, reached.transforms)) ** 2)))

    for kind in kinds:
        path = write_measurements(_rows(machine, kind, rng), errors.robot, tmp_path / f"{kind}.csv")
        calibration = calibrate(path, errors, "lm", on_refusal="keep")
        reasons = calibration.refusals
        if kind == "between":
            assert any("no row shows the pose of the tool" in reason for reason in reasons)
        if kind == "mix":
            assert not reasons, (kind, reasons)
        if not reasons:
            assert missed(calibration.compensation.compensate(wanted).commands) <= missed(wanted.commands), kind


@pytest.mark.parametrize("name", ["linear_delta", "hexapod"])
def test_distances_to_several_centres_are_several_observations_of_a_pose(name: str) -> None:
    """Four draw wires at each of 35 poses: 140 equations, of 35 visits; the machine obeys the stated bounds."""
    errors, rng = GeometricErrors.load(name), np.random.default_rng(0)
    poses, wanted = (reachable_poses(errors.robot, count, rng) for count in (35, 60))
    truth = errors.apply(errors.sample(rng))
    rows = np.repeat(np.arange(35), 4)
    centres = poses.positions.mean(axis=0) + 0.5 * np.array([[1, 0, 0.3], [-1, 0.5, 0.3], [0, -1, 0.4], [0.2, 0.3, -1]])
    origins = np.tile(centres, (35, 1))
    reached = truth.forward(poses.commands, guess=poses.q).positions[rows]
    measured = Measurements(
        poses.commands[rows],
        poses.positions[rows],
        None,
        np.tile([1e-5, np.inf, np.inf], (140, 1)),
        np.zeros((140, 3)),
        distances=np.linalg.norm(reached - origins, axis=1) + rng.normal(0.0, 1e-5, 140),
        origins=origins,
        partners=np.full(140, -1),
    )
    found = calibrate(measured, errors, "lm")
    assert found.held_out is not None
    assert len(found.held_out.after) == 35
    answer = found.compensate(wanted)
    missed = [
        tip_error(pose_difference(wanted.transforms, truth.forward(commands, guess=wanted.q).transforms))
        for commands in (wanted.commands, answer.commands)
    ]
    assert np.mean(missed[1] ** 2) < 0.5 * np.mean(missed[0] ** 2)
    assert np.mean(missed[1] < answer.error_bound) > 0.9


@pytest.mark.usefixtures("report_without_pictures")
def test_the_command_takes_them(run: Callable[..., object], tmp_path: Path) -> None:
    """Some cells of the output of `measure` are dropped, then whole columns."""
    run("measure", "--world", "geometry", "--poses", "16", "--out", "all.csv", cwd=tmp_path)
    header, *lines = (line.split(",") for line in (tmp_path / "all.csv").read_text().splitlines())
    for k, line in enumerate(lines):
        for name in ("x_m", "y_m", "z_m") if k % 4 == 0 else ("qw", "qx", "qy", "qz") if k % 4 == 1 else ():
            line[header.index(name)] = ""
    (tmp_path / "some.csv").write_text("\n".join(map(",".join, [header, *lines])) + "\n")
    answer = run("calibrate", "some.csv", "--method", "lm", "--out", "some", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    kept = [k for k, name in enumerate(header) if name in ("u1_m", "u2_m", "u3_m", "z_m", "sigma_z_m")]
    heights = [",".join(line[k] for k in kept) for line in [header, *lines[1:3]]]
    (tmp_path / "heights.csv").write_text("\n".join(heights) + "\n")
    answer = run("calibrate", "heights.csv", "--method", "lm", "--out", "heights", cwd=tmp_path)
    assert answer.returncode == 1
    assert "2 rows give 2 equations" in answer.stderr
    assert not (tmp_path / "heights").exists()
