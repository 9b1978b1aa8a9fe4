"""Rows of temperatures and desired poses in, commands out: from a file, or line by line from standard input."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import numpy as np
import typer
from numpy.typing import ArrayLike

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.cli.output import message
from pm3dof_pin.cli.poses import limit_words, read_table, write_batch
from pm3dof_pin.errors.body_temperatures import BodyTemperatures, rise_column, rises_of
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.pose_file import BROKEN_LIMITS, PoseTable, columns_text, read_poses, readings
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array

STANDARD_INPUT = "-"


def compensate_warm(known: Compensation, source: str, out: Path | None, *, as_json: bool, eta: float) -> None:
    """Write the commands for rows of temperature rises and desired poses of a calibrated machine.

    A column `rise_NAME_K` is the temperature rise of a link, of a drive's screw, or of all, since the calibration.

    Raises:
        InvalidValueError: the calibration has learned temperatures itself, no column has a temperature, or one has that
            of an unknown body.
        MeasurementError: see :func:`~pm3dof_pin.kinematics.pose_file.read_poses`.
    """
    learned = () if known.learned is None else known.learned.inputs.conditions
    if temperatures := [name for name in learned if name.startswith("temperature")]:
        problem = f"this calibration has learned {', '.join(temperatures)}"
        raise InvalidValueError("--temperatures", problem=problem, expected="those columns in --poses, or --method lm")
    heat = BodyTemperatures.from_errors(known.errors, known.model)
    conditions = known.with_usual_conditions({})

    def commands(table: PoseTable) -> tuple[Poses, dict[str, Array]]:
        rises = rises_of(table.others)
        if not rises:
            expected = f"columns rise_NAME_K or gradient_LINK_x_K_per_m; names: {', '.join(heat.names)}"
            raise InvalidValueError("--temperatures", problem="has no temperatures", expected=expected)
        wanted = table.poses
        found = np.full(wanted.commands.shape, np.nan)
        cold = known.compensate(wanted, conditions, on_failure="nan", with_deviations=False).commands
        rows = np.flatnonzero(np.isfinite(cold).all(axis=1))
        if len(rows):
            at = known.model.forward(cold[rows], guess=wanted.q[rows])
            change = heat.corrections(at, {name: values[rows] for name, values in rises.items()}, eta=eta)
            found[rows] = cold[rows] + change
        named = {rise_column(name): values for name, values in rises.items()}
        return wanted, {**table.columns, **named, **readings(known.errors.robot.command_coordinates, found)}

    robot = known.errors.robot
    if source != STANDARD_INPUT:
        table = read_table(robot, Path(source), used=_rises_of(Path(source)))
        poses, columns = commands(table)
        write_batch(poses, columns, out, as_json)
        return
    if out is not None or as_json:
        raise typer.BadParameter("--temperatures -: rows go to standard output as they come, without --out and --json")

    def answer(path: Path, is_first: bool) -> dict[str, ArrayLike]:
        if is_first:
            read_table(robot, path, used=_rises_of(path))  # it names columns that are not used, once
        poses, columns = commands(read_poses(robot, path))
        return {**columns, BROKEN_LIMITS: limit_words(poses)}

    _stream(answer)


def _rises_of(path: Path) -> list[str]:
    header = path.read_text(encoding="utf-8").split("\n", 1)[0]
    names = [name.strip() for name in header.split(",")]
    return [rise_column(name) for name in rises_of(dict.fromkeys(names))]


def _stream(answer: Callable[[Path, bool], Mapping[str, ArrayLike]]) -> None:
    """Answer each line of standard input by one of output, at once; a line that is wrong ends the stream."""
    lines = ((k, line) for k, line in enumerate(_lines(), start=1) if line.strip() and not line.startswith("#"))
    _, header = next(lines, (0, None))
    if header is None:
        message("pm3dof: nothing on standard input: expected a header, then rows")
        raise typer.Exit(1)
    with tempfile.TemporaryDirectory() as folder:
        path, is_first = Path(folder, "row.csv"), True
        for number, line in lines:
            path.write_text(f"{header}{line}", encoding="utf-8")
            try:
                text = columns_text(answer(path, is_first)).splitlines(keepends=True)
            except MeasurementError as error:
                raise MeasurementError("standard input", error.problem, [number] if error.rows else []) from error
            typer.echo("".join(text if is_first else text[1:]), nl=False)
            sys.stdout.flush()
            is_first = False


def _lines() -> Iterator[str]:
    for line in sys.stdin:
        yield line if line.endswith("\n") else f"{line}\n"
