"""MJCF files of every kind of statement, held against MuJoCo: places, anchors, inertias, drives."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pm3dof_pin.description.description import Description
from pm3dof_pin.description.readers.mjcf import read_mjcf
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.model import build_model

_GEOM = '<geom type="box" size="0.1 0.2 0.3" mass="2" pos="0.1 0.2 0.3"/>'


def _arm(joint: str, *, compiler: str = "", default: str = "", body: str = "") -> str:
    return (
        f"<mujoco>{compiler}{default}<worldbody><body {body}>{joint}{_GEOM}<body pos='0.3 0.1 0' quat='1 2 3 4'>"
        f'<joint name="second" axis="1 2 3"/>{_GEOM}</body></body></worldbody></mujoco>'
    )


_TWO_BARS = """<worldbody><body name="l"><joint name="left"/><geom size="0.1" mass="1" pos="0 0.2 0"/></body>
<body name="r" pos="0.4 0 0"><joint name="right"/><geom size="0.1" mass="1" pos="0 0.3 0"/></body>
<body name="s" pos="0 0 1"><joint name="slide" type="slide" ref="0.2"/><geom size="0.1" mass="1"/></body></worldbody>"""

CORPUS = {
    "joint pos by default": _arm(
        '<joint name="j"/>', default='<default><joint pos="0 0.018 0.1" axis="1 0 1" armature="0.3"/></default>'
    ),
    "joint pos by class": _arm(
        '<joint name="j" class="a"/><joint name="k" axis="1 0 0"/>',
        default='<default><default class="a"><joint pos="0.1 0 0" damping="2" frictionloss="0.5"/></default></default>',
    ),
    "childclass": _arm(
        '<joint name="j"/>',
        default='<default><default class="x"><joint axis="1 1 0" ref="0.3"/><geom type="capsule" size="0.1 0.2"/>'
        "</default></default>",
        body='childclass="x"',
    ),
    "axisangle not of length 1": _arm('<joint name="j"/>', body='axisangle="1 2 3 40"'),
    "euler, turning axes": _arm('<joint name="j"/>', body='euler="10 20 30"'),
    "euler, fixed axes": _arm('<joint name="j"/>', body='euler="10 20 30"', compiler='<compiler eulerseq="XYZ"/>'),
    "euler, both": _arm(
        '<joint name="j"/>', body='euler="0.1 0.2 0.3"', compiler='<compiler eulerseq="zXy" angle="radian"/>'
    ),
    "xyaxes": _arm('<joint name="j"/>', body='xyaxes="1 2 0 0 1 1"'),
    "zaxis": _arm('<joint name="j"/>', body='zaxis="1 2 -3"'),
    "ref": _arm('<joint name="j" ref="20"/><joint name="k" type="slide" axis="0 1 1" ref="0.3"/>'),
    "three joints of a body": _arm(
        '<joint name="j" pos="0.1 0 0"/><joint name="k" axis="0 1 0" pos="0 0.2 0"/><joint name="b" type="ball"/>'
    ),
    "joints in a frame": _arm('<frame pos="0.1 0.2 0" euler="0 40 0"><joint name="j" pos="0 0 0.1"/></frame>'),
    "free body": _arm('<freejoint name="f"/>', body='pos="1 2 3" quat="1 0.2 0.3 0.4"'),
    "total mass": _arm('<joint name="j"/>', compiler='<compiler settotalmass="8"/>'),
    "groups with mass": _arm(
        '<joint name="j"/><geom size="0.3" group="3"/>', compiler='<compiler inertiagrouprange="0 2"/>'
    ),
    "bounds": _arm('<joint name="j"/>', compiler='<compiler boundmass="3" boundinertia="0.5"/>'),
    "balanced": _arm(
        '<joint name="j"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 2.5"/>',
        compiler='<compiler balanceinertia="true"/>',
    ),
    "inertia from geoms": _arm(
        '<joint name="j"/><inertial pos="0 0 0" mass="9" diaginertia="1 1 1"/>',
        compiler='<compiler inertiafromgeom="true"/>',
    ),
    "shells": _arm(
        '<joint name="j"/><geom type="box" size="0.1 0.2 0.3" shellinertia="true"/>'
        '<geom type="cylinder" size="0.1 0.2" mass="3" shellinertia="true" pos="0 1 0"/>'
        '<geom size="0.1" shellinertia="true"/><geom type="capsule" size="0.1 0.3" shellinertia="true"/>'
    ),
    "from to": _arm(
        '<joint name="j"/><geom type="cylinder" size="0.1" fromto="0 0 0 1 2 3"/>'
        '<geom type="box" size="0.1 0.2" fromto="0 0 0 1 -2 3" density="3"/>'
        '<geom type="ellipsoid" size="0.1 0.2" fromto="0 1 0 1 -2 3"/>'
        '<geom type="capsule" size="0.1" fromto="0 0 0 0 0 -1"/>'
    ),
    "replicate": '<mujoco><worldbody><body name="hub"><joint name="h"/><geom size="0.1"/>'
    '<replicate count="12" euler="0 0 30" offset="0.1 0 0.05" sep="-"><body name="b" pos="1 0 0"><joint name="j" '
    'axis="0 1 0"/><geom size="0.1"/></body></replicate></body></worldbody></mujoco>',
    "frames": '<mujoco><worldbody><frame pos="1 2 3" euler="10 20 30"><body name="a" pos="0 0 1" axisangle="0 1 0 30">'
    '<frame euler="0 0 45"><geom type="box" size="0.1 0.2 0.3" pos="1 0 0"/><site name="s" pos="0 1 0"/></frame>'
    '<joint name="j" axis="1 1 0"/></body></frame></worldbody></mujoco>',
    "connect and weld": f"<mujoco>{_TWO_BARS}<equality><connect body1='l' body2='r' anchor='0 0.3 0'/>"
    "<weld body1='s' body2='r' torquescale='0' anchor='0.1 0 0'/><connect active='false' body1='l' body2='s' "
    "anchor='0 0 0'/></equality></mujoco>",
    "weld by default": "<mujoco><default><default class='w'><equality active='false'/></default></default>"
    f"{_TWO_BARS}<equality><weld class='w' body1='s'/><weld body1='s' relpose='0.1 0.2 0.3 0 1 0 0'/>"
    "</equality></mujoco>",
}


def _both(path: Path) -> tuple[Description, pin.Model, mujoco.MjModel]:
    description = read_mjcf(path)
    return description, build_model(description), mujoco.MjModel.from_xml_path(str(path))


def _random(model: pin.Model, reference: mujoco.MjModel, seed: int) -> tuple[np.ndarray, mujoco.MjData]:
    """The same random configuration as q and as qpos."""
    generator = np.random.default_rng(seed)
    data, q = mujoco.MjData(reference), pin.neutral(model)
    movable = [joint for joint in list(model.joints)[1:] if joint.nq]
    assert len(movable) == reference.njnt
    for joint, address in zip(movable, reference.jnt_qposadr, strict=True):
        numbers = generator.uniform(-1.0, 1.0, joint.nq)
        if joint.nq > 1:
            numbers[-4:] /= np.linalg.norm(numbers[-4:])
            data.qpos[address : address + joint.nq] = [*numbers[:-4], numbers[-1], *numbers[-4:-1]]
        else:
            data.qpos[address] = numbers[0]
        q[joint.idx_q : joint.idx_q + joint.nq] = numbers
    mujoco.mj_forward(reference, data)
    return q, data


@pytest.mark.parametrize("statement", CORPUS)
def test_every_statement_is_read_as_by_mujoco(tmp_path: Path, statement: str) -> None:
    path = tmp_path / "model.xml"
    path.write_text(CORPUS[statement], encoding="utf-8")
    description, model, reference = _both(path)
    for seed in range(3):
        q, data = _random(model, reference, seed)
        placed = model.createData()
        pin.framesForwardKinematics(model, placed, q)
        bodies = [body.name for body in description.bodies if not body.name.endswith("_body")]
        for body, name in enumerate(bodies):
            found = placed.oMf[model.getFrameId(name, pin.FrameType.BODY)]
            np.testing.assert_allclose(found.translation, data.xpos[body], atol=1e-13)
            np.testing.assert_allclose(found.rotation.ravel(), data.xmat[body], atol=1e-13)
        for index in range(reference.nsite):
            found = placed.oMf[model.getFrameId(reference.site(index).name, pin.FrameType.OP_FRAME)]
            np.testing.assert_allclose(found.translation, data.site_xpos[index], atol=1e-13)
        masses = np.zeros((reference.nv, reference.nv))
        mujoco.mj_fullM(reference, data, masses)
        if all(joint.nq == 1 for joint in list(model.joints)[1:]):  # others have rates in other axes
            computed = np.triu(pin.crba(model, model.createData(), q))
            np.testing.assert_allclose(computed, np.triu(masses), rtol=1e-10, atol=1e-10)
    total = sum(body.mass for body in description.bodies)
    assert total == pytest.approx(reference.body_mass.sum(), rel=1e-12)
    singles = [joint for joint in description.joints if joint.is_single]
    dofs = [reference.joint(joint.name).dofadr[0] for joint in singles if joint.name in _names(reference)]
    known = [joint for joint in singles if joint.name in _names(reference)]
    np.testing.assert_allclose([joint.damping for joint in known], reference.dof_damping[dofs])
    np.testing.assert_allclose([joint.friction for joint in known], reference.dof_frictionloss[dofs])
    np.testing.assert_allclose([joint.armature for joint in known], reference.dof_armature[dofs])


def _names(reference: mujoco.MjModel) -> set[str]:
    return {reference.joint(index).name for index in range(reference.njnt)}


@pytest.mark.parametrize("statement", ["connect and weld", "weld by default"])
def test_closures_are_mujocos_constraints(tmp_path: Path, statement: str) -> None:
    path = tmp_path / "model.xml"
    path.write_text(CORPUS[statement], encoding="utf-8")
    robot, reference = Robot.load(path), mujoco.MjModel.from_xml_path(str(path))
    q, data = _random(robot.model, reference, 5)
    active = [k for k in range(reference.neq) if reference.eq_active0[k]]
    assert len(active) == len(robot.closures)
    row = 0
    for k, closure in zip(active, robot.closures, strict=True):
        places = [robot.configuration(q).frame_placement(name) for name in (closure.frame_a, closure.frame_b)]
        gap = places[0].translation - places[1].translation
        np.testing.assert_allclose(gap, data.efc_pos[row : row + 3], atol=1e-13)
        row += 6 if reference.eq_type[k] == mujoco.mjtEq.mjEQ_WELD else 3
        has_torque = reference.eq_type[k] == mujoco.mjtEq.mjEQ_WELD and reference.eq_data[k, 10] != 0.0
        assert closure.type == ("6d" if has_torque else "3d")


def test_couplings_are_mujocos_joint_equalities(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(
        f"<mujoco>{_TWO_BARS}<equality><joint joint1='slide' joint2='left' polycoef='0.1 0.2 0.3 0.4 0.5'/>"
        "<joint joint1='right' polycoef='0.3 0 0 0 0'/></equality></mujoco>",
        encoding="utf-8",
    )
    description, reference = read_mjcf(path), mujoco.MjModel.from_xml_path(str(path))
    (coupling,) = description.couplings
    data = mujoco.MjData(reference)
    data.qpos[:] = 0.7, 0.3, 0.9
    mujoco.mj_forward(reference, data)
    # the residual is that of the joint that follows
    assert 0.9 - coupling.value([0.7]) == pytest.approx(data.efc_pos[0], abs=1e-14)
    assert data.efc_pos[1] == pytest.approx(0.0, abs=1e-14)
    held = description.joint("right")
    assert held.is_fixed
    assert held.placement.se3.rotation[1, 0] == pytest.approx(np.sin(0.3), abs=1e-15)


GRIPPER = """<mujoco><default><default class="finger"><joint axis="0 0 1" range="0 45"/></default></default><worldbody>
<body name="palm"><geom size="0.1"/>
<body name="a" pos="-0.1 0 0"><joint name="first" class="finger"/><geom size="0.02"/></body>
<body name="b" pos="0.1 0 0"><joint name="second" class="finger"/><geom size="0.02"/></body></body></worldbody>
<tendon><fixed name="split"><joint joint="first" coef="0.5"/><joint joint="second" coef="0.5"/></fixed></tendon>
<equality>EQUAL</equality><actuator><general name="grip" tendon="split" ctrlrange="0 255" forcerange="-5 5" gear="2"
gainprm="0.3" biasprm="0 -100 -10" biastype="affine"/></actuator></mujoco>"""


def test_a_gripper_with_a_joint_equality_has_one_degree_of_freedom(tmp_path: Path) -> None:
    path = tmp_path / "gripper.xml"
    path.write_text(GRIPPER.replace("EQUAL", '<joint joint1="second" joint2="first"/>'), encoding="utf-8")
    robot = Robot.load(path)
    assert DegreesOfFreedom(robot.home).count == 1
    assert robot.actuated_joints == ("first",)
    (drive,) = robot.description.drives if robot.description else ()
    assert (drive.name, drive.gear, drive.control_range, drive.force_range) == ("grip", 2.0, (0.0, 255.0), (-5.0, 5.0))


def test_a_tendon_of_free_joints_is_a_coordinate_of_its_own(tmp_path: Path) -> None:
    path = tmp_path / "gripper.xml"
    path.write_text(GRIPPER.replace("EQUAL", ""), encoding="utf-8")
    robot = Robot.load(path)
    assert robot.actuated_joints == ("split",)
    assert DegreesOfFreedom(robot.home).count == 2
    q = robot.assemble(joints={"first": 0.2, "second": 0.4}).q
    assert q[robot.q_names.index("split")] == pytest.approx(0.5 * (0.2 + 0.4), abs=1e-9)


def test_springs_of_fixed_tendons_are_felt_at_the_tool(tmp_path: Path) -> None:
    """Two hinges with springs of their own, and c q of a tendon: in joint space, K = diag(k) + s c c^T."""
    c, s, k = np.array([0.6, -1.2]), 50.0, np.array([40.0, 30.0])
    path = tmp_path / "arm.xml"
    path.write_text(
        f"""<mujoco><default><tendon stiffness="{s}"/></default><worldbody><body name="upper">
        <joint name="shoulder" axis="0 1 0" stiffness="{k[0]}"/><geom size="0.1"/>
        <body name="lower" pos="1 0 0"><joint name="elbow" axis="0 1 0" stiffness="{k[1]}"/><geom size="0.1"/>
        <site name="tip" pos="0.5 0 0"/></body></body></worldbody>
        <tendon><fixed name="strap"><joint joint="shoulder" coef="{c[0]}"/><joint joint="elbow" coef="{c[1]}"/></fixed>
        <fixed name="band" stiffness="7"><joint joint="elbow" coef="2"/></fixed></tendon>
        <actuator><motor joint="shoulder"/><motor joint="elbow"/></actuator></mujoco>""",
        encoding="utf-8",
    )
    robot = Robot.load(path, tool_frame="tip")
    assert DegreesOfFreedom(robot.home).count == 2
    stiffness = np.diag(k) + s * np.outer(c, c) + np.diag([0.0, 7.0 * 2.0**2])
    lever = np.array([-1.5, -0.5])  # of the tip along z, by each hinge [m]
    found = cartesian_compliance(ElasticModel(robot), robot.home).compliance[2, 2]
    assert found == pytest.approx(lever @ np.linalg.solve(stiffness, lever), rel=1e-9)


def test_drives_keep_gains_gears_and_ranges(tmp_path: Path) -> None:
    path = tmp_path / "model.xml"
    path.write_text(
        f"<mujoco><default><position kp='7' ctrlrange='-1 1'/></default>{_TWO_BARS}<actuator>"
        "<position name='p' joint='left' gear='3'/><motor name='m' joint='right' gear='50' forcerange='-2 2'/>"
        "<velocity name='v' joint='slide' kv='4'/></actuator></mujoco>",
        encoding="utf-8",
    )
    drives = read_mjcf(path).drives
    reference = mujoco.MjModel.from_xml_path(str(path))
    assert [(drive.name, drive.joint, drive.gear) for drive in drives] == [
        ("p", "left", 3.0),
        ("m", "right", 50.0),
        ("v", "slide", 1.0),
    ]
    assert drives[0].proportional_gain == reference.actuator_gainprm[0, 0] == 7.0
    assert drives[2].derivative_gain == reference.actuator_gainprm[2, 0] == 4.0
    assert drives[0].control_range == (-1.0, 1.0)
    assert drives[1].force_range == (-2.0, 2.0)


@pytest.mark.parametrize("method", ["exact", "legacy", "convex", "shell"])
@pytest.mark.parametrize("shape", ["box", "dumbbell"])
def test_masses_of_meshes_are_mujocos(tmp_path: Path, method: str, shape: str) -> None:
    mesh = trimesh.creation.box((0.1, 0.2, 0.3))
    if shape == "dumbbell":
        ends = [trimesh.creation.icosphere(radius=0.1).apply_translation((x, 0.02, 0.3)) for x in (-0.3, 0.3)]
        mesh = trimesh.boolean.union([trimesh.creation.box((0.6, 0.03, 0.03)).apply_translation((0, 0, 0.3)), *ends])
    (tmp_path / "meshes").mkdir()
    mesh.export(tmp_path / "meshes" / "part.stl")
    path = tmp_path / "model.xml"
    path.write_text(
        f'<mujoco><compiler meshdir="meshes"/><asset><mesh file="part.stl" scale="2 1 0.5" refpos="0.1 0 0" '
        f'refquat="1 0.2 0 0" inertia="{method}"/></asset><worldbody><body><joint/><geom type="mesh" mesh="part" '
        'pos="0.1 0.2 0.3" euler="10 20 30" density="500"/></body></worldbody></mujoco>',
        encoding="utf-8",
    )
    _, model, reference = _both(path)
    assert model.inertias[1].mass == pytest.approx(reference.body_mass[1], rel=1e-5)
    np.testing.assert_allclose(model.inertias[1].lever, reference.body_ipos[1], atol=1e-5)
    moments = np.sort(np.linalg.eigvalsh(model.inertias[1].inertia))
    np.testing.assert_allclose(moments, np.sort(reference.body_inertia[1]), rtol=1e-4)


def test_models_are_attached_with_their_own_settings(tmp_path: Path) -> None:
    (tmp_path / "leg.xml").write_text(
        '<mujoco model="leg"><compiler angle="radian"/><default><joint axis="0 1 0" range="-1 1"/></default>'
        '<worldbody><body name="thigh" euler="0.3 0 0"><joint name="hip"/><geom size="0.1"/>'
        '<body name="shin" pos="0 0 -1">'
        '<joint name="knee"/><geom size="0.1"/><site name="foot" pos="0 0 -1"/></body></body></worldbody>'
        '<actuator><motor name="m" joint="knee"/></actuator></mujoco>',
        encoding="utf-8",
    )
    path = tmp_path / "model.xml"
    path.write_text(
        '<mujoco><asset><model name="leg" file="leg.xml"/></asset><worldbody><body name="trunk" euler="0 30 0">'
        '<joint name="j" range="-90 90"/><geom size="0.1"/><frame pos="0 0.2 0">'
        '<attach model="leg" body="thigh" prefix="l_"/>'
        '</frame><frame pos="0 -0.2 0" euler="10 0 0"><attach model="leg" body="thigh" prefix="r_"/></frame></body>'
        "</worldbody></mujoco>",
        encoding="utf-8",
    )
    description, model, reference = _both(path)
    q, data = _random(model, reference, 1)
    placed: Any = model.createData()
    pin.framesForwardKinematics(model, placed, q)
    for name in ("l_shin", "r_shin"):
        found = placed.oMf[model.getFrameId(name, pin.FrameType.BODY)]
        np.testing.assert_allclose(found.translation, data.body(name).xpos, atol=1e-14)
    np.testing.assert_allclose(
        np.stack([model.lowerPositionLimit, model.upperPositionLimit], axis=1), reference.jnt_range, rtol=1e-14
    )
    assert {drive.joint for drive in description.drives} == {"l_knee", "r_knee"}


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<equality>EQUAL", "<equality><flex/>", "<flex>: is not supported"),
        ("<equality>EQUAL", '<equality><tendon tendon1="split" tendon2="split"/>', "is not supported: of two tendons"),
        ('tendon="split" ctrl', 'tendon="ghost" ctrl', "expected a fixed tendon, not 'ghost'"),
        ('tendon="split" ctrl', 'cranksite="a" slidersite="b" ctrl', "slider-crank transmissions are not supported"),
        ('<body name="a"', '<composite/><body name="a"', "<composite>: is not supported"),
        ('<body name="a"', '<jonit/><body name="a"', "<jonit>: is unknown in <body>, expected <joint>"),
    ],
)
def test_what_is_not_supported_is_refused_by_name_and_line_or_listed(
    tmp_path: Path, old: str, new: str, said: str
) -> None:
    path = tmp_path / "gripper.xml"
    path.write_text(GRIPPER.replace(old, new).replace("EQUAL", ""), encoding="utf-8")
    with pytest.raises(DescriptionError, match=rf"line \d+: .*{said}.*lenient"):
        read_mjcf(path)
    assert any(said.partition(": ")[2] in str(entry) for entry in read_mjcf(path, lenient=True).unread)


@pytest.mark.parametrize("kind", ["copies", "included"])
def test_files_that_multiply_without_end_are_refused(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "model.xml"
    body = "<body><joint/><geom size='0.1'/></body>"
    if kind == "copies":
        nested = "<replicate count='1000'>" * 4 + body + "</replicate>" * 4
        path.write_text(f"<mujoco><worldbody>{nested}</worldbody></mujoco>", encoding="utf-8")
    for level in range(19) if kind == "included" else ():
        twice = f"<include file='m{level + 1}.xml'/>" * 2
        text = f"<mujoco><worldbody>{twice}</worldbody></mujoco>" if level == 0 else f"<x>{twice}{body}</x>"
        (tmp_path / ("model.xml" if level == 0 else f"m{level}.xml")).write_text(text, encoding="utf-8")
    (tmp_path / "m19.xml").write_text(f"<x>{body}</x>", encoding="utf-8")
    with pytest.raises(DescriptionError, match="expected at most 50000 elements"):
        read_mjcf(path)


def test_a_short_keyframe_is_completed_by_the_initial_configuration(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(_arm('<joint name="j" ref="30"/>', body='quat="1 0 1 0"'), encoding="utf-8")
    third = f'<body><joint name="b" type="ball"/>{_GEOM}</body>'
    text = path.read_text(encoding="utf-8").replace("</worldbody>", f"{third}</worldbody>")
    for numbers in ("0.5", "0.5 0.6", "0.5 0.6 0.6 0.8"):
        key = f'<keyframe><key name="home" qpos="{numbers}"/></keyframe></mujoco>'
        path.write_text(text.replace("</mujoco>", key), encoding="utf-8")
        expected = mujoco.MjModel.from_xml_path(str(path)).key_qpos[0]
        found = read_mjcf(path).configurations["home"]
        ball = found["b"]
        np.testing.assert_allclose([*found["j"], *found["second"], ball[3], *ball[:3]], expected, atol=1e-15)
    path.write_text(path.read_text(encoding="utf-8").replace('qpos="', 'qpos="1 2 3 '), encoding="utf-8")
    with pytest.raises(DescriptionError, match="line 1: <key name='home'>: qpos: expected 6 numbers, not 7"):
        read_mjcf(path)


def test_an_equality_of_bodies_that_do_not_move_is_read_over(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    weld = '<body name="post"/></worldbody><equality><weld body1="post"/></equality>'
    path.write_text(_arm('<joint name="j"/>').replace("</worldbody>", weld), encoding="utf-8")
    description = read_mjcf(path)
    assert description.closures == ()
    assert [part.reason for part in description.unread] == ["joins bodies that do not move to each other"]


def test_a_tendon_around_something_is_refused_or_read_over(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    sites = "".join(f'<site name="s{k}" pos="{k} 0 1"/>' for k in range(3))
    tendon = "<tendon><spatial name='t'>" + "".join(f"<site site='s{k}'/>" for k in range(3)) + "</spatial></tendon>"
    tail = f"{sites}</worldbody>{tendon}<equality><tendon tendon1='t'/></equality>"
    path.write_text(_arm('<joint name="j"/>').replace("</worldbody>", tail), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"line 1: <spatial name='t'>: is held by an equality.*--lenient"):
        read_mjcf(path)
    assert read_mjcf(path, lenient=True).closures == ()
