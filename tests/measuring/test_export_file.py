"""Exports of instruments: each form gives the measurements of the plain file, each damage one clear message."""

from __future__ import annotations

import random
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.exceptions import DescriptionError, MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import PROFILES, ColumnMap
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.plan_file import read_plan

FIVE_BAR = Path(__file__).parents[1] / "machines" / "five_bar"
HEADER = "u1_m,u2_m,u3_m,x_m,y_m,z_m"


@pytest.fixture(scope="module")
def plain(tripod_nominal: Poses, tmp_path_factory: pytest.TempPathFactory) -> tuple[list[list[str]], Measurements]:
    """Cells of commands and positions without a header, and what is read from them."""
    poses = tripod_nominal[:12]
    rows = np.column_stack([poses.commands, poses.positions])
    cells = [[f"{number:.7f}" for number in row] for row in rows]
    path = tmp_path_factory.mktemp("plain") / "plain.csv"
    path.write_text("\n".join([HEADER, *map(",".join, cells)]))
    return cells, read_measurements(path, poses.robot)


def millimetres(cells: list[list[str]]) -> list[list[str]]:
    return [[f"{1e3 * float(cell):.4f}" for cell in row] for row in cells]


def table(header: str, rows: list[list[str]], mark: str = ",", end: str = "\n") -> str:
    return end.join([header, *(mark.join(row) for row in rows)]) + end


def with_cell(text: str, cell: str) -> str:
    """Return a text with another y_m on line 4."""
    lines = text.splitlines()
    lines[3] = ",".join([*lines[3].split(",")[:4], cell, *lines[3].split(",")[5:]])
    return "\n".join(lines)


FORMS: dict[str, Callable[[list[list[str]]], bytes]] = {
    "brackets": lambda c: table("U1 [mm],U2 [mm],U3 [mm],X [mm],Y [mm],Z [mm]", millimetres(c)).encode(),
    "parentheses": lambda c: table("u1(mm),u2(mm),u3(mm),x (mm),y (mm),z (mm)", millimetres(c)).encode(),
    "a blank before the unit": lambda c: table("U1 mm,U2 mm,U3 mm,X mm,Y mm,Z mm", millimetres(c)).encode(),
    "capitals": lambda c: table(HEADER.upper().replace("_M", "_m"), c).encode(),
    "UTF-16": lambda c: table(HEADER, c).encode("utf-16"),
    "UTF-16 without a mark": lambda c: table(HEADER, c).encode("utf-16-le"),
    "UTF-8 with a mark": lambda c: table(HEADER, c).encode("utf-8-sig"),
    "degree sign in Latin-1": lambda c: table(HEADER + ",note [\u00b0]", [[*r, "1"] for r in c]).encode("latin-1"),
    "comments": lambda c: ("# of a tracker\n// job 12\n% 3\n" + table(HEADER, c)).encode(),
    "lines before the header": lambda c: (
        "Leica AT960;SN 750123\nOperator: A. B., lab 3\n\n" + table(HEADER, c)
    ).encode(),
    "a header in a comment": lambda c: ("// Units\n// " + table(HEADER, c)).encode(),
    "commas at the end": lambda c: table(HEADER + ",", [[*row, ""] for row in c]).encode(),
    "commas at the end of rows": lambda c: table(HEADER, [[*row, ""] for row in c]).encode(),
    "semicolons, decimal commas": lambda c: table(HEADER, c, ";").replace(",", ";").replace(".", ",").encode(),
    "tabs": lambda c: table(HEADER, c, "\t").replace(",", "\t").encode(),
    "sep=": lambda c: ("sep=|\n" + table(HEADER.replace(",", "|"), c, "|")).encode(),
    "Windows line ends": lambda c: table(HEADER, c, end="\r\n").encode(),
    "words": lambda c: table("Target," + HEADER, [[f"P{k}", *row] for k, row in enumerate(c)]).encode(),
    "a row of units": lambda c: table(
        "U1,U2,U3,X,Y,Z",
        [["m"] * 3 + ["[mm]"] * 3] + [[*a[:3], *b[3:]] for a, b in zip(c, millimetres(c), strict=True)],
    ).encode(),
    "headers repeated": lambda c: table(HEADER, [*c[:4], HEADER.split(","), *c[4:]]).encode(),
    "quoted cells": lambda c: table(HEADER, [[f'"{cell}"' for cell in row] for row in c]).encode(),
}


@pytest.mark.parametrize("form", FORMS)
def test_a_form_changes_nothing(
    form: str, plain: tuple[list[list[str]], Measurements], tripod_nominal: Poses, tmp_path: Path
) -> None:
    cells, expected = plain
    path = tmp_path / "export.csv"
    path.write_bytes(FORMS[form](cells))
    found = read_measurements(path, tripod_nominal.robot)
    np.testing.assert_allclose(found.commands, expected.commands, atol=1e-12)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-12)
    first = path.read_bytes()[:2]
    lines = path.read_text("utf-16" if first == b"\xff\xfe" else "utf-16-le" if first[1:] == b"\0" else "latin-1")
    digits = cells[0][1].replace(".", "[.,]") + "|" + millimetres(cells)[0][1].replace(".", "[.,]")
    assert re.search(digits, lines.splitlines()[found.lines[0] - 1])


def test_iso_times_are_seconds(
    plain: tuple[list[list[str]], Measurements], tripod_nominal: Poses, tmp_path: Path
) -> None:
    for text, step in (
        ("2026-03-29T00:59:{:02d}.250Z", 1.0),
        ("2026-03-29 00:{:02d}:00+02:00", 60.0),
        ("7:{:02d}:09", 60.0),
    ):
        rows = [[*row, text.format(k)] for k, row in enumerate(plain[0])]
        path = tmp_path / "times.csv"
        path.write_text(table(HEADER + ",Timestamp", rows))
        times = read_measurements(path, tripod_nominal.robot).times
        assert times is not None
        np.testing.assert_allclose(np.diff(times), step, atol=1e-6)
    # a clock without a date at midnight, and times of which some have no zone
    around = [f"23:59:{50 + k}" for k in range(10)] + ["00:00:00", "0:00:01.0"]
    path.write_text(table(HEADER + ",Time", [[*row, text] for row, text in zip(plain[0], around, strict=True)]))
    times = read_measurements(path, tripod_nominal.robot).times
    assert times is not None
    np.testing.assert_allclose(np.diff(times), 1.0, atol=1e-6)
    mixed = [f"2026-03-29T00:00:{k:02d}{'Z' if k == 7 else ''}" for k in range(12)]
    path.write_text(table(HEADER + ",Time", [[*row, text] for row, text in zip(plain[0], mixed, strict=True)]))
    with pytest.raises(MeasurementError, match="lines 2, 9: some times have a zone"):
        read_measurements(path, tripod_nominal.robot)
    # Python's own calendar: seconds of 2026-03-28 23:00 UTC
    path.write_text(table(HEADER + ",time", [[*row, "2026-03-29T00:00:00+01:00"] for row in plain[0]]))
    times = read_measurements(path, tripod_nominal.robot).times
    assert times is not None
    assert times[0] == (20540 * 24 + 23) * 3600.0


@pytest.mark.parametrize(
    ("heading", "factor"),
    [
        *(
            (heading, 1.0)
            for heading in ("t [s]", "T [s]", "T_s", "t/s", "time, s", "Elapsed Time [s]", "Time Stamp (sec)")
        ),
        *((heading, 1e-3) for heading in ("time (ms)", "t [ms]", "T ms", "t_ms")),
        *((heading, 1e-6) for heading in ("t [µs]", "time_us")),
        *((heading, 60.0) for heading in ("t [min]", "time (minutes)")),
        ("Time [h]", 3600.0),
    ],
)
def test_times_need_no_map(
    heading: str, factor: float, plain: tuple[list[list[str]], Measurements], tripod_nominal: Poses, tmp_path: Path
) -> None:
    path, rows = tmp_path / "times.csv", [[*row, str(2 * k)] for k, row in enumerate(plain[0])]
    cell = f'"{heading}"' if "," in heading else heading
    path.write_text(table(f"{HEADER},{cell}", rows))
    times = read_measurements(path, tripod_nominal.robot).times
    assert times is not None
    np.testing.assert_allclose(times, 2.0 * factor * np.arange(len(rows)))


@pytest.mark.parametrize(
    ("headings", "used"),
    [
        (("T [s]", "T [°C]"), 0),
        (("T [K]", "Elapsed [s]"), 1),
        (("t [s]", "Time [s]"), 1),
        (("elapsed_time [ms]", "t_s"), 1),
        (("T [°C]", "t_min [m]"), None),
        (("t [mm]", "t"), None),
    ],
)
def test_one_column_is_the_time(
    headings: tuple[str, str],
    used: int | None,
    plain: tuple[list[list[str]], Measurements],
    tripod_nominal: Poses,
    tmp_path: Path,
) -> None:
    """A temperature is none, and of several the one that is named best is it."""
    path, rows = tmp_path / "times.csv", [[*row, str(k), str(2 * k)] for k, row in enumerate(plain[0])]
    path.write_text(table(",".join([HEADER, *headings]), rows))
    times = read_measurements(path, tripod_nominal.robot).times
    if used is None:
        assert times is None
    else:
        assert times is not None
        np.testing.assert_allclose(np.diff(times), 1.0 + used)


_DIGITS = {
    "Arabic-Indic": "٠١٢٣٤٥٦٧٨٩",
    "full-width": "０１２３４５６７８９",
    "Devanagari": "०१२३४५६७८९",
    "bold": "".join(map(chr, range(0x1D7CE, 0x1D7D8))),
}


@pytest.mark.parametrize("script", _DIGITS)
def test_digits_of_other_scripts_are_refused(
    script: str, plain: tuple[list[list[str]], Measurements], tripod_nominal: Poses, tmp_path: Path
) -> None:
    """Python's float takes them for numbers; in one cell, in all, with decimal commas, in times and temperatures."""
    robot, path, other = tripod_nominal.robot, tmp_path / "digits.csv", str.maketrans("0123456789", _DIGITS[script])
    cells = plain[0]

    def refused(text: str, says: str) -> None:
        path.write_text(text, encoding="utf-8")
        with pytest.raises(MeasurementError, match=says):
            read_measurements(path, robot)

    text = table(HEADER, cells)
    line = text.splitlines()[3]
    says = "line 4: u1_m is '.*', expected a number in digits 0 to 9"
    refused(text.replace(line, line.translate(other)), says)
    german = text.replace(",", ";").replace(".", ",")
    line = german.splitlines()[3]
    refused(german.replace(line, line.translate(other)), says)
    for heading, says in (("temperature_K", "expected a number in digits"), ("t [s]", "expected a number in digits")):
        refused(table(f"{HEADER},{heading}", [[*row, "17".translate(other)] for row in cells]), says)
    for one, usual in (("7:05:09", "7:00:{:02d}"), ("2026-03-29T00:05:09", "2026-03-29T00:00:{:02d}")):
        rows = [[*row, one.translate(other) if k == 4 else usual.format(k)] for k, row in enumerate(cells)]
        refused(table(f"{HEADER},time", rows), "line 6: '.*' is not a time, expected ISO 8601")
    path.write_text(text.translate(other).replace(HEADER.translate(other), HEADER), encoding="utf-8")
    with pytest.raises(MeasurementError, match="expected a number in digits 0 to 9"):
        read_plan(path, robot)


@pytest.mark.parametrize(
    ("column", "cell", "says"),
    [
        ("time", "10:61", "line 5: '10:61' is not a time"),
        ("time", "24:00", "line 5: '24:00' is not a time"),
        ("time", "2026-03-29", "lines 2, 5: some times have a date and others none"),
        ("sigma_touch_m", "-1e-6", "line 5: sigma_touch_m is not positive"),
        ("sigma_distance_mm", "-0.001", "line 5: sigma_distance_m is not positive"),
        ("sigma_image_px", "-inf", "line 5: sigma_image_px is not positive"),
    ],
)
def test_impossible_times_and_noises_are_refused(
    column: str,
    cell: str,
    says: str,
    plain: tuple[list[list[str]], Measurements],
    tripod_nominal: Poses,
    tmp_path: Path,
) -> None:
    usual = "10:00" if column == "time" else "1e-5"
    rows = [[*row, cell if k == 3 else usual] for k, row in enumerate(plain[0])]
    path = tmp_path / "wrong.csv"
    path.write_text(table(f"{HEADER},{column}", rows))
    with pytest.raises(MeasurementError, match=says):
        read_measurements(path, tripod_nominal.robot)


@pytest.mark.parametrize("order", ["fixed xyz", "moving zyx", "moving zyz", "rotation vector", "fixed yzx"])
def test_angles_are_used(order: str, tripod_nominal: Poses, tmp_path: Path) -> None:
    """The matrices are products of elementary rotations; fixed axes multiply from the left."""

    def about(axis: str, angle: float) -> np.ndarray:
        k = "xyz".index(axis)
        cross = np.cross(np.eye(3), np.eye(3)[k]).T
        return np.eye(3) - np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross

    poses = tripod_nominal[:6]
    angles = np.random.default_rng(3).uniform(-0.3, 0.3, (6, 3))
    axes, numbered = order.split()[1], order == "moving zyz"
    names = "euler1,euler2,euler3" if numbered else "Rx,Ry,Rz"
    path, columns = tmp_path / "angles.csv", tmp_path / "map.yaml"
    columns.write_text(f"angles: {order}\n")
    heading = ",".join(f"{name} [deg]" for name in names.split(","))
    rows = np.column_stack([poses.commands, poses.positions, np.degrees(angles)])
    path.write_text(table(f"{HEADER},{heading}", [[repr(float(cell)) for cell in row] for row in rows]))
    found = read_measurements(path, poses.robot, columns=columns).rotations
    assert found is not None
    for seen, given in zip(found, angles, strict=True):
        if order == "rotation vector":
            expected = Rotation.from_rotvec(given).as_matrix()
        else:
            expected = np.eye(3)
            for k, axis in enumerate(axes):
                turn = about(axis, given[k if numbered else "xyz".index(axis)])
                expected = turn @ expected if order.startswith("fixed") else expected @ turn
        np.testing.assert_allclose(seen, expected, atol=1e-12)


def test_angles_of_unknown_order_are_refused_with_the_nearest(tripod_nominal: Poses, tmp_path: Path) -> None:
    poses = tripod_nominal[:8]
    angles = Rotation.from_matrix(poses.rotations).as_euler("ZYX", degrees=True)[:, ::-1]
    rows = np.column_stack([poses.commands, poses.positions, angles])
    path = tmp_path / "angles.csv"
    path.write_text(table(HEADER + ",rx_deg,ry_deg,rz_deg", [[repr(float(cell)) for cell in row] for row in rows]))
    with pytest.raises(MeasurementError, match=r"line 1: .*unknown order.*`fixed xyz` or `moving zyx` is nearest"):
        read_measurements(path, poses.robot)


def test_a_profile_names_the_columns(tripod_nominal: Poses, tmp_path: Path) -> None:
    """KUKA's A, B, C: about Z, then the moved Y, then the moved X, in degrees."""
    poses = tripod_nominal[:8]
    angles = Rotation.from_matrix(poses.rotations).as_euler("ZYX", degrees=True)
    rows = np.column_stack([poses.commands, 1e3 * poses.positions, angles])
    path = tmp_path / "kuka.csv"
    path.write_text(table("u1_m,u2_m,u3_m,X,Y,Z,A,B,C", [[repr(float(cell)) for cell in row] for row in rows]))
    found = read_measurements(path, poses.robot, columns="kuka")
    np.testing.assert_allclose(found.positions, poses.positions, atol=1e-12)
    np.testing.assert_allclose(found.rotations, poses.rotations, atol=1e-12)


def test_a_map_says_the_rest(
    plain: tuple[list[list[str]], Measurements], tripod_nominal: Poses, tmp_path: Path
) -> None:
    cells, expected = plain
    columns, path = tmp_path / "map.yaml", tmp_path / "list.txt"
    columns.write_text(
        "skip: 2\nseparator: blanks\ndecimal: ','\nencoding: cp1252\nheader: [a1, a2, a3, east, north, up, name]\n"
        "columns: {a1: u1_mm, a2: u2_mm, a3: u3_mm, east: x_mm, north: y_mm, up: z_mm, name: ignore}\n"
    )
    text = table("Stra\u00dfe 1\nx y", [[*row, "P"] for row in millimetres(cells)], "  ").replace(".", ",")
    path.write_bytes(text.encode("cp1252"))
    found = read_measurements(path, tripod_nominal.robot, columns=columns)
    np.testing.assert_allclose(found.positions, expected.positions, atol=1e-12)
    assert found.lines[0] == 3


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("angels: fixed xyz", "not angels"),
        ("angles: xyz", "angles are xyz|angles = xyz|one of fixed xyz"),
        ("columns: [x_m]", "columns: expected a dict of words"),
        ("columns: {X: 3}", "columns: expected a dict of words"),
        ("columns:", "columns: expected a dict of words, not None"),
        ("header: 5", "header: expected a list of words, not 5"),
        ("skip: -1", "number of lines"),
        ("skip: two", "expected a int|expected an int"),
        ("encoding: no-such-code", "one that Python knows"),
        ("separator: ', '", "one character"),
        ("profile: cooka", "expected one of abb"),
        ("- x", "expected a mapping of keys"),
        ("a: [", "expected YAML"),
    ],
)
def test_a_wrong_map_is_refused(text: str, says: str, tmp_path: Path) -> None:
    path = tmp_path / "map.yaml"
    path.write_text(text)
    with pytest.raises(DescriptionError, match=says):
        ColumnMap.load(path)


def test_profiles_agree_with_themselves() -> None:
    for name, profile in PROFILES.items():
        assert ColumnMap.load(name) is profile
        for heading, column in profile.columns.items():
            assert profile.name_of(heading) == column


@pytest.mark.parametrize(
    ("damage", "says"),
    [
        (lambda t: t.replace("x_m", "X"), "line 1: X without a unit: expected headings such as X"),
        (lambda t: t.replace("x_m", "x_furlong"), "no column x_m|x_furlong"),
        (lambda t: t.replace(t.splitlines()[4], "1,2"), "line 5: 2 cells, expected 6"),
        (lambda t: t.replace(t.splitlines()[4], t.splitlines()[4] + ",7"), "line 5: 7 cells, expected 6"),
        (lambda t: with_cell(t, "12,5"), "line 4: 7 cells"),
        (lambda t: with_cell(t, '"1,5"'), "line 4: y_m is '1,5', expected a number"),
        (lambda t: with_cell(t, "OVERLOAD"), "line 4: y_m is 'OVERLOAD'"),
        (lambda t: with_cell(t, "---"), "line 4: y_m is '---', expected"),
        (lambda t: t.replace("\n", "\nm,m,m,mm,mm,mm\n", 1), "line 2: x_m is said to be in mm"),
        (lambda t: t[:150] + "\0" + t[150:], "line 3: has null bytes|line 4: has null bytes"),
    ],
)
def test_the_line_of_a_mistake_is_named(
    damage: Callable[[str], str],
    says: str,
    plain: tuple[list[list[str]], Measurements],
    tripod_nominal: Poses,
    tmp_path: Path,
) -> None:
    path = tmp_path / "damaged.csv"
    path.write_text(damage(table(HEADER, plain[0])))
    with pytest.raises(MeasurementError, match=says):
        read_measurements(path, tripod_nominal.robot)


def test_300_damaged_files_give_one_clear_error_each(tripod_nominal: Poses, tmp_path: Path) -> None:
    """Or are read: none ends in another error, and a damaged cell is reported with its line."""
    poses = tripod_nominal[:5]
    good = write_measurements(
        Measurements.from_poses(poses.commands, poses.transforms), poses.robot, tmp_path / "good.csv"
    )
    text, path = good.read_text(), tmp_path / "odd.csv"
    refused = 0
    for seed in range(300):
        content, line = _damaged(text, random.Random(seed))
        path.write_bytes(content)
        message = _refusal(path, poses)
        if message:
            refused += 1
            assert message.startswith(f"{path}: "), (seed, message)
            assert "\n" not in message, (seed, message)
            assert line is None or re.search(rf"\b{line}\b", message.removeprefix(str(path))), (seed, line, message)
        else:
            assert line is None, (seed, content)
    assert refused > 150


def _refusal(path: Path, poses: Poses) -> str:
    try:
        read_measurements(path, poses.robot)
    except MeasurementError as error:
        return str(error)
    return ""


def _damaged(text: str, generator: random.Random) -> tuple[bytes, int | None]:
    """Return a damaged file, and the line that must be named, None if it may be understood."""
    lines = text.splitlines()
    row = generator.randrange(1, len(lines))
    cells = lines[row].split(",")
    column = generator.randrange(len(cells))
    kind = generator.randrange(10)
    if kind < 3:
        cells[column] = generator.choice(["n/a", "--", "1.2.3", "0x1F", "1e", "12mm", "#REF!", "1_000", "ok", "+-1"])
        lines[row] = ",".join(cells)
        return "\n".join(lines).encode(), row + 1
    if kind == 3:
        lines[row] = ",".join(cells[: max(1, column)])
        return "\n".join(lines).encode(), row + 1
    if kind == 4:
        lines[row] += ",1"
        return "\n".join(lines).encode(), row + 1
    if kind == 5:
        names = lines[0].split(",")
        names[column] = generator.choice(["", names[column - 1], "?", "u9_m", "x", names[column].upper(), " "])
        return "\n".join([",".join(names), *lines[1:]]).encode(), None
    if kind == 6:
        return text[: generator.randrange(len(text))].encode(), None
    if kind == 7:
        damaged = bytearray(text.encode())
        for _ in range(generator.randrange(1, 20)):
            damaged[generator.randrange(len(damaged))] = generator.randrange(256)
        return bytes(damaged), None
    if kind == 8:
        encoding = generator.choice(["utf-16", "utf-16-be", "utf-32", "utf-7", "cp037"])
        return text.encode(encoding), None
    return generator.choice(
        [
            "",
            "\n\n",
            "{}",
            "<html></html>",
            "PK\3\4" + text,
            text.replace(",", " "),
            text.replace(",", "|"),
            text * 2,
            '"' + text,
            "u1_m\n" * 3,
            lines[0],
            "\n".join(lines[1:]),
            text.replace(".", ","),
            text.replace("\n", "\r"),
        ]
    ).encode(), None


def test_commands_have_the_names_of_drives(tmp_path: Path) -> None:
    """In any unit, as corrected commands are written; beside numbered ones they are ambiguous."""
    robot, path = Robot.load(FIVE_BAR), tmp_path / "named.csv"
    poses = reachable_poses(robot, 8, np.random.default_rng(1))
    angles, places = np.degrees(poses.commands).tolist(), poses.positions.tolist()
    rows = [[*map(repr, u), *map(repr, x)] for u, x in zip(angles, places, strict=True)]
    path.write_text(table("left_motor_deg,Right_Motor [deg],x_m,y_m,z_m", rows))
    np.testing.assert_allclose(read_measurements(path, robot).commands, poses.commands, atol=1e-12)
    np.testing.assert_allclose(read_plan(path, robot)[0], poses.commands, atol=1e-12)
    path.write_text(table("u1_deg,left_motor_deg,right_motor_deg,x_m,y_m,z_m", [[row[0], *row] for row in rows]))
    with pytest.raises(MeasurementError, match="line 1: u1_deg, left_motor_deg: expected one column of u1"):
        read_measurements(path, robot)
    path.write_text(table("left_motor,right_motor_deg,x_m,y_m,z_m", rows))
    with pytest.raises(MeasurementError, match="left_motor without a unit"):
        read_measurements(path, robot)


def test_commands_have_the_names_of_joints_whose_coordinates_they_are(tmp_path: Path) -> None:
    """Not where counters start elsewhere: 0.24 m at a slider's zero."""
    path = tmp_path / "named.csv"
    for name, joints in (("hexapod", "strut{}_joint"), ("pm3dof", "slider{}_joint")):
        robot = Robot.load(name)
        poses = reachable_poses(robot, 8, np.random.default_rng(1))
        rows = [
            [*map(repr, (1e3 * u).tolist()), *map(repr, x.tolist())]
            for u, x in zip(poses.commands, poses.positions, strict=True)
        ]
        drives = [f"{joints.format(k)}_mm" for k in range(1, poses.commands.shape[1] + 1)]
        path.write_text(table(",".join([*drives, "x_m", "y_m", "z_m"]), rows))
        if name == "hexapod":
            np.testing.assert_allclose(read_measurements(path, robot).commands, poses.commands, atol=1e-12)
        else:
            with pytest.raises(MeasurementError, match="no column u1_m"):
                read_measurements(path, robot)


def test_units_below_headings_that_have_them_change_nothing(
    plain: tuple[list[list[str]], Measurements], tripod_nominal: Poses, tmp_path: Path
) -> None:
    path = tmp_path / "units.csv"
    path.write_text(table(HEADER, plain[0]).replace("\n", "\nm,m,[m],m,metres,-\n", 1))
    read = read_measurements(path, tripod_nominal.robot)
    np.testing.assert_array_equal(read.commands, plain[1].commands)
    np.testing.assert_array_equal(read.positions, plain[1].positions)
