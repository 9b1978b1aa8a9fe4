from __future__ import annotations

import logging
import pickle
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import (
    DescriptionError,
    FrameNotFoundError,
    InvalidValueError,
    JointNotFoundError,
    UnknownRobotError,
)
from pm3dof_pin.kinematics.robot import Robot

Writer = Callable[..., Path]

ARM = """<robot name="arm">
<link name="base"/><link name="forearm"/>
<joint name="elbow" type="revolute">
  <parent link="base"/><child link="forearm"/><axis xyz="0 0 1"/>
  <limit lower="-1" upper="2" effort="1" velocity="1"/>
</joint>
</robot>
"""
NO_CLOSURES = "closed_loop: []\ntype: []\nname_mot: [elbow]\ntool_frame: forearm\n"
SRDF = """<robot name="arm">
  <group_state name="home" group="all"><joint name="elbow" value="0.5"/></group_state>
  <group_state name="bent" group="all"><joint name="{joint}" value="{value}"/></group_state>
</robot>
"""


def test_a_loaded_mechanism_says_what_its_files_say(five_bar: Robot) -> None:
    assert five_bar.name == "five_bar"
    assert five_bar.actuated_joints == ("left_joint", "right_joint")
    assert set(five_bar.passive_joints) == {"x_joint", "y_joint", "left_elbow", "right_elbow"}
    assert [five_bar.model.names[1 + int(index)] for index in five_bar.actuated_indices] == [
        "left_joint",
        "right_joint",
    ]
    assert sorted([*five_bar.actuated_indices, *five_bar.passive_indices]) == list(range(five_bar.model.nv))
    assert five_bar.tool_frame == "tool"
    assert five_bar.motion_coordinates == ("x_joint", "y_joint")
    x, left = five_bar.q_names.index("x_joint"), five_bar.q_names.index("left_joint")
    assert (five_bar.lower_limits[x], five_bar.upper_limits[left]) == (-2.0, 3.2)
    np.testing.assert_array_equal(
        five_bar.velocity_scale != 1.0, [name in ("x_joint", "y_joint") for name in five_bar.q_names]
    )


def test_a_continuous_joint_has_no_limits_and_two_coordinates(crank_rocker: Robot) -> None:
    first = crank_rocker.q_names.index("crank_joint[0]")
    assert crank_rocker.q_names[first + 1] == "crank_joint[1]"
    assert np.isneginf(crank_rocker.lower_limits[first : first + 2]).all()
    assert np.isposinf(crank_rocker.upper_limits[first : first + 2]).all()
    assert crank_rocker.home.commands == 0.0


def test_without_closures_all_joints_are_driven(write_robot: Writer) -> None:
    mechanism = Robot.load(write_robot(ARM, NO_CLOSURES.replace("name_mot: [elbow]\n", "")))
    assert mechanism.actuated_joints == ("elbow",)
    assert mechanism.home.closure_residual == 0.0
    assert mechanism.home.constraint_jacobian.shape == (0, 1)


def test_home_and_named_configurations_come_from_the_srdf(write_robot: Writer) -> None:
    mechanism = Robot.load(write_robot(ARM, NO_CLOSURES, SRDF.format(joint="elbow", value="1.5")))
    assert {name: q.tolist() for name, q in mechanism.named_configurations.items()} == {"home": [0.5], "bent": [1.5]}
    assert mechanism.home.q.tolist() == [0.5]


def test_arrays_are_read_only_and_the_model_is_a_copy(five_bar: Robot) -> None:
    for array in (
        five_bar.actuated_indices,
        five_bar.passive_indices,
        five_bar.lower_limits,
        five_bar.upper_limits,
        five_bar.velocity_scale,
        five_bar.closure_scale,
    ):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 0
    model = five_bar.model.copy()
    mechanism = Robot(model, five_bar.closures, tool_frame="tool")
    before = mechanism.home.closure_error
    model.jointPlacements[1] = pin.SE3.Random()
    np.testing.assert_array_equal(mechanism.home.closure_error, before)


def test_characteristic_length_is_the_rms_radius_of_the_points(make_four_bar: Callable[..., Robot]) -> None:
    mechanism = make_four_bar(0.3, 0.5, 0.3, 0.5)
    # along x: joints at 0, 0.3, 0.5; closure points twice at 0.8; the tool frame with its joint at 0.3
    points = np.array([0.0, 0.3, 0.5, 0.8, 0.8, 0.3])
    assert mechanism.characteristic_length == pytest.approx(points.std(), rel=1e-14)
    assert Robot(mechanism.model, mechanism.closures, characteristic_length=2.0).characteristic_length == 2.0


def test_mechanisms_and_configurations_survive_pickling(five_bar: Robot) -> None:
    configuration = five_bar.solve([0.05, 0.5], guess=[0.0, 0.5, 2.2, -1.3, 0.9, 1.3]).configuration()
    copy = pickle.loads(pickle.dumps(configuration))
    np.testing.assert_array_equal(copy.q, configuration.q)
    np.testing.assert_array_equal(copy.constraint_jacobian, configuration.constraint_jacobian)
    assert repr(copy.mechanism) == repr(five_bar)
    assert copy.mechanism.characteristic_length == five_bar.characteristic_length


def test_unknown_robot() -> None:
    with pytest.raises(UnknownRobotError, match="no_such_robot"):
        Robot.load("no_such_robot")


@pytest.mark.parametrize(
    ("urdf", "place", "reason"),
    [
        ("no XML at all", "line 1", "XML"),
        (ARM.replace("</joint>", "</joynt>"), "line 6", "mismatched tag"),
        (
            ARM.replace("robot", "machine"),
            "file",
            "<machine>, which is not supported: expected URDF, xacro, MJCF or SDF",
        ),
        ('<sdf version="1.9"><model name="arm"/></sdf>', "<model name='arm'>", "has no links"),
        (ARM.replace('<link name="forearm"/>', ""), "joint 'elbow': child", "forearm"),
        (ARM.replace('lower="-1"', 'lower="low"'), "joint 'elbow': limit: lower", "'low'"),
        (ARM.replace("<axis ", '<axis xyz="1 0 0"/><axis ', 1), "<axis>", "stands 2 times in one element"),
        (ARM.replace("<axis", '<origin xyx="1 0 0"/><axis', 1), "<origin>", "unknown attribute 'xyx', expected 'xyz'"),
        (ARM.replace("<axis xyz", "<axis XYZ", 1), "<axis>", "unknown attribute 'XYZ', expected 'xyz'"),
        (re.sub("<axis [^/]*/>", "<axis/>", ARM), "joint '.*': axis", "has no xyz, expected 3 numbers"),
    ],
)
def test_a_bad_urdf_is_one_error_and_silence(
    write_robot: Writer, capfd: pytest.CaptureFixture[str], urdf: str, place: str, reason: str
) -> None:
    path = write_robot(urdf, NO_CLOSURES)
    with pytest.raises(DescriptionError, match=rf"(?s){path}(, line \d+)?: {place}.*{reason}"):
        Robot.load(path)
    assert capfd.readouterr() == ("", "")


def test_a_tool_that_cannot_move(write_robot: Writer) -> None:
    path = write_robot(ARM, NO_CLOSURES)
    with pytest.raises(DescriptionError, match="tool_frame: expected a frame that moves, not 'base'"):
        Robot.load(path, tool_frame="base")


@pytest.mark.parametrize(
    ("srdf", "error", "reason"),
    [
        ("<robot>", DescriptionError, "line 1"),
        (SRDF.format(joint="elbow", value="one"), DescriptionError, "bent.*elbow"),
    ],
)
def test_a_bad_srdf_is_one_error_and_silence(
    write_robot: Writer, capfd: pytest.CaptureFixture[str], srdf: str, error: type[Exception], reason: str
) -> None:
    path = write_robot(ARM, NO_CLOSURES, srdf)
    with pytest.raises(error, match=f"(?s){path.with_suffix('.srdf')}.*{reason}"):
        Robot.load(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("line", "error", "reason"),
    [
        ("closed_loop: [[forearm, ghost]]\ntype: ['3d']", FrameNotFoundError, r"closed_loop\[0\].*'ghost'.*forearm"),
        ("closed_loop: [[forearm, elbow]]\ntype: ['3d']", DescriptionError, r"closed_loop\[0\].*one body"),
        ("name_mot: [knee]", JointNotFoundError, "name_mot.*'knee'.*elbow"),
        ("motion_coordinates: [knee]", JointNotFoundError, "motion_coordinates.*'knee'.*elbow"),
        ("tool_frame: ghost", FrameNotFoundError, "tool_frame.*'ghost'.*forearm"),
    ],
)
def test_names_in_the_closures_file_are_looked_up(
    write_robot: Writer, line: str, error: type[Exception], reason: str
) -> None:
    path = write_robot(ARM, line)
    with pytest.raises(error, match=f"{path.with_suffix('.closures.yaml')}.*{reason}"):
        Robot.load(path)


def test_a_joint_with_several_degrees_of_freedom_cannot_be_driven() -> None:
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with pytest.raises(DescriptionError, match=r"ball.*several degrees of freedom"):
        Robot(model, actuated_joints=["ball"])
    assert Robot(model).actuated_joints == ()


@pytest.mark.parametrize("length", [0.0, -1.0, np.nan, np.inf])
def test_characteristic_length_is_a_positive_number(five_bar: Robot, length: float) -> None:
    with pytest.raises(InvalidValueError, match="characteristic_length"):
        Robot(five_bar.model, five_bar.closures, characteristic_length=length)


def test_what_follows_no_joint_is_refused_by_line_and_lenient_reads_over_it(write_robot: Writer) -> None:
    follower = '<link name="hand"/><joint name="wrist" type="revolute"><parent link="forearm"/><child link="hand"/>\n'
    text = ARM.replace("</robot>", f'{follower}<mimic joint="elbo"/></joint></robot>')
    with pytest.raises(
        DescriptionError, match=r"line 8: <mimic>: joint 'wrist' follows 'elbo', .*there is none.*lenient"
    ):
        Robot.load(write_robot(text, "{}\n"))
    assert Robot.load(write_robot(text, "{}\n"), lenient=True).couplings == ()


def test_a_transmission_of_a_fixed_joint_drives_nothing(write_robot: Writer) -> None:
    """As that of the PR2's casters in example-robot-data."""
    text = ARM.replace(
        "</robot>",
        '<link name="hand"/><joint name="wrist" type="fixed"><parent link="forearm"/><child link="hand"/></joint>'
        '<transmission name="t"><joint name="wrist"/></transmission></robot>',
    )
    robot = Robot.load(write_robot(text, "{}\n"))
    assert robot.actuated_joints == ("elbow",)
    assert any("fixed" in str(unread) for unread in robot.description.unread)


def test_moments_that_rounding_makes_negative_are_taken(write_robot: Writer) -> None:
    """A slender rod, as the iCub of example-robot-data has them after a turn; Pinocchio's constructor refuses them."""
    rod = '<inertial><mass value="1"/><inertia ixx="-1e-20" iyy="0.1" izz="0.1" ixy="0" ixz="0" iyz="0"/></inertial>'
    text = ARM.replace('<link name="forearm"/>', f'<link name="forearm">{rod}</link>')
    robot = Robot.load(write_robot(text, "{}\n"))
    np.testing.assert_allclose(robot.model.inertias[1].inertia, np.diag([0.0, 0.1, 0.1]), atol=1e-15)


def test_a_mimic_joint_follows(write_robot: Writer) -> None:
    fingers = ARM.replace("</robot>", "") + (
        '<link name="finger"/><joint name="finger_joint" type="revolute"><parent link="base"/><child link="finger"/>'
        '<mimic joint="elbow" multiplier="-0.5" offset="0.2"/></joint></robot>'
    )
    robot = Robot.load(write_robot(fingers, NO_CLOSURES))
    assert [coupling.joint for coupling in robot.couplings] == ["finger_joint"]
    assert robot.couplings[0].value([0.4]) == pytest.approx(0.0, abs=1e-15)
    assert robot.actuated_joints == ("elbow",)


@pytest.mark.parametrize(("kind", "nq"), [("revolute", 1), ("prismatic", 1)])
def test_a_joint_that_others_follow_by_a_broken_ratio_counts_its_turns(write_robot: Writer, kind: str, nq: int) -> None:
    """After a turn and a quarter of the pinion, a finger of ratio 0.3 is at 0.75 pi, and not at 0.15 pi."""
    fingers = ARM.replace('type="revolute"', 'type="continuous"').replace("</robot>", "") + (
        f'<link name="finger"/><joint name="finger_joint" type="{kind}"><parent link="base"/><child link="finger"/>'
        '<mimic joint="elbow" multiplier="0.3"/></joint></robot>'
    )
    robot = Robot.load(write_robot(fingers, NO_CLOSURES))
    poses = robot.forward([2.5 * np.pi])
    assert poses.configuration().joint_position("finger_joint") == pytest.approx(0.75 * np.pi, abs=1e-12)
    whole = Robot.load(write_robot(fingers.replace('multiplier="0.3"', 'multiplier="2"'), NO_CLOSURES))
    assert whole.model.nq == (2 if kind == "revolute" else 1) + nq


@pytest.mark.parametrize(
    ("entry", "line", "place"),
    [
        (
            "coordinates:\n  - name: z\n    joint: elbow\n    unit: rad\n    scal: 2\n",
            5,
            r"coordinates\[0\].scal: unknown",
        ),
        (
            "commands:\n  - {name: u, joint: elbow, unit: rad}\n  - {name: v, joint: elbow, scale: x}\n",
            3,
            r"commands\[1\]",
        ),
        ("tool_motions: [x,\n  up]\n", 2, r"tool_motions\[1\]"),
        ("no_such: 1\n", 1, "no_such: unknown key"),
    ],
)
def test_a_wrong_entry_of_the_closures_file_is_named_with_its_line(
    write_robot: Writer, entry: str, line: int, place: str
) -> None:
    path = write_robot(ARM, entry + NO_CLOSURES)
    with pytest.raises(DescriptionError, match=rf"closures.yaml, line {line}: {place}") as caught:
        Robot.load(path)
    assert caught.value.line == line


@pytest.mark.parametrize("limit", ["", '<limit effort="1" velocity="1"/>'])
def test_a_joint_without_limits_is_unlimited(write_robot: Writer, limit: str) -> None:
    described = '<limit lower="-1" upper="2" effort="1" velocity="1"/>'
    assert described in ARM
    robot = Robot.load(write_robot(ARM.replace(described, limit), NO_CLOSURES))
    assert (robot.lower_limits.tolist(), robot.upper_limits.tolist()) == ([-np.inf], [np.inf])
    assert robot.model.effortLimit[0] == (1.0 if limit else np.inf)


def test_limits_of_zero_everywhere_are_none(write_robot: Writer, caplog: pytest.LogCaptureFixture) -> None:
    fixed = ARM.replace('lower="-1" upper="2"', 'lower="0" upper="0"')
    with caplog.at_level(logging.WARNING):
        robot = Robot.load(write_robot(fixed, NO_CLOSURES))
    assert "limits 0 .. 0 of 1 joints" in caplog.text
    assert (robot.lower_limits.tolist(), robot.upper_limits.tolist()) == ([-np.inf], [np.inf])
    caplog.clear()
    hand = (
        '<link name="hand"/><joint name="wrist" type="revolute"><parent link="forearm"/><child link="hand"/>'
        '<limit lower="0" upper="0" effort="1" velocity="1"/></joint></robot>'
    )
    with caplog.at_level(logging.WARNING):
        robot = Robot.load(write_robot(ARM.replace("</robot>", hand), NO_CLOSURES))
    assert not caplog.text, "the elbow has limits: the wrist is locked on purpose"
    assert (robot.lower_limits.tolist(), robot.upper_limits.tolist()) == ([-1.0, 0.0], [2.0, 0.0])


def test_a_urdf_alone_is_a_serial_robot(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM, encoding="utf-8")
    robot = Robot.load(path)
    assert (robot.closures, robot.actuated_joints, robot.tool_frame) == ((), ("elbow",), None)
    with_tool = Robot.load(path, tool_frame="forearm")
    assert with_tool.model.frames[with_tool.tool_frame_id].name == "forearm"
    with pytest.raises(FrameNotFoundError, match=rf"{path}: tool_frame.*'hand'.*forearm"):
        Robot.load(path, tool_frame="hand")


def test_a_joint_that_only_the_srdf_has_is_passed_over(write_robot: Writer, caplog: pytest.LogCaptureFixture) -> None:
    """SRDF files are written for several URDFs, and for a floating base: `root_joint`."""
    joint = '<joint name="root_joint" value="0 0 0.4 0 0 0 1"/><joint name="elbow"'
    with caplog.at_level(logging.WARNING):
        robot = Robot.load(
            write_robot(ARM, NO_CLOSURES, SRDF.format(joint="elbow", value="1").replace('<joint name="elbow"', joint))
        )
    assert "group_state 'home': no joint 'root_joint' in the model" in caplog.text
    assert {name: q.tolist() for name, q in robot.named_configurations.items()} == {"home": [0.5], "bent": [1.0]}


def test_a_link_goes_before_a_joint_of_the_same_name(write_robot: Writer) -> None:
    urdf = ARM.replace('joint name="elbow"', 'joint name="forearm"')
    mechanism = Robot.load(write_robot(urdf, NO_CLOSURES.replace("[elbow]", "[forearm]")))
    assert mechanism.model.frames[mechanism.frame_id("forearm")].type == pin.FrameType.BODY


def test_loop_closures_may_hang_on_the_world(five_bar: Robot) -> None:
    mechanism = Robot(five_bar.model, [LoopClosure("base", "left_tip", "3d")])
    position = mechanism.home.frame_placement("left_tip").translation
    np.testing.assert_allclose(mechanism.home.closure_error, position, atol=1e-15)
