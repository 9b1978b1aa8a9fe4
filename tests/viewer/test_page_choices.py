"""User actions in the page of any robot: select ellipsoids and loads, drag bodies, follow paths and links."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.direct_kinematics import all_assembly_modes
from pm3dof_pin.chapter.kinematics import placement
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer

pytestmark = pytest.mark.browser

STEP = 1e-6
POSE = [0.004, -0.003, 0.137, 0.05, -0.04, 0.03]


@pytest.fixture(scope="module")
def hexapod(load: Callable[[str], Robot]) -> Robot:
    return load("hexapod")


@pytest.fixture(scope="module")
def saved(hexapod: Robot, tmp_path_factory: pytest.TempPathFactory) -> Path:
    model = ElasticModel(hexapod)
    viewer = Viewer(hexapod)
    compliance = cartesian_compliance(model, hexapod.home).compliance
    viewer.stiffness_ellipsoid(compliance=compliance, kind="translation")
    viewer.stiffness_ellipsoid(compliance=compliance, kind="rotation")
    viewer.colour_legs(model, visible=False)
    path = hexapod.solve(np.linspace(hexapod.home_coordinates, POSE, 5))
    frames = [cartesian_compliance(model, configuration).compliance for configuration in path]
    viewer.play(list(path), compliance=frames, duration=2.0)
    viewer.colour_legs(model, visible=False)
    return viewer.save_html(tmp_path_factory.mktemp("page") / "hexapod.html")


@pytest.fixture
def shown(page: Any, saved: Path) -> Iterator[Any]:
    page.open_again(saved.as_uri())
    page.ask("pm3dof.viewer.animator.pause()")
    for index, value in enumerate(POSE):
        page.ask(f"pm3dof.slide({index}, {value})")
    yield page
    assert page.browser.errors == []
    assert len(set(page.browser.requests)) == 1


def point_of(page: Any, joint: int, local: list[float]) -> np.ndarray:
    """Position of a point of a joint's body at the displayed pose [m]."""
    rows = np.array(page.ask(f"pm3dof.pose().rows({joint})"))
    return np.asarray(rows[:, :3] @ local + rows[:, 3])


def principal(page: Any, motion: str) -> tuple[np.ndarray, np.ndarray]:
    """The numbers of an ellipsoid, and its matrix, the sum of the outer products of its drawn semi-axes."""
    entry = page.call("key => pm3dof.panel().legend.find(entry => entry.key === key)", motion)
    drawn = page.matrix(f"/ellipsoids/{motion}")[:3, :3] / entry["live"]["scale"]
    return np.array(entry["principal"]), drawn @ drawn.T


def by_finite_differences(robot: Robot) -> np.ndarray:
    """Twists of the tool for one unit of each command, shape=(6, 6), from forward kinematics."""
    pose = robot.solve(POSE)
    columns = []
    for k in range(len(robot.commands)):
        ends = [robot.forward(pose.commands + sign * STEP * np.eye(6)[k], guess=pose.q).transforms for sign in (1, -1)]
        rate = (ends[0] - ends[1]) / (2.0 * STEP)
        spin = rate[:3, :3] @ pose.transforms[:3, :3].T
        columns.append([*rate[:3, 3], spin[2, 1], spin[0, 2], spin[1, 0]])
    return np.transpose(columns)


@pytest.mark.parametrize(("motion", "rows"), [("translation", slice(0, 3)), ("rotation", slice(3, 6))])
def test_velocity_and_force_ellipsoids_are_those_of_the_jacobian(
    shown: Any, hexapod: Robot, motion: str, rows: slice
) -> None:
    J = by_finite_differences(hexapod)[rows]
    shown.ask("pm3dof.choose('velocity')")
    values, square = principal(shown, motion)
    np.testing.assert_allclose(values, np.linalg.svd(J, compute_uv=False)[::-1], rtol=1e-6)
    np.testing.assert_allclose(square, J @ J.T, atol=1e-6 * np.abs(J @ J.T).max())
    shown.ask("pm3dof.choose('force')")
    values, square = principal(shown, motion)
    np.testing.assert_allclose(values, 1.0 / np.linalg.svd(J, compute_uv=False), rtol=1e-6)
    inverse = np.linalg.inv(J @ J.T)
    np.testing.assert_allclose(square, inverse, atol=1e-6 * np.abs(inverse).max())


def test_error_ellipsoid_is_that_of_displaced_machines(shown: Any, hexapod: Robot) -> None:
    """Each part of the error file is displaced separately, both ways, and the poses at the same commands compared."""
    errors = GeometricErrors.load("hexapod")
    pose = hexapod.solve(POSE)
    covariance = np.zeros((3, 3))
    for parameter in errors.parameters:
        ends = [
            errors.apply({parameter.name: sign * STEP}).forward(pose.commands, guess=pose.q).positions
            for sign in (1, -1)
        ]
        moved = parameter.tolerance * (ends[0] - ends[1]) / (2.0 * STEP)
        covariance += np.outer(moved, moved)
    shown.ask("pm3dof.choose('error')")
    values, square = principal(shown, "translation")
    np.testing.assert_allclose(square, covariance, atol=1e-5 * np.abs(covariance).max())
    np.testing.assert_allclose(values**2, np.linalg.eigvalsh(covariance), rtol=1e-5)


def test_a_load_tells_its_deflection(shown: Any, hexapod: Robot) -> None:
    model = ElasticModel(hexapod)
    C = cartesian_compliance(model, hexapod.solve(POSE).configuration()).compliance
    shown.tick("legs")
    shown.ask("pm3dof.load([30, -20, 50, 1, 2, 3])")
    moved = C @ [30.0, -20.0, 50.0, 1.0, 2.0, 3.0]
    shift, tilt = np.linalg.norm(moved[:3]), np.linalg.norm(moved[3:])
    line = shown.values("legs").splitlines()[-1].replace("\u00a0", " ")
    said = [float(part.split()[0]) for part in line.removeprefix("deflection ").split(", ")]
    units = [part.split()[1] for part in line.removeprefix("deflection ").split(", ")]
    factors = {"nm": 1e-9, "\u00b5m": 1e-6, "mm": 1e-3, "nrad": 1e-9, "\u00b5rad": 1e-6, "mrad": 1e-3}
    np.testing.assert_allclose(np.array(said) * [factors[unit] for unit in units], [shift, tilt], rtol=5e-3)


def test_a_dragged_platform_goes_where_the_pointer_is(shown: Any, hexapod: Robot) -> None:
    """As far as six degrees of freedom allow: the held point ends within a hundredth of a millimetre."""
    joint = shown.ask("pm3dof.robot().data.tool_joint")
    local = [0.02, 0.01, 0.0]
    before = shown.call(
        "(joint, p) => pm3dof.pose().rows(joint).map(r => r[0]*p[0]+r[1]*p[1]+r[2]*p[2]+r[3])", joint, local
    )
    target = [before[0] + 0.004, before[1] - 0.002, before[2] + 0.003]
    shown.ask(f"[1,2,3,4].forEach(() => pm3dof.drag({joint}, {local}, {target}))")
    after = shown.call(
        "(joint, p) => pm3dof.pose().rows(joint).map(r => r[0]*p[0]+r[1]*p[1]+r[2]*p[2]+r[3])", joint, local
    )
    np.testing.assert_allclose(after, target, atol=1e-5)
    assert shown.ask("pm3dof.pose().residual") < 1e-12


def test_a_pointed_at_strut_tells_its_travel_and_force(shown: Any, hexapod: Robot) -> None:
    """The forces by virtual work: the weight of all bodies, displaced for one unit of each command."""
    model = hexapod.model
    shown.browser.settle()
    x, y, leg = shown.ask(
        """(() => {
            const legs = new Map(pm3dof.robot().data.bodies.map(({ name, actuator }) => [name, actuator]));
            for (let y = 0; y < 600; y += 5) for (let x = 320; x < 800; x += 5) {
                const isSeen = document.elementFromPoint(x, y) === pm3dof.viewer.renderer.domElement;
                const leg = isSeen && legs.get(pm3dof.bodyAt(x, y));
                if (Number.isInteger(leg)) return [x, y, leg];
            }
        })()"""
    )
    number = hexapod.solve(POSE).commands[leg]
    shown.call(
        "(x, y) => pm3dof.viewer.renderer.domElement.dispatchEvent("
        "new PointerEvent('pointermove', { clientX: x, clientY: y, bubbles: true }))",
        x,
        y,
    )
    said = shown.ask("document.getElementById('tip').innerText").replace("\u00a0", " ").splitlines()
    assert f"u{leg + 1} {number:.5f} of -0.01200 to 0.01200 m" in said

    def energy(commands: np.ndarray) -> float:
        data, q = model.createData(), hexapod.forward(commands, guess=hexapod.solve(POSE).q).q
        return float(pin.computePotentialEnergy(model, data, q))

    commands = np.array(hexapod.solve(POSE).commands)
    step = 1e-5 * np.eye(6)[leg]
    force = (energy(commands + step) - energy(commands - step)) / 2e-5
    (line,) = [line for line in said if line.startswith("holds the weight with ")]
    assert line.endswith(" N")
    assert float(line.split()[4].replace("\u2212", "-")) == pytest.approx(force, rel=5e-3)


def test_the_mouse_takes_the_platform_along(shown: Any) -> None:
    x, y = shown.ask("pm3dof.project(pm3dof.pose().tool)")
    names = {
        shown.ask(f"pm3dof.bodyAt({x + dx}, {y + dy})"): (x + dx, y + dy) for dx in (-30, 0, 30) for dy in (10, 30, 50)
    }
    assert "platform" in names
    start = names["platform"]
    before = shown.ask("[...pm3dof.pose().q]")
    shown.browser.drag(start, (start[0] + 25.0, start[1] - 10.0))
    assert not np.allclose(shown.ask("[...pm3dof.pose().q]"), before, atol=1e-4)
    assert shown.ask("pm3dof.viewer.controls.enabled")


def test_a_path_is_gone_to_and_plotted(shown: Any, hexapod: Robot) -> None:
    shown.ask("pm3dof.go(2)")
    middle = 0.5 * (hexapod.home_coordinates + POSE)
    values = shown.ask("pm3dof.pose().values(pm3dof.robot().data.sets[0])")
    np.testing.assert_allclose(values, middle, atol=1e-9)
    titles = shown.ask("[...document.querySelectorAll('#path option')].map(option => option.textContent)")
    expected = {"commands: lengths", "translation stiffness", "deflection under the load", "distance to singularities"}
    assert expected <= set(titles)
    for title in titles:
        shown.call(
            "title => { const select = document.querySelector('#path select'); select.value = title;"
            " select.dispatchEvent(new Event('change')); }",
            title,
        )
        assert shown.ask("document.querySelectorAll('#path .line').length") > 0, title


def test_a_path_shows_its_limits_and_deflection(page: Any, hexapod: Robot, tmp_path: Path) -> None:
    """The line is red from the frame at which a limit breaks; deflections are drawn beside it, enlarged as it says."""
    path = hexapod.solve(hexapod.home_coordinates + np.outer(np.linspace(0.0, 0.04, 9), np.eye(6)[2]))
    within = path.within_limits
    assert within[0]
    assert not within[-1]
    bent = np.linspace([0.0, 0.0, 0.0], [2e-6, 0.0, 0.0], 9)
    viewer = Viewer(hexapod)
    viewer.play(list(path), deflections=bent, duration=2.0)
    page.open_again(viewer.save_html(tmp_path / "path.html").as_uri())
    frames = page.ask("pm3dof.panel().path.frames.map(({ within }) => within)")
    assert frames == within.tolist()
    read = "(k, name) => Array.from(pm3dof.node('/trace/line').object.children[k].geometry.attributes[name].array)"
    line, colours, moved = (
        np.reshape(page.call(read, *which), (-1, 3)) for which in ((0, "position"), (0, "color"), (1, "position"))
    )
    is_red = colours[:, 0] > colours[:, 2]
    nearest = np.abs(line[:, None, 2] - path.positions[:, 2]).argmin(axis=1)
    np.testing.assert_array_equal(is_red, ~within[nearest])
    (text,) = page.ask("pm3dof.panel().legend.filter(({ key }) => key === 'trace').map(({ lines }) => lines[1])")
    enlarged = float(text.partition("deflected, ")[2].partition(" times")[0])
    tip = moved[-9:].mean(axis=0)  # the last ring, the first point of which is its last too
    np.testing.assert_allclose(tip, path.positions[-1] + enlarged * bent[-1], atol=0.1 * enlarged * 2e-6)


def test_a_path_has_its_line_axes_and_ellipsoids(shown: Any, hexapod: Robot) -> None:
    """The line passes the tool at every frame; the plot's ticks are in the unit that stands beside them."""
    vertices = shown.ask("Array.from(pm3dof.node('/trace/line').object.children[0].geometry.attributes.position.array)")
    path = hexapod.solve(np.linspace(hexapod.home_coordinates, POSE, 5)).positions
    away = np.linalg.norm(np.reshape(vertices, (-1, 1, 3)) - path, axis=2).min(axis=0)
    assert away.max() < 0.003
    assert shown.ask("pm3dof.node('/trace/ellipsoids').object.children.length") == 5
    shown.ask("pm3dof.plot('coordinates: lengths')")
    texts = shown.ask("[...document.querySelectorAll('#path text')].map(text => text.textContent)")
    assert "mm" in texts
    assert {"0", "50", "100"} <= set(texts)
    assert "2" in texts  # seconds, the duration


def test_a_playing_path_brings_what_was_chosen_along(shown: Any, hexapod: Robot) -> None:
    """The ellipsoid and the numbers in the panel and at the axis are those of the compliance at the frame."""
    shown.ask("pm3dof.choose('compliance', 'free')")
    animator = "pm3dof.viewer.animator"
    shown.ask(f"({animator}.pause(), {animator}.time = {animator}.duration, {animator}.seek({animator}.duration))")
    shown.browser.settle()
    shown.browser.settle()
    C = cartesian_compliance(ElasticModel(hexapod), hexapod.solve(POSE).configuration()).compliance[:3, :3]
    numbers, drawn = principal(shown, "translation")
    np.testing.assert_allclose(numbers, np.linalg.eigvalsh(C), rtol=1e-6)
    np.testing.assert_allclose(drawn, C @ C, atol=1e-5 * np.abs(C @ C).max())


def test_a_link_holds_what_is_shown(shown: Any, saved: Path) -> None:
    shown.ask("(pm3dof.choose('compliance', 'held'), pm3dof.load([0, 0, 0, 0, 0, 2]))")
    shown.ask("(pm3dof.turn(20), pm3dof.setTheme('dark'))")
    shown.tick("rotation")
    shown.ask("(pm3dof.chooseSet(1), pm3dof.plot('holding forces'))")
    link = shown.ask("pm3dof.written()")
    camera = shown.ask("pm3dof.viewer.camera.position.toArray()")
    shown.browser.open("about:blank")
    shown.browser.open(f"{saved.as_uri()}#{link}")
    values = shown.ask("pm3dof.pose().values(pm3dof.robot().data.sets[0])")
    np.testing.assert_allclose(values, POSE, atol=1e-8)
    assert shown.ask("[document.documentElement.dataset.theme, pm3dof.choice().of]") == ["dark", "compliance"]
    assert shown.ask("pm3dof.wrench()") == [0, 0, 0, 0, 0, 2]
    assert shown.ask("[...document.querySelectorAll('.load input')].map(field => field.valueAsNumber)") == [0] * 5 + [2]
    assert shown.ask("[pm3dof.set().title, pm3dof.plotted()]") == ["Commands", "holding forces"]
    assert not shown.is_visible("/ellipsoids/rotation")
    np.testing.assert_allclose(shown.ask("pm3dof.viewer.camera.position.toArray()"), camera, rtol=1e-4)
    shown.browser.requests[:] = [saved.as_uri()]


def test_hostile_links_change_nothing(shown: Any, saved: Path) -> None:
    before = shown.ask("[...pm3dof.pose().q]")
    for text in (
        "pose=1,2",
        "pose=a,b,c,d,e,f",
        "pose=1e9,0,0,0,0,0",
        "ellipsoids=<b>,held",
        "load=NaN,0,0,0,0,0",
        "pose=1e9,0,0,0,0,0&q=1,2",
        "sliders=7&frame=-1&cut=9,9,9&plot=<b>",
        "camera=x",
        "%",
    ):
        shown.call("text => pm3dof.follow(text)", text)
    np.testing.assert_array_equal(shown.ask("[...pm3dof.pose().q]"), before)


def test_singular_poses_are_announced(page: Any, hexapod: Robot, tmp_path: Path) -> None:
    """The hexapod turned by almost 90 degrees about z, where its struts lose the platform (Fichter, 1986)."""
    page.open(Viewer(hexapod).save_html(tmp_path / "page.html").as_uri())
    assert page.warnings() == []
    for angle in np.radians([20.0, 40.0, 60.0, 80.0, 88.0]):
        page.ask(f"pm3dof.slide(5, {angle})")
    assert any("singular" in line for line in page.warnings())
    assert page.browser.errors == []


def test_other_assemblies_are_those_of_the_closed_form(
    page: Any, mechanism: Robot, tripod: Tripod, tmp_path: Path
) -> None:
    """Every assembly mode that the page finds for the tripod at given commands is a solution of the equations."""
    page.open(Viewer(mechanism).save_html(tmp_path / "page.html").as_uri())
    commands = [0.25, 0.23, 0.245]
    sets = page.ask("pm3dof.robot().data.sets.map(set => set.title)")
    found = page.call(
        "(k, values) => { const robot = pm3dof.robot(), [first] = robot.data.sets;"
        " return robot.assemblies(robot.data.sets[k], values).map(pose => pose.values(first)); }",
        sets.index("Commands"),
        commands,
    )
    known = np.asarray(all_assembly_modes(tripod, commands))
    assert len(found) >= 2
    for coordinates in found:
        assert np.abs(placement(known) - placement(coordinates)).max(axis=(-1, -2)).min() < 1e-7, coordinates
    assert np.abs(np.array(found)[:, :2]).max() < np.pi + 1e-9
    near = mechanism.forward(commands).coordinates
    assert np.abs(np.array(found) - near).max(axis=1).min() < 1e-9
    q = page.ask(
        "(document.querySelectorAll('#sets button')[1].click(), pm3dof.showAssemblies(),"
        " document.querySelector('#assemblies button:last-child').click(), [...pm3dof.pose().q])"
    )
    page.ask("(link => { pm3dof.home(); pm3dof.follow(link); })(pm3dof.written())")
    np.testing.assert_allclose(page.ask("[...pm3dof.pose().q]"), q, atol=1e-7)
    assert page.ask("document.querySelectorAll('#assemblies button').length") >= 2
    assert page.browser.errors == []
