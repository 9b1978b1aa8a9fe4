"""Files of plans: commands, loads, and the nominal poses of the tool."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from pm3dof_pin.csv_table import csv_of_columns
from pm3dof_pin.errors.pose_error import quaternion
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.pose_file import PLACEMENT
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.joint_columns import checked_commands, command_columns, commands_table
from pm3dof_pin.typing import Array


def write_plan(poses: Poses, path: Path | str, loads: Mapping[str, Array] | None = None) -> Path:
    """Write a plan as CSV at full precision: commands, loads by column, and nominal poses of the tool.

    The nominal pose is that of the robot as described; the column names say that it is not a measurement.

    Raises:
        OutputError: the file cannot be written; no partial file is left.
    """
    columns: dict[str, Array] = dict(zip(command_columns(poses.robot), poses.commands.T, strict=True))
    nominal = np.concatenate([poses.positions, quaternion(poses.rotations)], axis=1)
    columns |= {f"nominal_{name}": values for name, values in zip(PLACEMENT, nominal.T, strict=True)}
    return write_text_atomically(path, csv_of_columns(columns | dict(loads or {})))


def read_plan(path: Path | str, robot: Robot) -> tuple[Array, dict[str, Array]]:
    """Read a plan, or any file with commands: these, and temperatures and loads by column, shape=(n,).

    Returns:
        The commands, shape=(n, number of commands) [m, rad], and the conditions.

    Raises:
        MeasurementError: the file is unreadable, a column is missing, a cell is not a number, no row is left, or a
            temperature or load is missing in some row.
    """
    table = commands_table(Path(path), robot, None)
    table.keep(np.asarray(np.isfinite(table.matrix(command_columns(robot))).all(axis=1)))
    return checked_commands(table, robot), table.conditions()
