"""The page of the tripod in a real browser: its scene graph, before and after a slider is moved."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.broken_limits import broken_limits
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.viewer import Viewer

pytestmark = pytest.mark.browser

KINDS = ("translation", "rotation")
BODIES = ["base", "middle_platform", "passive_leg", "passive_cross", "platform"]
BODIES += [f"{name}{leg}" for name in ("slider", "cross", "link") for leg in (1, 2, 3)]


def at_pose(mechanism: Robot, tripod: Tripod, theta_x: float, theta_y: float, z_e: float) -> Configuration:
    """The general engine's configuration, found by Newton's method from the URDF: degrees and metres."""
    return mechanism.solve([np.radians(theta_x), np.radians(theta_y), z_e]).configuration()


def drawn_everything(mechanism: Robot, tripod: Tripod, where: Configuration, **options: Any) -> Viewer:
    """A viewer with all items that the page can update, drawn from the general engine."""
    viewer = Viewer(mechanism)
    model = ElasticModel(mechanism)
    viewer.display(where)
    stiffness = cartesian_compliance(model, where).stiffness
    for kind in KINDS:
        viewer.stiffness_ellipsoid(stiffness, kind=kind, **options)
    viewer.actuator_forces(holding_forces(where).actuator_forces)
    viewer.colour_legs(model)
    viewer.frames()
    return viewer


@pytest.fixture(scope="module")
def model(mechanism: Robot) -> ElasticModel:
    return ElasticModel(mechanism)


@pytest.fixture(scope="module")
def saved(mechanism: Robot, tripod: Tripod, tmp_path_factory: pytest.TempPathFactory) -> Path:
    viewer = drawn_everything(mechanism, tripod, at_pose(mechanism, tripod, 10.0, -15.0, 0.5))
    return viewer.save_html(tmp_path_factory.mktemp("page") / "tripod.html")


@pytest.fixture
def shown(page: Any, saved: Path) -> Iterator[Any]:
    """The page of the tripod at (10 deg, -15 deg, 0.5 m), without errors or requests that leave the machine."""
    page.open_again(saved.as_uri())
    yield page
    assert page.browser.errors == []
    assert set(page.browser.requests) == {saved.as_uri()}


def assert_ellipsoid(matrix: np.ndarray, block: np.ndarray, scale: float, centre: np.ndarray) -> None:
    """The drawn ellipsoid is that of the block: M M^T / scale^2 = B^2, as R diag(s v) (R diag(s v))^T = s^2 B B."""
    linear = matrix[:3, :3] / scale
    np.testing.assert_allclose(linear @ linear.T, block @ block, rtol=0, atol=1e-9 * np.abs(block @ block).max())
    values = np.linalg.eigvalsh(block)
    lengths = np.linalg.norm(linear, axis=0)
    np.testing.assert_allclose(np.sort(lengths), values, rtol=1e-8)
    for length, axis in zip(lengths, (linear / lengths).T, strict=True):
        np.testing.assert_allclose(block @ axis, length * axis, rtol=0, atol=1e-8 * values[-1])
    np.testing.assert_allclose(matrix[:3, 3], centre, rtol=0, atol=1e-12)


def assert_machine(page: Any, where: Configuration) -> None:
    """Every body is where Pinocchio has it."""
    for body in BODIES:
        expected = where.frame_placement(body).homogeneous
        np.testing.assert_allclose(page.matrix(f"/robot/{body}"), expected, rtol=0, atol=1e-9, err_msg=body)


def test_pictures_are_not_empty(page: Any, mechanism: Robot, tripod: Tripod, tmp_path: Path) -> None:
    """Hiding the machine, and an ellipsoid, changes the picture; the machine fills it."""
    viewer = drawn_everything(mechanism, tripod, at_pose(mechanism, tripod, -25.0, 20.0, 0.46))
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    whole = page.picture()
    assert whole.std() > 0.05
    page.tick("rotation")
    without_ellipsoid = page.picture()
    page.ask("pm3dof.node('/robot').object.visible = false, pm3dof.viewer.set_dirty()")
    without_machine = page.picture()
    ellipsoid = np.abs(whole - without_ellipsoid).max(axis=-1) > 0.05
    machine = np.abs(without_ellipsoid - without_machine).max(axis=-1) > 0.05
    assert ellipsoid.mean() > 0.001
    assert machine.mean() > 0.02
    rows, columns = np.argwhere(machine).T
    height, width = machine.shape
    assert rows.min() > 0.02 * height  # all of it is in the picture
    assert rows.max() < 0.98 * height
    assert columns.min() > 0.02 * width
    assert columns.max() < 0.98 * width
    assert np.ptp(rows) > 0.5 * height
    assert page.browser.errors == []


def test_the_tree_has_the_parts(shown: Any, mechanism: Robot) -> None:
    tree = shown.ask("""(() => {
        const paths = [];
        const walk = (node, path) => Object.entries(node.children).forEach(([name, child]) => {
            paths.push(`${path}/${name}`);
            walk(child, `${path}/${name}`);
        });
        walk(pm3dof.viewer.scene_tree, "");
        return paths;
    })()""")
    expected = [f"/robot/{body}/visual" for body in BODIES]
    expected += [f"/ellipsoids/{kind}/surface" for kind in KINDS]
    expected += [f"/forces/{joint}/shaft" for joint in mechanism.actuated_joints]
    expected += ["/robot/platform/frames/O_e", "/robot/link1/frames/link1_tip", "/robot/platform/frames/E1"]
    assert set(expected) <= set(tree)
    names = "[...document.querySelectorAll('#sliders input[type=range]')].map(input => input.name)"
    assert shown.ask(names) == ["theta_x", "theta_y", "z_e"]
    assert shown.ask("document.title") == "PM3DOF"


def test_what_python_displays(shown: Any, mechanism: Robot, tripod: Tripod, model: ElasticModel) -> None:
    where = at_pose(mechanism, tripod, 10.0, -15.0, 0.5)
    assert_machine(shown, where)
    stiffness = cartesian_compliance(model, where).stiffness
    scales = {
        entry["key"]: entry["live"]["scale"]
        for entry in shown.ask("pm3dof.panel().legend")
        if entry["live"] and "scale" in entry["live"]
    }
    for kind, rows in (("translation", slice(0, 3)), ("rotation", slice(3, 6))):
        block = stiffness[rows, rows]
        assert_ellipsoid(shown.matrix(f"/ellipsoids/{kind}"), block, scales[kind], where.tool_placement.translation)
    arrows = [shown.matrix(f"/forces/{joint}") for joint in mechanism.actuated_joints]
    lengths = [np.linalg.norm(arrow[:3, 2]) / scales["forces"] for arrow in arrows]
    # holding forces of five programs
    np.testing.assert_allclose(lengths, [5.868999588679, 5.836388512736, 6.334937172705], rtol=1e-9)
    for leg, arrow in enumerate(arrows):
        np.testing.assert_allclose(arrow[:3, 3], where.frame_placement(f"D{leg + 1}").translation, atol=1e-12)
        np.testing.assert_allclose(np.cross(arrow[:3, 2], tripod.guide_directions[leg]), 0.0, atol=1e-12)


def test_a_slider_moves_the_machine(shown: Any, mechanism: Robot, tripod: Tripod, model: ElasticModel) -> None:
    """Dragged with the mouse: the machine, its ellipsoids, forces and colours are then those of the general engine."""
    theta_x = shown.drag_slider("theta_x", 0.33)
    z_e = shown.drag_slider("z_e", 0.4)
    assert -30.0 < theta_x < -15.0
    assert z_e < 0.5
    where = at_pose(mechanism, tripod, theta_x, -15.0, z_e)
    assert_machine(shown, where)
    behaviour = cartesian_compliance(model, where)
    scales = {entry["key"]: entry["live"].get("scale") for entry in shown.ask("pm3dof.panel().legend") if entry["live"]}
    for kind, rows in (("translation", slice(0, 3)), ("rotation", slice(3, 6))):
        block = behaviour.stiffness[rows, rows]
        assert_ellipsoid(shown.matrix(f"/ellipsoids/{kind}"), block, scales[kind], where.tool_placement.translation)
    forces = holding_forces(where).actuator_forces
    lengths = [np.linalg.norm(shown.matrix(f"/forces/slider{leg}_joint")[:3, 2]) for leg in (1, 2, 3)]
    np.testing.assert_allclose(lengths, scales["forces"] * forces, rtol=1e-9)
    np.testing.assert_allclose(
        [float(text) for text in shown.values("forces").removesuffix("\u00a0N").split(" · ")], forces, atol=0.0051
    )
    up = behaviour.contributions[:, 2, 2] / behaviour.compliance[2, 2]
    by_name = dict(zip(behaviour.spring_names, up, strict=True))
    expected = [by_name[f"actuator{leg}"] + by_name[f"link{leg}"] for leg in (1, 2, 3)] + [by_name["passive_leg"]]
    written = [float(text) for text in re.findall(r": ([\d.]+) %", shown.values("legs"))]
    np.testing.assert_allclose(written, 100.0 * np.array(expected), atol=0.051)
    assert "in this page" in shown.note()


def test_leg_colours(shown: Any) -> None:
    """The checkbox of the legend removes the colours; the legs' own return."""
    slider, link = "/robot/slider1/visual/slider1_0", "/robot/link1/visual/link1_0"
    coloured = shown.colour(slider)
    np.testing.assert_allclose(shown.colour(link), coloured, atol=1e-6)
    shown.tick("legs")
    np.testing.assert_allclose(shown.colour(slider), [0.835, 0.369, 0.0], atol=0.005)
    np.testing.assert_allclose(shown.colour(link), [0.0, 0.447, 0.698], atol=0.005)
    shown.drag_slider("theta_x", 0.3)
    np.testing.assert_allclose(shown.colour(link), [0.0, 0.447, 0.698], atol=0.005)
    shown.tick("legs")
    np.testing.assert_allclose(shown.colour(link), shown.colour(slider), atol=1e-6)
    assert not np.allclose(shown.colour(slider), coloured, atol=1e-3)


def test_home_button(shown: Any, mechanism: Robot) -> None:
    shown.drag_slider("theta_y", 0.8)
    shown.ask("document.querySelector('#sets .home').click()")
    shown.browser.settle()
    assert_machine(shown, mechanism.home)
    assert [shown.slider("theta_x"), shown.slider("theta_y")] == [0, 0]
    assert shown.note().startswith("tilt about x\u00a00.0°, tilt about y\u00a00.0°, z_e\u00a00.493")
    shown.ask("pm3dof.slide(0, -1e-9)")
    assert shown.note().startswith("tilt about x\u00a00.0°, ")  # zero has no sign
    assert shown.warnings() == []


def test_a_broken_limit_is_named(shown: Any, mechanism: Robot, tripod: Tripod) -> None:
    theta_y = shown.drag_slider("theta_y", 0.9)
    where = at_pose(mechanism, tripod, 10.0, theta_y, 0.5)
    violations = [str(violation) for violation in broken_limits(mechanism, where)]
    assert any("spherical" in violation for violation in violations)
    assert shown.warnings() == ["Outside the joint limits:", *violations]


def test_out_of_reach_is_said_and_the_last_pose_stays(shown: Any) -> None:
    """Where a link does not reach its guideway: the corner of the slider ranges, moved far up."""
    shown.drag_slider("theta_x", 0.999)
    shown.drag_slider("theta_y", 0.999)
    shown.ask("pm3dof.slide(2, 0.9)")
    (warning,) = shown.warnings()
    assert warning.startswith("Out of reach: the loops do not close there")
    reached = shown.ask("pm3dof.pose().values(pm3dof.set())[2]")
    assert 0.7 < reached < 0.9
    assert shown.ask("pm3dof.pose().residual") < 1e-12
    shown.ask("pm3dof.slide(2, 0.5)")
    assert not any("do not close" in warning for warning in shown.warnings())


def test_below_the_clamp_there_is_no_stiffness(shown: Any, tripod: Tripod) -> None:
    shown.ask(f"(pm3dof.home(), pm3dof.slide(2, {tripod.clamp_height - 0.001}))")
    assert not shown.is_visible("/ellipsoids/translation")
    assert "no stiffness" in shown.values("translation")
    shown.ask("pm3dof.home()")
    assert shown.is_visible("/ellipsoids/translation")


def test_another_kind_of_ellipsoid_goes_on(
    page: Any, mechanism: Robot, tripod: Tripod, model: ElasticModel, tmp_path: Path
) -> None:
    viewer = drawn_everything(mechanism, tripod, mechanism.home, of="stiffness", others="free")
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    page.ask(f"(pm3dof.slide(0, {np.radians(-12.0)}), pm3dof.slide(1, {np.radians(17.0)}), pm3dof.slide(2, 0.47))")
    stiffness = cartesian_compliance(model, at_pose(mechanism, tripod, -12.0, 17.0, 0.47)).stiffness
    scales = {entry["key"]: entry["live"].get("scale") for entry in page.ask("pm3dof.panel().legend") if entry["live"]}
    for kind, rows in (("translation", slice(0, 3)), ("rotation", slice(3, 6))):
        block = np.linalg.inv(np.linalg.inv(stiffness)[rows, rows])
        drawn = page.matrix(f"/ellipsoids/{kind}")
        values, axes = np.linalg.eigh(block)
        lengths = np.linalg.norm(drawn[:3, :3], axis=0)
        np.testing.assert_allclose(np.sort(lengths) / scales[kind], values, rtol=1e-6)
        np.testing.assert_allclose(np.abs((drawn[:3, :3] / lengths).T @ axes).max(axis=1), 1.0, atol=1e-6)
    assert page.browser.errors == []


def test_what_is_not_the_machines_own_is_left_behind(
    page: Any, mechanism: Robot, tripod: Tripod, tmp_path: Path
) -> None:
    """An ellipsoid of other springs, and forces of another load, belong to their pose: hidden when a slider moves."""
    viewer = Viewer(mechanism)
    viewer.stiffness_ellipsoid(np.diag([1e6, 2e6, 3e6, 1e4, 2e4, 3e4]))
    viewer.actuator_forces([10.0, 10.0, 10.0])
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    assert page.is_visible("/ellipsoids/translation")
    page.ask("pm3dof.slide(0, 0.1)")
    assert not page.is_visible("/ellipsoids/translation")
    assert not page.is_visible("/forces/slider1_joint")
    assert page.values("translation") == "drawn for another pose: hidden"


def test_workspace_in_the_page(page: Any, mechanism: Robot, tmp_path: Path) -> None:
    """The tip of the drawn tool follows the formula, also after moving a slider; the checkbox hides the shell."""
    from pm3dof_pin.viewer.shell import _tool_tips

    viewer = Viewer(mechanism)
    viewer.workspace("condition_number", tool_length=0.2, cells=9)
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    pose = [0.2, -0.3, 0.48]
    page.ask("".join(f"pm3dof.slide({index}, {value});" for index, value in enumerate(pose)) + "0")
    np.testing.assert_allclose(
        page.matrix("/robot/platform/tool/tip")[:3, 3], _tool_tips(mechanism.solve(pose), 0.2), atol=1e-12
    )
    assert page.is_visible("/workspace")
    assert not page.ask("document.getElementById('scale').hidden")
    ends = page.ask("[...document.querySelectorAll('#scale .ends span')].map(end => end.textContent)")
    assert ends == page.ask("[...document.querySelectorAll('[data-key=workspace] .ends span')].map(e => e.textContent)")
    assert not page.is_visible("/workspace/points")
    page.ask("pm3dof.cutTo(0, 2, 0.5)")
    assert page.is_visible("/workspace/points")
    page.tick("workspace")
    assert not page.is_visible("/workspace")
    assert page.ask("document.getElementById('scale').hidden")
    assert page.browser.errors == []
