"""Labels in the scene: names of points that move with their bodies, and lengths and angles of the schematic."""

from __future__ import annotations

import base64
import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from pm3dof_pin.exceptions import FrameNotFoundError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.scene import Json

_POINT = re.compile(r"([A-Z])_?(\w{0,2})")  # names of points: B1, D_2, O_e, P
_INK, _MEASURE = "#111111", "#B03A2E"
_DPI = 200
_LONG = 12  # characters
_LEG = ("B3", "D3", "E3")  # the one in front of the camera

_ANGLE = re.compile(r"(?:r|theta_|rot_)([xyz])")  # names of angles of the tool: rx, theta_x
# names that programs give to every robot, and those of the usual folders
_NAMELESS = {"onshape", "mujoco model", "mujoco", "robot", "model", "urdf", "mjcf", "sdf", "xacro", "robots", "", "."}
_SPOKEN = re.compile(r"[aeiouy]")


def display_name(name: str) -> str:
    """Return a robot's name as people write it: Hexapod, Three RPS, UR5, Linear delta; names with capitals as given."""
    words = re.split(r"[_\-\s]+", name)
    if not name.islower():
        return " ".join(words)
    spelled = [word if _SPOKEN.search(word) and not re.search(r"\d", word) else word.upper() for word in words]
    return " ".join([spelled[0][:1].upper() + spelled[0][1:], *spelled[1:]])


def display_title(mechanism: Mechanism) -> str:
    """Return the title of a robot: its name, or that of its file or folder where the name is a program's or none."""
    parts = [mechanism.name, *reversed(Path(mechanism.source).with_suffix("").parts)]
    return display_name(next((part for part in parts if part.lower() not in _NAMELESS), mechanism.name))


def display_label(name: str) -> str:
    """Return a coordinate's name as people say it: rx is "tilt about x", wrist_1_joint "wrist 1"."""
    if angle := _ANGLE.fullmatch(name):
        return f"{'turn' if angle[1] == 'z' else 'tilt'} about {angle[1]}"
    words = [word for word in re.split(r"[_\-\s]+", name) if word not in ("joint", "")]
    return " ".join(words) if words and all(len(word) > 1 or word.isdigit() for word in words) else name


def point_names(configuration: Configuration) -> dict[str, str]:
    """Return the frames with short point names, and the tool's, with their mathematical text.

    Several at one place share a text: O_e = P.
    """
    mechanism = configuration.mechanism
    names = [frame.name for frame in mechanism.model.frames if _POINT.fullmatch(frame.name)]
    tool = [mechanism.tool_frame] if mechanism.tool_frame else []
    found: dict[str, str] = {}
    places: dict[str, Array] = {}
    for name in dict.fromkeys([*tool, *names]):
        place = configuration.frame_placement(name).translation
        same = next((other for other, known in places.items() if np.allclose(place, known, atol=SOLVED)), None)
        if same is None:
            found[name], places[name] = _in_symbols(name), place
        else:
            found[same] += f" = {_in_symbols(name)}"
    return found


def measures(configuration: Configuration) -> dict[str, tuple[str, Array]]:
    """Return frame and position, base axes [m], of the lengths and angles of Fig. 8.1b at one leg, by symbol."""
    try:
        b, d, e, tool = (configuration.frame_placement(name).translation for name in (*_LEG, "O_e"))
    except FrameNotFoundError:
        return {}
    base, slider, ball = _LEG
    along, inward = (d - b) / np.linalg.norm(d - b), -b / np.linalg.norm(b)
    across = np.linalg.norm(b)
    return {
        "O_b": (base, np.zeros(3)),
        r"\alpha_i": (base, 0.12 * (2.0 * b + [across, 0.0, 0.0])),
        r"\beta_i": (ball, tool + 0.25 * (e - tool) + [0.2 * np.linalg.norm(e - tool), 0.0, 0.0]),
        r"\gamma": (base, b + 0.2 * across * (along + inward)),
        "l_b": (base, 0.6 * b),
        "u_i": (base, 0.4 * b + 0.6 * d),
        "l_i": (slider, 0.7 * d + 0.3 * e),
        "l_e": (ball, tool + 0.6 * (e - tool)),
        "z_0": (ball, tool + 0.5 * (e - tool) * [0.0, 0.0, 1.0]),
        "z_e": (base, 0.35 * tool),
    }


def _in_symbols(name: str) -> str:
    found = _POINT.fullmatch(name)
    if found is None:
        return rf"\mathrm{{{name.replace('_', chr(92) + '_')}}}"
    return f"{found[1]}_{{{found[2]}}}" if found[2] else found[1]


def label(text: str, height: float, *, measure: bool = False) -> Json:
    """Return mathematical text as a picture of a height [m] at the origin, facing the camera, never hidden."""
    picture, shape = _picture(text, _MEASURE if measure else _INK)
    sprite = objects.sprite(picture)
    sprite["object"]["matrix"] = np.diag([height * shape[1] / shape[0], height, 1.0, 1.0]).ravel().tolist()
    return sprite


def _picture(text: str, color: str) -> tuple[str, Sequence[int]]:
    """Return a picture of a text as a data URL, and its height and width."""
    from matplotlib.patheffects import withStroke

    from pm3dof_pin.figures.style import house_style, new_figure

    with house_style():
        width = 1.0 if "=" in text or len(text) > _LONG else 0.5
        figure = new_figure(width, 0.5)
        figure.patch.set_alpha(0.0)
        effects = [withStroke(linewidth=3.0, foreground="white")]
        figure.text(0.5, 0.5, f"${text}$", fontsize=18, color=color, ha="center", va="center", path_effects=effects)
        stream = io.BytesIO()
        figure.savefig(stream, format="png", dpi=_DPI, transparent=True, metadata={"Software": None})
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return f"data:image/png;base64,{data}", (_DPI // 2, round(_DPI * width))
