"""What a thicker passive leg brings on every axis, in the chapter's model and in the elastic one."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import NullFormatter, ScalarFormatter

from pm3dof_pin.chapter.axis_stiffness import READINGS
from pm3dof_pin.chapter.chapter_stiffness import AXES
from pm3dof_pin.chapter.passive_leg import with_passive_leg_radius
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.figures.style import INK, TWO_COLUMNS, house_style, new_figure
from pm3dof_pin.typing import Array

_LINES = {  # axis shown: words, colour, width, dashes; at the centre of the section theta_y is as theta_x, t_y as t_x
    "theta_z": (r"$\theta_z$", "#D55E00", 3.2, "solid"),
    "t_x": ("$T_x, T_y$", "#56B4E9", 1.6, (0, (4, 2))),
    "theta_x": (r"$\theta_x, \theta_y$", "#0072B2", 1.6, "solid"),
    "t_z": ("$T_z$", INK, 1.6, (0, (1, 1.5))),
}


_TITLES = {
    "chapter": "chapter's model",
    "elastic, held": "elastic, other motions held",
    "elastic, felt": "elastic, felt by a probe",
}


def passive_leg_radius_figure(tripod: Tripod) -> Figure:
    """Draw each axis' stiffness at the section's centre against the radius, both over those of today's leg."""
    factors = np.geomspace(1.0, 2.0, 41)
    centre = [0.0, 0.0, tripod.middle_height]
    machines = [with_passive_leg_radius(tripod, factor) for factor in factors]
    with house_style():
        figure = new_figure(TWO_COLUMNS, 3.1)
        panels = figure.subplots(1, 3, sharex=True, sharey=True)
        for axes, (name, reading) in zip(panels, READINGS.items(), strict=True):
            gains = np.stack([reading(machine, centre) for machine in machines]) / reading(tripod, centre)
            _draw(axes, _TITLES[name], factors, gains)
        panels[0].set_ylabel("stiffness, times that of today's leg")
        handles = [
            Line2D([], [], label=words, color=color, linewidth=width, linestyle=dashes)
            for words, color, width, dashes in _LINES.values()
        ]
        figure.legend(handles=handles, loc="lower center", ncols=len(handles), handlelength=3.0)
        figure.subplots_adjust(left=0.075, right=0.985, top=0.91, bottom=0.255, wspace=0.13)
    return figure


def _draw(axes: Axes, name: str, factors: Array, gains: Array) -> None:
    for axis, (_, color, width, dashes) in _LINES.items():
        axes.plot(factors, gains[:, AXES.index(axis)], color=color, linewidth=width, linestyle=dashes)
    axes.axvline(1.2, color="#999999", linewidth=0.6)
    axes.set(xscale="log", yscale="log", xlim=(1.0, 2.0), ylim=(0.93, 17.5), xlabel="radius, times today's", title=name)
    axes.set_xticks([1.0, 1.2, 1.5, 2.0])
    axes.set_yticks([1, 2, 4, 8, 16])
    for along in (axes.xaxis, axes.yaxis):
        along.set_major_formatter(ScalarFormatter())
        along.set_minor_formatter(NullFormatter())
        along.set_tick_params(which="minor", length=0)
    axes.grid(color="#DDDDDD", linewidth=0.5)
