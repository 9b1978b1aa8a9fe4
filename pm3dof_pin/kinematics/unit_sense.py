"""Recognise numbers in the wrong unit, as opposed to unreachable poses: millimetres or degrees."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

_METRES_BEYOND = 50.0  # lengths above this multiple of the greatest declared magnitude are suspected
_RADIANS_BEYOND = 5.0
_LEAST_ANGLE = 3.2  # angles up to half a turn are not suspected [rad]
_MARGIN = 0.5  # permitted excess over the range in the other unit, relative to the range


def other_unit(values: ArrayLike, unit: str, lower: float, upper: float) -> str:
    """Return "millimetres" or "degrees" if numbers [m, rad] seem to be in these, otherwise "".

    Numbers are suspected if all are far beyond the range but would be near it in the other unit.
    """
    numbers, most = np.asarray(values, dtype=float).reshape(-1), max(abs(lower), abs(upper))
    if unit == "m":
        limit, factor, word = _METRES_BEYOND * most, 1e-3, "millimetres"
    else:
        limit, factor, word = max(_RADIANS_BEYOND * most, _LEAST_ANGLE), math.radians(1.0), "degrees"
    if not np.isfinite([lower, upper]).all() or (numbers.size and 0.0 < abs(numbers[0]) <= limit):
        return ""  # usually the first number suffices
    numbers = numbers[np.isfinite(numbers) & (numbers != 0.0)]
    margin = _MARGIN * (upper - lower)
    plausible = (factor * numbers >= lower - margin) & (factor * numbers <= upper + margin)
    return word if numbers.size and bool((np.abs(numbers) > limit).all() and plausible.all()) else ""
