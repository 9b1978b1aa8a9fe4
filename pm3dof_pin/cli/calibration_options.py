"""What commands that correct by a calibration have in common: whose it is, and under which conditions."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, TypeAlias

import numpy as np
import typer

from pm3dof_pin.calibration.compensation import Compensation, Conditions
from pm3dof_pin.calibration.session_effects import TIME_COLUMN
from pm3dof_pin.cli.output import message
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import coordinate_scales
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array

_TRIED = 0.01  # motion of a coordinate [characteristic lengths, rad]

ConditionWords: TypeAlias = Annotated[
    list[str] | None,
    typer.Option(
        "--condition",
        metavar="NAME=VALUE",
        help="A temperature, a load, or the time (time_s) for drift, named as its column; may be repeated.",
    ),
]


def require_calibration_of(asked: Robot, machine: Robot, calibration: Path) -> None:
    """Check that a calibrated machine is the robot asked for; otherwise raise InvalidValueError."""
    if not _moves_alike(asked, machine):
        found = machine.name if asked.name != machine.name else f"another {machine.name}"
        raise InvalidValueError("--calibration", calibration, f"a calibration of {asked.name}, not of {found}")


def _moves_alike(one: Robot, other: Robot) -> bool:
    """Tell whether two robots have the same drives, and the same tool poses at commands around home."""
    drives = [[(command.name, command.unit) for command in robot.commands] for robot in (one, other)]
    if drives[0] != drives[1] or not np.allclose(one.home.commands, other.home.commands, rtol=0.0, atol=SAME):
        return False
    # commands that agree: with more drives than degrees of freedom none can move alone; from home, with a guess, no
    # way around is sought to poses next to it that cannot be reached
    home = one.at(one.home.q).coordinates
    steps = _TRIED * np.diag(coordinate_scales(one, one.coordinates))
    targets = np.vstack([home, home + steps])
    poses = one.solve(targets, guess=one.home, on_failure="nan", engine="pinocchio")
    places = other.forward(poses.commands, guess=other.home, on_failure="nan", engine="pinocchio").transforms
    return bool(np.allclose(poses.transforms, places, rtol=0.0, atol=SAME, equal_nan=True))


def conditions_of(words: Sequence[str]) -> dict[str, float]:
    """Read NAME=VALUE of `--condition`; a name twice or a value that is not finite ends the command with status 2."""
    conditions: dict[str, float] = {}
    for word in words:
        name, _, value = (part.strip() for part in word.partition("="))
        try:
            number = float(value)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise typer.BadParameter(f"--condition {word}: expected NAME=VALUE with a finite number")
        if name in conditions:
            raise typer.BadParameter(f"--condition {word}: {name} is given twice, expected once")
        conditions[name] = number
    return conditions


def given_once(
    given: Mapping[str, Array | float], more: Mapping[str, Array | float], where: str
) -> dict[str, Array | float]:
    """Join conditions by name; one that is given twice ends the command with status 2."""
    if both := sorted(set(given) & set(more)):
        raise typer.BadParameter(f"given twice, the second time by {where}: {', '.join(both)}: expected once")
    return {**given, **more}


def completed(compensation: Compensation, given: Conditions) -> Conditions:
    """Fill in missing conditions with the middle of the measured range; report these and any outside it."""
    complete = compensation.with_usual_conditions(given)
    for name in sorted(set(complete) - set(given)):
        message(f"pm3dof: {name} is not given: using {complete[name]:.4g}, the middle of the measured range")
    if compensation.session.drift.size and TIME_COLUMN not in complete:
        message(f"pm3dof: {TIME_COLUMN} is not given: drift is not corrected, the middle of the session is assumed")
    if compensation.learned is not None:
        for name, (least, most) in compensation.learned.inputs.beyond(given).items():
            value = given[name]
            words = f"{name} = {value:.4g} is" if isinstance(value, float) else f"some {name} are"
            message(f"pm3dof: {words} outside the measured range {least:.4g} .. {most:.4g}: it is extrapolated")
    return complete
