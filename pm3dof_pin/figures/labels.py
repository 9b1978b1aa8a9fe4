"""Labels of coordinates and quantities in pictures: names in italics, units that keep numbers readable."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr

    from pm3dof_pin.maps.datasets import Map

_PREFIXES = {
    "m": ((0.1, 1.0, "m"), (1e-3, 1e-3, "mm"), (1e-7, 1e-6, "µm"), (0.0, 1e-9, "nm")),
    "rad": ((1.0, 1.0, "rad"), (1e-3, 1e-3, "mrad"), (0.0, 1e-6, "µrad")),
    "N/m": ((1e9, 1e9, "kN/µm"), (1e5, 1e6, "N/µm"), (1e2, 1e3, "N/mm"), (0.0, 1.0, "N/m")),
    "N m/rad": ((1e9, 1e9, "GN m/rad"), (1e6, 1e6, "MN m/rad"), (1e3, 1e3, "kN m/rad"), (0.0, 1.0, "N m/rad")),
    "m/N": ((1e-3, 1.0, "m/N"), (1e-7, 1e-6, "µm/N"), (0.0, 1e-9, "nm/N")),
    "rad/(N m)": (
        (1e-1, 1.0, "rad/(N m)"),
        (1e-4, 1e-3, "mrad/(N m)"),
        (1e-7, 1e-6, "µrad/(N m)"),
        (0.0, 1e-9, "nrad/(N m)"),
    ),
}
"""By unit: the least greatest number, the divisor and the name of each display unit."""
_PLAIN = range(-2, 5)  # powers of ten of numbers written without an exponent
_DIRECTIONS = {"t": "along", "r": "about"}
_ANGLE = re.compile(r"(theta)_([xyz])")
_LETTERS = re.compile(r"([xyzruq])_?([xyze]|\d*)")


def plain(name: str) -> str:
    """Return a name escaped to be drawn literally: a dollar does not begin a formula."""
    return name.replace("$", r"\$")


def symbol(name: str) -> str:
    r"""Return the name of a coordinate in italics: theta_x as $\theta_x$, z_e as $z_e$; other words unchanged."""
    if _ANGLE.fullmatch(name):
        return rf"$\{name}$"
    found = _LETTERS.fullmatch(name)
    if not found:
        return plain(name)
    return f"${found[1]}_{{{found[2]}}}$" if found[2] else f"${found[1]}$"


def axis_label(name: str, unit: str) -> str:
    """Return the label of an axis, with its display unit."""
    return f"{symbol(name)} [{'deg' if unit == 'rad' else unit}]"


def drawn(values: ArrayLike, unit: str) -> Array:
    """Return numbers for drawing: angles in degrees, all else unchanged."""
    return np.degrees(values) if unit == "rad" else np.asarray(values, dtype=float)


def in_words(name: str, value: float, unit: str, digits: int = 4) -> str:
    """Return a coordinate and its value: $z_e$ = 0.4873 m, $r_x$ = 5.0 deg."""
    if unit == "rad":
        return f"{symbol(name)} = {np.degrees(value):z.1f} deg".replace("-", "\N{MINUS SIGN}")
    return f"{symbol(name)} = {value:z.{digits}f} {unit}".replace("-", "\N{MINUS SIGN}")


def fixed_coordinates(dataset: Map | xr.DataArray) -> dict[str, tuple[float, str]]:
    """Return value and unit of each coordinate of a map that does not vary."""
    return {
        str(name): (float(coordinate.values), str(coordinate.attrs["units"]))
        for name, coordinate in dataset.coords.items()
        if not coordinate.dims and "units" in coordinate.attrs
    }


def display_unit(values: ArrayLike, unit: str) -> tuple[float, str]:
    """Return the divisor of finite values and their display unit: 1e-6 and "µm" for errors of about 1e-4 m.

    The unit is "" for plain numbers.
    """
    sizes = np.abs(np.asarray(values, dtype=float))
    greatest = float(np.max(sizes, where=np.isfinite(sizes), initial=0.0))
    for least, factor, name in _PREFIXES.get(unit, ()):
        if greatest >= least:
            return factor, name
    words = {"1": "", "mixed": "mixed units"}.get(unit, unit)
    exponent = math.floor(math.log10(greatest)) if greatest > 0.0 else 0
    if exponent in _PLAIN:
        return 1.0, words
    return 10.0**exponent, f"$10^{{{exponent}}}$ {words}".strip()


def in_brackets(words: str, unit: str) -> str:
    """Return words followed by the unit in brackets, if there is one."""
    return f"{words} [{unit}]" if unit else words


def typeset(text: str) -> str:
    """Set angles and axes within words in italics."""
    return re.sub(r"along ([xyz])\b", r"along $\1$", re.sub(r"theta_([xyz])", r"$\\theta_\1$", text))


def part_words(name: str) -> str:
    """Return the name of a part as words: actuator1 as actuator 1, passive_leg as passive leg."""
    return plain(re.sub(r"(?<=[a-z])(?=\d)", " ", name).replace("_", " "))


def parameter_words(name: str) -> str:
    """Return the name of an error parameter as words: slider1_joint.tx as slider 1, along $x$.

    Other names are unchanged.
    """
    place, dot, motion = name.rpartition(".")
    found = re.fullmatch(r"([tr])_?([xyz]|across\d)", motion)
    if not dot or not found:
        return plain(name)
    axis = f"${found[2]}$" if len(found[2]) == 1 else f"axis {found[2][-1]} across"
    part = part_words(place.removesuffix("_joint"))
    part = re.sub(r" ([xyz])$", r" $\1$", part)
    point = re.fullmatch(r"([A-Z])_?([a-z0-9]*)", place)
    if point:
        part = f"${point[1]}_{{{point[2]}}}$" if point[2] else f"${point[1]}$"
    return f"{part}, {_DIRECTIONS[found[1]]} {axis}"


def entry_words(entry: str) -> str:
    """Return the label of an entry as words: x as along $x$, rx as about $x$; others with their symbols."""
    if re.fullmatch(r"[xyz]", entry):
        return f"along ${entry}$"
    if re.fullmatch(r"r[xyz]", entry):
        return f"about ${entry[1]}$"
    return symbol(entry) if symbol(entry) != entry else plain(entry.replace("_", " "))
