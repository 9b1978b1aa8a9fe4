"""Pictures of a calibration: errors on held-out poses, parameters, residuals, maps before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator

from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.judging import HeldOut, WorkspaceErrors
from pm3dof_pin.figures.style import COLORMAP, INK, house_style, new_figure
from pm3dof_pin.typing import Array

BEFORE, AFTER, FLOOR, NOISE = "#D55E00", "#0072B2", "#009E73", "#999999"  # Okabe and Ito

_MICROMETRES = 1e6
_LEVELS = 14
_PANEL = 3.3  # width of a map with its bar of colours [inch]


def held_out_picture(held_out: HeldOut) -> Figure:
    """Draw the share of held-out poses whose tip error stays below a size: before, after, floor, noise.

    Args:
        held_out: errors at poses that the calibration was not shown.
    """
    curves = (
        ("as described", held_out.before, BEFORE, "-"),
        ("corrected", held_out.after, AFTER, "-"),
        ("best commands (floor)", held_out.floor, FLOOR, "--"),
        ("measurement noise", held_out.noise, NOISE, ":"),
    )
    with house_style():
        figure = new_figure(6.4, 3.4)
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        for label, values, color, line in curves:
            ordered = np.sort(values) * _MICROMETRES
            share = np.arange(1, len(ordered) + 1) / len(ordered)
            axes.step(ordered, 100.0 * share, where="post", color=color, linestyle=line, label=label)
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.minorticks_off()
        axes.set_xlabel("tip error [µm]")
        axes.set_ylabel("held-out poses below [%]")
        axes.set_ylim(0.0, 102.0)
        figure.legend(loc="outside upper center", ncols=4)
    return figure


def parameters_picture(found: Identification) -> Figure:
    """Draw every identified parameter with two standard deviations, in units of its tolerance.

    Args:
        found: the identification.
    """
    values = found.values / found.errors.tolerances
    spread = np.minimum(found.sigmas / found.errors.tolerances, found.prior)
    places = np.arange(len(values))[::-1]
    with house_style():
        figure = new_figure(6.4, 1.2 + 0.17 * len(values))
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        axes.axvspan(-1.0, 1.0, color="#EEEEEE", zorder=0)
        axes.axvline(0.0, color=INK, linewidth=0.7)
        axes.errorbar(values, places, xerr=2.0 * spread, fmt="o", markersize=3.0, color=AFTER, ecolor=NOISE)
        axes.set_yticks(places, found.errors.names, fontsize=7.0)
        axes.set_ylim(-1.0, len(values))
        axes.set_xlabel("value and two standard deviations, over the tolerance")
    return figure


def residuals_picture(found: Identification) -> Figure:
    """Draw the residual of every measurement in units of its sigma; outliers stand out.

    Args:
        found: the identification.
    """
    size = np.sqrt(np.mean(found.normalized_residuals**2, axis=1))
    outliers = np.zeros(len(size), dtype=bool)
    outliers[list(found.outliers)] = True
    lines = np.array(found.measurements.lines)
    with house_style():
        figure = new_figure(6.0, 2.6)
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        axes.axhline(1.0, color=NOISE, linestyle=":", label="noise as stated")
        axes.plot(lines[~outliers], size[~outliers], "o", markersize=3.0, color=AFTER, label="measurement")
        if outliers.any():
            axes.plot(lines[outliers], size[outliers], "x", color=BEFORE, label="outlier")
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.minorticks_off()
        axes.set_xlabel("line of the file")
        axes.set_ylabel("residual [sigma]")
        figure.legend(loc="outside upper center", ncols=3)
    return figure


def workspace_picture(errors: WorkspaceErrors) -> Figure:
    """Draw the maps of the tip error before and after, and of the floor if it is known; these two have one scale.

    Args:
        errors: errors over two coordinates.
    """
    after = (errors.after,) if errors.floor is None else (errors.after, errors.floor)
    levels = [_levels(errors.before), *[_levels(*after)] * len(after)]
    panels = list(zip(("as described", "corrected, expected", "floor"), (errors.before, *after), levels, strict=False))
    with house_style():
        figure = new_figure(len(panels) * _PANEL, 3.0)
        figure.set_layout_engine("constrained", wspace=0.06)
        row: Any = figure.subplots(1, len(panels), sharex=True, sharey=True)
        for axes, (title, field, steps) in zip(row, panels, strict=True):
            _draw_map(axes, errors, field, title, steps)
            figure.colorbar(axes.collections[0], ax=axes, label="tip error [µm]")
        row[0].set_ylabel(_axis_label(errors, 1))
    return figure


def _levels(*fields: Array) -> Array:
    """Round values between which the colours of all these maps step [µm]."""
    values = np.concatenate([field[np.isfinite(field)] for field in fields]) * _MICROMETRES
    least, greatest = float(values.min()), float(values.max())
    return np.array(MaxNLocator(_LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(least, max(greatest, least + 1.0)))


def _draw_map(axes: Any, errors: WorkspaceErrors, field: Array, title: str, levels: Array) -> None:
    (x, y), values = _drawn_coordinates(errors), field * _MICROMETRES
    axes.contourf(x, y, values.T, levels=levels, cmap=COLORMAP)
    axes.contour(x, y, values.T, levels=levels, colors="white", linewidths=0.3, alpha=0.7)
    for limits, coordinate, along in ((axes.set_xlim, x, 1), (axes.set_ylim, y, 0)):
        shown = coordinate[np.isfinite(field).any(axis=along)]
        margin = 0.05 * np.ptp(shown)
        limits(shown.min() - margin, shown.max() + margin)
    axes.set_title(title)
    axes.set_xlabel(_axis_label(errors, 0))


def _drawn_coordinates(errors: WorkspaceErrors) -> tuple[Array, Array]:
    """Angles in degrees, lengths in metres."""
    x, y = (
        np.degrees(values) if unit == "rad" else values
        for values, unit in zip(errors.coordinates, errors.units, strict=True)
    )
    return x, y


def _axis_label(errors: WorkspaceErrors, which: int) -> str:
    return f"{errors.names[which]} [{'deg' if errors.units[which] == 'rad' else 'm'}]"
