"""Planes, lines, sockets and cameras of unknown placement: against a hexapod in NumPy, and finite differences."""

from __future__ import annotations

import tracemalloc
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.datum import Datum, axes_of_extents, narrowness
from pm3dof_pin.measuring.instruments.table import datum_kinds
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements

SIGMA = 2e-6
LENGTHS = tuple(f"strut{k}_tip.tz" for k in range(1, 7))
CAMERA = Rotation.from_euler("xyz", [2.9, 0.2, 0.4]).as_matrix()
CAMERA_PLACE = np.array([0.05, -0.08, 0.9])
FOCAL, CENTRE = 4000.0, 1024.0


def test_axes_of_many_points_take_memory_in_proportion_to_them() -> None:
    """Extents of 0.5, 0.2 and 0 along turned axes; all left singular vectors would take 8 n^2 bytes."""
    turn = Rotation.from_euler("xyz", [0.3, -0.7, 1.1]).as_matrix()
    across, along = np.meshgrid(np.linspace(-0.2, 0.2, 41), np.linspace(-0.5, 0.5, 101))
    points = np.stack([along.ravel(), across.ravel(), np.zeros(across.size)], axis=1) @ turn.T
    tracemalloc.start()
    axes = axes_of_extents(points)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 10 * points.nbytes
    np.testing.assert_allclose(np.abs(np.einsum("ij,ji->i", axes, turn)), 1.0, atol=1e-12)
    assert narrowness(points, axes) == pytest.approx(0.4)


@pytest.fixture(scope="module")
def errors() -> GeometricErrors:
    return GeometricErrors.load("hexapod").select(LENGTHS)


@dataclass
class Hexapod:
    """Struts between points of base and platform, as the description has them at home; lengths from Pythagoras."""

    base: np.ndarray
    platform: np.ndarray
    shortest: np.ndarray
    home: np.ndarray

    @classmethod
    def of(cls, errors: GeometricErrors) -> Hexapod:
        robot = errors.robot
        at = robot.configuration(robot.home.q)
        base, joints = (
            np.array([at.frame_placement(name.format(k)).translation for k in range(1, 7)])
            for name in ("universal{}_first_joint", "B{}")
        )
        tool = at.tool_placement
        platform = (joints - tool.translation) @ tool.rotation
        lengths = np.linalg.norm(joints - base, axis=1)
        return cls(base, platform, lengths - robot.home.commands.ravel(), tool.translation)

    def commands(self, place: np.ndarray, turn: np.ndarray, longer: np.ndarray) -> np.ndarray:
        """Readings of the drives of a machine with longer struts."""
        reach = np.linalg.norm(place + self.platform @ turn.T - self.base, axis=1)
        return np.asarray(reach - self.shortest - longer)


def _touches(kind: str, hexapod: Hexapod, longer: np.ndarray, generator: np.random.Generator) -> tuple[str, list[str]]:
    """Return the header and rows of a file: poses that touch exactly, and noise on the number or on the commands."""
    rows = []
    normal = np.array([0.03, -0.02, 1.0]) / np.linalg.norm([0.03, -0.02, 1.0])
    along = np.array([1.0, 0.1, 0.05]) / np.linalg.norm([1.0, 0.1, 0.05])
    for _ in range(60):
        place = hexapod.home + generator.uniform(-6e-3, 6e-3, 3)
        turn = Rotation.from_rotvec(generator.uniform(-0.05, 0.05, 3)).as_matrix()
        cells: list[float] = [1]
        # points beside the tool point, so that turning shows
        point = generator.uniform(-0.03, 0.03, 3) if kind in ("plane", "camera") else np.zeros(3)
        noise = generator.normal(scale=SIGMA, size=3)
        if kind == "plane":
            height = (place + turn @ point - hexapod.home - [0.0, 0.0, 0.001]) @ normal
            cells += [height + noise[0], SIGMA]
        elif kind == "line":
            place = hexapod.home + 1e-3 + along * ((place - hexapod.home) @ along)
            place = place + noise - along * (noise @ along)
            cells += [SIGMA]
        elif kind == "socket":
            place = hexapod.home + 1e-3 + noise
            cells += [SIGMA]
        else:
            x, y, z = CAMERA @ (place + turn @ point - CAMERA_PLACE)
            pixel = SIGMA / z * FOCAL
            cells += [
                FOCAL * x / z + CENTRE + pixel * noise[0] / SIGMA,
                FOCAL * y / z + CENTRE + pixel * noise[1] / SIGMA,
            ]
            cells += [FOCAL, FOCAL, CENTRE, CENTRE, pixel]
        row = [*hexapod.commands(place, turn, longer), *cells, *point]
        rows.append(",".join(repr(float(cell)) for cell in row))
    own = {"plane": "height_m,sigma_touch_m", "line": "sigma_touch_m", "socket": "sigma_touch_m"}
    image = "image_u_px,image_v_px,focal_u_px,focal_v_px,centre_u_px,centre_v_px,sigma_image_px"
    drives = ",".join(f"u{k}_m" for k in range(1, 7))
    return f"{drives},{kind},{own.get(kind, image)},px_m,py_m,pz_m", rows


@pytest.mark.parametrize("kind", ["plane", "line", "socket", "camera"])
def test_strut_lengths_are_identified(kind: str, errors: GeometricErrors, tmp_path: Path) -> None:
    """As their covariance says."""
    generator = np.random.default_rng(5)
    hexapod, longer = Hexapod.of(errors), np.array([80, -120, 60, 150, -40, -100]) * 1e-6
    header, rows = _touches(kind, hexapod, longer, generator)
    path = tmp_path / "touches.csv"
    path.write_text("\n".join([header, *rows]))
    seen = read_measurements(path, errors.robot, target_sigma=0.0)
    assert seen.warnings == ()
    found = identify(seen, errors, loss="squares")
    assert found.nuisances.names[0].startswith(f"{kind}1.")
    assert len(found.nuisances) == len(datum_kinds()[kind].moves)
    covariance = found.covariance[:6, :6]
    off = found.values[:6] - longer
    square = off @ np.linalg.solve(covariance, off)
    assert square < 22.5  # 99.9 % of six
    # what cannot be told is a shift of everything, not the differences between struts
    assert np.sort(np.sqrt(np.linalg.eigvalsh(covariance)))[:3].max() < 2e-5
    again = read_measurements(
        write_measurements(seen, errors.robot, tmp_path / "again.csv"), errors.robot, target_sigma=0.0
    )
    poses = errors.robot.forward(seen.commands)
    np.testing.assert_allclose(again.residuals(poses), seen.residuals(poses), atol=1e-9)
    np.testing.assert_allclose(again.sigmas, seen.sigmas, rtol=1e-6)


def test_a_few_wrong_targets_do_not_move_a_camera(errors: GeometricErrors, tmp_path: Path) -> None:
    """Four of 60 rows have each other's targets; a mirrored image has the camera before the points nowhere."""
    hexapod, longer = Hexapod.of(errors), np.array([80, -120, 60, 150, -40, -100]) * 1e-6
    header, rows = _touches("camera", hexapod, longer, np.random.default_rng(5))
    cells = [row.split(",") for row in rows]
    for one, other in ((4, 5), (20, 31)):
        cells[one][-3:], cells[other][-3:] = cells[other][-3:], cells[one][-3:]
    path = tmp_path / "touches.csv"
    path.write_text("\n".join([header, *map(",".join, cells)]))
    found = identify(read_measurements(path, errors.robot, target_sigma=0.0), errors)
    assert found.outliers == (4, 5, 20, 31)
    off = found.values - longer
    assert off @ np.linalg.solve(found.covariance, off) < 22.5  # 99.9 % of six
    at = header.split(",").index("image_u_px")
    for row in cells:
        row[at] = repr(2.0 * CENTRE - float(row[at]))
    path.write_text("\n".join([header, *map(",".join, cells)]))
    with pytest.raises(MeasurementError, match="sees a mirrored image"):
        read_measurements(path, errors.robot, target_sigma=0.0)


def test_rows_have_the_derivatives_of_finite_differences(errors: GeometricErrors, tmp_path: Path) -> None:
    """By errors of a machine a tolerance off, for all kinds in one file."""
    generator = np.random.default_rng(1)
    poses = reachable_poses(errors.robot, 35, generator)
    at = errors.sample(generator)
    machine = errors.apply(at).forward(poses.commands, guess=poses.q)
    datums = []
    for k, (kind, entry) in enumerate(datum_kinds().items()):
        values = np.full((35, entry.dimension), np.nan)
        own = slice(7 * k, 7 * k + 7)
        if kind == "camera":
            seen = (machine.positions[own] - CAMERA_PLACE) @ CAMERA.T
            values[own] = seen[:, :2] / seen[:, 2:]
        else:
            values[own] = 0.0
        datums.append(Datum.fitted(entry, 1, machine.positions, values))
    sigmas = np.full((35, 3), np.inf)
    for datum in datums:
        sigmas[datum.rows, : datum.values.shape[1]] = SIGMA
    rows = Measurements(poses.commands, poses.positions, None, sigmas, np.full((35, 3), 0.01), datums=tuple(datums))
    motions = sensitivities(errors, machine, at).errors
    step = 1e-6
    for k in range(6):
        ahead, back = (
            rows.residuals(errors.apply(at + sign * step * np.eye(6)[k]).forward(poses.commands, guess=machine.q))
            for sign in (1.0, -1.0)
        )
        expected = np.where(rows.seen, -(ahead - back) / (2.0 * step), 0.0)
        found = np.where(rows.seen, rows.derivatives(machine, motions)[:, :, k], 0.0)
        np.testing.assert_allclose(found, expected, atol=5e-7)
        shifted = rows.without_motions(machine, step * motions[:, :, k])
        change = np.where(rows.seen, shifted.residuals(machine) - rows.residuals(machine), 0.0)
        np.testing.assert_allclose(change, -step * found, atol=1e-10)
    some = rows[np.arange(5, 16)]
    np.testing.assert_array_equal(some.residuals(machine[5:16]), rows.residuals(machine)[5:16])


@pytest.mark.parametrize(
    ("header", "cells", "says"),
    [
        ("plane", ["1"] * 3, "plane 1 has 3 rows: expected at least 4|plane 1 has 3 rows, expected at least 4"),
        ("plane", ["1.5"] * 5, "plane is a number of datums"),
        ("line,x_m,y_m,z_m", ["1,0,0,0.13"] * 4, "a row has a datum and other measurements"),
        ("camera", ["1"] * 7, "no column image_u_px"),
        ("socket,sigma_touch_m", ["1,0"] * 3, "sigma_touch_m is not positive"),
    ],
)
def test_what_cannot_be_is_refused_with_lines(
    header: str, cells: list[str], says: str, errors: GeometricErrors, tmp_path: Path
) -> None:
    path = tmp_path / "wrong.csv"
    drives = ",".join(f"u{k}_m" for k in range(1, 7))
    lines = [",".join(["0.001"] * 5 + [f"0.00{k}"]) + "," + cell for k, cell in enumerate(cells)]
    path.write_text("\n".join([f"{drives},{header}", *lines]))
    with pytest.raises(MeasurementError, match=says):
        read_measurements(path, errors.robot)


def test_pixels_by_both_focal_lengths_are_tangents() -> None:
    """u = c_u + f_u X / Z, v = c_v + f_v Y / Z; noise is along u."""
    x, y, z = np.array([[0.1, -0.2, 2.0], [0.3, 0.1, 1.5]]).T
    focal_u, focal_v, centre_u, centre_v = 1500.0, 1200.0, 640.0, 360.0
    cells = np.column_stack([centre_u + focal_u * x / z, centre_v + focal_v * y / z])
    given = np.tile([focal_u, focal_v, centre_u, centre_v], (2, 1))
    tangents, change = datum_kinds()["camera"].read(np.hstack([cells, given]))
    np.testing.assert_allclose(tangents, np.column_stack([x / z, y / z]), atol=1e-12)
    np.testing.assert_allclose(change, 1.0 / focal_u)


@pytest.mark.parametrize("height", [0.4, -0.02])
def test_the_square_of_a_height_above_a_plane_has_the_derivatives_of_finite_differences(height: float) -> None:
    """Distances of points of a plane from a centre off it; below a height of zero they are too short for any place."""
    generator, kind = np.random.default_rng(1), datum_kinds()["sphere"]
    axes = Rotation.from_rotvec([0.3, -0.4, 0.2]).as_matrix()
    points = np.column_stack([generator.normal(size=(8, 2)), np.zeros(8)]) @ axes
    origin = axes.T @ [0.1, 0.2, height]
    distances = np.linalg.norm(points - origin, axis=1)
    datum = Datum(kind, 1, axes, origin, distances[:, None], np.ones(8), height, 0.7)
    for k in range(3):
        twist = 1e-6 * np.eye(3)[k]
        ahead, back = (datum.moved(sign * twist).residuals(points) for sign in (1.0, -1.0))
        np.testing.assert_allclose(datum.by_placement(points)[:, :, k], -(ahead - back) / 2e-6, rtol=1e-6, atol=1e-7)
    beyond = 0.01  # by so much the squares of the distances are below those from the plane itself
    short = np.sqrt(np.sum((points - axes.T @ [0.1, 0.2, 0.0]) ** 2, axis=1) - beyond)
    datum = Datum(kind, 1, axes, origin, short[:, None], np.ones(8), height, 0.7)
    moved = datum.moved(np.array([0.0, 0.0, -(beyond + height**2) / (2.0 * 0.7)]))
    np.testing.assert_allclose(moved.residuals(points), 0.0, atol=1e-12)


def test_placements_and_points_have_the_derivatives_of_finite_differences() -> None:
    generator = np.random.default_rng(0)
    for entry in datum_kinds().values():
        points = generator.normal(size=(8, 3)) + np.array([0.0, 0.0, 6.0])
        axes = Rotation.from_rotvec(generator.normal(scale=0.3, size=3)).as_matrix()
        values = generator.normal(size=(8, entry.dimension))
        datum = Datum(entry, 1, axes, np.array([0.1, -0.2, 0.3]), values, generator.uniform(1.0, 2.0, 8))
        step = 1e-6
        for k in range(3):
            ahead, back = (datum.residuals(points + sign * step * np.eye(3)[k]) for sign in (1.0, -1.0))
            np.testing.assert_allclose(datum.directions(points)[:, :, k], -(ahead - back) / (2 * step), atol=1e-8)
        for k in range(len(entry.moves)):
            twist = step * np.eye(len(entry.moves))[k]
            ahead, back = (datum.moved(sign * twist).residuals(points) for sign in (1.0, -1.0))
            np.testing.assert_allclose(datum.by_placement(points)[:, :, k], -(ahead - back) / (2 * step), atol=1e-8)
            moved = np.einsum("ndi,ni->nd", datum.directions(points), datum.apparent_motions(points)[:, :, k])
            np.testing.assert_allclose(moved, datum.by_placement(points)[:, :, k], atol=1e-9)
