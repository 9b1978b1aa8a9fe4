"""`pm3dof path`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pm3dof_pin.calibration.folder import read_compensation
from pm3dof_pin.cli.options import Json, Payload, RobotErrorsOptions, finite_number
from pm3dof_pin.cli.output import LIMIT_BROKEN, message, print_result, progress_bar, table_lines
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.mechanism.tool_components import rotation_of_angles
from pm3dof_pin.paths.evaluation import TOLERANCE, PathOptions, evaluate_path
from pm3dof_pin.paths.follower import with_tool_length
from pm3dof_pin.paths.planning import MotionLimits
from pm3dof_pin.paths.tool_path import read_path
from pm3dof_pin.paths.writing import write_path
from pm3dof_pin.typing import Matrix

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
    feed: Annotated[
        float | None, typer.Option(metavar="V", help="Feed instead of the program's [m/s].", parser=finite_number)
    ] = None,
    rapid: Annotated[
        float, typer.Option(metavar="V", help="Feed of rapids, and where none is given [m/s].", parser=finite_number)
    ] = MotionLimits.rapid,
    acceleration: Annotated[
        float, typer.Option(metavar="A", help="Greatest acceleration along the path [m/s^2].", parser=finite_number)
    ] = MotionLimits.acceleration,
    tolerance: Annotated[
        float, typer.Option(metavar="E", help="Greatest deviation between points [m].", parser=finite_number)
    ] = TOLERANCE,
    spacing: Annotated[
        float | None,
        typer.Option(
            metavar="D",
            help="Greatest distance of points [m]; 1/50 of the robot's size by default.",
            parser=finite_number,
        ),
    ] = None,
    calibration: Annotated[
        Path | None, typer.Option(metavar="DIR", help="Folder that `pm3dof calibrate` wrote, for calibrated commands.")
    ] = None,
    large: Annotated[
        bool, typer.Option("--large", help="Deflections by the equilibrium under load, pose by pose; slow.")
    ] = False,
    out: Annotated[
        Path | None, typer.Option(metavar="FILE", help="All points: CSV, or NetCDF if the name ends in .nc.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Judge a tool path before it is run: limits, speeds, forces, deflection, accuracy; angles in degrees, metres.

    Points that break a limit are kept, with a message and exit status 1.
    """
    errors = which.load_errors()
    robot = errors.robot
    placements = dict(map(_placement, workpiece or ()))
    has_tool = tool_length != 0.0
    tool_path = read_path(with_tool_length(robot, tool_length), file, workpiece=placements, has_tool=has_tool)
    known = None if calibration is None else read_compensation(calibration)
    if known is not None and known.errors.robot.name != robot.name:
        raise InvalidValueError("--calibration", calibration, f"a calibration of {robot.name}")
    limits = MotionLimits(acceleration=acceleration, rapid=rapid, feed=feed)
    options = PathOptions(
        tool_length=tool_length,
        table=[name.strip() for name in table.split(",") if name.strip()],
        limits=limits,
        tolerance=tolerance,
        spacing=spacing,
        force=force,
        payload=payload,
        large=large,
        errors=errors if errors.file is not None else None,
        calibration=known,
    )
    found = evaluate_path(robot, tool_path, options)
    files = []
    with progress_bar("points") as progress:
        if out is not None:
            files.append(write_path(found, out, progress=progress))
    summary = {"file": str(file)} | found.summary
    print_result(summary, _lines(summary), as_json=as_json, files=files)
    if not summary["within_limits"]:
        beyond = summary["points"] - summary["points_within_limits"]
        words = ", ".join(summary["broken_limits"]) or "another branch"
        line = summary["first_line_beyond_limits"]
        message(f"pm3dof: {beyond} of {summary['points']} points break a limit ({words}), first in line {line}")
        raise typer.Exit(LIMIT_BROKEN)


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


def _lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary as text."""
    lines = [
        f"{summary['points']} points, {summary['points_within_limits']} within limits and on home's branch; "
        f"{summary['time_s']:.2f} s, {summary['energy_J']:.4g} J",
        "",
    ]
    rows = []
    for key, (words, factor, unit) in _WORDS.items():
        if key in summary:
            rows.append([words, f"{factor * summary[key]:.4g}", unit, str(summary["lines"][key])])
    lines += [line.rstrip() for line in table_lines(["worst along the path", "", "", "line"], rows)]
    drives = [_drive_row(drive) for drive in summary["drives"]]
    header = ["drive", "rms force", "peak force", "", "peak speed", "", "peak acceleration", "", "peak power [W]"]
    return [*lines, "", *(line.rstrip() for line in table_lines(header, drives))]


_WORDS = {
    "least_limit_margin": ("limit margin, of the joint's range", 1.0, ""),
    "least_singularity_distance": ("distance to a singularity", 1.0, ""),
    "greatest_feed_m_s": ("feed", 6e4, "mm/min"),
    "least_feed_ceiling_m_s": ("least feed ceiling by the drives", 6e4, "mm/min"),
    "greatest_deflection_m": ("deflection", 1e6, "µm"),
    "least_stiffness_along_N_m": ("stiffness along the feed", 1e-6, "N/µm"),
    "least_stiffness_across_N_m": ("stiffness across the feed", 1e-6, "N/µm"),
    "greatest_expected_error_m": ("expected error, rms", 1e6, "µm"),
    "greatest_error_95_percent_m": ("error with 95 % probability", 1e6, "µm"),
    "greatest_error_bound_m": ("error, at most", 1e6, "µm"),
    "lowest_frequency_Hz": ("lowest natural frequency", 1.0, "Hz"),
}


def _drive_row(drive: dict[str, Any]) -> list[str]:
    force = "N_m" if "rms_force_N_m" in drive else "N"
    length = "m" if "peak_speed_m_s" in drive else "rad"
    return [
        drive["drive"],
        f"{drive[f'rms_force_{force}']:.4g}",
        f"{drive[f'peak_force_{force}']:.4g}",
        force.replace("_", " "),
        f"{drive[f'peak_speed_{length}_s']:.4g}",
        f"{length}/s",
        f"{drive[f'peak_acceleration_{length}_s2']:.4g}",
        f"{length}/s^2",
        f"{drive['peak_power_W']:.4g}",
    ]
