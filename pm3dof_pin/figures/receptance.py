"""Receptances over frequency, and stability lobes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MultipleLocator

from pm3dof_pin.dynamics.stability_lobes import StabilityLobes
from pm3dof_pin.figures.style import INK, ONE_COLUMN, TWO_COLUMNS, house_style, new_figure, round_ticks
from pm3dof_pin.typing import Array, Vector

_COLORS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#56B4E9", "#D55E00")
_NARROWEST, _WIDER = 0.9, 0.5  # width of the last line, and of each before it more than the next [points]


def receptance_curves(robot: str, frequencies: Vector, curves: Mapping[str, tuple[Array, str]]) -> Figure:
    """Draw magnitude, phase and real part of receptances, each with its unit, over frequency [Hz].

    Curves of different units are drawn relative to their value at the lowest frequency.
    """
    units = {unit for _, unit in curves.values()}
    with house_style():
        figure = new_figure(TWO_COLUMNS, 6.6)
        magnitude, phase, real = figure.subplots(3, 1, sharex=True)
        figure.subplots_adjust(left=0.11, right=0.97, top=0.94, bottom=0.14, hspace=0.12)
        widths = _NARROWEST + _WIDER * np.arange(len(curves))[::-1]  # those below, at symmetric poses, stay visible
        for (name, (values, _)), color, width in zip(curves.items(), _COLORS * len(curves), widths, strict=False):
            shown = values if len(units) == 1 else values / abs(values[0])
            style: dict[str, Any] = {"color": color, "linewidth": width}
            magnitude.loglog(frequencies, np.abs(shown), label=name, **style)
            phase.semilogx(frequencies, np.degrees(np.unwrap(np.angle(shown))), **style)
            real.semilogx(frequencies, shown.real, **style)
        unit = f"[{units.pop()}]" if len(units) == 1 else "relative to static"
        magnitude.set_ylabel(f"|G| {unit}")
        phase.set_ylabel("phase [deg]")
        low, high = phase.get_ylim()
        phase.set_ylim(90.0 * np.floor(low / 90.0), 90.0 * np.ceil(high / 90.0))
        phase.yaxis.set_major_locator(MultipleLocator(90.0))
        real.set(ylabel=f"Re G {unit}", xlabel="frequency [Hz]")
        real.axhline(0.0, color=INK, linewidth=0.5)
        for axes in (magnitude, phase, real):
            axes.set_xlim(frequencies[0], frequencies[-1])
            axes.grid(True, which="major", color="#dddddd", linewidth=0.5)
        figure.legend(loc="lower center", ncols=3, bbox_to_anchor=(0.54, 0.0), borderaxespad=0.2)
        figure.suptitle(f"{robot}: receptance", y=0.985)
    return figure


def lobes_diagram(robot: str, lobes: StabilityLobes) -> Figure:
    """Draw the depth limit over the spindle speed, and the limit of all speeds."""
    with house_style():
        figure = new_figure(ONE_COLUMN, 2.8)
        axes = figure.add_axes((0.16, 0.16, 0.77, 0.72))
        rpm, finite = 60.0 * lobes.speeds, np.isfinite(lobes.depths)
        top = 5.0 * lobes.depth_limit
        depths = np.where(finite, lobes.depths, 1e3 * top)
        axes.plot(rpm, 1e3 * depths, color=_COLORS[0])
        axes.fill_between(rpm, 0.0, 1e3 * np.minimum(depths, 2.0 * top), color=_COLORS[2], alpha=0.15, linewidth=0.0)
        axes.axhline(1e3 * lobes.depth_limit, color=INK, linestyle=":", linewidth=0.8)
        if lobes.cutting.ap is not None:
            axes.axhline(1e3 * lobes.cutting.ap, color=_COLORS[5], linewidth=0.8)
        axes.set(xlim=(rpm[0], rpm[-1]), ylim=(0.0, 1e3 * top), xlabel="spindle speed [1/min]", ylabel="depth [mm]")
        round_ticks(axes)
        axes.grid(True, color="#dddddd", linewidth=0.5)
        figure.suptitle(f"{robot}: stable below the line", y=0.97)
    return figure
