"""The error budget of `pm3dof error-map --budget`: all sources of error, separately and combined."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pm3dof_pin.cli.output import table_lines
from pm3dof_pin.cli.pictures import PictureFormat, save
from pm3dof_pin.cli.poses import in_words

if TYPE_CHECKING:
    from pm3dof_pin.errors.source_errors import ErrorSources
    from pm3dof_pin.kinematics.grid import Grid
    from pm3dof_pin.kinematics.robot import Poses

_CLASSES = {
    "kinematic parameters": "quasi-static: kinematic parameters",
    "thermal": "quasi-static: thermal",
    "stiffness": "quasi-static: stiffness",
    "drives": "quasi-static: clearance, drives",
    "vibration": "vibration",
    "all": "all",
}
"""The words of Table 8.4."""


def map_budget(
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
    import numpy as np

    from pm3dof_pin.errors.error_budget import budget_as_data
    from pm3dof_pin.maps.datasets import write_map
    from pm3dof_pin.maps.grid_map import LEAST_SENSITIVE, budget_map
    from pm3dof_pin.measuring.measurement_file import write_plan

    dataset, budget = budget_map(sources, grid_or_poses, eta=eta, names=names)
    files = write_map(dataset, out / "error_budget")
    least = np.flatnonzero(budget.least_sensitive())
    region = budget.poses[least]
    files.append(write_plan(region, out / "least_sensitive.csv"))
    if formats != [] and dataset["tip_rms"].ndim in (2, 3) and LEAST_SENSITIVE in dataset:
        from pm3dof_pin.figures.least_sensitive_region import least_sensitive_region
        from pm3dof_pin.maps.limit_space import limits_over

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


def budget_lines(result: dict[str, Any]) -> list[str]:
    """Return the result of :func:`map_budget` as a table, in the words of Table 8.4."""
    columns = ("tip_rms_m", "greatest_tip_rms_m", "worst_tip_m", "left_m", "energy_m")
    rows, last = [], ""
    for line in result["budget"]:
        group = _CLASSES[line["error_class"]]
        numbers = [f"{1e6 * line[name]:.2f}" for name in columns]
        rows.append([group if group != last else "", line["long_name"], *numbers, f"{line['share']:.1%}"])
        last = group
    header = ["Table 8.4", "source [µm]", "tip, rms", "worst pose", "bound", "left", "E", "share"]
    least, ends = result["least_sensitive"], result["least_sensitive"]["least_median_greatest"]
    tip = least["tip_rms_m"]
    medians = []
    for heading, (_, median, _) in ends.items():
        name, unit = heading.rsplit("_", 1)
        medians.append(in_words(name, unit, median, ".4f" if unit == "m" else ".1f"))
    lines = table_lines(header, rows, words=2)
    lines.append(
        f"least sensitive fifth: {1e6 * tip['least']:.1f} to {1e6 * tip['most']:.1f} µm, elsewhere up to "
        f"{1e6 * tip['elsewhere']:.1f} µm; medians: {', '.join(medians)}"
    )
    return lines
