"""Polytopes of forces and speeds at the tool: against linear programs, and the page's own against Python's."""

from __future__ import annotations

import json
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.optimize import linprog
from scipy.spatial import ConvexHull

import pm3dof_pin as pm
from pm3dof_pin.capability.tool_capability import ToolCapability, tool_capability
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Motion
from pm3dof_pin.viewer.page_programs import PagePrograms
from pm3dof_pin.viewer.polytopes import PolytopeQuantity, tool_polytope
from pm3dof_pin.viewer.sliders import Sliders
from tests.viewer.test_moving_robots import robot_program, run

CASES: list[tuple[str, PolytopeQuantity, Motion]] = [
    ("hexapod", "force", "translation"),
    ("hexapod", "speed", "translation"),
    ("hexapod", "speed", "rotation"),
    ("linear_delta", "speed", "translation"),
    ("pm3dof", "force", "translation"),
    ("ankle_rus", "force", "rotation"),
    ("ankle_rus", "speed", "rotation"),
]
SCRIPT = """
const robot = new Robot(data, programs);
console.log(JSON.stringify(lives.map((live) => Polytope.at(robot, robot.pose(q), live))));
"""


def _case(name: str) -> tuple[Robot, np.ndarray, ToolCapability]:
    """Return a robot off home, with limits that differ from drive to drive."""
    robot = pm.load(name)
    values = robot.home_coordinates + np.linspace(0.02, 0.03, len(robot.coordinates))
    q = robot.solve(values).q
    count = len(robot.actuated_joints)
    return (
        robot,
        q,
        tool_capability(robot, q, effort=np.linspace(40.0, 60.0, count), speed=np.linspace(0.2, 0.4, count)),
    )


def _support(at: ToolCapability, of: PolytopeQuantity, kind: Motion, direction: np.ndarray) -> float:
    """The greatest component of a force (in the space of the tool's motions), or of a speed, by a linear program."""
    block = at.tool_rates[:3] if kind == "translation" else at.tool_rates[3:]
    if of == "speed":
        bounds = list(zip(-at.speed, at.speed, strict=True))
        return float(-linprog(-direction @ block, bounds=bounds).fun)
    left, sizes, _ = np.linalg.svd(block)
    axes = left[:, : len(sizes)][:, sizes > 1e-6 * sizes[0]]
    rows = (axes.T @ block).T
    found = linprog(
        -direction @ axes,
        A_ub=np.vstack([rows, -rows]),
        b_ub=np.concatenate([at.effort - at.weight, at.effort + at.weight]),
        bounds=[(None, None)] * axes.shape[1],
    )
    return float(-found.fun)


@pytest.mark.parametrize(("name", "of", "kind"), CASES)
def test_polytopes_reach_as_far_as_linear_programs(name: str, of: PolytopeQuantity, kind: Motion) -> None:
    _, _, at = _case(name)
    drawn = tool_polytope(at, of, kind)
    for direction in np.random.default_rng(3).normal(size=(6, 3)):
        expected = _support(at, of, kind, direction)
        assert (drawn.vertices @ direction).max() == pytest.approx(expected, rel=1e-9)
    around = drawn.vertices[drawn.triangles]
    if np.linalg.matrix_rank(drawn.vertices - drawn.vertices[0], tol=1e-6 * drawn.greatest) == 3:
        volumes = np.abs(np.linalg.det(around - drawn.vertices.mean(axis=0))) / 6.0
        assert volumes.sum() == pytest.approx(ConvexHull(drawn.vertices).volume, rel=1e-9)


@pytest.mark.parametrize("name", list(dict.fromkeys(case[0] for case in CASES)))
def test_the_page_has_the_same_polytopes(name: str) -> None:
    robot, q, at = _case(name)
    sliders = Sliders(robot, PagePrograms(robot))
    asked = [(of, kind) for other, of, kind in CASES if other == name]
    sizes: dict[str, Any] = {"scale": 1.0, "length": 1.0}
    lives = [sliders.live_polytope(at, robot.configuration(q), of=of, kind=kind, **sizes) for of, kind in asked]
    page = files("pm3dof_pin.viewer").joinpath("assets", "polytopes.js").read_text(encoding="utf-8")
    data = {"data": sliders.machine_data(()), "q": q.tolist(), "lives": lives}
    constants = [f"const {key} = {json.dumps(entry)};" for key, entry in data.items()]
    found = run(
        "\n".join([sliders._programs.source, robot_program(), "const hasWebGL = false;", page, *constants, SCRIPT])
    )
    for (of, kind), answer in zip(asked, found, strict=True):
        expected = tool_polytope(at, of, kind)
        corners = np.concatenate(answer["faces"])
        apart = np.linalg.norm(corners[:, None] - expected.vertices, axis=-1)
        assert apart.min(axis=0).max() < 1e-8 * expected.greatest  # each of Python's is a corner in the page
        assert apart.min(axis=1).max() < 1e-8 * expected.greatest
        np.testing.assert_allclose(answer["values"], [expected.least, expected.greatest], rtol=1e-8)


def test_weak_drives_and_rigid_directions() -> None:
    """One newton a drive: the hexapod of 3.6 N a drive must be carried; one drive of 0 leaves no room for forces."""
    robot = pm.load("hexapod")
    weak = tool_polytope(tool_capability(robot, robot.home, effort=1.0), "force", "translation")
    assert weak.least == 0.0
    assert weak.vertices[:, 2].max() < 0.0
    limp = tool_capability(robot, robot.home, effort={robot.actuated_joints[0]: 0.0})
    with pytest.raises(InvalidValueError, match="hold the weight"):
        tool_polytope(limp, "force", "translation")
    delta = pm.load("linear_delta")
    with pytest.raises(SingularConfigurationError, match="no rotation"):
        tool_polytope(tool_capability(delta, delta.home, effort=60.0), "force", "rotation")


def test_a_point_on_two_slides_has_a_rectangle(tmp_path: Path) -> None:
    body = '<body><joint name="{}" type="slide" axis="{}"/><geom size="0.1"/>'
    chain = body.format("a", "1 0 0") + body.format("b", "0 1 0") + '<site name="tip"/></body></body>'
    path = tmp_path / "point.xml"
    drives = "<actuator><motor joint='a'/><motor joint='b'/></actuator>"
    path.write_text(f"<mujoco><option gravity='0 0 0'/><worldbody>{chain}</worldbody>{drives}</mujoco>")
    robot = pm.load(path, tool_frame="tip")
    drawn = tool_polytope(tool_capability(robot, robot.home, effort=[3.0, 2.0]), "force", "translation")
    assert sorted(map(tuple, np.abs(drawn.vertices.round(12)))) == [(3.0, 2.0, 0.0)] * 4
    assert (drawn.least, drawn.greatest) == pytest.approx((2.0, 13.0**0.5))
