"""All formats: the text as committed, from any robot, and the messages for invalid input."""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh
import yaml
import yourdfpy

from pm3dof_pin.description.robots import find_robot, robots_directory
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, OutputError, PM3DofError, UnknownRobotError
from pm3dof_pin.export.formats import FORMATS, export_robot, exported_files
from pm3dof_pin.export.robot_document import read_robot
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.robot import Robot

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

from generate_description import description_files, same_but_rounding

MACHINES = Path(__file__).parents[1] / "machines"
CONVENTION = ["closed_loop", "type", "name_mot", "joint_name", "joint_type"]


Run = Callable[..., Any]


@pytest.fixture
def run(run: Run) -> Run:
    return partial(run, "export")


@pytest.mark.parametrize("kind", FORMATS)
def test_an_export_is_the_committed_file(kind: str, robot: str, tmp_path: Path) -> None:
    for path in export_robot(robot, kind, tmp_path):
        if kind == "ros":
            committed = robots_directory() / path.relative_to(tmp_path)
        elif kind == "urdf":
            committed = next((robots_directory() / f"{robot}_description").glob(f"*rdf/{path.name}"))
        else:
            committed = robots_directory() / f"{robot}_description" / kind / path.name
        assert same_but_rounding(path.read_text(), committed.read_text())


def test_every_tree_loads_in_yourdfpy(robot: str) -> None:
    folder = robots_directory() / f"{robot}_description"
    plain = yourdfpy.URDF.load(str(find_robot(robot).urdf))
    frames = [frame for pair in Robot.load(robot).closures for frame in (pair.frame_a, pair.frame_b)]
    for path in (folder / "drake" / f"{robot}.urdf", folder / "gepetto" / "robot.urdf"):
        tree = yourdfpy.URDF.load(str(path))
        assert set(tree.link_map) - {"world"} == set(plain.link_map)
        for frame in frames:
            np.testing.assert_array_equal(tree.get_transform(frame, "base"), plain.get_transform(frame, "base"))


def test_gepetto_files_have_the_keys_of_the_convention_and_no_others(robot: str) -> None:
    folder = robots_directory() / f"{robot}_description" / "gepetto"
    content = yaml.safe_load((folder / "robot.yaml").read_text())
    assert list(content) == CONVENTION
    mechanism = Robot.load(robot)
    from_there = Robot.load(folder / "robot.urdf")
    assert from_there.actuated_joints == mechanism.actuated_joints
    assert [(loop.frame_a, loop.frame_b, loop.type) for loop in from_there.closures] == [
        (loop.frame_a, loop.frame_b, loop.type) for loop in mechanism.closures
    ]
    assert from_there.home.closure_residual < 1e-12


def test_a_joint_that_stands_for_another_is_written_as_what_it_is(four_bar: Path) -> None:
    """A spherical joint is three revolute joints through one point, in every format."""
    closures = four_bar.with_name("linkage.closures.yaml")
    closures.write_text(closures.read_text() + "joint_name: [rocker_joint]\njoint_type: [SPHERICAL]\n")
    files = exported_files(read_robot(four_bar), "gepetto")
    assert yaml.safe_load(files["robot.yaml"])["joint_name"] == []
    hinges = ElementTree.fromstring(files["robot.urdf"]).iterfind("joint[@type='revolute']")
    assert {"rocker_joint", "rocker_joint_y", "rocker_joint_z"} <= {joint.get("name") for joint in hinges}


@pytest.mark.parametrize("kind", ["mjcf", "urdf", "gepetto"])
def test_mjcf_with_a_ball_comes_back_as_the_same_mechanism(tmp_path: Path, kind: str) -> None:
    """A slider-crank with a ball at each end of its rod: one degree of freedom, and the spin of the rod."""
    body = '<geom size="0.02" mass="0.1"/>'
    (tmp_path / "crank.xml").write_text(
        '<mujoco model="crank"><worldbody><body name="crank"><joint name="motor" axis="0 1 0"/>'
        f'{body}<body name="rod" pos="0.1 0 0"><joint name="ball" type="ball"/>{body}</body></body>'
        f'<body name="slider" pos="0.5 0 0"><joint name="slide" type="slide" axis="1 0 0"/>{body}</body></worldbody>'
        '<equality><connect body1="rod" body2="slider" anchor="0.4 0 0"/></equality>'
        '<actuator><motor joint="motor"/></actuator></mujoco>'
    )
    first, *_ = export_robot(tmp_path / "crank.xml", kind, tmp_path / kind)
    for path in (tmp_path / "crank.xml", first):
        robot = Robot.load(path)
        bent = robot.assemble(robot.home, joints={"motor": 0.3})
        reach = 0.1 * np.cos(0.3) + np.sqrt(0.4**2 - (0.1 * np.sin(0.3)) ** 2)
        assert bent.frame_placement("slider").translation[0] == pytest.approx(reach, abs=1e-10)
        assert DegreesOfFreedom(bent).count == 2


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        (
            "drake",
            ["arm.obj", "arm_2.obj", "arm_3.obj", "arm_4.obj"],
        ),  # it reads no Collada, and no STL for collisions
        ("gepetto", ["arm.obj", "arm_2.obj", "arm.dae", "arm.stl"]),
        ("mjcf", ["arm.obj", "arm_2.obj", "arm_3.obj", "arm.stl"]),
        ("sdf", ["arm.obj", "arm_2.obj", "arm.dae", "arm.stl"]),
        ("urdf", ["arm.obj", "arm_2.obj", "arm.dae", "arm.stl"]),
    ],
)
def test_meshes_are_beside_the_files_that_name_them(
    four_bar: Path, tmp_path: Path, kind: str, expected: list[str]
) -> None:
    """In a file type that the tool reads, with the same triangles."""
    path, *others = export_robot(four_bar, kind, tmp_path)
    meshes = ElementTree.parse(path).iter("mesh")
    named = [name for mesh in meshes if (name := mesh.get("filename") or mesh.get("file") or mesh.findtext("uri"))]
    assert named == [f"meshes/{name}" for name in expected]
    assert {path.parent / name for name in named} <= set(others)
    original = trimesh.load_mesh(four_bar.parents[1] / "arm.obj").triangles
    for name in named:
        corners = trimesh.load_mesh(path.parent / name).triangles
        np.testing.assert_allclose(np.sort(corners, axis=None), np.sort(original, axis=None), rtol=0, atol=1e-9)


def test_a_fixed_joint_may_have_an_axis_of_zero_and_no_other(four_bar: Path) -> None:
    """SolidWorks' exporter writes it into every fixed joint."""
    text = four_bar.read_text()
    four_bar.write_text(text.replace('<origin xyz="0 0 0.1" rpy', '<axis xyz="0 0 0"/><origin xyz="0 0 0.1" rpy'))
    assert "tip_rocker_tip" in exported_files(read_robot(four_bar), "mjcf")["four_bar.xml"]
    four_bar.write_text(four_bar.read_text().replace('<axis xyz="0 -1 0"/>', '<axis xyz="0 0 0"/>', 1))
    with pytest.raises(PM3DofError, match=r"linkage\.urdf"):
        read_robot(four_bar)


@pytest.mark.parametrize("kind", ["urdf", "ros"])
def test_the_error_file_goes_along(four_bar: Path, tmp_path: Path, kind: str) -> None:
    four_bar.with_suffix(".errors.yaml").write_text("classes: {}\n")
    (written,) = [path for path in export_robot(four_bar, kind, tmp_path) if path.name == "four_bar.errors.yaml"]
    assert written.read_text() == "classes: {}\n"
    assert written.with_name("four_bar.urdf").is_file()


def test_an_exported_urdf_is_loaded_again(four_bar: Path, tmp_path: Path) -> None:
    export_robot(four_bar, "urdf", tmp_path)
    assert Robot.load(tmp_path / "four_bar.urdf").closures == Robot.load(four_bar).closures


def test_the_tool_may_be_named(four_bar: Path, tmp_path: Path) -> None:
    export_robot(four_bar, "urdf", tmp_path, tool_frame="rocker_tip")
    assert Robot.load(tmp_path / "four_bar.urdf").tool_frame == "rocker_tip"


def test_a_mesh_that_cannot_be_rewritten_is_named(four_bar: Path, tmp_path: Path) -> None:
    (four_bar.parent / "more" / "arm.dae").write_text("no mesh")
    with pytest.raises(DescriptionError, match=r"arm\.dae: mesh: expected a readable mesh"):
        export_robot(four_bar, "mjcf", tmp_path)


def test_a_missing_mesh_is_named(run: Run, four_bar: Path) -> None:
    (four_bar.parent / "more" / "arm.obj").unlink()
    with pytest.raises(DescriptionError, match=r"mesh 'more/arm\.obj': expected an existing file"):
        read_robot(four_bar)
    failed = run("mjcf", "--robot", str(four_bar), cwd=four_bar.parent)
    assert failed.returncode == 1
    assert "--no-meshes exports the robot without them" in failed.stderr


def test_shapes_that_are_not_read_are_named(four_bar: Path, caplog: pytest.LogCaptureFixture) -> None:
    four_bar.write_text(four_bar.read_text().replace("<mesh filename=", "<capsule filename="))
    read_robot(four_bar)
    assert "link 'crank': visual: unsupported capsule is ignored" in caplog.text


def test_bad_arguments_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidValueError, match="format = stl: expected one of drake, gepetto"):
        export_robot("pm3dof", "stl", tmp_path)
    with pytest.raises(UnknownRobotError):
        export_robot("nobody", "mjcf", tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="cannot write"):
        export_robot("pm3dof", "mjcf", tmp_path / "file")


def _without_mass(part: str, folder: Path) -> dict[str, str]:
    config = yaml.safe_load((robots_directory() / "pm3dof_description" / "config" / "pm3dof.yaml").read_text())
    config["inertia"][part]["value"] = 0.0
    (folder / "light.yaml").write_text(yaml.safe_dump(config))
    return description_files(config=folder / "light.yaml")


def test_a_machine_that_a_format_cannot_say_is_generated_without_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = _without_mass("link_mass", tmp_path)
    assert not [name for name in files if name.startswith(("mjcf", "sdf"))]
    assert "drake/pm3dof.urdf" in files
    assert "pm3dof: no mjcf: link 'link1': expected mass and inertia" in caplog.text


def test_crosses_without_mass_get_a_negligible_one_where_a_format_needs_it(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    files = _without_mass("cross_mass", tmp_path)
    cross = ElementTree.fromstring(files["mjcf/pm3dof.xml"]).find(".//body[@name='passive_cross']/inertial")
    assert cross is not None
    assert cross.get("mass") == "1e-05"
    mass = ElementTree.fromstring(files["sdf/pm3dof.sdf"]).find(".//link[@name='cross1']/inertial/mass")
    assert mass is not None
    assert float(mass.text) == 1e-5
    assert "1e-09 kg m^2 are assigned to the massless links passive_cross, cross1, cross2, cross3" in caplog.text


def test_ends_of_legs_without_mass_that_close_loops_get_a_negligible_one(caplog: pytest.LogCaptureFixture) -> None:
    mujoco = pytest.importorskip("mujoco")
    text = exported_files(read_robot(MACHINES / "agile_eye"), "mjcf")["agile_eye.xml"]
    assert "1e-05 kg and 1e-09 kg m^2 are assigned to the massless links tip1, tip2:" in caplog.text
    model = mujoco.MjModel.from_xml_string(text)
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert model.body("tip1").mass == pytest.approx(1e-5)
    assert model.neq == 2
    np.testing.assert_allclose(data.efc_pos[: data.ne], 0.0, atol=1e-12)


@pytest.mark.parametrize("limit", ["", '<limit lower="0" upper="0" effort="0" velocity="0"/>'])
def test_joints_without_limits_have_none_elsewhere(tmp_path: Path, limit: str) -> None:
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    joint = f'<joint name="elbow" type="revolute"><parent link="a"/><child link="b"/>{limit}</joint>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="arm"><link name="a"/><link name="b">{inertial}</link>{joint}</robot>'
    )
    robot = read_robot(tmp_path / "arm.urdf")
    elbow = ElementTree.fromstring(exported_files(robot, "mjcf")["arm.xml"]).find(".//joint[@name='elbow']")
    assert elbow is not None
    assert "range" not in elbow.attrib
    axis = ElementTree.fromstring(exported_files(robot, "sdf")["arm.sdf"]).find(".//joint[@name='elbow']/axis/limit")
    assert axis is None or not list(axis)
    drake = ElementTree.fromstring(exported_files(robot, "drake")["arm.urdf"]).find("joint[@name='elbow']/limit")
    assert drake is None or not drake.attrib  # a drive with effort 0 is no drive there


# The command


def test_the_command_knows_all_formats(run: Run) -> None:
    usage = run("stl").stderr
    assert all(f"'{name}'" in usage for name in FORMATS)


def test_the_command_writes_and_says_what(run: Run, four_bar: Path, tmp_path: Path) -> None:
    done = run("mjcf", "--robot", str(four_bar), "--out", "a/b", cwd=tmp_path)
    assert done.returncode == 0
    assert done.stdout == ""
    written = [line.removeprefix("wrote ") for line in done.stderr.splitlines() if line.startswith("wrote ")]
    assert written == [
        "a/b/four_bar.xml",
        "a/b/meshes/arm.obj",
        "a/b/meshes/arm_2.obj",
        "a/b/meshes/arm_3.obj",
        "a/b/meshes/arm.stl",
    ]
    assert all((tmp_path / path).is_file() for path in written)


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (["stl"], 2, "'stl' is not one of"),
        ([], 2, "Missing argument"),
        (["mjcf", "--robot", "nobody"], 1, "no robot 'nobody'"),
        (["mjcf", "--out", "file"], 1, "cannot write file/pm3dof.xml"),
    ],
)
def test_the_command_refuses_bad_input(run: Run, arguments: list[str], status: int, said: str, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    done = run(*arguments, cwd=tmp_path)
    assert done.returncode == status
    assert said in done.stderr
    assert "Traceback" not in done.stderr


def test_meshes_can_be_left_out(tmp_path: Path) -> None:
    """Mesh shapes are omitted, others are kept; the tree is the same."""
    inertial = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    mesh = '<visual><geometry><mesh filename="package://nowhere/arm.stl"/></geometry></visual>'
    box = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
    (tmp_path / "arm.urdf").write_text(
        f'<robot name="arm"><link name="base"/><link name="arm">{inertial}{mesh}{box}</link><joint name="hinge" '
        'type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 0 1"/>'
        '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>'
    )
    with pytest.raises(DescriptionError, match=r"arm\.stl"):
        export_robot(tmp_path / "arm.urdf", "urdf", tmp_path / "with")
    for format_name in FORMATS:
        folder = tmp_path / format_name
        files = export_robot(tmp_path / "arm.urdf", format_name, folder, meshes=False)
        assert files
        assert not any("arm.stl" in file.read_text() for file in files)
    assert "<box" in (tmp_path / "urdf" / "arm.urdf").read_text()
