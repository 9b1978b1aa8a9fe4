"""Traces of a ballbar: readings along a circle, as distances from the socket that calibration uses.

The machine was driven by its own controller along a circle about the socket, with the tool's orientation as at home
and constant feed v; a sample at time t is at the angle a0 +- v t / R. Commands are those of the machine as described,
which is what such a controller carries out. Each trace has its direction, so the drives' directions are known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Literal

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import ColumnMap, Export
from pm3dof_pin.measuring.instruments.sphere import BALLBAR, BALLBAR_LENGTH
from pm3dof_pin.measuring.joint_columns import approach_columns, command_columns
from pm3dof_pin.typing import Array

CirclePlane = Literal["xy", "yz", "zx"]


class Sense(StrEnum):
    """Counter-clockwise or clockwise, seen against the third axis."""

    CCW = "ccw"
    CW = "cw"


_READING, _ANGLE, _TIME = "reading_m", "angle_rad", "time_s"
_FREE, _LONGEST = 6, 0.1  # drives for any placement; reading relative to the bar
_MIN_SAMPLES = 4  # of a socket of unknown place
_STEP = 0.01  # [rad], by which the drives' directions are told


@dataclass(frozen=True)
class Circle:
    """The circle that was programmed."""

    centre: tuple[float, float, float]  #: about where the socket is, base axes [m]
    length: float = BALLBAR_LENGTH  #: radius of the circle and calibrated length of the bar [m]
    plane: CirclePlane = "xy"
    start: float = 0.0  #: angle of the first sample, from the first axis of the plane to the second [rad]
    sense: Sense = Sense.CCW
    feed: float | None = None  #: along the circle [m/s]; needed if the samples have times and no angles

    def __post_init__(self) -> None:
        """Check numbers; raise InvalidValueError."""
        if not all(np.isfinite(self.centre)):
            raise InvalidValueError("centre", self.centre, "three finite numbers of metres")
        for name in ("length", "feed"):
            value = getattr(self, name)
            if value is not None and not 0.0 < value < np.inf:
                raise InvalidValueError(name, value, "a positive number")
        if not np.isfinite(self.start):
            raise InvalidValueError("start", self.start, "a finite angle")

    def points(self, angles: Array) -> Array:
        """Return its points at angles [rad], shape=(n, 3) [m]."""
        first, second = ("xyz".index(axis) for axis in self.plane)
        found = np.tile(np.array(self.centre, dtype=float), (len(angles), 1))
        found[:, first] += self.length * np.cos(angles)
        found[:, second] += self.length * np.sin(angles)
        return found


def ballbar_columns(
    path: Path | str,
    robot: Robot,
    circle: Circle,
    *,
    samples: int = 72,
    sphere: int = 1,
    columns: ColumnMap | None = None,
) -> dict[str, Array]:
    """Return the columns of a measurement file from a trace: commands, distances, their usual noise, approaches.

    Columns of the trace: `reading_m`, by how much the bar is longer than calibrated, and `angle_rad` from the first
    axis of the plane, or `time_s` from the first sample (with :attr:`Circle.feed`).

    Args:
        path: the trace.
        robot: the robot; its tool point is the ball.
        circle: the circle that was programmed.
        samples: how many samples, evenly spaced along the trace, are taken.
        sphere: number of the socket in the measurement file: the same for all traces about one socket.
        columns: what the trace does not say of itself.

    Raises:
        MeasurementError: the trace cannot be read, has times and no feed is given, or a reading is no reading.
        InvalidValueError: fewer than four samples are to be taken.
        UnreachablePoseError: the machine cannot go round this circle.
    """
    if samples < _MIN_SAMPLES:
        raise InvalidValueError("samples", samples, "four or more: a socket has three coordinates")
    given = columns or ColumnMap()
    known = replace(given, columns={"reading": _READING, "angle": _ANGLE, **given.columns})
    export = Export.read(Path(path), (_READING,), known)
    timed = not {name for name in export.headings if name.startswith("angle_")}
    along = _TIME if timed else _ANGLE
    if timed and _TIME not in export.headings:
        raise MeasurementError(export.path, f"has neither {_ANGLE} nor {_TIME}", [max(1, export.header_line)])
    table = export.table((_READING, along))
    table.keep(np.asarray(np.isfinite(table.matrix((_READING, along))).all(axis=1)))
    if timed and circle.feed is None:
        raise MeasurementError(table.path, f"has {_TIME} and no {_ANGLE}: expected the feed along the circle")
    far = np.abs(table[_READING]) > _LONGEST * circle.length
    if far.any():
        problem = (
            f"{_READING} is {table[_READING][far][0]:.6g}, a tenth of the bar or more: another unit, or its length?"
        )
        raise MeasurementError(table.path, problem, table.lines_where(far))
    turn = 1.0 if circle.sense == Sense.CCW else -1.0
    if timed:
        angles = circle.start + turn * (circle.feed or 0.0) / circle.length * (table[_TIME] - table[_TIME].min())
    else:
        angles = table[_ANGLE]
        if len(angles) > 1 and turn * float(np.median(np.diff(angles))) < 0.0:
            falls = "fall, which is clockwise" if turn > 0.0 else "rise, which is counter-clockwise"
            raise MeasurementError(table.path, f"{_ANGLE}: they {falls}, and the trace is said to be {circle.sense}")
    chosen = np.unique(np.linspace(0, len(table) - 1, min(samples, len(table))).round().astype(int))
    angles, readings = angles[chosen], table[_READING][chosen]
    commands, before = (_commands(robot, circle.points(angles - back)) for back in (0.0, turn * _STEP))
    names = command_columns(robot)
    found = dict(zip(names, commands.T, strict=True))
    found |= {"distance_m": circle.length + readings, "sigma_distance_m": np.full(len(chosen), BALLBAR.sigma)}
    found |= {"sphere": np.full(len(chosen), float(sphere))}
    directions = np.sign(np.round(commands - before, 9))
    return found | dict(zip(approach_columns(len(directions.T)), directions.T, strict=True))


def write_ballbar(traces: Sequence[dict[str, Array]], path: Path | str) -> Path:
    """Write the columns of one or several traces as one measurement file; raise OutputError on failure."""
    names = list(traces[0])
    rows = np.concatenate([np.column_stack([trace[name] for name in names]) for trace in traces])
    return write_text_atomically(path, csv_text([names, *rows.tolist()]))


def _commands(robot: Robot, points: Array) -> Array:
    if len(robot.command_coordinates) < _FREE:  # the orientation is what the machine makes it
        return np.asarray(robot.reach(points).commands)
    placements = np.tile(robot.home.tool_placement.homogeneous, (len(points), 1, 1))
    placements[:, :3, 3] = points
    return np.asarray(robot.reach(placements).commands)
