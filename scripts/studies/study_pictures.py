"""Pictures of the calibration study: errors against the number of poses, with the floors."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter
from study import FLOOR, NONE, TESTS, Record, StudyPlan, over_seeds, select

from pm3dof_pin.calibration.fit import METHODS
from pm3dof_pin.figures.style import TWO_COLUMNS, house_style, new_figure

# Okabe and Ito's colours
_COLORS = {"lm": "#222222", "nn": "#E69F00", "gp": "#56B4E9", "lm+nn": "#D55E00", "lm+gp": "#0072B2"}
_MARKERS = {"lm": "o", "nn": "s", "gp": "^", "lm+nn": "D", "lm+gp": "v"}
_WORDS = {
    "lm": "parameters (lm)",
    "nn": "neural network (nn)",
    "gp": "Gaussian process (gp)",
    "lm+nn": "parameters and network (lm+nn)",
    "lm+gp": "parameters and process (lm+gp)",
}
_APART = 1.045  # ratio of the positions of two methods at the same number of poses
_MICROMETRES = 1e6


def excess_picture(plan: StudyPlan, records: Sequence[Record]) -> Figure:
    """Draw the distance of commands from the best ones, mean over the seeds with its range.

    Args:
        plan: the cases of the study.
        records: the results.
    """
    with house_style():
        figure, panels = _panels(plan)
        for (world, test), axes in panels.items():
            here = select(records, world=world, test=test)
            for method in METHODS:
                values = [[r.excess for r in select(here, count=count, method=method)] for count in plan.counts]
                _curve(axes, plan, values, method)
            _levels(axes, *(over_seeds(select(here, method=NONE), name)[0] for name in ("excess", "joint_noise")))
            axes.set_title(f"{world}: {test}")
        _finish(plan, figure, panels, "excess joint error, rms [µm]")
    return figure


def tip_picture(plan: StudyPlan, records: Sequence[Record]) -> Figure:
    """Draw the mean tip error beyond the floor, that of the best commands, with its range over the seeds.

    Args:
        plan: the cases of the study.
        records: the results.
    """
    with house_style():
        figure, panels = _panels(plan)
        for (world, test), axes in panels.items():
            here = select(records, world=world, test=test)
            floors = {record.seed: record.tip[0] for record in select(here, method=FLOOR)}
            for method in METHODS:
                rows = [select(here, count=count, method=method) for count in plan.counts]
                _curve(axes, plan, [[r.tip[0] - floors[r.seed] for r in row] for row in rows], method)
            floor = over_seeds(select(here, method=FLOOR), "tip", 0)[0]
            before = over_seeds(select(here, method=NONE), "tip", 0)[0]
            _levels(axes, before - floor, over_seeds(select(here, method=NONE), "noise")[0])
            axes.set_title(f"{world}: {test}, floor {_MICROMETRES * floor:.0f} µm")
        _finish(plan, figure, panels, "mean tip error beyond the floor [µm]")
    return figure


def _panels(plan: StudyPlan) -> tuple[Figure, dict[tuple[str, str], Any]]:
    figure = new_figure(TWO_COLUMNS, 4.6)
    figure.set_layout_engine("constrained")
    grid = figure.subplots(len(TESTS), len(plan.worlds), sharex=True, sharey=True, squeeze=False)
    return figure, {(world, test): grid[i][j] for i, test in enumerate(TESTS) for j, world in enumerate(plan.worlds)}


def _curve(axes: Any, plan: StudyPlan, values: Sequence[Sequence[float]], method: str) -> None:
    """Draw the mean over the seeds, one list of values for each number of poses [m]."""
    numbers = _MICROMETRES * np.array(values)
    color, mean = _COLORS[method], numbers.mean(axis=1)
    # side by side, so that the ranges of all methods can be distinguished
    places = np.array(plan.counts) * _APART ** (METHODS.index(method) - 0.5 * (len(METHODS) - 1))
    axes.errorbar(
        places,
        mean,
        yerr=[mean - numbers.min(axis=1), numbers.max(axis=1) - mean],
        fmt=_MARKERS[method] + "-",
        markersize=2.5,
        linewidth=0.9,
        elinewidth=0.7,
        color=color,
        label=_WORDS[method],
    )


def _levels(axes: Any, none: float, noise: float) -> None:
    axes.axhline(_MICROMETRES * none, color="#999999", label="no correction")
    axes.axhline(_MICROMETRES * noise, color="#009E73", linestyle=":", label="noise of one measurement")


def _finish(plan: StudyPlan, figure: Figure, panels: dict[tuple[str, str], Any], quantity: str) -> None:
    for axes in panels.values():
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("poses measured")
        axes.set_xticks(plan.counts, [str(count) for count in plan.counts])
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.yaxis.set_minor_formatter(NullFormatter())
        axes.minorticks_off()
        axes.label_outer()
    figure.supylabel(quantity, fontsize="medium")
    handles, labels = next(iter(panels.values())).get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=3)
