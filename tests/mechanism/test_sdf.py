"""SDF files: places as Drake has them, and loops whose mobility is counted by hand."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.readers.sdf import read_sdf
from pm3dof_pin.description.robots import robot_names
from pm3dof_pin.description.xml_file import read_xml
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.formats import export_robot
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.model import build_model

_INERTIAL = (
    "<inertial><pose>0.1 0.2 0.3 0.1 0 0</pose><mass>2</mass><inertia><ixx>0.2</ixx><iyy>0.3</iyy><izz>0.4</izz>"
    "</inertia></inertial>"
)
CHAIN = f"""<sdf version="1.9"><model name="chain"><link name="base"><pose>0 0 1 0 0 0.3</pose>{_INERTIAL}</link>
<frame name="mark" attached_to="base"><pose degrees="true">0.1 0 0 30 0 0</pose></frame>
<link name="a"><pose relative_to="mark">0 0.4 0 0.2 0 0</pose>{_INERTIAL}</link>
<link name="b"><pose relative_to="a" rotation_format="quat_xyzw">0.3 0 0.1 0 0.6 0 0.8</pose>{_INERTIAL}</link>
<link name="c"><pose relative_to="j_b">0 0 0.5 0 0 0</pose>{_INERTIAL}</link>
<joint name="j_a" type="revolute"><parent>base</parent><child>a</child><pose>0 -0.1 0 0 0.1 0</pose>
 <axis><xyz expressed_in="__model__">0 0.6 0.8</xyz><limit><lower>-1</lower><upper>2</upper><effort>3</effort></limit>
 <dynamics><damping>0.5</damping><friction>0.25</friction></dynamics></axis></joint>
<joint name="j_b" type="prismatic"><parent>mark</parent><child>b</child><pose relative_to="b">0 0 0.2 0 0 0</pose>
 <axis><xyz>0 0 1</xyz></axis></joint>
<joint name="j_c" type="universal"><parent>b</parent><child>c</child><axis><xyz>1 0 0</xyz></axis>
 <axis2><xyz>0 1 0</xyz></axis2></joint></model></sdf>"""

_LINKS = "".join(
    f'<link name="{name}"><pose>{pose}</pose></link>'
    for name, pose in (
        ("ground", "0 0 0 0 0 0"),
        ("crank", "0 0 0 0 0 0"),
        ("coupler", "0 0.3 0 0 0 0"),
        ("rocker", "0.4 0 0 0 0 0"),
    )
)


def _hinge(name: str, parent: str, child: str, pose: str = "", kind: str = "revolute") -> str:
    return (
        f'\n<joint name="{name}" type="{kind}"><parent>{parent}</parent><child>{child}</child>{pose}'
        "<axis><xyz>0 0 1</xyz></axis></joint>"
    )


FOUR_BAR = (
    f'<sdf version="1.8"><model name="bars">{_LINKS}'
    + '\n<joint name="anchor" type="fixed"><parent>world</parent><child>ground</child></joint>'
    + _hinge("j1", "ground", "crank")
    + _hinge("j2", "crank", "coupler")
    + _hinge("j3", "ground", "rocker")
    + _hinge("j4", "rocker", "coupler", "<pose>0.4 0 0 0 0 0</pose>")
    + "</model></sdf>"
)


def _written(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "model.sdf"
    path.write_text(text, encoding="utf-8")
    return path


def test_places_and_inertias_are_drakes(tmp_path: Path) -> None:
    parsing = pytest.importorskip("pydrake.multibody.parsing")
    plant_module = pytest.importorskip("pydrake.multibody.plant")
    path = _written(tmp_path, CHAIN)
    plant = plant_module.MultibodyPlant(1e-3)
    parsing.Parser(plant).AddModels(str(path))
    plant.WeldFrames(plant.world_frame(), plant.GetFrameByName("base"))
    plant.Finalize()
    context = plant.CreateDefaultContext()
    model = build_model(read_sdf(read_xml(path)))
    data = model.createData()
    values = {"j_a": [0.3], "j_b": [-0.2], "j_c": [0.4, -0.5]}
    q = np.zeros(model.nq)
    for name, numbers in values.items():
        joint = plant.GetJointByName(name)
        plant.SetPositions(context, _with(plant.GetPositions(context), joint.position_start(), numbers))
    for name, value in (("j_a", 0.3), ("j_b", -0.2), ("j_c_x", 0.4), ("j_c_y", -0.5)):
        q[model.joints[model.getJointId(name)].idx_q] = value
    pin.framesForwardKinematics(model, data, q)
    for name in ("a", "b", "c", "mark"):
        found = data.oMf[model.getFrameId(name)]
        expected = plant.GetFrameByName(name).CalcPoseInWorld(context)
        np.testing.assert_allclose(found.homogeneous, expected.GetAsMatrix4(), atol=1e-14)
    masses = plant.CalcMassMatrix(context)
    order = [
        plant.GetJointByName(name).velocity_start() + k for name, k in (("j_a", 0), ("j_b", 0), ("j_c", 0), ("j_c", 1))
    ]
    computed = pin.crba(model, data, q)
    names = ("j_a", "j_b", "j_c_x", "j_c_y")
    own = [model.joints[model.getJointId(name)].idx_v for name in names]
    computed = np.triu(computed) + np.triu(computed, 1).T
    np.testing.assert_allclose(computed[np.ix_(own, own)], masses[np.ix_(order, order)], atol=1e-13)
    assert (model.lowerPositionLimit[own[0]], model.upperEffortLimit[own[0]], model.damping[own[0]]) == (-1.0, 3.0, 0.5)


def _with(positions: np.ndarray, start: int, numbers: list[float]) -> np.ndarray:
    positions = np.array(positions)
    positions[start : start + len(numbers)] = numbers
    return positions


@pytest.mark.parametrize("kind", ["revolute", "ball", "continuous", "universal"])
def test_a_four_bar_is_cut_once_and_closed(tmp_path: Path, kind: str) -> None:
    text = FOUR_BAR.replace('name="j2" type="revolute"', f'name="j2" type="{kind}"')
    if kind == "universal":  # a second axis across the first
        text = text.replace(
            '</axis></joint>\n<joint name="j3"', '</axis><axis2><xyz>1 0 0</xyz></axis2></joint>\n<joint name="j3"'
        )
    path = _written(tmp_path, text)
    robot = Robot.load(path)
    assert robot.description is not None
    cut = "j2" if kind in ("ball", "universal") else "j4"
    assert [str(entry.origin.line) for entry in robot.description.unread] == [
        str(3 + ["j1", "j2", "j3", "j4"].index(cut))
    ]
    assert f"<joint name='{cut}'>: closes a loop: cut" in str(robot.description.unread[0])
    assert [loop.type for loop in robot.closures] == [{"ball": "3d", "universal": "universal"}.get(kind, "hinge")]
    assert robot.home.closure_residual < 1e-15
    assert DegreesOfFreedom(robot.home).count == 1
    found = robot.assemble(joints={"j1": 0.5})
    joints = dict(zip(robot.q_names, found.q, strict=True))
    assert joints["j3"] == pytest.approx(0.5, abs=1e-9), "the rods form a parallelogram"


def test_a_joint_against_the_tree_keeps_its_coordinate(tmp_path: Path) -> None:
    text = FOUR_BAR.replace(
        "<parent>ground</parent><child>rocker</child>", "<parent>rocker</parent><child>ground</child>"
    )
    robot = Robot.load(_written(tmp_path, text.replace('name="j4" type="revolute"', 'name="j4" type="ball"')))
    found = dict(zip(robot.q_names, robot.assemble(joints={"j1": 0.5}).q, strict=True))
    assert found["j3"] == pytest.approx(-0.5, abs=1e-9)
    closing = _hinge("j4", "rocker", "coupler", "<pose>0.4 0 0 0 0 0</pose>", "ball")
    unused = closing.replace("</axis>", f"{2 * '<use_parent_model_frame>0</use_parent_model_frame>'}</axis>")
    text = FOUR_BAR.replace(_hinge("j4", "rocker", "coupler", "<pose>0.4 0 0 0 0 0</pose>"), unused)
    assert Robot.load(_written(tmp_path, text)).closures, "a ball has no axis"


def test_controllers_say_what_drives_a_loop(tmp_path: Path) -> None:
    plugin = (
        '<plugin name="gz::sim::systems::JointPositionController" filename="x"><joint_name>j4</joint_name></plugin>'
    )
    robot = Robot.load(_written(tmp_path, FOUR_BAR.replace("</model>", f"{plugin}</model>")))
    assert robot.actuated_joints == ("j4",)
    assert robot.description is not None
    assert "j3" in str(robot.description.unread[0]), "driven joints are not cut"
    both = "<joint_name>j1</joint_name><joint_name>j4</joint_name></plugin></model>"
    moved = '<plugin name="gz::sim::systems::JointTrajectoryController" filename="x">'
    robot = Robot.load(_written(tmp_path, FOUR_BAR.replace("</model>", f"{moved}{both}")))
    assert robot.actuated_joints == ("j1", "j4"), "a plugin names any number of joints"
    for watching in ("gz::sim::systems::JointStatePublisher", "joint_state_publisher", "gazebo_ros_ft_sensor"):
        watched = f'{plugin}<plugin name="{watching}" filename="x">{both}'
        robot = Robot.load(_written(tmp_path, FOUR_BAR.replace("</model>", watched)))
        assert robot.actuated_joints == ("j4",), "a plugin that publishes joints moves none"


def test_a_joint_that_mimics_follows(tmp_path: Path) -> None:
    mimic = '<mimic joint="j1"><multiplier>-2</multiplier><offset>0.1</offset><reference>0.2</reference></mimic>'
    text = FOUR_BAR.replace(_hinge("j4", "rocker", "coupler", "<pose>0.4 0 0 0 0 0</pose>"), "")
    text = text.replace(
        _hinge("j3", "ground", "rocker"), _hinge("j3", "ground", "rocker").replace("</axis>", f"{mimic}</axis>")
    )
    (coupling,) = Robot.load(_written(tmp_path, text)).couplings
    assert coupling.value([0.5]) == pytest.approx(-2.0 * (0.5 - 0.2) + 0.1, abs=1e-15)


@pytest.mark.parametrize("name", robot_names())
def test_our_own_exports_come_back(tmp_path: Path, name: str) -> None:
    (path,) = [file for file in export_robot(name, "sdf", tmp_path, meshes=False) if file.suffix == ".sdf"]
    robot, original = Robot.load(path), Robot.load(name)
    assert DegreesOfFreedom(robot.home).count == DegreesOfFreedom(original.home).count
    assert robot.home.closure_residual < 1e-12


@pytest.mark.skipif(shutil.which("ign") is None, reason="sdformat's command is not installed")
@pytest.mark.parametrize("text", [CHAIN, FOUR_BAR], ids=["chain", "four-bar"])
def test_these_files_are_valid(tmp_path: Path, text: str) -> None:
    done = subprocess.run(
        ["ign", "sdf", "--check", str(_written(tmp_path, text))], capture_output=True, text=True, check=False
    )
    assert "Valid" in done.stdout, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("<parent>ground</parent>", "<parent>ghost</parent>", r"line 3: <joint name='j1'>: expected an existing frame"),
        ('type="revolute"', 'type="glue"', r"line 3: joint 'j1': expected one of fixed, .*not 'glue'"),
        ("<xyz>0 0 1</xyz>", "<xyz>0 0 0</xyz>", "expected a direction"),
        ("0 0.3 0 0 0 0", "0 0.3 0 0 0", "expected 6 numbers"),
        ("0 0.3 0 0 0 0", "0 0.3 nan 0 0 0", "not 'nan'"),
        ("0 0.3 0 0 0 0", "0 0.3 1e30 0 0 0", "pose: expected at most 10000 m"),
        ("<xyz>0 0 1</xyz>", "<xyz>0 0 1</xyz><xyz>0 1 0</xyz>", "<xyz>: stands 2 times in one element"),
        ('link name="crank"', 'link name="ground"', "defined twice"),
        (
            "</model>",
            "<include><uri>model://x</uri></include></model>",
            "<include>: expected a model in or next to the file.*lenient",
        ),
        ("</model>", "<jonit/></model>", "<jonit>: is unknown in <model>, expected <joint>.*lenient"),
        ("</model>", '<link name="lost"/></model>', "no joint connects 'lost' to 'world'"),
    ],
)
def test_a_damaged_file_is_one_error(tmp_path: Path, old: str, new: str, said: str) -> None:
    with pytest.raises(DescriptionError, match=said):
        Robot.load(_written(tmp_path, FOUR_BAR.replace(old, new, 1)))


@pytest.mark.parametrize("none", ["-inf", "-1.79769e+308", "-1e16"])
def test_infinite_limits_are_none(tmp_path: Path, none: str) -> None:
    limit = f"<limit><lower>{none}</lower><upper>{none[1:]}</upper><effort>inf</effort></limit>"
    text = CHAIN.replace("<xyz>0 0 1</xyz>", f"<xyz>0 0 1</xyz>{limit}")
    joint = Robot.load(_written(tmp_path, text)).description.joint("j_b")
    assert (joint.lower, joint.upper, joint.effort) == (None, None, None)


def test_a_joint_of_links_that_do_not_move_to_each_other_closes_nothing(tmp_path: Path) -> None:
    twice = '<link name="lid"/>' + "".join(
        f'<joint name="{name}" type="fixed"><parent>ground</parent><child>lid</child></joint>' for name in "ab"
    )
    robot = Robot.load(_written(tmp_path, FOUR_BAR.replace("</model>", f"{twice}</model>")))
    assert len(robot.closures) == 1
    assert any("do not move to each other" in entry.reason for entry in robot.description.unread)


def test_models_of_a_world_are_one_robot(tmp_path: Path) -> None:
    """Each is held at its first link unless a joint holds it; the names are those that SDF gives nested models."""
    model = FOUR_BAR.partition('<sdf version="1.8">')[2].removesuffix("</sdf>")
    loose = CHAIN.partition('<sdf version="1.9">')[2].removesuffix("</sdf>").replace('name="chain">', "{}", 1)
    moved = loose.format('name="chain"><pose>1 2 3 0 0 0.5</pose>')
    ground = '<model name="ground_plane"><static>true</static><link name="l"/></model>'
    plugin = '<plugin name="p" filename="f"><joint_name>j1</joint_name></plugin></model>'
    text = f'<sdf version="1.9"><world name="hall">{ground}{model.replace("</model>", plugin)}{moved}</world></sdf>'
    robot = Robot.load(_written(tmp_path, text))
    assert [loop.frame_a for loop in robot.closures] == ["bars::j4_parent"]
    assert robot.actuated_joints == ("bars::j1",)
    assert DegreesOfFreedom(robot.home).count == 1 + 4
    assert robot.home.closure_residual < 1e-12
    alone = Robot.load(_written(tmp_path, CHAIN))
    placed = pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, 0.5), np.array([1.0, 2.0, 3.0])) * pin.SE3(
        pin.rpy.rpyToMatrix(0.0, 0.0, 0.3), np.array([0.0, 0.0, 1.0])
    )  # of the model in the world, and of its first link, the root of the other, in the model
    expected = placed * alone.home.frame_placement("c")
    assert robot.home.frame_placement("chain::c").isApprox(expected, 1e-12)


def test_gearboxes_and_drakes_constraints_are_read(tmp_path: Path) -> None:
    """The gearbox has theta_2 = -ratio theta_1 of the links about its axes (sdformat)."""
    gear = (
        '<joint name="g" type="gearbox"><parent>crank</parent><child>rocker</child><gearbox_reference_body>ground'
        "</gearbox_reference_body><gearbox_ratio>-3</gearbox_ratio><axis><xyz>0 0 1</xyz></axis></joint></model>"
    )
    ball = (
        "<drake:ball_constraint><drake:ball_constraint_body_A>coupler</drake:ball_constraint_body_A>"
        "<drake:ball_constraint_body_B>rocker</drake:ball_constraint_body_B><drake:ball_constraint_p_AP>0.4 0 0"
        "</drake:ball_constraint_p_AP><drake:ball_constraint_p_BQ>0 0.3 0</drake:ball_constraint_p_BQ>"
        "</drake:ball_constraint></model>"
    )
    start = FOUR_BAR.index('\n<joint name="j4"')
    open_chain = FOUR_BAR[:start] + FOUR_BAR[FOUR_BAR.index("</joint>", start) + len("</joint>") :]
    geared = Robot.load(_written(tmp_path, open_chain.replace("</model>", gear)))
    (coupling,) = geared.couplings
    assert (coupling.joint, coupling.joints, coupling.coefficients) == ("j3", ("j1",), ((3.0,),))
    closed = Robot.load(_written(tmp_path, open_chain.replace("</model>", ball)))
    assert [loop.type for loop in closed.closures] == ["3d"]
    assert closed.home.closure_residual < 1e-12
    assert DegreesOfFreedom(closed.home).count == 1


ARM = """<sdf version="1.9"><model name="arm"><pose>9 9 9 0 0 0</pose><link name="upper"/>
<link name="fore"><pose>0.5 0 0 0 0 0</pose></link><joint name="elbow" type="revolute"><parent>upper</parent>
<child>fore</child><axis><xyz>0 0 1</xyz><limit><effort/></limit><dynamics><damping/></dynamics></axis></joint>
</model></sdf>"""
CELL = """<sdf version="1.9"><world name="w"><include><uri>model://sun</uri></include>
<include><uri>model://ground</uri></include><model name="cell"><link name="base"/>
<include><uri>model://arm</uri><name>left</name><pose>0 1 0 0 0 1.5707963267948966</pose></include>
<joint name="mount" type="fixed"><parent>base</parent><child>left::__model__</child></joint></model></world></sdf>"""


@pytest.fixture
def model_folders(tmp_path: Path) -> Path:
    """A folder of models, each with its model.config; return the file of a cell that includes another."""
    for name, text in {"arm": ARM, "ground": ARM.replace("<pose>", "<static>true</static><pose>", 1)}.items():
        (tmp_path / name).mkdir()
        (tmp_path / name / "arm.sdf").write_text(text, encoding="utf-8")
        config = "<model><sdf version='1.6'>old.sdf</sdf><sdf version='1.10'>arm.sdf</sdf></model>"
        (tmp_path / name / "model.config").write_text(config, encoding="utf-8")
    (tmp_path / "cell").mkdir()
    path = tmp_path / "cell" / "cell.sdf"
    path.write_text(CELL, encoding="utf-8")
    return path


def test_models_are_included_from_folders_next_to_the_file(model_folders: Path) -> None:
    """The include places the arm a metre to the left, turned by 90 degrees, instead of where its own file does."""
    description = Robot.load(model_folders).description
    assert [joint.name for joint in description.joints] == ["mount", "left::elbow"]
    np.testing.assert_allclose(description.zero_placements["left::fore"].translation, [0.0, 1.5, 0.0], atol=1e-12)
    assert "sun" in next(str(part) for part in description.unread if "<include>" in part.element)
    assert any("beside the robot" in part.reason for part in description.unread)
    elbow = description.joint("left::elbow")
    assert (elbow.effort, elbow.damping) == (None, 0.0)


def test_of_several_models_that_are_missing_the_robot_is_named(model_folders: Path) -> None:
    """Worlds of Gazebo include the sun and the ground before their robot, which may be in another folder."""
    world = "<include><uri>model://sun</uri></include><include><uri>model://there</uri></include>"
    model_folders.write_text(f"<sdf version='1.6'><world name='w'>{world}</world></sdf>", encoding="utf-8")
    with pytest.raises(DescriptionError, match="--package-path, not 'model://there'"):
        Robot.load(model_folders)
    text = f"<sdf version='1.6'><world name='w'>{world.replace('there', 'arm')}</world></sdf>"
    model_folders.write_text(text, encoding="utf-8")
    assert Robot.load(model_folders).actuated_joints == ("elbow",), "what is missing beside it is read over"


def test_merged_models_have_the_names_of_the_model_around_them(model_folders: Path) -> None:
    """The include turns the arm by 90 degrees about z: its x axis, here the elbow's, is y of the cell."""
    arm = ARM.replace("<xyz>0 0 1</xyz>", "<xyz expressed_in='__model__'>1 0 0</xyz>")
    arm = arm.replace("</model>", "<frame name='tool'><pose>1 0 0 0 0 0</pose></frame></model>")
    (model_folders.parents[1] / "arm" / "arm.sdf").write_text(arm, encoding="utf-8")
    text = CELL.replace("<include><uri>model://arm", '<include merge="true"><uri>model://arm')
    model_folders.write_text(text.replace("left::__model__", "upper"), encoding="utf-8")
    robot = Robot.load(model_folders)
    assert [joint.name for joint in robot.description.joints if not joint.is_fixed] == ["elbow"]
    turned = robot.configuration([0.3])
    expected = pin.utils.rotate("y", 0.3) @ pin.utils.rotate("z", 0.5 * np.pi)
    np.testing.assert_allclose(turned.frame_placement("fore").rotation, expected, atol=1e-12)
    np.testing.assert_allclose(turned.frame_placement("fore").translation, [0.0, 1.5, 0.0], atol=1e-12)
    np.testing.assert_allclose(turned.frame_placement("tool").translation, [0.0, 2.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("model://arm", "model://../arm", "line 3: <include>: expected a model"),
        ("model://arm", "../../outside.sdf", "line 3: <include>: is .*outside.sdf, expected a file in"),
        ("model://arm", "https://fuel/arm", "line 3: <include>: expected a model"),
        ("<include><uri>model://arm", '<include merge="true"><uri>model://cell', "line 3: <include>: .*with merge"),
        ("<name>left", "<placement_frame>x</placement_frame><name>left", "<include>: .*with <placement_frame>"),
        ("model://arm", "model://cell", "nested more than 20 deep"),
        ('<link name="base"/>', '<link name="base"/><model name="x" placement_frame="y"/>', "'x'.*placement_frame"),
    ],
)
def test_what_cannot_be_included_is_refused_by_line(model_folders: Path, old: str, new: str, message: str) -> None:
    outside = model_folders.parents[2] / "outside.sdf"
    outside.write_text(ARM, encoding="utf-8")
    (model_folders.parent / "model.config").write_text("<model><sdf>own.sdf</sdf></model>", encoding="utf-8")
    own = "<sdf><model name='m'><include><uri>model://cell</uri></include></model></sdf>"
    (model_folders.parent / "own.sdf").write_text(own, encoding="utf-8")
    assert CELL.count(old) == 1
    model_folders.write_text(CELL.replace(old, new), encoding="utf-8")
    with pytest.raises(DescriptionError, match=message):
        Robot.load(model_folders)
    outside.unlink()


def test_a_screw_has_its_limits(tmp_path: Path) -> None:
    path = tmp_path / "screw.sdf"
    screw = _hinge("screw", "base", "nut", kind="screw").replace("</axis>", "<limit><lower>-1</lower></limit></axis>")
    text = f'<sdf version="1.8"><model name="m"><link name="base"/><link name="nut"/>{screw}</model></sdf>'
    path.write_text(text, encoding="utf-8")
    robot = Robot.load(path)
    np.testing.assert_array_equal(robot.lower_limits, [-1.0])
    np.testing.assert_array_equal(robot.upper_limits, [np.inf])


def test_a_models_own_frame_is_that_of_its_first_link(tmp_path: Path) -> None:
    """Joints may have __model__ as an end, and frames of nested models without links carry nothing."""
    joint = '<joint name="j" type="revolute"><parent>{}</parent><child>{}</child><axis><xyz>0 0 1</xyz></axis></joint>'
    for ends in (("__model__", "a"), ("a", "__model__")):
        text = f"""<sdf version="1.9"><model name="m"><link name="base"/><link name="a"><pose>1 0 0 0 0 0</pose></link>
        {joint.format(*ends)}<model name="empty"><frame name="mark"/></model></model></sdf>"""
        robot = Robot.load(_written(tmp_path, text))
        assert (robot.model.nv, set(robot.description.body_by_name)) == (1, {"base", "a"})


def test_a_fixed_joint_that_closes_a_loop_is_cut_before_a_hinge(tmp_path: Path) -> None:
    """So that limits, drives and springs of hinges stay."""
    text = FOUR_BAR.replace(
        '<link name="rocker">', '<link name="tip"><pose>0.4 0.3 0 0 0 0</pose></link><link name="rocker">'
    )
    fixed = '<joint name="welded" type="fixed"><parent>tip</parent><child>rocker</child></joint>'
    found = text.rpartition("<joint")
    last = found[2].partition("</joint>")
    hinge = _hinge("tip_hinge", "coupler", "tip")
    robot = Robot.load(_written(tmp_path, f"{found[0]}{fixed}{hinge}{last[2]}"))
    assert [loop.type for loop in robot.closures] == ["6d"]
    assert robot.model.nv == 4
    assert DegreesOfFreedom(robot.home).count == 1
