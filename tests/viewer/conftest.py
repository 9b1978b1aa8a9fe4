"""A browser for the tests, and readings from its page."""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from pm3dof_pin.description.robots import robots_directory
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import BrowserError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import page_programs, viewer
from pm3dof_pin.viewer.browser import Browser, find_browser
from pm3dof_pin.viewer.page_programs import PagePrograms

Array = NDArray[np.float64]


# Software rendering takes most of the time of these tests, and few of them check pixels.
DRAWING_ON_DEMAND = """
for (const kind of ["drawArrays", "drawArraysInstanced", "drawElements", "drawElementsInstanced"]) {
    const draw = WebGL2RenderingContext.prototype[kind];
    WebGL2RenderingContext.prototype[kind] = function (...words) {
        if (window.isDrawing) draw.apply(this, words);
    };
}
"""


class WatchedBrowser(Browser):
    """A browser with mouse and keyboard control, and a record of the page's errors and requests."""

    def __init__(self, width: int, height: int) -> None:
        self.errors: list[str] = []
        self.requests: list[str] = []
        super().__init__(width, height)
        for domain in ("Runtime", "Log", "Network"):
            self.ask(f"{domain}.enable")

    def on_message(self, event: dict[str, Any]) -> None:
        super().on_message(event)
        method, details = event["method"], event.get("params", {})
        if method == "Runtime.exceptionThrown":
            thrown = details["exceptionDetails"]
            self.errors.append(thrown.get("exception", {}).get("description") or thrown["text"])
        elif method == "Runtime.consoleAPICalled" and details["type"] in ("error", "warning", "assert"):
            said = (str(entry.get("value", entry.get("description", ""))) for entry in details["args"])
            self.errors.append(f"console.{details['type']}: {' '.join(said)}")
        elif method == "Log.entryAdded" and details["entry"]["level"] in ("error", "warning"):
            self.errors.append(f"{details['entry']['source']}: {details['entry']['text']}")
        elif method == "Network.requestWillBeSent":
            self.requests.append(details["request"]["url"])
        elif method == "Network.webSocketCreated":
            self.requests.append(details["url"])

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        """Drag the mouse from one point of the page to another [pixels]."""
        pressed = {"button": "left", "clickCount": 1}
        for kind, (x, y), details in (
            ("mouseMoved", start, {}),
            ("mousePressed", start, pressed),
            ("mouseMoved", end, {"button": "left"}),
            ("mouseReleased", end, pressed),
        ):
            self.ask("Input.dispatchMouseEvent", {"type": kind, "x": x, "y": y, **details})
        self.settle()

    def press(self, key: str) -> None:
        """Press and release a key, such as "ArrowLeft"."""
        code = {"ArrowLeft": 37, "ArrowUp": 38, "ArrowRight": 39, "ArrowDown": 40}[key]
        for kind in ("keyDown", "keyUp"):
            self.ask("Input.dispatchKeyEvent", {"type": kind, "key": key, "code": key, "windowsVirtualKeyCode": code})
        self.settle()


class Page:
    """The page of a viewer in the browser; its scene is drawn for :meth:`picture` only."""

    def __init__(self, browser: WatchedBrowser) -> None:
        self.browser = browser

    def open(self, url: str) -> None:
        self.browser.errors.clear()
        self.browser.requests.clear()
        self.browser.open(url)

    def open_again(self, url: str) -> None:
        """Open a page, or reset it if it is already open, which is faster.

        The user's choices remain in an open page, and appear in its URL after a while.
        """
        if self.ask("location.href") != url or self.ask("Boolean(pm3dof.choice() || pm3dof.wrench())"):
            self.open(url)
        else:
            self.ask("pm3dof.receive(JSON.parse(document.getElementById('scene').textContent))")
            self.browser.settle()

    def ask(self, expression: str) -> Any:
        return self.browser.evaluate(expression)

    def call(self, function: str, *arguments: object) -> Any:
        return self.ask(f"({function})({', '.join(json.dumps(argument) for argument in arguments)})")

    def matrix(self, path: str) -> Array:
        """World transform of a node of the scene graph, from three.js itself."""
        elements = self.call(
            """path => {
                const object = pm3dof.node(path).object;
                object.updateWorldMatrix(true, false);
                return pm3dof.viewer.scene.matrixWorld.clone().invert().multiply(object.matrixWorld).elements;
            }""",
            path,
        )
        return np.array(elements).reshape(4, 4).T

    def is_visible(self, path: str) -> bool:
        return bool(self.call("path => pm3dof.node(path).object.visible", path))

    def colour(self, path: str) -> Array:
        """The colour of the material of an object."""
        return np.array(self.call("path => pm3dof.node(path + '/<object>').object.material.color.toArray()", path))

    def note(self) -> str:
        return str(self.ask("document.getElementById('note').innerText"))

    def warnings(self) -> list[str]:
        return list(self.ask("[...document.querySelectorAll('#note .warning')].map(line => line.textContent)"))

    def values(self, key: str) -> str:
        return str(self.call("key => document.querySelector(`[data-key=${key}] .values`).textContent", key))

    def tick(self, key: str) -> None:
        """Click on the checkbox of an entry of the legend."""
        self.call("key => document.querySelector(`[data-key=${key}] input`).click()", key)
        self.browser.settle()

    def drag_slider(self, name: str, place: float) -> float:
        """Drag a slider to a place between 0 and 1 with the mouse, and return the number it then shows."""
        left, top, width, height = self.call(
            """name => {
                const slider = document.querySelector(`#sliders input[type=range][name="${name}"]`);
                const box = slider.getBoundingClientRect();
                return [box.left, box.top, box.width, box.height];
            }""",
            name,
        )
        middle = top + 0.5 * height
        self.browser.drag((left + 0.5 * width, middle), (left + place * width, middle))
        return self.slider(name)

    def slider(self, name: str) -> float:
        """The value of a slider [deg, m]."""
        return float(self.call("name => document.querySelector(`#sliders input[name='${name}']`).value", name))

    def picture(self) -> Array:
        """The screenshot, shape=(height, width, 3), in 0 .. 1."""
        from matplotlib.image import imread

        self.ask("window.isDrawing = true, pm3dof.viewer.set_dirty()")
        try:
            picture = self.browser.picture()
        finally:
            self.ask("window.isDrawing = false")
        return np.asarray(imread(io.BytesIO(picture), format="png"))[..., :3].astype(float)


@pytest.fixture(scope="session")
def load() -> Callable[[str], Robot]:
    """Robots of the package, loaded once: page programs are traced once for each."""
    return cache(Robot.load)


@pytest.fixture(scope="session")
def traced() -> dict[tuple[str, str], PagePrograms | None]:
    """The cache of :func:`_traced_once`."""
    return {}


@pytest.fixture(autouse=True)
def _traced_once(traced: dict[tuple[str, str], PagePrograms | None], monkeypatch: pytest.MonkeyPatch) -> None:
    """Trace the programs of a page once per robot of the package, however often tests and commands load it."""

    def programs_of(robot: Robot, model: ElasticModel | None = None) -> PagePrograms | None:
        key = str(robot.source), str(robot.tool_frame)
        if model is not None or not key[0].startswith(str(robots_directory())):
            return page_programs.programs_of(robot, model)
        if key not in traced:
            traced[key] = page_programs.programs_of(robot)
        return traced[key]

    monkeypatch.setattr(viewer, "programs_of", programs_of)


@pytest.fixture(scope="session")
def started_browser() -> Iterator[WatchedBrowser]:
    try:
        find_browser()
    except BrowserError as error:
        pytest.skip(str(error))
    with WatchedBrowser(800, 600) as started:
        started.ask("Page.addScriptToEvaluateOnNewDocument", {"source": DRAWING_ON_DEMAND})
        yield started


@pytest.fixture(scope="module")
def browser(started_browser: WatchedBrowser) -> Iterator[WatchedBrowser]:
    yield started_browser
    started_browser.open("about:blank")  # an open page takes a processor from all later tests


@pytest.fixture
def page(browser: WatchedBrowser) -> Page:
    return Page(browser)


@pytest.fixture
def write_robot(tmp_path: Path) -> Any:
    """Writes a URDF with its closures file and returns the URDF's path."""

    def write(urdf: str, closures: str = "name_mot: []\n") -> Path:
        path = tmp_path / "robot.urdf"
        path.write_text(urdf, encoding="utf-8")
        path.with_name("robot.closures.yaml").write_text(closures, encoding="utf-8")
        return path

    return write
