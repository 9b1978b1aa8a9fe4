"""Critical error parameters: the share of each parameter in the squared tip error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure

from pm3dof_pin.errors.error_map import ParameterShare
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.labels import parameter_words, plain
from pm3dof_pin.figures.style import ONE_COLUMN, house_style, new_figure

COMPENSABLE_COLOR, UNCOMPENSABLE_COLOR = "#56B4E9", "#D55E00"
_MOST = 20  # parameters shown


def error_ranking(ranking: Sequence[ParameterShare], machine: str) -> Figure:
    """Draw the tip errors of an :class:`ErrorMap`'s most critical parameters of a machine within their tolerances.

    Raises:
        InvalidValueError: there is nothing to show.
    """
    shown = list(ranking)[:_MOST]
    if not shown:
        raise InvalidValueError("ranking", problem="is empty", expected="at least one parameter")
    rows = np.arange(len(shown))
    inches = 1.0 + 0.2 * len(shown)
    with house_style():
        figure = new_figure(ONE_COLUMN, inches)
        figure.suptitle(f"Critical parameters: {plain(machine)}", y=1.0 - 0.04 / inches, va="top")
        words = [parameter_words(share.name) for share in shown]
        left = min(0.6, 0.06 + 0.0195 * max(len(text.replace("$", "")) for text in words))
        axes = figure.add_axes((left, 0.42 / inches, 0.97 - left, 1.0 - 0.86 / inches))
        for offset, color, text, shares in (
            (-0.19, COMPENSABLE_COLOR, "of the tip error", [share.share for share in shown]),
            (0.19, UNCOMPENSABLE_COLOR, "of the uncompensable part", [share.uncompensable_share for share in shown]),
        ):
            axes.barh(rows + offset, 100.0 * np.array(shares), 0.38, color=color, label=text)
        axes.set_yticks(rows, words)
        axes.set_ylim(len(shown) - 0.4, -0.6)
        axes.set_xlabel("share of the mean square [%]", x=1.0, ha="right")
        figure.legend(loc="upper center", ncols=2, bbox_to_anchor=(0.5, 1.0 - 0.18 / inches), columnspacing=1.0)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
    return figure
