"""Showing a scene: served to a browser, in a notebook, as one file, as a picture.

The page is one HTML file: meshcat's program, the panel, the robot's programs, and the whole scene.
"""

from __future__ import annotations

import importlib.util
import json
import os
import sys
import threading
import webbrowser
from dataclasses import dataclass
from functools import lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Self

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import write_atomically, write_text_atomically
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer.panel import Entry
from pm3dof_pin.viewer.scene import Json, Scene

if TYPE_CHECKING:
    from pm3dof_pin.viewer.server import SceneServer

_PARTS = (
    *("ellipsoids", "polytopes", "labels", "ghosts", "load", "free_motion", "workspace", "path", "trace", "pointer"),
    *("settings", "tools"),
)


@dataclass(frozen=True)
class NotebookCell:
    """A page in an iframe: its attribute `src` or `srcdoc`, and its height [pixels]."""

    source: str
    height: int

    def _repr_html_(self) -> str:
        return f'<iframe {self.source} style="width: 100%; height: {self.height}px; border: none"></iframe>'


class ShownScene:
    """A scene with its panel, and the ways to show it. Nothing is served and no browser is needed until requested.

    It is served on `host`, by default only this machine, and `port`, by default the first free one from 7000.
    """

    def __init__(self, title: str, host: str = "127.0.0.1", port: int | None = None) -> None:
        self.scene = Scene()
        self._panel: Json = {"title": title, "subtitle": "", "note": []}
        self._entries: dict[str, Entry] = {}
        self._beside: dict[str, Array] = {}  # points, by entry, to be in the picture besides the machine
        self.host = host
        self._port = port
        self._server: SceneServer | None = None

    @property
    def is_served(self) -> bool:
        """Whether browsers may be looking at it."""
        return self._server is not None

    def start(self) -> str:
        """Serve the scene, if it is not yet served, and return the URL for a browser.

        Raises:
            ServerError: the port is in use, or the host is not an address of this machine.
        """
        from pm3dof_pin.viewer.server import SceneServer

        if self._server is None:
            self._server = SceneServer(self.scene, lambda: self._page(served=True), self.host, self._port)
        return self._server.url

    def open(self) -> bool:
        """Serve the scene as :meth:`start`; return whether a browser was opened, which needs a screen."""
        url = self.start()
        has_screen = sys.platform in ("darwin", "win32") or {"DISPLAY", "WAYLAND_DISPLAY"} & set(os.environ)
        return bool(has_screen) and webbrowser.open(url, new=2)

    def wait(self) -> None:
        """Keep serving until the program is interrupted."""
        threading.Event().wait()

    def close(self) -> None:
        """Stop serving; a second call does nothing."""
        if self._server is not None:
            self._server.close()
            self._server = None

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def html(self) -> str:
        """Return the scene as one self-contained page."""
        return self._page(served=False)

    def save_html(self, path: Path | str) -> Path:
        """Write the scene as one page and return the path.

        Raises:
            OutputError: the folder does not exist, or the file cannot be written; no partial file is left.
        """
        return write_text_atomically(_in_existing_folder(path), self.html())

    def save_picture(self, path: Path | str, *, width: int = 1200, height: int = 900) -> Path:
        """Write a picture of the scene (PNG), size in pixels, taken by a headless browser, and return the path.

        Raises:
            OutputError: the folder does not exist, or the file cannot be written; no partial file is left.
            BrowserError: there is no Chromium or Chrome, or it cannot draw.
        """
        from pm3dof_pin.viewer.browser import Browser

        target = _in_existing_folder(path)
        (png,) = Browser.pictures_of(self.html(), width, height)
        with write_atomically(target) as temporary:
            temporary.write_bytes(png)
        return target

    def capture_image(self, width: int = 1200, height: int = 900) -> NDArray[np.uint8]:
        """Return the picture of :meth:`save_picture` without the panel, shape=(height, width, 3) in 0 .. 255."""
        import io

        from PIL import Image

        from pm3dof_pin.viewer.browser import Browser

        (png,) = Browser.pictures_of(self.html(), width, height, bare=True)
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))

    captureImage = capture_image  # noqa: N815
    """As Pinocchio's MeshcatVisualizer calls it."""

    def record(
        self, path: Path | str, *, width: int = 640, height: int = 480, count: int = 48, duration: float = 6.0
    ) -> Path:
        """Write a film (GIF, or MP4 with ffmpeg) without the panel, like :meth:`save_picture`, and return the path.

        It shows the path that is played, frame by frame in its own time; without one, the camera circles the machine
        once in a duration [s], in `count` pictures.

        Raises:
            InvalidValueError: the name ends neither in .gif nor in .mp4.
            OutputError, BrowserError: as :meth:`save_picture`; or ffmpeg is missing.
        """
        from pm3dof_pin.viewer.browser import Browser
        from pm3dof_pin.viewer.film import write_film

        target = _in_existing_folder(path)
        if played := self._panel.get("path"):
            steps = [f"pm3dof.go({frame})" for frame in range(len(played["frames"]))]
            duration = played["duration"]
        else:
            steps = [f"pm3dof.turn({360.0 / count if k else 0.0})" for k in range(count)]
        return write_film(target, Browser.pictures_of(self.html(), width, height, bare=True, steps=steps), duration)

    def jupyter_cell(self, height: int = 600, *, static: bool = False) -> NotebookCell:
        """Return the scene for the last line of a notebook cell, as a frame of a height [pixels].

        The served scene follows later drawing; a static copy also works if the browser is on another machine.
        """
        if static:
            return NotebookCell(f'srcdoc="{escape(self.html())}"', height)
        return NotebookCell(f'src="{escape(self.start())}"', height)

    def set_title(self, title: str, subtitle: str = "") -> None:
        """Set the heading of the panel; by default the name of the mechanism."""
        self._panel |= {"title": title, "subtitle": subtitle}
        self._update()

    def _show(self, entry: Entry) -> None:
        self._entries[entry.key] = entry
        for path in entry.nodes:
            self.scene.set_visible(path, entry.visible)
        for item in entry.paint or []:
            self.scene.set_colour(item["path"], [*item["colour"], item["own"][3]] if entry.visible else item["own"])
        self._update()

    def _remove_entry(self, entry: Entry) -> None:
        del self._entries[entry.key]
        self._beside.pop(entry.key, None)
        for path in entry.nodes:
            self.scene.set_visible(path, False)
        for item in entry.paint or []:
            self.scene.set_colour(item["path"], item["own"])

    def _update(self) -> None:
        self.scene.set_panel(self._panel | {"legend": [entry.to_json() for entry in self._entries.values()]})

    def _page(self, *, served: bool) -> str:
        title = str(self.scene.panel.get("title", ""))
        scene = {} if served else self.scene.snapshot()
        return _page_html(scene, title=title, served=served, programs=self._program_source(), still=self._still())

    def _still(self) -> str:
        """Return a picture (SVG) for browsers without WebGL."""
        return ""

    def _program_source(self) -> str:
        """Return the JavaScript that moves the robot in the page, see :mod:`pm3dof_pin.viewer.page_programs`."""
        return ""


def _in_existing_folder(path: Path | str) -> Path:
    target = Path(path)
    if not target.parent.is_dir():
        raise OutputError(target, f"folder {target.parent} does not exist")
    return target


def _page_html(scene: Json, *, title: str, served: bool, programs: str = "", still: str = "") -> str:
    """Return the page of a scene's snapshot with the programs of its sliders; a served page listens for changes."""
    data = json.dumps(scene, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":  # "</script>" and "<!--" take effect even inside a string
        data = data.replace(sign, f"\\u{ord(sign):04x}")
    return Template(_asset("page.html")).substitute(
        title=escape(title),
        style=_asset("page.css"),
        still=still,
        socket="yes" if served else "no",
        licences=_meshcat_file("LICENSE") + "\n" + _meshcat_file("dist/main.min.js.LICENSE.txt"),
        meshcat=_meshcat_file("dist/main.min.js"),
        programs=programs or "const programs = null;",
        robot=_asset("robot.js"),
        page=_asset("page.js"),
        parts="\n".join(_asset(f"{name}.js") for name in _PARTS),
        scene=data,
    )


@lru_cache
def _asset(name: str) -> str:
    return files("pm3dof_pin.viewer").joinpath("assets", name).read_text(encoding="utf-8")


@lru_cache
def _meshcat_file(name: str) -> str:
    # located, not imported: the package would import IPython and its own servers
    specification = importlib.util.find_spec("meshcat")
    assert specification is not None
    assert specification.origin is not None
    return (Path(specification.origin).parent / "viewer" / name).read_text(encoding="utf-8")
