"""Forward kinematics of many commands, against the single-pose solver and the closed form."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, placement
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot


def test_they_are_assembled_and_keep_the_commands(case: Poses) -> None:
    again = case.robot.forward(case.commands)
    np.testing.assert_allclose(again.commands, case.commands, atol=1e-15)
    for configuration in again:
        assert configuration.closure_residual < 1e-12


def test_the_tripod_reaches_the_poses_of_its_inverse_kinematics(
    tripod: Tripod, mechanism: Robot, reachable_poses: np.ndarray
) -> None:
    """Far commands too end in the machine's own assembly mode."""
    poses = reachable_poses[:400]
    u = inverse_kinematics(tripod, poses)
    np.testing.assert_allclose(mechanism.forward(u).transforms, placement(poses), atol=1e-11)


def test_motion_coordinates_can_be_held(tripod: Tripod, mechanism: Robot, reachable_poses: np.ndarray) -> None:
    poses = reachable_poses[:50]
    solved = mechanism.solve(poses)
    u = inverse_kinematics(tripod, poses)
    np.testing.assert_allclose(solved.commands, u, atol=1e-12)
    assert solved.within_limits.all()
    np.testing.assert_array_equal(solved[3:5].q, solved.q[3:5])


def test_a_command_out_of_reach_is_named(mechanism: Robot) -> None:
    with pytest.raises(UnreachablePoseError, match=r"u1 = 0\.5"):
        mechanism.forward([[0.24, 0.24, 0.24], [0.5, -0.5, 0.24]])


def test_shapes_are_checked(mechanism: Robot) -> None:
    with pytest.raises(InvalidValueError, match=r"shape \(\.\.\., 3\)"):
        mechanism.forward([0.0, 0.0])
    with pytest.raises(InvalidValueError, match="finite"):
        mechanism.forward([[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    with pytest.raises(InvalidValueError, match="guess"):
        mechanism.forward([[0.0, 0.0, 0.0]], guess=np.zeros(3))
    assert len(mechanism.forward(np.empty((0, 3)))) == 0
