"""The panel next to the picture: an entry for each drawn item, with its scale and its numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.viewer.scene import Json


@dataclass
class Entry:
    """An entry of the legend, with a checkbox that shows or hides its item."""

    key: str  #: name in the page
    title: str  #: title of the item
    lines: list[str] = field(default_factory=list)  #: scale and explanations
    values: str = ""  #: the numbers currently drawn
    colour: str | None = None  #: colour of the item in CSS notation, or None
    bar: Json | None = None  #: a colour scale: `colours`, and `ends`, the texts at its ends
    nodes: list[str] = field(default_factory=list)  #: paths that the checkbox shows and hides
    #: bodies that are coloured instead: `path`, `own` colour, `colour`, and `leg`, the index in live shares
    paint: list[Json] | None = None
    visible: bool = True  #: whether it is shown initially
    of_pose: bool = True  #: whether it was computed for the displayed configuration, and is invalid at any other
    live: Json | None = None  #: how the page computes it for the sliders' pose, or None
    principal: list[float] | None = None  #: numbers at the ends of an ellipsoid's axes, ascending, or None
    unit: str = ""  #: their unit
    #: what a plane cuts: the `nodes`, and least and greatest `corners` of a box around them [m]; and the `layers` of
    #: numbers that can colour the nodes in `colours`, in order, by the scale `stops`
    cut: Json | None = None

    def to_json(self) -> Json:
        """Return the entry in the page's format."""
        return dict(vars(self))


_SMALL = 1e-3  # relative to the greatest number: smaller ones have their own prefix
_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def numbers_with_unit(values: ArrayLike, unit: str | Sequence[str], *, digits: int = 3) -> str:
    """Format numbers as in the page: 64.7 · 429 kN/m, with a common prefix if it suits all; a unit for all, or each."""
    if not isinstance(unit, str):
        if len(set(unit)) != 1:
            each = zip(np.asarray(values, dtype=float), unit, strict=True)
            return " · ".join(numbers_with_unit([value], own, digits=digits) for value, own in each)
        unit = unit[0]
    numbers = [float(value) for value in np.asarray(values, dtype=float)]
    greatest = max(map(abs, numbers), default=0.0)
    numbers = [0.0 if abs(number) < ROUNDING * greatest else number for number in numbers]
    powers = [_power(n if 0.0 < abs(n) < _SMALL * greatest else greatest) if unit != "1" else 0 for n in numbers]
    texts = [f"{float(f'{number / 10.0**power:.{digits}g}'):g}" for number, power in zip(numbers, powers, strict=True)]
    units = ["" if unit == "1" else f" {_PREFIXES[power]}{unit}" for power in powers]
    if len(set(units)) == 1:
        return " · ".join(texts).replace("-", "\u2212") + units[0]
    return " · ".join(text + own for text, own in zip(texts, units, strict=True)).replace("-", "\u2212")


def _power(number: float) -> int:
    """Return the power of ten of a number's SI prefix."""
    size = abs(number)
    if not 0.0 < size < math.inf:
        return 0
    return min(9, max(-9, 3 * math.floor(math.log10(size * 1.0005) / 3)))


def scale_text(scale: float, length: float, unit: str, what: str) -> str:
    """Describe the scale of a drawn length, as in "semi-axis of 100 mm = 200 MN/m"."""
    return f"{what} of {1000.0 * length:g} mm = {numbers_with_unit([length / scale], unit, digits=4)}"
