"""Forces, masses and motions of more drives than degrees of freedom, against their null spaces."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.traced import of_drives
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts" / "benchmarks"))
from families import Drawing, legs, walker


@pytest.mark.parametrize(("draw", "size"), [(legs, 8), (walker, 6)])
def test_redundant_drives_against_their_null_space(draw: Callable[[int], Drawing], size: int, tmp_path: Path) -> None:
    """Least motions at the drives are the pseudo-inverse of the rates of the motions that singular values find."""
    robot = Robot.load(draw(size).write(tmp_path))
    poses = reachable_poses(robot, 4, np.random.default_rng(0))
    holding = of_drives("holding_forces", robot, robot.model, poses.q)
    mass = of_drives("mass_matrix", robot, robot.model, poses.q)
    moved = of_drives("drive_motions", robot, robot.model, poses.q)
    data = robot.model.createData()
    for k, q in enumerate(poses.q):
        dof = DegreesOfFreedom(Configuration(robot, q))
        rates = dof.actuators @ dof.basis
        motions = dof.scale[:, None] * (dof.basis @ np.linalg.pinv(rates)) / dof.scale[robot.actuated_indices]
        upper = np.triu(pin.crba(robot.model, data, q))
        masses = upper + np.triu(upper, 1).T
        expected = [
            motions.T @ pin.computeGeneralizedGravity(robot.model, data, q),
            (motions.T @ masses @ motions).ravel(),
            np.vstack([motions, Configuration(robot, q).tool_jacobian @ motions]).ravel(),
        ]
        for (values, sound), own in zip((holding, mass, moved), expected, strict=True):
            assert sound[k]
            np.testing.assert_allclose(values[k].ravel(), own, atol=1e-9 * np.abs(own).max())
