"""Columns of commands: their names, and whether the machine can reach their values."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.exceptions import MeasurementError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array

_BEYOND_LIMITS = 0.2  # of a joint's range


def command_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the commands: u1_m, u2_m ... for linear drives, u1_rad ... for rotary ones."""
    return tuple(f"u{k}_{unit}" for k, unit in enumerate((command.unit for command in robot.commands), start=1))


def approach_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the drives' approach directions: approach_u1, approach_u2 ..."""
    return tuple(f"approach_u{k}" for k in range(1, len(robot.commands) + 1))


def start_columns(robot: Robot) -> tuple[str, ...]:
    """Return the columns of the commands at the pose where a distance starts: from_u1_m ..."""
    return tuple(f"from_{name}" for name in command_columns(robot))


def commands_of(table: CsvTable, robot: Robot) -> Array:
    """Return the commands, shape=(n, number of commands) [m, rad].

    Raises:
        MeasurementError: some are far outside the limits of the joints.
    """
    commands = table.matrix(command_columns(robot))
    lower, upper = np.array([robot.range_of(command) for command in robot.command_coordinates]).T
    slack = np.where(np.isfinite(upper - lower), _BEYOND_LIMITS * (upper - lower), 0.0)
    for k, name in enumerate(command_columns(robot)):
        unit = name.rsplit("_", 1)[1]

        def within(values: Array, k: int = k) -> NDArray[np.bool_]:
            inside: NDArray[np.bool_] = (values >= lower[k] - slack[k]) & (values <= upper[k] + slack[k])
            return inside

        bad = ~within(commands[:, k])
        if not bad.any():
            continue
        factor, other = (1e-3, "millimetres") if unit == "m" else (np.pi / 180.0, "degrees")
        problem = f"{name} is far outside the joint's limits {lower[k]:.6g} .. {upper[k]:.6g} {unit}"
        if bad.mean() > 0.5 and np.mean(within(factor * commands[:, k])[bad]) > 0.5:
            problem += f": these look like {other}"
        raise MeasurementError(table.path, problem, table.lines_where(bad))
    _warn_of_equal_columns(table, command_columns(robot))
    return commands


def _warn_of_equal_columns(table: CsvTable, names: Sequence[str]) -> None:
    """Warn of a drive that does not move while others do, and of two drives with the same values in every row."""
    still = [name for name in names if np.ptp(table[name]) == 0.0]
    moving = [name for name in names if name not in still]
    if moving and still:
        table.warn(f"{', '.join(still)} {'are' if len(still) > 1 else 'is'} the same in every row, unlike the others")
    pairs = [(a, b) for a, b in itertools.combinations(moving, 2) if np.array_equal(table[a], table[b])]
    for first, second in pairs:
        table.warn(f"{first} and {second} have the same values in every row")
