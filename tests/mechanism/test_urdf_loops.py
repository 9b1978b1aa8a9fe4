"""Loops and couplings in URDF files, in the words of others: mobility counted by hand."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.readers.urdf import read_urdf
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, JointNotFoundError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.mobility import instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot

Writer = Callable[..., Path]

_LINK = '<link name="{}"/>'
_HINGE = (
    '<joint name="{0}" type="revolute" independent="{4}"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}"/>'
    '<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
)
# a square of four rods, the last cut from its neighbour at (0, 0.3)
FOUR_BAR = (
    '<robot name="bars" xmlns:drake="http://drake.mit.edu">'
    + "".join(map(_LINK.format, ("base", "crank", "coupler", "rocker")))
    + _HINGE.format("j1", "base", "crank", "0 0 0", "true")
    + _HINGE.format("j2", "crank", "coupler", "0 0.3 0", "false")
    + _HINGE.format("j3", "base", "rocker", "0.4 0 0", "False")
    + "{}</robot>"
)
_ENDS = '<{0} link="coupler"><origin xyz="0.4 0 0"/></{0}><{1} link="rocker"><origin xyz="0 0.3 0"/></{1}>'
LOOPS = {
    "URDF+": f'<loop name="l" type="revolute">{_ENDS.format("predecessor", "successor")}<axis xyz="0 0 1"/></loop>',
    "constraint": '<constraint name="l" type="revolute"><parent link="coupler"/><parent_origin xyz="0.4 0 0"/>'
    '<parent_axis xyz="0 0 1"/><child link="rocker"/><child_origin xyz="0 0.3 0"/><child_axis xyz="0 0 1"/>'
    "</constraint>",
    "loop_joint": '<loop_joint name="l" type="spherical"><link1 link="coupler" xyz="0.4 0 0" rpy="0 0 0"/>'
    '<link2 link="rocker" xyz="0 0.3 0" rpy="0 0 0"/></loop_joint>',
    "loop_joint of Isaac Sim's manual": '<loop_joint name="l" type="spherical"><link1 link="coupler" xyz="0.4 0 0"/>'
    '<link1 link="rocker" xyz="0 0.3 0"/></loop_joint>',
    "Drake": '<drake:ball_constraint><drake:ball_constraint_body_A name="coupler"/>'
    '<drake:ball_constraint_body_B name="rocker"/><drake:ball_constraint_p_AP value="0.4 0 0"/>'
    '<drake:ball_constraint_p_BQ value="0 0.3 0"/></drake:ball_constraint>',
    "Gazebo": '<gazebo><joint name="l" type="revolute"><pose>0 0.3 0 0 0 0</pose><parent>coupler</parent>'
    "<child>rocker</child><axis><xyz>0 0 1</xyz></axis></joint></gazebo>",
    "Gazebo, placed in other frames": '<gazebo><joint name="l" type="revolute"><pose relative_to="j1">0.4 0.3 0 '
    '1.57 0 0</pose><parent>coupler</parent><child>rocker</child><axis><xyz expressed_in="base">0 0 1</xyz></axis>'
    "</joint></gazebo>",
}


@pytest.mark.parametrize("dialect", LOOPS)
def test_a_four_bar_has_one_degree_of_freedom(write_robot: Writer, dialect: str) -> None:
    robot = Robot.load(write_robot(FOUR_BAR.format(LOOPS[dialect]), "{}\n"))
    assert [loop.type for loop in robot.closures] == ["3d" if dialect.startswith(("loop_joint", "Drake")) else "hinge"]
    assert robot.home.closure_residual < 1e-15
    assert DegreesOfFreedom(robot.home).count == 1
    assert robot.actuated_joints == ("j1",)
    found = robot.assemble(joints={"j1": 0.5})
    # the rods form a parallelogram: the coupler keeps its direction
    np.testing.assert_allclose(found.q, [0.5, -0.5, 0.5], atol=1e-9)


def test_independent_is_the_default_beside_joints_that_are_not(write_robot: Writer) -> None:
    text = FOUR_BAR.format(LOOPS["URDF+"]).replace('independent="true"', "")
    assert Robot.load(write_robot(text, "{}\n")).actuated_joints == ("j1",)
    without_loop = text.replace(LOOPS["URDF+"], "")  # as if a program closed it
    assert Robot.load(write_robot(without_loop, "{}\n")).actuated_joints == ("j1",)
    text = text.replace('independent="false"', "").replace('independent="False"', "")
    assert Robot.load(write_robot(text, "{}\n")).actuated_joints == ()


def test_a_loop_without_drives_has_those_whose_stiffness_is_given(write_robot: Writer) -> None:
    """A crank of 0.3 m with 1e5 N m/rad gives the coupler of a parallelogram 1e5 / 0.3^2 N/m along its circle."""
    text = FOUR_BAR.format(LOOPS["URDF+"])
    for value in ("true", "false", "False"):
        text = text.replace(f'independent="{value}"', "")
    path = write_robot(text, "{}\n")
    with pytest.raises(DescriptionError, match="--drives JOINT"):
        Robot.load(path, tool_frame="coupler", drive_stiffness=1e5)
    with pytest.raises(JointNotFoundError, match="no joint 'j9'"):
        Robot.load(path, tool_frame="coupler", drive_stiffness={"j9": 1e5})
    robot = Robot.load(path, tool_frame="coupler", drive_stiffness={"j1": 1e5})
    expected = np.zeros((6, 6))
    expected[0, 0] = 0.3**2 / 1e5
    np.testing.assert_allclose(compliance(robot, robot.home), expected, rtol=1e-9, atol=1e-18)
    named = Robot.load(path, tool_frame="coupler", drives=["j1"], drive_stiffness=1e5)
    np.testing.assert_allclose(compliance(named, named.home), expected, rtol=1e-9, atol=1e-18)


def test_drives_named_when_loading(write_robot: Writer) -> None:
    """A parallelogram: at a quarter of a radian of either crank, both are there."""
    path = write_robot(FOUR_BAR.format(LOOPS["URDF+"]), "{}\n")
    robot = Robot.load(path, tool_frame="coupler", drives=["j3"])
    assert robot.actuated_joints == ("j3",)
    assert [command.joint for command in robot.commands] == ["j3"]
    poses = robot.forward([0.25])
    np.testing.assert_allclose(np.abs(poses.q), 0.25, atol=1e-9)
    with pytest.raises(JointNotFoundError, match="drives: no joint 'j9'"):
        Robot.load(path, drives=["j9"])
    with pytest.raises(InvalidValueError, match="each joint once"):
        Robot.load(path, drives=["j1", "j1"])


def test_mobility_needs_no_tool(write_robot: Writer) -> None:
    path = write_robot(FOUR_BAR.format(LOOPS["URDF+"]), "{}\n")
    robot, at_tool = Robot.load(path), Robot.load(path, tool_frame="coupler")
    without, given = instantaneous_mobility(robot.home), instantaneous_mobility(at_tool.home)
    assert (without.count, without.tool_mobility, given.count, given.tool_mobility) == (1, 0, 1, 1)
    assert without.redundant_constraints == given.redundant_constraints == 3
    assert without.idle_motions.shape == (3, 0)


def test_every_closure_knows_its_line(write_robot: Writer) -> None:
    path = write_robot(FOUR_BAR.format("\n\n" + LOOPS["URDF+"]), "{}\n")
    (closure,) = read_urdf(read_xml(path)).closures
    assert (closure.origin.path, closure.origin.line) == (path, 3)


def test_a_coupling_of_urdf_plus_is_a_gear(write_robot: Writer) -> None:
    # ratio times the joints to the predecessor is the sum of those to the successor
    text = FOUR_BAR.format(
        '<coupling name="c"><predecessor link="coupler"/><successor link="rocker"/><ratio value="6"/></coupling>'
    )
    robot = Robot.load(write_robot(text, "{}\n"))
    assert DegreesOfFreedom(robot.home).count == 2
    (coupling,) = robot.couplings
    q = dict(zip(robot.q_names, robot.assemble([0.1, 0.05, 0.0], joints={"j1": 0.1, "j2": 0.05}).q, strict=True))
    assert q["j3"] == pytest.approx(6.0 * (0.1 + 0.05), rel=1e-9)
    assert coupling.joint == "j3"


GEARBOX = """<gazebo><joint name="g" type="gearbox"><parent>crank</parent><child>rocker</child>
<gearbox_reference_body>base</gearbox_reference_body><gearbox_ratio>2.5</gearbox_ratio>
<axis><xyz>0 0 {}</xyz></axis><axis2><xyz>0 0 1</xyz></axis2></joint></gazebo>"""
TENDON = """<drake:tendon_constraint><drake:tendon_constraint_joint name="j1" a="{}"/>
<drake:tendon_constraint_joint name="j3" a="2"/><drake:tendon_constraint_lower_limit value="0.2"/>
<drake:tendon_constraint_upper_limit value="{}"/><drake:tendon_constraint_offset value="0.1"/>
</drake:tendon_constraint>"""


@pytest.mark.parametrize(
    ("element", "coefficient", "offset"),
    [
        (GEARBOX.format(1), -2.5, 0.0),
        (GEARBOX.format(-1), 2.5, 0.0),
        (TENDON.format(0.5, 0.2), -0.25, 0.05),
    ],
)
def test_gearboxes_and_tendons_couple_joints(
    write_robot: Writer, element: str, coefficient: float, offset: float
) -> None:
    """A gearbox has theta_2 = -ratio theta_1 (sdformat); a tendon of equal limits sum(a q) + offset = limit (Drake)."""
    (coupling,) = Robot.load(write_robot(FOUR_BAR.format(element), "{}\n")).couplings
    assert (coupling.joint, coupling.joints) == ("j3", ("j1",))
    np.testing.assert_allclose(coupling.coefficients, [[coefficient]])
    assert coupling.offset == pytest.approx(offset)


@pytest.mark.parametrize(
    ("element", "message"),
    [
        (GEARBOX.format(1).replace(">rocker<", ">coupler<"), "a hinge of the tree between 'coupler'"),
        (GEARBOX.format(1).replace("0 0 1</xyz></axis>", "0 1 0</xyz></axis>"), "its axis to be that of joint 'j1'"),
        (GEARBOX.format(1).replace(">base<", ">bsae<"), "expected an existing link, not 'bsae'"),
        (TENDON.format(1, 0.3), "expected equal limits"),
        (TENDON.format(1, 0.2).replace("j3", "j9"), "each once, not 'j9'"),
    ],
)
def test_other_gearboxes_and_tendons_are_refused_by_line(write_robot: Writer, element: str, message: str) -> None:
    with pytest.raises(DescriptionError, match=rf"line \d+: .*{message}"):
        Robot.load(write_robot(FOUR_BAR.format(element), "{}\n"))


def test_drakes_distances_are_closures(write_robot: Writer) -> None:
    text = LOOPS["Drake"].replace("ball_", "distance_").replace("0.4 0 0", "0.4 0 0.1")
    text = text.replace("</drake:distance", '<drake:distance_constraint_distance value="0.1"/></drake:distance', 1)
    (closure,) = (robot := Robot.load(write_robot(FOUR_BAR.format(text), "{}\n"))).closures
    assert (closure.type, closure.length) == ("distance", 0.1)
    assert robot.home.closure_residual < 1e-15


def test_a_gazebo_plugin_makes_a_joint_follow(write_robot: Writer) -> None:
    text = FOUR_BAR.format(
        '<gazebo><plugin name="p" filename="libmimic.so"><joint>j1</joint><mimicJoint>j3</mimicJoint>'
        "<multiplier>-2</multiplier><offset>0.1</offset></plugin></gazebo>"
    )
    (coupling,) = Robot.load(write_robot(text, "{}\n")).couplings
    assert (coupling.joint, coupling.joints, coupling.value([0.3])) == ("j3", ("j1",), pytest.approx(-0.5))
    # as Talos' gripper has it: the follower was fixed later
    fixed = '<link name="jaw"/><joint name="held" type="fixed"><parent link="base"/><child link="jaw"/></joint>'
    robot = Robot.load(
        write_robot(text.replace("<mimicJoint>j3", "<mimicJoint>held").replace("<gazebo>", f"{fixed}<gazebo>"), "{}\n")
    )
    assert robot.couplings == ()


def test_transmissions_say_what_drives_a_loop(write_robot: Writer) -> None:
    drive = (
        '<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="j3"/>'
        '<actuator name="m"><mechanicalReduction>50</mechanicalReduction><drake:rotor_inertia value="1e-6"/></actuator>'
        "</transmission>"
    )
    robot = Robot.load(write_robot(FOUR_BAR.format(LOOPS["Drake"] + drive), "{}\n"))
    assert robot.actuated_joints == ("j3",)
    assert robot.model.armature.tolist() == [0.0, 0.0, 50.0**2 * 1e-6]


@pytest.mark.parametrize(
    ("element", "said"),
    [
        (
            '<jonit name="x"><parent link="base"/><child link="crank"/></jonit>',
            "is unknown in <robot>, expected <joint>",
        ),
        ("<drake:linear_bushing_rpy/>", "is not supported"),
        ('<loop_closure><link1 link="base"/></loop_closure>', "may connect bodies"),
        ('<constraint name="c" type="screw"><parent link="base"/><child link="crank"/></constraint>', "not 'screw'"),
    ],
)
def test_what_may_close_a_loop_is_refused_by_name_and_line_or_listed(
    write_robot: Writer, element: str, said: str
) -> None:
    path = write_robot(FOUR_BAR.format("\n" + element), "{}\n")
    with pytest.raises(DescriptionError, match=rf"{path}, line 2: <{element[1:6]}.*{said}.*lenient"):
        read_urdf(read_xml(path))
    (unread,) = read_urdf(read_xml(path), lenient=True).unread
    assert said in str(unread)
    assert "line 2" in str(unread)


def test_what_has_no_meaning_here_is_listed(write_robot: Writer) -> None:
    text = FOUR_BAR.format('<gazebo reference="crank"><mu1>0.2</mu1></gazebo><weather/>').replace(
        'effort="1"', 'effort="1" current="3"', 1
    )
    description = read_urdf(read_xml(write_robot(text, "{}\n")))
    assert [entry.element for entry in description.unread] == ["<weather>", "<limit> current", "<gazebo>"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ('link="rocker"><origin', 'link="ghost"><origin', "expected an existing link, not 'ghost'"),
        ('xyz="0 0.3 0"/></succ', 'xyz="0 0.3"/></succ', "origin: xyz: expected 3 numbers"),
        ("successor", "heir", "expected <successor>"),
        ('<axis xyz="0 0 1"/></loop>', '<axis xyz="0 0 0"/></loop>', "axis: expected a direction"),
    ],
)
def test_a_damaged_loop_is_one_error(write_robot: Writer, old: str, new: str, said: str) -> None:
    text = FOUR_BAR.format("\n" + LOOPS["URDF+"].replace(old, new))
    path = write_robot(text, "{}\n")
    with pytest.raises(DescriptionError, match=rf"line 2: <loop name='l'>.*{said}"):
        read_urdf(read_xml(path))


def test_a_universal_joint_of_drake_has_two_hinges(write_robot: Writer) -> None:
    text = (
        '<robot name="r"><link name="a"/><link name="b"/><drake:joint name="u" type="universal"><parent link="a"/>'
        '<child link="b"/><origin xyz="0 0 1"/></drake:joint></robot>'
    )
    robot = Robot.load(write_robot(text, "{}\n"))
    assert robot.q_names == ("u_x", "u_y")
    found = robot.configuration([0.3, 0.4]).frame_placement("b").rotation
    turn = [[math.cos(0.4), 0.0, math.sin(0.4)]]
    np.testing.assert_allclose(found[:1], turn, atol=1e-15)


def test_a_planar_joint_moves_across_its_axis(write_robot: Writer) -> None:
    """URDF: in the plane perpendicular to the axis; numbers of limits and dynamics, three in Drake, have no meaning."""
    text = (
        '<robot name="r"><link name="floor"/><link name="cart"/><joint name="move" type="planar"><parent link="floor"/>'
        '<child link="cart"/><axis xyz="0.6 0 0.8"/><dynamics damping="0.1 0.1 0.1"/></joint></robot>'
    )
    robot = Robot.load(write_robot(text, "{}\n"))
    twists = robot.configuration(robot.home.q).frame_jacobian("cart")
    normal = np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(normal @ twists[:3], 0.0, atol=1e-15)
    np.testing.assert_allclose(np.cross(twists[3:].T, normal), 0.0, atol=1e-15)
    assert robot.home.frame_placement("cart").isApprox(pin.SE3.Identity(), 1e-12)


def test_the_world_of_drakes_urdf_needs_no_link(write_robot: Callable[..., Path]) -> None:
    weld = '<joint name="weld" type="fixed"><parent link="world"/><child link="arm"/></joint>'
    robot = Robot.load(write_robot(f'<robot name="r"><link name="arm"/>{weld}</robot>', "{}\n"))
    assert robot.description.root.name == "world"
