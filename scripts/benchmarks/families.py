"""Families of large robots, written as a stranger would: a URDF of the tree and a closures file beside it.

    python scripts/benchmarks/families.py FAMILY SIZE FOLDER [tilted]

Placements are computed here from drawings, so that zero is an assembled configuration.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import ArrayLike, NDArray
from pinocchio.rpy import matrixToRpy, rpyToMatrix

_LIMITS = {"revolute": (-0.5, 0.5), "prismatic": (-0.05, 0.05)}
_STIFFNESS: Mapping[str, Mapping[str, float | str]] = {
    "revolute": {"stiffness": 1e4, "unit": "N m/rad"},
    "prismatic": {"stiffness": 1e7, "unit": "N/m"},
}
_STANDING = """<link name="ground"/><joint name="standing" type="fixed"><origin xyz="0 0 0" rpy="0.3 0.2 1.1"/>\
<parent link="ground"/><child link="base"/></joint>"""


class Drawing:
    """Links and joints of a tree, and its closures."""

    def __init__(self, name: str) -> None:
        self.name = name
        self.kinds: dict[str, str] = {}
        self.closures: list[tuple[str, str]] = []
        self.drives: list[str] = []
        self.tool = ""
        self._elements: list[str] = []
        self._link("base")

    def _link(self, name: str) -> None:
        inertia = '<inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/>'
        self._elements.append(f'<link name="{name}"><inertial><mass value="0.2"/>{inertia}</inertial></link>')

    def joint(
        self,
        parent: str,
        name: str,
        at: ArrayLike = (0.0, 0.0, 0.0),
        rpy: ArrayLike = (0.0, 0.0, 0.0),
        kind: str = "fixed",
        axis: ArrayLike = (0.0, 0.0, 1.0),
        limits: tuple[float, float] | None = None,
    ) -> str:
        """Attach a link called `name` by a joint called `name`_joint; return the link."""
        self._link(name)
        place, turn, along = (" ".join(repr(float(v)) for v in np.asarray(vector)) for vector in (at, rpy, axis))
        text = f'<origin xyz="{place}" rpy="{turn}"/><parent link="{parent}"/><child link="{name}"/>'
        if kind != "fixed":
            lower, upper = limits or _LIMITS[kind]
            text += f'<axis xyz="{along}"/><limit lower="{lower}" upper="{upper}" effort="100" velocity="5"/>'
            self.kinds[f"{name}_joint"] = kind
        self._elements.append(f'<joint name="{name}_joint" type="{kind}">{text}</joint>')
        return name

    def close(self, a: str, at_a: ArrayLike, b: str, at_b: ArrayLike) -> None:
        """Join points of two links."""
        number = len(self.closures)
        pair = (self.joint(a, f"end{number}a", at_a), self.joint(b, f"end{number}b", at_b))
        self.closures.append(pair)

    def write(self, folder: Path, *, tilted: bool = False) -> Path:
        """Write the description into a folder, level or on a base yawed and tilted; return the URDF's path."""
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{self.name}.urdf"
        elements = "\n".join([_STANDING] * tilted + self._elements)
        path.write_text(f'<robot name="{self.name}">\n{elements}\n</robot>\n', encoding="utf-8")
        springs = [{"name": d, "type": "joint", "joint": d, **_STIFFNESS[self.kinds[d]]} for d in self.drives]
        closures = {
            "closed_loop": [list(pair) for pair in self.closures],
            "type": ["3d"] * len(self.closures),
            "name_mot": self.drives,
            "tool_frame": self.tool,
            "springs": springs,
        }
        path.with_suffix(".closures.yaml").write_text(yaml.safe_dump(closures, sort_keys=False), encoding="utf-8")
        return path


def _circle(radius: float, angle: float, height: float) -> NDArray[np.float64]:
    return np.array([radius * math.cos(angle), radius * math.sin(angle), height])


def _pointing(direction: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the roll, pitch and yaw of a frame whose z axis has a direction."""
    z = direction / np.linalg.norm(direction)
    side = np.cross([0.0, 1.0, 0.0], z)
    x = side / np.linalg.norm(side)
    return np.asarray(matrixToRpy(np.column_stack([x, np.cross(z, x), z])))


def _platform(drawing: Drawing, base: str, prefix: str, height: float) -> str:
    """Attach a free platform by three slides and three turns."""
    link = base
    for k, kind in enumerate(("prismatic",) * 3 + ("revolute",) * 3):
        at = (0.0, 0.0, height) if k == 0 else (0.0, 0.0, 0.0)
        link = drawing.joint(link, f"{prefix}{'xyzabc'[k]}", at, kind=kind, axis=np.eye(3)[k % 3])
    return link


def _struts(drawing: Drawing, base: str, platform: str, prefix: str, count: int, height: float) -> list[str]:
    """Join two platforms by universal-prismatic-spherical legs; return the sliding joints."""
    slides = []
    for k in range(count):
        foot = _circle(0.2, 2.0 * math.pi * (k // 2 * 2 + 0.2 * (-1) ** k) / (2 * math.ceil(count / 2)), 0.02)
        head = _circle(0.15, 2.0 * math.pi * (k // 2 * 2 + 0.8 * (-1) ** k) / (2 * math.ceil(count / 2)), -0.02)
        along = head + np.array([0.0, 0.0, height]) - foot
        cross = drawing.joint(base, f"{prefix}u{k}", foot, _pointing(along), "revolute", (1.0, 0.0, 0.0))
        lower = drawing.joint(cross, f"{prefix}v{k}", kind="revolute", axis=(0.0, 1.0, 0.0))
        middle = (0.0, 0.0, 0.5 * float(np.linalg.norm(along)))
        rod = drawing.joint(lower, f"{prefix}s{k}", middle, kind="prismatic")
        drawing.close(rod, middle, platform, head)
        slides.append(f"{prefix}s{k}_joint")
    return slides


def legs(count: int) -> Drawing:
    """Draw a platform on n universal-prismatic-spherical legs: more than six drive it redundantly.

    With fewer, the second axes of the universal joints are driven too, as many as are missing.
    """
    drawing = Drawing(f"legs{count}")
    drawing.tool = _platform(drawing, "base", "p", 0.3)
    drawing.drives = _struts(drawing, "base", drawing.tool, "", count, 0.3)
    drawing.drives += [f"v{k}_joint" for k in range(max(0, 6 - count))]
    return drawing


def stacked(count: int) -> Drawing:
    """Draw n hexapods, each on the platform of the one below."""
    drawing = Drawing(f"stacked{count}")
    link = "base"
    for level in range(count):
        platform = _platform(drawing, link, f"p{level}", 0.3)
        drawing.drives += _struts(drawing, link, platform, f"l{level}", 6, 0.3)
        link = platform
    drawing.tool = link
    return drawing


def scissor(count: int) -> Drawing:
    """Draw a lift of n pairs of crossed bars, driven by the slide of one foot."""
    drawing = Drawing(f"scissor{count}")
    half, angle = 0.25, 0.6
    c = half * math.cos(angle)
    axis = (0.0, 1.0, 0.0)
    slide = drawing.joint("base", "slide", (2.0 * c, 0.0, 0.0), kind="prismatic", axis=(1.0, 0.0, 0.0))
    drawing.drives = ["slide_joint"]
    # bars rise by turning about -y; x along a bar
    left = drawing.joint("base", "a0", (0.0, 0.0, 0.0), (0.0, -angle, 0.0), "revolute", axis)
    right = drawing.joint(slide, "b0", (0.0, 0.0, 0.0), (0.0, angle - math.pi, 0.0), "revolute", axis)
    drawing.close(left, (half, 0.0, 0.0), right, (half, 0.0, 0.0))
    for k in range(1, count):
        next_right = drawing.joint(
            left, f"b{k}", (2.0 * half, 0.0, 0.0), (0.0, 2.0 * angle - math.pi, 0.0), "revolute", axis
        )
        next_left = drawing.joint(
            right, f"a{k}", (2.0 * half, 0.0, 0.0), (0.0, math.pi - 2.0 * angle, 0.0), "revolute", axis
        )
        drawing.close(next_left, (half, 0.0, 0.0), next_right, (half, 0.0, 0.0))
        left, right = next_left, next_right
    # the top plate turns on the right bar, whose end is on the left, and slides on the left bar's end
    plate = drawing.joint(right, "plate", (2.0 * half, 0.0, 0.0), (0.0, math.pi - angle, 0.0), "revolute", axis)
    shoe = drawing.joint(plate, "shoe", (2.0 * c, 0.0, 0.0), kind="prismatic", axis=(1.0, 0.0, 0.0))
    drawing.close(shoe, (0.0, 0.0, 0.0), left, (2.0 * half, 0.0, 0.0))
    drawing.tool = plate
    return drawing


def four_bars(count: int) -> Drawing:
    """Draw a chain of n planar four-bars, each on the coupler of the one before and turned a quarter."""
    drawing = Drawing(f"four_bars{count}")
    link, axis = "base", (0.0, 0.0, 1.0)
    ground, crank, coupler, rocker = 0.2, 0.1, 0.22, 0.15
    start = 1.2
    pin = np.array([crank * math.cos(start), crank * math.sin(start)])
    gap = np.array([ground, 0.0]) - pin
    distance = float(np.linalg.norm(gap))
    inner = math.acos((coupler**2 + distance**2 - rocker**2) / (2.0 * coupler * distance))
    along = math.atan2(gap[1], gap[0]) + inner
    end = pin + coupler * np.array([math.cos(along), math.sin(along)])
    back = math.atan2(end[1], end[0] - ground)
    for k in range(count):
        first = drawing.joint(link, f"crank{k}", (0.0, 0.0, 0.0), (0.0, 0.0, start), "revolute", axis)
        middle = drawing.joint(first, f"coupler{k}", (crank, 0.0, 0.0), (0.0, 0.0, along - start), "revolute", axis)
        last = drawing.joint(link, f"rocker{k}", (ground, 0.0, 0.0), (0.0, 0.0, back), "revolute", axis)
        drawing.close(middle, (coupler, 0.0, 0.0), last, (rocker, 0.0, 0.0))
        drawing.drives.append(f"crank{k}_joint")
        link = drawing.joint(middle, f"mount{k}", (0.5 * coupler, 0.08, 0.02), (0.5 * math.pi, 0.0, 0.0))
    drawing.tool = link
    return drawing


def arm(count: int) -> Drawing:
    """Draw a serial arm of n revolute joints with axes in turn."""
    drawing = Drawing(f"arm{count}")
    link = "base"
    for k in range(count):
        at = (0.0, 0.0, 0.1) if k else (0.0, 0.0, 0.0)
        link = drawing.joint(
            link, f"j{k}", at, (0.3 if k == 1 else 0.0, 0.0, 0.0), "revolute", np.eye(3)[(2, 1, 0)[k % 3]]
        )
        drawing.drives.append(f"j{k}_joint")
    drawing.tool = drawing.joint(link, "hand", (0.03, 0.0, 0.1))
    return drawing


def walker(count: int) -> Drawing:
    """Draw a body on n legs with three drives each, the feet on ball joints on the ground, the knees on four-bars."""
    drawing = Drawing(f"walker{count}")
    body = _platform(drawing, "base", "p", 0.3)
    axis = (0.0, 1.0, 0.0)
    for k in range(count):
        angle = 2.0 * math.pi * k / count
        hip = drawing.joint(body, f"hip{k}", _circle(0.15, angle, 0.0), (0.0, 0.0, angle), "revolute")
        thigh = drawing.joint(hip, f"thigh{k}", (0.04, 0.0, 0.0), (0.0, -0.4, 0.0), "revolute", axis)
        lever = drawing.joint(hip, f"lever{k}", (0.04, 0.0, 0.0), (0.0, 0.9, 0.0), "revolute", axis)
        shank = drawing.joint(thigh, f"shank{k}", (0.2, 0.0, 0.0), (0.0, 1.8, 0.0), "revolute", axis)
        # a rod from the lever's end to the shank, a parallelogram but for a few millimetres
        knee, heel = np.array([0.06, 0.0, 0.0]), np.array([-0.055, 0.0, 0.01])
        lever_end = rpyToMatrix(0.0, 0.9, 0.0) @ knee
        shank_end = rpyToMatrix(0.0, -0.4, 0.0) @ (np.array([0.2, 0.0, 0.0]) + rpyToMatrix(0.0, 1.8, 0.0) @ heel)
        gap = shank_end - lever_end
        pitch = math.atan2(-gap[2], gap[0])
        rod = drawing.joint(lever, f"rod{k}", knee, (0.0, pitch - 0.9, 0.0), "revolute", axis)
        drawing.close(rod, (float(np.linalg.norm(gap)), 0.0, 0.0), shank, heel)
        length = 0.3
        ankle = rpyToMatrix(0.0, -0.4, 0.0) @ (
            np.array([0.2, 0.0, 0.0]) + rpyToMatrix(0.0, 1.8, 0.0) @ [length, 0.0, 0.0]
        )
        foot = _circle(0.15, angle, 0.3) + rpyToMatrix(0.0, 0.0, angle) @ (ankle + np.array([0.04, 0.0, 0.0]))
        drawing.close(shank, (length, 0.0, 0.0), "base", foot)
        drawing.drives += [f"hip{k}_joint", f"thigh{k}_joint", f"lever{k}_joint"]
    drawing.tool = body
    return drawing


FAMILIES: Mapping[str, tuple[Callable[[int], Drawing], Sequence[int]]] = {
    "legs": (legs, (3, 6, 8, 12, 24, 48)),
    "scissor": (scissor, (1, 2, 4, 8, 16, 32)),
    "four_bars": (four_bars, (1, 4, 16, 32, 64)),
    "stacked": (stacked, (1, 2, 3, 4, 6)),
    "arm": (arm, (6, 7, 15, 30, 60)),
    "walker": (walker, (4, 6)),
}
"""How to draw each family, and the sizes of the study."""


if __name__ == "__main__":
    name, size, output, *mounting = sys.argv[1:]
    print(FAMILIES[name][0](int(size)).write(Path(output), tilted=mounting == ["tilted"]))
