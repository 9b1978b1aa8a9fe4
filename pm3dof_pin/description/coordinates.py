"""The numbers that users and drives work with: commands, coordinates, and named groups of limits."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import msgspec

from pm3dof_pin.description.schema import Name
from pm3dof_pin.exceptions import first_words

Unit: TypeAlias = Literal["m", "rad"]
ToolComponent: TypeAlias = Literal["x", "y", "z", "rx", "ry", "rz"]

TOOL_COMPONENTS: tuple[ToolComponent, ...] = ("x", "y", "z", "rx", "ry", "rz")


def unit_of(component: ToolComponent) -> Unit:
    """Return the unit of a component of the tool's placement (or, per second, of its twist)."""
    return "m" if component in ("x", "y", "z") else "rad"


def shown_in(unit: str) -> tuple[float, str]:
    """Return the factor from SI to display units, and the display unit: angles are in degrees."""
    return (180.0 / math.pi, "deg") if unit == "rad" else (1.0, unit)


def value_in_words(name: str, unit: str, value: float, digits: str = ".9g") -> str:
    """Format a value [rad, m] as in "theta_x = 10 deg", with the format `digits`."""
    factor, shown = shown_in(unit)
    return f"{name} = {round(factor * value, 9) + 0.0:{digits}} {shown}"  # no minus sign on zero


def pose_in_words(coordinates: Sequence[Coordinate | Command], values: Iterable[float], digits: str = ".9g") -> str:
    """Return a pose [rad, m] as in "theta_x = 10 deg, z_e = 0.5 m", each number with the format `digits`.

    Of a long one the first numbers.
    """
    pairs = zip(coordinates, values, strict=True)
    return first_words([value_in_words(each.name, each.unit, value, digits) for each, value in pairs])


class Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The counter reading of a drive: scale times the joint coordinate plus offset."""

    name: Name  #: its name
    joint: Name  #: the actuated joint
    unit: Unit  #: "m" or "rad"
    offset: float = 0.0  #: counter reading at joint coordinate zero [unit]
    scale: float = 1.0  #: counter units per unit of the joint coordinate, nonzero


@dataclass(frozen=True)
class Coordinate:
    """One of the independent numbers that place the tool.

    It is either scale times a joint coordinate plus offset, or a component of the tool's placement in the base:
    position x, y, z, or an angle of R = Rx(rx) Ry(ry) Rz(rz).
    """

    name: str  #: its name
    unit: Unit  #: "m" or "rad"
    joint: str | None = None  #: the joint, or None
    tool: ToolComponent | None = None  #: the component of the tool's placement, or None
    offset: float = 0.0  #: value at joint coordinate zero [unit]
    scale: float = 1.0  #: change per unit of the joint coordinate
    lower: float | None = None  #: lower end of the declared range, or None
    upper: float | None = None  #: upper end of the declared range, or None

    @property
    def heading(self) -> str:
        """Column heading in output files: angles in degrees."""
        return f"{self.name}_{shown_in(self.unit)[1]}"

    @property
    def headings(self) -> tuple[str, ...]:
        """Column headings accepted in input files."""
        return (self.heading,) if self.unit == "m" else (self.heading, f"{self.name}_rad")


def tool_coordinates(components: Iterable[ToolComponent]) -> tuple[Coordinate, ...]:
    """Return components of the tool's placement as coordinates."""
    return tuple(Coordinate(component, unit_of(component), tool=component) for component in components)


@dataclass(frozen=True)
class LimitGroup:
    """A named group of limits: joint ranges, and swing limits of closures by index."""

    name: str
    joints: tuple[str, ...] = ()
    closures: tuple[int, ...] = ()
