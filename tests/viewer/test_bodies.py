"""Drawings of a mechanism: shapes, meshes, colours, stick figures, boxes around them."""

from __future__ import annotations

import base64
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.bodies import Bodies
from pm3dof_pin.viewer.viewer import Viewer

URDF = """<robot name="robot">
  <link name="base">
    <visual><origin xyz="0 0 1"/><geometry><box size="0.2 0.4 0.6"/></geometry>
      <material name="red"><color rgba="0.8 0.1 0.2 0.5"/></material></visual>
    <visual><geometry><sphere radius="0.1"/></geometry></visual>
  </link>
  <joint name="turn" type="revolute"><parent link="base"/><child link="arm"/><origin xyz="0 0 2"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="arm"><visual><origin xyz="0.5 0 0" rpy="0 1.5707963267948966 0"/>
    <geometry><cylinder radius="0.05" length="1"/></geometry></visual>{mesh}</link>
</robot>
"""
MESH = '<visual><origin xyz="1 0 0"/><geometry><mesh filename="{file}" scale="2 2 2"/></geometry></visual>'
Write = Callable[..., Path]


def test_shapes(write_robot: Write) -> None:
    mechanism = Robot.load(write_robot(URDF.format(mesh="")))
    base, arm = Bodies.from_mechanism(mechanism)
    box, ball = base.parts
    (rod,) = arm.parts
    shape = box.scene_object["geometries"][0]
    assert [shape[key] for key in ("type", "width", "height", "depth")] == ["BoxGeometry", 0.2, 0.4, 0.6]
    np.testing.assert_allclose(box.placement[:3, 3], [0.0, 0.0, 1.0])
    np.testing.assert_allclose(box.colour, [0.8, 0.1, 0.2, 0.5], atol=1e-6)
    assert box.scene_object["materials"][0]["transparent"] is True
    assert ball.scene_object["geometries"][0]["radius"] == 0.1
    shape = rod.scene_object["geometries"][0]
    assert (shape["type"], shape["radiusBottom"], shape["height"]) == ("CylinderGeometry", 0.05, 1.0)
    # three.js has cylinders along y; the URDF's z axis is rotated to x here
    np.testing.assert_allclose(rod.placement[:3, :3] @ [0.0, 1.0, 0.0], [1.0, 0.0, 0.0], atol=1e-12)


def test_placements_are_those_of_the_links(mechanism: Robot) -> None:
    where = mechanism.solve([0.2, -0.1, 0.5]).configuration()
    placements = Bodies.from_mechanism(mechanism).placements(where)
    assert len(placements) == 14
    for path, placement in placements.items():
        expected = where.frame_placement(path.removeprefix("/robot/")).homogeneous
        np.testing.assert_allclose(placement, expected, atol=1e-14)


def test_the_box_around_a_mechanism(write_robot: Write) -> None:
    """Upright, the arm of length 1 reaches from z = 2 down to 1, or up to 3."""
    mechanism = Robot.load(write_robot(URDF.format(mesh="")))
    bodies = Bodies.from_mechanism(mechanism)
    np.testing.assert_allclose(
        bodies.box(mechanism.configuration([0.0])), [[-0.1, -0.2, -0.1], [1.0, 0.2, 2.05]], atol=1e-9
    )
    np.testing.assert_allclose(
        bodies.box(mechanism.configuration([-np.pi / 2])), [[-0.1, -0.2, -0.1], [0.1, 0.2, 3.0]], atol=1e-9
    )


@pytest.mark.parametrize("suffix", ["stl", "obj", "dae"])
def test_meshes_have_their_scale(write_robot: Write, tmp_path: Path, suffix: str) -> None:
    file = tmp_path / f"part.{suffix}"
    trimesh.creation.box([0.1, 0.2, 0.3]).export(file)
    mechanism = Robot.load(write_robot(URDF.format(mesh=MESH.format(file=file))))
    arm = Bodies.from_mechanism(mechanism)[1]
    corners = arm.parts[-1].corners
    np.testing.assert_allclose(corners.min(axis=0), [0.9, -0.2, -0.3], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [1.1, 0.2, 0.3], atol=1e-6)


def test_fine_meshes_are_drawn_with_fewer_triangles(write_robot: Write, tmp_path: Path) -> None:
    """A ball of 81,920 triangles: fewer are drawn, invisibly close to the ball, and the page stays small."""
    trimesh.creation.icosphere(subdivisions=6, radius=0.5).export(tmp_path / "ball.stl")
    robot = Robot.load(write_robot(URDF.format(mesh=MESH.format(file=tmp_path / "ball.stl"))))
    page = Viewer(robot).save_html(tmp_path / "ball.html")
    assert page.stat().st_size < 1.5e6
    arrays = re.findall(r'"typed_array": ?"Float32Array", ?"base64": ?"([^"]*)"', page.read_text())
    ball = max((np.frombuffer(base64.b64decode(text), np.float32) for text in arrays), key=len).reshape(-1, 3)
    assert 2000 < len(ball) < 10_000
    np.testing.assert_allclose(np.linalg.norm(ball, axis=1), 1.0, atol=1e-6)


def test_meshes_of_a_package(write_robot: Write, tmp_path: Path) -> None:
    """package://name/... is searched in every folder above the URDF, as in a ROS workspace."""
    (tmp_path / "parts" / "meshes").mkdir(parents=True)
    trimesh.creation.icosphere(radius=0.1).export(tmp_path / "parts" / "meshes" / "ball.stl")
    mesh = MESH.format(file="package://parts/meshes/ball.stl")
    mechanism = Robot.load(write_robot(URDF.format(mesh=mesh)))
    assert len(Bodies.from_mechanism(mechanism)[1].parts) == 2


def test_packages_from_elsewhere(write_robot: Write, tmp_path_factory: pytest.TempPathFactory) -> None:
    folder = tmp_path_factory.mktemp("workspace")
    (folder / "parts").mkdir()
    trimesh.creation.icosphere(radius=0.1).export(folder / "parts" / "ball.stl")
    urdf = write_robot(URDF.format(mesh=MESH.format(file="package://parts/ball.stl")))
    assert len(Bodies.from_mechanism(Robot.load(urdf, package_paths=[folder]))[1].parts) == 2
    with pytest.raises(DescriptionError, match=r"ball\.stl"):
        Bodies.from_mechanism(Robot.load(urdf), urdf)


def test_shapes_of_mjcf(tmp_path: Path) -> None:
    """A capsule is a cylinder with two balls at its ends, an ellipsoid a stretched ball."""
    (tmp_path / "arm.xml").write_text(
        '<mujoco><worldbody><body name="arm"><joint/><geom type="capsule" size="0.1" fromto="0 0 0 0 0 1"/>'
        '<geom type="ellipsoid" size="0.1 0.2 0.3" pos="0 0 1"/></body></worldbody></mujoco>'
    )
    (arm,) = Bodies.from_mechanism(Robot.load(tmp_path / "arm.xml"))
    kinds = [part.scene_object["geometries"][0]["type"] for part in arm.parts]
    assert kinds == ["CylinderGeometry", "SphereGeometry", "SphereGeometry", "SphereGeometry"]
    np.testing.assert_allclose(sorted(part.placement[2, 3] for part in arm.parts), [0.0, 0.5, 1.0, 1.0], atol=1e-12)
    np.testing.assert_allclose(arm.parts[-1].placement[:3, :3], np.diag([0.1, 0.2, 0.3]), atol=1e-12)


STRUT = """<robot name="strut"><link name="base"/><link name="swing"/><link name="rod"/>
  <joint name="hinge" type="revolute"><parent link="base"/><child link="swing"/><origin xyz="0 0 1"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <joint name="slide" type="prismatic"><parent link="swing"/><child link="rod"/><axis xyz="0 0 1"/>
    <limit lower="{0}" upper="{1}" effort="1" velocity="1"/></joint>
</robot>
"""


@pytest.mark.parametrize(("lower", "upper", "length"), [(0.3, 0.5, 0.25), (-0.5, -0.3, 0.25), (0.1, 0.9, 0.45)])
def test_a_strut_without_visuals_reaches_from_its_hinge_to_its_end(
    write_robot: Write, lower: float, upper: float, length: float
) -> None:
    """Barrel and rod, each half as long as the strut at its longest, so that they always meet.

    An open tree whose range excludes zero is at the middle of that at home.
    """
    robot = Robot.load(write_robot(STRUT.format(lower, upper)))
    bodies = {body.name: body for body in Bodies.from_mechanism(robot)}
    parts = [part for name in ("hinge", "slide") for part in bodies[name].parts if "Cylinder" in str(part.scene_object)]
    assert [part.scene_object["geometries"][0]["height"] for part in parts] == pytest.approx([length] * 2)
    placements = Bodies.from_mechanism(robot).placements(robot.configuration([0.0, lower]))
    barrel, rod = (
        (placements[bodies[name].path] @ np.column_stack([part.corners, np.ones(len(part.corners))]).T)[2] - 1.0
        for name, part in zip(("hinge", "slide"), parts, strict=True)
    )
    side = np.sign(lower)
    assert sorted([barrel.min(), barrel.max()], key=abs) == pytest.approx([0.0, side * length], abs=1e-12)
    assert sorted([rod.min(), rod.max()]) == pytest.approx(sorted([lower, lower - side * length]), abs=1e-12)


def test_a_missing_mesh_is_named(write_robot: Write, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Downloaded files often lack their meshes: a stick figure, and a warning that says why."""
    urdf = write_robot(URDF.format(mesh=MESH.format(file=tmp_path / "gone.stl")))
    robot = Robot.load(urdf)
    assert [body.name for body in Bodies.from_mechanism(robot)] == ["universe", "turn"]
    assert "gone.stl" in caplog.text
    with pytest.raises(DescriptionError, match=r"robot\.urdf: mesh '.*gone\.stl"):
        Bodies.from_mechanism(robot, urdf)


def test_the_urdf_is_found_beside_either_closures_file(write_robot: Write) -> None:
    urdf = write_robot(URDF.format(mesh=""))
    assert [body.name for body in Bodies.from_mechanism(Robot.load(urdf))] == ["base", "arm"]
    urdf.with_name("robot.closures.yaml").rename(urdf.with_name("robot.yaml"))
    assert [body.name for body in Bodies.from_mechanism(Robot.load(urdf))] == ["base", "arm"]


def test_visuals_from_elsewhere(write_robot: Write) -> None:
    urdf = write_robot(URDF.format(mesh=""))
    bare = Robot(pin.buildModelFromUrdf(str(urdf)))
    assert [body.name for body in Bodies.from_mechanism(bare)] == ["universe", "turn"]  # a stick figure
    assert [body.name for body in Bodies.from_mechanism(bare, urdf)] == ["base", "arm"]
    geometry = pin.buildGeomFromUrdf(bare.model, str(urdf), pin.GeometryType.VISUAL)
    assert [body.name for body in Bodies.from_mechanism(bare, geometry)] == ["base", "arm"]


@pytest.mark.parametrize("robot", ["pm3dof", "hexapod", "three_rps"])
def test_stick_figures_join_at_the_closures(robot: str) -> None:
    mechanism = Robot.load(robot)
    bodies = Bodies.from_mechanism(mechanism, pin.GeometryModel())
    placements = bodies.placements(mechanism.home)
    balls = {part.name: placements[body.path] @ part.placement for body in bodies for part in body.parts}
    for loop in mechanism.closures:
        np.testing.assert_allclose(balls[loop.frame_a][:3, 3], balls[loop.frame_b][:3, 3], atol=1e-9)


def test_free_joints_and_several_freedoms() -> None:
    """A floating body and one on a ball joint: multi-DoF joints."""
    model = pin.Model()
    float_joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "float")
    model.addJoint(float_joint, pin.JointModelSpherical(), pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0])), "ball")
    bodies = Bodies.from_mechanism(Robot(model))
    assert [body.name for body in bodies] == ["float", "ball"]


def test_the_base_of_a_stick_figure_joins_what_it_carries(load: Callable[[str], Robot]) -> None:
    """The hexapod's six joints of the base, and not the platform, which floats on six joints of its own."""
    base = Bodies.from_mechanism(load("hexapod"), pin.GeometryModel())[0]
    assert {part.name for part in base.parts} == {f"to_universal{leg}_first_joint" for leg in range(1, 7)}
