"""The springs whose colours bodies get."""

from __future__ import annotations

import pinocchio as pin
import pytest

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.legs import ColouredLegs, _actuator


def test_legs_of_the_tripod(mechanism: Robot) -> None:
    model = ElasticModel(mechanism)
    assert ColouredLegs(model).springs == [
        ("actuator1", "link1"),
        ("actuator2", "link2"),
        ("actuator3", "link3"),
        ("passive_leg",),
    ]
    legs = ColouredLegs(model)
    numbers = {mechanism.model.names[j]: legs.number(j) for j in legs.shares(dict.fromkeys(model.spring_names, 0.0))}
    expected = {"passive_slider_joint": 3}
    for leg in (1, 2, 3):
        joints = (f"slider{leg}_joint", f"universal{leg}_first_joint", f"universal{leg}_second_joint")
        expected |= dict.fromkeys(joints, leg - 1)
    assert numbers == expected  # the platform belongs to no leg


def test_shares_add_up_over_a_leg(mechanism: Robot) -> None:
    model = ElasticModel(mechanism)
    shares = {name: 2.0**-number for number, name in enumerate(model.spring_names)}
    found = ColouredLegs(model).shares(shares)
    slider = mechanism.model.getJointId("slider2_joint")
    assert found[slider] == shares["actuator2"] + shares["link2"]
    assert found[slider + 2] == found[slider]


def test_a_serial_robot_is_coloured_body_by_body() -> None:
    model = pin.Model()
    parent = 0
    for name in ("a", "b", "c"):
        parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3.Random(), name)
    springs = [JointSpring(f"spring_{name}", name, 1.0, "N m/rad") for name in "ac"]
    elastic = ElasticModel(Robot(model), springs)
    assert ColouredLegs(elastic).shares({"spring_a": 0.25, "spring_c": 0.75}) == {1: 0.25, 3: 0.75}


@pytest.mark.parametrize(("robot", "legs"), [("hexapod", 6), ("three_rps", 6)])
def test_other_robots(robot: str, legs: int) -> None:
    model = ElasticModel(Robot.load(robot))
    assert len(ColouredLegs(model).springs) == legs
    assert sorted(name for springs in ColouredLegs(model).springs for name in springs) == sorted(model.spring_names)


def test_a_body_behind_two_drives_is_moved_by_neither_alone() -> None:
    """A branch with two drives and a hinge at its end, and one with a drive between hinges."""
    model, parent = pin.Model(), 0
    model.name = "branches"
    for name in ("a1", "a2", "a3", "b1", "b2", "b3"):
        parent = model.addJoint(0 if name == "b1" else parent, pin.JointModelRX(), pin.SE3.Identity(), name)
        model.addFrame(pin.Frame(f"{name}_link", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = Robot(model, [], actuated_joints=["a1", "a2", "b2"], tool_frame="a3_link")
    found = [_actuator(robot, model.getJointId(name)) for name in ("a1", "a2", "a3", "b1", "b2", "b3")]
    assert found == [0, 1, None, 2, 2, 2]
