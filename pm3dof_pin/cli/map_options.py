"""Over which coordinates: the options of all commands that map a robot."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum
from typing import TYPE_CHECKING, Annotated

import click
import typer

from pm3dof_pin.cli.options import finite_number
from pm3dof_pin.cli.pose_arguments import check_units

if TYPE_CHECKING:
    from pm3dof_pin.description.coordinates import Coordinate
    from pm3dof_pin.kinematics.grid import Grid
    from pm3dof_pin.kinematics.robot import Robot


class EngineName(StrEnum):
    """What computes a batch."""

    PROGRAM = "program"
    PINOCCHIO = "pinocchio"


class _Number(click.ParamType):
    name = "number"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        return value if isinstance(value, float) else finite_number(str(value))


_RANGE = click.Tuple([str, _Number(), _Number(), click.IntRange(min=1)])
_VALUE = click.Tuple([str, _Number()])

RangeOption = tuple[str, float, float, int]
ValueOption = tuple[str, float]

Ranges = Annotated[
    list[str] | None,
    typer.Option(
        "--range",
        metavar="NAME FIRST LAST COUNT",
        click_type=_RANGE,
        help="Values of a coordinate [deg, m]; may be repeated. Coordinates not named stay at home.",
    ),
]
Over = Annotated[
    list[str] | None,
    typer.Option(
        "--over",
        metavar="NAME FIRST LAST COUNT",
        click_type=_RANGE,
        help="Values of a coordinate of the map [deg, m], twice; the first two by default, over their ranges.",
    ),
]
Values = Annotated[
    list[str] | None,
    typer.Option(
        "--at",
        metavar="NAME VALUE",
        click_type=_VALUE,
        help="Value of a coordinate that stands still [deg, m]; may be repeated. Home by default.",
    ),
]
EngineOption = Annotated[
    EngineName, typer.Option("--engine", help="program: compiled; pinocchio: Pinocchio pose by pose, slow.")
]
Threads = Annotated[
    int | None, typer.Option("--threads", "--workers", min=1, help="Threads; the number of processors by default.")
]


def robot_grid(robot: Robot, ranges: Sequence[RangeOption], values: Sequence[ValueOption] = ()) -> Grid:
    """Return the grid of `--range` (or `--over`) and `--at`; wrong usage ends the command with status 2.

    Args:
        robot: the robot.
        ranges: name, first, last and count of each coordinate that varies [deg, m].
        values: name and value of coordinates that stand still [deg, m].
    """
    import numpy as np

    names = [name for name, *_ in (*ranges, *values)]
    for name in names:
        if names.count(name) > 1:
            raise typer.BadParameter(f"{name} is given twice")
    axes: dict[str, tuple[float, float, int] | float] = {}
    for name, first, last, count in ranges:
        coordinate = _coordinate(robot, name)
        if not (first < last or (first == last and count == 1)) or (first < last and count < 2):
            raise typer.BadParameter(f"{name} from {first:g} to {last:g} in {count}: expected growing values, at least 2")
        check_units(robot, [coordinate], np.array([[first], [last]]))
        axes[name] = (_si(coordinate, first), _si(coordinate, last), count)
    for name, value in values:
        coordinate = _coordinate(robot, name)
        check_units(robot, [coordinate], np.array([[value]]))
        axes[name] = _si(coordinate, value)
    return robot.grid(**axes)


def declared_ranges(robot: Robot, coordinates: Sequence[Coordinate], counts: Sequence[int]) -> list[RangeOption]:
    """Return the ranges of coordinates as `--range` takes them [deg, m].

    Args:
        robot: the robot.
        coordinates: those that vary.
        counts: number of values of each, or one for all.
    """
    import numpy as np

    ranges: list[RangeOption] = []
    for coordinate, count in zip(coordinates, counts if len(counts) > 1 else counts * len(coordinates), strict=True):
        lower, upper = robot.range_of(coordinate)
        if not np.isfinite([lower, upper]).all():
            raise typer.BadParameter(f"{coordinate.name} of {robot.name} has no range: give one with its name")
        factor = 1.0 if coordinate.unit == "m" else 180.0 / np.pi
        ranges.append((coordinate.name, float(lower * factor), float(upper * factor), count))
    return ranges


def _coordinate(robot: Robot, name: str) -> Coordinate:
    for coordinate in robot.coordinates:
        if coordinate.name == name:
            return coordinate
    raise typer.BadParameter(f"{robot.name} has no coordinate '{name}': expected one of {_names(robot)}")


def _names(robot: Robot) -> str:
    return ", ".join(coordinate.name for coordinate in robot.coordinates)


def _si(coordinate: Coordinate, number: float) -> float:
    import math

    return number if coordinate.unit == "m" else math.radians(number)
