"""Ghosts in the page: the tool's body where a dragged load takes it, and the motion of a singular pose."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.modes import natural_modes
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer

pytestmark = pytest.mark.browser

FIVE_BAR = Path(__file__).parents[1] / "machines" / "five_bar"
GHOST = "pm3dof.node('/load/ghost').object.children[0].matrix.elements"
FRAMES = """new Promise((done) => setTimeout(() => done(pm3dof.freeMotion().map((pose) =>
    pm3dof.robot().data.sets.map((set) => pose.values(set)).concat([pose.toolComponents, [pose.residual]]))), 1500))"""


def entry(page: Any) -> Any:
    return page.ask("pm3dof.panel().legend.find(({ key }) => key === 'load')")


def test_a_dragged_load_takes_the_ghost_along(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    robot = load("hexapod")
    viewer, model = Viewer(robot), ElasticModel(robot)
    said = viewer.load(model, [0.0, 0.0, 50.0, 0.0, 0.0, 2.0])
    C = cartesian_compliance(model, robot.home).compliance
    np.testing.assert_allclose(said, C @ [0.0, 0.0, 50.0, 0.0, 0.0, 2.0], rtol=1e-12)
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    x, y = page.ask("pm3dof.loadTip()")
    page.browser.drag((x, y), (x + 60.0, y + 40.0))
    np.testing.assert_allclose(page.ask("pm3dof.loadTip()"), [x + 60.0, y + 40.0], atol=1.5)
    wrench = np.array(entry(page)["live"]["wrench"])
    assert np.abs(wrench[:2]).max() > 1.0
    assert wrench[5] == 2.0
    # the platform is the body of the tool: it moves by the magnified twist, about the tool
    twist = page.ask("pm3dof.magnification()") * (C @ wrench)
    tool = robot.home.tool_placement.translation
    joint = robot.model.frames[robot.tool_frame_id].parentJoint
    body = next(body for body in page.ask("pm3dof.robot().data.bodies") if body["joint"] == joint)
    before = page.matrix(body["path"])
    after = np.array(page.ask(GHOST)).reshape(4, 4).T
    np.testing.assert_allclose(after[:3, :3], pin.exp3(twist[3:]) @ before[:3, :3], atol=1e-6)
    expected = tool + twist[:3] + pin.exp3(twist[3:]) @ (before[:3, 3] - tool)
    np.testing.assert_allclose(after[:3, 3], expected, atol=1e-6)
    assert page.browser.errors == []


def test_a_load_in_a_plane_stays_in_it(page: Any, tmp_path: Path) -> None:
    robot = Robot.load(FIVE_BAR)
    viewer = Viewer(robot)
    viewer.load(ElasticModel(robot), [30.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    x, y = page.ask("pm3dof.loadTip()")
    page.browser.drag((x, y), (x - 20.0, y - 50.0))
    wrench = entry(page)["live"]["wrench"]
    assert wrench[1] > 5.0
    assert wrench[2] == 0.0


def test_the_machine_swings_in_a_mode(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    """The platform moves by a multiple of the mode's twist at its joint, which is that of finite differences."""
    robot = load("pm3dof")
    viewer, model = Viewer(robot), ElasticModel(robot)
    frequencies = viewer.modes(model, 2)
    found = natural_modes(model, robot.home, count=2)
    np.testing.assert_array_equal(frequencies, found.frequencies)
    joint = robot.model.frames[robot.tool_frame_id].parentJoint
    name, tree = robot.model.names[joint], model.mechanism.model
    step, places = 1e-7, []
    for sign in (-1.0, 1.0):
        data = tree.createData()
        q = pin.integrate(tree, np.array(found.configuration.q), sign * step * found.shapes[:, 1])
        pin.forwardKinematics(tree, data, q)
        places.append(data.oMi[tree.getJointId(name)])
    shift = (places[1].translation - places[0].translation) / (2.0 * step)
    turn = pin.log3(places[1].rotation @ places[0].rotation.T) / (2.0 * step)
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    entries = page.ask("pm3dof.panel().legend.filter(({ live }) => live && live.kind === 'mode')")
    assert [entry["title"] for entry in entries] == ["Mode 1", "Mode 2"]
    assert entries[0]["values"] == "162.6 Hz"
    drawn = np.array(entries[1]["live"]["twists"][joint])
    np.testing.assert_allclose(
        drawn / np.linalg.norm(drawn), np.append(shift, turn) / np.hypot(*map(np.linalg.norm, (shift, turn))), atol=1e-6
    )
    mode = "pm3dof.modeAt(pm3dof.panel().legend.find(({ key }) => key === 'mode2'), 0.5)"
    after = np.array(page.ask(f"{mode}.placement({joint})")).reshape(4, 4).T
    before = np.array(page.ask(f"pm3dof.pose().placement({joint})")).reshape(4, 4).T
    np.testing.assert_allclose(after[:3, 3] - before[:3, 3], 0.5 * drawn[:3], atol=1e-12)
    np.testing.assert_allclose(after[:3, :3] @ before[:3, :3].T, pin.exp3(0.5 * drawn[3:]), atol=1e-9)
    ghost = "pm3dof.node('/mode1').object.children.map(({ matrix }) => [...matrix.elements])"
    one, other = (page.ask(f"new Promise((done) => setTimeout(() => done({ghost}), {wait}))") for wait in (100, 500))
    assert np.abs(np.array(one) - np.array(other)).max() > 1e-3
    page.ask("pm3dof.slide(0, 5)")
    assert page.ask("pm3dof.panel().legend.find(({ key }) => key === 'mode1').stale")
    assert page.browser.errors == []


@pytest.mark.parametrize("wrench", [np.zeros(6), [1.0, 0.0], [np.nan, 0.0, 0.0, 0.0, 0.0, 0.0]])
def test_loads_that_are_none(load: Callable[[str], Robot], wrench: Any) -> None:
    robot = load("hexapod")
    with pytest.raises(InvalidValueError, match="wrench"):
        Viewer(robot, sliders=False).load(ElasticModel(robot), wrench)


def test_a_ghost_shows_the_motion_that_becomes_free(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    """The hexapod turned by almost 90 degrees (Fichter, 1986): it screws about z while the drives hardly move."""
    robot = load("hexapod")
    page.open(Viewer(robot).save_html(tmp_path / "page.html").as_uri())
    assert page.ask(FRAMES) == []
    for angle in np.radians([20.0, 40.0, 60.0, 80.0, 88.0]):
        page.ask(f"pm3dof.slide(5, {angle})")
    frames = page.ask(FRAMES)
    assert max(frame[-1][0] for frame in frames) < 1e-12
    first, last = ([np.array(part) for part in frames[k]] for k in (0, -1))
    moved, driven = last[0] - first[0], np.linalg.norm(last[1] - first[1])
    np.testing.assert_allclose(moved[[0, 1, 3, 4]], 0.0, atol=1e-9)
    assert abs(moved[5]) > 0.02
    ends = robot.solve(np.array(robot.home_coordinates) + np.array([[-0.5], [0.5]]) * moved).commands
    assert driven < np.linalg.norm(ends[1] - ends[0]) / 5.0
    page.ask("pm3dof.home()")
    assert page.ask(FRAMES) == []
    assert page.browser.errors == []


def test_a_ghost_shows_drives_that_do_not_move_the_tool(page: Any, tmp_path: Path) -> None:
    """The five-bar stretched out: its cranks turn, and the tool moves to second order."""
    robot = Robot.load(FIVE_BAR)
    page.open(Viewer(robot).save_html(tmp_path / "page.html").as_uri())
    for y in (0.5, 0.55, 0.58, 0.6):
        page.ask(f"pm3dof.slide(1, {y})")
    frames = page.ask(FRAMES)
    assert len(frames) > 2
    steps = [np.linalg.norm(np.subtract(b[2][:2], a[2][:2])) for a, b in itertools.pairwise(frames)]
    turned = [np.linalg.norm(np.subtract(b[1], a[1])) for a, b in itertools.pairwise(frames)]
    ends = robot.forward(np.array(robot.home.commands) + np.array([[-0.01], [0.01]])).positions
    assert min(np.divide(steps, turned)) < np.linalg.norm(ends[1] - ends[0]) / (0.02 * np.sqrt(2.0)) / 5.0
