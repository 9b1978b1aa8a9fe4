"""The numbers people and drives speak of: commands, coordinates, and names for kinds of limits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import msgspec

from pm3dof_pin.description.schema import Name

Unit: TypeAlias = Literal["m", "rad"]
ToolComponent: TypeAlias = Literal["x", "y", "z", "rx", "ry", "rz"]

TOOL_COMPONENTS: tuple[ToolComponent, ...] = ("x", "y", "z", "rx", "ry", "rz")


def unit_of(component: ToolComponent) -> Unit:
    """Return the unit of a component of the tool's placement or twist, per second there."""
    return "m" if component in ("x", "y", "z") else "rad"


def shown_in(unit: str) -> tuple[float, str]:
    """Return what a number in SI units is multiplied by for people, and the unit then: angles are in degrees."""
    return (180.0 / math.pi, "deg") if unit == "rad" else (1.0, unit)


class Command(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the counter of a drive shows: scale times the joint's coordinate plus offset."""

    name: Name  #: its name
    joint: Name  #: the actuated joint
    unit: Unit  #: "m" or "rad"
    offset: float = 0.0  #: what the counter shows where the joint's coordinate is zero [unit]
    scale: float = 1.0  #: counter units per unit of the joint's coordinate, not zero


@dataclass(frozen=True)
class Coordinate:
    """One of the independent numbers that a person places the tool with.

    It is scale times the coordinate of a joint plus offset, or a component of the tool's placement in the base: its
    position x, y, z, or an angle of R = Rx(rx) Ry(ry) Rz(rz).
    """

    name: str  #: its name
    unit: Unit  #: "m" or "rad"
    joint: str | None = None  #: the joint, or None
    tool: ToolComponent | None = None  #: the component of the tool's placement, or None
    offset: float = 0.0  #: its value where the joint's coordinate is zero [unit]
    scale: float = 1.0  #: its change per unit of the joint's coordinate
    lower: float | None = None  #: least value of the declared range, or None
    upper: float | None = None  #: greatest value of the declared range, or None

    @property
    def heading(self) -> str:
        """Heading of its column in a file that is written: angles in degrees."""
        return f"{self.name}_{shown_in(self.unit)[1]}"

    @property
    def headings(self) -> tuple[str, ...]:
        """Headings that its column may have in a file that is read."""
        return (self.heading,) if self.unit == "m" else (self.heading, f"{self.name}_rad")


def tool_coordinates(components: Iterable[ToolComponent]) -> tuple[Coordinate, ...]:
    """Return components of the tool's placement as coordinates."""
    return tuple(Coordinate(component, unit_of(component), tool=component) for component in components)


@dataclass(frozen=True)
class LimitGroup:
    """A name for several limits of one kind: ranges of joints, and swing limits of closures, by their positions."""

    name: str
    joints: tuple[str, ...] = ()
    closures: tuple[int, ...] = ()
