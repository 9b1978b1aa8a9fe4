"""Measurement files: the round trip, and the messages for invalid files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.joint_columns import command_columns
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.plan_file import read_plan

HEADER = "u1_m,u2_m,u3_m,x_m,y_m,z_m,qw,qx,qy,qz"


@pytest.fixture(scope="module")
def measurements(tripod_nominal: Poses) -> Measurements:
    return Measurements.from_poses(tripod_nominal.commands[:12], tripod_nominal.transforms[:12])


@pytest.fixture
def lines(measurements: Measurements, tripod_errors: GeometricErrors, tmp_path: Path) -> list[list[str]]:
    """Cells of a good file, header first, without sigmas."""
    path = write_measurements(measurements, tripod_errors.robot, tmp_path / "good.csv")
    return [line.split(",")[:10] for line in path.read_text().splitlines()]


def read(lines: list[list[str]], errors: GeometricErrors, tmp_path: Path) -> Measurements:
    path = tmp_path / "file.csv"
    path.write_text("\n".join(",".join(line) for line in lines) + "\n")
    return read_measurements(path, errors.robot)


def scaled(lines: list[list[str]], columns: slice, factor: float) -> list[list[str]]:
    header, *rows = lines
    changed = [[*row] for row in rows]
    for row in changed:
        row[columns] = [repr(factor * float(cell)) for cell in row[columns]]
    return [header, *changed]


def test_every_digit_survives(
    measurements: Measurements, tripod_errors: GeometricErrors, tmp_path: Path, tripod_nominal: Poses
) -> None:
    path = write_measurements(measurements, tripod_errors.robot, tmp_path / "file.csv")
    again = read_measurements(path, tripod_errors.robot)
    np.testing.assert_allclose(again.commands, tripod_nominal.commands[:12], atol=1e-16)
    np.testing.assert_array_equal(again.positions, tripod_nominal.positions[:12])
    assert again.rotations is not None
    np.testing.assert_allclose(again.rotations, tripod_nominal.rotations[:12], atol=5e-16)
    assert again.warnings == ()
    assert again.lines == tuple(range(2, 14))


def test_commands_are_what_the_counters_show(lines: list[list[str]], tripod_nominal: Poses) -> None:
    """u = 0.240272 m is joint coordinate 0."""
    assert ",".join(lines[0]) == HEADER
    joints = [tripod_nominal.robot.single_joint(f"slider{leg}_joint").q_index for leg in (1, 2, 3)]
    np.testing.assert_allclose(np.array(lines[1][:3], dtype=float), tripod_nominal.q[0, joints] + 0.240272, atol=1e-15)


def test_columns_of_other_robots(serial_arm: Robot) -> None:
    assert command_columns(serial_arm) == tuple(f"u{k}_rad" for k in range(1, 7))
    assert command_columns(Robot.load("hexapod")) == tuple(f"u{k}_m" for k in range(1, 7))


def test_positions_alone(lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    found = read([line[:6] for line in lines], tripod_errors, tmp_path)
    assert found.measured == "position"
    assert found.rotations is None
    np.testing.assert_allclose(found.sigmas, np.full((12, 3), Instrument().position_sigma))


def test_sigmas_points_and_conditions(lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    more = ["px_m", "py_m", "pz_m", "sigma_x_m", "sigma_y_m", "sigma_z_m", "temperature_screw_K", "load_fz_N"]
    table = [[*lines[0][:6], *more]]
    table += [[*row[:6], "0", "0", "0", "1e-5", "2e-5", "3e-5", str(k), "-50"] for k, row in enumerate(lines[1:])]
    found = read(table, tripod_errors, tmp_path)
    np.testing.assert_array_equal(found.sigmas[3], [1e-5, 2e-5, 3e-5])
    np.testing.assert_array_equal(found.conditions["temperature_screw_K"], np.arange(12))
    np.testing.assert_array_equal(found.conditions["load_fz_N"], np.full(12, -50.0))
    assert not found.points.any()


@pytest.mark.parametrize("column", ["u2_m", "z_m", "qy"])
def test_a_missing_column_is_named(
    column: str, lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    place = lines[0].index(column)
    with pytest.raises(MeasurementError, match=f"no column {column};"):
        read([[*line[:place], *line[place + 1 :]] for line in lines], tripod_errors, tmp_path)


@pytest.mark.parametrize(("columns", "named"), [(slice(0, 3), "u1_m"), (slice(3, 6), "x_m,y_m,z_m")])
def test_millimetres_are_suspected(
    columns: slice, named: str, lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    with pytest.raises(MeasurementError, match=f"{named} .*look like millimetres"):
        read(scaled(lines, columns, 1e3), tripod_errors, tmp_path)


def test_the_point_that_a_wrist_turns_about_is_not_in_millimetres(tmp_path: Path) -> None:
    """The tool is where three axes meet: it stays there, and what is seen of it is the errors of the parts."""
    turns = "".join(
        f'<link name="l{k}"/><joint name="j{k}" type="revolute"><parent link="{parent}"/><child link="l{k}"/>'
        f'<axis xyz="{axis}"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        for k, (parent, axis) in enumerate((("base", "1 0 0"), ("l0", "0 1 0"), ("l1", "0 0 1")))
    )
    (tmp_path / "wrist.urdf").write_text(f'<robot name="wrist"><link name="base"/>{turns}</robot>')
    robot = Robot.load(tmp_path / "wrist.urdf", tool_frame="l2")
    path = tmp_path / "file.csv"
    path.write_text("u1_rad,u2_rad,u3_rad,x_m,y_m,z_m\n0.1,0.2,0.3,1e-4,2e-4,0\n-0.5,0.1,0.4,0,3e-4,1e-4\n")
    found = read_measurements(path, robot)
    np.testing.assert_array_equal(found.positions, [[1e-4, 2e-4, 0.0], [0.0, 3e-4, 1e-4]])
    assert found.warnings == ()


def test_degrees_are_suspected(four_bar: Path, tmp_path: Path) -> None:
    errors = GeometricErrors.load(four_bar)
    path = tmp_path / "file.csv"
    path.write_text("u1_rad,x_m,y_m,z_m\n" + "\n".join(f"{angle},0.3,0.4,0" for angle in (20.0, 30.0, -25.0)) + "\n")
    with pytest.raises(MeasurementError, match=r"lines 2, 3, 4: u1_rad .*look like degrees") as caught:
        read_measurements(path, errors.robot)
    assert caught.value.rows == (2, 3, 4)


def test_a_command_out_of_reach_is_named_by_its_line(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    lines[4][1] = "0.5"
    with pytest.raises(MeasurementError, match=r"line 5: u2_m is far outside the joint's limits 0\.155\d* \.\. 0\.325"):
        read(lines, tripod_errors, tmp_path)


@pytest.mark.parametrize("cell", ["nan", "", "inf"])
def test_rows_without_numbers_are_left_out_and_named(
    cell: str, lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    lines[2][4] = lines[7][0] = cell
    found = read(lines, tripod_errors, tmp_path)
    assert len(found) == 10
    assert found.lines == (2, 4, 5, 6, 7, 9, 10, 11, 12, 13)
    assert found.warnings == ("lines 3, 8: numbers are missing or not finite; left out",)


def test_a_quaternion_that_is_no_rotation(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    lines[6][6] = "0.3"
    with pytest.raises(
        MeasurementError, match=r"line 7: qw,qx,qy,qz is not a rotation: its length is 0\.\d+, expected 1"
    ):
        read(lines, tripod_errors, tmp_path)


def test_copies_and_repeated_commands_are_named(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    moved = [*lines[3]]
    moved[3] = repr(float(moved[3]) + 1e-6)
    found = read([*lines, lines[1], moved], tripod_errors, tmp_path)
    assert len(found) == 14
    assert found.warnings[0].startswith("line 14: copies of earlier lines")
    assert found.warnings[1].startswith("14 rows at 12 different commands")


def test_orientations_alone_need_no_columns_of_positions(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    places = [k for k, name in enumerate(lines[0]) if name not in ("x_m", "y_m", "z_m") and name[:8] != "sigma_x_"]
    turned = [[row[k] for k in places if lines[0][k][:7] not in ("sigma_y", "sigma_z")] for row in lines]
    found = read(turned, tripod_errors, tmp_path)
    assert found.seen.tolist() == [[False] * 3 + [True] * 3] * 12


def test_what_was_measured_twice_to_the_last_digit_is_named(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    lines[4][3:] = lines[3][3:]
    found = read(lines, tripod_errors, tmp_path)
    assert found.warnings[0].startswith("line 5: measurements repeat those of other lines to the last digit, at other")


def test_a_position_far_off_is_named(lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    lines[9][3] = "0.2"
    assert read(lines, tripod_errors, tmp_path).warnings[0].startswith("line 10: positions are more than 0.02")


def test_another_frame_is_suspected(lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    for line in lines[1:]:
        line[5] = repr(float(line[5]) - 0.3)
    assert "other axes, another zero" in read(lines, tripod_errors, tmp_path).warnings[0]


@pytest.mark.parametrize(
    ("order", "signs", "problem"),
    [
        ((1, 2, 3, 0), (1, 1, 1, 1), "qw,qx,qy,qz are in the order x, y, z, w"),
        ((1, 0, 2, 3), (1, 1, 1, 1), "qw,qx,qy,qz are in the order x, w, y, z"),
        ((0, 2, 1, 3), (1, 1, 1, 1), "qw,qx,qy,qz are in the order w, y, x, z"),
        ((0, 3, 2, 1), (1, 1, 1, 1), "qw,qx,qy,qz are in the order w, z, y, x"),
        ((0, 1, 2, 3), (1, -1, -1, -1), "are inverse rotations"),
    ],
)
def test_other_ways_to_write_a_rotation_are_recognised(
    order: tuple[int, ...],
    signs: tuple[int, ...],
    problem: str,
    lines: list[list[str]],
    tripod_errors: GeometricErrors,
    tmp_path: Path,
) -> None:
    for line in lines[1:]:
        quaternion = [float(cell) for cell in line[6:]]
        line[6:] = [repr(sign * quaternion[k]) for sign, k in zip(signs, order, strict=True)]
    with pytest.raises(MeasurementError, match=problem):
        read(lines, tripod_errors, tmp_path)


def test_turned_axes_and_turned_rows_are_named(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    """A quarter turn about the tool's z: q times (1, 0, 0, 1) over the root of two."""
    turned = [[*line] for line in lines]
    for line in turned[1:]:
        w, x, y, z = (float(cell) for cell in line[6:])
        line[6:] = [repr(value / 2**0.5) for value in (w - z, x + y, y - x, z + w)]
    warnings = read([*lines[:5], turned[5], *lines[6:]], tripod_errors, tmp_path).warnings
    assert warnings[0].startswith("line 6: orientations are more than 0.1 rad")
    (warning,) = read(turned, tripod_errors, tmp_path).warnings
    assert warning.startswith("orientations are 1.57 rad (median) from where the description has the machine")


def test_large_sigmas_are_suspected(lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    names = ["sigma_x_m", "sigma_y_m", "sigma_z_m"]
    table = [[*lines[0][:6], *names], *([*row[:6], "0.015", "0.015", "0.015"] for row in lines[1:])]
    assert (
        "sigma_x_m is 0.015 m (median), which is very large: millimetres?"
        in read(table, tripod_errors, tmp_path).warnings
    )


def test_columns_that_are_not_used_are_named(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    table = [[*line, "operator" if k == 0 else "7"] for k, line in enumerate(lines)]
    assert read(table, tripod_errors, tmp_path).warnings == ("columns operator are not used",)


def test_what_spreadsheets_and_trackers_write(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    """Semicolons, decimal commas, a byte order mark, millimetres: 1 mm is 1e-3 m."""
    plain = read(lines, tripod_errors, tmp_path)
    header = [name.replace("_m", "_mm") for name in lines[0]]
    strange = [header, *([*(f"{1e3 * float(cell):.12f}" for cell in row[:6]), *row[6:]] for row in lines[1:])]
    text = "\r\n".join(";".join(line).replace(".", ",") for line in strange)
    path = tmp_path / "strange.csv"
    path.write_text("\ufeff" + text + "\r\n", encoding="utf-8", newline="")
    found = read_measurements(path, tripod_errors.robot)
    assert found.warnings == plain.warnings
    np.testing.assert_allclose(found.commands, plain.commands, atol=1e-14)
    np.testing.assert_allclose(found.positions, plain.positions, atol=1e-14)
    assert found.rotations is not None
    np.testing.assert_array_equal(found.rotations, plain.rotations)


def test_comments_keep_the_numbers_of_lines(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    comments = [["# tracker 7", " Leica"], [""], ["#"]]
    found = read([*comments, *lines[:3], ["# after a pause"], *lines[3:]], tripod_errors, tmp_path)
    assert found.lines[:3] == (5, 6, 8)
    np.testing.assert_array_equal(found.commands, read(lines, tripod_errors, tmp_path).commands)


def test_euler_angles_of_unknown_order_are_refused(
    lines: list[list[str]], tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    table = [[*lines[0][:6], "rx_deg", "ry_deg", "rz_deg"], *([*row[:6], "1", "2", "3"] for row in lines[1:])]
    with pytest.raises(MeasurementError, match="line 1: rx_rad,ry_rad,rz_rad are angles of unknown order"):
        read(table, tripod_errors, tmp_path)


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "no column u1_m"),
        (HEADER + "\n", "no complete row"),
        (HEADER.replace(",", "|") + "\n0.24|0.24\n", "line 1: columns are separated by '|', expected commas"),
        (HEADER.replace(",", ";") + ";y_mm\n", "line 1: column y_m appears more than once"),
        (HEADER + "\n0.24,0.24\n", "line 2: 2 cells, expected 10"),
        (HEADER + "\n0.24,0.24,0.24,zero,0,0.49,1,0,0,0\n", "line 2: x_m is 'zero', expected a number"),
        (HEADER + ",u1_m\n", "line 1: column u1_m appears more than once"),
        (
            HEADER + ",\n0.24,0.24,0.24,0,0,0.49,1,0,0,0,7\n",
            "line 1: column 11 has no name|line 2: 11 cells, expected 10",
        ),
        (HEADER.replace(",", " ") + "\n", "line 1: columns are separated by ' '"),
        (HEADER.replace("u", "v") + "\n", "line 1: no column u1_m"),
        (HEADER.replace("z_m,", "") + "\n", "line 1: no column z_m"),
        (HEADER.replace(",qz", "") + "\n", "line 1: no column qz"),
        (HEADER + ",sigma_x_m\n", "line 1: no column sigma_y_m"),
        (HEADER + "\n0.24,0.24,0.24,1e300,0,0.49,1,0,0,0\n", "line 2: x_m is '1e300', expected a number of at most 1e"),
        (HEADER + "\n0.24,0.24,0.24,1e400,0,0.49,1,0,0,0\n", "line 2: x_m is '1e400', expected a number of at most 1e"),
        (HEADER + "\n0.24,0.24,0.24,0.2 m,0,0.49,1,0,0,0\n", "line 2: x_m is '0.2 m', expected a number"),
        (HEADER + "\n0.24,0.24,0.24,1_0,0,0.49,1,0,0,0\n", "line 2: x_m is '1_0', expected a number"),
        (HEADER + "\n0.24,0.24,0.24,0,0,0.49,1.5,0,0,0\n", "line 2: .* not a rotation: its length is 1.5"),
        ("0.24,0.24,0.24,0,0,0.49,1,0,0,0\n", "line 1: no column u1_m"),
    ],
)
def test_broken_files(text: str, problem: str, tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    path = tmp_path / "file.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError, match=problem):
        read_measurements(path, tripod_errors.robot)
    with pytest.raises(MeasurementError, match="expected a readable file"):
        read_measurements(tmp_path / "missing.csv", tripod_errors.robot)


def test_commands_of_a_plan(tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    path = tmp_path / "plan.csv"
    path.write_text("u1_m,u2_m,u3_m,nominal_x_m\n0.25,0.24,0.23,\n")
    np.testing.assert_allclose(read_plan(path, tripod_errors.robot)[0], [[0.25, 0.24, 0.23]], atol=1e-12)


def test_arrays_that_do_not_fit() -> None:
    with pytest.raises(InvalidValueError, match="positions"):
        Measurements(np.zeros((2, 3)), np.zeros((3, 3)), None, np.ones((2, 3)), np.zeros((2, 3)))
    with pytest.raises(InvalidValueError, match="sigmas"):
        Measurements(np.zeros((2, 3)), np.zeros((2, 3)), None, np.zeros((2, 3)), np.zeros((2, 3)))
