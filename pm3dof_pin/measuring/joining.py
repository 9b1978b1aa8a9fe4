"""A controller's log of commands and an instrument's list of measurements, joined by time or by order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.angles import replace_angles
from pm3dof_pin.measuring.export_file import ColumnMap, Export
from pm3dof_pin.measuring.joint_columns import command_columns, drive_names
from pm3dof_pin.typing import Array

_TIME = "time_s"
_AT_REST = 1e-5  # [m, rad]: within the tolerance of time, drives at rest stay within this


@dataclass(frozen=True, eq=False)
class Joined:
    """Rows of an instrument, with the commands at the same time."""

    columns: Mapping[str, Array]  #: commands, then the instrument's columns, in metres, radians, seconds
    without_commands: tuple[int, ...]  #: lines of the instrument's file at whose times the log has no row
    moving: tuple[int, ...]  #: lines at whose times the drives moved
    greatest_gap: float  #: greatest difference in time of the rows that were joined [s]; 0 if joined by order

    def write(self, path: Path | str) -> Path:
        """Write a measurement file, atomically and at full precision; raise OutputError on failure."""
        rows = np.column_stack(list(self.columns.values())).tolist()
        return write_text_atomically(path, csv_text([list(self.columns), *rows]))


def join(
    log: Path | str,
    seen: Path | str,
    robot: Robot,
    *,
    tolerance: float | None = 0.05,
    offset: float = 0.0,
    log_columns: ColumnMap | None = None,
    columns: ColumnMap | None = None,
) -> Joined:
    r"""Join a log of commands and a list of measurements.

    Each row of the instrument gets the commands of the log's row nearest in time. Rows during which the drives moved
    are left out: between the log's rows within the tolerance, by more than 10 um or 10 urad.

    Example:
        >>> from pathlib import Path
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.measuring.joining import join
        >>> _ = Path("log.csv").write_text("time_s,u1_m,u2_m,u3_m\n0,0.24,0.24,0.24\n5,0.25,0.24,0.24\n")
        >>> _ = Path("tracker.csv").write_text("Time [s],X [mm],Y [mm],Z [mm]\n5.01,0,3,480\n")
        >>> join("log.csv", "tracker.csv", pm.load("pm3dof")).columns["u1_m"]
        array([0.25])

    Args:
        log: file with commands, and with times.
        seen: file of the instrument, with times.
        robot: the robot.
        tolerance: greatest difference in time [s]; None to join row by row, without times.
        offset: what to add to the instrument's times to have the log's [s].
        log_columns: what the log does not say of itself.
        columns: what the instrument's file does not say of itself.

    Raises:
        MeasurementError: a file cannot be read, the instrument's angles have no known order, or nothing is left.
        InvalidValueError: the tolerance is not a positive number, or the offset not finite.
    """
    if tolerance is not None and not 0.0 < tolerance < np.inf:
        raise InvalidValueError("tolerance", tolerance, "a positive number of seconds")
    if not np.isfinite(offset):
        raise InvalidValueError("offset", offset, "a finite number of seconds")
    names, times = command_columns(robot), () if tolerance is None else (_TIME,)
    left = _table(Path(log), (*names, *times), log_columns, drive_names(robot))
    right = _table(Path(seen), times, columns)
    if columns is not None and columns.angles:
        replace_angles(right, columns.angles)
    commands = left.matrix(names)
    if tolerance is None:
        if len(left) != len(right):
            problem = f"has {len(right)} rows, {left.path} has {len(left)}: expected as many, to join them in order"
            raise MeasurementError(right.path, problem)
        rows, gaps = np.arange(len(right)), np.zeros(len(right))
        moving = np.zeros(len(right), dtype=bool)
    else:
        order = np.argsort(left[_TIME], kind="stable")
        clock, commands, at = left[_TIME][order], commands[order], right[_TIME] + offset
        after = np.clip(np.searchsorted(clock, at), 1, max(1, len(clock) - 1))
        before = np.minimum(after, len(clock)) - 1
        after = np.minimum(after, len(clock) - 1)
        rows = np.where(np.abs(clock[before] - at) <= np.abs(clock[after] - at), before, after)
        gaps = np.abs(clock[rows] - at)
        first = np.searchsorted(clock, at - tolerance, side="left")
        last = np.searchsorted(clock, at + tolerance, side="right")
        moving = np.array([_moved(commands[a:b]) for a, b in zip(first, last, strict=True)], dtype=bool)
    taken = gaps <= np.inf if tolerance is None else (gaps <= tolerance)
    moving &= taken
    kept = taken & ~moving
    if not kept.any():
        if moving.any():
            problem = "the drives move at every time of this file"
        else:
            spans = (f"from {table[_TIME].min():.9g} to {table[_TIME].max():.9g} s" for table in (right, left))
            problem = (
                "no time within {:.3g} ms of one of {}: it runs {}, the log {}; another clock (--offset-s)?".format(
                    1e3 * (tolerance or 0.0), left.path, *spans
                )
            )
        raise MeasurementError(right.path, problem)
    found = dict(zip(names, commands[rows[kept]].T, strict=True))
    found |= {name: values[kept] for name, values in right.columns.items() if name not in found}
    without, moved = right.lines_where(~taken), right.lines_where(moving)
    return Joined(found, tuple(without), tuple(moved), float(gaps[kept].max()))


def _table(
    path: Path, needed: tuple[str, ...], columns: ColumnMap | None, drives: Mapping[str, str] | None = None
) -> CsvTable:
    table = Export.read(path, needed, columns, drives).table(needed)
    table.keep(np.asarray(np.isfinite(table.matrix(needed)).all(axis=1)))
    return table


def _moved(commands: Array) -> bool:
    return bool(len(commands) > 1 and np.ptp(commands, axis=0).max() > _AT_REST)
