"""Small mechanisms with closed-form kinematics, written as a user would: a URDF and its closures file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.kinematics.robot import Robot

_LINK = '<link name="{0}"/>\n'
_REVOLUTE = """<joint name="{name}" type="revolute">
  <parent link="{parent}"/><child link="{child}"/><origin xyz="{x} {y} 0"/><axis xyz="0 0 1"/>
  <limit lower="-3.2" upper="3.2" effort="1" velocity="1"/>
</joint>
"""
_SLIDE = """<joint name="{name}" type="prismatic">
  <parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>
  <limit lower="-2" upper="2" effort="1" velocity="1"/>
</joint>
"""
_FIXED = """<joint name="{child}_fixed" type="fixed">
  <parent link="{parent}"/><child link="{child}"/><origin xyz="{x} {y} 0"/>
</joint>
"""


def _urdf(name: str, links: str, joints: str) -> str:
    return f'<robot name="{name}">\n' + "".join(map(_LINK.format, links.split())) + joints + "</robot>\n"


def four_bar_urdf(crank: float, coupler: float, rocker: float, ground: float, crank_type: str = "revolute") -> str:
    """A planar four-bar: crank and rocker pivot on the ground, at (0, 0) and (ground, 0); q = 0 has all along x."""
    joints = (
        _REVOLUTE.format(name="crank_joint", parent="ground", child="crank", x=0, y=0).replace("revolute", crank_type)
        + _REVOLUTE.format(name="coupler_joint", parent="crank", child="coupler", x=crank, y=0)
        + _REVOLUTE.format(name="rocker_joint", parent="ground", child="rocker", x=ground, y=0)
        + _FIXED.format(parent="coupler", child="coupler_tip", x=coupler, y=0)
        + _FIXED.format(parent="rocker", child="rocker_tip", x=rocker, y=0)
    )
    return _urdf("four_bar", "ground crank coupler rocker coupler_tip rocker_tip", joints)


FOUR_BAR_CLOSURES = """closed_loop: [[coupler_tip, rocker_tip]]
type: ['3d']
name_mot: [{driven}]
tool_frame: {tool}
"""


def five_bar_urdf(proximal: float, distal: float, ground: float) -> str:
    """A planar five-bar with pivots at (-+ground/2, 0), whose tool slides in x and y and joins the two arms' tips."""
    joints = _SLIDE.format(name="x_joint", parent="base", child="carriage", axis="1 0 0")
    joints += _SLIDE.format(name="y_joint", parent="carriage", child="tool", axis="0 1 0")
    for side, x in (("left", -ground / 2), ("right", ground / 2)):
        joints += _REVOLUTE.format(name=f"{side}_joint", parent="base", child=f"{side}_proximal", x=x, y=0)
        joints += _REVOLUTE.format(
            name=f"{side}_elbow", parent=f"{side}_proximal", child=f"{side}_distal", x=proximal, y=0
        )
        joints += _FIXED.format(parent=f"{side}_distal", child=f"{side}_tip", x=distal, y=0)
    links = "base carriage tool left_proximal left_distal left_tip right_proximal right_distal right_tip"
    return _urdf("five_bar", links, joints)


FIVE_BAR_CLOSURES = """closed_loop: [[left_tip, tool], [right_tip, tool]]
type: ['3d', '3d']
name_mot: [{driven}]
tool_frame: tool
motion_coordinates: [{coordinates}]
"""


@pytest.fixture(scope="session")
def write_robot(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Write a robot's files into a new folder and return the path of its URDF."""

    def write(urdf: str, closures: str, srdf: str | None = None) -> Path:
        path = tmp_path_factory.mktemp("robot") / "little.urdf"
        path.write_text(urdf)
        path.with_suffix(".closures.yaml").write_text(closures)
        if srdf is not None:
            path.with_suffix(".srdf").write_text(srdf)
        return path

    return write


@pytest.fixture(scope="session")
def make_four_bar(write_robot: Callable[..., Path]) -> Callable[..., Robot]:
    """Load a four-bar; see :func:`four_bar_urdf`. It is driven at the crank by default."""

    def make(
        *lengths: float, crank_type: str = "revolute", driven: str = "crank_joint", tool: str = "coupler"
    ) -> Robot:
        closures = FOUR_BAR_CLOSURES.format(driven=driven, tool=tool)
        return Robot.load(write_robot(four_bar_urdf(*lengths, crank_type=crank_type), closures))

    return make


@pytest.fixture(scope="session")
def make_five_bar(write_robot: Callable[..., Path]) -> Callable[..., Robot]:
    """Load a five-bar; see :func:`five_bar_urdf`. It is driven at the two pivots on the ground by default."""

    def make(*lengths: float, driven: str = "left_joint, right_joint", coordinates: str = "x_joint, y_joint") -> Robot:
        closures = FIVE_BAR_CLOSURES.format(driven=driven, coordinates=coordinates)
        return Robot.load(write_robot(five_bar_urdf(*lengths), closures))

    return make


@pytest.fixture(scope="session")
def crank_rocker(make_four_bar: Callable[..., Robot]) -> Robot:
    """Crank 0.2, coupler 0.5, rocker 0.4, ground 0.6 m: the crank can rotate fully, so its joint is continuous."""
    return make_four_bar(0.2, 0.5, 0.4, 0.6, crank_type="continuous")


@pytest.fixture(scope="session")
def five_bar(make_five_bar: Callable[..., Robot]) -> Robot:
    """Proximal links 0.3, distal links 0.4, ground 0.2 m."""
    return make_five_bar(0.3, 0.4, 0.2)


@dataclass(frozen=True)
class Gough:
    """A Gough platform: feet in the world and heads on the platform, shape=(6, 3) [m]."""

    mechanism: Robot
    feet: NDArray[np.float64]
    heads: NDArray[np.float64]


@pytest.fixture(scope="session")
def gough() -> Gough:
    """A Gough platform built in code: a free-flyer and six legs of a spherical and a prismatic joint.

    The strut coordinates are the leg lengths. Every leg can spin about its axis. The geometry is that of
    T. Dehaeze's hexapod, with the platform's frame at the heads' height.
    """
    foot_angles, head_angles = np.radians([-10, 10, 110, 130, 230, 250]), np.radians([-50, 50, 70, 170, 190, -70])
    feet = np.column_stack([0.115 * np.cos(foot_angles), 0.115 * np.sin(foot_angles), np.full(6, 0.015)])
    heads = np.column_stack([0.09 * np.cos(head_angles), 0.09 * np.sin(head_angles), np.zeros(6)])
    model = pin.Model()
    model.name = "gough"
    platform = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "platform_joint")
    model.addFrame(pin.Frame("platform", platform, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    for leg in range(6):
        foot = model.addJoint(0, pin.JointModelSpherical(), pin.SE3(np.eye(3), feet[leg]), f"foot{leg}")
        strut = model.addJoint(foot, pin.JointModelPZ(), pin.SE3.Identity(), f"strut{leg}")
        model.addFrame(pin.Frame(f"tip{leg}", strut, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        model.addFrame(pin.Frame(f"head{leg}", platform, 0, pin.SE3(np.eye(3), heads[leg]), pin.FrameType.OP_FRAME))
    mechanism = Robot(
        model,
        [LoopClosure(f"tip{leg}", f"head{leg}", "3d") for leg in range(6)],
        actuated_joints=[f"strut{leg}" for leg in range(6)],
        tool_frame="platform",
    )
    return Gough(mechanism, feet, heads)


@pytest.fixture(scope="session")
def welded_four_bar() -> Robot:
    """The crank-rocker as one chain of four joints, welded to the ground: three rows of six are redundant."""
    model = pin.Model()
    model.name = "welded_four_bar"
    parent, offset = 0, 0.0
    for index, length in enumerate((0.2, 0.5, 0.4)):
        placement = pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0]))
        parent, offset = model.addJoint(parent, pin.JointModelRZ(), placement, f"joint{index}"), length
    parent = model.addJoint(parent, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([offset, 0.0, 0.0])), "joint3")
    model.addFrame(pin.Frame("end", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("pivot", 0, 0, pin.SE3(np.eye(3), np.array([0.6, 0.0, 0.0])), pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("coupler", 2, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Robot(model, [LoopClosure("pivot", "end", "6d")], actuated_joints=["joint0"], tool_frame="coupler")


@pytest.fixture(scope="session")
def ur5() -> Robot:
    """A serial arm with six joints, from example-robot-data."""
    import example_robot_data

    return Robot(example_robot_data.load("ur5").model, tool_frame="tool0")
