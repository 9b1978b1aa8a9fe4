"""Distances from singularities at many poses: those of one pose at a time, and of formulas."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity_measures import least_singularity_measures, singularity_measures

MACHINES = Path(__file__).parents[1] / "machines"


def usual(robot: Robot) -> Mobility:
    return instantaneous_mobility(generic_configuration(robot.home))


@pytest.mark.parametrize("name", ["three_rps", MACHINES / "delta"], ids=["3-RPS", "delta"])
def test_engines_agree(name: str | Path) -> None:
    robot = Robot.load(name)
    poses = reachable_poses(robot, 10, np.random.default_rng(0))
    found, careful = (singularity_measures(robot, poses, usual(robot), engine=e) for e in ("program", "pinocchio"))
    assert found.shape == (10, 4)
    np.testing.assert_allclose(found, careful, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    "name", ["pm3dof", "three_rps", "hexapod", "ur5", MACHINES / "delta", MACHINES / "five_bar"], ids=str
)
def test_the_least_of_them(name: str | Path) -> None:
    robot = Robot.load(name, tool_frame="tool0") if name == "ur5" else Robot.load(name)
    q = reachable_poses(robot, 60, np.random.default_rng(0)).q.copy()
    q[5] = np.nan
    every = singularity_measures(robot, q, usual(robot), on_failure="nan")
    found = least_singularity_measures(robot, q, usual(robot), on_failure="nan")
    np.testing.assert_allclose(found, every.min(axis=1), rtol=1e-8, atol=1e-12)
    assert np.isnan(found).sum() == 1


def test_a_turned_hexapod_comes_down_to_zero() -> None:
    hexapod = Robot.load("hexapod")
    turns = np.radians([60.0, 89.0, 89.5, 90.0])
    poses = hexapod.solve([[0.0, 0.0, 0.135, 0.0, 0.0, turn] for turn in turns])
    constraint, parallel, serial, passive = singularity_measures(hexapod, poses, usual(hexapod)).T
    assert parallel[-1] < 1e-12
    assert parallel[1] == pytest.approx(2.0 * parallel[2], rel=5e-3)  # linear next to the singularity
    assert min(constraint.min(), serial.min(), passive.min()) > 0.01
    least = least_singularity_measures(hexapod, poses, usual(hexapod))
    np.testing.assert_allclose(least, np.minimum(parallel, serial), rtol=1e-9, atol=1e-12)


def test_open_loops_are_refused_and_missing_poses_stay_missing() -> None:
    robot = Robot.load(MACHINES / "five_bar")
    generic = usual(robot)
    with pytest.raises(InvalidValueError, match="closed loops"):
        singularity_measures(robot, robot.home.q[None] + [[0.01, 0.0, 0.0, 0.0]], generic)
    assert np.isnan(singularity_measures(robot, np.full((2, 4), np.nan), generic, on_failure="nan")).all()


def test_an_arm_without_loops() -> None:
    arm = Robot.load("ur5", tool_frame="tool0")
    q = np.random.default_rng(1).uniform(-2.0, 2.0, (20, arm.model.nq))
    found, careful = (singularity_measures(arm, q, usual(arm), engine=e) for e in ("program", "pinocchio"))
    np.testing.assert_allclose(found, careful, rtol=0.0, atol=1e-12)
    straight = np.zeros((1, arm.model.nq))
    assert (singularity_measures(arm, straight, usual(arm)) < 1e-9).any()
