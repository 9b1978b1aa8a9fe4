"""`pm3dof error-map`."""

from __future__ import annotations

import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import typer

from pm3dof_pin.cli.error_options import RobotErrorsOptions
from pm3dof_pin.cli.error_parameters import closing_errors
from pm3dof_pin.cli.map_options import EngineOption, Over, Values, robot_grid
from pm3dof_pin.cli.options import Json, Out, Wrench
from pm3dof_pin.cli.output import print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import Formats, PictureFormat, remove_former, save
from pm3dof_pin.cli.poses import with_units
from pm3dof_pin.description.coordinates import value_in_words
from pm3dof_pin.errors.error_budget import budget_as_data
from pm3dof_pin.errors.error_map import ErrorMap, ParameterShare, section_grid
from pm3dof_pin.errors.error_map import error_map as error_map_at
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.errors.tolerances import Rule, allocate_tolerances
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.maps.datasets import write_map
from pm3dof_pin.maps.grid_map import LEAST_SENSITIVE, budget_map, error_section, errors_over, whole_workspace_grid
from pm3dof_pin.maps.limit_space import limits_over
from pm3dof_pin.measuring.plan_file import write_plan

_CLASSES = {
    "kinematic parameters": "quasi-static: kinematic parameters",
    "thermal": "quasi-static: thermal",
    "stiffness": "quasi-static: stiffness",
    "drives": "quasi-static: clearance, drives",
    "vibration": "vibration",
    "all": "all",
}
"""The words of Table 8.4."""

PICTURES = {
    "error_map_tip.png": "tip_rms",
    "error_map_uncompensable.png": "uncompensable_rms",
    "error_map_worst.png": "worst_tip",
}
_SHOWN = 10
SAMPLES = 300


def _coverage(text: str) -> str:
    try:
        good = text == "rms" or 0.0 < float(text) < 1.0
    except ValueError:
        good = False
    if not good:
        raise typer.BadParameter(f"{text} is neither rms nor a fraction between 0 and 1, such as 0.95")
    return text


def error_map(
    which: RobotErrorsOptions,
    out: Out = Path("results"),
    over: Over = None,
    at: Values = None,
    whole: Annotated[
        bool,
        typer.Option("--whole", help="Map over all coordinates that have ranges, --points values each (13)."),
    ] = False,
    points: Annotated[
        int | None, typer.Option(min=2, help="Number of values of each coordinate not given by --over. [default: 41]")
    ] = None,
    samples: Annotated[
        int | None, typer.Option(min=1, help="Number of random poses of the whole workspace, instead of a section.")
    ] = None,
    eta: Annotated[
        float, typer.Option(min=0.0, help="Weight of orientation in the tip error [m/rad]: the tool's length.")
    ] = 0.1,
    uniform: Annotated[
        bool, typer.Option("--uniform", help="Tolerances are half widths of uniform distributions.")
    ] = False,
    target: Annotated[
        float | None, typer.Option(help="Allocate tolerances that keep the tip error within this [m] everywhere.")
    ] = None,
    coverage: Annotated[
        str,
        typer.Option(
            metavar="PART|rms",
            help="Fraction of machines that must meet --target at every pose; rms applies it to their rms error.",
            callback=_coverage,
        ),
    ] = "0.95",
    budget: Annotated[
        bool,
        typer.Option("--budget", help="All sources of error, not only geometry; implied by the next four options."),
    ] = False,
    source: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME", help="Restrict the budget to this source or class of sources; may be repeated."),
    ] = None,
    wrench: Wrench = None,
    rise: Annotated[
        float | None, typer.Option(min=0.0, metavar="K", help="Temperature range of the machine, plus or minus [K].")
    ] = None,
    large: Annotated[
        bool, typer.Option("--large", help="Large deflections: solve the equilibrium under the wrench at each pose.")
    ] = False,
    pictures: Annotated[bool, typer.Option(help="Draw the pictures.")] = True,
    formats: Formats = None,
    engine: EngineOption = "program",
    as_json: Json = False,
) -> None:
    """Map the tool errors caused by errors of the parts over a section, and rank the critical parameters.

    With --budget, or an option that implies it, errors are also listed by source: parts, temperature, loads, drives,
    vibration. Their magnitudes are in the error file too; those it omits have documented defaults.

    Error parameters and tolerances come from the robot's error file, `<robot>.errors.yaml` next to its description;
    without one, every joint has 0.1 mm and 0.5 mrad. Robots whose coordinates have no ranges are evaluated at random
    poses. Coordinates that are neither mapped nor fixed stay in the middle of their ranges.
    """
    if sum([samples is not None, bool(over or at), whole]) > 1:
        raise typer.BadParameter("expected only one of --samples, --whole, or --over with --at")
    errors = which.load_errors(engine)
    named = robot_grid(errors.robot, over or [], at or [])
    ranges = {name: (float(values[0]), float(values[-1]), len(values)) for name, values in named.axes.items()}
    fixed = {entry.name: named.fixed[entry.name] for entry in at or []}
    grid = None
    if whole:
        grid = whole_workspace_grid(errors.robot, points or 13)
    elif samples is None:
        grid = section_grid(errors.robot, ranges=ranges or None, fixed=fixed, points=points or 41)
    distribution: Any = "uniform" if uniform else "normal"
    settings: dict[str, Any] = {"eta": eta, "distribution": distribution}
    files: list[Path] = []
    result: dict[str, Any] = {"robot": errors.robot.name, "eta_m_per_rad": eta}
    with progress_bar("error map") as progress:
        if grid is None:
            poses = reachable_poses(errors.robot, samples or SAMPLES, np.random.default_rng(0))
            errors = closing_errors(errors, poses)
            mapped = error_map_at(errors, poses, **settings)
            place = "the workspace, at random"
        else:
            errors = closing_errors(errors)
            section, mapped = error_section(errors, grid, **settings)
            steps = 2 + len(PICTURES) * (pictures and len(grid.dims) == 2)
            progress(1, steps)
            fixed_ones = [c for c in errors.robot.coordinates if c.name in grid.fixed]
            result |= with_units(fixed_ones, [grid.fixed[c.name] for c in fixed_ones])
            words = [
                value_in_words(c.name, c.unit, grid.fixed[c.name], ".6f" if c.unit == "m" else "g") for c in fixed_ones
            ]
            place = f"the section {', '.join(words)}" if words else "the workspace"
            files += write_map(section, out / "error_map")
            if pictures and len(grid.dims) == 2:
                from pm3dof_pin.figures.section_map import section_map

                broken = limits_over(errors.robot, grid.dims, grid.fixed)
                for done, (name, variable) in enumerate(PICTURES.items(), start=3):
                    exact = errors_over(errors, grid, variable, eta=eta, distribution=distribution)
                    figure = section_map(section, variable, within=lambda points: broken(points) == 0, exact=exact)
                    files += save(figure, out / name, formats)
                    progress(done, steps)
        ranking = mapped.ranking()
        files.append(_write_ranking(ranking, out / "error_ranking.csv"))
        if pictures:
            from pm3dof_pin.figures.error_ranking import error_ranking

            files += save(error_ranking(ranking, errors.robot.name), out / "error_ranking.png", formats)
        result |= _summary(mapped) | {"ranking": [_plain(share) for share in ranking]}
        if target is not None:
            result["allocation"] = _allocation(mapped, target, None if coverage == "rms" else float(coverage))
        if budget or source or wrench is not None or rise is not None or large:
            sources = ErrorSources(errors, wrench=wrench, rise=rise, large=large, distribution=distribution)
            found, written = _map_budget(
                sources, mapped.poses if grid is None else grid, source or [], eta, out, formats if pictures else []
            )
            files += written
            result |= found
        names = "|".join(name.removesuffix(".png") for name in PICTURES)
        remove_former(out, rf"{names}|error_ranking|least_sensitive_region", files)
    print_result(result, _lines(result, place), as_json=as_json, files=files)


def _summary(mapped: ErrorMap) -> dict[str, Any]:
    quantities = {
        "tip_rms_m": mapped.tip_rms,
        "compensable_rms_m": mapped.compensable_rms,
        "uncompensable_rms_m": mapped.uncompensable_rms,
        "position_rms_m": mapped.position_rms,
        "orientation_rms_rad": mapped.orientation_rms,
        "tip_95_percent_m": mapped.tip_bound(0.95),
        "worst_tip_m": mapped.worst_tip,
        "energy_m": mapped.energy,
    }
    return {
        "poses": len(mapped.poses),
        "parameters": len(mapped.errors),
        "least": {name: float(values.min()) for name, values in quantities.items()},
        "mean": {name: float(values.mean()) for name, values in quantities.items()},
        "greatest": {name: float(values.max()) for name, values in quantities.items()},
    }


def _allocation(mapped: ErrorMap, target: float, coverage: float | None) -> dict[str, Any]:
    def tolerances(rule: Rule, *, compensated: bool = False) -> dict[str, float]:
        return allocate_tolerances(mapped, target, rule, compensated=compensated, coverage=coverage).tolerances

    return {
        "target_m": target,
        "coverage": "rms" if coverage is None else coverage,
        "tolerances_are": "standard deviations" if mapped.distribution == "normal" else "half widths",
        "equal_contributions": tolerances("equal_contributions"),
        "least_cost": tolerances("least_cost"),
        "least_cost_with_corrected_commands": tolerances("least_cost", compensated=True),
    }


def _plain(share: ParameterShare) -> dict[str, Any]:
    return {"tip_rms_m" if name == "tip_rms" else name: value for name, value in share.__dict__.items()}


def _write_ranking(ranking: list[ParameterShare], path: Path) -> Path:
    rows = [["parameter", "class", "tip_rms_m", "share", "uncompensable_share"]]
    for share in ranking:
        numbers = (share.tip_rms, share.share, share.uncompensable_share)
        rows.append([share.name, share.group, *(f"{number:.9g}" for number in numbers)])
    return write_text_atomically(path, csv_text(rows))


def _lines(result: dict[str, Any], place: str) -> list[str]:
    words = {
        "tip_rms_m": "tip error, rms",
        "compensable_rms_m": "- that commands can undo",
        "uncompensable_rms_m": "- that no command can undo",
        "position_rms_m": "position error, rms",
        "orientation_rms_rad": "orientation error, rms",
        "tip_95_percent_m": "tip error, 95 % of machines",
        "worst_tip_m": "tip error, bound",
        "energy_m": "energy E (8.15), mean",
    }
    rows = [
        [text, *(f"{1e6 * result[kind][name]:z.1f}" for kind in ("least", "mean", "greatest"))]
        for name, text in words.items()
    ]
    critical = [
        [
            share["name"],
            share["group"],
            f"{1e6 * share['tip_rms_m']:z.1f}",
            f"{share['share']:z.1%}",
            f"{share['uncompensable_share']:z.1%}",
        ]
        for share in result["ranking"][:_SHOWN]
    ]
    lines = [
        f"{result['robot']}: {result['parameters']} error parameters, {result['poses']:,} poses of {place}, "
        f"eta = {result['eta_m_per_rad']:g} m/rad",
        *table_lines(["[µm, µrad]", "least", "mean", "greatest"], rows),
        "",
        *table_lines(["critical parameters", "class", "tip [µm]", "of all", "of what stays"], critical),
    ]
    if "allocation" in result:
        lines += ["", *_allocation_lines(result["allocation"])]
    if "budget" in result:
        lines += ["", *_budget_lines(result)]
    return lines


def _allocation_lines(allocation: dict[str, Any]) -> list[str]:
    kinds = ("equal_contributions", "least_cost", "least_cost_with_corrected_commands")
    rows = [
        [
            name,
            *(
                "any" if math.isinf(allocation[kind][name]) else f"{1e6 * allocation[kind][name]:z.1f}"
                for kind in kinds
            ),
        ]
        for name in allocation[kinds[0]]
    ]
    covered = "rms" if allocation["coverage"] == "rms" else f"{allocation['coverage']:z.0%} of machines"
    header = [
        f"for {1e6 * allocation['target_m']:g} µm, {covered} [µm, µrad]",
        "equal parts",
        "least cost",
        "commands corrected",
    ]
    return table_lines(header, rows)


def _map_budget(
    sources: ErrorSources,
    grid_or_poses: Grid | Poses,
    names: Sequence[str],
    eta: float,
    out: Path,
    formats: list[PictureFormat] | None,
) -> tuple[dict[str, Any], list[Path]]:
    """Compute the error budget on a grid or at poses, of all or the named sources; write its maps and draw them.

    Returns the entries for the command's result, and the files written. With no formats, nothing is drawn.
    """
    dataset, budget = budget_map(sources, grid_or_poses, eta=eta, names=names)
    files = write_map(dataset, out / "error_budget")
    least = np.flatnonzero(budget.least_sensitive())
    region = budget.poses[least]
    files.append(write_plan(region, out / "least_sensitive.csv"))
    if formats != [] and dataset["tip_rms"].ndim in (2, 3) and LEAST_SENSITIVE in dataset:
        from pm3dof_pin.figures.least_sensitive_region import least_sensitive_region

        figure = least_sensitive_region(dataset, partial(limits_over, sources.robot))
        files += save(figure, out / "least_sensitive_region.png", formats)
    ends = {
        f"{coordinate.name}_{coordinate.unit}": [float(column.min()), float(np.median(column)), float(column.max())]
        for coordinate, column in zip(sources.robot.coordinates, region.coordinates.T, strict=True)
    }
    tip = budget.tip_rms
    return {
        "budget": budget_as_data(budget.lines()),
        "wrench_N_Nm": sources.wrench.tolist(),
        "rise_K": sources.rise,
        "least_sensitive": {
            "poses": len(region),
            "tip_rms_m": {"least": float(tip.min()), "most": float(tip[least].max()), "elsewhere": float(tip.max())},
            "least_median_greatest": ends,
        },
    }, files


def _budget_lines(result: dict[str, Any]) -> list[str]:
    """Return the result of `_map_budget` as a table, in the words of Table 8.4."""
    columns = ("tip_rms_m", "greatest_tip_rms_m", "worst_tip_m", "left_m", "energy_m")
    rows, last = [], ""
    for line in result["budget"]:
        group = _CLASSES[line["error_class"]]
        numbers = [f"{1e6 * line[name]:z.2f}" for name in columns]
        rows.append([group if group != last else "", line["long_name"], *numbers, f"{line['share']:z.1%}"])
        last = group
    header = ["Table 8.4", "source [µm]", "tip, rms", "worst pose", "bound", "left", "E", "share"]
    least, ends = result["least_sensitive"], result["least_sensitive"]["least_median_greatest"]
    tip = least["tip_rms_m"]
    medians = []
    for heading, (_, median, _) in ends.items():
        name, unit = heading.rsplit("_", 1)
        medians.append(value_in_words(name, unit, median, ".4f" if unit == "m" else ".1f"))
    lines = table_lines(header, rows, words=2)
    lines.append(
        f"least sensitive fifth: {1e6 * tip['least']:z.1f} to {1e6 * tip['most']:z.1f} µm, elsewhere up to "
        f"{1e6 * tip['elsewhere']:z.1f} µm; medians: {', '.join(medians)}"
    )
    return lines
