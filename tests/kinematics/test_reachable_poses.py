"""Random poses within all limits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import ks_2samp

from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot


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
