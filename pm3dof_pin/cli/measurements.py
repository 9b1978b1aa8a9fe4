"""`pm3dof measurements`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from pm3dof_pin.cli.options import ColumnsOf, Json, RobotOptions
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.exceptions import OutputError, lines_in_words
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.ballbar import Circle, Sense, ballbar_columns, write_ballbar
from pm3dof_pin.measuring.export_file import ColumnMap
from pm3dof_pin.measuring.file_check import FileCheck
from pm3dof_pin.measuring.joining import join


def measurements(
    action: Annotated[Literal["check", "join", "ballbar"], typer.Argument(help="What to do.", show_default=False)],
    files: Annotated[
        list[Path],
        typer.Argument(
            metavar="FILE...", help="check: measurements; join: a log of commands, a tracker; ballbar: traces."
        ),
    ],
    which: RobotOptions,
    columns: ColumnsOf = None,
    log_columns: Annotated[
        str | None, typer.Option("--log-columns", metavar="FILE|PROFILE", help="join: the same for the log.")
    ] = None,
    own_frame: Annotated[
        bool, typer.Option("--own-frame", help="check: positions are in the instrument's own frame.")
    ] = False,
    tolerance: Annotated[
        float, typer.Option("--tolerance-ms", min=1e-3, help="join: greatest difference in time [ms].")
    ] = 50.0,
    offset: Annotated[
        float, typer.Option("--offset-s", help="join: what to add to the tracker's times to have the log's [s].")
    ] = 0.0,
    in_order: Annotated[bool, typer.Option("--in-order", help="join: row by row, without times.")] = False,
    centre: Annotated[
        tuple[float, float, float] | None,
        typer.Option(metavar="X Y Z", help="ballbar: about where the socket is, base axes [m]."),
    ] = None,
    length: Annotated[
        float, typer.Option(min=1e-6, help="ballbar: length of the bar, radius of the circle [m].")
    ] = 0.15,
    plane: Annotated[Literal["xy", "yz", "zx"], typer.Option(help="ballbar: plane of the circle.")] = "xy",
    start: Annotated[float, typer.Option("--start-deg", help="ballbar: angle of the first sample [deg].")] = 0.0,
    sense: Annotated[
        list[Sense] | None,
        typer.Option(help="ballbar: counter-clockwise or clockwise; once, or for each trace."),
    ] = None,
    feed: Annotated[
        float | None, typer.Option(min=1e-9, help="ballbar: feed along the circle, of traces with times [m/s].")
    ] = None,
    samples: Annotated[int, typer.Option(min=4, help="ballbar: samples taken of each trace.")] = 72,
    out: Annotated[Path, typer.Option(help="join, ballbar: output file (CSV).")] = Path("results/measurements.csv"),
    force: Annotated[
        bool, typer.Option("--force", help="join, ballbar: replace the output file if it exists.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Say what was understood of a file of measurements (check), or make one of other files (join, ballbar).

    Nothing is fitted. Lengths in metres, angles in radians.
    """
    if action != "ballbar" and len(files) != (1 if action == "check" else 2):
        raise typer.BadParameter(f"{action} takes {'one file' if action == 'check' else 'two files'}")
    given, of_log = (None if each is None else ColumnMap.load(each) for each in (columns, log_columns))
    robot = which.load()
    if action == "check":
        return _check(files[0], robot, given, own_frame=own_frame, as_json=as_json)
    if out.exists() and not force:
        raise OutputError(out, "exists and may hold real measurements: use --force to replace it")
    if action == "ballbar":
        if centre is None:
            raise typer.BadParameter("ballbar needs --centre")
        senses = sense or [Sense.CCW]
        if len(senses) not in (1, len(files)):
            raise typer.BadParameter("expected --sense once, or for each trace")
        traces = []
        for k, file in enumerate(files):
            circle = Circle(centre, length, plane, math.radians(start), senses[k % len(senses)], feed)
            traces.append(ballbar_columns(file, robot, circle, samples=samples, columns=given))
        path = write_ballbar(traces, out)
        taken = sum(len(trace["sphere"]) for trace in traces)
        found = {"robot": robot.name, "traces": len(files), "rows": taken}
        print_result(
            found, [f"{taken} distances from one socket, of {len(files)} traces"], as_json=as_json, files=[path]
        )
        return None
    within = None if in_order else 1e-3 * tolerance
    joined = join(files[0], files[1], robot, tolerance=within, offset=offset, log_columns=of_log, columns=given)
    path = joined.write(out)
    rows = len(next(iter(joined.columns.values())))
    for lines, why in ((joined.without_commands, "no commands at that time"), (joined.moving, "the drives moved")):
        if lines:
            message(f"pm3dof: {files[1]}: {lines_in_words(lines)}{why}; left out")
    result: dict[str, Any] = {"robot": robot.name, "rows": rows, "greatest_gap_s": joined.greatest_gap}
    result |= {"lines_without_commands": list(joined.without_commands), "lines_moving": list(joined.moving)}
    said = "in order" if in_order else f"times differ by up to {1e3 * joined.greatest_gap:.3g} ms"
    print_result(result, [f"{rows} rows joined, {said}"], as_json=as_json, files=[path])
    return None


def _check(file: Path, robot: Robot, columns: Any, *, own_frame: bool, as_json: bool) -> None:
    found = {"robot": robot.name} | FileCheck.read(file, robot, own_frame=own_frame, columns=columns).as_data()
    separators = {",": "commas", ";": "semicolons", "\t": "tabs", "blanks": "blanks"}
    between = separators.get(found["separator"], repr(found["separator"]))
    rows = [
        [name, entry["heading"], f"{entry['least']:.6g}", f"{entry['greatest']:.6g}", str(entry["empty_cells"] or "")]
        for name, entry in found["columns"].items()
    ]
    kinds = ", ".join(f"{count} {kind}" for kind, count in found["rows_by_kind"].items())
    beside, off = found["estimated_beside_the_machine"], found["median_distance_from_description_m"]
    lines = [
        f"{found['encoding'].upper()}, {between}, decimal {'commas' if found['decimal'] == ',' else 'points'}, "
        + (f"header on line {found['header_line']}, " if found["header_line"] else "no header, ")
        + f"{found['rows']} rows",
        f"{kinds}, at {found['different_commands']} different commands",
        f"to be estimated besides the machine: {', '.join(beside) or 'nothing'}",
        *([f"{1e6 * off:z.0f} µm (median) from the described machine"] if off is not None else []),
        "",
        *table_lines(["column", "heading", "least", "greatest", "empty"], rows, words=2),
    ]
    print_result(found, lines, as_json=as_json)
    for warning in found["warnings"]:
        message(f"pm3dof: warning: {warning}")
