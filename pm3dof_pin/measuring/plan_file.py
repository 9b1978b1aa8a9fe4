"""Plan files: commands to measure at, and the nominal poses of the tool."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pm3dof_pin.csv_table import CsvTable, columns_as_text
from pm3dof_pin.errors.pose_error import quaternion
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.command_columns import command_columns, commands_of
from pm3dof_pin.typing import Array

_NOMINAL_COLUMNS = tuple(f"nominal_{name}" for name in ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"))


def write_plan(poses: Poses, path: Path | str, loads: Mapping[str, Array] | None = None) -> Path:
    """Write a plan as CSV at full precision: commands, loads by column, and nominal poses of the tool.

    The nominal pose is that of the robot as described; the column names say that it is not a measurement.

    Raises:
        OutputError: the file cannot be written; no partial file is left.
    """
    columns: dict[str, Array] = dict(zip(command_columns(poses.robot), poses.commands.T, strict=True))
    seen = np.concatenate([poses.positions, quaternion(poses.rotations)], axis=1)
    columns |= dict(zip(_NOMINAL_COLUMNS, seen.T, strict=True)) | dict(loads or {})
    return write_text_atomically(path, columns_as_text(columns))


def read_commands(path: Path | str, robot: Robot) -> Array:
    """Read the commands, shape=(n, number of commands) [m, rad], of a CSV file with other columns, such as a plan.

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is not a number, or no row is left.
    """
    return commands_of(_table(path, robot), robot)


def read_plan(path: Path | str, robot: Robot) -> tuple[Array, dict[str, Array]]:
    """Read a plan: commands as :func:`read_commands`, and temperatures and loads, shape=(n,), by column.

    Raises:
        MeasurementError: see :func:`read_commands`; or a temperature or load is missing in some row.
    """
    table = _table(path, robot)
    return commands_of(table, robot), table.conditions()


def _table(path: Path | str, robot: Robot) -> CsvTable:
    table = CsvTable(Path(path), command_columns(robot))
    table.keep(np.asarray(np.isfinite(table.matrix(command_columns(robot))).all(axis=1)))
    return table
