"""Predicted accuracy after calibration against the number of measured poses, by selection strategy."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import ScalarFormatter
from numpy.typing import NDArray

from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.figures.style import ONE_COLUMN, house_style, new_figure

_STRATEGIES: Mapping[str, tuple[str, str]] = {
    "d-optimal": ("#0072B2", "D-optimal"),
    "tip-optimal": ("#009E73", "best for the tip"),
    "space-filling": ("#CC79A7", "space-filling"),
    "process-variance": ("#56B4E9", "least variance of a Gaussian process"),
    "random": ("#999999", "random"),
    "least-sensitive": ("#D55E00", "in the least sensitive region (the chapter's rule)"),
}
"""Colour (Okabe and Ito) and description of each strategy."""


def plan_accuracy(
    counts: Sequence[int], curves: Mapping[str, NDArray[np.float64]], minimum: int | None = None, robot: str = ""
) -> Figure:
    """Draw the predicted tip error [m] by strategy over the number of poses: the mean over seeds, and the range.

    Curves are NaN where so many poses do not fit apart.

    Raises:
        InvalidValueError: a curve does not have as many rows as there are counts.
    """
    for strategy, curve in curves.items():
        if curve.ndim != 2 or len(curve) != len(counts):
            raise ShapeError(f"curve of {strategy}", curve.shape, f"({len(counts)}, seeds)")
    with house_style():
        above = 0.25 if robot else 0.03  # the title [in]
        height = 2.87 + above + 0.14 * len(curves)
        figure = new_figure(ONE_COLUMN, height)
        if robot:
            figure.suptitle(f"Calibration by number of poses: {robot}", y=1.0 - 0.05 / height, va="top")
        axes = figure.add_axes((0.15, 1.0 - (2.4 + above) / height, 0.83, 2.4 / height))
        for strategy, curve in curves.items():
            microns = 1e6 * curve
            color, words = _STRATEGIES[strategy]
            axes.plot(counts, microns.mean(axis=1), "o-", markersize=3.5, color=color, label=words)
            axes.fill_between(counts, microns.min(axis=1), microns.max(axis=1), color=color, alpha=0.15, linewidth=0.0)
        if minimum is not None:
            axes.axvline(minimum, color="#222222", linestyle=":", linewidth=0.8)
            axes.annotate(
                "all identified",
                (minimum, 0.98),
                (4, 0),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                va="top",
            )
        axes.set(xscale="log", yscale="log", xlabel="poses measured", ylabel="predicted tip error, rms [µm]")
        fitting = [
            count for k, count in enumerate(counts) if any(np.isfinite(curve[k]).any() for curve in curves.values())
        ]
        axes.set_xlim(0.9 * fitting[0], fitting[-1] / 0.9)
        axes.set_xticks(fitting, [str(count) for count in fitting])
        axes.minorticks_off()
        axes.yaxis.set_major_formatter(ScalarFormatter())
        ticks = [1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000]
        low, high = axes.get_ylim()
        axes.set_yticks([tick for tick in ticks if low <= tick <= high])
        axes.grid(True, color="#dddddd", linewidth=0.5)
        figure.legend(loc="lower left", bbox_to_anchor=(0.1, 0.0), borderaxespad=0.2, labelspacing=0.3)
    return figure
