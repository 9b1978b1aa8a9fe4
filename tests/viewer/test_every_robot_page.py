"""The page of every robot of the tests in a browser: slider ends, numbers of Python, nothing overlaps, no errors."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer

pytestmark = pytest.mark.browser

MACHINES = Path(__file__).parents[1] / "machines"
ROBOTS = {
    **{name: name for name in ("pm3dof", "hexapod", "three_rps", "linear_delta")},
    **{name: MACHINES / name for name in ("agile_eye", "delta", "five_bar", "four_bar", "four_rrr", "three_rpr")},
    **{name: MACHINES / name / f"{name}.xml" for name in ("ankle", "walker")},
}
# a floating base with a loop in each leg, a spring joint in it, and drives that are not all coordinates of the tool
LEG = """
<body name="{0}_hip" pos="0 {1} 0"><joint name="{0}_hip" axis="0 1 0" range="-0.6 0.6"/><geom size=".03" mass="1"/>
  <body name="{0}_thigh"><joint name="{0}_knee" axis="0 1 0" range="-0.5 0.5"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="2"/>
    <body name="{0}_shin" pos="0 0 -.4"><joint name="{0}_shin" axis="0 1 0" range="-1 1"/>
      <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".03" mass="2"/></body></body>
  <body name="{0}_rod" pos=".1 0 0"><joint name="{0}_rod" axis="0 1 0"/>
    <geom type="capsule" fromto="0 0 0 0 0 -.4" size=".02" mass=".3"/></body></body>"""
FLOATING = """<mujoco model="biped"><compiler angle="radian"/><worldbody><body name="pelvis" pos="0 0 1"><freejoint/>
<geom size=".1" mass="8"/>{0}{1}</body></worldbody>
<equality><connect body1="left_rod" body2="left_shin" anchor="0 0 -.4"/>
<connect body1="right_rod" body2="right_shin" anchor="0 0 -.4"/></equality>
<actuator><motor joint="left_hip"/><motor joint="left_knee"/>
<motor joint="right_hip"/><motor joint="right_knee"/></actuator>
</mujoco>"""
ENDS = """(() => {
    const robot = pm3dof.robot(), home = robot.home();
    return robot.data.sets.map((set, s) => set.numbers.flatMap(({ slider: { range, least, greatest, factor } }, k) =>
        (range || [least / factor, greatest / factor]).map((end) => {
            const values = home.values(set);
            values[k] = end;
            const found = robot.moved(home, set, values);
            return [values, found && found.residual];
        })));
})()"""
VALUES = """rows => {
    const robot = pm3dof.robot(), set = robot.data.sets[0];
    return rows.map((row) => {
        const pose = robot.moved(robot.home(), set, row);
        if (!pose) return null;
        return [pose.residual, pose.values(set), robot.data.tool === null ? null : pose.tool, robot.compliance(pose)];
    });
}"""
OVERLAPS = """(() => {
    const box = (each) => each.getBoundingClientRect();
    const names = ["#panel", "#note", "#tools", "#path:not([hidden])", "#scale:not([hidden])"];
    const seen = names.map((each) => document.querySelector(each)).filter(Boolean);
    const all = [...seen, ...document.querySelectorAll("#labels span")].filter((each) => box(each).width);
    const before = (a, b) => a.right <= b.left + 1 || a.bottom <= b.top + 1;
    const found = [];
    all.forEach((a, i) => all.slice(i + 1).forEach((b) => {
        const apart = before(box(a), box(b)) || before(box(b), box(a));
        const alike = seen.includes(a) === seen.includes(b);
        if (!apart && alike) found.push([a, b].map((each) => each.id || each.textContent));
    }));
    return found;
})()"""

# points of the machine outside the picture, or behind the panel or the buttons
HIDDEN = """(() => {
    const { width, height, behind, above } = pm3dof.pane();
    const places = pm3dof.panel().camera.points.map(pm3dof.project);
    return places.filter(([x, y]) => !(behind <= x && x <= width && above <= y && y <= height));
})()"""
# a flat parallelogram, from which it can leave as such or crossed
FLAT = """<mujoco><worldbody>
<body name="crank"><joint name="crank" axis="0 0 1"/><geom type="capsule" fromto="0 0 0 1 0 0" size=".02"/>
  <body name="coupler" pos="1 0 0"><joint axis="0 0 1"/><geom type="capsule" fromto="0 0 0 .5 0 0" size=".02"/></body>
</body>
<body name="rocker" pos=".5 0 0"><joint axis="0 0 1"/><geom type="capsule" fromto="0 0 0 1 0 0" size=".02"/></body>
<geom type="box" pos="30 0 0" size="9 1 1"/></worldbody>
<equality><connect body1="coupler" body2="rocker" anchor=".5 0 0"/></equality>
<actuator><motor joint="crank"/></actuator></mujoco>"""


@pytest.fixture(scope="module", params=[*ROBOTS, "biped"])
def robot(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Robot:
    if request.param == "biped":
        path = tmp_path_factory.mktemp("biped") / "biped.xml"
        path.write_text(FLOATING.format(LEG.format("left", 0.1), LEG.format("right", -0.1)), encoding="utf-8")
        return Robot.load(path)
    return Robot.load(ROBOTS[request.param])


def test_the_page_moves_every_robot_as_python_does(
    page: Any, robot: Robot, answer: Callable[..., dict[str, Any]], tmp_path: Path
) -> None:
    viewer = Viewer(robot)
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    # ends of the sliders: closed, or out of reach; Python, which also tries detours, reaches more beyond the limits
    for solve, ends in zip((robot.solve, robot.forward), page.ask(ENDS), strict=False):
        expected = solve(np.array([values for values, _ in ends]), on_failure="nan")
        for (values, residual), solved, allowed in zip(ends, expected.solved, expected.within_limits, strict=True):
            assert solved if residual is not None else not allowed, (robot.name, values)
            assert residual is None or residual < 1e-12, (robot.name, values)
    # the numbers of Python at random poses
    home, rng = np.array(robot.home_coordinates), np.random.default_rng(29)
    ranges = [robot.range_of(coordinate) for coordinate in robot.coordinates]
    half = np.array([0.25 * min(high - low, 1.0) for low, high in ranges])
    rows = home + rng.uniform(-1.0, 1.0, (20, len(home))) * half
    poses = robot.solve(rows, on_failure="nan")
    found = page.call(VALUES, rows.tolist())
    for k, shown in enumerate(found):
        assert poses.solved[k] if shown is not None else not poses.within_limits[k]
        if shown is not None:
            assert shown[0] < 1e-12
            np.testing.assert_allclose(shown[1], rows[k], atol=1e-10)
            if robot.tool_frame is not None:
                np.testing.assert_allclose(shown[2], poses.positions[k], atol=1e-10)
    assert poses.solved.any()
    # the compliance that the command prints
    both = [k for k, shown in enumerate(found) if shown is not None and shown[3] is not None and poses.within_limits[k]]
    if robot.springs and robot.tool_frame is not None:
        assert both
        for k, printed in zip(both, printed_compliances(robot, rows[both], answer, tmp_path), strict=True):
            size = np.sqrt(np.diag(printed))
            size[size == 0.0] = 1.0  # rigid directions
            np.testing.assert_allclose(
                np.array(found[k][3]) / np.outer(size, size), printed / np.outer(size, size), atol=1e-9
            )
    # readable and framed at three sizes
    try:
        for size in ((1400, 900), (800, 600), (390, 844)):
            page.browser.resize(*size)
            page.browser.settle()
            assert page.ask(OVERLAPS) == [], size
            assert page.ask("document.documentElement.scrollWidth") <= size[0]
            assert page.ask(HIDDEN) == [], size
        assert page.picture().std() > 0.02
    finally:
        page.browser.resize(800, 600)
    assert page.browser.errors == []


def test_joints_at_a_limit(page: Any, tmp_path: Path) -> None:
    """Balls that do not swing at all, as in a home of zeros, are at none; a strut at the end of its stroke is."""
    robot = Robot.load("hexapod")
    page.open(Viewer(robot, visuals=pin.GeometryModel()).save_html(tmp_path / "page.html").as_uri())
    assert page.ask("[...pm3dof.pose().stoppedJoints()]") == []
    moved = "pm3dof.robot().moved(pm3dof.pose(), pm3dof.robot().data.sets[1], [0.012, 0, 0, 0, 0, 0])"
    assert page.ask(f"[...{moved}.stoppedJoints()]") == [robot.model.getJointId("strut1_joint")]


def printed_compliances(
    robot: Robot, rows: NDArray[np.float64], answer: Callable[..., dict[str, Any]], folder: Path
) -> NDArray[np.float64]:
    """C at poses as `pm3dof stiffness --json` prints them, shape=(n, 6, 6)."""
    turns = np.array([coordinate.unit == "rad" for coordinate in robot.coordinates])
    names = [f"{c.name}_{'deg' if turn else 'm'}" for c, turn in zip(robot.coordinates, turns, strict=True)]
    file = folder / "poses.csv"
    np.savetxt(file, np.where(turns, np.degrees(rows), rows), "%.17g", ",", header=",".join(names), comments="")
    columns = answer("stiffness", "--robot", str(robot.files.path), "--poses", str(file))["columns"]
    axes = ("x", "y", "z", "rx", "ry", "rz")
    full = np.zeros((len(rows), 6, 6))
    for i, j in zip(*np.triu_indices(6), strict=True):
        (name,) = (name for name in columns if name.startswith(f"C_{axes[i]}_{axes[j]}_"))
        full[:, i, j] = full[:, j, i] = columns[name]
    return full


def test_a_home_that_sliders_cannot_leave_says_why(page: Any, tmp_path: Path) -> None:
    path = tmp_path / "flat.xml"
    path.write_text(FLAT, encoding="utf-8")
    page.open(Viewer(Robot.load(path)).save_html(tmp_path / "page.html").as_uri())
    reason = "home is a singular pose, at which 2 branches meet: define a configuration 'home' on one of them"
    assert reason in page.warnings()[0]
    page.drag_slider("crank", 0.8)
    assert reason in page.warnings()[0]
    assert page.slider("crank") == 0.0
    assert "no tool frame (--tool-frame)" in page.ask("document.querySelector('.lack').textContent")
    assert page.ask("pm3dof.panel().camera.box[1][0]") < 2.0  # the obstacle at 30 m is not of the machine
    assert page.browser.errors == []


def test_an_arm_leaves_a_singular_home_by_its_commands(page: Any, tmp_path: Path) -> None:
    """A stretched arm: coordinates lead nowhere, which is said; numbers at its hand stay inside the picture."""
    pytest.importorskip("example_robot_data")
    robot = Robot.load("ur5", tool_frame="tool0").with_drive_stiffness(2e4)
    viewer = Viewer(robot)
    compliance = cartesian_compliance(ElasticModel(robot), robot.home).compliance
    viewer.stiffness_ellipsoid(compliance=compliance, of="compliance")
    page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    try:
        for size in ((800, 600), (390, 844)):
            page.browser.resize(*size)
            page.browser.settle()
            ends = page.ask(
                "[...document.querySelectorAll('#labels span')].map((e) => e.getBoundingClientRect().right)"
            )
            assert ends
            assert max(ends) <= size[0]
            assert page.ask("document.documentElement.scrollWidth") <= size[0]
        assert page.ask("document.getElementById('meshcat-pane').clientHeight") >= 0.48 * 844 - 1
    finally:
        page.browser.resize(800, 600)
    page.ask("pm3dof.slide(0, 0.5)")
    assert page.warnings() == ["Not even a small step is possible, as in a singular pose: move the commands first."]
    page.ask(
        "(pm3dof.chooseSet(1), pm3dof.slide(1, -1.2), pm3dof.slide(2, 1.4), pm3dof.slide(4, 0.8), pm3dof.chooseSet(0))"
    )
    wanted = page.ask("pm3dof.pose().tool[0]") - 0.05
    assert page.ask(f"(pm3dof.slide(0, {wanted}), pm3dof.pose().tool[0])") == pytest.approx(wanted, abs=1e-12)
