"""Steps over the commands of robots whose drives can move while the tool rests."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import four_bars


def test_steps_are_taken_along_the_tangent_that_pinocchio_gives(tmp_path: Path) -> None:
    robot = Robot.load(four_bars(8).write(tmp_path))
    home = robot.at([robot.home.q]).commands[0]
    poses = robot.forward(home + np.random.default_rng(0).uniform(-0.1, 0.1, (3, len(home))))
    motions = robot.continuation(robot.coordinates)._null_motions
    assert motions is not None
    found = motions._by_commands(poses.q, poses.commands)
    expected = jacobian(robot, poses, of="coordinates", by="commands", engine="pinocchio").values
    lengths = np.where([c.unit == "m" for c in robot.coordinates], robot.characteristic_length, 1.0)
    np.testing.assert_allclose(found, expected / lengths[:, None], atol=1e-11)  # differences are off by 1e-8
