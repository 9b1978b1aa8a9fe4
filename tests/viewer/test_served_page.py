"""The scene served to a real browser: later drawings appear, and everything shuts down cleanly."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer

pytestmark = pytest.mark.browser


@pytest.fixture
def viewer(mechanism: Robot, tripod: Tripod) -> Iterator[Viewer]:
    with Viewer(mechanism) as started:
        yield started


def opened(page: Any, viewer: Viewer) -> None:
    page.open(viewer.start())
    page.ask(CONNECTED)


# resolves once the page has received the scene over its socket and made its sliders
CONNECTED = """new Promise(done => {
    const isMade = () => pm3dof.panel().legend && document.querySelector("#sliders input[type=range]");
    const look = () => isMade() ? done(true) : setTimeout(look, 20);
    look();
})"""


def shows_pose(page: Any, pose: np.ndarray) -> None:
    """Wait until the page has the pose that Python displays."""
    page.call(
        """pose => new Promise(done => {
            const shown = () => pm3dof.pose().values(pm3dof.robot().data.sets[0]);
            const near = () => shown().every((value, index) => Math.abs(value - pose[index]) < 1e-12);
            const look = () => near() ? done(true) : setTimeout(look, 20);
            look();
        })""",
        pose.tolist(),
    )


def test_what_is_drawn_later_appears(page: Any, viewer: Viewer, mechanism: Robot, tripod: Tripod) -> None:
    opened(page, viewer)
    pose = np.array([0.25, -0.1, 0.47])
    where = mechanism.solve(pose).configuration()
    viewer.display(where)
    stiffness = cartesian_compliance(ElasticModel(mechanism), where).stiffness
    drawn = viewer.stiffness_ellipsoid(stiffness, kind="rotation")
    shows_pose(page, pose)
    page.ask("""new Promise(done => {
        const look = () => pm3dof.panel().legend.length ? done(true) : setTimeout(look, 20);
        look();
    })""")
    expected = where.frame_placement("platform").homogeneous
    np.testing.assert_allclose(page.matrix("/robot/platform"), expected, atol=1e-9)
    np.testing.assert_allclose(page.matrix("/ellipsoids/rotation"), drawn.transform, atol=1e-9)
    degrees = [page.slider("theta_x"), page.slider("theta_y")]
    np.testing.assert_allclose(degrees, np.degrees(pose[:2]), atol=0.051)
    viewer.display(mechanism.home)
    shows_pose(page, tripod.home)
    assert not page.is_visible("/ellipsoids/rotation")


def test_the_sliders_live_in_the_served_page_too(page: Any, viewer: Viewer, mechanism: Robot, tripod: Tripod) -> None:
    """With the server and after it has ended; no request leaves the machine."""
    opened(page, viewer)
    address = viewer.start()
    assert set(page.browser.requests) == {address, f"{address.replace('http', 'ws')}socket"}
    theta_y = page.drag_slider("theta_y", 0.7)
    where = mechanism.solve([0.0, np.radians(theta_y), tripod.height_home]).configuration()
    np.testing.assert_allclose(page.matrix("/robot/platform"), where.frame_placement("platform").homogeneous, atol=1e-9)
    assert "in this page" in page.note()
    viewer.close()
    page.ask("""new Promise(done => {
        const ended = () => document.getElementById("note").innerText.includes("ended");
        const look = () => ended() ? done(true) : setTimeout(look, 20);
        look();
    })""")
    page.ask("pm3dof.slide(0, 0.2)")
    assert "in this page" in page.note()
    assert [error for error in page.browser.errors if "CONNECTION_REFUSED" not in error] == []  # it tries again


def test_a_second_browser_gets_all_there_is(page: Any, viewer: Viewer) -> None:
    viewer.frames()
    viewer.set_title("my machine", "of today")
    opened(page, viewer)
    assert page.is_visible("/robot/platform/frames/O_e")
    assert page.ask("document.querySelector('h1').textContent") == "my machine"
    viewer.close()
    page.open(viewer.start())  # serves again
    page.ask(CONNECTED)
    assert page.is_visible("/robot/platform/frames/O_e")
