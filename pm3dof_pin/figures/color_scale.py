"""The colour scale of a map: steps between round values, logarithmic for wide ranges, and values beyond it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from matplotlib.colors import BoundaryNorm, LogNorm, Normalize
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator

from pm3dof_pin.typing import Array

_LOGARITHMIC_FROM = 10.0  # ratio of the largest to the least value
_NEARLY_CONSTANT = 0.1  # variation relative to the mean; the picture says so if it is less
TAILS = (1.0, 5.0)  # of the values at either end [%], which may lie beyond the colours ...
_MANY_LEVELS = 10  # from which every second one has a tick
_FEW_TICKS = 5
_MAX_KINDS = 8
_TAIL_SPAN = 3.0  # ... if they would stretch the scale by this factor
_STEPS = {
    1: (1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0),
    2: (1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0),
    4: (1.0, 2.0, 5.0),
}


@dataclass(frozen=True, eq=False)
class ColorScale:
    """Increasing values at which the colours step, and the sides on which values lie beyond them."""

    levels: Array
    logarithmic: bool  #: whether equal steps of colour are equal ratios
    extend: Literal["neither", "min", "max", "both"]
    note: str  #: a note for the reader, or ""
    kinds: tuple[float, ...] = ()  #: whole numbers that stand for kinds, between two levels each; empty for quantities

    def smooth_norm(self) -> Normalize:
        """Return the scale without steps, for shaded surfaces."""
        return (LogNorm if self.logarithmic else Normalize)(self.levels[0], self.levels[-1], clip=True)

    def norm(self) -> BoundaryNorm:
        """Return the scale in steps for matplotlib's 256 colours."""
        return BoundaryNorm(self.levels, 256, extend=self.extend)

    @property
    def ticks(self) -> list[float]:
        """Return round values for the colour bar."""
        if self.kinds:
            return list(self.kinds)
        if len(self.levels) == 2:  # constant
            return [float(f"{self.levels.mean():.4g}")]
        if not self.logarithmic:
            every, step = 1 if len(self.levels) < _MANY_LEVELS else 2, self.levels[1] - self.levels[0]
            return [float(level) for level in self.levels if round(level / step) % every == 0]
        decades = math.log10(self.levels[-1] / self.levels[0])
        heads = (1, 2, 5) if decades < 4 else (1,)
        found = [
            level
            for level in self.levels
            if round(level / 10.0 ** math.floor(math.log10(level) + 1e-9)) in heads
            and math.isclose(level, float(f"{level:.0e}"))
        ]
        if len(found) < _FEW_TICKS:  # hardly a decade: the ends too
            found = sorted({self.levels[0], *found, self.levels[-1]})
        return [float(level) for level in found]

    def label(self, bar: Any) -> None:
        """Set the ticks of a colour bar."""
        axis = bar.ax.yaxis if bar.orientation == "vertical" else bar.ax.xaxis
        axis.set_major_locator(FixedLocator(self.ticks))
        decimals = 0 if self.logarithmic else max((_decimals(tick) for tick in self.ticks), default=0)
        axis.set_major_formatter(FuncFormatter(lambda value, _: axis_number(value, decimals)))
        bar.ax.minorticks_off()
        bar.outline.set_linewidth(0.7)


def color_scale(values: Array, also: Array | None = None) -> ColorScale:
    """Return the scale for all finite values drawn in a picture.

    `also` are values that are drawn too, but ignored when the bulk of the values is determined.
    """
    finite = np.asarray(values, dtype=float)
    finite = finite[np.isfinite(finite)]
    kinds = kinds_of(finite)
    if len(kinds) > 1:
        middles = 0.5 * (kinds[1:] + kinds[:-1])
        levels = np.array([kinds[0] - 0.5, *middles, kinds[-1] + 0.5])
        return ColorScale(levels, False, "neither", "", tuple(kinds.tolist()))
    every = finite if also is None else np.concatenate([finite, np.ravel(also)])
    least, greatest = float(every.min()), float(every.max())
    mean = float(np.abs(finite).mean())
    if greatest - least <= 1e-9 * mean or greatest == least:  # constant: one colour, not the noise of rounding
        half = 0.05 * abs(least) or 1.0
        return ColorScale(
            np.array([least - half, least + half]),
            False,
            "neither",
            "constant everywhere" if least else "zero everywhere",
        )
    low, high = least, greatest
    for tail in TAILS:
        bulk = np.percentile(finite, [tail, 100.0 - tail])
        marks = np.array([low, *bulk, high])
        scaled = np.log(marks) if low > 0.0 else marks
        if 0.0 < _TAIL_SPAN * (scaled[2] - scaled[1]) < scaled[3] - scaled[0]:
            low, high = float(bulk[0]), float(bulk[1])
    logarithmic = low > 0.0 and high > _LOGARITHMIC_FROM * low
    levels = _decade_levels(low, high) if logarithmic else _round_levels(low, high)
    slack = 1e-9 * abs(levels[-1] - levels[0])
    below, above = least < levels[0] - slack, greatest > levels[-1] + slack
    extend: Literal["neither", "min", "max", "both"] = (
        "both" if below and above else "min" if below else "max" if above else "neither"
    )
    note = ""
    if greatest - least < _NEARLY_CONSTANT * mean:
        note = f"varies by {100.0 * (greatest - least) / mean:.2g} % of its mean"
    elif extend != "neither":
        note = f"values from {axis_number(float(f'{least:.3g}'))} to {axis_number(float(f'{greatest:.3g}'))}"
    return ColorScale(levels, logarithmic, extend, note)


def kinds_of(values: Array) -> Array:
    """Return the different values if they are few whole numbers, which stand for kinds; otherwise nothing."""
    known = np.unique(values[np.isfinite(values)])
    return known if len(known) <= _MAX_KINDS and np.array_equal(known, np.round(known)) else known[:0]


def axis_number(value: float, decimals: int = 0) -> str:
    """Format a number for an axis: 0.05, 1500, or a power of ten, with at least `decimals` decimals."""
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.{max(decimals, _decimals(value))}f}".replace("-", "\N{MINUS SIGN}")
    exponent = math.floor(math.log10(abs(value)) + 1e-9)
    head = value / 10.0**exponent
    power = f"10^{{{exponent}}}"
    return f"${power}$" if math.isclose(head, 1.0) else rf"${head:.3g} \cdot {power}$"


def _decimals(value: float) -> int:
    """Return the number of decimals needed for six digits of a number."""
    _, _, behind = f"{value:.6g}".partition(".")
    return 0 if "e" in behind else len(behind)


def _round_levels(least: float, greatest: float) -> Array:
    return np.asarray(MaxNLocator(16, steps=[1, 2.5, 5, 10]).tick_values(least, greatest), dtype=float)


def _decade_levels(least: float, greatest: float) -> Array:
    decades = math.log10(greatest / least)
    heads = next((steps for most, steps in _STEPS.items() if decades <= most), (1.0,) if decades > 8 else (1.0, 3.0))
    first, last = math.floor(math.log10(least)), math.ceil(math.log10(greatest))
    steps = np.array([head * 10.0**power for power in range(first, last + 1) for head in heads])
    start = max(int(np.searchsorted(steps, least * (1 + 1e-12), side="right")) - 1, 0)
    stop = int(np.searchsorted(steps, greatest * (1 - 1e-12)))
    levels: Array = steps[start : stop + 1]
    return levels
