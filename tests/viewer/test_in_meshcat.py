"""Robots drawn into a user's meshcat.Visualizer, which records what it is sent."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer, draw_in_meshcat
from pm3dof_pin.viewer.scene import Scene


@pytest.fixture
def visualizer() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    return meshcat.Visualizer(window=Scene())["mine"]


def transforms(scene: Scene) -> dict[str, np.ndarray]:
    commands = scene.snapshot()["commands"]
    return {c["path"]: np.reshape(c["matrix"], (4, 4)).T for c in commands if c["type"] == "set_transform"}


def objects(scene: Scene) -> dict[str, Any]:
    return {c["path"]: c["object"] for c in scene.snapshot()["commands"] if c["type"] == "set_object"}


def test_one_call_draws_robot_pose_and_ellipsoids(mechanism: Robot, visualizer: Any) -> None:
    where = mechanism.solve([0.2, -0.1, 0.5]).configuration()
    draw_in_meshcat(visualizer, where)
    drawn = transforms(visualizer.window)
    for body in ("platform", "link2", "slider3"):
        expected = where.frame_placement(body).homogeneous
        np.testing.assert_allclose(drawn[f"/meshcat/mine/robot/{body}"], expected, atol=1e-12)
    tool = where.tool_placement.translation
    np.testing.assert_allclose(drawn["/meshcat/mine/ellipsoids/translation"][:3, 3], tool, atol=1e-12)
    own = objects(Viewer(mechanism).scene)
    sent = objects(visualizer.window)
    for path in (path for path in own if path.startswith("/robot")):
        assert sent[f"/meshcat/mine{path}"]["geometries"][0].keys() == own[path]["geometries"][0].keys()
    assert not any("floor" in path or "Lights" in path for path in sent)


def test_a_second_call_and_the_viewer_keep_it_current(mechanism: Robot, visualizer: Any) -> None:
    draw_in_meshcat(visualizer, mechanism.home)
    viewer = draw_in_meshcat(visualizer, mechanism.solve([0.1, 0.1, 0.49]).configuration(), of=None)
    assert "/meshcat/mine/ellipsoids/translation/surface" not in visualizer.window.paths()
    where = mechanism.solve([-0.2, 0.3, 0.48]).configuration()
    viewer.display(where)
    expected = where.frame_placement("platform").homogeneous
    np.testing.assert_allclose(transforms(visualizer.window)["/meshcat/mine/robot/platform"], expected, atol=1e-12)


def test_arrays_are_packed_as_meshcat_packs_them(mechanism: Robot, visualizer: Any) -> None:
    """Arrays in base64 for the page become the same bytes in msgpack: the axes of an ellipsoid."""
    draw_in_meshcat(visualizer, mechanism.home)
    viewer = Viewer(mechanism)
    viewer.stiffness_ellipsoid(np.eye(6))
    own, sent = (
        objects(scene)[f"{root}/ellipsoids/translation/axes"]["geometries"][0]["data"]
        for scene, root in ((viewer.scene, ""), (visualizer.window, "/meshcat/mine"))
    )
    assert sent == own


def test_two_robots_share_the_scene_of_a_viewer(mechanism: Robot) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        import meshcat
    first = Viewer(mechanism)
    beside = meshcat.Visualizer(window=first.scene)["second"]
    second = Viewer(Robot.load("hexapod"), viewer=beside, sliders=False)
    pose = second.mechanism.solve([0.0, 0.0, 0.14, 0.0, 0.0, 0.0])
    second.display(pose)
    drawn = transforms(first.scene)
    expected = pose.configuration().frame_placement("platform").homogeneous
    np.testing.assert_allclose(drawn["/meshcat/second/robot/platform"], expected, atol=1e-12)
    np.testing.assert_allclose(drawn["/robot/platform"], mechanism.home.frame_placement("platform").homogeneous)
