"""`pm3dof view` from outside: its files, messages and exit."""

from __future__ import annotations

import os
import re
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.capability.tool_capability import tool_capability
from pm3dof_pin.chapter import Tripod
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.polytopes import tool_polytope

COMMAND = [sys.executable, "-c", "from pm3dof_pin.cli.app import main; main()", "view"]


Run = Callable[..., Any]


@pytest.fixture
def run(run: Run) -> Run:
    """The command in this process, when it does not serve."""
    return partial(run, "view")


@contextmanager
def served(*arguments: str) -> Iterator[tuple[subprocess.Popen[str], str]]:
    """The command while it serves, and its output so far."""
    process = subprocess.Popen([*COMMAND, *arguments], stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    try:
        said = ""
        while "until Ctrl-C" not in said:
            line = process.stderr.readline()
            assert line, said
            said += line
        yield process, said
    finally:
        process.kill()
        process.wait()
        process.stderr.close()


def test_serves_until_it_is_told_to_end() -> None:
    with served("10", "-15", "0.5", "--no-open") as (process, said):
        (address,) = re.findall(r"at (http://\S+) until Ctrl-C", said)
        assert address.startswith("http://127.0.0.1:")
        with urllib.request.urlopen(address) as answer:
            assert b"meshcat-pane" in answer.read()
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=20) == 0
        assert process.stderr is not None
        assert process.stderr.read() == "closed\n"
        port = int(address.rstrip("/").rpartition(":")[2])
        with pytest.raises(ConnectionRefusedError), socket.create_connection(("127.0.0.1", port), timeout=2.0):
            pass


def test_limits_strangers_and_no_screen_are_named_and_the_page_still_served(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A pose beyond a limit, on every interface, where no browser can be opened; it ends by SIGTERM."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]

    def end_when_served() -> None:
        for _ in range(2000):
            with suppress(OSError), urllib.request.urlopen(f"http://127.0.0.1:{port}/") as answer:
                answer.read()
                os.kill(os.getpid(), signal.SIGTERM)
                return
            time.sleep(0.02)

    ending = threading.Thread(target=end_when_served, daemon=True)
    ending.start()
    result = run("0", "0", "0.59", "--host", "0.0.0.0", "--port", str(port))
    ending.join()
    assert result.returncode == 0
    said, _, after = result.stderr.partition("until Ctrl-C")
    assert said.count("joint limit broken: slider") == 3
    assert "anyone who can reach this machine can see the page" in after
    assert "no browser could be opened: open the address yourself" in after
    assert after.endswith("closed\n")


def test_a_taken_port(run: Run) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        result = run("0", "0", "0.5", "--no-open", "--port", str(port))
    assert result.returncode == 1
    assert result.stderr == f"Error: cannot listen on 127.0.0.1, port {port}: Address already in use\n"


@pytest.mark.parametrize(
    ("arguments", "status", "words"),
    [
        (["0", "0", "0.9"], 1, "out of reach"),
        (["--robot", "nobody"], 1, "no robot 'nobody'"),
        (["0", "0", "0.5", "--html", "missing/page.html"], 1, "folder missing does not exist"),
        (["0", "0", "0.5", "--picture", "missing/picture.png"], 1, "folder missing does not exist"),
        (["0", "0"], 2, "pm3dof takes theta_x"),
        (["0", "0", "high"], 2, "high is not a number"),
        (["0", "0", "nan"], 2, "nan is not a finite number"),
        (["0", "0", "0.5", "--of", "beauty"], 2, "beauty"),
        (["0", "0", "0.5", "--shares", "w"], 2, "'w'"),
        (["0", "0", "0.5", "--port", "0"], 2, "--port"),
        (["0", "0", "0.5", "--hmtl", "page.html"], 2, "--hmtl"),
        (
            ["0", "0", "0.5", "--workspace", "colour", "--html", "page.html"],
            1,
            "--workspace = colour: expected",
        ),
        (["--robot", "hexapod", "0", "0", "0.135"], 2, "hexapod takes x"),
        (["10", "0", "0.5", "--path", "path.txt"], 2, "--path cannot be combined"),
        (["--path", "missing.txt"], 1, "missing.txt: expected a readable file"),
        (["--host", "no such host.invalid"], 1, "cannot listen on no such host.invalid"),
    ],
)
def test_bad_input_gives_one_clear_message(
    run: Run, arguments: list[str], status: int, words: str, tmp_path: Path
) -> None:
    result = run(*arguments, cwd=tmp_path)
    assert result.returncode == status, result.stderr
    assert words in result.stderr
    assert "Traceback" not in result.stderr
    assert result.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("0 0 0.49\n0 0\n", "line 2: 2 cells, expected 3 numbers: theta_x_deg"),
        ("0 0 0.49\n\n# nothing\n1 2 three\n", "line 4: z_e_m is 'three', expected a number"),
        ("0 0 0.49\n0 0 inf\n", "line 2: expected finite numbers"),
        ("0 0 0.49\n", "at least two poses"),
        ("0 0 0.49\n0 0 0.9\n", "path.txt: pose 2 is out of reach"),
    ],
)
def test_bad_path_files(run: Run, text: str, words: str, tmp_path: Path) -> None:
    file = tmp_path / "path.txt"
    file.write_text(text, encoding="utf-8")
    result = run("--path", str(file), "--html", str(tmp_path / "page.html"))
    assert result.returncode == 1
    assert words in result.stderr
    assert list(tmp_path.iterdir()) == [file]


def test_no_browser_for_a_picture(run: Run, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PM3DOF_BROWSER", str(tmp_path / "gone"))
    result = run("0", "0", "0.5", "--picture", "picture.png", cwd=tmp_path)
    assert result.returncode == 1
    assert "expected the path of Chromium or Chrome" in result.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_page_of_a_pose_beyond_a_limit(run: Run, tmp_path: Path) -> None:
    result = run("0", "0", "0.59", "--html", "page.html", cwd=tmp_path)
    assert result.returncode == 1
    assert "wrote page.html" in result.stderr
    assert "joint limit broken: slider1_joint" in result.stderr
    assert (tmp_path / "page.html").is_file()


@pytest.mark.browser
def test_a_planar_mechanism_has_an_ellipse(run: Run, tmp_path: Path) -> None:
    """In its plane; two springs hold two of three motions, so that the third is left free."""
    planar = Path(__file__).parents[1] / "machines" / "five_bar" / "five_bar.urdf"
    result = run("--robot", str(planar), "--html", "page.html", cwd=tmp_path)
    assert result.returncode == 0
    assert result.stderr == "wrote page.html\n"
    page = (tmp_path / "page.html").read_text(encoding="utf-8")
    assert "Translation stiffness" in page
    assert "rotations free" in page


def test_the_page_it_writes(run: Run, page: Any, mechanism: Robot, tripod: Tripod, tmp_path: Path) -> None:
    options = ["--shares", "z", "--frames", "--workspace", "felt_stiffness:z", "--of", "compliance"]
    options += ["--effort", "300", "--html"]
    result = run("10", "-15", "0.5", *options, "page.html", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    page.open((tmp_path / "page.html").as_uri())
    where = mechanism.solve([np.radians(10.0), np.radians(-15.0), 0.5]).configuration()
    expected = where.frame_placement("platform").homogeneous
    np.testing.assert_allclose(page.matrix("/robot/platform"), expected, atol=1e-9)
    keys = page.ask("pm3dof.panel().legend.map(entry => [entry.key, Boolean(entry.live)])")
    assert dict(keys) == {
        "translation": True,
        "rotation": True,
        "force_translation_polytope": True,
        "speed_translation_polytope": True,
        "forces": True,
        "load": True,
        "legs": True,
        "frames": False,
        "workspace": False,
    }
    page.ask("pm3dof.slide(2, 0.52)")
    moved = mechanism.solve([np.radians(10.0), np.radians(-15.0), 0.52]).configuration()
    expected = tool_polytope(tool_capability(mechanism, moved, effort=300.0), "force", "translation")
    entry = page.ask("pm3dof.panel().legend.find(({ live }) => live && live.of === 'force').live")
    edges = "pm3dof.node('/polytopes/force_translation/edges/<object>').object.geometry"
    drawn = np.reshape(page.ask(f"[...{edges}.attributes.position.array]"), (-1, 3)) / entry["scale"]
    assert np.linalg.norm(drawn, axis=1).max() == pytest.approx(expected.greatest, rel=1e-4)
    shown = page.ask("pm3dof.panel().legend.filter(({ key }) => key.endsWith('polytope')).map(pm3dof.isShown)")
    assert shown == [True, False]  # the speeds' limits are only described
    assert page.browser.errors == []


@pytest.mark.browser
def test_the_path_it_plays(run: Run, page: Any, tmp_path: Path) -> None:
    (tmp_path / "path.txt").write_text("# TX TY Z\n0 0 0.49\n20, -10, 0.5  # there\n0 0 0.49\n", encoding="utf-8")
    result = run("--path", "path.txt", "--duration", "2", "--html", "page.html", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    page.open((tmp_path / "page.html").as_uri())
    page.ask("(pm3dof.viewer.animator.pause(), pm3dof.viewer.animator.time = 1, pm3dof.viewer.animator.seek(1))")
    page.browser.settle()
    normal = page.matrix("/robot/platform")[:3, 2]
    theta_x, theta_y = np.radians([20.0, -10.0])
    expected = [np.sin(theta_y), -np.sin(theta_x) * np.cos(theta_y), np.cos(theta_x) * np.cos(theta_y)]
    np.testing.assert_allclose(normal, expected, atol=1e-6)
    assert page.browser.errors == []


@pytest.mark.browser
def test_the_picture_it_takes(run: Run, page: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Taken by the tests' browser; the viewer would start its own."""
    from matplotlib.image import imread

    from pm3dof_pin.viewer import browser

    class Lent(browser.Browser):
        def __init__(self, width: int, height: int) -> None:
            page.browser.resize(width, height)

        def __enter__(self) -> Any:
            return page.browser

        def __exit__(self, *error: object) -> None:
            page.browser.resize(800, 600)

    monkeypatch.setattr(browser, "Browser", Lent)
    result = run("--robot", "hexapod", "--picture", "picture.png", "--size", "320", "240", cwd=tmp_path)
    assert result.returncode == 0, result.stderr
    assert imread(tmp_path / "picture.png").shape[:2] == (240, 320)
