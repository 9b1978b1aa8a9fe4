"""Columns of drives and joints in files of measurements and of plans: their names, and reading commands."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np

from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import ColumnMap, Export
from pm3dof_pin.typing import Array

ENCODER = "encoder_"
"""Start of the columns with readings of passive joints."""

_BEYOND_LIMITS = 0.2  # of a joint's range


def command_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the commands: u1_m, u2_m ... for linear drives, u1_rad ... for rotary ones."""
    return tuple(f"u{k}_{unit}" for k, unit in enumerate((command.unit for command in robot.commands), start=1))


def drive_names(robot: Robot) -> dict[str, str]:
    """Return the names that columns of commands may have instead of u1, u2 ..., and which of these they stand for.

    They are those of the drives, and of the joints whose coordinate is what the counter reads.
    """
    numbered = [(f"u{k}", command) for k, command in enumerate(robot.command_coordinates, start=1)]
    joints = {each.joint: u for u, each in numbered if each.joint and (each.offset, each.scale) == (0.0, 1.0)}
    return joints | {each.name: u for u, each in numbered}


def start_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the commands at the pose where a distance starts: from_u1_m ..."""
    return tuple(f"from_{name}" for name in command_columns(robot))


def approach_columns(drives: int) -> tuple[str, ...]:
    """Return the columns of the approach directions of so many drives: approach_u1, approach_u2 ..."""
    return tuple(f"approach_u{k}" for k in range(1, drives + 1))


def encoder_column(robot: Robot, joint: str) -> str:
    """Return the column of a passive joint's readings, such as encoder_hinge1_left_joint_rad.

    Raises:
        InvalidValueError: the joint is driven or has several degrees of freedom.
        JointNotFoundError: there is no such joint.
    """
    unit = robot.single_joint(joint).unit
    if joint in robot.actuated_joints:
        passive = ", ".join(robot.passive_joints) or "there is none"
        raise InvalidValueError("encoder", joint, f"a passive joint: {passive}")
    return f"{ENCODER}{joint}_{unit}"


def commands_table(path: Path, robot: Robot, columns: ColumnMap | None) -> CsvTable:
    """Read a file with commands."""
    return Export.read(path, command_columns(robot), columns, drive_names(robot)).table(command_columns(robot))


def checked_commands(table: CsvTable, robot: Robot) -> Array:
    """Return the commands, shape=(n, number of commands) [m, rad]; refuse those far outside the joints' limits."""
    if not robot.commands:
        raise InvalidValueError(robot.name, problem="has no drives", expected="driven joints (--drives, drives=[...])")
    names = command_columns(robot)
    commands = table.matrix(names)
    lower, upper = np.array([robot.range_of(command) for command in robot.command_coordinates]).T
    slack = np.where(np.isfinite(upper - lower), _BEYOND_LIMITS * (upper - lower), 0.0)
    for k, name in enumerate(names):
        unit = name.rsplit("_", 1)[1]
        factor, other = (1e-3, "millimetres") if unit == "m" else (np.pi / 180.0, "degrees")
        bad, looks = (
            ~((values >= lower[k] - slack[k]) & (values <= upper[k] + slack[k]))
            for values in (commands[:, k], factor * commands[:, k])
        )
        if bad.any():
            problem = f"{name} is far outside the joint's limits {lower[k]:.6g} .. {upper[k]:.6g} {unit}"
            if bad.mean() > 0.5 and looks[bad].mean() < 0.5:
                problem += f": these look like {other}"
            raise MeasurementError(table.path, problem, table.lines_where(bad))
    still = [name for name in names if np.ptp(table[name]) == 0.0]
    moving = [name for name in names if name not in still]
    if moving and still:
        table.warn(f"{', '.join(still)} {'are' if len(still) > 1 else 'is'} the same in every row, unlike the others")
    for first, second in itertools.combinations(moving, 2):
        if np.array_equal(table[first], table[second]):
            table.warn(f"{first} and {second} have the same values in every row")
    return commands
