"""Pictures of the calibration study: errors against the number of poses, with the floors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from pm3dof_pin.calibration.calibrate import METHODS
from pm3dof_pin.calibration.study import FLOOR, NONE, TESTS, Record, StudyPlan, over_seeds, select
from pm3dof_pin.figures.style import house_style, new_figure

# Okabe and Ito's colours
_COLORS = {"lm": "#222222", "nn": "#E69F00", "gp": "#56B4E9", "lm+nn": "#D55E00", "lm+gp": "#0072B2"}
_MICROMETRES = 1e6


def excess_picture(plan: StudyPlan, records: Sequence[Record]) -> Figure:
    """Draw by how much commands miss the best ones, mean over the seeds with its range.

    Args:
        plan: what the study ran through.
        records: what came out.
    """
    with house_style():
        figure, panels = _panels(plan)
        for (world, test), axes in panels.items():
            here = select(records, world=world, test=test)
            for method in METHODS:
                _curve(axes, plan, here, method, "excess", None)
            none = _MICROMETRES * over_seeds(select(here, method=NONE), "excess")[0]
            noise = _MICROMETRES * over_seeds(select(here, method=NONE), "joint_noise")[0]
            axes.axhline(none, color="#999999", label="no correction")
            axes.axhline(noise, color="#009E73", linestyle=":", label="noise of one measurement")
            axes.set_ylabel("excess joint error, rms [µm]")
        _finish(plan, figure, panels)
    return figure


def tip_picture(plan: StudyPlan, records: Sequence[Record]) -> Figure:
    """Draw the mean tip error, mean over the seeds with its range, over the floor of the best commands.

    Args:
        plan: what the study ran through.
        records: what came out.
    """
    with house_style():
        figure, panels = _panels(plan)
        for (world, test), axes in panels.items():
            here = select(records, world=world, test=test)
            for method in METHODS:
                _curve(axes, plan, here, method, "tip", 0)
            for row, color, line, label in (
                (NONE, "#999999", "-", "no correction"),
                (FLOOR, "#009E73", "--", "best commands (floor)"),
            ):
                level = _MICROMETRES * over_seeds(select(here, method=row), "tip", 0)[0]
                axes.axhline(level, color=color, linestyle=line, label=label)
            noise = _MICROMETRES * over_seeds(select(here, method=NONE), "noise")[0]
            axes.axhline(noise, color="#009E73", linestyle=":", label="noise of one measurement")
            axes.set_ylabel("mean tip error [µm]")
        _finish(plan, figure, panels)
    return figure


def _panels(plan: StudyPlan) -> tuple[Figure, dict[tuple[str, str], Any]]:
    figure = new_figure(3.4 * len(plan.worlds), 6.0)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(len(TESTS), len(plan.worlds), sharex=True, sharey=True, squeeze=False)
    return figure, {(world, test): grid[i][j] for i, test in enumerate(TESTS) for j, world in enumerate(plan.worlds)}


def _curve(
    axes: Any, plan: StudyPlan, records: Sequence[Record], method: str, quantity: str, index: int | None
) -> None:
    numbers = [over_seeds(select(records, count=count, method=method), quantity, index) for count in plan.counts]
    mean, least, most = _MICROMETRES * np.array(numbers).T
    color = _COLORS[method]
    axes.plot(plan.counts, mean, "o-", markersize=3.0, color=color, label=method)
    axes.fill_between(plan.counts, least, most, color=color, alpha=0.1, linewidth=0.0)


def _finish(plan: StudyPlan, figure: Figure, panels: dict[tuple[str, str], Any]) -> None:
    for (world, test), axes in panels.items():
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_title(f"{world}: {test}")
        axes.set_xlabel("poses measured")
        axes.set_xticks(plan.counts, [str(count) for count in plan.counts])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.minorticks_off()
        axes.label_outer()
    handles, labels = next(iter(panels.values())).get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4)
