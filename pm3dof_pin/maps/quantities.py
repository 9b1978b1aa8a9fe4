"""The table of all quantities that can be mapped.

The library, the command line, its completion and the documentation read it. To add a quantity, write a
:class:`~pm3dof_pin.maps.quantity.Quantity` in a file of its own, and add it to the table.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.capability_quantities import CAPABILITY_QUANTITIES
from pm3dof_pin.maps.chapter_quantities import CHAPTER_QUANTITIES
from pm3dof_pin.maps.error_quantities import ERROR_QUANTITIES
from pm3dof_pin.maps.quantity import Dimension, Evaluation, MappedRobot, Quantity, Unit
from pm3dof_pin.maps.robot_quantities import ROBOT_QUANTITIES
from pm3dof_pin.typing import Array

QUANTITIES: dict[str, Quantity] = {
    entry.name: entry
    for entry in (
        *ROBOT_QUANTITIES,
        *CAPABILITY_QUANTITIES,
        *CHAPTER_QUANTITIES,
        *ERROR_QUANTITIES,
    )
}
"""All quantities by name."""


def quantity(
    name: str, *, unit: Unit, long_name: str, dims: tuple[Dimension, ...] = ()
) -> Callable[[Callable[[Evaluation], Array]], Callable[[Evaluation], Array]]:
    """Add a function of an :class:`~pm3dof_pin.maps.quantity.Evaluation` to the table, in a script of one's own."""

    def add(compute: Callable[[Evaluation], Array]) -> Callable[[Evaluation], Array]:
        QUANTITIES[name] = Quantity(name, compute, unit, long_name, dims)
        return compute

    return add


def select_quantities(names: Iterable[str], mapped: MappedRobot | None = None) -> tuple[Quantity, ...]:
    """Return the quantities of the given names, in that order, each once.

    Raises:
        InvalidValueError: no names, an unknown one, or one that the robot, if given, does not have.
    """
    known = {name: entry for name, entry in QUANTITIES.items() if mapped is None or entry.exists(mapped)}
    selected = tuple(dict.fromkeys(names))
    unknown = [name for name in selected if name not in known]
    if mapped is not None and (absent := [name for name in unknown if name in QUANTITIES]):
        lacks = "it lacks what they need, as springs, a tool, drives that determine its pose, or limits of these"
        has = ", ".join(known)
        raise InvalidValueError(mapped.robot.name, problem=f"has no {', '.join(absent)} ({lacks})", expected=has)
    if unknown or not selected:
        raise InvalidValueError("quantities", ", ".join(unknown) or "none", f"some of {', '.join(known)}")
    return tuple(known[name] for name in selected)
