"""Other mechanisms in a real browser: hexapod, 3-RPS, a serial arm with meshes, stick figures, paths."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.chapter import Tripod
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer

MACHINES = Path(__file__).parents[1] / "machines"

pytestmark = pytest.mark.browser


@pytest.mark.parametrize("robot", ["hexapod", "three_rps"])
def test_other_robots(page: Any, load: Callable[[str], Robot], tmp_path: Path, robot: str) -> None:
    mechanism = load(robot)
    viewer = Viewer(mechanism)
    model = ElasticModel(mechanism)
    where = mechanism.home
    drawn = viewer.stiffness_ellipsoid(cartesian_compliance(model, where).stiffness, kind="translation")
    viewer.actuator_forces(holding_forces(where).actuator_forces)
    viewer.colour_legs(model)
    viewer.frames()
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    np.testing.assert_allclose(page.matrix("/ellipsoids/translation"), drawn.transform, atol=1e-9)
    for closure in mechanism.closures:
        ends = [
            path
            for path in viewer.scene.paths()
            if path.endswith((f"/{closure.frame_a}/x_shaft", f"/{closure.frame_b}/x_shaft"))
        ]
        assert len(ends) == 2
        first, second = (page.matrix(path.removesuffix("/x_shaft"))[:3, 3] for path in ends)
        np.testing.assert_allclose(first, second, atol=1e-9)
    assert page.picture().std() > 0.05
    # the second set of sliders: the commands
    page.ask("document.querySelectorAll('#sets button')[1].click()")
    name = mechanism.commands[0].name
    at_home = page.slider(name)
    assert page.drag_slider(name, 0.6) != at_home
    commands = page.ask("pm3dof.pose().values(pm3dof.robot().data.sets[1])")
    assert commands[0] != 0.0
    np.testing.assert_allclose(commands[1:], where.commands[1:], atol=1e-12)
    moved = mechanism.forward(commands).configuration()
    for path in ("/robot/platform", *(end.removesuffix("/x_shaft") for end in ends)):
        expected = moved.frame_placement(path.split("/")[-1]).homogeneous
        np.testing.assert_allclose(page.matrix(path), expected, rtol=0, atol=1e-9)
    block = cartesian_compliance(model, moved).stiffness[:3, :3]
    linear = page.matrix("/ellipsoids/translation")[:3, :3] / drawn.scale
    np.testing.assert_allclose(linear @ linear.T, block @ block, rtol=0, atol=1e-8 * np.abs(block @ block).max())
    assert page.browser.errors == []


def test_serial_arm_with_meshes(page: Any, tmp_path: Path) -> None:
    example_robot_data = pytest.importorskip("example_robot_data")
    arm = example_robot_data.load("ur5")
    mechanism = Robot(arm.model, tool_frame="ee_link")
    model = ElasticModel(mechanism, [JointSpring(name, name, 1e4, "N m/rad") for name in mechanism.actuated_joints])
    viewer = Viewer(mechanism, model=model, visuals=arm.visual_model)
    where = mechanism.configuration([0.3, -1.2, 1.4, -1.0, -1.5, 0.2])
    viewer.display(where)
    jacobian = where.tool_jacobian
    compliance = jacobian @ jacobian.T / 1e4
    drawn = viewer.stiffness_ellipsoid(compliance=compliance, kind="translation", of="compliance")
    viewer.colour_legs(model)
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    for link in ("base_link", "forearm_link", "wrist_3_link"):
        expected = where.frame_placement(link).homogeneous
        np.testing.assert_allclose(page.matrix(f"/robot/{link}"), expected, atol=1e-9)
    lengths = np.linalg.norm(page.matrix("/ellipsoids/translation")[:3, :3], axis=0)
    np.testing.assert_allclose(np.sort(lengths) / drawn.scale, np.linalg.eigvalsh(compliance[:3, :3]), rtol=1e-9)
    # a key moves a slider, and items drawn with these springs are updated
    page.ask("document.querySelector('#sliders input[type=range]').focus()")
    before = page.ask("pm3dof.pose().values(pm3dof.robot().data.sets[0])")
    page.browser.press("ArrowLeft")
    coordinates = page.ask("pm3dof.pose().values(pm3dof.robot().data.sets[0])")
    assert coordinates[0] < before[0]
    moved = mechanism.solve(coordinates, guess=where.q).configuration()
    expected = moved.frame_placement("wrist_3_link").homogeneous
    np.testing.assert_allclose(page.matrix("/robot/wrist_3_link"), expected, atol=1e-9)
    jacobian = moved.tool_jacobian[:3]
    lengths = np.linalg.norm(page.matrix("/ellipsoids/translation")[:3, :3], axis=0)
    np.testing.assert_allclose(
        np.sort(lengths) / drawn.scale, np.linalg.eigvalsh(jacobian @ jacobian.T / 1e4), rtol=1e-8
    )
    assert page.picture().std() > 0.05
    assert page.ask("pm3dof.panel().lacks") == []  # springs were given
    assert page.browser.errors == []


def test_stick_figure(page: Any, mechanism: Robot, tmp_path: Path) -> None:
    viewer = Viewer(mechanism, visuals=pin.GeometryModel())
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    for leg in (1, 2, 3):
        ends = [f"/robot/universal{leg}_second_joint/visual/link{leg}_tip", f"/robot/platform_y_joint/visual/E{leg}"]
        first, second = (page.matrix(path)[:3, 3] for path in ends)
        np.testing.assert_allclose(first, second, atol=1e-9)
    assert page.browser.errors == []


def test_a_path_is_played(page: Any, mechanism: Robot, tripod: Tripod, tmp_path: Path) -> None:
    """At the time of a frame, bodies, ellipsoids and arrows are where the frame has them."""
    model = ElasticModel(mechanism)
    angles = np.linspace(0.0, 2.0 * np.pi, 9)
    poses = np.column_stack([0.3 * np.cos(angles), 0.3 * np.sin(angles), np.full(9, 0.48)])
    frames = list(mechanism.solve(poses))
    stiffness = [cartesian_compliance(model, frame).stiffness for frame in frames]
    forces = [holding_forces(frame).actuator_forces for frame in frames]
    viewer = Viewer(mechanism)
    viewer.play(frames, stiffness=stiffness, forces=forces, duration=4.0)
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    page.ask("pm3dof.viewer.animator.pause()")
    for index in (0, 3, 8):
        page.call("time => (pm3dof.viewer.animator.time = time, pm3dof.viewer.animator.seek(time))", 0.5 * index)
        page.browser.settle()
        expected = frames[index].frame_placement("platform").homogeneous
        np.testing.assert_allclose(page.matrix("/robot/platform"), expected, atol=1e-6)  # tracks are single precision
        block = stiffness[index][:3, :3]
        linear = page.matrix("/ellipsoids/translation")[:3, :3]
        lengths = np.linalg.norm(linear, axis=0)
        scale = lengths.max() / np.linalg.eigvalsh(block)[-1]
        np.testing.assert_allclose(linear @ linear.T / scale**2, block @ block, atol=1e-5 * np.abs(block @ block).max())
        arrows = [np.linalg.norm(page.matrix(f"/forces/slider{leg}_joint")[:3, 2]) for leg in (1, 2, 3)]
        np.testing.assert_allclose(arrows / arrows[0], forces[index] / forces[index][0], rtol=1e-5)
        assert page.slider("theta_x") == pytest.approx(np.degrees(poses[index, 0]), abs=0.051)
    page.ask("pm3dof.viewer.animator.play()")
    page.drag_slider("theta_x", 0.4)
    assert page.ask("pm3dof.viewer.animator.playing") is False
    assert page.browser.errors == []


def test_a_notebooks_copy(page: Any, mechanism: Robot, tmp_path: Path) -> None:
    """The page inside a page, as a notebook shows it."""
    cell = Viewer(mechanism).jupyter_cell(height=500, static=True)
    file = tmp_path / "notebook.html"
    file.write_text(f"<!DOCTYPE html><html><body>{cell._repr_html_()}</body></html>", encoding="utf-8")
    page.open(file.as_uri())
    frame = "document.querySelector('iframe').contentWindow"
    assert page.ask(f"{frame}.eval('pm3dof.node(\"/robot/platform\").object.type')") == "Group"
    assert page.browser.errors == []


def test_more_drawn_with_meshcat(page: Any, mechanism: Robot, tmp_path: Path) -> None:
    """Objects of meshcat's own package: a primitive, points with packed arrays, a transform, a property."""
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat

    viewer = Viewer(mechanism)
    scene = meshcat.Visualizer(window=viewer.scene)
    scene["ball"].set_object(meshcat.geometry.Sphere(0.05))
    move = np.eye(4)
    move[:3, 3] = [0.2, 0.1, 0.5]
    scene["ball"].set_transform(move)
    points = np.random.default_rng(0).uniform(size=(3, 20)).astype(np.float32)
    scene["cloud"].set_object(meshcat.geometry.PointCloud(points, np.ones_like(points)))
    scene["gone"].set_object(meshcat.geometry.Box([0.1, 0.1, 0.1]))
    scene["gone"].delete()
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    np.testing.assert_allclose(page.matrix("/meshcat/ball"), move, atol=1e-15)
    positions = page.ask("[...pm3dof.node('/meshcat/cloud/<object>').object.geometry.attributes.position.array]")
    np.testing.assert_allclose(np.reshape(positions, (20, 3)).T, points)
    assert "gone" not in page.ask("Object.keys(pm3dof.node('/meshcat').children)")
    assert page.browser.errors == []


@pytest.mark.parametrize("size", ["0.1 0.1 3", "3 0.1 0.1"])
def test_all_of_it_is_in_the_picture(page: Any, write_robot: Any, tmp_path: Path, size: str) -> None:
    """No corner is cut off, for long and thin as well as bulky machines."""
    urdf = f'<robot name="r"><link name="b"><visual><geometry><box size="{size}"/></geometry></visual></link></robot>'
    page.open(Viewer(Robot.load(write_robot(urdf))).save_html(tmp_path / "page.html").as_uri())
    whole = page.picture()
    page.ask("pm3dof.node('/robot').object.visible = false, pm3dof.viewer.set_dirty()")
    rows, columns = np.argwhere(np.abs(whole - page.picture()).max(axis=-1) > 0.1).T
    height, width = whole.shape[:2]
    assert 0 < rows.min() < rows.max() < height - 1
    assert 0 < columns.min() < columns.max() < width - 1


def test_a_wrist_offers_the_stiffness_of_free_rotations(page: Any, tmp_path: Path) -> None:
    """It is elastic only in its three rotations, so that C is singular and there is no K with other motions held."""
    mechanism = Robot.load(MACHINES / "agile_eye")
    viewer = Viewer(mechanism)
    viewer.motion_ellipsoid("velocity", kind="rotation")
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    assert page.ask("pm3dof.quantities()") == ["stiffness", "compliance", "velocity", "force"]
    pose = "robot.moved(robot.home(), robot.data.sets[0], [0.1, -0.2, 0.15])"
    kinds = [{"motion": "rotation", "of": "stiffness", "others": others} for others in ("free", "held")]
    found = page.ask(
        f"(() => {{ const robot = pm3dof.robot(), pose = {pose}, C = robot.compliance(pose);"
        f" return {json.dumps(kinds)}.map((kind) => robot.ellipsoid(pose, kind, C)); }})()"
    )
    compliance = pm.compliance(mechanism, mechanism.forward([[0.1, -0.2, 0.15]]), engine="pinocchio")[0, 3:, 3:]
    np.testing.assert_allclose(found[0]["values"], np.linalg.eigvalsh(np.linalg.inv(compliance)), rtol=1e-9)
    assert "rigid" in found[1]
