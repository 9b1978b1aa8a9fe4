"""MJCF files read into mechanisms, compared with MuJoCo itself."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, JointNotFoundError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.robot import Robot

LEG = """
<body name="thigh_{s}" pos="0 {y} 0"><joint name="hip_{s}" axis="0 1 0" range="-60 60"/>
 <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.4" mass="2"/>
 <body name="shin_{s}" pos="0 0 -0.4"><joint name="knee_{s}" axis="0 1 0" range="0 90"/>
  <geom type="capsule" size="0.03" fromto="0 0 0 0 0 -0.4" mass="1.5"/>
  <body name="foot_{s}" pos="0 0 -0.4">
   <joint name="ankle_pitch_{s}" axis="0 1 0"/><joint name="ankle_roll_{s}" axis="1 0 0" pos="0 0 -0.01"/>
   <geom type="box" size="0.1 0.05 0.01" mass="0.5"/>
   <site name="sole_{s}" pos="0 0 -0.02"/><site name="heel_left_{s}" pos="-0.06 0.04 0"/>
  </body>
  <body name="crank_left_{s}" pos="0 0.04 -0.1" quat="0.99 0.02 0.1 0.03"><joint name="motor_left_{s}" axis="0 1 0"/>
   <geom size="0.02" mass="0.1"/>
   <body name="rod_left_{s}" pos="-0.06 0 0"><joint name="ball_left_{s}" type="ball"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.3" mass="0.1"/>
    <site name="tip_left_{s}" pos="0 0 -0.3"/></body>
  </body>
  <body name="crank_right_{s}" pos="0 -0.04 -0.1"><joint name="motor_right_{s}" axis="0 1 0"/>
   <geom size="0.02" mass="0.1"/>
   <body name="rod_right_{s}" pos="-0.06 0 0"><joint name="ball_right_{s}" type="ball"/>
    <geom type="capsule" size="0.01" fromto="0 0 0 0 0 -0.3" mass="0.1"/></body>
  </body>
 </body>
</body>"""
LOOPS = """<connect name="right_{s}" body1="rod_right_{s}" body2="foot_{s}" anchor="0 0 -0.3"/>
<connect name="left_{s}" site1="tip_left_{s}" site2="heel_left_{s}"/>"""
MOTORS = "".join(f'<motor joint="{joint}_{{s}}"/>' for joint in ("hip", "knee", "motor_left", "motor_right"))
WALKER = f"""<mujoco model="walker"><option gravity="0 0 -1.62"/><worldbody><geom type="plane" size="1 1 0.1"/>
<body name="pelvis" pos="0 0 1">FREE<geom type="box" size="0.1 0.1 0.1" mass="5"/>
{LEG.format(s="l", y=0.1)}{LEG.format(s="r", y=-0.1)}</body>
</worldbody><equality>{"".join(LOOPS.format(s=s) for s in "lr")}</equality>
<actuator>{"".join(MOTORS.format(s=s) for s in "lr")}</actuator></mujoco>"""
STANDING, FLOATING = WALKER.replace("FREE", ""), WALKER.replace("FREE", "<freejoint name='float'/>")

SEVERAL_BODIES = """<mujoco model="several"><compiler angle="radian"/>
<default><joint stiffness="2" range="-1 1"/>
 <default class="leg"><joint axis="1 0 0" stiffness="5"/>
  <default class="foot"><joint limited="false" stiffness="0"/></default></default></default>
<worldbody>
 <site name="post" pos="0.3 0.2 0.1" axisangle="0 0 1 0.4"/>
 <body name="a" pos="0 0 1" childclass="leg"><joint name="turn"/><geom size="0.1" mass="1"/>
  <frame pos="0 0.5 0" euler="0.3 0.2 0.1">
   <body name="b"><joint name="slide" type="slide" class="foot" ref="0.1"/>
    <joint name="swing" axis="0 1 1" pos="0 0.1 0"/>
    <geom size="0.1" mass="1"/><site name="b" pos="0 0 0.5" euler="0.3 0.2 0.1"/></body></frame></body>
 <body name="c" pos="1 0 0"><geom size="0.1" mass="1"/>
  <body name="d" pos="0 0 0.2"><joint axis="0 1 0" ref="0.2" stiffness="0"/><geom size="0.1" mass="1"/>
   <site name="tcp" pos="0 0 0.1"/></body></body>
 <body name="e" pos="0 1 0"><freejoint name="float"/><geom size="0.1" mass="1"/></body>
</worldbody>
<equality>
 <connect body1="b" body2="d" anchor="0 0 0.4"/><connect body1="b" anchor="0.1 0 0.4"/>
 <weld body1="d" body2="e"/><weld body1="a" relpose="0.1 0.2 0.3 0.9 0.1 0.2 0.3" anchor="0.1 0.2 0.3"/>
 <weld body1="d" body2="a" anchor="0.1 0 0.3"/>
 <weld site1="b" site2="post"/><connect active="false" body1="b" body2="e" anchor="0 0 0"/>
 <joint name="geared" joint1="turn" joint2="swing"/>
</equality>
<actuator><position name="lift" joint="slide"/><velocity joint="slide"/><motor joint="turn"/>
 <motor name="thrust" site="tcp"/></actuator>
<keyframe><key qpos="0 0.1 0 0 0 1 0 1 0 0 0"/><key name="home" qpos="0.1 0.2 0.3 0.4 0 1 0 0.6 0.8 0 0"/></keyframe>
</mujoco>"""


def _load(tmp_path: Path, text: str, **options: Any) -> tuple[Robot, mujoco.MjModel]:
    path = tmp_path / "model.xml"
    path.write_text(text, encoding="utf-8")
    return Robot.load(path, **options), mujoco.MjModel.from_xml_path(str(path))


def _both(robot: Robot, model: mujoco.MjModel, seed: int) -> tuple[np.ndarray, mujoco.MjData]:
    """The same random configuration as q and as qpos, with MuJoCo's kinematics and constraints computed."""
    generator = np.random.default_rng(seed)
    q, data = pin.neutral(robot.model), mujoco.MjData(model)
    for joint, name in enumerate(robot.model.names[1:]):
        assert model.joint(joint).name in (name, "")
        index, address = robot.model.joints[joint + 1].idx_q, model.jnt_qposadr[joint]
        kind = mujoco.mjtJoint(model.jnt_type[joint])
        if kind == mujoco.mjtJoint.mjJNT_FREE:
            data.qpos[address : address + 3] = q[index : index + 3] = generator.uniform(-1.0, 1.0, 3)
            index, address = index + 3, address + 3
        if kind in (mujoco.mjtJoint.mjJNT_FREE, mujoco.mjtJoint.mjJNT_BALL):
            quaternion = generator.normal(size=4)
            quaternion /= np.linalg.norm(quaternion)
            data.qpos[address : address + 4] = quaternion
            q[index : index + 4] = quaternion[[1, 2, 3, 0]]
        else:
            data.qpos[address] = q[index] = generator.uniform(-1.0, 1.0)
    mujoco.mj_forward(model, data)
    return q, data


@pytest.mark.parametrize("text", [STANDING, FLOATING, SEVERAL_BODIES], ids=["standing", "floating", "several bodies"])
@pytest.mark.parametrize("seed", range(4))
def test_bodies_and_closures_are_where_mujoco_has_them(tmp_path: Path, text: str, seed: int) -> None:
    robot, model = _load(tmp_path, text)
    q, data = _both(robot, model, seed)
    configuration = robot.configuration(q)
    for body in range(1, model.nbody):
        placement = configuration.frame_placement(model.body(body).name)
        np.testing.assert_allclose(placement.translation, data.xpos[body], atol=1e-14)
        np.testing.assert_allclose(placement.rotation.ravel(), data.xmat[body], atol=1e-14)
    row, active = 0, [k for k in range(model.neq) if model.eq_active0[k] and model.eq_type[k] in (0, 1)]
    assert len(active) == len(robot.closures)
    for k, closure in zip(active, robot.closures, strict=True):
        assert closure.type == ("6d" if model.eq_type[k] else "3d")
        frames = [configuration.frame_placement(frame) for frame in (closure.frame_a, closure.frame_b)]
        gap = frames[0].translation - frames[1].translation
        np.testing.assert_allclose(gap, data.efc_pos[row : row + 3], atol=1e-14)
        if closure.type == "6d":  # MuJoCo's three numbers are the vector part of the quaternion between the frames
            turn = pin.Quaternion(frames[1].rotation.T @ frames[0].rotation).coeffs()[:3]
            measured = np.linalg.norm(data.efc_pos[row + 3 : row + 6])
            np.testing.assert_allclose(measured, np.linalg.norm(turn), atol=1e-14)
        row += 6 if closure.type == "6d" else 3


def test_a_walker_with_universal_ankles(tmp_path: Path) -> None:
    standing, _ = _load(tmp_path, STANDING)
    assert standing.name == "walker"
    assert len(standing.actuated_joints) == 8
    assert standing.model.gravity.linear.tolist() == [0.0, 0.0, -1.62]
    assert standing.home.closure_residual < 1e-12
    degrees = DegreesOfFreedom(standing.home)
    assert degrees.count == 2 * (2 + 2 + 2), "hip and knee, an ankle of two, and two rods that spin, in each leg"
    assert degrees.count - degrees.at_actuators.rank.rank == 4, "the motors hold all but the spin of four rods"
    assert np.degrees(standing.lower_limits[standing.q_names.index("hip_l")]) == pytest.approx(-60.0, rel=1e-14)
    floating, _ = _load(tmp_path, FLOATING)
    assert DegreesOfFreedom(floating.home).count == 6 + 12
    assert np.isinf(floating.upper_limits[:7]).all()


def test_drives_springs_couplings_and_keyframes(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.WARNING):
        robot, model = _load(tmp_path, SEVERAL_BODIES)
    assert [(command.name, command.joint, command.unit) for command in robot.commands] == [
        ("lift", "slide", "m"),
        ("turn", "turn", "rad"),
    ]
    assert [(c.joint, c.joints, c.coefficients) for c in robot.couplings] == [("turn", ("swing",), ((1.0,),))]
    assert "actuator 'thrust' drives no joint" in caplog.text
    assert {(spring["joint"], spring["stiffness"], spring["unit"]) for spring in robot.springs} == {
        ("turn", 5.0, "N m/rad"),
        ("swing", 5.0, "N m/rad"),
    }
    limits = {name: robot.upper_limits[robot.q_names.index(name)] for name in ("turn", "slide", "swing")}
    assert limits == {"turn": 1.0, "slide": np.inf, "swing": 1.0}
    assert robot.tool_frame == "tcp"
    home = robot.named_configurations["home"]
    np.testing.assert_allclose(home, [0.1, 0.2, 0.3, 0.4, 0.0, 1.0, 0.0, 0.8, 0.0, 0.0, 0.6], atol=1e-15)
    assert set(robot.named_configurations) == {"home", "key0", "qpos0"}
    np.testing.assert_allclose(robot.named_configurations["qpos0"][:4], model.qpos0[:4])


@pytest.mark.parametrize("angle", ["degree", "radian"])
def test_limits_are_mujocos(tmp_path: Path, angle: str) -> None:
    """Not shifted by `ref`, and those of slides are never degrees, unlike in Pinocchio's reader."""
    text = f"""<mujoco><compiler angle="{angle}"/>
    <default><default class="long"><joint type="slide" range="-0.1 0.8"/></default></default>
    <worldbody><body name="a"><joint name="s" class="long" axis="1 0 0" ref="0.5"/><geom size="0.1" mass="1"/>
    <body name="b"><joint name="h" range="-0.3 0.3" ref="0.2"/><geom size="0.1" mass="1"/></body></body></worldbody>
    </mujoco>"""
    robot, model = _load(tmp_path, text)
    limits = np.stack([robot.model.lowerPositionLimit, robot.model.upperPositionLimit], axis=1)
    np.testing.assert_allclose(limits, model.jnt_range, rtol=1e-12)


def test_home_is_the_initial_configuration_without_a_key_of_that_name(tmp_path: Path) -> None:
    robot, model = _load(tmp_path, SEVERAL_BODIES.replace('name="home"', 'name="bent"'))
    np.testing.assert_allclose(robot.named_configurations["home"][:4], model.qpos0[:4])


def test_a_site_is_the_tool_by_name(tmp_path: Path) -> None:
    robot, model = _load(tmp_path, STANDING, tool_frame="sole_l")
    q, data = _both(robot, model, 7)
    np.testing.assert_allclose(robot.configuration(q).tool_placement.translation, data.site("sole_l").xpos, atol=1e-14)


def test_a_site_may_share_its_name_with_a_body(tmp_path: Path) -> None:
    robot, model = _load(tmp_path, SEVERAL_BODIES)
    q, data = _both(robot, model, 7)
    for name, place in (("b", data.body("b")), ("b_site", data.site("b")), ("post", data.site("post"))):
        position = robot.configuration(q).frame_placement(name).translation
        np.testing.assert_allclose(position, place.xpos, atol=1e-14)


def test_files_that_are_included_are_read(tmp_path: Path) -> None:
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "leg.xml").write_text(f"<mujocoinclude>{LEG.format(s='l', y=0.1)}</mujocoinclude>")
    robot, model = _load(
        tmp_path, '<mujoco><worldbody><body name="pelvis"><include file="parts/leg.xml"/></body></worldbody></mujoco>'
    )
    assert robot.model.njoints - 1 == model.njnt
    assert robot.name == "model"


def test_included_files_include_others_as_mujoco_has_it(tmp_path: Path) -> None:
    """Relative to the main file, or else the including one; from another folder only if that is given."""
    (tmp_path / "a" / "parts").mkdir(parents=True)
    (tmp_path / "b").mkdir()
    (tmp_path / "a" / "parts" / "world.xml").write_text(
        '<mujocoinclude><worldbody><include file="arm.xml"/><include file="../b/table.xml"/></worldbody>'
        "</mujocoinclude>"
    )
    (tmp_path / "a" / "parts" / "arm.xml").write_text(
        '<mujocoinclude><body name="arm"><joint name="j"/><geom size="0.1"/></body></mujocoinclude>'
    )
    (tmp_path / "b" / "table.xml").write_text(
        '<mujocoinclude><body name="table"><joint name="k"/><geom size="0.1"/></body></mujocoinclude>'
    )
    text = '<mujoco><include file="parts/world.xml"/></mujoco>'
    robot, model = _load(tmp_path / "a", text, package_paths=[tmp_path / "b"])
    assert list(robot.model.names)[1:] == [model.joint(index).name for index in range(model.njnt)] == ["j", "k"]
    with pytest.raises(DescriptionError, match=r"table\.xml, expected a file in .*--package-path"):
        _load(tmp_path / "a", text)


def test_sections_in_any_order_and_number(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Duplicate defaults, also after the bodies that use them; a flag named like a number; drives of a ball joint."""
    robot, model = _load(
        tmp_path,
        """<mujoco><option><flag gravity="disable"/></option><default><joint range="-20 40"/></default>
        <worldbody><body name="a"><joint name="j" class="stiff"/><geom class="bar" mass="1"/>
        <body name="b" pos="1 0 0"><joint name="ball" type="ball" range="0 40"/>
        <geom size="0.1" material="grey" mass="2"/></body>
        </body></worldbody><actuator><motor name="m" joint="j"/><motor name="turn" joint="ball"/></actuator>
        <default><default class="stiff"><joint stiffness="3"/></default>
        <default class="bar"><geom type="capsule" size="0.1 0.5"/></default></default>
        <asset><material name="grey" rgba="0.5 0.5 0.5 1"/></asset></mujoco>""",
    )
    np.testing.assert_allclose([robot.lower_limits[0], robot.upper_limits[0]], model.jnt_range[0], rtol=1e-12)
    assert [spring["stiffness"] for spring in robot.springs] == model.jnt_stiffness[:1].tolist() == [3.0]
    np.testing.assert_array_equal(robot.model.gravity.linear, np.zeros(3))
    assert [command.name for command in robot.commands] == ["m"]
    assert "actuator 'turn' drives a ball or free joint" in caplog.text
    assert "the ranges of ball joints are ignored: ball" in caplog.text


def test_masses_of_meshes_whose_files_are_missing_are_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "model.xml"
    path.write_text(
        '<mujoco><asset><mesh name="m" file="gone.stl"/></asset><worldbody>'
        '<body name="unknown"><joint/><geom type="mesh" mesh="m"/></body>'
        '<body name="given"><joint/><inertial pos="0 0 0" mass="3" diaginertia="1 1 1"/><geom mesh="m" type="mesh"/>'
        "</body></worldbody></mujoco>",
        encoding="utf-8",
    )
    with caplog.at_level(logging.WARNING):
        assert Robot.load(path).model.inertias[2].mass == 3.0
    assert "their files are missing; give <inertial>: unknown" in caplog.text


def test_inertias_are_mujocos(tmp_path: Path) -> None:
    geoms = (
        '<geom type="capsule" size="0.03" fromto="0 0 0 0.3 0.2 -0.4" mass="2"/>',
        '<geom type="cylinder" size="0.03 0.1" pos="0.1 0 0" euler="0 30 0"/>',
        '<geom type="ellipsoid" size="0.1 0.2 0.3" density="10"/><geom type="box" size="0.1 0.2 0.3"/>',
        '<inertial pos="0.1 0.2 0.3" mass="2" fullinertia="1 2 2.5 0.1 0.2 0.3"/>',
    )
    bodies = "".join(f'<body pos="0.1 0 0.2"><joint axis="0 {k} 1"/>{geom}' for k, geom in enumerate(geoms))
    robot, model = _load(tmp_path, f"<mujoco><worldbody>{bodies}{'</body>' * len(geoms)}</worldbody></mujoco>")
    q, data = _both(robot, model, 3)
    masses = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, masses)
    computed = np.triu(pin.crba(robot.model, robot.model.createData(), q))
    np.testing.assert_allclose(computed, np.triu(masses), rtol=1e-12, atol=1e-12)


def test_the_closures_file_beside_it_goes_first(tmp_path: Path) -> None:
    (tmp_path / "model.closures.yaml").write_text(
        "commands: [{name: u1, joint: hip_l, unit: rad, offset: 0.5}]\ntool_frame: sole_r\n"
        "closed_loop: [[sole_l, sole_r]]\ntype: [3d]\n"
    )
    robot, _ = _load(tmp_path, STANDING)
    assert [command.name for command in robot.commands] == ["u1"]
    assert robot.actuated_joints == ("hip_l",)
    assert robot.tool_frame == "sole_r"
    assert len(robot.closures) == 5


@pytest.mark.parametrize(
    ("text", "error", "said"),
    [
        (
            "<mujoco><worldbody><flexcomp/></worldbody></mujoco>",
            DescriptionError,
            "line 1: <flexcomp>: is not supported",
        ),
        (
            SEVERAL_BODIES.replace('stiffness="5"', 'stiffness="soft"'),
            DescriptionError,
            "stiffness: expected a number, not 'soft'",
        ),
        (SEVERAL_BODIES.replace('body2="e"', 'body2="ghost"'), FrameNotFoundError, "<weld name='weld3'>.*'ghost'"),
        (SEVERAL_BODIES.replace('site2="post"', 'site2="ghost"'), DescriptionError, "expected existing sites"),
        (
            SEVERAL_BODIES.replace('motor joint="turn"', 'motor joint="ghost"'),
            JointNotFoundError,
            "<actuator>.*'ghost'",
        ),
        (
            SEVERAL_BODIES.replace('type="slide"', 'type="screw"'),
            DescriptionError,
            "'slide'>: expected a hinge, .*'screw'",
        ),
        (SEVERAL_BODIES.replace("<geom", '<geom class="ghost"', 1), DescriptionError, "no default class 'ghost'"),
        ("<mujoco><include file='ghost.xml'/></mujoco>", DescriptionError, r"ghost\.xml: file: expected a readable"),
    ],
)
def test_what_is_not_read_is_named(tmp_path: Path, text: str, error: type[Exception], said: str) -> None:
    path = tmp_path / "model.xml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(error, match=said):
        Robot.load(path)


def test_a_shape_without_size_has_no_inertia(tmp_path: Path) -> None:
    path = tmp_path / "walker.xml"
    path.write_text(STANDING.replace('type="capsule" size="0.03"', 'type="capsule" size="0"', 1), encoding="utf-8")
    with pytest.raises(DescriptionError, match="a capsule without size has no inertia"):
        Robot.load(path)


def test_what_an_equality_holds_is_neither_driven_nor_followed(tmp_path: Path) -> None:
    """An equality of one joint, its follower's, and a quaternion of zeros, which MuJoCo takes for none."""
    body = '<body name="{0}" pos="0 0 0.1"><joint name="{0}" axis="0 1 0"/><geom size="0.1"/>'
    text = (
        '<mujoco><compiler angle="radian"/><worldbody>'
        + "".join(map(body.format, "abc"))
        + '</body></body></body><body name="cup"><freejoint/><geom size="0.1"/></body></worldbody><equality>'
        '<joint joint1="b" joint2="a" polycoef="0.1 2 0.5 0 0"/><joint joint1="a" polycoef="0.3 0 0 0 0"/></equality>'
        '<actuator><motor joint="a"/><motor joint="c"/></actuator>'
        '<keyframe><key name="home" qpos="0.3 0.745 0 1 2 3 0 0 0 0"/></keyframe></mujoco>'
    )
    robot, model = _load(tmp_path, text)
    assert robot.actuated_joints == ("c",)
    assert robot.couplings == ()
    assert robot.model.nv == 1 + 6
    assert [str(entry) for entry in robot.description.unread if "which an equality holds" in entry.reason]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    mujoco.mj_kinematics(model, data)
    for name in ("b", "c", "cup"):
        placed = robot.home.frame_placement(name)
        np.testing.assert_allclose(placed.translation, data.body(name).xpos, atol=1e-12)
        np.testing.assert_allclose(placed.rotation, data.body(name).xmat.reshape(3, 3), atol=1e-12)


def test_a_mesh_without_volume_is_refused(tmp_path: Path) -> None:
    (tmp_path / "flat.xml").write_text(
        '<mujoco><asset><mesh name="sheet" vertex="0 0 0 1 0 0 0 1 0 1 1 0"/></asset><worldbody><body name="b">'
        '<joint name="j"/><geom type="mesh" mesh="sheet"/></body></worldbody></mujoco>'
    )
    with pytest.raises(DescriptionError, match=r"sheet.*has no volume"):
        Robot.load(tmp_path / "flat.xml")
