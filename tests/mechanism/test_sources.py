"""Descriptions from objects of other libraries, and from files beside a URDF."""

from __future__ import annotations

import sys
import types
from pathlib import Path

import mujoco
import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.capability.transmission import drive_values
from pm3dof_pin.description.description import Description
from pm3dof_pin.description.readers.pinocchio_model import describe_model
from pm3dof_pin.description.robots import find_robot, robot_names
from pm3dof_pin.exceptions import DescriptionError, FreeDirectionError, InvalidValueError, UnknownRobotError
from pm3dof_pin.export.mjcf import mjcf_text
from pm3dof_pin.export.robot_document import read_robot
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.model import build_model

LEG = """<mujoco model="leg"><worldbody><body name="thigh" pos="0 0 1" euler="0 20 0">
<joint name="hip" axis="0 1 0" range="-60 60" ref="10" armature="0.1" damping="2"/><geom size="0.1" mass="2"/>
<body name="shin" pos="0 0 -0.4"><joint name="knee" axis="0 1 0" pos="0 0 0.01" frictionloss="0.3"/>
<joint name="twist" axis="0 0 1"/><geom type="box" size="0.1 0.2 0.3"/><site name="sole" pos="0 0 -0.4"/></body></body>
<body name="crank" pos="0.2 0 1"><joint name="motor" axis="0 1 0"/><geom size="0.1"/></body>
<body name="box"><freejoint name="free"/><geom size="0.1"/></body></worldbody>
<equality><connect body1="crank" body2="shin" anchor="0 0 -0.3"/>
<joint joint1="knee" joint2="hip" polycoef="0 2 1 0 0"/>
</equality><actuator><position name="p" joint="hip" kp="30" gear="2" ctrlrange="-1 1"/><motor joint="motor"/></actuator>
<keyframe><key name="home" qpos="0.1 0.2 0 0.3 1 2 3 0.6 0 0.8 0"/></keyframe></mujoco>"""


def _same_model(one: pin.Model, other: pin.Model) -> None:
    assert list(one.names) == list(other.names)
    q = pin.randomConfiguration(one, np.full(one.nq, -1.0), np.full(one.nq, 1.0))
    for name in ("lowerPositionLimit", "upperPositionLimit", "damping", "armature", "upperDryFrictionLimit"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-12)
    datas = [model.createData() for model in (one, other)]
    for model, data in zip((one, other), datas, strict=True):
        pin.framesForwardKinematics(model, data, q)
    for frame in one.frames:
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME):
            places = [data.oMf[m.getFrameId(frame.name)] for m, data in zip((one, other), datas, strict=True)]
            np.testing.assert_allclose(places[0].translation, places[1].translation, atol=1e-13)
            if frame.type == pin.FrameType.BODY:  # the axes of a closure's frames may differ
                np.testing.assert_allclose(places[0].rotation, places[1].rotation, atol=1e-13)
    np.testing.assert_allclose(pin.crba(one, datas[0], q), pin.crba(other, datas[1], q), atol=1e-10)


@pytest.mark.parametrize("as_spec", [False, True])
def test_a_compiled_model_of_mujoco_is_that_of_its_file(tmp_path: Path, as_spec: bool) -> None:
    path = tmp_path / "leg.xml"
    path.write_text(LEG, encoding="utf-8")
    source = mujoco.MjSpec.from_file(str(path)) if as_spec else mujoco.MjModel.from_xml_path(str(path))
    found, expected = pm.load(source, tool_frame="sole"), pm.load(path, tool_frame="sole")
    _same_model(expected.model, found.model)
    assert found.name == "leg"
    for one, other in zip(found.couplings, expected.couplings, strict=True):
        assert (one.joint, one.joints) == (other.joint, other.joints)
        np.testing.assert_allclose([one.value([0.3])], [other.value([0.3])], rtol=1e-12)
    assert [loop.type for loop in found.closures] == ["3d"]
    q = pin.neutral(expected.model)
    errors = [robot.configuration(q).closure_error for robot in (found, expected)]
    np.testing.assert_allclose(errors[0], errors[1], atol=1e-12)
    assert found.actuated_joints == expected.actuated_joints == ("hip", "motor")
    assert [(d.gear, d.control_range, d.proportional_gain) for d in found.description.drives] == [
        (d.gear, d.control_range, d.proportional_gain) for d in expected.description.drives
    ]
    for name in ("home", "qpos0"):
        np.testing.assert_allclose(found.named_configurations[name], expected.named_configurations[name], atol=1e-14)


def test_the_effort_of_a_general_actuator_is_its_gain_times_its_control(tmp_path: Path) -> None:
    actuators = """<actuator>
      <general name="motor" joint="hip" gear="3" gainprm="20" ctrlrange="-2 2"/>
      <general name="least" joint="knee" gear="3" gainprm="20" ctrlrange="-2 2" forcerange="-30 30"/>
      <general name="servo" joint="toe" gainprm="7" biastype="affine" biasprm="0 -7 -2" ctrlrange="-1 1"/>
      <general name="scaled" joint="tip" gainprm="0.5" biastype="affine" biasprm="0 -7 -2" ctrlrange="-1 1"/>
    </actuator>"""
    joints = ("hip", "knee", "toe", "tip")
    body = "".join(f'<body><joint name="{name}"/><geom size="0.1"/>' for name in joints)
    path = tmp_path / "leg.xml"
    path.write_text(f"<mujoco><worldbody>{body}{'</body>' * 4}</worldbody>{actuators}</mujoco>", encoding="utf-8")
    reference = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(reference)
    data.ctrl[:2] = 2.0
    mujoco.mj_forward(reference, data)
    written = tmp_path / "written.xml"
    written.write_text(mjcf_text(read_robot(path)), encoding="utf-8")
    for source in (path, reference, written):
        robot = pm.load(source)
        drives = robot.description.drives
        assert [drive.kind for drive in drives] == ["motor", "motor", "position", "position"]
        assert [drive.proportional_gain for drive in drives] == [None, None, 7.0, 7.0]
        assert [drive.derivative_gain for drive in drives] == [None, None, 2.0, 2.0]
        efforts = drive_values(robot, "effort")
        np.testing.assert_allclose(efforts[:2], data.qfrc_actuator[:2], rtol=1e-15)
        assert np.isinf(efforts[2:]).all()
    again = mujoco.MjModel.from_xml_path(str(written))
    np.testing.assert_array_equal(again.actuator_gainprm[:, 0], reference.actuator_gainprm[:, 0])
    np.testing.assert_array_equal(again.actuator_biasprm[:, :3], reference.actuator_biasprm[:, :3])


@pytest.mark.parametrize("name", robot_names())
def test_a_model_of_pinocchio_is_described(name: str) -> None:
    model = pm.load(name).model
    _same_model(model, build_model(describe_model(model)))


def test_constraint_models_of_pinocchio_close_loops() -> None:
    delta = pm.load("linear_delta")
    model, anchors = delta.model.copy(), []
    for loop in delta.closures:
        ends = [model.frames[delta.frame_id(frame)] for frame in (loop.frame_a, loop.frame_b)]
        arguments = [part for end in ends for part in (end.parentJoint, end.placement)]
        anchors.append(pin.PointAnchorConstraintModel(model, *arguments))
    robot = pm.load(model, closures=[pin.ConstraintModel(anchors[0]), *anchors[1:]], tool_frame=delta.tool_frame)
    q = delta.assemble(joints={delta.actuated_joints[0]: delta.home.joint_position(delta.actuated_joints[0])}).q
    found, expected = (r.configuration(q).closure_error for r in (robot, delta))
    np.testing.assert_allclose(found, expected, atol=1e-15)
    with pytest.raises(InvalidValueError, match="closures"):
        pm.load(model, closures=["left"])
    with pytest.raises(InvalidValueError, match=r"closures are for a pinocchio\.Model"):
        pm.load("hexapod", closures=anchors)
    for source in (delta.description, mujoco.MjModel.from_xml_string(LEG)):
        with pytest.raises(InvalidValueError, match=r"closures are for a pinocchio\.Model"):
            pm.load(source, closures=anchors)


def test_a_module_of_robot_descriptions_names_a_file() -> None:
    module = types.ModuleType("hexapod_description")
    with pytest.raises(InvalidValueError, match="has no URDF_PATH or MJCF_PATH"):
        pm.load(module)
    module.URDF_PATH = str(find_robot("hexapod").urdf)  # type: ignore[attr-defined]
    assert pm.load(module).actuated_joints == pm.load("hexapod").actuated_joints


def test_a_robot_of_robot_descriptions_is_found_by_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In a package of the same form: the real one fetches its robots from the network."""
    package = tmp_path / "robot_descriptions"
    package.mkdir()
    (package / "__init__.py").touch()
    path = str(find_robot("hexapod").urdf)
    (package / "six_description.py").write_text(f"URDF_PATH = {path!r}\n", encoding="utf-8")
    (package / "far_description.py").write_text("raise OSError('no network')\n", encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "robot_descriptions", raising=False)
    assert pm.load("six_description").actuated_joints == pm.load("hexapod").actuated_joints
    with pytest.raises(DescriptionError, match="could not fetch it: no network"):
        pm.load("far_description")
    with pytest.raises(UnknownRobotError):
        pm.load("other_description")


_HINGE = """<joint name="{0}" type="revolute"><parent link="{1}"/><child link="{2}"/><origin xyz="{3}" rpy="{4}"/>
<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>"""
BARS = (
    '<robot name="bars"><link name="base"/><link name="crank"/><link name="coupler"/><link name="rocker"/>'
    + _HINGE.format("j1", "base", "crank", "0 0 0", "0 0 0.5")
    + _HINGE.format("j2", "crank", "coupler", "0 0.3 0", "0 0 0.4")
    + _HINGE.format("j3", "base", "rocker", "0.4 0 0", "0 0 0.2")
    + "</robot>"
)


@pytest.fixture
def bars(tmp_path: Path) -> Path:
    (tmp_path / "bars.urdf").write_text(BARS, encoding="utf-8")
    # scikit-robot gives point and axis in the root, with all joints at zero
    (tmp_path / "loop_closures.yaml").write_text(
        "closures:\n- {link_a: coupler, link_b: rocker, point: [0.2, 0.5, 0.0], axis: [0.0, 0.0, 2.0]}\n"
        "independent: [j1]\ndependent: [j2, j3]\nversion: 3\n",
        encoding="utf-8",
    )
    return tmp_path


def test_loops_of_scikit_robot(bars: Path) -> None:
    robot = Robot.load(bars / "bars.urdf")
    assert DegreesOfFreedom(robot.home).count == 1
    assert robot.actuated_joints == ("j1",)
    assert robot.home.closure_residual < 1e-15
    for frame in (robot.closures[0].frame_a, robot.closures[0].frame_b):
        np.testing.assert_allclose(robot.home.frame_placement(frame).translation, [0.2, 0.5, 0.0], atol=1e-15)
    assert [entry.element for entry in robot.description.unread] == ["version"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("link_a: coupler", "link_a: ghost", r"closures\[0\]\.link_a: expected an existing link, not 'ghost'"),
        ("0.0, 0.0, 2.0", "0.0, 0.0, 0.0", r"closures\[0\]\.axis: expected a direction"),
        ("point:", "pint:", r"closures\[0\]"),
        ("[0.2, 0.5, 0.0]", "[0.2, .nan, 0.0]", "point"),
        ("independent: [j1]", "independent: [j9]", "independent: no joint 'j9'"),
    ],
)
def test_damaged_loops_of_scikit_robot(bars: Path, old: str, new: str, said: str) -> None:
    path = bars / "loop_closures.yaml"
    path.write_text(path.read_text().replace(old, new), encoding="utf-8")
    with pytest.raises((DescriptionError, pm.PM3DofError), match=said):
        Robot.load(path)


def test_lenient_loading_lists_what_was_read_over(tmp_path: Path) -> None:
    path = tmp_path / "bars.urdf"
    path.write_text(BARS.replace("</robot>", '\n<jonit name="x"/></robot>'), encoding="utf-8")
    with pytest.raises(DescriptionError, match="<jonit name='x'>: is unknown"):
        pm.load(path)
    description = pm.load(path, lenient=True).description
    assert isinstance(description, Description)
    assert [str(entry.origin.line) for entry in description.unread] == ["5"]


@pytest.mark.parametrize("name", robot_names())
@pytest.mark.parametrize("dialect", ["mjcf/*.xml", "sdf/*.sdf", "drake/*.urdf"])
def test_every_dialect_of_a_robot_is_the_same_machine(name: str, dialect: str) -> None:
    """Loops, mobility, drives, mass and the placement of every body that both name, with the loops closed at home."""
    original = Robot.load(name)
    assert original.files is not None
    (path,) = original.files.path.parents[1].glob(dialect)
    robot = Robot.load(path)
    assert DegreesOfFreedom(robot.home).count == DegreesOfFreedom(original.home).count
    assert robot.home.closure_residual < 1e-12
    if not dialect.startswith("sdf"):  # which has no word for drives
        assert set(robot.actuated_joints) == set(original.actuated_joints)
    masses = [pin.computeTotalMass(each.model) for each in (robot, original)]
    assert masses[0] == pytest.approx(masses[1], abs=2e-3), "small masses stand for none there"
    shared = {b.name for b in robot.description.bodies} & {b.name for b in original.description.bodies}
    assert len(shared) > 6
    root = next(body for body in ("base", "world", robot.description.root.name) if body in shared)
    for body in sorted(shared):
        found, expected = (
            each.home.frame_placement(root).actInv(each.home.frame_placement(body)).translation
            for each in (robot, original)
        )
        np.testing.assert_allclose(found, expected, atol=1e-9)


WALKER = """<mujoco model="walker"><worldbody><body name="trunk"><freejoint name="float"/><geom size="0.1"/>
<body name="arm" pos="0.2 0 0"><joint name="hip" axis="0 0 1"/><geom size="0.1"/><site name="hand" pos="0.5 0 0"/>
</body></body></worldbody><actuator><motor joint="hip"/></actuator>
<keyframe><key name="home" qpos="1 2 3 0 0 0 1 0"/></keyframe></mujoco>"""


SLIDES = "".join(f'<joint name="{x}" type="slide" axis="{a}" ref="{r}"/>' for x, a, r in
                 (("x", "1 0 0", 0), ("y", "0 1 0", 0), ("z", "0 0 1", 0.5)))  # fmt: skip
"""A free base as some files have it: three slides, and a ball or three hinges, of one body."""


@pytest.mark.parametrize(
    ("turns", "numbers"),
    [
        ('<joint name="turn" type="ball"/>', "0 0 0 1"),
        (
            '<joint name="a" axis="1 0 0"/><joint name="b" axis="0 1 0"/><joint name="c" axis="0 0 1"/>',
            "0 0 3.14159265358979",
        ),
    ],
)
def test_a_base_on_slides_and_turns_floats_too(tmp_path: Path, turns: str, numbers: str) -> None:
    text = WALKER.replace('<freejoint name="float"/>', SLIDES + turns).replace(
        "1 2 3 0 0 0 1 0", f"1 2 3.5 {numbers} 0"
    )
    weld = '<equality><weld body1="trunk"/></equality><actuator>'  # without effect once the base is held
    path = tmp_path / "walker.xml"
    path.write_text(
        text.replace("<mujoco", '<mujoco><compiler angle="radian"/>', 1)
        .replace(
            '<mujoco><compiler angle="radian"/> model="walker">', '<mujoco model="walker"><compiler angle="radian"/>'
        )
        .replace("<actuator>", weld),
        encoding="utf-8",
    )
    held = pm.load(path, tool_frame="hand", drive_stiffness=100.0)
    assert held.model.nv == 1
    assert held.closures == ()
    np.testing.assert_allclose(held.home.tool_placement.translation, [1.0 - 0.7, 2.0, 3.0], atol=1e-12)
    driven = path.read_text(encoding="utf-8").replace("</actuator>", '<motor joint="x"/></actuator>')
    path.write_text(driven.replace('<equality><weld body1="trunk"/></equality>', ""), encoding="utf-8")
    assert pm.load(path, hold_base=True).model.nv > 1, "a base that is driven, as a gantry, is no floating one"


def test_a_planar_base_and_free_objects_float_but_no_platform(tmp_path: Path) -> None:
    """Two slides and a turn in their plane are a base; what closures join to other parts is none."""
    base = '<joint name="x" type="slide" axis="1 0 0"/><joint name="z" type="slide" axis="0 0 1"/>'
    planar = WALKER.replace('<freejoint name="float"/>', base + '<joint name="pitch" axis="0 1 0"/>')
    planar = planar.replace("1 2 3 0 0 0 1 0", "1 3 1.5707963267948966 0")
    cup = '<body name="cup" pos="0 0 1"><freejoint/><geom size="0.01"/></body></worldbody>'
    path = tmp_path / "walker.xml"
    path.write_text(planar.replace("</worldbody>", cup), "utf-8")
    robot = pm.load(path, tool_frame="hand", hold_base=True)
    assert robot.description.floating_base == ()
    assert robot.model.nv == 1
    np.testing.assert_allclose(robot.home.tool_placement.translation, [1.0, 0.0, 3.0 - 0.7], atol=1e-12)
    path.write_text(planar.replace('axis="0 1 0"', 'axis="0 0 1"'), "utf-8")
    assert pm.load(path, hold_base=True).model.nv == 4, "its turn is not in the plane of its slides"
    leg = '<body name="leg" pos="0.2 0 0"><joint axis="0 0 1"/><geom size="0.1"/></body></worldbody>'
    tied = '<equality><connect body1="{0}" body2="{1}" anchor="0.1 0 0"/></equality><actuator>'
    for ends in (("trunk", "leg"), ("arm", "world")):
        text = WALKER.replace("</worldbody>", leg).replace("<actuator>", tied.format(*ends)).split("<keyframe>")[0]
        path.write_text(text + "</mujoco>", "utf-8")
        assert len(pm.load(path).description.floating_base) == 0, f"{ends} belong to a platform"


def test_a_floating_base_is_held_for_a_stiffness(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A hinge of stiffness k bends the end of an arm of length L by L^2/k along y; home is turned by pi about z."""
    path = tmp_path / "walker.xml"
    path.write_text(WALKER, encoding="utf-8")
    assert DegreesOfFreedom(pm.load(path).home).count == 7
    robot = pm.load(path, tool_frame="hand", drive_stiffness=100.0)
    assert "its base 'trunk' floats" in caplog.text
    assert DegreesOfFreedom(robot.home).count == 1
    np.testing.assert_allclose(robot.home.tool_placement.translation, [1.0 - 0.7, 2.0, 3.0], atol=1e-12)
    expected = np.zeros((6, 6))
    expected[np.ix_([1, 5], [1, 5])] = np.outer([-0.5, 1.0], [-0.5, 1.0]) / 100.0
    np.testing.assert_allclose(pm.compliance(robot, robot.home), expected, atol=1e-15)
    floating = pm.load(path, tool_frame="hand", drive_stiffness=100.0, hold_base=False)
    with pytest.raises(FreeDirectionError, match="the base 'trunk' floats: hold it"):
        pm.compliance(floating, floating.home)
