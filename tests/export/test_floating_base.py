"""A robot that floats in the world does so in every dialect, with its own joint, masses and coordinates."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.exceptions import DescriptionError, FreeDirectionError
from pm3dof_pin.export.convert import convert_robot
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.kinematics.robot import Robot

FORMS = {"mjcf": "b.xml", "sdf": "b.sdf", "urdf": "b.urdf", "drake": "drake.urdf"}
INERTIA = '<inertial pos="0.01 0.02 0.1" mass="2" diaginertia="0.02 0.01 0.03"/>'
MJCF = f"""<mujoco model="floater"><compiler angle="radian"/><worldbody>
<body name="base" pos="0.1 0.2 1" quat="0.5 0.5 -0.5 0.5"><freejoint name="root"/>{INERTIA}
 <body name="limb" pos="0 0 0.3"><joint name="j" axis="0 1 0" range="-1 1"/>{INERTIA}
  <site name="tool" pos="0.4 0 0.2"/></body></body>
</worldbody><actuator><motor name="m" joint="j"/></actuator>
<keyframe><key name="turned" qpos="0.3 -0.2 0.9 0.8 0 0.6 0 0.4"/></keyframe></mujoco>"""
LINK = '<inertial><mass value="2"/><inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.02"/></inertial>'
URDF = f"""<robot name="floater"><link name="ground"/><link name="mount"/><link name="base">{LINK}</link>
<link name="limb">{LINK}</link><link name="other">{LINK}</link>
<joint name="stand" type="fixed"><parent link="ground"/><child link="mount"/>
 <origin xyz="0 0.5 0" rpy="0 0 1.5"/></joint>
<joint name="root" type="floating"><parent link="mount"/><child link="base"/><origin xyz="0 0 1" rpy="0.3 0 0"/></joint>
<joint name="j" type="revolute"><parent link="base"/><child link="limb"/><origin xyz="0 0 0.3"/><axis xyz="0 1 0"/>
 <limit lower="-1" upper="1" effort="9" velocity="9"/></joint>
<joint name="deep" type="JOINT"><parent link="limb"/><child link="other"/><origin xyz="0.1 0 0"/></joint></robot>"""


@pytest.fixture
def floater(tmp_path: Path) -> Path:
    (tmp_path / "floater.xml").write_text(MJCF)
    return tmp_path / "floater.xml"


def _assert_same(robot: Robot, again: Robot) -> None:
    moving = [{j.name: j.type for j in which.description.joints if not j.is_fixed} for which in (robot, again)]
    assert moving[0] == moving[1]
    assert sum(b.mass for b in again.description.bodies) == sum(b.mass for b in robot.description.bodies)
    assert pin.computeTotalMass(again.model) == pytest.approx(pin.computeTotalMass(robot.model), rel=1e-12)
    assert again.named_configurations.keys() == robot.named_configurations.keys()
    for name, q in robot.named_configurations.items():
        places = [
            which.configuration(at).frame_placement("limb").homogeneous
            for which, at in ((robot, q), (again, again.named_configurations[name]))
        ]
        np.testing.assert_allclose(places[1], places[0], atol=1e-12)


@pytest.mark.parametrize("back", FORMS)
@pytest.mark.parametrize("dialect", FORMS)
def test_a_free_body_stays_one_there_and_back(floater: Path, dialect: str, back: str) -> None:
    middle, end = floater.with_name(f"1{FORMS[dialect]}"), floater.with_name(f"2{FORMS[back]}")
    convert_robot(floater, middle, dialect=dialect, strict=True)
    convert_robot(middle, end, dialect=back, strict=True)
    robot, again = pm.load(floater), pm.load(end)
    _assert_same(robot, again)
    held = [pm.load(path, drive_stiffness=5000.0) for path in (floater, end)]
    compliances = [np.asarray(pm.compliance(which, which.home)) for which in held]
    np.testing.assert_allclose(compliances[1], compliances[0], atol=1e-12 * compliances[0].max())
    loose = pm.load(end, drive_stiffness=5000.0, hold_base=False)
    with pytest.raises(FreeDirectionError, match="--hold-base"):
        pm.compliance(loose, loose.home)


def test_simulators_have_it_free(floater: Path) -> None:
    import mujoco
    from pydrake.multibody.parsing import Parser
    from pydrake.multibody.plant import MultibodyPlant

    home = pm.load(floater).home.frame_placement("limb").homogeneous
    convert_robot(floater, floater.with_name("b.xml"))
    model = mujoco.MjModel.from_xml_path(str(floater.with_name("b.xml")))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    np.testing.assert_allclose(data.body("limb").xpos, home[:3, 3], atol=1e-12)
    for dialect in ("sdf", "drake"):
        target = floater.with_name(FORMS[dialect])
        convert_robot(floater, target, dialect=dialect)
        plant = MultibodyPlant(0.001)
        Parser(plant).AddModels(target)
        plant.Finalize()
        assert (plant.num_positions(), plant.num_velocities()) == (8, 7)
        if dialect == "sdf":  # whose pose is that of home
            place = plant.EvalBodyPoseInWorld(plant.CreateDefaultContext(), plant.GetBodyByName("limb"))
            np.testing.assert_allclose(place.GetAsMatrix4(), home, atol=1e-12)


@pytest.mark.parametrize("dialect", FORMS)
def test_one_that_stands_elsewhere_is_measured_from_the_world(tmp_path: Path, dialect: str) -> None:
    """The seat of a free joint is part of its coordinates, where a dialect places free bodies in the world."""
    source = tmp_path / "floater.urdf"
    source.write_text(URDF.replace("JOINT", "fixed"))
    convert_robot(source, tmp_path / FORMS[dialect], dialect=dialect, strict=True)
    robot, again = pm.load(source), pm.load(tmp_path / FORMS[dialect])
    place = robot.home.frame_placement("limb").homogeneous
    np.testing.assert_allclose(place[:3, 3], [np.sin(1.5) * np.sin(0.3) * 0.3, 0.5 - np.cos(1.5) * np.sin(0.3) * 0.3,
                                              1.0 + np.cos(0.3) * 0.3], atol=1e-12)  # fmt: skip
    np.testing.assert_allclose(again.home.frame_placement("limb").homogeneous, place, atol=1e-12)
    assert again.description.joint("root").type == "floating"


@pytest.mark.parametrize("dialect", ["mjcf", "sdf", "drake"])
def test_a_free_joint_within_the_tree_is_lost(tmp_path: Path, dialect: str) -> None:
    source = tmp_path / "floater.urdf"
    source.write_text(URDF.replace("JOINT", "floating"))
    losses = convert_robot(source, tmp_path / FORMS[dialect], dialect=dialect).losses
    assert [loss for loss in losses if "deep, floating, is read back as slides or turns" in loss], losses
    assert not [loss for loss in losses if "root" in loss]
    with pytest.raises(DescriptionError, match="deep, floating"):
        convert_robot(source, tmp_path / f"strict{FORMS[dialect]}", dialect=dialect, strict=True)
    assert convert_robot(source, tmp_path / "again.urdf", strict=True).losses == ()  # URDF has them anywhere


def test_an_export_has_it_too(floater: Path) -> None:
    export_robot(floater, "sdf", floater.parent / "out")
    assert pm.load(floater.parent / "out" / "floater.sdf").description.joint("root").type == "floating"


@pytest.mark.parametrize(
    "bad", ['<pm3dof:free_joint name="root"/>', "<pm3dof:free_joint><child>base</child></pm3dof:free_joint>"]
)
def test_a_free_joint_without_name_or_link_is_refused(floater: Path, bad: str) -> None:
    convert_robot(floater, floater.with_name("b.sdf"))
    text = floater.with_name("b.sdf").read_text()
    start, end = text.index("<pm3dof:free_joint"), text.index("</pm3dof:free_joint>")
    floater.with_name("bad.sdf").write_text(text[:start] + bad + text[end + len("</pm3dof:free_joint>") :])
    with pytest.raises(DescriptionError, match="a name of its own, and a child"):
        pm.load(floater.with_name("bad.sdf"))
