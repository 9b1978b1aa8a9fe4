"""The report of a judged path: one self-contained HTML page with its pictures."""

from __future__ import annotations

from html import escape

import numpy as np
from matplotlib.figure import Figure

from pm3dof_pin.figures.html_page import html_image, html_page, html_table
from pm3dof_pin.figures.style import COLORMAP, INK, TWO_COLUMNS, house_style, new_figure, round_ticks, spring_colors
from pm3dof_pin.paths.evaluation import Columns, PathEvaluation
from pm3dof_pin.paths.placement import PlacementSearch, WorkpiecePlacement
from pm3dof_pin.paths.summary import DRIVE_HEADER, WORST_HEADER, drive_rows, worst_rows

_BROKEN, _PATH, _RAPID = "#D55E00", "#0072B2", "#999999"  # Okabe and Ito
_MILLIMETRES, _MICROMETRES = 1e3, 1e6
_MAP_POINTS = 61  # along each variable
_GOALS = {"stiffest": "deflection", "accurate": "expected error", "fastest": "time per length"}
_SHOWN = {"m": (1e6, "µm"), "m/N": (1e6, "µm/N"), "s/m": (1.0, "s/m")}


def path_report(found: PathEvaluation, name: str, placement: WorkpiecePlacement | None = None) -> str:
    """Return the report of a path with this name, and of its placement if searched; equal paths give equal bytes."""
    summary, robot = found.summary, escape(found.robot.name)
    within = f"All {summary['points']} points are within limits and on home's branch."
    if not summary["within_limits"]:
        beyond = summary["points"] - summary["points_within_limits"]
        why = escape(", ".join(summary["broken_limits"]) or "another branch")
        line = summary["first_line_beyond_limits"]
        within = f"<b>{beyond} of {summary['points']} points break a limit ({why}), first in line {line}.</b>"
    time, work = f"{summary['time_s']:.2f} s", f"{summary['energy_J']:.4g} J"
    parts = [
        f"<h1>{escape(name)} on {robot}</h1>",
        f"<p>{within} It takes {time} and {work} of the drives, net.</p>",
        html_image(path_picture(found), "the path, seen along y and z"),
        "<h2>Worst points</h2>",
        html_table(WORST_HEADER, worst_rows(summary)),
        "<h2>In time</h2>",
        html_image(time_picture(found), "feed, speeds and forces of the drives, deflection and error over time"),
        "<h2>Drives</h2>",
        html_table(DRIVE_HEADER, drive_rows(summary)),
        "<p>Peak accelerations and forces are those right after a point of the path.</p>",
    ]
    if placement is not None:
        where = f"The workpiece is placed where the path is {placement.goal}: {_cost(placement)}."
        parts[3:3] = [
            f"<p>{where}</p>",
            html_image(_placement_picture(found, placement), "map of what was searched, and the path"),
        ]
    return html_page(f"{escape(name)} on {robot}", parts)


def _cost(placement: WorkpiecePlacement) -> str:
    (factor, unit), words = _SHOWN[placement.unit], _GOALS[placement.goal]
    before = "beyond a limit" if np.isnan(placement.cost_before) else f"{factor * placement.cost_before:.4g} {unit}"
    return f"{words} {factor * placement.cost:.4g} {unit}, before {before}"


def _placement_picture(found: PathEvaluation, placement: WorkpiecePlacement) -> Figure:
    """Draw the map of what was searched around the path, at its mean height and orientation, and the path on it.

    Over one variable alone, a curve.
    """
    search = PlacementSearch(found.bare, found.path, placement.goal, found.options)
    names = [name for name in placement.variables if name != "rz"][:2]
    ends = search.ends(turn=False)
    axes_values = [np.linspace(*ends[name], _MAP_POINTS if len(names) > 1 else 10 * _MAP_POINTS) for name in names]
    mesh = np.stack(np.meshgrid(*axes_values, indexing="ij"), axis=-1).reshape(-1, len(names))
    targets = np.tile(search.targets.mean(axis=0), (len(mesh), 1))
    columns = ["xyz".index(name) for name in names]
    targets[:, columns] = mesh
    quality, within = search.judged(targets)
    (factor, unit), words = _SHOWN[placement.unit], _GOALS[placement.goal]
    values = np.where(within, factor * quality, np.nan)
    with house_style():
        figure = new_figure(TWO_COLUMNS, 3.2)
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        label = f"{words} [{unit}]"
        if len(names) == 1:
            axes.plot(_MILLIMETRES * mesh[:, 0], values, color=_PATH)
            places = _MILLIMETRES * search.targets[:, columns[0]]
            axes.axvspan(places.min(), places.max() + 1e-9, color=_BROKEN, alpha=0.3, linewidth=0.0, label="path")
            axes.axvline(places.mean(), color=_BROKEN, linewidth=0.8)
            axes.set_ylabel(label)
            axes.legend()
        else:
            first, second = (_MILLIMETRES * values_along for values_along in axes_values)
            drawn = axes.pcolormesh(
                first, second, values.reshape(len(first), -1).T, cmap=COLORMAP, shading="nearest", rasterized=True
            )
            figure.colorbar(drawn, label=label)
            axes.plot(*(_MILLIMETRES * search.targets[:, columns].T), color=_BROKEN, linewidth=1.4, label="path")
            axes.set_ylabel(f"{names[1]} [mm]")
            axes.set_aspect("equal")
            axes.legend(loc="upper right")
        axes.set_xlabel(f"{names[0]} [mm]")
    return figure


def path_picture(found: PathEvaluation) -> Figure:
    """Draw the path of the tool against the workpiece from above and from the side, points beyond limits marked."""
    columns = found.thinned
    places = _against_workpiece(columns) * _MILLIMETRES
    within, rapid = columns["within_limits"] == 1.0, _rapid(found, columns)
    with house_style():
        figure = new_figure(TWO_COLUMNS, 3.0)
        figure.set_layout_engine("constrained")
        for axes, (across, up) in zip(figure.subplots(1, 2), ((0, 1), (0, 2)), strict=True):
            for label, chosen, color, width in (("rapid", rapid, _RAPID, 0.7), ("feed", ~rapid, _PATH, 1.4)):
                # a segment belongs to the move of its second point
                line = np.stack([places[:-1], places[1:], np.full_like(places[1:], np.nan)], axis=1)
                line = line[chosen[1:]].reshape(-1, 3)
                axes.plot(line[:, across], line[:, up], color=color, linewidth=width, label=label)
            if not within.all():
                axes.plot(
                    *places[~within][:, [across, up]].T, ".", color=_BROKEN, markersize=4.0, label="breaks a limit"
                )
            axes.set_xlabel(f"{'xyz'[across]} [mm]")
            axes.set_ylabel(f"{'xyz'[up]} [mm]")
            axes.set_aspect("equal", adjustable="datalim")
            round_ticks(axes)
        handles, labels = axes.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=3)
    return figure


def time_picture(found: PathEvaluation) -> Figure:
    """Draw feed, speeds and forces of the drives, and deflection and error, over time."""
    columns, robot = found.thinned, found.robot
    time = columns["time_s"]
    drives = [(command.name, f"u{k}") for k, command in enumerate(robot.commands, start=1)]
    colors = spring_colors(len(drives))
    panels = [("feed [mm/min]", [("", columns["feed_m_s"] * 6e4, INK)])]
    for moment, label in (("speed", "drive speed"), ("force", "drive force")):
        keys = [next(key for key in columns if key.startswith(f"{name}_{moment}_")) for _, name in drives]
        units = sorted(
            {_unit(key.removeprefix(f"{name}_{moment}_")) for key, (_, name) in zip(keys, drives, strict=True)}
        )
        lines = [(words, columns[key], color) for key, (words, _), color in zip(keys, drives, colors, strict=True)]
        panels.append((f"{label} [{', '.join(units)}]", lines))
    micrometres = []
    if "deflection_x_m" in columns:
        size = np.linalg.norm([columns[f"deflection_{axis}_m"] for axis in "xyz"], axis=0)
        if np.nanmax(size, initial=0.0) > 0.0:
            micrometres.append(("deflection", size * _MICROMETRES, _PATH))
    if "expected_error_m" in columns:
        micrometres.append(("expected error", columns["expected_error_m"] * _MICROMETRES, _BROKEN))
    panels += [(f"{label} [µm]", [("", values, color)]) for label, values, color in micrometres]
    with house_style():
        figure = new_figure(TWO_COLUMNS, 0.4 + 1.25 * len(panels))
        figure.set_layout_engine("constrained")
        rows = figure.subplots(len(panels), 1, sharex=True)
        for axes, (label, lines) in zip(rows, panels, strict=True):
            for words, values, color in lines:
                axes.plot(time, values, color=color, linewidth=0.9, label=words)
            axes.set_ylabel(label)
            round_ticks(axes, 8, 4)
        rows[-1].set_xlabel("time [s]")
        rows[-1].set_xlim(time[0], max(time[-1], time[0] + 1e-9))
        handles, labels = rows[1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside upper center", ncols=8)
        figure.align_ylabels()
    return figure


def _against_workpiece(columns: Columns) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Return the positions of the tool point against the workpiece, shape=(n, 3) [m]."""
    zero = np.zeros_like(columns["time_s"])
    return np.stack([columns[f"tool_{a}_m"] - columns.get(f"table_{a}_m", zero) for a in "xyz"], axis=1)


def _rapid(found: PathEvaluation, columns: Columns) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    """Return which points are in rapids; lines of a program may have several moves, which are alike."""
    return np.asarray(found.path.rapid[np.searchsorted(found.path.lines, columns["line"])])


def _unit(key: str) -> str:
    return {"m_s": "m/s", "rad_s": "rad/s", "N": "N", "N_m": "N m"}[key]
