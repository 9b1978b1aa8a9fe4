"""Pictures on a dark ground: greys change sides, colours stay."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
from matplotlib.artist import Artist
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba_array
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.text import Text
from numpy.typing import NDArray

GROUND, LIGHT = 0.09, 0.93  # what white and black become
_GREY = 0.08  # largest difference of the parts of a colour that counts as grey


def _flipped(colours: Any) -> NDArray[np.float64]:
    rgba: NDArray[np.float64] = np.array(to_rgba_array(colours), dtype=float)
    grey = np.ptp(rgba[:, :3], axis=1) < _GREY
    rgba[grey, :3] = LIGHT - (LIGHT - GROUND) * rgba[grey, :3]
    return rgba


def _properties(artist: Artist) -> tuple[str, ...]:
    if isinstance(artist, Text):
        return ("color",)
    if isinstance(artist, Line2D):
        return "color", "markerfacecolor", "markeredgecolor"
    if isinstance(artist, Patch):
        return "facecolor", "edgecolor"
    if isinstance(artist, Collection) and artist.get_array() is None and not hasattr(artist, "do_3d_projection"):
        return "facecolor", "edgecolor"
    return ()


@contextmanager
def darkened(figure: Figure) -> Iterator[None]:
    """Draw a figure on a dark ground within the block: white, grey and black change sides."""
    undo: list[tuple[Callable[[Any], None], Any]] = []
    try:
        in_space: list[Any] = [axes for axes in figure.axes if hasattr(axes, "zaxis")]
        for axes in in_space:
            for axis in (axes.xaxis, axes.yaxis, axes.zaxis):
                undo.append((axis.set_pane_color, axis._axinfo["color"]))
                axis.set_pane_color((*[2.0 * GROUND] * 3, 1.0))
        for artist in figure.findobj():
            for name in _properties(artist):
                setter, before = getattr(artist, f"set_{name}"), getattr(artist, f"get_{name}")()
                if isinstance(before, str) and before in ("none", "auto"):
                    continue
                flipped = _flipped(before)
                setter(flipped if isinstance(artist, Collection) else tuple(flipped[0]))
                undo.append((setter, before))
        yield
    finally:
        for setter, before in reversed(undo):
            setter(before)
