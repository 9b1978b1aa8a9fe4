"""`pm3dof path`."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import MISSING, fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import typer

from pm3dof_pin.calibration.folder import read_compensation
from pm3dof_pin.capability.transmission import drive_values
from pm3dof_pin.cli.calibration_options import ConditionWords, completed, conditions_of, require_calibration_of
from pm3dof_pin.cli.drive_options import DriveEffort, DriveSpeed, limits_of_drives
from pm3dof_pin.cli.error_options import RobotErrorsOptions
from pm3dof_pin.cli.options import Json, Payload, finite_number, numbers_by_name
from pm3dof_pin.cli.output import LIMIT_BROKEN, message, print_result, progress_bar, table_lines
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, unit_of
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.tool_components import rotation_of_angles, tool_components
from pm3dof_pin.paths.bounds import MotionLimits
from pm3dof_pin.paths.controller import controller_limits
from pm3dof_pin.paths.cutting import Milling
from pm3dof_pin.paths.evaluation import TOLERANCE, PathOptions, evaluate_path
from pm3dof_pin.paths.follower import with_tool_length
from pm3dof_pin.paths.placement import place_path
from pm3dof_pin.paths.summary import DRIVE_HEADER, WORST_HEADER, drive_rows, worst_rows
from pm3dof_pin.paths.tool_path import ToolPath, read_path
from pm3dof_pin.paths.writing import write_path
from pm3dof_pin.typing import Matrix, Vector

_NUMBERS_OF_PLACEMENT = (3, 6)
_SYSTEMS = range(54, 60)


def path(
    file: Annotated[
        Path,
        typer.Argument(
            metavar="FILE", help="CSV of poses, with columns time_s or feed_mm_min if wanted; or a program in G-code."
        ),
    ],
    which: RobotErrorsOptions,
    tool_length: Annotated[
        float, typer.Option(metavar="L", help="Length of the tool along z of the tool frame [m].", parser=finite_number)
    ] = 0.0,
    workpiece: Annotated[
        list[str] | None,
        typer.Option(
            metavar="[G5N=]X,Y,Z[,RX,RY,RZ]",
            help="Zero of the program's coordinate system in the base [m, deg], of G54 by default; may be repeated.",
        ),
    ] = None,
    table: Annotated[
        str, typer.Option(metavar="x,y", help="Directions in which a table moves the workpiece instead of the robot.")
    ] = "",
    force: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="FX FY FZ", help="Force on the tool point during cutting moves, base axes [N]."),
    ] = None,
    payload: Payload = 0.0,
    milling: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=NUMBER,..",
            help="Cutting force by the feed: tangential, radial [N/m^2], depth, width, diameter [m], rpm, teeth, and "
            "climb=1 for climb milling.",
        ),
    ] = None,
    place: Annotated[
        Literal["stiffest", "accurate", "fastest"] | None,
        typer.Option(help="Search the place of the workpiece where the path is best; --workpiece is where it starts."),
    ] = None,
    turn: Annotated[bool, typer.Option("--turn", help="With --place: the workpiece may be turned about z.")] = False,
    controller: Annotated[
        Path | None, typer.Option(metavar="FILE", help="INI file of a LinuxCNC machine, for its limits.")
    ] = None,
    feed: Annotated[
        float | None, typer.Option(metavar="V", help="Feed instead of the program's [m/s].", parser=finite_number)
    ] = None,
    rapid: Annotated[
        float | None,
        typer.Option(
            metavar="V",
            help=f"Feed of rapids, and if none is given [m/s]; {MotionLimits.rapid:g} or the controller's by default.",
            parser=finite_number,
        ),
    ] = None,
    acceleration: Annotated[
        float | None,
        typer.Option(
            metavar="A",
            help=f"Greatest acceleration along the path [m/s^2]; {MotionLimits.acceleration:g} or the controller's by "
            "default.",
            parser=finite_number,
        ),
    ] = None,
    jerk: Annotated[
        float | None,
        typer.Option(
            metavar="J",
            help="Greatest jerk along the path [m/s^3]; without it, or the controller's, the law is trapezoidal.",
            parser=finite_number,
        ),
    ] = None,
    effort: DriveEffort = None,
    speed: DriveSpeed = None,
    tolerance: Annotated[
        float, typer.Option(metavar="E", help="Greatest deviation between points [m].", parser=finite_number)
    ] = TOLERANCE,
    spacing: Annotated[
        float | None,
        typer.Option(
            metavar="D",
            help="Greatest distance of points [m]; 1/50 of the robot's size or 1/2000 of the path by default.",
            parser=finite_number,
        ),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder that `pm3dof calibrate` wrote, for calibrated commands.")
    ] = None,
    condition: ConditionWords = None,
    large: Annotated[
        bool, typer.Option("--large", help="Deflections by the equilibrium under load, pose by pose; slow.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="All points: CSV, or NetCDF if the name ends in .nc.")
    ] = None,
    report: Annotated[
        Path | None, typer.Option(metavar="FILE", help="A page with the summary and pictures (HTML).")
    ] = None,
    as_json: Json = False,
) -> None:
    """Judge a tool path before it is run: limits, speeds, forces, deflection, accuracy; angles in degrees, metres.

    Points that break a limit are kept, with a message and exit status 1.
    """
    errors = which.load_errors()
    robot = errors.robot
    placements = dict(map(_placement, workpiece or ()))
    pointed = with_tool_length(robot, tool_length)

    def read(workpiece: Mapping[int, Matrix]) -> ToolPath:
        return read_path(pointed, file, workpiece=workpiece, has_tool=tool_length != 0.0)

    tool_path = read(placements)
    known, conditions = None if calibration is None else read_compensation(calibration), conditions_of(condition or [])
    if known is not None and calibration is not None:
        require_calibration_of(robot, known.errors.robot, calibration)
    limits = MotionLimits() if controller is None else controller_limits(robot, controller)
    given: dict[str, Any] = {"acceleration": acceleration, "rapid": rapid, "feed": feed, "jerk": jerk}
    of_drives = limits_of_drives(robot, effort=effort, speed=speed)
    given["drive_force"] = drive_values(robot, "effort", of_drives["effort"]) if effort else None
    given["drive_speed"] = _drive_speed(robot, of_drives["speed"], limits.drive_speed) if speed else None
    limits = replace(limits, **{name: value for name, value in given.items() if value is not None})
    options = PathOptions(
        tool_length=tool_length,
        table=[name.strip() for name in table.split(",") if name.strip()],
        limits=limits,
        tolerance=tolerance,
        spacing=spacing,
        force=force,
        milling=_milling(milling),
        payload=payload,
        large=large,
        errors=errors if errors.file is not None else None,
        calibration=known,
        conditions=conditions,
    )
    if known is not None:
        completed(known, conditions)  # which says what is not known on a path
    placement = None
    if place is not None:
        placement = place_path(robot, tool_path, place, options, turn=turn)
        tool_path = read(placement.workpiece)
    found = evaluate_path(robot, tool_path, options)
    files = []
    with progress_bar("points") as progress:
        if out is not None:
            files.append(write_path(found, out, progress=progress))
    summary = {"file": str(file)} | found.summary
    lines = _lines(summary)
    if placement is not None:
        unit = placement.unit.replace("/", "_")
        zeros = {f"G{number}": _components(zero) for number, zero in placement.workpiece.items()}
        summary["place"] = {"goal": placement.goal, f"cost_{unit}": placement.cost, "workpiece": zeros}
        summary["place"][f"cost_before_{unit}"] = placement.cost_before
        lines = [f"placed: --workpiece {_option(name, zero)}" for name, zero in zeros.items()] + lines
    if report is not None:
        from pm3dof_pin.paths.report import path_report

        files.append(write_text_atomically(report, path_report(found, file.name, placement)))
    print_result(summary, lines, as_json=as_json, files=files)
    if not summary["within_limits"]:
        beyond = summary["points"] - summary["points_within_limits"]
        words = ", ".join(summary["broken_limits"]) or "another branch"
        line = summary["first_line_beyond_limits"]
        message(f"pm3dof: {beyond} of {summary['points']} points break a limit ({words}), first in line {line}")
    if beyond_force := summary["points_beyond_drive_force"]:
        share, line = f"{beyond_force} of {summary['points']}", summary["first_line_beyond_drive_force"]
        message(f"pm3dof: {share} points need more force than a drive has, first in line {line}")
    if not summary["within_limits"] or beyond_force:
        raise typer.Exit(LIMIT_BROKEN)


def _drive_speed(robot: Robot, given: float | dict[str, float] | None, of_controller: Vector | None) -> Vector:
    """Return the limits of `--speed`; drives that it does not name keep the controller's."""
    if isinstance(given, dict) and of_controller is not None:
        known = zip(robot.actuated_joints, of_controller.tolist(), strict=True)
        given = {name: value for name, value in known if math.isfinite(value)} | given
    return drive_values(robot, "speed", given)


def _placement(text: str) -> tuple[int, Matrix]:
    """Read [G5N=]X,Y,Z[,RX,RY,RZ]."""
    name, equals, rest = text.rpartition("=")
    system = name.strip().upper().removeprefix("G") if equals else "54"
    numbers = [finite_number(word) for word in rest.split(",")]
    if not system.isdigit() or int(system) not in _SYSTEMS or len(numbers) not in _NUMBERS_OF_PLACEMENT:
        raise typer.BadParameter(f"--workpiece {text}: expected X,Y,Z or X,Y,Z,RX,RY,RZ, after G54= to G59= if needed")
    placement = np.eye(4)
    placement[:3, :3] = rotation_of_angles([math.radians(angle) for angle in (*numbers[3:], 0.0, 0.0, 0.0)][:3])
    placement[:3, 3] = numbers[:3]
    return int(system), placement


def _milling(text: str | None) -> Milling | None:
    """Read NAME=NUMBER,.. of a milling cut."""
    numbers = numbers_by_name("--milling", text)
    if numbers is None:
        return None
    names = [entry.name for entry in fields(Milling)]
    needed = [entry.name for entry in fields(Milling) if entry.default is MISSING]
    if not isinstance(numbers, dict) or not set(needed) <= set(numbers) <= set(names):
        raise typer.BadParameter(f"--milling {text}: expected {', '.join(f'{name}=' for name in needed)}")
    return Milling(**numbers)


def _components(placement: Matrix) -> dict[str, float]:
    """Return a placement for JSON."""
    return {
        f"{name}_{unit_of(name)}": float(value)
        for name, value in zip(TOOL_COMPONENTS, tool_components(placement), strict=True)
    }


def _option(name: str, zero: Mapping[str, float]) -> str:
    """Return a placement as an option [m, deg]."""
    *_, rx, ry, rz = (round(math.degrees(value), 9) + 0.0 for value in zero.values())
    numbers = [round(value, 9) + 0.0 for value in list(zero.values())[:3]] + ([rx, ry, rz] if rx or ry or rz else [])
    return f"{name}=" + ",".join(f"{number:.9g}" for number in numbers)


def _lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary as text."""
    lines = [
        f"{summary['points']} points, {summary['points_within_limits']} within limits and on home's branch; "
        f"{summary['time_s']:z.2f} s, {summary['energy_J']:.4g} J",
        "",
    ]
    rows = worst_rows(summary)
    lines += [line.rstrip() for line in table_lines(WORST_HEADER, rows)]
    return [*lines, "", *(line.rstrip() for line in table_lines(DRIVE_HEADER, drive_rows(summary)))]
