"""Random poses within all limits."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ks_2samp

from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.reachable_poses import _Draws, reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import legs, stacked


def test_a_block_has_no_poses_to_choose_from(tmp_path: Path) -> None:
    path = tmp_path / "block.urdf"
    path.write_text('<robot name="block"><link name="base"/></robot>')
    with pytest.raises(UnreachablePoseError, match="block: has no coordinates"):
        reachable_poses(Robot.load(path), 3, np.random.default_rng(0))


def test_a_robot_that_reaches_a_small_part_of_its_box() -> None:
    """Plain rejection from the whole box finds what the smaller box holds, as evenly; a seed gives the same poses."""
    robot = Robot.load("linear_delta")
    found, again = (reachable_poses(robot, 300, np.random.default_rng(1)).coordinates for _ in range(2))
    assert np.array_equal(found, again)
    joints = [replace(coordinate, lower=None, upper=None) for coordinate in robot.coordinates]
    lower, upper = np.array([robot.range_of(joint) for joint in joints]).T
    drawn = robot.solve(np.random.default_rng(2).uniform(lower, upper, (6000, 3)), on_failure="nan")
    expected = drawn.coordinates[drawn.within_limits]
    for ours, theirs in zip(found.T, expected.T, strict=True):
        assert ks_2samp(ours, theirs).pvalue > 1e-3


def test_walks_from_home_are_as_even_as_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where hardly any draw is within limits, walks replace them: here for a robot that could do without."""
    robot = Robot.load("hexapod")
    lower, upper = coordinate_ranges(robot, robot.command_coordinates)
    drawn = robot.forward(np.random.default_rng(2).uniform(lower, upper, (3000, 6)), on_failure="nan")
    expected = drawn[drawn.within_limits]
    monkeypatch.setattr("pm3dof_pin.kinematics.reachable_poses._MIN_RATE", 2.0)
    found = reachable_poses(robot, 300, np.random.default_rng(1))
    assert found.within_limits.all()
    for ours, theirs in ((found.commands, expected.commands), (found.coordinates, expected.coordinates)):
        assert min(ks_2samp(a, b).pvalue for a, b in zip(ours.T, theirs.T, strict=True)) > 1e-3


def test_stacked_hexapods_use_all_their_drives(tmp_path: Path) -> None:
    """Six coordinates do not determine twelve drives, and few random commands of eighteen are within all limits."""
    for count in (2, 3):
        robot = Robot.load(stacked(count).write(tmp_path / str(count)))
        found = reachable_poses(robot, 64, np.random.default_rng(0))
        assert found.within_limits.all()
        assert (np.ptp(found.commands, axis=0) > 0.06).all()  # of 0.1


def test_a_round_without_a_draw_near_limits_finds_none(tmp_path: Path) -> None:
    robot = Robot.load(legs(8).write(tmp_path))
    found = _Draws.kept(robot, by_commands=False, margin=0.0).within_limits(0, np.random.default_rng(0))
    assert found.shape == (0, robot.model.nq)


def _platform_below_an_axis(folder: Path) -> Path:
    """Write a plate on four arms, as in the tests' machines, with a driven axis across on it."""
    source = Path(__file__).parents[1] / "machines" / "four_rrr"
    axis = (
        '<link name="hand"/><joint name="m4" type="revolute"><parent link="tool"/><child link="hand"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        '<link name="tip"/><joint name="tip" type="fixed"><parent link="hand"/><child link="tip"/>'
        '<origin xyz="0.1 0 0"/></joint></robot>'
    )
    text = (source / "four_rrr.closures.yaml").read_text()
    text = text.replace("m3]", "m3,m4]").replace("tool_frame: tool", "tool_frame: tip")
    (folder / "four_rrr.closures.yaml").write_text(text)
    path = folder / "four_rrr.urdf"
    path.write_text((source / "four_rrr.urdf").read_text().replace("</robot>", axis))
    return path


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_more_legs_than_freedoms_below_an_axis(tmp_path: Path, engine: Engine) -> None:
    """Six coordinates do not determine the pose, nor do random lengths of four legs of a plane belong together.

    Commands read at its poses lead back to them; those that contradict each other by 1e-5 are met by least squares.
    """
    robot = Robot.load(_platform_below_an_axis(tmp_path), engine=engine)
    assert len(robot.placing_drives) == 4 < len(robot.commands)
    found = reachable_poses(robot, 20, np.random.default_rng(0))
    assert len(found) == 20
    assert found.within_limits.all()
    again = robot.forward(found.commands + 1e-5 * np.eye(len(robot.commands))[0])
    np.testing.assert_allclose(again.commands, found.commands, atol=2e-5)


def test_walks_are_even_along_a_narrow_strip(tmp_path: Path) -> None:
    """A joint that follows the sum of two drives has hardly room: along the strip the drives are uniform all the same.

    Each of -1 to 1 rad but for the ends: their standard deviation is 1 / sqrt 3.
    """
    joint = (
        '<link name="{0}"/><joint name="{0}_joint" type="revolute"><parent link="{1}"/><child link="{0}"/>'
        '<origin xyz="{2} 0 0"/><axis xyz="0 0 1"/><limit lower="-{3}" upper="{3}" effort="1" velocity="1"/></joint>'
    )
    links = joint.format("a", "base", 0, 1), joint.format("b", "a", 0.3, 1), joint.format("c", "base", 1, 0.005)
    (tmp_path / "strip.urdf").write_text(f'<robot name="strip"><link name="base"/>{"".join(links)}</robot>')
    text = "couplings: [{joint: c_joint, of: {a_joint: 1.0, b_joint: 1.0}}]\nname_mot: [a_joint, b_joint]\n"
    (tmp_path / "strip.closures.yaml").write_text(f"{text}tool_frame: b\n")
    found = reachable_poses(Robot.load(tmp_path / "strip.urdf"), 400, np.random.default_rng(0))
    assert np.abs(found.commands.sum(axis=1)).max() <= 0.005
    np.testing.assert_allclose(found.commands.std(axis=0), 1.0 / np.sqrt(3.0), rtol=0.1)
