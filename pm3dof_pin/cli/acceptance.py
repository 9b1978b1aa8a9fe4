"""`pm3dof acceptance`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer

from pm3dof_pin.calibration.acceptance import (
    STANDARDS,
    InstrumentErrors,
    evaluate_acceptance,
    planned_targets,
    write_acceptance_plan,
)
from pm3dof_pin.calibration.folder import read_compensation
from pm3dof_pin.cli.calibration_options import ConditionWords, completed, conditions_of, require_calibration_of
from pm3dof_pin.cli.options import ColumnsOf, Json, RobotOptions
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import ColumnMap

TestName: TypeAlias = Literal["positioning", "diagonals", "circular", "probing"]
"""Tests of ISO 230-2, -6, -4 and -10."""

LineEnds: TypeAlias = tuple[float, float, float, float, float, float]
"""Two points, base axes [m]."""

CentreAndRadius: TypeAlias = tuple[float, float, float, float]
"""A circle or sphere, base axes [m]."""


def acceptance(
    action: Annotated[Literal["plan", "evaluate"], typer.Argument(help="What to do.", show_default=False)],
    test: Annotated[TestName, typer.Argument(help="Which test of ISO 230.", show_default=False)],
    which: RobotOptions,
    file: Annotated[Path | None, typer.Argument(metavar="[FILE]", help="evaluate: what was measured (CSV).")] = None,
    line: Annotated[
        LineEnds | None,
        typer.Option(metavar="X Y Z X Y Z", help="plan: ends of a line, or opposite corners of a box, base axes [m]."),
    ] = None,
    circle: Annotated[
        CentreAndRadius | None,
        typer.Option(metavar="X Y Z R", help="plan: centre and radius of a circle or sphere [m]."),
    ] = None,
    targets: Annotated[int, typer.Option(min=5, help="plan: targets on a line.")] = 5,
    runs: Annotated[int, typer.Option(min=2, help="plan: runs from each side, or rounds in each direction.")] = 5,
    calibration: Annotated[
        Path | None, typer.Option(metavar="DIR", help="plan: correct the commands by this calibration.")
    ] = None,
    condition: ConditionWords = None,
    columns: ColumnsOf = None,
    radius: Annotated[
        float | None, typer.Option(min=1e-9, metavar="METRES", help="evaluate: nominal radius of the circle or sphere.")
    ] = None,
    noise: Annotated[
        float,
        typer.Option(
            min=0.0,
            help="evaluate: noise of a reading of the instrument [m]; without it, --per-length and --drift, no "
            "uncertainty is stated.",
        ),
    ] = 0.0,
    per_length: Annotated[
        float, typer.Option(min=0.0, help="evaluate: its relative error of lengths, standard deviation.")
    ] = 0.0,
    drift: Annotated[
        float, typer.Option(min=0.0, help="evaluate: drift during the test, standard deviation [m].")
    ] = 0.0,
    out: Annotated[Path, typer.Option(help="Output: commands (CSV), or results (JSON).")] = Path(
        "results/acceptance.csv"
    ),
    as_json: Json = False,
) -> None:
    """Plan a test of ISO 230-2, -4, -6 or -10, or evaluate one from a file, with its test uncertainty; in metres."""
    if action == "plan":
        place = circle if test in ("circular", "probing") else line
        if place is None or file is not None:
            name = "--circle" if test in ("circular", "probing") else "--line"
            raise typer.BadParameter(f"plan {test} takes {name}, and no file")
        points, described = planned_targets(test, place, targets=targets, runs=runs)
        given = conditions_of(condition or [])
        if calibration is None:
            if given:
                raise typer.BadParameter("--condition is for --calibration")
            known, conditions, robot = None, None, which.load()
        else:
            known = read_compensation(calibration)
            robot = known.errors.robot
            if which.robot is not None:
                reading = which.reading | {"tool_frame": which.tool_frame or robot.tool_frame}
                require_calibration_of(Robot.load(which.robot, **reading), robot, calibration)
            conditions = completed(known, given)
        path = write_acceptance_plan(robot, points, described, out.with_suffix(".csv"), known, conditions)
        plan: dict[str, Any] = {"robot": robot.name, "test": test, "standard": STANDARDS[test], "points": len(points)}
        plan |= {"corrected": known is not None}
        said = "corrected by the calibration" if known is not None else "not corrected"
        print_result(plan, [f"{STANDARDS[test]}: {len(points)} points, {said}"], as_json=as_json, files=[path])
        return
    if file is None:
        raise typer.BadParameter("evaluate takes a file")
    of_plans = {"--line": line, "--circle": circle, "--calibration": calibration, "--condition": condition}
    if refused := [name for name, value in of_plans.items() if value]:
        raise typer.BadParameter(f"{refused[0]} is for plan, not for evaluate")
    errors = InstrumentErrors(noise, per_length, drift)
    column_map = None if columns is None else ColumnMap.load(columns)
    found = evaluate_acceptance(test, file, instrument=errors, radius=radius, columns=column_map)
    # readings are of a line, a circle or a sphere, of whatever robot
    result = ({} if which.robot is None else {"robot": which.load().name}) | found.as_data()
    for note in found.notes:
        message(f"pm3dof: {file}: {note}")
    path = write_text_atomically(out.with_suffix(".json"), json.dumps(result, indent=2) + "\n")
    rows = [
        [
            name,
            f"{1e6 * value:z.1f}",
            "not stated" if (spread := found.uncertainties[name]) is None else f"{1e6 * spread:z.1f}",
        ]
        for name, value in found.values.items()
    ]
    lines = [f"{found.standard}, {found.readings} readings", *table_lines(["result", "[µm]", "U, k = 2"], rows)]
    print_result(result, lines, as_json=as_json, files=[path])
