"""The general engine against the closed form of the tripod, at every reachable pose."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, joint_positions, motion_twists, placement
from pm3dof_pin.chapter.kinematics import slider_jacobian as closed_form_jacobian
from pm3dof_pin.kinematics.actuation import independent_motions
from pm3dof_pin.kinematics.robot import Robot


def test_constraint_jacobian_kinematics_all_over_the_workspace(
    mechanism: Robot, tripod: Tripod, reachable_poses: np.ndarray
) -> None:
    """Loops closed, tool in place, J_t and the platform's twists equal to 1e-12 of the largest entry."""
    reachable_poses = reachable_poses[:1000]
    jacobians = closed_form_jacobian(tripod, reachable_poses)
    twists = motion_twists(reachable_poses)
    placements = placement(reachable_poses)
    columns = mechanism.velocity_indices(mechanism.motion_coordinates)
    worst = np.zeros(4)
    for pose, expected, twist, transform in zip(reachable_poses, jacobians, twists, placements, strict=True):
        q, _ = mechanism.place_joints(mechanism.home.q, joint_positions(tripod, pose))
        configuration = mechanism.configuration(q)
        errors = [
            configuration.closure_error,
            configuration.tool_placement.homogeneous - transform,
            (independent_motions(configuration)[configuration.mechanism.actuated_indices] - expected)
            / np.abs(expected).max(),
            configuration.tool_jacobian[:, columns] - twist,
        ]
        worst = np.maximum(worst, [np.abs(error).max() for error in errors])
    assert np.all(worst < 1e-12), worst


def test_general_geometry_finds_the_closed_form(mechanism: Robot, tripod: Tripod, reachable_poses: np.ndarray) -> None:
    """From home, given only slider travels or a pose."""
    for pose in reachable_poses[:50]:
        u = inverse_kinematics(tripod, pose)
        forward = mechanism.forward(u).configuration()
        np.testing.assert_allclose(forward.tool_placement.homogeneous, placement(pose), atol=1e-11)
        inverse = mechanism.reach(placement(pose)).configuration()
        np.testing.assert_allclose(inverse.commands, u, atol=1e-11)
