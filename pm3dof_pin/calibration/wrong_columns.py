"""Columns of measurements that do not fit when all others do: what they should be, and how they differ."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from pm3dof_pin.calibration.mistakes import SHIFTS, Mistake, rows_apart
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.errors.command_correction import command_scales, descend, weighted_control
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array

_LIKE = 0.1  # greatest remaining fraction of the differences if a simpler form describes them
_SAME = 1e-9
_STEPS = 3  # times the steps of one descent
_ELSE = ", and all else fits"


def wrong_columns(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Iterable[Mistake]]:
    """Yield columns that do not fit when all others do; without them, the rest explains itself too easily."""
    yield _of_one_column(measurements, nominal, eta)
    if measurements.rotations is not None and measurements.seen.all():
        for columns, wrong, right in (
            ([3, 4, 5], "orientations", "positions"),
            ([0, 1, 2], "positions", "orientations"),
        ):
            text = f"the {wrong} do not fit the commands, and the {right} do"
            yield [Mistake(text, _unseen(measurements, columns), nominal)]


def _of_one_column(measurements: Measurements, nominal: Poses, eta: float) -> Iterator[Mistake]:
    if measurements.seen[:, :3].all():
        expected = measurements.points_on(nominal)
        table = dict(zip(("x_m", "y_m", "z_m"), measurements.positions.T, strict=True))
        for k, name in enumerate(table):
            yield Mistake(_difference(name, table, expected[:, k]) + _ELSE, _unseen(measurements, [k]), nominal)
    names = [f"u{k + 1}" for k in range(len(nominal.robot.commands))]
    table = dict(zip(names, measurements.commands.T, strict=True))
    for k, name in enumerate(names):
        if (commands := _explaining_commands(measurements, nominal, [k], eta)) is not None:
            yield Mistake(
                _difference(name, table, commands[:, k]) + _ELSE, replace(measurements, commands=commands), None
            )


def _explaining_commands(measurements: Measurements, nominal: Poses, drives: list[int], eta: float) -> Array | None:
    """Return the commands of some drives that best explain the measurements, shape=(n, number of commands).

    None if the rows of a pose show too little: each pose needs two more equations than unknown drives.
    """
    numbers, first = measurements.visit_numbers, measurements.first_rows
    spare = 0 if len(drives) == len(nominal.robot.commands) else 2
    if measurements.seen.sum() < (len(drives) + spare) * len(first):
        return None
    scales = command_scales(nominal)

    def residuals(poses: Poses) -> Array:
        return seen_errors(measurements, poses, eta).errors

    def step(poses: Poses) -> Array:
        found = seen_errors(measurements, poses, eta)
        control = found.shown @ weighted_control(poses, eta)[:, :, drives]
        move = np.zeros((len(poses), len(scales)))
        move[:, drives] = scales[drives] * np.einsum("nij,nj->ni", np.linalg.pinv(control, rcond=1e-3), found.errors)
        return move

    poses, commands = nominal[first], measurements.commands[first]
    try:
        for _ in range(_STEPS):
            change, poses = descend(poses, commands, step, residuals, on_failure="nan")
            commands = commands + change
    except (PM3DofError, np.linalg.LinAlgError):
        return None
    return np.asarray(commands[numbers])


def _difference(name: str, table: dict[str, Array], right: Array) -> str:
    """Describe how a column differs from what it should be."""
    column, others = table[name], {other: values for other, values in table.items() if other != name}
    if np.ptp(column) < _SAME:
        return f"{name} is constant"
    if same := next((other for other, values in others.items() if np.abs(column - values).max() < _SAME), None):
        return f"{name} repeats {same}"
    if not np.isfinite(right).all() or np.ptp(right) < _SAME:
        return f"{name} does not belong to these rows"
    off = column - right
    zero = np.median(off)
    if np.median(np.abs(off - zero)) < _LIKE * abs(zero):
        return f"{name} has a shifted zero: it is {1e3 * zero:.4g} mm or mrad off"
    for shift in sorted(range(-SHIFTS, SHIFTS + 1), key=abs):
        if shift and np.median(np.abs(column - np.roll(right, shift))) < _LIKE * np.median(np.abs(off)):
            return f"{name} is {rows_apart(shift)} the rows it belongs to"
    slope, start = np.polyfit(right, column, 1)
    if np.median(np.abs(column - slope * right - start)) < _LIKE * np.median(np.abs(off)):
        return f"{name} is {slope:.5g} times what it should be: another unit, lead or sign"
    return f"{name} does not belong to these rows"


def _unseen(measurements: Measurements, columns: list[int]) -> Measurements:
    sigmas = measurements.sigmas.copy()
    sigmas[:, columns] = np.inf
    return replace(measurements, sigmas=sigmas)
