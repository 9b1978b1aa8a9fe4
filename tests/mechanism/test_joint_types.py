"""Joints replaced by the types they stand for, as in the `robot.yaml` files of example-parallel-robots."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.exceptions import DescriptionError, JointNotFoundError
from pm3dof_pin.kinematics.robot import Robot

Writer = Callable[..., Path]

_JOINT = """<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>
<origin xyz="{xyz}" rpy="{rpy}"/><axis xyz="0 0 1"/><limit lower="-1" upper="2" effort="3" velocity="4"/></joint>"""
_LINK = """<link name="{}"><inertial><origin xyz="0 0 0.1"/><mass value="{}"/>
<inertia ixx="0.1" iyy="0.1" izz="0.1" ixy="0" iyz="0" ixz="0"/></inertial></link>"""
CHAIN = (
    '<robot name="chain"><link name="base"/>'
    + "".join(_LINK.format(name, mass) for name, mass in (("upper", 1.0), ("lower", 2.0), ("foot", 0.5)))
    + _JOINT.format(name="hip", parent="base", child="upper", xyz="0 0 1", rpy="0.1 0.2 0.3")
    + _JOINT.format(name="knee", parent="upper", child="lower", xyz="0.4 0 0", rpy="-0.3 0.2 0.5")
    + _JOINT.format(name="ankle", parent="lower", child="foot", xyz="0 0.3 0", rpy="0.7 0 0")
    + "</robot>"
)
ORIGINS = {
    "hip": ([0, 0, 1], [0.1, 0.2, 0.3]),
    "knee": ([0.4, 0, 0], [-0.3, 0.2, 0.5]),
    "ankle": ([0, 0.3, 0], [0.7, 0, 0]),
}


def _origin(joint: str) -> pin.SE3:
    xyz, rpy = ORIGINS[joint]
    return pin.SE3(Rotation.from_euler("xyz", rpy).as_matrix(), np.array(xyz, dtype=float))


def _turn(sequence: str, *angles: float) -> pin.SE3:
    return pin.SE3(Rotation.from_euler(sequence, angles).as_matrix(), np.zeros(3))


def _load(write_robot: Writer, types: str) -> Robot:
    names, kinds = zip(*(pair.split(": ") for pair in types.split(", ")), strict=True)
    return Robot.load(write_robot(CHAIN, f"joint_name: [{', '.join(names)}]\njoint_type: [{', '.join(kinds)}]\n"))


def test_a_universal_joint_turns_about_its_two_axes_in_their_order(write_robot: Writer) -> None:
    robot = _load(write_robot, "knee: UJOINT_YX")
    assert robot.q_names == ("hip", "knee_Y", "knee_X", "ankle")
    hip, y, x, ankle = q = np.array([0.3, 0.4, -0.5, 0.6])
    expected = (
        _origin("hip") * _turn("Z", hip) * _origin("knee") * _turn("YX", y, x) * _origin("ankle") * _turn("Z", ankle)
    )
    found = robot.configuration(q).frame_placement("foot")
    np.testing.assert_allclose(found.homogeneous, expected.homogeneous, atol=1e-15)
    moving = robot.configuration(q).frame_placement("lower").rotation
    np.testing.assert_array_equal(robot.configuration(q).frame_placement("knee").rotation, moving)
    np.testing.assert_array_equal(robot.lower_limits, [-1.0, -np.inf, -np.inf, -1.0])
    np.testing.assert_array_equal(robot.model.effortLimit[[0, 3]], [3.0, 3.0])


def test_a_spherical_joint_turns_about_every_axis(write_robot: Writer) -> None:
    robot = _load(write_robot, "hip: SPHERICAL")
    assert (robot.model.nq, robot.model.nv) == (6, 5)
    turn = Rotation.from_rotvec([0.5, -0.7, 0.2])
    q = np.concatenate([turn.as_quat(), [0.4, -0.2]])
    expected = _origin("hip") * pin.SE3(turn.as_matrix(), np.zeros(3)) * _origin("knee") * _turn("Z", 0.4)
    found = robot.configuration(q).frame_placement("lower")
    np.testing.assert_allclose(found.homogeneous, expected.homogeneous, atol=1e-15)


def test_a_fixed_joint_stays_as_it_is_at_zero(write_robot: Writer) -> None:
    robot = _load(write_robot, "knee: FIXED, ankle: UJOINT_ZX")
    assert robot.q_names == ("hip", "ankle_Z", "ankle_X")
    expected = _origin("hip") * _turn("Z", 0.2) * _origin("knee") * _origin("ankle") * _turn("Z", 0.4)
    found = robot.configuration([0.2, 0.4, 0.0]).frame_placement("foot")
    np.testing.assert_allclose(found.homogeneous, expected.homogeneous, atol=1e-15)


@pytest.mark.parametrize(
    "types", ["knee: UJOINT_XZ", "hip: SPHERICAL", "knee: FIXED", "hip: SPHERICAL, ankle: UJOINT_YZ"]
)
def test_bodies_and_frames_are_the_old_ones(write_robot: Writer, types: str) -> None:
    robot = _load(write_robot, types)
    old = pin.buildModelFromXML(CHAIN)
    old_data, data = old.createData(), robot.model.createData()
    zero, neutral = np.zeros(old.nq), pin.neutral(robot.model)
    np.testing.assert_allclose(
        pin.centerOfMass(robot.model, data, neutral), pin.centerOfMass(old, old_data, zero), atol=1e-15
    )
    energies = [
        pin.computePotentialEnergy(*arguments) for arguments in ((robot.model, data, neutral), (old, old_data, zero))
    ]
    assert energies[0] == pytest.approx(energies[1], rel=1e-15)
    pin.framesForwardKinematics(old, old_data, zero)
    pin.framesForwardKinematics(robot.model, data, neutral)
    for index, frame in enumerate(old.frames):
        placement = (
            data.oMf[robot.model.getFrameId(frame.name, frame.type)] if frame.type == pin.FrameType.BODY else None
        )
        if placement is not None:
            np.testing.assert_allclose(placement.homogeneous, old_data.oMf[index].homogeneous, atol=1e-15)


@pytest.mark.parametrize("kind", ["UJOINT", "UJOINT_XX", "UJOINT_XYZ", "BALL", "PRISMATIC"])
def test_an_unknown_type_is_named(write_robot: Writer, kind: str) -> None:
    with pytest.raises(DescriptionError, match=rf"joint_type: '{kind}' of 'knee' is unknown, expected SPHERICAL"):
        _load(write_robot, f"knee: {kind}")


def test_an_unknown_joint_is_named(write_robot: Writer) -> None:
    with pytest.raises(JointNotFoundError, match=r"joint_name: no joint 'no_such_joint'.*hip, knee, ankle"):
        _load(write_robot, "no_such_joint: SPHERICAL")


def test_more_kinds_of_limits_than_bits_are_all_heeded(tmp_path: Path) -> None:
    """Forty joints whose names differ in letters: exceeding the limit of the last one breaks one limit group."""
    names = [first + second for first in "abcdefgh" for second in "vwxyz"]
    links = '<link name="base"/>' + "".join(_LINK.format(f"link_{name}", 1.0) for name in names)
    parents = ["base", *(f"link_{name}" for name in names)]
    joints = "".join(
        _JOINT.format(name=name, parent=parent, child=f"link_{name}", xyz="0 0 0.1", rpy="0 0 0")
        for name, parent in zip(names, parents, strict=False)
    )
    (tmp_path / "many.urdf").write_text(f'<robot name="many">{links}{joints}</robot>', encoding="utf-8")
    robot = Robot.load(tmp_path / "many.urdf")
    for number in (0, 29, 30, 31, 39):
        poses = robot.at(2.5 * np.eye(40)[number])
        assert not poses.within_limits
    assert robot.at(np.zeros(40)).within_limits
