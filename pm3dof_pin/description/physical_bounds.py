"""Bounds of the numbers of a description: far beyond any machine, but exceeded by typing errors and corruption."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import lru_cache

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+", re.ASCII)


@dataclass(frozen=True, eq=False)
class Bounds:
    """Permitted magnitudes of a kind of number."""

    unit: str
    greatest: float
    least: float = 0.0  #: least magnitude; zero is permitted only if this is zero
    negative: bool = False
    slip: str = ""  #: a hint for numbers above the greatest

    def problem(self, number: float) -> str:
        """Return what is wrong with a number, or ""."""
        if not abs(number) <= self.greatest:  # also catches NaN
            guess = f" ({self.slip})" if self.slip and abs(number) < 1e6 * self.greatest else ""
            return f"expected at most {self.greatest:g}{self._unit}, not {number:g}{guess}"
        if number < 0.0 and not self.negative:
            return f"expected a nonnegative number, not {number:g}{self._unit}"
        if abs(number) < self.least and (number or not self.negative):
            return f"expected at least {self.least:g}{self._unit}, not {number:g}"
        return ""

    @property
    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""


LENGTH = Bounds("m", 1e4, negative=True)
SIZE = Bounds("m", 1e4)
ANGLE = Bounds("rad", 4.0 * 3.14159265358979, negative=True, slip="it looks like degrees")
MASS = Bounds("kg", 1e9)
MOMENT = Bounds("kg m^2", 1e15)
PRODUCT = Bounds("kg m^2", 1e15, negative=True)
STIFFNESS = Bounds("N/m, N or N m/rad", 1e18, least=1e-12)
ANY = Bounds("", 1e30, negative=True)
NOT_NEGATIVE = Bounds("", 1e30)


def _parse_number(text: str, bounds: Bounds) -> tuple[float, str]:
    """Read a number as C++ does, with no extra characters; return it and what is wrong with it, if anything."""
    word = text.strip()
    if not _NUMBER.fullmatch(word):
        comma = ": a decimal point, not a comma" if _DECIMAL_COMMA.fullmatch(word) else ""
        return 0.0, f"expected a number{comma}, not '{_shortened(word)}'"
    number = float(word)
    return number, bounds.problem(number)


@lru_cache(maxsize=10_000)
def parse_numbers(text: str, bounds: Bounds, count: int | None = None) -> tuple[tuple[float, ...], str]:
    """Read and check numbers separated by spaces; see :func:`_parse_number`."""
    words = text.split()
    if count is not None and len(words) != count:
        return (), f"expected {count} numbers, not '{_shortened(text)}'"
    read = [_parse_number(word, bounds) for word in words]
    return tuple(number for number, _ in read), next((problem for _, problem in read if problem), "")


def _shortened(text: str) -> str:
    return text if len(text) <= 60 else f"{text[:60]}..."
