"""Robots from one dialect to another and back: the same mechanism, and every loss listed."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import yaml

import pm3dof_pin as pm
from pm3dof_pin.description.description import Drive
from pm3dof_pin.description.robots import robot_names, robots_directory
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, PM3DofError
from pm3dof_pin.export.convert import convert_robot
from pm3dof_pin.kinematics.robot import Robot

MACHINES = Path(__file__).parents[1] / "machines"
_SUFFIX = {"urdf": ".urdf", "mjcf": ".xml", "sdf": ".sdf", "drake": ".urdf"}
_ROBOTS = [*robot_names(), *(str(MACHINES / name) for name in ("agile_eye", "delta", "five_bar", "four_rrr"))]


@pytest.mark.parametrize("dialect", _SUFFIX)
@pytest.mark.parametrize("name", _ROBOTS, ids=lambda name: Path(name).name)
def test_another_dialect_describes_the_same_mechanism(tmp_path: Path, name: str, dialect: str) -> None:
    robot = Robot.load(name)
    done = convert_robot(name, tmp_path / f"robot{_SUFFIX[dialect]}", dialect=dialect, meshes=False)
    again = Robot.load(tmp_path / f"robot{_SUFFIX[dialect]}")
    assert again.home.closure_residual < 1e-12
    assert pm.instantaneous_mobility(again.home).count == pm.instantaneous_mobility(robot.home).count
    assert again.actuated_joints == robot.actuated_joints
    assert [c.name for c in again.coordinates] == [c.name for c in robot.coordinates]
    assert again.tool_frame == robot.tool_frame
    assert done.losses == ()
    assert len(again.springs) == len(robot.springs)
    assert [(loop.type, loop.swing_limit) for loop in again.closures] == [
        (loop.type, loop.swing_limit) for loop in robot.closures
    ]
    groups = [{group.name: group.closures for group in which.limit_groups} for which in (robot, again)]
    assert groups[0] == groups[1]
    drives = {drive.joint: drive for drive in again.description.drives}
    for joint in robot.description.joints:
        other = again.description.joint_by_name.get(joint.name, joint)
        assert (other.effort or None, other.velocity or None) == (joint.effort or None, joint.velocity or None)
        assert other.armature == joint.armature
    for drive in robot.description.drives:
        other_drive = drives.get(drive.joint, Drive("", drive.joint))
        assert (other_drive.gear, other_drive.rotor_inertia) == (drive.gear, drive.rotor_inertia)
    home = again.home.tool_placement.homogeneous
    np.testing.assert_allclose(home, robot.home.tool_placement.homogeneous, atol=1e-12)
    np.testing.assert_allclose(again.home.commands, robot.home.commands, atol=1e-12)
    if robot.springs:
        both = [pm.compliance(which, which.at([which.home.q])) for which in (robot, again)]
        np.testing.assert_allclose(both[0], both[1], atol=1e-9 * np.abs(both[0]).max())


@pytest.mark.parametrize("dialect", ["mjcf", "sdf", "drake"])
def test_there_and_back_again(tmp_path: Path, dialect: str) -> None:
    robot, middle = Robot.load("hexapod"), tmp_path / f"middle{_SUFFIX[dialect]}"
    convert_robot("hexapod", middle, dialect=dialect, meshes=False)
    convert_robot(middle, tmp_path / "back.urdf", dialect="urdf", meshes=False)
    again = Robot.load(tmp_path / "back.urdf")
    assert len(again.closures) == len(robot.closures)
    assert {loop.type for loop in again.closures} == {"3d"}
    np.testing.assert_allclose(again.home.tool_placement.homogeneous, robot.home.tool_placement.homogeneous, atol=1e-12)
    both = [pm.compliance(which, which.at([which.home.q])) for which in (robot, again)]
    np.testing.assert_allclose(both[0], both[1], atol=1e-8 * np.abs(both[0]).max())


def test_losses_are_listed_and_may_be_errors(tmp_path: Path) -> None:
    source = tmp_path / "leg.xml"
    source.write_text(NAMESAKES, encoding="utf-8")
    losses = convert_robot(source, tmp_path / "leg.sdf").losses
    assert any(loss.startswith("joint hip is called hip_joint") for loss in losses), losses
    with pytest.raises(DescriptionError, match="joint hip is called"):
        convert_robot(source, tmp_path / "strict" / "leg.sdf", strict=True)
    assert not (tmp_path / "strict").exists()
    assert convert_robot("hexapod", tmp_path / "hexapod.urdf", strict=True).losses == ()


def test_what_a_dialect_has_no_words_for_is_beside_it(tmp_path: Path) -> None:
    """MJCF has no greatest speeds, and SDFormat no swing limits: without the closures file they are lost."""
    for suffix in (".xml", ".sdf"):
        convert_robot("three_rps", tmp_path / f"robot{suffix}", strict=True, meshes=False)
        (tmp_path / f"robot{suffix}.closures.yaml").unlink()
    assert pm.load(tmp_path / "robot.xml").description.joint("strut1_joint").velocity is None
    assert not any(loop.swing_limit for loop in pm.load(tmp_path / "robot.sdf").closures)


def test_closures_beside_a_file_add_to_its_own_or_replace_them(tmp_path: Path) -> None:
    convert_robot("pm3dof", tmp_path / "robot.xml", meshes=False)
    beside = tmp_path / "robot.xml.closures.yaml"
    entries = yaml.safe_load(beside.read_text())
    assert entries["replaces_loops"]
    assert len(pm.load(tmp_path / "robot.xml").closures) == 3
    del entries["replaces_loops"]
    beside.write_text(yaml.safe_dump(entries))
    assert len(pm.load(tmp_path / "robot.xml").closures) == 6


def test_a_closures_file_belongs_to_the_urdf_of_its_name(tmp_path: Path) -> None:
    """The files that a URDF has beside it say its loops, which the MJCF of the same name already has."""
    for dialect, suffix in _SUFFIX.items():
        stem = "robot" if dialect != "drake" else "other"
        convert_robot("pm3dof", tmp_path / f"{stem}{suffix}", dialect=dialect, meshes=False)
    for file in ("robot.xml", "robot.sdf", "robot.urdf", "other.urdf"):
        assert len(pm.load(tmp_path / file).closures) == 3
    (tmp_path / "robot.xml.closures.yaml").unlink()
    assert len(pm.load(tmp_path / "robot.xml").closures) == 3
    for exported in ("mjcf/pm3dof.xml", "sdf/pm3dof.sdf", "drake/pm3dof.urdf"):
        assert len(pm.load(robots_directory() / "pm3dof_description" / exported).closures) == 3


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"joints": {"nowhere": {"velocity": 1.0}}}, "nowhere"),
        ({"joints": {"slider1_joint": {"velocity": -1.0}}}, "joints.slider1_joint.velocity"),
        ({"joints": {"slider1_joint": {"speed": 1.0}}}, "unknown key"),
        ({"drives": {"slider1_joint": {"gear": 0.0}}}, "drives.slider1_joint.gear"),
        ({"drives": {"nowhere": {"gear": 2.0}}}, "nowhere"),
    ],
)
def test_numbers_of_joints_and_drives_are_checked(tmp_path: Path, entries: dict[str, Any], message: str) -> None:
    convert_robot("pm3dof", tmp_path / "robot.xml", meshes=False)
    beside = tmp_path / "robot.xml.closures.yaml"
    beside.write_text(yaml.safe_dump(yaml.safe_load(beside.read_text()) | entries))
    with pytest.raises(PM3DofError, match=message):
        pm.load(tmp_path / "robot.xml")


def test_springs_at_massless_frames_keep_their_places_in_mjcf(tmp_path: Path) -> None:
    """The tubes of a leg of three_rps are springs at its tip frames, which carry the ends of the closures."""
    done = convert_robot("three_rps", tmp_path / "robot.xml")
    robot, again = pm.load("three_rps"), pm.load(tmp_path / "robot.xml")
    expected = pm.compliance(robot, robot.home)
    np.testing.assert_allclose(pm.compliance(again, again.home), expected, atol=1e-9 * np.abs(expected).max())
    assert not [loss for loss in done.losses if "stiffness" in loss or "spring" in loss]


def test_a_suffix_says_the_dialect(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match="urdf, mjcf, sdf or drake"):
        convert_robot("pm3dof", tmp_path / "pm3dof.step")
    drake = convert_robot("pm3dof", tmp_path / "pm3dof.urdf", dialect="drake").files[0]
    assert "ball_constraint" in drake.read_text()


def test_armature_and_gains_pass_from_mjcf_to_mjcf(tmp_path: Path) -> None:
    (tmp_path / "arm.xml").write_text(
        """<mujoco model="arm"><compiler angle="radian" autolimits="true"/><worldbody><body name="a">
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <joint name="j" type="hinge" axis="0 0 1" armature="0.02" damping="0.3" frictionloss="0.1" range="-1 2"/>
        <body name="b" pos="0.2 0 0"><inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>
        <joint name="k" type="hinge" axis="0 1 0"/></body></body></worldbody>
        <equality><joint joint1="k" joint2="j" polycoef="0.1 2 0.3 0 0"/></equality>
        <actuator><position name="servo" joint="j" gear="30" kp="200" kv="4" ctrlrange="-1 1" forcerange="-5 5"/>
        </actuator></mujoco>"""
    )
    done = convert_robot(tmp_path / "arm.xml", tmp_path / "out.xml")
    first, second = Robot.load(tmp_path / "arm.xml"), Robot.load(tmp_path / "out.xml")
    assert first.couplings == second.couplings
    assert pm.instantaneous_mobility(second.replace(tool_frame="b").home).count == 1
    assert [loss for loss in done.losses if "drive" in loss or "armature" in loss] == []
    assert second.description.drives[0].gear == 30.0
    assert second.description.drives[0].proportional_gain == 200.0


def test_actuators_of_any_gain_give_the_same_force_in_mujoco(tmp_path: Path) -> None:
    """Of a control, a position and a velocity: gain u - kp q - kd v, and a gear."""
    (tmp_path / "arm.xml").write_text(
        """<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="a">
        <inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/><joint name="j" axis="0 0 1"/>
        </body></worldbody><actuator><general name="g" joint="j" gear="3" gainprm="7" biastype="affine"
        biasprm="0 -5 -2"/></actuator></mujoco>"""
    )
    convert_robot(tmp_path / "arm.xml", tmp_path / "out.xml")
    forces = []
    for name in ("arm.xml", "out.xml"):
        model = mujoco.MjModel.from_xml_path(str(tmp_path / name))
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = 0.3, -0.7, 1.1
        mujoco.mj_forward(model, data)
        forces.append(float(data.qfrc_actuator[0]))
    assert forces[0] == pytest.approx(3.0 * (7.0 * 1.1 - 5.0 * 3.0 * 0.3 + 2.0 * 3.0 * 0.7))
    assert forces[1] == pytest.approx(forces[0], rel=1e-12)


def test_the_command_lists_what_is_lost(answer: Callable[..., Any], tmp_path: Path) -> None:
    assert answer("convert", "three_rps", str(tmp_path / "out.sdf"))["losses"] == []
    assert answer("convert", "three_rps", str(tmp_path / "out.urdf"))["losses"] == []


NAMESAKES = """<mujoco model="leg"><compiler angle="radian"/><worldbody><body name="hip"><joint name="hip" axis="0 1 0"
stiffness="7"/><geom size="0.1"/><body name="shin" pos="0.3 0 0"><joint name="shin" axis="0 1 0" stiffness="50"
springref="0.1"/><geom size="0.1"/><site name="toe" pos="0.4 0 0"/><body name="foot" pos="0.4 0 0"><joint name="toe"
axis="0 1 0"/><geom size="0.05"/></body></body></body></worldbody><equality><joint joint1="toe" joint2="shin"
polycoef="0 0.5 0 0 0"/></equality><actuator><motor name="m" joint="hip"/></actuator></mujoco>"""
"""Joints with the names of bodies and of a site, as is usual in MJCF, two of them with springs."""


@pytest.mark.parametrize("dialect", ["mjcf", "sdf", "urdf", "drake"])
def test_joints_may_have_the_names_of_links_and_springs(tmp_path: Path, dialect: str) -> None:
    source = tmp_path / "leg.xml"
    source.write_text(NAMESAKES, encoding="utf-8")
    target = tmp_path / "out" / {"mjcf": "leg.xml", "sdf": "leg.sdf"}.get(dialect, "leg.urdf")
    target.parent.mkdir()
    losses = convert_robot(source, target, dialect=dialect, tool_frame="foot").losses
    assert sum("is called" in loss for loss in losses) == (3 if dialect == "sdf" else 0)
    before, after = pm.load(source, tool_frame="foot"), pm.load(target, tool_frame="foot")
    assert [spring["name"] for spring in after.springs] == [spring["name"] for spring in before.springs]
    assert len(after.couplings) == len(before.couplings) == 1
    found, expected = (np.asarray(pm.compliance(robot, robot.home)) for robot in (after, before))
    np.testing.assert_allclose(found, expected, atol=1e-9 * np.abs(expected).max())
    if dialect == "sdf":
        assert after.actuated_joints == ("hip_joint",)
        assert after.description.joint("shin_joint").stiffness == 50.0
        if shutil.which("ign"):
            done = subprocess.run(["ign", "sdf", "--check", target], capture_output=True, text=True, check=False)
            assert "Valid" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize("dialect", _SUFFIX)
def test_a_ball_in_the_tree_is_listed_as_three_turns(tmp_path: Path, dialect: str) -> None:
    """The turns are singular with the middle one at 90 degrees, and the bodies between them have masses."""
    (tmp_path / "arm.xml").write_text(
        '<mujoco model="arm"><worldbody><body name="arm"><joint name="shoulder" type="ball"/>'
        '<geom size="0.1" mass="1"/></body></worldbody></mujoco>'
    )
    target = tmp_path / "out" / f"robot{_SUFFIX[dialect]}"
    target.parent.mkdir()
    losses = convert_robot(tmp_path / "arm.xml", target, dialect=dialect).losses
    assert [loss for loss in losses if "shoulder, spherical" in loss and "turn about y is 90 deg" in loss], losses


def test_a_hinge_on_the_base_stays_one_in_sdf(tmp_path: Path) -> None:
    """SDF says it as a joint between the links, on which the chain then ends: the loop is cut elsewhere."""
    links = "".join(
        f'<link name="{name}"><inertial><mass value="1"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" '
        'iyz="0"/></inertial></link>'
        for name in ("base", "crank", "coupler", "rocker", "pin", "bearing")
    )
    places = [("base", "crank", 0.0), ("crank", "coupler", 0.1), ("coupler", "rocker", 0.4)]
    joints = "".join(
        f'<joint name="to_{child}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{x} 0 0"/><axis xyz="0 0 1"/><limit lower="-6" upper="6" effort="1" velocity="1"/></joint>'
        for parent, child, x in places
    )
    ends = "".join(
        f'<joint name="at_{name}" type="fixed"><parent link="{parent}"/><child link="{name}"/>'
        f'<origin xyz="{x} 0 0"/></joint>'
        for name, parent, x in (("pin", "rocker", 0.3), ("bearing", "base", 0.35))
    )
    (tmp_path / "fourbar.urdf").write_text(f'<robot name="fourbar">{links}{joints}{ends}</robot>')
    (tmp_path / "fourbar.closures.yaml").write_text(
        "closed_loop: [[pin, bearing]]\ntype: [hinge]\nname_mot: [to_crank]\ntool_frame: coupler\n"
    )
    angles = Robot.load(tmp_path / "fourbar.urdf").assemble([0.9, -0.9, -1.7], joints={"to_crank": 0.9}).q
    (tmp_path / "fourbar.srdf").write_text(
        '<robot name="fourbar"><group_state name="home" group="all">'
        + "".join(f'<joint name="to_{places[k][1]}" value="{angles[k]:.17g}"/>' for k in range(3))
        + "</group_state></robot>"
    )
    (tmp_path / "there").mkdir()
    convert_robot(tmp_path / "fourbar.urdf", tmp_path / "there" / "fourbar.sdf")
    robot, again = (Robot.load(path) for path in (tmp_path / "fourbar.urdf", tmp_path / "there" / "fourbar.sdf"))
    commands = np.linspace(0.6, 1.3, 5)[:, None]
    np.testing.assert_allclose(again.forward(commands).transforms, robot.forward(commands).transforms, atol=1e-9)


@pytest.mark.parametrize("dialect", _SUFFIX)
def test_configurations_that_are_not_home_keep_their_joint_values(tmp_path: Path, dialect: str) -> None:
    """Of a planar arm 0.4 and 0.3 m long, with angles by hand: MuJoCo's qpos counts from ref, where the body stands."""
    inertia = '<inertial pos="0.1 0 0" mass="1" diaginertia="0.01 0.01 0.01"/>'
    (tmp_path / "arm.xml").write_text(
        f"""<mujoco model="arm"><compiler angle="radian"/><worldbody><body name="upper">{inertia}
        <joint name="a" axis="0 0 1" ref="0.2" range="-2 2"/><body name="lower" pos="0.4 0 0">{inertia}
        <joint name="b" axis="0 0 1" ref="-0.7" range="-2 2"/><body name="rod" pos="0.3 0 0">{inertia}
        <joint name="c" type="slide" axis="0 0 1" ref="0.05" range="-1 1"/><site name="tip"/></body></body></body>
        </worldbody><actuator><motor joint="a"/><motor joint="b"/><motor joint="c"/></actuator><keyframe>
        <key name="home" qpos="0.2 -0.7 0.05"/><key name="bent" qpos="0.5 0.4 0.11"/></keyframe></mujoco>"""
    )
    target = tmp_path / f"converted{_SUFFIX[dialect]}"
    convert_robot(tmp_path / "arm.xml", target, dialect=dialect)
    again = pm.load(target)
    placed = again.configuration(again.named_configurations["bent"]).frame_placement("tip")
    first, both = 0.3, 0.3 + 1.1
    wanted = [0.4 * np.cos(first) + 0.3 * np.cos(both), 0.4 * np.sin(first) + 0.3 * np.sin(both), 0.06]
    np.testing.assert_allclose(placed.translation, wanted, atol=1e-9)
    np.testing.assert_allclose(placed.rotation[:2, 0], [np.cos(both), np.sin(both)], atol=1e-9)
