"""The panel beside the picture: one entry for each thing that is drawn, with its scale and its numbers."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

Json = dict[str, Any]


@dataclass
class Entry:
    """One entry of the legend, with a box that shows or hides what it stands for.

    Attributes:
        key: its name for the page.
        title: what is drawn.
        lines: scale and explanations.
        values: the numbers that are drawn now.
        colour: colour of what is drawn, as the style sheet writes it, or None.
        bar: a scale of colours: `colours` and `ends`, the texts at its ends.
        nodes: paths that the box shows and hides.
        paint: bodies that are coloured instead: `path`, `own` colour, `colour`, and `leg`, the place in live shares.
        visible: whether it is shown until the reader decides otherwise.
        of_pose: whether it was computed for the displayed configuration, and is wrong at any other.
        live: how the page computes it for a slider's pose, or None.
        principal: numbers at the ends of an ellipsoid's axes, the least first, or None.
        unit: their unit.
        cut: what a plane cuts: the `nodes`, least and greatest `corners` of a box around them [m]; and the `layers` of
            numbers that may colour the nodes in `colours`, one after the other, along the scale `stops`.
    """

    key: str
    title: str
    lines: list[str] = field(default_factory=list)
    values: str = ""
    colour: str | None = None
    bar: Json | None = None
    nodes: list[str] = field(default_factory=list)
    paint: list[Json] | None = None
    visible: bool = True
    of_pose: bool = True
    live: Json | None = None
    principal: list[float] | None = None
    unit: str = ""
    cut: Json | None = None

    def lowered(self) -> Json:
        """Return the entry as the page reads it."""
        return dict(vars(self))


def scientific(number: float) -> str:
    """Write a number with three digits, as the page does: 1.53e6, 0.0412, 88.6."""
    mantissa, exponent = f"{number:.2e}".split("e")
    if abs(int(exponent)) < 3:
        return f"{float(f'{number:.3g}'):g}"
    return f"{mantissa}e{int(exponent)}"


def numbers_with_unit(values: ArrayLike, unit: str) -> str:
    """Write numbers with their unit, unless that is 1."""
    text = " · ".join(scientific(float(value)) for value in np.asarray(values, dtype=float))
    return text if unit == "1" else f"{text} {unit}"


def outside_limits(broken: Iterable[str]) -> list[str]:
    """Return what the page says of joints outside their ranges, each described; nothing if there is none."""
    listed = list(broken)
    return ["Out of reach within the limits of the joints:", *listed] if listed else []


def scale_text(scale: float, length: float, unit: str, what: str) -> str:
    """Say what a drawn length stands for, as in "semi-axis of 100 mm = 2e8 N/m"."""
    mantissa, exponent = f"{length / scale:.3e}".split("e")
    value = float(f"{length / scale:.4g}")
    text = f"{value:g}" if abs(int(exponent)) < 3 else f"{float(mantissa):g}e{int(exponent)}"
    return f"{what} of {1000.0 * length:g} mm = {text} {unit}"
