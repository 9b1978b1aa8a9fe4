"""How coordinates are written on pictures: angles in degrees, lengths in metres, names in italics."""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.typing import Array

_ANGLE = re.compile(r"(theta)_([xyz])")
_LETTERS = re.compile(r"([xyzruq])_?([xyze]|\d*)")


def symbol(name: str) -> str:
    r"""Return the name of a coordinate in italics: theta_x as $\theta_x$, z_e as $z_e$; other words as they are."""
    if _ANGLE.fullmatch(name):
        return rf"$\{name}$"
    found = _LETTERS.fullmatch(name)
    if not found:
        return name
    return f"${found[1]}_{{{found[2]}}}$" if found[2] else f"${found[1]}$"


def axis_label(name: str, unit: str) -> str:
    """Return the label of an axis, with the unit its numbers are drawn in."""
    return f"{symbol(name)} [{'deg' if unit == 'rad' else unit}]"


def drawn(values: ArrayLike, unit: str) -> Array:
    """Return the numbers that are drawn: angles in degrees, all else as it is."""
    return np.degrees(values) if unit == "rad" else np.asarray(values, dtype=float)


def in_words(name: str, value: float, unit: str, digits: int = 4) -> str:
    """Return a coordinate and its value: $z_e$ = 0.4873 m, $r_x$ = 5.0 deg."""
    if unit == "rad":
        return f"{symbol(name)} = {np.degrees(value) + 0.0:.1f} deg"
    return f"{symbol(name)} = {value + 0.0:.{digits}f} {unit}"
