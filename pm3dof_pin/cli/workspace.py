"""`pm3dof workspace`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from pm3dof_pin.cli import completion
from pm3dof_pin.cli.map_options import CoordinateRange, EngineOption, Values, robot_grid
from pm3dof_pin.cli.options import Json, MachineOrChapterOptions, Out
from pm3dof_pin.cli.output import print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, remove_former, save
from pm3dof_pin.description.coordinates import shown_in
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.chapter_workspace import compare_printed_ranges, printed_ranges, tripod_space
from pm3dof_pin.maps.datasets import write_map
from pm3dof_pin.maps.limit_space import LimitSpace, robot_space
from pm3dof_pin.maps.workspace import Interval, Workspace, reachable_intervals, spaces_by_branch
from pm3dof_pin.maps.workspace import workspace as reachable_set
from pm3dof_pin.typing import Array

_SECTIONS, _DIRECTIONS = 121, 360  # of the tripod
_FEW_SECTIONS, _FEW_DIRECTIONS = 31, 240  # of other robots
_ONE_SECTION_DIRECTIONS = 1440
_SLOW_SECTIONS = 11  # of robots whose poses take long


def workspace(
    which: MachineOrChapterOptions,
    out: Out = Path("results"),
    coordinate: Annotated[
        list[str] | None,
        typer.Option(
            "--coordinate",
            metavar="NAME",
            help="Two coordinates of the sections and one to stack them along; by default the first three.",
            autocompletion=completion.coordinates,
        ),
    ] = None,
    values: Values = None,
    heights: Annotated[
        int | None,
        typer.Option("--heights", "--sections", min=3, help="Number of sections (121; 31 with --robot, or 11)."),
    ] = None,
    directions: Annotated[
        int | None,
        typer.Option(min=8, help="Boundary points per section, about (360; 240 with --robot, 1440 of one section)."),
    ] = None,
    beyond_ranges: Annotated[
        bool, typer.Option("--beyond-ranges", help="Go beyond the declared ranges of coordinates, up to other limits.")
    ] = False,
    all_branches: Annotated[
        bool, typer.Option("--all-branches", help="What geometry alone allows, branch by branch, not only home's.")
    ] = False,
    picture: Annotated[bool, typer.Option(help="Draw the picture.")] = True,
    formats: Formats = None,
    engine: EngineOption = "program",
    as_json: Json = False,
) -> None:
    """Compute the workspace under all limits: boundary, areas, volume, which limit binds where (Fig. 8.2).

    Angles in degrees, lengths in metres. Sections over two coordinates are stacked along a third; the other coordinates
    stay at home, or at the value of --at. Coordinates end at their declared ranges too. Poses beyond a singular one are
    on another branch and out of reach; with --all-branches each branch is listed and drawn. Of a
    robot with one coordinate the intervals are printed.
    """
    given = which.robot or coordinate or values or which.tool_frame or engine != "program"
    given = given or beyond_ranges or all_branches
    tripod = None
    with progress_bar("workspace") as progress:
        if given:
            space = _robot_space(which.load(engine), coordinate, values, beyond_ranges, all_branches)
        else:
            tripod = which.tripod()
            space = tripod_space(tripod)
        sections = heights or (_SECTIONS if tripod else _FEW_SECTIONS if space.density == 1.0 else _SLOW_SECTIONS)
        usual = _DIRECTIONS if tripod else _FEW_DIRECTIONS if space.stacked else _ONE_SECTION_DIRECTIONS
        try:
            spaces = spaces_by_branch(space) if all_branches else {0: space}
            if len(space.names) == 1:
                _print_intervals(space, {n: reachable_intervals(own) for n, own in spaces.items()}, as_json)
                return
            branches = {n: reachable_set(own, sections, directions or usual) for n, own in spaces.items()}
        except InvalidValueError as error:
            raise typer.BadParameter(f"{space.machine}: {error}") from None
        found = next(iter(branches.values()))
        progress(1, 4 if picture else 3)
        files = []
        for number, own in branches.items():
            files += write_map(own.boundary(), out / (f"workspace_branch_{number}" if all_branches else "workspace"))
        progress(3, 4 if picture else 3)
        if picture and all_branches:
            from pm3dof_pin.figures.workspace import branches_figure

            files += save(branches_figure(branches), out / "workspace_branches.png", formats)
        elif picture:
            from pm3dof_pin.figures.workspace import workspace_figure

            name = "figure_8_2_workspace.png" if tripod else "workspace.png"
            printed = None if tripod is None else printed_ranges(tripod)
            files += save(workspace_figure(found, printed), out / name, formats)
        remove_former(out, "figure_8_2_workspace|workspace(_branches)?", files)
    if all_branches:
        results = {n: _result(own) | {"branch": n} for n, own in branches.items()}
        lines = [line for n, own in branches.items() for line in (f"branch {n}", *_lines(own, results[n]), "")]
        print_result({"robot": space.machine, "branches": [*results.values()]}, lines, as_json=as_json, files=files)
        return
    result = _result(found)
    if tripod is not None:
        result["printed_ranges"] = [statement.text for statement in compare_printed_ranges(tripod, found)]
    print_result(result, _lines(found, result), as_json=as_json, files=files)


def _print_intervals(space: LimitSpace, intervals: dict[int, list[Interval]], as_json: bool) -> None:
    name, unit = space.names[0], space.units[0]
    entries, lines = [], []
    for number, parts in intervals.items():
        for part in parts:
            entries.append({"branch": number, f"{name}_range_{unit}": part.ends, "limits": part.limits})
            below, above = (" and ".join(limits) for limits in part.limits)
            lines.append(
                f"{_range(name, unit, part.ends)}: {below} below, {above} above" + f" (branch {number})" * (number > 0)
            )
    print_result({"robot": space.machine, "intervals": entries}, lines, as_json=as_json)


def _robot_space(
    loaded: Robot,
    names: list[str] | None,
    values: list[CoordinateRange] | None,
    beyond_ranges: bool,
    all_branches: bool,
) -> LimitSpace:
    fixed, chosen = robot_grid(loaded, [], values or ()).fixed, tuple(names) if names else None
    try:
        return robot_space(loaded, chosen, fixed, declared_ranges=not beyond_ranges, all_branches=all_branches)
    except InvalidValueError as error:
        raise typer.BadParameter(f"{loaded.name}: {error}") from None


def _result(found: Workspace) -> dict[str, Any]:
    space = found.space
    area_unit = f"{space.units[0]}2" if space.units[0] == space.units[1] else "_".join(space.units[:2])
    result: dict[str, Any] = {"robot": space.machine}
    if space.stacked:
        name, unit = space.names[2], space.units[2]
        volume_unit = "m3" if set(space.units) == {"m"} else f"{area_unit}_{unit}"
        result |= {f"volume_{volume_unit}": found.volume, f"{name}_range_{unit}": found.level_range}
    result |= {
        f"{name}_range_{unit}": ends for name, unit, ends in zip(space.names, space.units, found.ranges, strict=False)
    }
    result["limit_shares"] = found.limit_shares
    stacked = [{f"{space.names[2]}_{space.units[2]}": s.level} if space.stacked else {} for s in found.sections]
    result["sections"] = [
        level | {f"area_{area_unit}": section.area} for level, section in zip(stacked, found.sections, strict=True)
    ]
    return result


def _lines(found: Workspace, result: dict[str, Any]) -> list[str]:
    space = found.space
    units = space.units[:2]
    product = " ".join(units) if units[0] != units[1] else f"{units[0]}^2"
    are_angles = set(units) == {"rad"}
    header, rows = [f"area [{product}]", *(["area [deg^2]"] if are_angles else [])], []
    for section in found.sections[:: max(1, len(found.sections) // 10)]:
        row = [f"{section.area:z.4f}" if are_angles else f"{section.area:.4e}"]
        rows.append([*row, f"{section.area * math.degrees(1.0) ** 2:z.1f}"] if are_angles else row)
        if space.stacked:
            rows[-1].insert(0, f"{shown_in(space.units[2])[0] * section.level:z.4f}")
    ranges = [_range(*entry) for entry in zip(space.names, space.units, found.ranges, strict=False)]
    if space.stacked:
        name, unit = space.names[2], space.units[2]
        header.insert(0, f"{name} [{shown_in(unit)[1]}]")
        volume = f"{found.volume:z.6f}" if are_angles else f"{found.volume:.4e}"
        of_volume = f"{unit}^3" if set(space.units) == {unit} else f"{product} {unit}"
        ranges = [f"volume {volume} {of_volume}", _range(name, unit, found.level_range), *ranges]
    shares = ", ".join(f"{name} {share:z.1%}" for name, share in result["limit_shares"].items() if share)
    lines = [*table_lines(header, rows), "", ", ".join(ranges), f"limits along the boundary: {shares}"]
    if "printed_ranges" in result:
        lines += ["", "next to the chapter's working ranges:", *(f"- {text}" for text in result["printed_ranges"])]
    return lines


def _range(name: str, unit: str, ends: Sequence[float] | Array) -> str:
    factor, shown = shown_in(unit)
    low, high = (f"{factor * float(end):.{2 if unit == 'rad' else 4}f}" for end in ends)
    return f"{name} {low} .. {high} {shown}"
