"""The page as one HTML file: meshcat's program, the panel, the robot's programs, and the whole scene."""

from __future__ import annotations

import importlib.util
import json
from functools import lru_cache
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

from pm3dof_pin.viewer.scene import Json

_PARTS = ("ellipsoids", "workspace", "path", "pointer", "settings")


def page_html(scene: Json, *, title: str, served: bool, programs: str = "") -> str:
    """Return the page of a scene's snapshot with the programs of its sliders; a served page listens for changes."""
    data = json.dumps(scene, separators=(",", ":"), allow_nan=False)
    for sign in "<>&\u2028\u2029":  # "</script>" and "<!--" take effect even inside a string
        data = data.replace(sign, f"\\u{ord(sign):04x}")
    return Template(_asset("page.html")).substitute(
        title=escape(title),
        style=_asset("page.css"),
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
