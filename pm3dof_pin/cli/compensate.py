"""`pm3dof compensate`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from pm3dof_pin.calibration.compensation import Compensated
from pm3dof_pin.calibration.folder import read_compensation
from pm3dof_pin.calibration.session_effects import approaches_along
from pm3dof_pin.cli.calibration_options import (
    ConditionWords,
    completed,
    conditions_of,
    given_once,
    require_calibration_of,
)
from pm3dof_pin.cli.options import Json, OutFile, PlaceOptions, PoseOptions, Wrench
from pm3dof_pin.cli.output import progress_bar, table_lines
from pm3dof_pin.cli.poses import (
    expected_numbers,
    names_and_units,
    place,
    print_at_pose,
    read_table,
    write_batch,
)
from pm3dof_pin.cli.temperature_stream import compensate_warm
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.pose_file import readings
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.joint_columns import approach_columns, drive_names
from pm3dof_pin.measuring.wrenches import WRENCH_COLUMNS
from pm3dof_pin.typing import Array

_PATH = "path"
_SIGNS = {"+": 1.0, "-": -1.0, "1": 1.0, "+1": 1.0, "-1": -1.0, "0": 0.0}


def compensate(
    calibration: Annotated[Path, typer.Option(metavar="DIR", help="Folder that `pm3dof calibrate` wrote.")],
    at: PlaceOptions,
    robot: Annotated[
        str | None,
        typer.Option("--robot", metavar="NAME|PATH", help="The robot, to check that the calibration belongs to it."),
    ] = None,
    poses: Annotated[
        Path | None,
        typer.Option(
            "--poses",
            metavar="FILE",
            help="Many poses: CSV with a column NAME_deg, NAME_rad or NAME_m for each coordinate, or with x_m, y_m, "
            "z_m, qw, qx, qy, qz; columns of temperatures and loads may follow.",
        ),
    ] = None,
    out: OutFile = None,
    condition: ConditionWords = None,
    approach: Annotated[
        str | None,
        typer.Option(
            metavar="SIGNS|path",
            help="Correct hysteresis: the direction in which each drive arrives, such as +,-,0 (0: unknown); or path, "
            "for poses in the order of the file.",
        ),
    ] = None,
    wrench: Wrench = None,
    temperatures: Annotated[
        str | None,
        typer.Option(
            metavar="FILE|-",
            help="Rows of poses, as in --poses, with columns rise_NAME_K: the temperature rise of a link, of a drive's "
            "screw, or of `all`, since the calibration [K]. With -, rows of standard input are answered one by one.",
        ),
    ] = None,
    as_json: Json = False,
) -> None:
    """Compute commands that take the calibrated machine to one pose or many: angles in degrees, lengths in metres.

    Differences are motions of the drives. A pose that breaks a joint limit is still computed, with a message and exit
    status 1.
    """
    chosen = PoseOptions(pose=at.pose, configuration=at.configuration, poses=poses, out=None if temperatures else out)
    loads = dict(zip(WRENCH_COLUMNS, wrench or (), strict=False))
    given = given_once(conditions_of(condition or []), loads, "--wrench")
    known = read_compensation(calibration)
    machine = known.errors.robot
    columns_of_approach = approach_columns(len(machine.commands))
    if approach is not None and not known.session.hysteresis.size:
        raise InvalidValueError("--approach", approach, "a calibration with hysteresis (time_s or approach_u1 ...)")
    if approach is not None and approach != _PATH:
        given = given_once(given, _directions(approach, columns_of_approach), "--approach")
    if robot is not None:
        require_calibration_of(_loaded(robot, machine), machine, calibration)
    if temperatures is not None:
        if given or approach or not chosen.is_empty:
            raise typer.BadParameter("--temperatures holds the poses; expected no others, nor conditions or loads")
        compensate_warm(known, temperatures, out, as_json=as_json, eta=known.eta)
        return
    if chosen.is_empty:
        raise typer.BadParameter(f"expected a pose: {expected_numbers(machine, machine.coordinates)}")
    if chosen.poses is not None:
        learned = () if known.learned is None else known.learned.inputs.conditions
        names = (*learned, *known.session.columns(len(machine.commands)))
        table = read_table(machine, chosen.poses, used=names)
        many, numbers = table.poses, {name: table.others[name] for name in names if name in table.others}
        if approach == _PATH:
            along = dict(zip(columns_of_approach, approaches_along(many.commands).T, strict=True))
            given = given_once(given, along, "--approach path")
        conditions = completed(known, given_once(given, numbers, f"a column of {chosen.poses}"))
        with progress_bar("compensating") as progress:
            answer = known.compensate(many, conditions, on_failure="nan", with_deviations=False, progress=progress)
        columns = {
            **_without_commands(table.columns, machine),
            **numbers,
            **readings(machine.command_coordinates, answer.commands),
            "predicted_error_m": answer.predicted_error,
            "error_95_percent_m": answer.error_bound,
        }
        write_batch(many, columns, out, as_json)
        return
    if approach == _PATH:
        raise typer.BadParameter("--approach path needs the poses of a path (--poses); for one pose give signs: +,-,0")
    solved = place(machine, chosen)
    conditions = completed(known, given)
    answer = known.compensate(solved.reshape(1), conditions)
    units = {command.unit for command in machine.commands}
    numbers = {"u": answer.commands[0], "u_nominal": answer.nominal_commands[0], "deviation": answer.deviations[0]}
    result: dict[str, Any] = {
        **numbers,
        "commands": names_and_units(machine.command_coordinates),
        **({f"{name}_{min(units)}": values for name, values in numbers.items()} if len(units) == 1 else {}),
        "predicted_error_m": answer.predicted_error[0],
        "error_95_percent_m": answer.error_bound[0],
        "conditions": conditions,
    }
    print_at_pose(solved, result, _lines(machine, answer), as_json=as_json)


def _without_commands(columns: Mapping[str, Array], machine: Robot) -> dict[str, Array]:
    """Return the columns of the poses, without those of commands, beside which corrected ones would be ambiguous."""
    commands = {name for pair in drive_names(machine).items() for name in pair}
    return {name: values for name, values in columns.items() if name.rpartition("_")[0] not in commands}


def _loaded(robot: str, machine: Robot) -> Robot:
    """Load the robot of `--robot`, with the calibrated tool."""
    return Robot.load(robot, tool_frame=machine.tool_frame)


def _directions(words: str, columns: tuple[str, ...]) -> dict[str, float]:
    signs = [_SIGNS.get(word.strip()) for word in words.split(",")]
    if None in signs or len(signs) != len(columns):
        expected = f"{len(columns)} directions, such as {','.join('+-0'[k % 3] for k in range(len(columns)))}, or path"
        raise typer.BadParameter(f"--approach {words}: expected {expected}")
    return {name: sign for name, sign in zip(columns, signs, strict=True) if sign is not None}


def _lines(robot: Robot, answer: Compensated) -> list[str]:
    factors = [1.0 if command.unit == "m" else math.degrees(1.0) for command in robot.commands]
    names = {"m": ("m", "µm"), "rad": ("deg", "µrad")}
    units = [names[unit] for unit in dict.fromkeys(command.unit for command in robot.commands)]
    unit, small = (", ".join(words) for words in zip(*units, strict=True))
    sizes = [abs(command.scale) for command in robot.commands]
    rows = [
        [
            command.name,
            f"{factor * u:z.9f}",
            f"{factor * nominal:z.9f}",
            f"{1e6 * (u - nominal) / size:z.2f}",
        ]
        for command, factor, u, nominal, size in zip(
            robot.commands, factors, answer.commands[0], answer.nominal_commands[0], sizes, strict=True
        )
    ]
    lines = table_lines(["drive", f"command [{unit}]", f"nominal [{unit}]", f"difference [{small}]"], rows)
    expected, bound = 1e6 * answer.predicted_error[0], 1e6 * answer.error_bound[0]
    return [*lines, f"expected tip error: {expected:z.1f} µm; below {bound:z.1f} µm with 95 % probability"]
