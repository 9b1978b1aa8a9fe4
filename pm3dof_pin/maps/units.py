"""Units of quantities whose entries differ: the units, each followed by its entries in brackets."""

from __future__ import annotations


def unit_of_entry(units: str, entry: str) -> str:
    """Return an entry's unit out of "N/m (x, y, z), N m/rad (rx, ry, rz)"; a unit of all entries stays as it is."""
    for part in units.split("), "):
        unit, _, entries = part.rstrip(")").partition(" (")
        if entry in entries.split(", "):
            return unit
    return units
