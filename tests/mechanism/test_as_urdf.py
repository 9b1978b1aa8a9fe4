"""Robots from other formats, written as a URDF: the same frames, closures, drives and configurations."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.description.simple_joints import NEGLIGIBLE_MASS, Floating
from pm3dof_pin.description.urdf_files import _is_plain_urdf, urdf_files
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.robot import Robot

MJCF = """<mujoco model="leg"><compiler angle="radian"/><worldbody>
<site name="wall" pos="1.2 0.3 1.15" euler="0.1 0.2 0.3"/>
<body name="hip" pos="0 0 1" euler="0.3 1.5707963 0.2">
 <joint name="turn" axis="1 1 0" pos="0 0.1 0" range="-1 1" stiffness="7"/>
 <geom type="capsule" size="0.1" fromto="0 0 0 0 0 1"/>
 <body name="rod" pos="0 0 1"><joint name="ball" type="ball"/>
  <geom size="0.1" pos="0.3 0.2 0"/><site name="tip" pos="0.4 0 0"/>
  <body name="slider"><joint name="slide" type="slide" axis="0 0 1"/>
   <geom type="box" size="0.1 0.2 0.3"/></body></body></body>
</worldbody>
<equality><connect site1="tip" site2="wall"/></equality>
<actuator><motor name="drive" joint="turn"/><motor joint="slide"/></actuator>
<keyframe><key name="bent" qpos="0.3 0.5 0.5 -0.5 0.5 0.1"/></keyframe></mujoco>"""


@pytest.fixture
def leg(tmp_path: Path) -> Robot:
    (tmp_path / "leg.xml").write_text(MJCF)
    return Robot.load(tmp_path / "leg.xml", tool_frame="tip")


def written(robot: Robot, folder: Path, *, floating: Floating = "any") -> Path:
    """Write a robot's files into a folder of their own, and return the URDF."""
    folder = folder / "written"
    folder.mkdir()
    for suffix, text in urdf_files(robot.description, floating=floating).items():
        (folder / f"{robot.name}{suffix}").write_text(text, encoding="utf-8")
    return folder / f"{robot.name}.urdf"


def _in_hinges(robot: Robot, q: np.ndarray, plain: Robot) -> np.ndarray:
    """The same configuration with revolute joints instead of the ball joint."""
    x, y, z = Rotation.from_quat(q[1:5]).as_euler("XYZ")
    values = {"turn": q[0], "ball": x, "ball_y": y, "ball_z": z, "slide": q[5]}
    return np.array([values[name] for name in plain.q_names])


@pytest.mark.parametrize("seed", range(5))
def test_frames_and_inertias_are_the_same(leg: Robot, tmp_path: Path, seed: int) -> None:
    plain = Robot.load(written(leg, tmp_path))
    generator = np.random.default_rng(seed)
    q = pin.integrate(leg.model, pin.neutral(leg.model), generator.uniform(-1.0, 1.0, leg.model.nv))
    in_hinges = _in_hinges(leg, q, plain)
    for frame in ("hip", "rod", "slider", "tip", "wall", "world"):
        expected = leg.configuration(q).frame_placement(frame).homogeneous
        found = plain.configuration(in_hinges).frame_placement(frame).homogeneous
        np.testing.assert_allclose(found, expected, atol=2e-15)
    masses = [pin.computeTotalMass(robot.model) for robot in (leg, plain)]
    assert masses[1] - masses[0] == pytest.approx(2 * NEGLIGIBLE_MASS), "the two links between the hinges of the ball"
    energies = [
        pin.computePotentialEnergy(robot.model, robot.model.createData(), at)
        for robot, at in ((leg, q), (plain, in_hinges))
    ]
    assert energies[1] == pytest.approx(energies[0], abs=9.81 * 4.0 * NEGLIGIBLE_MASS)


def test_what_is_beside_the_tree_is_the_same(leg: Robot, tmp_path: Path) -> None:
    plain = Robot.load(written(leg, tmp_path))
    assert plain.name == "leg"
    assert (plain.closures, plain.commands, plain.tool_frame) == (leg.closures, leg.commands, "tip")
    assert [dict(spring) for spring in plain.springs] == [dict(spring) for spring in leg.springs]
    assert set(plain.named_configurations) == {"home", "bent", "qpos0"}
    bent = _in_hinges(leg, leg.named_configurations["bent"], plain)
    np.testing.assert_allclose(plain.named_configurations["bent"], bent, atol=1e-15)
    index = plain.q_names.index("turn")
    assert (plain.lower_limits[index], plain.upper_limits[index]) == (-1.0, 1.0)
    assert plain.upper_limits[plain.q_names.index("slide")] == np.inf
    closed = [DegreesOfFreedom(robot.assemble(robot.home)).count for robot in (leg, plain)]
    assert closed == [2, 2]


def test_a_plain_urdf_stays_as_it_is(mechanism: Robot) -> None:
    assert _is_plain_urdf(mechanism.description)
    assert mechanism.files is not None
    assert urdf_files(mechanism.description)[".urdf"] == mechanism.files.urdf.read_text(encoding="utf-8")


def test_universal_joints_become_two_hinges(tmp_path: Path) -> None:
    hinge = (
        '<joint name="knee" type="revolute"><parent link="a"/><child link="b"/><limit effort="1" velocity="1"/></joint>'
    )
    sphere = '<visual><origin xyz="0 0 1"/><geometry><sphere radius="0.1"/></geometry></visual>'
    (tmp_path / "robot.urdf").write_text(
        f'<robot name="r"><link name="a"/><link name="b">{sphere}</link>{hinge}</robot>'
    )
    (tmp_path / "robot.yaml").write_text("joint_name: [knee]\njoint_type: [UJOINT_ZX]\nname_mot: [knee_Z]\n")
    robot = Robot.load(tmp_path)
    assert not _is_plain_urdf(robot.description)
    urdf = written(robot, tmp_path)
    plain = Robot.load(urdf)
    assert plain.q_names == ("knee_Z", "knee_X")
    assert plain.actuated_joints == ("knee_Z",)
    q = [0.3, -0.7]
    expected = robot.configuration(q).frame_placement("b").homogeneous
    np.testing.assert_allclose(plain.configuration(q).frame_placement("b").homogeneous, expected, atol=1e-15)
    assert "<sphere" in urdf.read_text()


def test_a_mechanism_made_by_hand_is_written(tmp_path: Path) -> None:
    robot = Robot(pin.buildSampleModelManipulator(), tool_frame="effector_body")
    plain = Robot.load(written(robot, tmp_path), tool_frame="effector_body")
    q = pin.integrate(robot.model, pin.neutral(robot.model), np.full(robot.model.nv, 0.3))
    values = {name: robot.single_joint(name).coordinate(q) for name in plain.q_names if name in robot.q_names}
    assert values, "the elbow and wrists are hinges there too"
    assert plain.home.tool_placement.translation == pytest.approx(robot.home.tool_placement.translation, abs=1e-12)


def test_a_planar_joint_as_slides_and_a_hinge(tmp_path: Path) -> None:
    (tmp_path / "cart.urdf").write_text(
        """<robot name="cart"><link name="floor"/><link name="cart"/><link name="arm"/><link name="tip"/>
        <joint name="drive" type="planar"><parent link="floor"/><child link="cart"/><axis xyz="0 0 1"/></joint>
        <joint name="arm" type="continuous"><parent link="cart"/><child link="arm"/><origin xyz="0.1 0 0.2"/></joint>
        <joint name="end" type="fixed"><parent link="arm"/><child link="tip"/><origin xyz="0 0.3 0.4"/></joint>
        </robot>"""
    )
    x, y, heading, turn = 0.3, -0.4, 2.0, 0.7
    states = {"drive": f"{x} {y} {np.cos(heading)} {np.sin(heading)}", "arm": f"{np.cos(turn)} {np.sin(turn)}"}
    joints = "".join(f'<joint name="{name}" value="{value}"/>' for name, value in states.items())
    (tmp_path / "cart.srdf").write_text(
        f'<robot name="cart"><group_state name="parked" group="all">{joints}</group_state></robot>'
    )
    robot = Robot.load(tmp_path / "cart.urdf", tool_frame="tip")
    plain = Robot.load(written(robot, tmp_path, floating="none"))
    assert list(plain.model.names)[1:] == ["drive", "drive_along_y", "drive_about_z", "arm"]
    found = plain.configuration(plain.named_configurations["parked"]).tool_placement.translation
    side, up = 0.3 * np.cos(turn), 0.2 + 0.3 * np.sin(turn) + 0.4 * np.cos(turn)  # the arm turns about the x axis
    side -= 0.4 * np.sin(turn)
    expected = [x + 0.1 * np.cos(heading) - side * np.sin(heading), y + 0.1 * np.sin(heading) + side * np.cos(heading)]
    np.testing.assert_allclose(found, [*expected, up], atol=1e-12)


def test_a_free_joint_as_slides_and_hinges(tmp_path: Path) -> None:
    (tmp_path / "box.xml").write_text(
        """<mujoco model="box"><worldbody><body name="box" pos="0.1 0.2 0.3" euler="20 30 40"><freejoint name="free"/>
        <geom size="0.1" mass="1"/><body name="arm"><joint name="arm"/><geom size="0.1" mass="1"/>
        <site name="tool" pos="0.4 0.1 0"/></body></body></worldbody>
        <keyframe><key name="thrown" qpos="1 2 3 0.5 0.5 -0.1 0.7 0.2"/></keyframe></mujoco>"""
    )
    robot = Robot.load(tmp_path / "box.xml")
    plain = Robot.load(written(robot, tmp_path, floating="none"))
    assert all(joint.nv == 1 for joint in list(plain.model.joints)[1:])
    for name in ("home", "thrown"):
        expected, found = (r.configuration(r.named_configurations[name]) for r in (robot, plain))
        np.testing.assert_allclose(found.tool_placement.homogeneous, expected.tool_placement.homogeneous, atol=1e-12)
