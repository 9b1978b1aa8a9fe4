"""Tables of poses: whatever gives a pose, in whatever unit, is read as the same pose by every command."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.kinematics.pose_file import PLACEMENT, columns_text, placement_readings, readings

ROBOTS = ["pm3dof", "hexapod", "three_rps", "linear_delta"]


def _poses(name: str) -> pm.Poses:
    robot = pm.load(name)
    return pm.reachable_poses(robot, 4, np.random.default_rng(0))


@pytest.mark.parametrize("name", ROBOTS)
def test_coordinates_commands_and_placements_are_one_pose(name: str, tmp_path: Path) -> None:
    poses = _poses(name)
    robot, path = poses.robot, tmp_path / "poses.csv"
    in_degrees = readings(robot.coordinates, poses.coordinates)
    in_radians = {f"{c.name}_{c.unit}": poses.coordinates[:, k] for k, c in enumerate(robot.coordinates)}
    lengths = [heading for heading in in_degrees if heading.endswith("_m")]
    in_millimetres = {h: column for h, column in in_degrees.items() if h not in lengths}
    in_millimetres |= {f"{h}m": 1e3 * in_degrees[h] for h in lengths}
    placements = placement_readings(poses)
    w, x, y, z = (placements[name] for name in PLACEMENT[3:])
    np.testing.assert_allclose(poses.rotations[:, 2, 2], w**2 - x**2 - y**2 + z**2, atol=1e-12)
    np.testing.assert_allclose(poses.rotations[:, 1, 0], 2.0 * (x * y + w * z), atol=1e-12)
    commands = readings(robot.command_coordinates, poses.commands)
    numbered = {f"u{k}_{c.unit}": poses.commands[:, k - 1] for k, c in enumerate(robot.commands, start=1)}
    for columns in (in_degrees, in_radians, in_millimetres, placements, commands, numbered, in_degrees | commands):
        path.write_text(columns_text(columns))
        np.testing.assert_allclose(pm.read_poses(robot, path).poses.q, poses.q, atol=1e-8)
    headless = "\n".join(" ".join(map(str, row)) for row in zip(*in_degrees.values(), strict=True))
    path.write_text(f"# no header\n\n{headless}  # the last one\n")
    np.testing.assert_allclose(pm.read_poses(robot, path).poses.q, poses.q, atol=1e-8)
    path.write_text(columns_text(in_degrees | commands))
    np.testing.assert_allclose(pm.read_poses(robot, path, given="commands").poses.q, poses.q, atol=1e-8)
    assert list(pm.read_poses(robot, path, given="commands").others) == list(in_radians)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod"])
def test_what_one_command_writes_the_others_read(run: Callable[..., Any], name: str, tmp_path: Path) -> None:
    poses = _poses(name)
    (tmp_path / "poses.csv").write_text(columns_text(readings(poses.robot.coordinates, poses.coordinates)))
    robot = ("--robot", name)
    assert run("ik", *robot, "--poses", "poses.csv", "--out", "ik.csv", cwd=tmp_path).returncode == 0
    for command in ("ik", "fk", "stiffness", "statics", "modes"):
        done = run(command, *robot, "--poses", "ik.csv", "--out", f"{command}.csv", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        again = run("ik", *robot, "--poses", f"{command}.csv", cwd=tmp_path)
        assert again.returncode == 0, again.stderr
    done = run("view", *robot, "--path", "ik.csv", "--duration", "0.2", "--html", "path.html", cwd=tmp_path)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("z_e_m,theta_x_deg\n", "line 1: no column theta_y_deg; expected a header such as theta_x_deg,theta_y_deg"),
        ("theta_x_deg,theta_y_deg,z_e_m\n0,1,\n", "line 2: expected finite numbers in theta_x_rad, theta_y_rad, z_e_m"),
        ("theta_x_deg,theta_y_deg,z_e_m\n0,1,0.5\n0,1,inf\n", "line 3: expected finite"),
        ("theta_x_deg,theta_y_deg,z_e_m\n0,1,500\n0,1,510\n", "line 3: z_e_m = 510 looks like millimetres; expected"),
        ("theta_x_rad,theta_y_deg,z_e_m\n10,1,0.5\n", "line 2: theta_x_rad = 10 looks like degrees; expected radians"),
        ("x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0.5,1,1,0,0\n", "line 2: qw,qx,qy,qz has length 1.41421, expected 1"),
        ("1 2\n", "line 1: 2 cells, expected 3 numbers: theta_x_deg, theta_y_deg, z_e_m"),
        ("", "is empty, expected a header such as theta_x_deg,theta_y_deg,z_e_m"),
    ],
)  # fmt: skip
def test_a_bad_table_is_named_with_its_line(text: str, said: str, tmp_path: Path) -> None:
    path = tmp_path / "poses.csv"
    path.write_text(text)
    with pytest.raises(MeasurementError) as caught:
        pm.read_poses(pm.load("pm3dof"), path)
    assert f"poses.csv: {said}" in str(caught.value)


def test_poses_out_of_reach_stay_so(tmp_path: Path) -> None:
    path, robot = tmp_path / "poses.csv", pm.load("pm3dof")
    path.write_text("theta_x_deg,theta_y_deg,z_e_m,broken_limits\n0,1,0.9,reach\nnan,nan,nan,reach\n0,1,0.5,\n")
    table = pm.read_poses(robot, path)
    np.testing.assert_array_equal(table.poses.solved, [False, False, True])
    assert table.poses.coordinates[2, 1] == pytest.approx(math.radians(1.0))
    assert not table.others
