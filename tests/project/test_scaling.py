"""The study of large robots: its robots load and answer, and its table says what happened."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.exceptions import UnreachablePoseError

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import FAMILIES
from scaling import COMMANDS, Run, exponent, table, write_path

# size; degrees of freedom by counting: six of a platform, one of a scissor and of each four-bar, six of each hexapod,
# one of each joint of an arm, six of a walker's body on feet that stay; and drives, of a walker three a leg
SMALL = {
    "legs": (6, 6, 6),
    "scissor": (2, 1, 1),
    "four_bars": (4, 4, 4),
    "stacked": (1, 6, 6),
    "arm": (7, 7, 7),
    "walker": (4, 6, 12),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_small_robots_of_each_family(family: str, tmp_path: Path, answer: Callable[..., dict[str, Any]]) -> None:
    size, freedoms, drives = SMALL[family]
    path = FAMILIES[family][0](size).write(tmp_path / "robot")
    robot = pm.load(path)
    assert pm.instantaneous_mobility(robot.home).count == freedoms
    pose = answer("fk", "--robot", str(path), "--configuration", "home")
    assert len(pose["commands"]) == drives


@pytest.mark.parametrize("family", FAMILIES)
def test_a_tilted_robot_is_the_same_on_another_base(family: str, tmp_path: Path) -> None:
    drawing = FAMILIES[family][0](SMALL[family][0])
    level, tilted = (pm.load(drawing.write(tmp_path / str(k), tilted=k == 1)) for k in range(2))
    place, turned = (robot.at([robot.home.q]).transforms[0] for robot in (level, tilted))
    # roll, pitch and yaw about fixed axes
    standing = Rotation.from_euler("xyz", [0.3, 0.2, 1.1]).as_matrix()
    np.testing.assert_allclose(turned[:3], standing @ place[:3], atol=1e-12)


@pytest.mark.parametrize("family", ["scissor", "four_bars", "arm"])
def test_the_path_is_within_reach(family: str, tmp_path: Path, answer: Callable[..., dict[str, Any]]) -> None:
    path = FAMILIES[family][0](SMALL[family][0]).write(tmp_path / "robot")
    write_path(path, tmp_path / "near.csv")
    command, _, *options = COMMANDS["path"][:-2]
    summary = answer(command, str(tmp_path / "near.csv"), *options, "--robot", str(path))
    assert summary["points_within_limits"] == summary["points"] > 100


def test_table_and_exponents() -> None:
    runs = [Run("legs", n, "info", 0.01 * n**2, 1e8, 0, "") for n in (3, 6, 12, 24)]
    assert exponent(runs) == pytest.approx(2.0)
    slow = Run("legs", 24, "modes", 61.0, 1e8, 0, "")
    refused = Run("legs", 24, "workspace", 1.0, 1e8, 2, "Error: too many joints")
    killed = Run("scissor", 2, "info", 1.0, 1e8, -11, "")
    lines = table([*runs, slow, refused, killed]).splitlines()
    assert lines[0] == "| processor time [s] | legs 24 | scissor 2 |"
    assert lines[2] == "| info | 5.8, n^2.0^ | signal 11 from 2 |"
    cells = {line.split(" | ")[0]: line for line in lines}
    assert "slow from 24" in cells["| modes"]
    assert "refused" in cells["| workspace"]


def test_commands_of_many_drives_out_of_reach_are_told(tmp_path: Path) -> None:
    """No lattice is laid over twelve drives, whose points would not fit into memory."""
    robot = pm.load(FAMILIES["stacked"][0](2).write(tmp_path / "robot"))
    with pytest.raises(UnreachablePoseError, match="stacked2"):
        robot.forward([[0.5, *[0.0] * 11]])  # one strut 0.5 m longer than five of 0.3 m
