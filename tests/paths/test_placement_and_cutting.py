"""Placements against a search by brute force, milling forces against integrals, limits of a controller, the report."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, UnreachablePoseError
from pm3dof_pin.paths import placement
from pm3dof_pin.paths.bounds import MotionLimits
from pm3dof_pin.paths.controller import controller_limits
from pm3dof_pin.paths.cutting import Milling
from pm3dof_pin.paths.evaluation import PathOptions, evaluate_path
from pm3dof_pin.paths.placement import place_path
from pm3dof_pin.paths.report import path_report
from pm3dof_pin.paths.tool_path import read_path

POCKET = "G21 G64 P0.02\nG0 Z2\nG1 Z0 F200\nX4 F600\nG3 X4 I-4\nG1 X0\nG0 Z2\nM2\n"
INI = "[TRAJ]\nLINEAR_UNITS = mm\nMAX_LINEAR_VELOCITY = 30\nMAX_LINEAR_ACCELERATION = 200 # mm/s^2\n"
INI += "".join(f"[JOINT_{k}]\nMAX_VELOCITY = 40\nMAX_ACCELERATION = 300\n" for k in range(6))


def test_placement_of_a_tripods_workpiece_is_that_of_a_scan(tmp_path: Path) -> None:
    robot = pm.load("pm3dof")
    file = tmp_path / "pocket.ngc"
    file.write_text(POCKET)
    found = place_path(
        robot, read_path(robot, file), "stiffest", PathOptions(table=("x", "y"), force=[0.0, 0.0, 100.0])
    )
    assert found.variables == ("z",)
    heights = np.linspace(0.38, 0.58, 401)
    poses = robot.solve(np.stack([np.zeros(401), np.zeros(401), heights], axis=1), on_failure="nan")
    vertical = 100.0 * np.linalg.norm(pm.compliance(robot, poses, on_failure="nan")[:, :3, 2], axis=1)
    legal = poses.within_limits & (np.interp(heights + 0.002, heights, poses.within_limits) == 1.0)
    # the path is 2 mm high; its worst point is at one end of it or the other
    worst = np.fmax(vertical, np.interp(heights + 0.002, heights, vertical))
    assert found.cost == pytest.approx(np.nanmin(np.where(legal, worst, np.nan)), rel=5e-3)
    assert np.isnan(found.cost_before)


@pytest.mark.parametrize("goal", ["stiffest", "accurate", "fastest"])
def test_placed_path_is_legal_and_no_worse(goal: Any, tmp_path: Path) -> None:
    errors = pm.GeometricErrors.load("hexapod")
    robot, file = errors.robot, tmp_path / "pocket.ngc"
    file.write_text(POCKET)
    zero = np.eye(4)
    zero[:3, 3] = 0.003, -0.002, 0.134
    options = PathOptions(errors=errors)
    found = place_path(robot, read_path(robot, file, workpiece={54: zero}), goal, options)
    assert found.cost <= found.cost_before
    placed = evaluate_path(robot, read_path(robot, file, workpiece=found.workpiece), options)
    assert placed.summary["within_limits"]
    if goal == "accurate":
        cutting = ~placed.path.rapid[placed.points.moves]
        assert placed.columns["expected_error_m"][cutting].max() == pytest.approx(found.cost, rel=1e-2)


def test_a_workpiece_that_is_placed_already_moves_as_a_whole(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Read again with the placements found, the program is where the motion takes the first one."""
    monkeypatch.setattr(placement, "_POPULATION", 4)
    monkeypatch.setattr(placement, "_GENERATIONS", 3)
    robot, file = pm.load("linear_delta"), tmp_path / "part.ngc"
    file.write_text("G21 G55\nG1 X-10 Y5 F600\nX10 Y-20\nM2\n")
    start = np.eye(4)
    start[:3, :3] = Rotation.from_euler("z", 40.0, degrees=True).as_matrix()
    start[:3, 3] = [0.06, -0.05, 0.03]
    path = read_path(robot, file, workpiece={55: start})
    found = place_path(robot, path, "fastest", turn=True)
    assert found.variables == ("x", "y", "rz")  # the program does not say at which height
    assert not np.allclose(found.motion, np.eye(4), atol=1e-3)
    moves, end = np.arange(len(path)), np.ones(len(path))
    before, after = (
        each.values(moves, end)[:, :3] for each in (path, read_path(robot, file, workpiece=found.workpiece))
    )
    np.testing.assert_allclose(after, before @ found.motion[:3, :3].T + found.motion[:3, 3], atol=1e-12)


@pytest.mark.parametrize("turn", [0.0, 35.0])
def test_axes_not_named_yet_stay_where_the_machine_is(turn: float, tmp_path: Path) -> None:
    """Points of a moved workpiece are those of the program read again with the moved placements."""
    robot, file = pm.load("hexapod"), tmp_path / "part.ngc"
    file.write_text("G21\nG1 X4 F600\nX-3\nG91 Z1\nG90 G55 Y5\nZ-1\nG54 X2\nG55 Z2\nM2\n")
    first, second, motion = np.eye(4), np.eye(4), np.eye(4)
    first[:3, :3] = second[:3, :3] = Rotation.from_euler("z", 40.0, degrees=True).as_matrix()
    first[:3, 3], second[:3, 3], motion[:3, 3] = [0.002, 0.001, 0.13], [0.0, 0.003, 0.14], [0.004, -0.002, 0.006]
    motion[:3, :3] = Rotation.from_euler("z", turn, degrees=True).as_matrix()
    placements = {54: first, 55: second}
    path = read_path(robot, file, workpiece=placements)
    again = read_path(robot, file, workpiece={number: motion @ own for number, own in placements.items()})
    search = placement.PlacementSearch(robot, path, "fastest", PathOptions())
    ends = again.values(np.arange(len(again)), np.ones(len(again)))[:, :3]
    off = np.linalg.norm(search.moved(motion[None])[0][:, None, :3] - ends, axis=2)
    assert off.min(axis=0).max() < 1e-12


def test_a_workpiece_out_of_reach_that_is_approached_at_the_height_of_home(tmp_path: Path) -> None:
    robot, file = pm.load("hexapod"), tmp_path / "pocket.ngc"
    file.write_text("G21 G0 X0 Y0\n" + POCKET)
    options = PathOptions(force=[0.0, 0.0, 10.0])
    found = place_path(robot, read_path(robot, file), "stiffest", options)
    placed = evaluate_path(robot, read_path(robot, file, workpiece=found.workpiece), options)
    assert placed.summary["within_limits"]


def test_a_workpiece_above_the_reach_of_a_tripod_is_lowered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A table moves it along x, where it is as far off as the tripod reaches up."""
    monkeypatch.setattr(placement, "_POPULATION", 4)
    monkeypatch.setattr(placement, "_GENERATIONS", 3)
    robot, file = pm.load("pm3dof"), tmp_path / "line.ngc"
    file.write_text("G21\nG1 X440 Z900 F600\nX460\nM2\n")
    found = place_path(robot, read_path(robot, file), "stiffest", PathOptions(table=("x", "y")))
    assert found.variables == ("z",)
    assert robot.solve([0.0, 0.0, 0.9 + found.motion[2, 3]]).within_limits


def test_what_cannot_be_placed_is_refused(tmp_path: Path) -> None:
    robot, file = pm.load("hexapod"), tmp_path / "large.ngc"
    file.write_text("G21 G1 X0 F100\nX500\nM2\n")
    with pytest.raises(UnreachablePoseError, match="no placement of the path is within all limits"):
        place_path(robot, read_path(robot, file))
    with pytest.raises(InvalidValueError, match="has no error file"):
        place_path(robot, read_path(robot, file), "accurate")
    file.write_text("G21 G53 G1 X1 F100\nG53 X2\nM2\n")
    with pytest.raises(InvalidValueError, match="is all in the base, G53"):
        place_path(robot, read_path(robot, file))
    table = tmp_path / "path.csv"
    table.write_text("x_m,y_m,z_m,rx_rad,ry_rad,rz_rad\n0,0,.135,0,0,0\n.001,0,.135,0,0,0\n")
    with pytest.raises(InvalidValueError, match="one of the robot's coordinates"):
        place_path(robot, read_path(robot, table))


@pytest.mark.parametrize("climb", [0.0, 1.0])
def test_milling_forces_are_means_over_a_turn(climb: float) -> None:
    cut = Milling(
        tangential=700e6, radial=200e6, depth=1e-3, width=2.5e-3, diameter=8e-3, rpm=9000, teeth=3, climb=climb
    )
    immersion = np.arccos(1.0 - 2.0 * 2.5 / 8.0)
    ends = (np.pi - immersion, np.pi) if climb else (0.0, immersion)
    feed = 0.02
    chip = feed / (3 * 150.0)

    def mean(part: Callable[[float], float]) -> float:
        return 3.0 / (2.0 * np.pi) * quad(part, *ends)[0]

    def tangential(p: float) -> float:
        return 700e6 * 1e-3 * chip * np.sin(p)

    def radial(p: float) -> float:
        return 200e6 * 1e-3 * chip * np.sin(p)

    # the tooth is at the angle p clockwise from the left of the feed; the work pushes it back and towards the axis
    along = mean(lambda p: -tangential(p) * np.cos(p) - radial(p) * np.sin(p))
    left = mean(lambda p: tangential(p) * np.sin(p) - radial(p) * np.cos(p))
    found = cut(np.array([feed]), np.array([[0.0, 1.0, 0.0]]), np.array([[0.0, 0.0, 1.0]]))[0]
    np.testing.assert_allclose(found, [-left, along, 0.0], rtol=1e-9, atol=1e-12)
    with pytest.raises(InvalidValueError, match="at most"):
        Milling(tangential=1e8, radial=1e8, depth=1e-3, width=9e-3, diameter=8e-3, rpm=9000, teeth=3)


def test_limits_of_a_linuxcnc_machine(tmp_path: Path) -> None:
    robot, file = pm.load("hexapod"), tmp_path / "machine.ini"
    file.write_text(INI)
    limits = controller_limits(robot, file, MotionLimits(feed=0.01))
    assert (limits.rapid, limits.acceleration, limits.feed) == pytest.approx((0.03, 0.2, 0.01))
    assert limits.drive_speed == pytest.approx(np.full(6, 0.04))
    assert limits.drive_acceleration == pytest.approx(np.full(6, 0.3))
    file.write_text(INI.replace("[JOINT_5]", "[JOINT_7]"))
    with pytest.raises(DescriptionError, match=r"\[JOINT_5\]"):
        controller_limits(robot, file)
    file.write_text(INI.replace("= 200 # mm/s^2", "= fast"))
    with pytest.raises(DescriptionError, match="is 'fast', expected a positive number"):
        controller_limits(robot, file)


def test_command_writes_points_report_and_placement(run: Callable[..., Any], tmp_path: Path) -> None:
    import json

    (tmp_path / "pocket.ngc").write_text(POCKET)
    (tmp_path / "machine.ini").write_text(INI)
    words = "pocket.ngc --robot hexapod --workpiece 0,0,0.134 --controller machine.ini --place stiffest --json "
    words += "--milling tangential=7e8,radial=2e8,depth=1e-3,width=4e-3,diameter=8e-3,rpm=8000,teeth=2 "
    words += "--out points.nc --report path.html"
    result = run("path", *words.split(), cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    answer = json.loads(result.stdout)
    assert answer["robot"] == "hexapod"
    assert answer["within_limits"] is True
    assert answer["place"]["goal"] == "stiffest"
    assert answer["files"] == ["points.nc", "path.html"]
    page = (tmp_path / "path.html").read_text()
    assert page.count("data:image/svg+xml;base64,") == 3
    beyond = run("path", "pocket.ngc", "--robot", "hexapod", "--workpiece", "0.02,0,0.134", cwd=tmp_path)
    assert beyond.returncode == 1
    assert re.search(r"points break a limit \(strut_joint\), first in line \d", beyond.stderr)
    (tmp_path / "bad.ngc").write_text("G21\nG99 X1\n")
    refused = run("path", "bad.ngc", "--robot", "hexapod", cwd=tmp_path)
    assert refused.returncode == 1
    assert refused.stderr.strip().endswith("bad.ngc: line 2: G99 is not understood")
    wrong = run("path", "pocket.ngc", "--robot", "hexapod", "--workpiece", "1,2", cwd=tmp_path)
    assert wrong.returncode == 2


def test_drives_that_are_not_named_keep_the_limits_of_the_controller(run: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "pocket.ngc").write_text(POCKET)
    (tmp_path / "machine.ini").write_text(INI.replace("MAX_VELOCITY = 40\n", "MAX_VELOCITY = 1\n"))
    words = "pocket.ngc --robot hexapod --workpiece 0,0,0.134 --controller machine.ini --out points.csv --speed "
    result = run("path", *words.split(), f"{pm.load('hexapod').actuated_joints[0]}=0.002", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    table = np.genfromtxt(tmp_path / "points.csv", delimiter=",", names=True, dtype=None, encoding=None)
    speeds = np.abs([table[f"u{k}_speed_m_s"] for k in range(1, 7)]).max(axis=1)
    assert 0.001 < speeds[0] <= 0.002 * (1.0 + 1e-9)
    assert speeds[1:].max() == pytest.approx(0.001, rel=1e-6)


def test_report_escapes_names(tmp_path: Path) -> None:
    robot, file = pm.load("pm3dof"), tmp_path / "path.csv"
    file.write_text("theta_x_deg,theta_y_deg,z_e_m\n0,0,.48\n5,0,.48\n")
    page = path_report(evaluate_path(robot, read_path(robot, file)), "<b>&path")
    assert "<b>&path" not in page
    assert "&lt;b&gt;&amp;path on pm3dof" in page


@pytest.mark.parametrize("name", ["hexapod", "linear_delta"])
def test_program_and_limits_of_an_exported_controller(name: str, run: Callable[..., Any], tmp_path: Path) -> None:
    """The stops of an exported machine have the joints that Pinocchio computed for its check."""
    assert run("export", "linuxcnc", "--robot", name, "--out", "machine", cwd=tmp_path).returncode == 0
    folder, robot = tmp_path / "machine", pm.load(name)
    limits = controller_limits(robot, folder / f"{name}.ini")
    found = evaluate_path(robot, read_path(robot, folder / "check.ngc"), PathOptions(limits=limits, spacing=0.05))
    assert found.summary["within_limits"]
    header, *rows = [line.split(",") for line in (folder / "check_joints.csv").read_text().splitlines()]
    joints = [k for k, word in enumerate(header) if word.startswith("joint_")]
    expected = 1e-3 * np.array([[float(row[k]) for k in joints] for row in rows])
    dwells = (found.points.sizes[found.points.moves] == 0.0) & (found.points.shares == 1.0)
    commands = np.stack([found.columns[f"u{k + 1}_m"] for k in range(len(joints))], axis=1)[dwells]
    np.testing.assert_allclose(commands, expected, rtol=0.0, atol=1e-9)
