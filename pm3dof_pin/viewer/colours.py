"""Colour scales, as stops that the page and Python interpolate identically."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

# matplotlib's viridis at nine places: perceptually uniform, readable without colour vision
INDEX_STOPS = ("#440154", "#472d7b", "#3b528b", "#2c728e", "#21918c", "#28ae80", "#5ec962", "#addc30", "#fde725")
# from almost nothing, pale, to everything, dark
SHARE_STOPS = ("#e9ecef", "#f6d98b", "#f29f4b", "#d9542b", "#9b1c31", "#5c0f2b")

# Okabe and Ito: bodies whose file gives no colour
ROLES: dict[str, tuple[float, float, float]] = {
    "base": (0.36, 0.39, 0.43),
    "drive": (0.835, 0.369, 0.0),
    "passive": (0.0, 0.447, 0.698),
    "tool": (0.95, 0.74, 0.10),
}


def stops(colours: tuple[str, ...]) -> NDArray[np.float64]:
    """Return colours such as "#440154" as red, green, blue in 0 .. 1, shape=(n, 3)."""
    return np.array([[int(colour[start : start + 2], 16) / 255.0 for start in (1, 3, 5)] for colour in colours])


def blend(colours: tuple[str, ...], places: ArrayLike) -> NDArray[np.float64]:
    """Return the colours at places between 0 and 1 of a scale, shape=(..., 3)."""
    at = np.linspace(0.0, 1.0, len(colours))
    return np.stack([np.interp(np.asarray(places, dtype=float), at, part) for part in stops(colours).T], axis=-1)


def css(colour: ArrayLike) -> str:
    """Return a colour, shape=(3,), in CSS notation."""
    red, green, blue = (round(255.0 * part) for part in np.asarray(colour, dtype=float))
    return f"rgb({red}, {green}, {blue})"
