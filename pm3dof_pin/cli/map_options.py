"""Coordinate ranges and other options shared by all commands that map a robot."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import typer

from pm3dof_pin.cli import completion
from pm3dof_pin.cli.command import NUMBER_OF_VALUES
from pm3dof_pin.cli.options import finite_number
from pm3dof_pin.cli.output import message
from pm3dof_pin.cli.poses import check_units, in_si, say_if_drives_are_dependent
from pm3dof_pin.description.coordinates import Coordinate, shown_in
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_range
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot

if TYPE_CHECKING:
    from pm3dof_pin.maps.quantity import Quantity


@dataclass(frozen=True)
class CoordinateRange:
    """Values of a coordinate, or one fixed value; angles in degrees."""

    name: str
    first: float
    last: float
    count: int = 1

    @classmethod
    def parse(cls, text: str) -> CoordinateRange:
        """Read NAME FIRST LAST COUNT."""
        words = text.split()
        if len(words) != NUMBER_OF_VALUES["--range"] or not words[3].isdigit():
            raise typer.BadParameter(f"expected NAME FIRST LAST COUNT, not '{text}'")
        return cls(words[0], finite_number(words[1]), finite_number(words[2]), int(words[3]))

    @classmethod
    def parse_value(cls, text: str) -> CoordinateRange:
        """Read NAME VALUE."""
        words = text.split()
        if len(words) != NUMBER_OF_VALUES["--at"]:
            raise typer.BadParameter(f"expected NAME VALUE, not '{text}'")
        return cls(words[0], finite_number(words[1]), finite_number(words[1]))


def _ranges(name: str, metavar: str, parse: Callable[[str], CoordinateRange], text: str) -> Any:
    """Return a repeatable option for values of coordinates."""
    return typer.Option(name, metavar=metavar, parser=parse, help=text, autocompletion=completion.coordinates)


Ranges = Annotated[
    list[CoordinateRange] | None,
    _ranges(
        "--range",
        "NAME FIRST LAST COUNT",
        CoordinateRange.parse,
        "Values of a coordinate [deg, m]; may be repeated. Coordinates not named stay at home.",
    ),
]
Over = Annotated[
    list[CoordinateRange] | None,
    _ranges(
        "--over",
        "NAME FIRST LAST COUNT",
        CoordinateRange.parse,
        "Values of a coordinate to map over [deg, m], given twice; by default the ranges of the first two.",
    ),
]
Values = Annotated[
    list[CoordinateRange] | None,
    _ranges(
        "--at",
        "NAME VALUE",
        CoordinateRange.parse_value,
        "Value of a fixed coordinate [deg, m]; may be repeated.",
    ),
]
Quantities = Annotated[
    list[str] | None,
    typer.Option(
        "--quantity",
        "-q",
        help="Name of a quantity to map; may be repeated. `pm3dof atlas --list` lists them.",
        autocompletion=completion.quantities,
    ),
]
EngineOption = Annotated[
    Literal["program", "pinocchio"],
    typer.Option("--engine", help="program: compiled; pinocchio: pose by pose with Pinocchio, slow."),
]
Threads = Annotated[
    int | None, typer.Option("--threads", "--workers", min=1, help="Threads; the number of processors by default.")
]


def known_quantities(names: Sequence[str] | None) -> Mapping[str, Quantity]:
    """Return all quantities that can be mapped, after checking those of `--quantity`."""
    from pm3dof_pin.maps.quantities import QUANTITIES  # it loads the compiler

    for name in names or ():
        if name not in QUANTITIES:
            raise typer.BadParameter(f"no quantity '{name}', expected one of {', '.join(QUANTITIES)}")
    return QUANTITIES


def robot_grid(
    robot: Robot, ranges: Sequence[CoordinateRange] | None, values: Sequence[CoordinateRange] | None = None
) -> Grid:
    """Return the grid of `--range` (or `--over`) and `--at`; wrong usage ends the command with status 2."""
    say_if_drives_are_dependent(robot)
    given = [*(ranges or ()), *(values or ())]
    names = [entry.name for entry in given]
    known = {coordinate.name: coordinate for coordinate in robot.coordinates}
    for name in names:
        if names.count(name) > 1:
            raise typer.BadParameter(f"{name} is given twice")
        if name not in known:
            raise typer.BadParameter(f"{robot.name} has no coordinate '{name}': expected one of {', '.join(known)}")
    axes: dict[str, tuple[float, float, int] | float] = {}
    for entry in ranges or ():
        if entry.count < 1 or (entry.first >= entry.last if entry.count > 1 else entry.first != entry.last):
            words = f"{entry.name} {entry.first:g} {entry.last:g} {entry.count}"
            expected = "a COUNT of 2 or more" if entry.first < entry.last else "increasing values"
            raise typer.BadParameter(f"{words}: expected {expected}")
        first, last = (in_si(known[entry.name].unit, end) for end in (entry.first, entry.last))
        axes[entry.name] = (first, last, entry.count)
    for entry in values or ():
        axes[entry.name] = in_si(known[entry.name].unit, entry.first)
    numbers = {entry.name: (entry.first, entry.last) for entry in given}
    home = zip(robot.coordinates, robot.home_coordinates, strict=True)
    ends = [numbers.get(c.name, (shown_in(c.unit)[0] * value,) * 2) for c, value in home]
    check_units(robot, robot.coordinates, np.array(ends).T)
    for entry in values or ():
        factor, unit = shown_in(known[entry.name].unit)
        low, high = (factor * end for end in robot.range_of(known[entry.name]))
        if not low <= entry.first <= high:
            message(f"pm3dof: --at {entry.name} {entry.first:g} is outside its range, {low:.4g} to {high:.4g} {unit}")
    return robot.grid(**axes)


def declared_ranges(robot: Robot, coordinates: Sequence[Coordinate], counts: Sequence[int]) -> list[CoordinateRange]:
    """Return the ranges of coordinates as values of `--range`, with the given counts."""
    ranges = []
    for coordinate, count in zip(coordinates, counts, strict=True):
        lower, upper = coordinate_range(robot, coordinate)
        if not math.isfinite(upper - lower):
            raise typer.BadParameter(
                f"{robot.name} declares no range for {coordinate.name}, and none follows from the limits: "
                f"give --range or --over {coordinate.name} FIRST LAST COUNT"
            )
        factor = shown_in(coordinate.unit)[0]
        ranges.append(CoordinateRange(coordinate.name, factor * float(lower), factor * float(upper), count))
    return ranges
