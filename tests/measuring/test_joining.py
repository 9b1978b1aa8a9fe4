"""A log and a tracker's list, joined: by time, by order, with moving drives and clocks that differ."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.export_file import ColumnMap
from pm3dof_pin.measuring.file_check import FileCheck
from pm3dof_pin.measuring.joining import join
from pm3dof_pin.measuring.measurement_file import read_measurements

DWELL, STEP = 4.0, 0.02


@pytest.fixture
def files(tripod_nominal: Poses, tmp_path: Path) -> tuple[Path, Path, Poses]:
    """A log every 20 ms, 4 s at each of six poses and 1 s between them; the tracker's times, 10 ms beside the log's."""
    poses = tripod_nominal[:6]
    times = np.arange(0.0, 6 * (DWELL + 1.0), STEP)
    pose, since = np.divmod(times, DWELL + 1.0)
    part = np.clip(since - DWELL, 0.0, 1.0)[:, None]
    here, there = poses.commands[pose.astype(int)], poses.commands[np.minimum(pose.astype(int) + 1, 5)]
    rows = np.column_stack([times, (1.0 - part) * here + part * there])
    log, seen = tmp_path / "log.csv", tmp_path / "tracker.csv"
    log.write_text("time_s,u1_m,u2_m,u3_m\n" + "\n".join(",".join(map(repr, row)) for row in rows.tolist()))
    at = 2.01 + (DWELL + 1.0) * np.arange(6)
    lines = [",".join(map(repr, row)) for row in np.column_stack([at, 1e3 * poses.positions]).tolist()]
    seen.write_text("Time [s],X [mm],Y [mm],Z [mm]\n" + "\n".join(lines))
    return log, seen, poses


def test_the_nearest_commands_are_taken(files: tuple[Path, Path, Poses], tmp_path: Path) -> None:
    log, seen, poses = files
    joined = join(log, seen, poses.robot, tolerance=0.05)
    assert joined.greatest_gap == pytest.approx(0.01, abs=1e-9)
    assert joined.without_commands == joined.moving == ()
    read = read_measurements(joined.write(tmp_path / "joined.csv"), poses.robot)
    np.testing.assert_allclose(read.commands, poses.commands, atol=1e-12)
    np.testing.assert_allclose(read.positions, poses.positions, atol=1e-12)


def test_rows_in_motion_and_without_commands_are_left_out(files: tuple[Path, Path, Poses]) -> None:
    log, seen, poses = files
    text = seen.read_text() + "\n4.5,0,0,480\n99,0,0,480"
    seen.write_text(text)
    joined = join(log, seen, poses.robot)
    assert (joined.moving, joined.without_commands) == ((8,), (9,))
    assert len(joined.columns["u1_m"]) == 6


def test_another_clock(files: tuple[Path, Path, Poses]) -> None:
    log, seen, poses = files
    seen.write_text(seen.read_text().replace("\n2.01", "\n3602.01").replace("Time [s]", "time_s"))
    kept = join(log, seen, poses.robot)
    assert kept.without_commands == (2,)
    seen.write_text("\n".join(seen.read_text().splitlines()[:2]))
    with pytest.raises(MeasurementError, match=r"no time within 50 ms .* runs from 3602.01 to 3602.01 s.*--offset-s"):
        join(log, seen, poses.robot)
    assert join(log, seen, poses.robot, offset=-3600.0).greatest_gap == pytest.approx(0.01, abs=1e-6)


def test_in_order(files: tuple[Path, Path, Poses], tmp_path: Path) -> None:
    _, seen, poses = files
    plan = tmp_path / "plan.csv"
    plan.write_text("u1_m,u2_m,u3_m\n" + "\n".join(",".join(map(repr, row)) for row in poses.commands.tolist()))
    # as SpatialAnalyzer writes it: a header in a comment, names, a comma at the end
    rows = [f"Main,P{k},{x!r},{y!r},{z!r}," for k, (x, y, z) in enumerate((1e3 * poses.positions).tolist())]
    seen.write_text("// Group,Target,X,Y,Z,\n" + "\n".join(rows))
    joined = join(plan, seen, poses.robot, tolerance=None, columns=ColumnMap.load("spatialanalyzer"))
    np.testing.assert_allclose(joined.columns["z_m"], poses.positions[:, 2], atol=1e-12)
    plan.write_text("\n".join(plan.read_text().splitlines()[:-1]))
    with pytest.raises(MeasurementError, match=r"has 6 rows, .* has 5"):
        join(plan, seen, poses.robot, tolerance=None, columns=ColumnMap.load("spatialanalyzer"))


def test_a_log_without_times_is_refused(files: tuple[Path, Path, Poses]) -> None:
    log, seen, poses = files
    log.write_text("\n".join(line.partition(",")[2] for line in log.read_text().splitlines()))
    with pytest.raises(MeasurementError, match="no column time_s"):
        join(log, seen, poses.robot)
    with pytest.raises(InvalidValueError, match="positive number of seconds"):
        join(log, seen, poses.robot, tolerance=0.0)


def test_a_check_says_what_was_understood(tripod_nominal: Poses, tmp_path: Path) -> None:
    """Two rows of positions, two of heights, one distance; as the machine is described."""
    poses = tripod_nominal[:5]
    (u, p), text = (poses.commands, 1e3 * poses.positions), ""
    for k in range(5):
        cells = [*map(repr, u[k].tolist())]
        xyz = [repr(float(value)) for value in p[k]] if k < 4 else ["", "", ""]
        sigmas = ["0.01", "0.01", "0.01"] if k < 2 else ["inf", "inf", "0.01"]
        far = ["", "", "", ""] if k < 4 else [repr(float(np.linalg.norm(p[k]))), "0", "0", "0"]
        text += ",".join([*cells, *xyz, *sigmas, *far]) + "\n"
    head = "u1_m,u2_m,u3_m,X [mm],Y [mm],Z [mm],sigma_x_mm,sigma_y_mm,sigma_z_mm,distance_mm,cx_mm,cy_mm,cz_mm\n"
    path = tmp_path / "mixed.csv"
    path.write_text(head + text)
    found = FileCheck.read(path, poses.robot).as_data()
    assert found["rows_by_kind"] == {"positions": 2, "single coordinates": 2, "distances from fixed points": 1}
    assert found["columns"]["x_m"]["heading"] == "X [mm]"
    assert found["columns"]["x_m"]["empty_cells"] == 1
    assert found["different_commands"] == 5
    assert found["median_distance_from_description_m"] < 1e-9
    assert found["header_line"] == 1
