"""`pm3dof evaluate`."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any

import typer

from pm3dof_pin.cli.map_options import (
    EngineOption,
    Quantities,
    Ranges,
    Threads,
    Values,
    declared_ranges,
    known_quantities,
    robot_grid,
)
from pm3dof_pin.cli.options import AppliedWrenches, Json, MachineOptions, Out
from pm3dof_pin.cli.output import print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, remove_former, save
from pm3dof_pin.cli.poses import with_units
from pm3dof_pin.cli.stiffness import Model
from pm3dof_pin.description.coordinates import shown_in
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.datasets import write_netcdf
from pm3dof_pin.maps.limit_space import limits_over
from pm3dof_pin.maps.quantity import NO_WRENCH, MappedRobot
from pm3dof_pin.maps.workspace_evaluation import Distribution, WorkspaceEvaluation, evaluate_workspace

_POSES = 100_000  # approximate number over all coordinates
_MAX_POINTS = 201  # of one coordinate
_PICTURE_POINTS = 81
_OF_CHAPTER = ("chapter_diagonal", "chapter_global")
_MIN_SHARE = 0.05  # least share of a spring to be printed


def evaluate(
    which: MachineOptions,
    model: Annotated[
        Model, typer.Option(help="elastic: felt and principal stiffness; chapter: the diagonal of section 8.2.3.")
    ] = "elastic",
    quantity: Quantities = None,
    out: Out = Path("results"),
    ranges: Ranges = None,
    values: Values = None,
    points: Annotated[
        int | None, typer.Option(min=2, help="Number of values of each coordinate (about 100,000 poses in all).")
    ] = None,
    pictures: Annotated[bool, typer.Option(help="Draw which springs govern where.")] = True,
    formats: Formats = None,
    wrench: AppliedWrenches = None,
    threads: Threads = None,
    engine: EngineOption = "program",
    as_json: Json = False,
) -> None:
    """Evaluate the stiffness over the workspace: mean, spread, extremes, global indices, critical springs.

    Angles in degrees, lengths in metres. The workspace is the part of the coordinate ranges, or of --range, within all
    limits; averages are over its volume. For each axis, the critical springs are listed: which contributes most, over
    what part of the workspace, and the least gain from making it 10 % stiffer.
    """
    known = known_quantities(quantity)
    loaded = which.load(engine, threads)
    mapped = MappedRobot(loaded, wrench or NO_WRENCH)
    if model == "chapter":
        if quantity:
            raise typer.BadParameter("--model chapter cannot be combined with --quantity")
        if not known[_OF_CHAPTER[0]].exists(mapped):
            raise typer.BadParameter(f"--model chapter is for tripods of the chapter's family, not {loaded.name}")
    quantities = _OF_CHAPTER if model == "chapter" else tuple(quantity) if quantity else None
    grid = _grid(loaded, ranges, values, points)
    with progress_bar("evaluation") as progress:
        found = evaluate_workspace(mapped, grid, quantities, springs=quantities is None)
        progress(1, 2)
        files = [
            write_netcdf(found.dataset, out / "evaluation.nc"),
            write_text_atomically(out / "evaluation.csv", _table(found)),
        ]
        if pictures and found.springs and len(grid.axes) > 1:
            files += _draw(mapped, grid, out, formats)
        remove_former(out, "critical_springs", files)
        progress(2, 2)
    result = _result(loaded, grid, found, model if not quantity else None)
    print_result(result, _lines(grid, found), as_json=as_json, files=files)


def _grid(robot: Robot, ranges: Any, values: Any, points: int | None) -> Grid:
    named = {entry.name for entry in (*(ranges or ()), *(values or ()))}
    free = [coordinate for coordinate in robot.coordinates if coordinate.name not in named]
    size = _POSES / max(1, math.prod(entry.count for entry in ranges or ()))
    count = points or min(_MAX_POINTS, 2 * round(0.5 * (max(size, 1.0) ** (1.0 / max(len(free), 1)) - 1.0)) + 1)
    grid = robot_grid(
        robot, [*(ranges or ()), *declared_ranges(robot, free, [max(count, 3)] * len(free))], values or ()
    )
    if not grid.axes:
        raise typer.BadParameter(f"{robot.name}: every coordinate is fixed; there is nothing to evaluate over")
    return grid


def _result(robot: Robot, grid: Grid, found: WorkspaceEvaluation, model: Model | None) -> dict[str, Any]:
    result: dict[str, Any] = {
        "robot": robot.name,
        "model": model,
        "dimensions": grid.dims,
        "fixed": dict(grid.fixed),
        "poses": grid.size,
        "poses_within_limits": int((found.dataset["broken_limits"] == 0).sum()),
        "reachable_part": found.reachable,
        "distributions": {
            entry.label: {
                "unit": entry.unit,
                "mean": entry.mean,
                "standard_deviation": entry.standard_deviation,
                "least": entry.least,
                "least_at": with_units(robot.coordinates, entry.least_at.values()),
                "greatest": entry.greatest,
                "greatest_at": with_units(robot.coordinates, entry.greatest_at.values()),
                "defined_part": entry.defined_part,
            }
            for entry in found.distributions
        },
    }
    if found.indices:
        result["global_indices"] = found.indices
    if found.springs:
        ranks: dict[str, list[dict[str, Any]]] = {}
        for rank in found.springs:
            ranks.setdefault(rank.axis, []).append({k: value for k, value in vars(rank).items() if k != "axis"})
        result["springs"] = ranks
    return result


def _lines(grid: Grid, found: WorkspaceEvaluation) -> list[str]:
    moving = [coordinate for coordinate in grid.coordinates if coordinate.name in grid.axes]
    names = ", ".join(f"{c.name} [{shown_in(c.unit)[1]}]" for c in moving)

    def place(values: dict[str, float]) -> str:
        shown = ((c, values[c.name]) for c in moving)
        return " ".join(f"{math.degrees(v):z.1f}" if c.unit == "rad" else f"{v:z.4f}" for c, v in shown)

    rows = [
        [
            entry.label,
            f"{entry.mean:.4e}",
            f"{entry.standard_deviation / abs(entry.mean):z.1%}" if entry.mean else "",
            *(f"{entry.least:.4e}", place(entry.least_at), f"{entry.greatest:.4e}", place(entry.greatest_at)),
            entry.unit,
        ]
        for entry in found.distributions
    ]
    lines = [
        f"over {names}: {grid.size:,} poses, {found.reachable:z.1%} of the volume within every limit",
        "",
        *table_lines(["quantity", "mean", "spread", "least", "at", "greatest", "at", "unit"], rows),
    ]
    if found.indices:
        lines += [
            "",
            f"mean of the stiffness' diagonal, whatever its units: {found.indices['mean_diagonal']:.4e}",
            f"1 / condition number: mean {found.indices['conditioning']:.3e}, "
            f"least {found.indices['least_conditioning']:.3e}",
        ]
    printed = [rank for rank in found.springs if rank.mean_share >= _MIN_SHARE or rank.governs_part >= _MIN_SHARE]
    if printed:
        header = ["axis", "spring", "governs", "mean share", "least", "greatest", "10 % stiffer: felt at least"]
        lines += [
            "",
            *table_lines(
                header,
                [
                    [rank.axis, rank.spring, f"{rank.governs_part:z.1%}"]
                    + [f"{value:z.1%}" for value in (rank.mean_share, rank.least_share, rank.greatest_share)]
                    + [f"+{rank.gain_of_10_percent_at_least:z.2%}"]
                    for rank in printed
                ],
            ),
        ]
    return lines


def _table(found: WorkspaceEvaluation) -> str:
    """Return the distributions as CSV."""

    def ends(entry: Distribution) -> list[str]:
        return [f"{value:.12g}" for place in (entry.least_at, entry.greatest_at) for value in place.values()]

    names = list(found.distributions[0].least_at) if found.distributions else []
    units = {name: str(found.dataset[name].attrs["units"]) for name in names}
    at = [f"{end}_at_{name}_{units[name]}" for end in ("least", "greatest") for name in names]
    lines = [["quantity", "unit", "mean", "standard_deviation", "least", "greatest", *at]]
    for entry in found.distributions:
        numbers = (entry.mean, entry.standard_deviation, entry.least, entry.greatest)
        lines.append([entry.label, entry.unit, *(f"{value:.12g}" for value in numbers), *ends(entry)])
    return csv_text(lines)


def _draw(mapped: MappedRobot, grid: Grid, out: Path, formats: list[PictureFormat] | None) -> list[Path]:
    """Draw which spring governs over the first two coordinates, with the others in the middle of their ranges."""
    from pm3dof_pin.figures.critical_springs import critical_springs

    robot = mapped.robot
    ends = {name: (float(values[0]), float(values[-1])) for name, values in grid.axes.items()}
    across = list(ends)[:2]
    home = dict(zip((c.name for c in robot.coordinates), robot.home_coordinates, strict=True))
    fixed = dict(grid.fixed)
    for name in list(ends)[2:]:
        low, high = ends[name]
        fixed[name] = float(home[name]) if low < home[name] < high else 0.5 * (low + high)
    section = robot.grid(**{name: (*ends[name], _PICTURE_POINTS) for name in across}, **fixed)
    found = evaluate_workspace(mapped, section, ("felt_stiffness",))
    broken = limits_over(robot, across, fixed)
    figure = critical_springs(found.dataset, lambda points: broken(points) == 0)
    return save(figure, out / "critical_springs.png", formats)
