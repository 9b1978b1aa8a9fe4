"""Partial measurements: single coordinates, distances, orientations, in any mix of rows of one file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import quaternion, rotation_matrix
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
    """Write a printer owner's measurements: the bed is probed, and marks are printed and measured."""
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
    """Excess length of prints in x and y when the machine is driven by a model of it."""
    printed = machine.forward(model.solve(ENDS).commands).positions
    return np.array([np.linalg.norm(printed[k + 1] - printed[k]) / 0.2 - 1.0 for k in (0, 2)])


def test_two_distances_give_a_printer_its_scale(errors: GeometricErrors, tmp_path: Path) -> None:
    """Under 0.05 % with a probe of 10 um; heights alone leave more than that."""
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
    """Small motions are removed from distances too."""
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
        ("distance_m", "0.3", "needs one starting point"),
        ("qw,qx,qy,qz,note", f"{q},1", "no column x_m"),
        ("z_m,note", f"{height},1", "no column x_m"),
    ):
        path = tmp_path / "file.csv"
        path.write_text(f"u1_m,u2_m,u3_m,{header}\n{u},{row}\n")
        with pytest.raises(MeasurementError, match=problem):
            read_measurements(path, robot)
    path.write_text(f"u1_m,u2_m,u3_m,z_m\n{u},{height}\n{u},\n")
    found = read_measurements(path, robot)
    assert (len(found), found.seen.tolist()) == (1, [[False, False, True]])
    four = "u1_m,u2_m,u3_m,distance_m,sphere\n" + 3 * f"{u},0.0127,1\n"
    path.write_text(four)
    with pytest.raises(MeasurementError, match=r"sphere 1 has 3 rows.* at least 4"):
        read_measurements(path, robot)


def _touched(machine: Robot, robot: Robot, centre: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Return commands with which a tool without orientation touches a sphere: by Newton on the machine's own poses."""
    rng = np.random.default_rng(7)
    ways = rng.standard_normal((24, 3))
    ways[:, 2] = np.abs(ways[:, 2])
    ways *= radius / np.linalg.norm(ways, axis=1)[:, None]
    commands = robot.solve(centre + ways).commands
    return commands, np.linalg.norm(machine.forward(commands).positions - centre, axis=1)


def test_a_sphere_tells_its_centre_and_the_machine(errors: GeometricErrors, tmp_path: Path) -> None:
    """Two spheres are a few millimetres off their assumed places: the result is as with known centres."""
    robot, truth = errors.robot, errors.sample(np.random.default_rng(4))
    machine = errors.apply(truth)
    centres = np.array([[0.05, 0.02, 0.03], [-0.06, -0.03, 0.05]])
    rows = []
    for number, centre in enumerate(centres):
        # every touch has its own distance, as a scanning probe's deflection gives it
        for u, distance in zip(*_touched(machine, robot, centre, 0.025), strict=True):
            rows.append([*u.tolist(), distance, 1e-6, number])
    path = tmp_path / "spheres.csv"
    header = "u1_m,u2_m,u3_m,distance_m,sigma_distance_m,sphere"
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    found = identify(read_measurements(path, robot), errors, prior=3.0, loss="squares")
    assert found.nuisances.names == tuple(f"sphere{k}.{axis}" for k in range(2) for axis in "xyz")
    origins = np.array([datum.origin for datum in found.settled.datums])
    sigmas = found.nuisance_sigmas.reshape(2, 3)
    assert np.all(np.abs(origins - centres) < 4.0 * sigmas)
    assert sigmas.max() < 3e-3
    assert np.abs(found.values - truth).max() < 4.0 * found.sigmas.max()
    again = read_measurements(write_measurements(found.measurements, robot, tmp_path / "b.csv"), robot)
    numbers = np.sum([datum.number * datum.rows for datum in again.datums], axis=0)
    assert numbers.tolist() == [row[-1] for row in rows]


def test_heights_above_a_bed_of_its_own(errors: GeometricErrors, tmp_path: Path) -> None:
    """The bed is 2 mm low and tilted by 3 mrad: `own_frame` finds this, and the heights are the machine's again."""
    robot, machine = errors.robot, errors.apply(errors.sample(np.random.default_rng(3)))
    tilt, low = 3e-3, 2e-3
    commands = robot.solve(BED).commands
    seen = machine.forward(commands).positions
    heights = np.cos(tilt) * seen[:, 2] + np.sin(tilt) * seen[:, 1] + low
    rows = [f"{','.join(map(repr, u))},{z!r},1e-5" for u, z in zip(commands.tolist(), heights.tolist(), strict=True)]
    path = tmp_path / "bed.csv"
    path.write_text("\n".join(["u1_m,u2_m,u3_m,z_m,sigma_z_m", *rows]) + "\n")
    found = identify(read_measurements(path, robot, own_frame=True), errors, loss="squares")
    registration = found.measurements.registration
    assert registration is not None
    # up of the bed in the base's axes; end stops tilt it too, as far as their tolerances go
    off = registration.rotation[:, 2] - [0.0, np.sin(tilt), np.cos(tilt)]
    sigmas = found.nuisance_sigmas[[4, 3]]
    assert np.all(np.abs(off[:2]) < 3.0 * sigmas)
    assert sigmas.max() < 3e-3
    assert np.abs(found.normalized_residuals[found.measurements.seen]).max() < 0.5


def test_an_instruments_own_frame_and_distances_in_one_file(errors: GeometricErrors, tmp_path: Path) -> None:
    """Positions from a tracker along with step-gauge lengths and distances from a point that the tracker measured."""
    robot, truth = errors.robot, errors.sample(np.random.default_rng(5))
    machine = errors.apply(truth)
    commands, marks = robot.solve(np.add(BED, [0.0, 0.0, 0.05])).commands, robot.solve(ENDS).commands
    turn, shift = rotation_matrix([0.3, -0.2, 1.1]), np.array([2.0, -1.0, 0.4])
    seen = machine.forward(commands).positions @ turn.T + shift
    ends = machine.forward(marks).positions
    post = np.array([0.2, 0.1, 0.1])
    rows = [[*u, *x, *[""] * 8] for u, x in zip(commands.tolist(), seen.tolist(), strict=True)]
    rows.append([*marks[1].tolist(), *[""] * 3, np.linalg.norm(ends[1] - ends[0]), 1e-5, *marks[0].tolist(), *[""] * 3])
    for u, end in zip(marks.tolist(), ends, strict=True):
        rows.append([*u, *[""] * 3, np.linalg.norm(end - post), 1e-5, *[""] * 3, *(turn @ post + shift).tolist()])
    header = "u1_m,u2_m,u3_m,x_m,y_m,z_m,distance_m,sigma_distance_m,from_u1_m,from_u2_m,from_u3_m,cx_m,cy_m,cz_m"
    path = tmp_path / "mixed.csv"
    path.write_text("\n".join([header, *(",".join(map(str, row)) for row in rows)]) + "\n")
    measurements = read_measurements(path, robot, own_frame=True)
    assert measurements.seen.sum() == 3 * len(BED) + 5
    found = identify(measurements, errors, loss="squares")
    assert np.abs(found.normalized_residuals[found.measurements.seen]).max() < 0.5
    registration = found.measurements.registration
    assert registration is not None
    np.testing.assert_allclose(registration.rotation @ turn, np.eye(3), atol=3e-3)
