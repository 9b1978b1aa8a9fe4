"""Less than poses: single coordinates, distances, orientations, in any mix of rows of one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements

BED = np.array([[r * np.cos(a), r * np.sin(a), 0.0] for r in (0.05, 0.1) for a in np.radians(np.arange(0, 360, 45))])
ENDS = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.0, 0.1, 0.0]])


@pytest.fixture(scope="module")
def errors() -> GeometricErrors:
    places = [f"carriage{i}_joint.t{axis}" for axis in "zxy" for i in (1, 2, 3)]
    rods = [f"rod{i}_{side}_tip.tz" for i in (1, 2, 3) for side in ("left", "right")]
    return GeometricErrors.load("linear_delta").select([*places, *rods])


def _file(robot: Robot, machine: Robot, path: Path, rng: np.random.Generator, *, distances: bool) -> Path:
    """Write what a printer's owner measures: the bed is touched, and marks are printed and measured."""
    touched, marks = machine.solve(BED).commands, robot.solve(ENDS).commands
    lines = [[*u, rng.normal(0.0, 1e-5), 1e-5, "", "", "", "", ""] for u in touched.tolist()]
    if distances:
        printed = machine.forward(marks).positions
        for k in (0, 2):
            length = np.linalg.norm(printed[k + 1] - printed[k]) + rng.normal(0.0, 2e-5)
            lines.append([*marks[k + 1].tolist(), "", "", length, 2e-5, *marks[k].tolist()])
    header = "u1_m,u2_m,u3_m,z_m,sigma_z_m,distance_m,sigma_distance_m,from_u1_m,from_u2_m,from_u3_m"
    path.write_text("\n".join([header, *(",".join(map(str, line)) for line in lines)]) + "\n")
    return path


def _scale(machine: Robot, model: Robot) -> np.ndarray:
    """By how much parts are too long in x and y when the machine is driven by a model of it."""
    printed = machine.forward(model.solve(ENDS).commands).positions
    return np.array([np.linalg.norm(printed[k + 1] - printed[k]) / 0.2 - 1.0 for k in (0, 2)])


def test_two_distances_give_a_printer_its_scale(errors: GeometricErrors, tmp_path: Path) -> None:
    """Under 0.05 % with a probe of 10 um, where heights alone leave more than as much."""
    robot, left = errors.robot, {False: [], True: []}
    for seed in range(3):
        rng = np.random.default_rng(seed)
        true = errors.sample(rng)
        true[-6:] = np.repeat(5.0 * true[-6::2], 2)  # rods half a millimetre too long, in pairs
        machine = errors.apply(true)
        for distances, found in left.items():
            path = _file(robot, machine, tmp_path / "seen.csv", np.random.default_rng(50 + seed), distances=distances)
            result = identify(read_measurements(path, robot), errors, prior=5.0, loss="squares")
            found.append(np.abs(_scale(machine, errors.apply(result.values))).max())
    assert max(left[True]) < 5e-4
    assert max(left[False]) > 2.0 * max(left[True])


@pytest.fixture(scope="module")
def mixed(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> tuple[Measurements, Poses]:
    """A pose, a position, a height, an inclination, distances from a point and from another row."""
    truth = tripod_errors.sample(np.random.default_rng(2))
    nominal = tripod_nominal[:7]
    machine = tripod_errors.apply(truth).forward(nominal.commands, guess=nominal.q)
    sigmas = np.full((7, 6), np.inf)
    sigmas[0] = 1e-5
    sigmas[1, :3] = sigmas[2, 2] = sigmas[3, 3:5] = sigmas[4, 0] = sigmas[5, 0] = 1e-5
    points = np.zeros((7, 3))
    points[4:] = [0.05, 0.02, -0.01]
    ends = machine.positions + np.einsum("nij,nj->ni", machine.rotations, points)
    origin = np.array([0.1, 0.3, 0.2])
    distances = np.full(7, np.nan)
    distances[4], distances[5] = np.linalg.norm(ends[4] - origin), np.linalg.norm(ends[5] - ends[6])
    partners = np.full(7, -1)
    partners[5] = 6
    found = Measurements(
        nominal.commands,
        ends,
        machine.rotations,
        sigmas,
        points,
        distances=distances,
        origins=np.tile(origin, (7, 1)),
        partners=partners,
    )
    return found, nominal


def test_derivatives_are_those_of_finite_differences(
    mixed: tuple[Measurements, Poses], tripod_errors: GeometricErrors
) -> None:
    measurements, nominal = mixed
    rows = measurements.derivatives(nominal, sensitivities(tripod_errors, nominal).errors)
    for k in range(0, len(tripod_errors), 4):
        step = 1e-6 * (np.arange(len(tripod_errors)) == k)
        ahead, back = (
            measurements.residuals(tripod_errors.apply(p).forward(nominal.commands, guess=nominal.q))
            for p in (step, -step)
        )
        seen = measurements.seen
        np.testing.assert_allclose(rows[:, :, k][seen], -((ahead - back) / 2e-6)[seen], atol=2e-8)


def test_a_machine_without_noise_leaves_no_residual(
    mixed: tuple[Measurements, Poses], tripod_errors: GeometricErrors
) -> None:
    """Small motions that are taken off are those of the distances, too."""
    measurements, nominal = mixed
    truth = tripod_errors.sample(np.random.default_rng(2))
    machine = tripod_errors.apply(truth).forward(nominal.commands, guess=nominal.q)
    assert np.abs(measurements.residuals(machine)[measurements.seen]).max() < 1e-12
    motions = 1e-6 * np.random.default_rng(0).standard_normal((7, 6))
    taken_off = measurements.without_motions(machine, motions)
    predicted = measurements.derivatives(machine, motions[:, :, None])[:, :, 0]
    left = -taken_off.residuals(machine)
    np.testing.assert_allclose(left[measurements.seen], predicted[measurements.seen], atol=1e-10)


def test_rows_lose_a_distance_without_its_other_end(mixed: tuple[Measurements, Poses]) -> None:
    measurements, _ = mixed
    turned = measurements[[6, 5]]
    assert turned.partners is not None
    assert turned.partners.tolist() == [-1, 0]
    assert not measurements[:6].seen[5].any()
    assert measurements[:6].seen[4].tolist() == [True, *[False] * 5]


def test_a_mixed_file_comes_back(mixed: tuple[Measurements, Poses], tmp_path: Path) -> None:
    measurements, nominal = mixed
    again = read_measurements(write_measurements(measurements, nominal.robot, tmp_path / "a.csv"), nominal.robot)
    assert len(again) == 7
    np.testing.assert_array_equal(again.seen, measurements.seen)
    expected = measurements.residuals(nominal)
    np.testing.assert_allclose(again.residuals(nominal)[again.seen], expected[again.seen], atol=1e-15)


def test_what_is_wrong_with_partial_rows_is_named(tripod_nominal: Poses, tmp_path: Path) -> None:
    robot, u = tripod_nominal.robot, ",".join(map(str, tripod_nominal.commands[0]))
    q = ",".join(map(str, quaternion(tripod_nominal.rotations[:1])[0]))
    height = tripod_nominal.positions[0, 2]
    for header, row, problem in (
        ("z_m,distance_m,cx_m,cy_m,cz_m", f"{height},0.3,0,0,0", "expected a row for each"),
        ("distance_m", "0.3", "from where"),
        ("qw,qx,qy,qz", q, "no column x_m"),
        ("z_m,note", f"{height},1", "no column x_m"),
    ):
        path = tmp_path / "file.csv"
        path.write_text(f"u1_m,u2_m,u3_m,{header}\n{u},{row}\n")
        with pytest.raises(MeasurementError, match=problem):
            read_measurements(path, robot)
    path.write_text(f"u1_m,u2_m,u3_m,z_m\n{u},{height}\n{u},\n")
    found = read_measurements(path, robot)
    assert (len(found), found.seen.tolist()) == (1, [[False, False, True]])
    with pytest.raises(MeasurementError, match="its own frame"):
        read_measurements(path, robot, own_frame=True)
