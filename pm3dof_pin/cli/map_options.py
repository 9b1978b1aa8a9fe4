"""Over which coordinates: the options of all commands that map a robot."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperCommand

from pm3dof_pin.cli import completion
from pm3dof_pin.cli.options import finite_number
from pm3dof_pin.cli.output import message
from pm3dof_pin.cli.pose_arguments import check_units

if TYPE_CHECKING:
    from pm3dof_pin.description.coordinates import Coordinate
    from pm3dof_pin.kinematics.grid import Grid
    from pm3dof_pin.kinematics.robot import Robot


class EngineName(StrEnum):
    """What computes a batch."""

    PROGRAM = "program"
    PINOCCHIO = "pinocchio"


@dataclass(frozen=True)
class CoordinateRange:
    """Values of a coordinate that varies, angles in degrees."""

    name: str
    first: float
    last: float
    count: int

    @classmethod
    def parse(cls, text: str) -> CoordinateRange:
        """Read NAME FIRST LAST COUNT."""
        words = text.split()
        if len(words) != _VALUES["--range"] or not words[3].isdigit():
            raise typer.BadParameter(f"'{text}' is not NAME FIRST LAST COUNT")
        return cls(words[0], finite_number(words[1]), finite_number(words[2]), int(words[3]))


@dataclass(frozen=True)
class CoordinateValue:
    """Value of a coordinate that stands still, angles in degrees."""

    name: str
    value: float

    @classmethod
    def parse(cls, text: str) -> CoordinateValue:
        """Read NAME VALUE."""
        words = text.split()
        if len(words) != _VALUES["--at"]:
            raise typer.BadParameter(f"'{text}' is not NAME VALUE")
        return cls(words[0], finite_number(words[1]))


class MapCommand(TyperCommand):
    """A command with options of several values that may be repeated, which Typer does not have of itself."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Join the values of such an option into one, and go on."""
        joined: list[str] = []
        rest = deque(args)
        while rest:
            joined.append(rest.popleft())
            count = _VALUES.get(joined[-1], 0)
            if count and rest and " " not in rest[0]:
                joined.append(" ".join(rest.popleft() for _ in range(min(count, len(rest)))))
        return super().parse_args(ctx, joined)


_VALUES = {"--range": 4, "--over": 4, "--at": 2}
"""Number of values of each such option."""

Ranges = Annotated[
    list[CoordinateRange] | None,
    typer.Option(
        "--range",
        metavar="NAME FIRST LAST COUNT",
        parser=CoordinateRange.parse,
        help="Values of a coordinate [deg, m]; may be repeated. Coordinates not named stay at home.",
        autocompletion=completion.coordinates,
    ),
]
Over = Annotated[
    list[CoordinateRange] | None,
    typer.Option(
        "--over",
        metavar="NAME FIRST LAST COUNT",
        parser=CoordinateRange.parse,
        help="Values of a coordinate of the map [deg, m], twice; the first two by default, over their ranges.",
        autocompletion=completion.coordinates,
    ),
]
Values = Annotated[
    list[CoordinateValue] | None,
    typer.Option(
        "--at",
        metavar="NAME VALUE",
        parser=CoordinateValue.parse,
        help="Value of a coordinate that stands still [deg, m]; may be repeated. Home by default.",
        autocompletion=completion.coordinates,
    ),
]
EngineOption = Annotated[
    EngineName, typer.Option("--engine", help="program: compiled; pinocchio: Pinocchio pose by pose, slow.")
]
Threads = Annotated[
    int | None, typer.Option("--threads", "--workers", min=1, help="Threads; the number of processors by default.")
]


def robot_grid(robot: Robot, ranges: Sequence[CoordinateRange], values: Sequence[CoordinateValue] = ()) -> Grid:
    """Return the grid of `--range` (or `--over`) and `--at`; wrong usage ends the command with status 2."""
    import numpy as np

    names = [entry.name for entry in ranges] + [entry.name for entry in values]
    for name in names:
        if names.count(name) > 1:
            raise typer.BadParameter(f"{name} is given twice")
    axes: dict[str, tuple[float, float, int] | float] = {}
    for wanted in ranges:
        coordinate = _coordinate(robot, wanted.name)
        if wanted.count < 1 or (wanted.first >= wanted.last if wanted.count > 1 else wanted.first != wanted.last):
            given = f"{wanted.name} {wanted.first:g} {wanted.last:g} {wanted.count}"
            raise typer.BadParameter(f"{given}: expected growing values")
        axes[wanted.name] = (_si(coordinate, wanted.first), _si(coordinate, wanted.last), wanted.count)
    for entry in values:
        coordinate = _coordinate(robot, entry.name)
        axes[entry.name] = _si(coordinate, entry.value)
        low, high = robot.range_of(coordinate)
        if not low <= _si(coordinate, entry.value) <= high:
            span = (low, high) if coordinate.unit == "m" else (math.degrees(low), math.degrees(high))
            unit = "m" if coordinate.unit == "m" else "deg"
            message(
                f"pm3dof: --at {entry.name} {entry.value:g}: {entry.name} runs {span[0]:.4g} to {span[1]:.4g} {unit}"
            )
    numbers = {entry.name: (entry.first, entry.last) for entry in ranges}
    numbers |= {entry.name: (entry.value, entry.value) for entry in values}
    home = zip(robot.coordinates, robot.home_coordinates, strict=True)
    ends = [numbers.get(c.name, [value if c.unit == "m" else math.degrees(value)] * 2) for c, value in home]
    check_units(robot, robot.coordinates, np.array(ends).T)
    return robot.grid(**axes)


def declared_ranges(robot: Robot, coordinates: Sequence[Coordinate], counts: Sequence[int]) -> list[CoordinateRange]:
    """Return the ranges of coordinates as `--range` takes them, with the number of values of each."""
    import numpy as np

    ranges = []
    for coordinate, count in zip(coordinates, counts, strict=True):
        lower, upper = robot.range_of(coordinate)
        if not np.isfinite([lower, upper]).all():
            raise typer.BadParameter(f"{coordinate.name} of {robot.name} has no range: give one with its name")
        factor = 1.0 if coordinate.unit == "m" else 180.0 / np.pi
        ranges.append(CoordinateRange(coordinate.name, float(lower * factor), float(upper * factor), count))
    return ranges


def _coordinate(robot: Robot, name: str) -> Coordinate:
    for coordinate in robot.coordinates:
        if coordinate.name == name:
            return coordinate
    names = ", ".join(coordinate.name for coordinate in robot.coordinates)
    raise typer.BadParameter(f"{robot.name} has no coordinate '{name}': expected one of {names}")


def _si(coordinate: Coordinate, number: float) -> float:
    return number if coordinate.unit == "m" else math.radians(number)
