"""Forward kinematics of many commands, against the single-pose solver and the closed form."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.calibration.tool_poses import ToolPoses, forward_poses, poses_at
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.mechanism import Mechanism
from pm3dof_pin.tripod import Tripod
from pm3dof_pin.tripod.kinematics import inverse_kinematics, placement


def test_they_are_assembled_and_keep_the_commands(case: ToolPoses) -> None:
    again = forward_poses(case.mechanism, case.commands)
    np.testing.assert_allclose(again.commands, case.commands, atol=1e-15)
    for configuration in again:
        assert configuration.closure_residual < 1e-12


def test_the_tripod_reaches_the_poses_of_its_inverse_kinematics(
    tripod: Tripod, mechanism: Mechanism, reachable_poses: np.ndarray
) -> None:
    """Far commands too end in the machine's own assembly mode."""
    poses = reachable_poses[:400]
    u = inverse_kinematics(tripod, poses) - tripod.parameters.slider_home
    np.testing.assert_allclose(forward_poses(mechanism, u).transforms, placement(poses), atol=1e-11)


def test_motion_coordinates_can_be_held(tripod: Tripod, mechanism: Mechanism, reachable_poses: np.ndarray) -> None:
    poses = reachable_poses[:50]
    held = poses_at(mechanism, mechanism.motion_coordinates, poses - [0.0, 0.0, tripod.height_home])
    u = inverse_kinematics(tripod, poses) - tripod.parameters.slider_home
    np.testing.assert_allclose(held.commands, u, atol=1e-12)
    assert held.within_limits().all()
    np.testing.assert_array_equal(held[3:5].q, held.q[3:5])


def test_a_command_out_of_reach_is_named(mechanism: Mechanism) -> None:
    with pytest.raises(ConvergenceError, match="row 1"):
        forward_poses(mechanism, [[0.0, 0.0, 0.0], [0.5, -0.5, 0.0]])


def test_shapes_are_checked(mechanism: Mechanism) -> None:
    with pytest.raises(InvalidValueError, match=r"shape \(n, 3\)"):
        forward_poses(mechanism, [0.0, 0.0, 0.0])
    with pytest.raises(InvalidValueError, match="row 1"):
        forward_poses(mechanism, [[0.0, 0.0, 0.0], [np.nan, 0.0, 0.0]])
    with pytest.raises(InvalidValueError, match="guesses"):
        forward_poses(mechanism, [[0.0, 0.0, 0.0]], np.zeros(3))
    assert len(forward_poses(mechanism, np.empty((0, 3)))) == 0
