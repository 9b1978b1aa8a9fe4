"""Poses on the command line: for every robot, by coordinates, by name and from files."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import typer
from typer.main import get_command

from pm3dof_pin.cli import completion
from pm3dof_pin.cli.app import app
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.robot import Robot

Run = Callable[..., Any]
Answer = Callable[..., dict[str, Any]]

POSES = {
    "pm3dof": ["10", "-15", "0.5"],
    "hexapod": ["0.01", "0", "0.14", "0", "5", "0"],
    "three_rps": None,  # its coordinates at home, from `ik --configuration home`
}


@pytest.mark.parametrize("name", POSES)
def test_fk_takes_what_ik_gives_back_to_the_pose(answer: Answer, name: str) -> None:
    pose = POSES[name] or ["--configuration", "home"]
    there = answer("ik", "--robot", name, *pose)
    assert [command["unit"] for command in there["commands"]] == ["m"] * len(there["u"])
    assert there["u_m"] == there["u"]
    assert list(there["pose"]) == [coordinate["name"] for coordinate in there["coordinates"]]
    back = answer("fk", "--robot", name, *map(repr, there["u"]))
    np.testing.assert_allclose(list(back["pose"].values()), list(there["pose"].values()), atol=1e-10)
    assert there["within_limits"] is back["within_limits"] is True
    if POSES[name] is None:
        assert answer("fk", "--robot", name, *pose)["pose"] == there["pose"]


def test_a_hexapods_struts_reach_from_base_to_platform(answer: Answer) -> None:
    """Lengths by hand: |t + R b_i - a_i| less those at home, R = Rx(2 deg) Ry(5 deg) Rz(-3 deg)."""
    robot = Robot.load("hexapod")
    base = np.array([robot.home.frame_placement(f"A{leg}").translation for leg in range(1, 7)])
    platform = np.array([robot.home.frame_placement(f"B{leg}").translation for leg in range(1, 7)])
    tool = robot.home.tool_placement
    rx, ry, rz = (
        pin.utils.rotate(axis, math.radians(turn)) for axis, turn in zip("xyz", (2.0, 5.0, -3.0), strict=True)
    )
    moved = [0.004, -0.003, 0.138] + (platform - tool.translation) @ tool.rotation @ (rx @ ry @ rz).T
    expected = np.linalg.norm(moved - base, axis=1) - np.linalg.norm(platform - base, axis=1)
    result = answer("ik", "--robot", "hexapod", "0.004", "-0.003", "0.138", "2", "5", "-3")
    np.testing.assert_allclose(result["u"], expected, atol=1e-12)
    assert result["rx_rad"] == pytest.approx(math.radians(2.0))


def test_a_broken_limit_is_read_off_the_counter(run: Run) -> None:
    """Of a joint with a command; of a closure, by its index in its declared group, or by its frames."""
    assert "spherical1 at 46.78 deg, outside 0.00 .. 45.00 deg" in run("ik", "44", "3", "0.5").stderr
    robot = Robot.load("pm3dof")
    low = robot.solve([0.0, 0.0, 0.59]).configuration()
    slider = next(limit for limit in broken_limits(robot, low) if limit.name == "slider1_joint")
    assert slider.value == pytest.approx(low.joint_position("slider1_joint") + robot.commands[0].offset)
    assert slider.upper - slider.lower == pytest.approx(0.17)
    far = run("ik", "--robot", "hexapod", "0", "0", "0.13526", "20", "0", "0")
    assert far.returncode == 1
    assert "strut1_tip-B1" in far.stdout


def _rows(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


def test_a_file_of_poses_and_back(run: Run, tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text("# three\nz_e_m,theta_y_rad,theta_x_deg\n0.5,-0.2,10\n\n0.5,0.05,44\n0.9,0,0\n")
    done = run("ik", "--poses", "poses.csv", "--out", "u.csv", cwd=tmp_path)
    assert done.returncode == 1
    assert "2 of 3 poses break a limit" in done.stderr
    assert "wrote u.csv" in done.stderr
    rows = _rows((tmp_path / "u.csv").read_text())
    assert [row["broken_limits"] for row in rows] == ["", "spherical", "reach"]
    assert rows[2]["u1_m"] == "nan"
    u = Robot.load("pm3dof").solve([math.radians(10), -0.2, 0.5]).commands
    np.testing.assert_allclose([float(rows[0][f"u{leg}_m"]) for leg in (1, 2, 3)], u, rtol=1e-11)
    kept = (tmp_path / "u.csv").read_text().splitlines()[:2]
    (tmp_path / "back.csv").write_text("\n".join(kept))
    whole = run("fk", "--poses", "u.csv", cwd=tmp_path)  # the pose out of reach stays so
    assert [row["broken_limits"] for row in _rows(whole.stdout)] == ["", "spherical", "reach"]
    back = run("fk", "--poses", "back.csv", cwd=tmp_path)
    assert back.returncode == 0
    assert "unused columns: theta_x_rad, theta_y_rad, z_e_m" in back.stderr
    (row,) = _rows(back.stdout)
    assert float(row["theta_y_deg"]) == pytest.approx(math.degrees(-0.2), abs=1e-8)


@pytest.mark.parametrize(
    ("command", "single", "column"),
    [
        ("stiffness", lambda result: result["felt"]["z"], "felt_z_N/m"),
        ("statics", lambda result: result["force_N"][0], "slider1_joint_N"),
        ("modes", lambda result: result["frequency_Hz"][0], "mode1_Hz"),
    ],
)
def test_a_file_gives_what_single_poses_give(
    answer: Answer, run: Run, command: str, single: Callable[[dict[str, Any]], float], column: str, tmp_path: Path
) -> None:
    (tmp_path / "poses.csv").write_text("theta_x_deg,theta_y_deg,z_e_m\n10,-15,0.5\n0,3,0.48\n")
    rows = _rows(run(command, "--poses", "poses.csv", cwd=tmp_path).stdout)
    expected = [single(answer(command, *pose)) for pose in (["10", "-15", "0.5"], ["0", "3", "0.48"])]
    np.testing.assert_allclose([float(row[column]) for row in rows], expected, rtol=1e-10)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "is empty, expected a header such as theta_x_deg,theta_y_deg,z_e_m"),
        ("theta_x_deg,theta_y_deg,z_e_cm\n", "line 1: no column z_e_m; expected a header such as theta_x_deg,"),
        ("theta_x_deg,z_e_m\n", "line 1: no column theta_y_deg; expected"),
        ("theta_x_deg,theta_x_rad,theta_y_deg,z_e_m\n", "column theta_x_rad appears more than once"),
        ("theta_x_deg,theta_y_deg,z_e_m\n1,2,0.5\n1,two,0.5\n", "line 3: theta_y_rad is 'two', expected a number"),
        ("theta_x_deg,theta_y_deg,z_e_m\n1,2\n", "line 2: 2 cells, expected 3"),
    ],
)
def test_a_bad_file_is_named_with_its_line(run: Run, text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "poses.csv").write_text(text)
    done = run("ik", "--poses", "poses.csv", cwd=tmp_path)
    assert done.returncode == 1
    assert done.stderr.startswith("Error: poses.csv: ")
    assert words in done.stderr
    assert done.stdout == ""


def test_small_tilts_are_asked_about_and_answered(run: Run) -> None:
    done = run("ik", "0.1", "-0.2", "0.5")
    assert done.returncode == 0
    assert done.stderr == (
        "pm3dof: reading theta_x = 0.1, theta_y = -0.2 as degrees; if radians were meant: 5.72958, -11.4592\n"
    )
    assert run("ik", "0", "0", "0.5").stderr == ""


def test_another_machine_of_the_kind(answer: Answer, tmp_path: Path) -> None:
    """A longer link raises the level platform: z = z_D + sqrt(l^2 - r^2), by the chapter's geometry."""
    config = tmp_path / "machine.yaml"
    shipped = (Path(answer("info")["urdf"]).parents[1] / "config" / "pm3dof.yaml").read_text()
    config.write_text(shipped.replace("value: 353.0", "value: 363.0"))
    assert config.read_text() != shipped
    usual, longer = (answer("ik", "0", "0", "0.5", *options)["u_m"][0] for options in ([], ["--config", str(config)]))

    def height(u: float, link: float) -> float:
        radius = 0.37425 - u * math.cos(math.radians(50)) - 0.075
        return u * math.sin(math.radians(50)) + math.sqrt(link**2 - radius**2)

    assert height(longer, 0.363) == pytest.approx(height(usual, 0.353), abs=1e-9)


def test_another_tool_frame(answer: Answer) -> None:
    frame = answer("stiffness", "10", "-15", "0.5", "--tool-frame", "E1")
    assert frame["felt"]["z"] != pytest.approx(answer("stiffness", "10", "-15", "0.5")["felt"]["z"])


def test_values_complete_in_the_shell() -> None:
    context = typer.Context(get_command(app), info_name="pm3dof")
    assert completion.robots("he") == ["hexapod"]
    assert completion.configurations(context, "tilt_y") == ["tilt_y", "tilt_y_back"]
    assert completion.coordinates(context, "") == ["theta_x", "theta_y", "z_e"]
    context.params["robot"] = "nobody"
    assert completion.coordinates(context, "") == completion.configurations(context, "") == []


def test_a_zero_with_rounding_has_no_unit(run: Run) -> None:
    """The cosine of a right angle in floating point is no angle that may have been meant in radians."""
    rounded = math.cos(math.pi / 2.0)
    assert 0.0 < rounded < 1e-15
    assert "radians" not in run("ik", "--robot", "hexapod", "0", "0", "0", repr(rounded), "0", "0").stderr
    assert "radians" in run("ik", "--robot", "hexapod", "0", "0", "0", "0.01", "0", "0").stderr
