"""Pictures of a calibration: errors at held-out poses, parameters, residuals, maps before and after."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator

from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.workspace_errors import WorkspaceErrors
from pm3dof_pin.figures.color_scale import color_scale
from pm3dof_pin.figures.labels import axis_label, parameter_words
from pm3dof_pin.figures.outlined_mesh import draw_map, outlined_mesh
from pm3dof_pin.figures.style import (
    COLORMAP,
    INK,
    TWO_COLUMNS,
    house_style,
    new_figure,
)

BEFORE, AFTER, FLOOR, NOISE = "#D55E00", "#0072B2", "#009E73", "#999999"  # Okabe and Ito

_MICROMETRES = 1e6


def calibration_pictures(
    calibration: Fit,
    held_out: HeldOut | None = None,
    maps: WorkspaceErrors | None = None,
    *,
    validation: HeldOut | None = None,
) -> dict[str, Figure]:
    """Return the pictures of a calibration's report, by file name."""
    found = calibration.identification
    pictures = {} if validation is None else {"tip_error_validation": held_out_picture(validation)}
    if held_out is not None:
        pictures["tip_error_held_out"] = held_out_picture(held_out)
    pictures["residuals"] = _residuals_picture(found)
    if maps is not None:
        pictures["workspace"] = workspace_picture(maps)
    if calibration.compensation.values is not None:
        pictures["parameters"] = _parameters_picture(found)
    return pictures


def held_out_picture(held_out: HeldOut) -> Figure:
    """Draw the share of held-out poses with tip errors below a value: before, after, floor, noise."""
    curves = (
        ("as described", held_out.before, BEFORE, "-"),
        ("corrected", held_out.after, AFTER, "-"),
        ("best commands (floor)", held_out.floor, FLOOR, "--"),
        ("measurement noise", held_out.noise, NOISE, ":"),
    )
    with house_style():
        figure = new_figure(TWO_COLUMNS, 3.2)
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


def _parameters_picture(found: Identification) -> Figure:
    """Draw the identified parameters with two standard deviations, in units of their tolerances."""
    values = found.values / found.errors.tolerances
    spread = np.minimum(found.sigmas / found.errors.tolerances, found.prior)
    places = np.arange(len(values))[::-1]
    with house_style():
        figure = new_figure(TWO_COLUMNS, 1.2 + 0.17 * len(values))
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        axes.axvspan(-1.0, 1.0, color="#EEEEEE", zorder=0)
        axes.axvline(0.0, color=INK, linewidth=0.7)
        axes.errorbar(values, places, xerr=2.0 * spread, fmt="o", markersize=3.0, color=AFTER, ecolor=NOISE)
        axes.set_yticks(places, [parameter_words(name) for name in found.errors.names], fontsize=7.0)
        axes.set_ylim(-1.0, len(values))
        axes.set_xlabel("value ± two standard deviations, relative to the tolerance")
    return figure


def _residuals_picture(found: Identification) -> Figure:
    """Draw the residual of every measurement in units of its sigma, with outliers marked."""
    size = np.sqrt(np.mean(found.normalized_residuals**2, axis=1))
    outliers = np.zeros(len(size), dtype=bool)
    outliers[list(found.outliers)] = True
    lines = np.array(found.measurements.lines)
    with house_style():
        figure = new_figure(TWO_COLUMNS, 2.6)
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
    """Draw maps of the tip error before and after, and of the floor if known, with a common colour scale."""
    fields = [errors.before, errors.after, *([] if errors.floor is None else [errors.floor])]
    scale = color_scale(_MICROMETRES * np.stack(fields))
    meshes = [outlined_mesh(*errors.coordinates, np.isfinite(field), errors.within) for field in fields]
    with house_style():
        figure = new_figure(TWO_COLUMNS, 2.6)
        figure.set_layout_engine("constrained", wspace=0.04)
        row: Any = figure.subplots(1, len(fields), sharex=True, sharey=True)
        for axes, title, field, mesh in zip(
            row, ("as described", "corrected, expected", "best commands (floor)"), fields, meshes, strict=False
        ):
            draw_map(axes, mesh, _MICROMETRES * mesh.values(field), scale, errors.units)
            axes.set_title(title)
            axes.xaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 5, 10]))
            axes.set_xlabel(axis_label(errors.names[0], errors.units[0]))
            if errors.units[0] == errors.units[1]:
                axes.set_aspect("equal")
        row[0].set_ylabel(axis_label(errors.names[1], errors.units[1]))
        bar = figure.colorbar(ScalarMappable(scale.norm(), COLORMAP), ax=row, extend=scale.extend, pad=0.01)
        bar.set_label("tip error [µm]")
        scale.label(bar)
    return figure
