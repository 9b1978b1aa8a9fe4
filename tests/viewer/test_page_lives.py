"""The page in the long run and in bad conditions: long dragging, no WebGL, a restarted server, films and links."""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import BrowserError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer, browser

pytestmark = pytest.mark.browser

DRAG_SECONDS = float(os.environ.get("PM3DOF_DRAG_SECONDS", "4"))
# objects that three.js keeps on the graphics card, and nodes of the document
SIZE = """(() => {
    const { geometries, textures } = pm3dof.viewer.renderer.info.memory;
    return [geometries, textures, document.querySelectorAll("*").length];
})()"""
DRAGGING = """seconds => new Promise((done) => {
    const robot = pm3dof.robot(), joint = robot.data.tool_joint, end = performance.now() + 1000 * seconds;
    const [x, y, z] = pm3dof.pose().translation(joint), size = 0.02;
    let moves = 0;
    const step = () => {
        for (let k = 0; k < 10; k++, moves++) {
            const [a, b] = [0.7 * moves, 1.1 * moves];
            pm3dof.drag(joint, [0, 0, 0], [x + size * Math.sin(a), y + size * Math.cos(b), z + size * Math.sin(b)]);
        }
        if (performance.now() < end) setTimeout(step);
        else done([moves, pm3dof.pose().residual]);
    };
    step();
})"""


def heap(page: Any) -> int:
    page.browser.ask("HeapProfiler.collectGarbage")
    return int(page.browser.ask("Runtime.getHeapUsage")["usedSize"])


def test_dragging_leaves_nothing_behind(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    """PM3DOF_DRAG_SECONDS=300 drags for five minutes."""
    robot = load("hexapod")
    page.open(Viewer(robot).save_html(tmp_path / "page.html").as_uri())
    page.call(DRAGGING, 1.0)
    before, bytes_before = page.ask(SIZE), heap(page)
    ends = time.monotonic() + DRAG_SECONDS
    total = 0
    while time.monotonic() < ends:
        moves, residual = page.call(DRAGGING, min(20.0, DRAG_SECONDS))
        assert residual < 1e-12
        total += moves
    page.browser.settle()
    assert total > 10
    after = page.ask(SIZE)
    assert after[:2] == before[:2]
    assert after[2] < before[2] + 100  # warnings about limits
    assert heap(page) < bytes_before + 2_000_000
    assert page.browser.errors == []


@pytest.mark.parametrize("robot", ["hexapod", "three_rps"])
def test_without_webgl_there_is_a_picture_and_a_sentence(
    page: Any, load: Callable[[str], Robot], robot: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    url = Viewer(load(robot)).save_html(tmp_path / "page.html").as_uri()
    flags = [flag for flag in browser._FLAGS if "swiftshader" not in flag]
    monkeypatch.setattr(browser, "_FLAGS", (*flags, "--disable-3d-apis"))
    with type(page.browser)(800, 600) as blind:
        blind.open(url)
        assert blind.evaluate("document.createElement('canvas').getContext('webgl2')") is None
        assert "WebGL" in blind.evaluate("document.getElementById('still').innerText")
        width, height = blind.evaluate(
            "(b => [b.width, b.height])(document.querySelector('#still svg').getBoundingClientRect())"
        )
        assert width > 200
        assert height > 100
        assert blind.evaluate("document.querySelectorAll('#still svg polygon').length") > 10
        visible = "[...document.querySelectorAll('button')].filter(b => b.offsetParent).length"
        assert blind.evaluate(visible) == 0
        assert [error for error in blind.errors if "WebGL" not in error] == []


def test_a_restarted_server_is_found_again(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]  # one that no other process takes next, as it does the first free one from 7000
    with Viewer(load("hexapod"), port=port) as first:
        page.open(first.start())
    wait_for(page, "document.getElementById('note').innerText.includes('has ended')")
    moved = page.ask("(pm3dof.slide(2, 0.137), pm3dof.pose().tool[2])")
    assert moved == pytest.approx(0.137, abs=1e-9)
    with Viewer(load("three_rps"), port=port) as second:
        second.start()
        wait_for(page, "pm3dof.panel().robot === 'three_rps'")
        np.testing.assert_allclose(page.ask("[...pm3dof.pose().q]"), second.mechanism.home.q, atol=1e-12)


def test_the_link_and_the_film(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    robot = load("hexapod")
    page.open(Viewer(robot).save_html(tmp_path / "page.html").as_uri())
    page.ask(
        "(window.copied = [], Object.defineProperty(navigator, 'clipboard',"
        " { value: { writeText: async (text) => { copied.push(text); } } }), pm3dof.slide(2, 0.137), 0)"
    )
    page.ask("document.getElementById('link').click()")
    wait_for(page, "copied.length === 1")
    (link,) = page.ask("copied")
    assert "robot=hexapod" in link
    page.open("about:blank")
    page.open(link)
    assert page.ask("pm3dof.pose().tool[2]") == pytest.approx(0.137, abs=1e-9)
    page.ask(
        "(window.saved = [], HTMLAnchorElement.prototype.click = function () { saved.push(this.download, this.href); },"
        " window.isDrawing = true, document.getElementById('film').click(), 0)"
    )
    wait_for(page, "saved.length === 2")
    name, address = page.ask("saved")
    assert name.startswith("hexapod.")
    start = page.ask(
        f"fetch('{address}').then(r => r.arrayBuffer()).then(b => [b.byteLength, ...new Uint8Array(b, 0, 12)])"
    )
    assert start[0] > 5000
    kinds = {"mp4": bytes(start[5:9]) == b"ftyp", "webm": bytes(start[1:5]) == b"\x1a\x45\xdf\xa3"}
    assert kinds[name.partition(".")[2]]


def wait_for(page: Any, condition: str) -> None:
    for _ in range(300):
        try:
            if page.ask(condition):
                return
        except BrowserError:  # while the page is loaded anew
            pass
        time.sleep(0.1)
    raise AssertionError(condition)
