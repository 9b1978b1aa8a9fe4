"""Diagrams of boxes and arrows in the house style."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, FancyBboxPatch

from pm3dof_pin.figures.style import INK, TWO_COLUMNS, new_figure
from pm3dof_pin.typing import Array

FILLS = {"plain": "#FFFFFF", "data": "#ECECEC", "model": "#CFE3F2", "machine": "#F6C9A8", "result": "#FBE7B2"}
NAMES = "#555555"  # colour of the names of frames
_TURN = 0.07  # radius of the corners of boxes
_LETTERS = 7.0  # size of all letters [typographic points]


@dataclass(frozen=True)
class Box:
    """A box of a diagram: its centre and sides, in units of the sheet."""

    x: float
    y: float
    width: float
    height: float

    @property
    def left(self) -> Array:
        """Middle of the left side, shape=(2,)."""
        return np.array([self.x - 0.5 * self.width, self.y])

    @property
    def right(self) -> Array:
        """Middle of the right side, shape=(2,)."""
        return np.array([self.x + 0.5 * self.width, self.y])

    @property
    def top(self) -> Array:
        """Middle of the upper side, shape=(2,)."""
        return np.array([self.x, self.y + 0.5 * self.height])

    @property
    def bottom(self) -> Array:
        """Middle of the lower side, shape=(2,)."""
        return np.array([self.x, self.y - 0.5 * self.height])


class Diagram:
    """A sheet two columns wide, which is `width` units; to be filled inside :func:`house_style`."""

    figure: Figure

    def __init__(self, width: float, height: float) -> None:
        self.figure = new_figure(TWO_COLUMNS, TWO_COLUMNS * height / width)
        self._axes: Axes = self.figure.add_axes((0.0, 0.0, 1.0, 1.0))
        self._axes.set(xlim=(0.0, width), ylim=(0.0, height))
        self._axes.axis("off")

    def box(
        self,
        centre: Sequence[float],
        size: Sequence[float],
        head: str,
        text: str = "",
        *,
        fill: str,
        dashed: bool = False,
    ) -> Box:
        """Draw a box with a bold head and lines of text below it, filled by a key of :data:`FILLS`."""
        (x, y), (width, height) = centre, size
        made = Box(x, y, width, height)
        pattern = (0, (4, 3)) if dashed else "solid"
        self._rounded(centre, size, facecolor=FILLS[fill], edgecolor=INK, linewidth=0.8, linestyle=pattern, zorder=3)
        lines = text.count("\n") + 1 if text else 0
        rise = 0.098 * lines
        bold: dict[str, Any] = {"fontweight": "bold", "fontsize": _LETTERS}
        self._axes.text(made.x, made.y + rise, head, ha="center", va="center", zorder=4, **bold)
        if text:
            self._axes.text(
                made.x, made.y - 0.115, text, ha="center", va="center", fontsize=_LETTERS, linespacing=1.3, zorder=4
            )
        return made

    def _rounded(self, centre: Sequence[float], size: Sequence[float], **style: Any) -> None:
        (x, y), (width, height) = centre, size
        shape = f"round,pad=0,rounding_size={_TURN}"
        corner = (x - 0.5 * width, y - 0.5 * height)
        self._axes.add_patch(FancyBboxPatch(corner, width, height, boxstyle=shape, **style))

    def circle(self, centre: Sequence[float], radius: float = 0.13) -> Box:
        """Draw a summing point and return the square around it."""
        self._axes.add_patch(Circle((centre[0], centre[1]), radius, facecolor="white", edgecolor=INK, zorder=3))
        self.text(centre, "+")
        return Box(centre[0], centre[1], 2 * radius, 2 * radius)

    def arrow(self, *points: Sequence[float] | Array, dashed: bool = False) -> None:
        """Draw an arrow along a polygon of two points or more."""
        path = np.array([np.asarray(point, dtype=float) for point in points])
        pattern = (0, (4, 3)) if dashed else "solid"
        self._axes.plot(*path[:-1].T, color=INK, linewidth=1.0, linestyle=pattern, zorder=2)
        head = {
            "arrowstyle": "-|>", "color": INK, "linewidth": 1.0, "linestyle": pattern, "shrinkA": 0.0, "shrinkB": 0.0,
        }  # fmt: skip
        self._axes.annotate("", xy=tuple(path[-1]), xytext=tuple(path[-2]), arrowprops=head, zorder=2)

    def frame(self, centre: Sequence[float], size: Sequence[float]) -> None:
        """Draw a pale area behind boxes that belong together."""
        self._rounded(centre, size, facecolor="#F7F7F7", edgecolor="#AAAAAA", linewidth=0.6)

    def text(self, at: Sequence[float], words: str, side: str = "center", color: str = INK) -> None:
        """Write text at a point; `side` is the side of the text that is there: "left", "center" or "right"."""
        self._axes.text(
            at[0], at[1], words, ha=side, va="center", fontsize=_LETTERS, linespacing=1.3, color=color, zorder=5
        )
