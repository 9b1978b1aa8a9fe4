from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.actuation import independent_motions, motion_components, tool_motions
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

GUESS = [0.0, 0.5, 2.2, -1.3, 0.9, 1.3]


@pytest.fixture(params=range(10))
def pose(five_bar: Robot, request: pytest.FixtureRequest) -> Configuration:
    tip = np.random.default_rng(request.param).uniform([-0.15, 0.3], [0.15, 0.55])
    return five_bar.solve(tip, guess=GUESS).configuration()


def five_bar_jacobian(configuration: Configuration) -> np.ndarray:
    """Differentiated link lengths: (tip - elbow) . d tip = (tip - elbow) . (z x (elbow - pivot)) du."""
    tip = configuration.tool_placement.translation
    rows = []
    for side in ("left", "right"):
        pivot = configuration.frame_placement(f"{side}_proximal").translation
        elbow = configuration.frame_placement(f"{side}_distal").translation
        link = tip - elbow
        rows.append(link[:2] / (link @ np.cross([0.0, 0.0, 1.0], elbow - pivot)))
    return np.array(rows)


def test_five_bar_against_its_closed_form(pose: Configuration) -> None:
    np.testing.assert_allclose(
        independent_motions(pose)[pose.mechanism.actuated_indices], five_bar_jacobian(pose), rtol=1e-12, atol=1e-12
    )
    np.testing.assert_allclose(tool_motions(pose), np.eye(6)[:, :2], atol=1e-14)


def test_five_bar_against_finite_differences(five_bar: Robot, pose: Configuration) -> None:
    columns = []
    for direction in np.eye(2):
        ahead, behind = (
            five_bar.solve(five_bar.at(pose.q).coordinates + step * direction, guess=pose).configuration().commands
            for step in (1e-6, -1e-6)
        )
        columns.append((ahead - behind) / 2e-6)
    np.testing.assert_allclose(
        independent_motions(pose)[pose.mechanism.actuated_indices], np.column_stack(columns), atol=1e-7
    )


def test_without_coordinates_the_tools_own_twists_serve(five_bar: Robot, pose: Configuration) -> None:
    plain = Robot(five_bar.model, five_bar.closures, actuated_joints=five_bar.actuated_joints, tool_frame="tool")
    configuration = plain.configuration(pose.q)
    assert motion_components(configuration) == ("x", "y")
    np.testing.assert_allclose(tool_motions(configuration), np.eye(6)[:, :2], atol=1e-14)
    np.testing.assert_allclose(
        independent_motions(configuration)[configuration.mechanism.actuated_indices],
        five_bar_jacobian(pose),
        rtol=1e-12,
        atol=1e-12,
    )


def test_gough_platform_against_its_closed_form(gough: Any) -> None:
    rng = np.random.default_rng(7)
    guess = gough.mechanism.assemble(joints={"platform_joint": [0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 1.0]})
    for _ in range(10):
        rotation, position = (
            pin.exp3(rng.uniform(-0.2, 0.2, 3)),
            np.array([0.0, 0.0, 0.12]) + rng.uniform(-0.02, 0.02, 3),
        )
        configuration = gough.mechanism.reach(pin.SE3(rotation, position), guess=guess).configuration()
        arms = gough.heads @ rotation.T
        legs = arms + position - gough.feet
        units = legs / np.linalg.norm(legs, axis=1, keepdims=True)
        wrenches = np.hstack([units, np.cross(arms, units)])
        sign = np.sign(configuration.commands)[:, None]
        np.testing.assert_allclose(tool_motions(configuration), np.eye(6), atol=1e-12)
        np.testing.assert_allclose(
            independent_motions(configuration)[configuration.mechanism.actuated_indices], sign * wrenches, atol=1e-12
        )


def test_motions_keep_the_loops_closed_and_idle_freedoms_at_rest(gough: Any) -> None:
    guess = gough.mechanism.assemble(joints={"platform_joint": [0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 1.0]})
    motions = independent_motions(guess)
    np.testing.assert_allclose(guess.constraint_jacobian @ motions, 0.0, atol=1e-14)
    model = gough.mechanism.model
    for leg in range(6):
        spin = model.joints[model.getJointId(f"foot{leg}")].idx_v + 2
        np.testing.assert_allclose(motions[spin], 0.0, atol=1e-14)


def test_serial_arm_inverts_its_jacobian(ur5: Robot) -> None:
    configuration = ur5.configuration([0.1, -1.0, 1.2, 0.3, 0.8, 0.2])
    rates = np.linalg.solve(configuration.tool_jacobian, tool_motions(configuration))
    np.testing.assert_allclose(
        independent_motions(configuration)[configuration.mechanism.actuated_indices], rates, atol=1e-12
    )


def test_the_characteristic_length_does_not_enter_coordinates(five_bar: Robot, pose: Configuration) -> None:
    other = Robot(
        five_bar.model,
        five_bar.closures,
        actuated_joints=five_bar.actuated_joints,
        tool_frame="tool",
        motion_coordinates=five_bar.motion_coordinates,
        characteristic_length=17.0,
    )
    np.testing.assert_allclose(
        independent_motions(other.configuration(pose.q))[other.actuated_indices],
        independent_motions(pose)[pose.mechanism.actuated_indices],
        rtol=1e-11,
    )


@pytest.mark.parametrize(
    ("coordinates", "reason"), [("x_joint, y_joint, left_joint", "not independent"), ("x_joint", "at rest")]
)
def test_coordinates_must_fit_the_mobility(make_five_bar: Any, coordinates: str, reason: str) -> None:
    five_bar = make_five_bar(0.3, 0.4, 0.2, coordinates=coordinates)
    with pytest.raises(SingularConfigurationError, match=reason):
        independent_motions(five_bar.assemble(GUESS))


def test_a_redundant_arm_moves_with_its_tool_at_rest() -> None:
    import example_robot_data

    panda = Robot(example_robot_data.load("panda").model, tool_frame="panda_hand")
    with pytest.raises(SingularConfigurationError, match="while the motions x, y, z, rx, ry, rz are at rest"):
        independent_motions(panda.configuration([0.1, -0.5, 0.3, -1.8, 0.2, 1.5, 0.4, 0.0, 0.0]))


def test_open_loops_are_refused(five_bar: Robot) -> None:
    with pytest.raises(InvalidValueError, match="closed loops"):
        independent_motions(five_bar.home)
