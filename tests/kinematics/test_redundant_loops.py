"""Loops that other loops or couplings hold where they alone would be singular have no singular pose there.

All machines are planar, about y, with answers by hand.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

ENGINES: tuple[Engine, ...] = ("program", "pinocchio")


class Linkage:
    """A planar linkage that grows joint by joint; places are x and z in the parent's axes."""

    def __init__(self) -> None:
        self.model = pin.Model()

    def joint(self, name: str, parent: str, x: float, z: float, kind: type | None = None) -> str:
        kind = kind or pin.JointModelRY
        at = pin.SE3(np.eye(3), np.array([x, 0.0, z]))
        self.model.addJoint(self.model.getJointId(parent) if parent else 0, kind(), at, name)
        return name

    def frame(self, name: str, joint: str, x: float, z: float) -> str:
        at = pin.SE3(np.eye(3), np.array([x, 0.0, z]))
        self.model.addFrame(pin.Frame(name, self.model.getJointId(joint), at, pin.FrameType.OP_FRAME))
        return name

    def robot(self, loops: list[tuple[str, str, str]], drives: list[str], tool: str, **parts: object) -> Robot:
        closures = [LoopClosure(*loop) for loop in loops]
        return Robot(self.model, closures, actuated_joints=drives, tool_frame=tool, **parts)


def joints(robot: Robot, q: np.ndarray, *names: str) -> np.ndarray:
    return np.array([[robot.configuration(row).joint_position(name) for name in names] for row in q])


@pytest.mark.parametrize("engine", ENGINES)
def test_a_plate_on_three_equal_cranks_turns_all_the_way(engine: Engine) -> None:
    """Two of the cranks are a parallelogram, flat at home; the third one is beside their line."""
    linkage = Linkage()
    linkage.joint("first", "", 0.0, 0.0)
    linkage.joint("plate", "first", 0.1, 0.0)
    loops = []
    for k, (x, z) in enumerate([(0.3, 0.0), (0.15, 0.25)]):
        linkage.joint(f"crank{k}", "", x, z)
        loops.append((linkage.frame(f"pin{k}", f"crank{k}", 0.1, 0.0), linkage.frame(f"hole{k}", "plate", x, z), "3d"))
    robot = linkage.robot(loops, ["first"], "hole0")
    angles = np.random.default_rng(0).uniform(-3.0, 3.0, 20)
    poses = robot.forward(angles[:, None], on_failure="nan", engine=engine)
    assert poses.solved.all()
    expected = np.column_stack([-angles, angles, angles])
    np.testing.assert_allclose(joints(robot, poses.q, "plate", "crank0", "crank1"), expected, atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_cardan_gear_passes_the_pose_in_which_its_cranks_lie_on_each_other(engine: Engine) -> None:
    """The gear turns the second crank by twice the first one's angle: its end stays on a line, at 0.2 m sin(angle)."""
    linkage = Linkage()
    linkage.joint("carrier", "", 0.0, 0.0)
    linkage.joint("planet", "carrier", 0.0, 0.1)
    linkage.joint("slide", "", 0.0, 0.0, pin.JointModelPX)
    ends = (linkage.frame("end", "planet", 0.0, -0.1), linkage.frame("block", "slide", 0.0, 0.0), "3d")
    gear = Coupling("planet", ("carrier",), ((-2.0,),))
    robot = linkage.robot([ends], ["slide"], "block", couplings=[gear])
    places = np.linspace(-0.19, 0.19, 12)
    poses = robot.forward(places[:, None], on_failure="nan", engine=engine)
    assert poses.solved.all()
    np.testing.assert_allclose(joints(robot, poses.q, "carrier")[:, 0], np.arcsin(places / 0.2), atol=1e-9)


@pytest.mark.parametrize("engine", ENGINES)
def test_a_gear_between_passive_joints_of_a_loop(engine: Engine) -> None:
    """Distal links that turn oppositely keep the five-bar symmetric: its base angles are opposite, too."""
    linkage = Linkage()
    for side, x in ((1, -0.1), (-1, 0.1)):
        linkage.joint(f"base{x:+}", "", x, 0.0)
        linkage.joint(f"elbow{x:+}", f"base{x:+}", 0.0, 0.2, pin.JointModelRUBY)
        linkage.frame(f"tip{x:+}", f"elbow{x:+}", side * 0.1, 0.2)
    gear = Coupling("elbow+0.1", ("elbow-0.1",), ((-1.0,),))
    robot = linkage.robot([("tip-0.1", "tip+0.1", "3d")], ["base-0.1"], "tip-0.1", couplings=[gear])
    angles = np.linspace(-0.3, 0.3, 9)
    poses = robot.forward(angles[:, None], on_failure="nan", engine=engine)
    assert poses.solved.all()
    found = joints(robot, poses.q, "base-0.1", "base+0.1", "elbow-0.1")
    np.testing.assert_allclose(found[:, 1], -found[:, 0], atol=1e-9)
    # the tip is above the middle: 0.2 sin(a) + 0.1 cos(a + b) + 0.2 sin(a + b) = 0.1
    a, both = found[:, 0], found[:, 0] + found[:, 2]
    np.testing.assert_allclose(0.2 * np.sin(a) + 0.1 * np.cos(both) + 0.2 * np.sin(both), 0.1, atol=1e-9)
