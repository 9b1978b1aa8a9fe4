"""The report of a calibration: one self-contained HTML page with its pictures."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape
from typing import Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, MaxNLocator

from pm3dof_pin.calibration.elastic_term import STIFFNESS_SIGMA
from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.folder import ACCURACIES, accuracy_rows, error_in_words
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.workspace_errors import WorkspaceErrors
from pm3dof_pin.figures.color_scale import color_scale
from pm3dof_pin.figures.html_page import html_image, html_page, html_table
from pm3dof_pin.figures.labels import axis_label, parameter_words
from pm3dof_pin.figures.outlined_mesh import draw_map, outlined_mesh
from pm3dof_pin.figures.style import COLORMAP, INK, TWO_COLUMNS, house_style, new_figure

_BEFORE, _AFTER, _FLOOR, _NOISE = "#D55E00", "#0072B2", "#009E73", "#999999"  # Okabe and Ito

_MICROMETRES = 1e6
_MOST = 50  # parameters drawn
_SHOWN = 4.0  # tolerances; a wider uncertainty leaves the picture of the parameters
_NO_FLOOR = (
    "The part that no command corrects is not drawn: only identified parameters locate it. Both maps lack it, except "
    "for its mean, which the second includes."
)
_CROSS_VALIDATION = (
    "Accuracy on held-out poses",
    "Cross-validation: each fifth of the poses is predicted from the rest.",
)
_VALIDATION = ("On the validation file", "These measurements were not used in the calibration.")
_METHODS = {
    "lm": "geometric parameters by least squares",
    "nn": "a neural network on the joint variables",
    "gp": "a Gaussian process on the joint variables",
    "lm+nn": "geometric parameters by least squares, and a neural network on the remainder",
    "lm+gp": "geometric parameters by least squares, and a Gaussian process on the remainder",
}


def report_as_html(
    calibration: Fit, summary: Mapping[str, Any], pictures: Mapping[str, Figure], maps: WorkspaceErrors | None
) -> str:
    """Return the report of a calibration with its summary and pictures; identical calibrations give identical bytes."""
    options, found, robot = calibration.options, calibration.identification, escape(summary["robot"])
    lines = {"To expect": "what_to_expect", "Not seen": "what_was_not_seen", "To do next": "what_to_do_next"}
    of_validation, of_held_out = (pictures.get(f"tip_error_{kind}") for kind in ("validation", "held_out"))
    parts = [
        f"<h1>Calibration of {robot}</h1>",
        *(
            f"<p><b>Written with --force, although {escape(reason)}.</b></p>"
            for reason in summary.get("forced_against", ())
        ),
        "<p>" + "<br>".join(f"<b>{name}:</b> {escape(summary[key])}." for name, key in lines.items()) + "</p>",
        f"<p>{len(calibration.measurements)} measurements ({found.measurements.measured}s), method "
        f"<b>{options.method}</b>: {_METHODS[options.method]}. Tip errors weigh rotations by {options.eta:g} m/rad. "
        f"Seed {options.seed}.</p>",
        *([] if "validation" not in summary else _accuracy(summary, "validation", of_validation, *_VALIDATION)),
        *_accuracy(summary, "held_out", of_held_out, *_CROSS_VALIDATION),
        *_budget(summary),
        *_data(calibration, pictures["residuals"]),
    ]
    if maps is not None:
        floor = "The floor is the part that no command corrects." if maps.floor is not None else _NO_FLOOR
        parts += [
            "<h2>Over the workspace</h2>",
            f"<p>According to the calibration, with the other coordinates in the middle of their ranges. {floor}</p>",
            html_image(pictures["workspace"], "maps of the tip error before and after"),
        ]
    if calibration.compensation.values is not None:
        parts += _parameters(found, pictures["parameters"])
    return html_page(f"Calibration of {robot}", parts)


def _data(calibration: Fit, residuals: Figure) -> list[str]:
    found = calibration.identification
    remarks = [escape(text) for text in calibration.measurements.warnings]
    if (registration := calibration.measurements.registration) is not None:
        x, y, z = registration.base[:3, 3]
        remarks.append(
            f"The base was found from the measurements: its origin is at ({x:.6f}, {y:.6f}, {z:.6f}) m in the frame of "
            f"the instrument. Positions differ by {1e6 * registration.residual:.0f} µm (rms) from the description."
        )
    if found.outliers:
        lines = ", ".join(map(str, found.outlier_lines))
        remarks.append(f"Outliers, given little or no weight and excluded from learned models: lines {lines}.")
    if found.noise_factor > 1.0:
        remarks.append(
            f"The residuals of the parametric model scatter {found.noise_factor:.2f} times as much as the sigmas of "
            "the measurements say: the noise is greater, or the machine has errors outside its parameters."
        )
    listed = "".join(f"<li>{remark}</li>" for remark in remarks) or "<li>No anomalies were found.</li>"
    return ["<h2>Measurements</h2>", f"<ul>{listed}</ul>", html_image(residuals, "residual of each measurement")]


def _budget(summary: Mapping[str, Any]) -> list[str]:
    budget = summary["uncertainty_budget_m"]
    words = {
        "floor": "not correctable by commands",
        "instrument": "instrument noise",
        "frame": "instrument frame",
        "targets": "target positions, drift, hysteresis",
        "parameters": "unobserved parameters",
        "learned": "learned part",
        "drift": "drift, at an unknown time of a session",
        "hysteresis": "hysteresis, drives arriving from either side",
        "unmodelled": "unmodelled effects",
        "repeatability": "repeatability",
    }
    rows = [(words[name], f"{1e6 * value:.1f}") for name, value in budget.items()]
    total = float(np.sqrt(sum(value**2 for value in budget.values())))
    parts = [
        "<h2>Sources of the remaining error</h2>",
        "<p>Contributions to the tip error of the corrected machine, root mean square over the workspace; squares add "
        "up.</p>",
        html_table(("source", "tip error [µm]"), [*rows, ("total", f"{1e6 * total:.1f}")]),
    ]
    for kind in ("drift", "hysteresis"):
        if kind in summary:
            size, sigma = (1e6 * summary[kind][key] for key in ("tip_error_m", "tip_sigma_m"))
            chance = "significant" if summary[kind]["more_than_chance"] else "not significant"
            parts.append(
                f"<p>{kind.capitalize()}: {size:.1f} ± {sigma:.1f} µm at the tip, {chance}. It is removed from the "
                "identification, and counts above; commands correct it where they are told the "
                f"{'time' if kind == 'drift' else 'directions in which the drives arrive'}.</p>"
            )
    if (repeated := summary.get("repeatability")) is not None:
        parts.append(
            f"<p>Repeated poses: the machine deviates from its mean by {1e6 * repeated['tip_sigma_m']:.1f} µm at the "
            f"tip (rms, without noise; {repeated['degrees_of_freedom']} degrees of freedom).</p>"
        )
        if table := repeated["iso_9283"]:
            header = ("pose", "visits", "accuracy AP [µm]", "repeatability RP [µm]")
            numbers = [
                [f"{row['pose']}", f"{row['visits']}"]
                + [f"{1e6 * row[key]:.1f}" for key in ("accuracy_AP_m", "repeatability_RP_m")]
                for row in table
            ]
            parts += ["<p>As in ISO 9283, uncorrected, noise included:</p>", html_table(header, numbers)]
    return parts


def _accuracy(summary: Mapping[str, Any], kind: str, picture: Figure | None, title: str, text: str) -> list[str]:
    heading, errors = f"<h2>{title}</h2>", summary.get(kind)
    if errors is None or picture is None:
        return [heading, "<p>Unknown: too few poses for a cross-validation.</p>"]
    interval = ""
    for key, entry in errors.items():
        if key in ACCURACIES and "rms_95_percent_interval" in entry:
            low, high = (1e6 * value for value in entry["rms_95_percent_interval"])
            units = ", ".join(f"µ{unit}" for unit in key.removeprefix("excess_joint_error_").split("_"))
            interval = f"<p>For this machine, each command is off the best one by a root mean square of {low:.1f} to "
            interval += f"{high:.1f} {units} with a probability of 95 %, given the finite number of poses.</p>"
    return [
        heading,
        f"<p>{text} Tip errors are in µm, as measured, and all include noise. The floor remains with the best "
        "possible commands: with fewer drives than degrees of freedom of a pose, commands cannot correct everything. "
        "The last line is how far the corrected command of each drive is expected to be off the best one. E, the "
        "energy of the pose error, adds position and weighted rotation instead of their squares; the best commands are "
        "best for the tip error.</p>",
        html_table(
            (f"{summary['measurements']['error_seen']} [µm]", "mean", "95 %", "max"),
            [[name, *row] for name, row in accuracy_rows(errors).items()],
        ),
        interval,
        html_image(picture, "share of held-out poses below a tip error"),
        f"<p>{100.0 * errors['within_95_percent_bound']:.0f} % of the 95 % prediction intervals contain the "
        f"measurement. In addition to noise, {1e6 * summary['unexplained_tip_error_m']:.1f} µm (rms) of the tip error "
        "are unexplained.</p>",
    ]


def _parameters(found: Identification, picture: Figure) -> list[str]:
    rows = [
        (name, *(f"{1e6 * number:.2f}" for number in numbers), f"{1e6 * tolerance:.0f}", f"µ{unit}")
        for name, *numbers, tolerance, unit in zip(
            found.errors.names,
            found.values,
            found.data_sigmas,
            found.sigmas,
            found.errors.tolerances,
            found.errors.units,
            strict=True,
        )
    ]
    silent = [
        ("Combinations known no better than their tolerances", found.identifiability.unidentified),
        ("Parameters individually dominated by the prior", found.prior_dominated),
    ]
    some = f" Drawn are the {_MOST} farthest from the description." if len(rows) > _MOST else ""
    remarks = "".join(f"<li>{text}: {escape('; '.join(names) or 'none')}.</li>" for text, names in silent)
    return [
        "<h2>Identified parameters</h2>",
        f"<p>{found.identifiability.identified} combinations of {len(found.identifiability.names)} parameters are "
        "known better than their tolerances. The grey band is the tolerance; before the measurements the standard "
        f"deviation was {found.prior.k:g} tolerances.{some}</p>",
        f"<ul>{remarks}</ul>",
        "<p>The first sigma is what the data say, given their noise and the tolerances. The second adds what they "
        "cannot tell: smooth effects that no parameter describes, hidden in the noise, may shift the parameters by as "
        "much.</p>",
        html_image(picture, "identified parameters with their uncertainties"),
        html_table(("parameter", "value", "sigma of the data", "sigma with hidden effects", "tolerance", "unit"), rows),
        *_stiffness(found),
    ]


def _stiffness(found: Identification) -> list[str]:
    if not found.stiffness:
        return []
    shares = found.stiffness_shares
    rows = [
        (name, f"{factor:.3f}", f"{100.0 * sigma:.1f}", f"{100.0 * shares[name]:.0f}")
        for name, (factor, sigma) in found.stiffness.items()
    ]
    return [
        "<h2>Identified stiffness</h2>",
        "<p>From the deflections under the measured wrenches. A spring whose uncertainty remains near "
        f"{100.0 * STIFFNESS_SIGMA:.0f} %, with little from the data, is as described: the measurements do not "
        "determine it.</p>",
        html_table(("spring", "stiffness relative to the description", "sigma [%]", "from the data [%]"), rows),
    ]


def calibration_pictures(
    calibration: Fit,
    held_out: HeldOut | None = None,
    maps: WorkspaceErrors | None = None,
    *,
    validation: HeldOut | None = None,
) -> dict[str, Figure]:
    """Return the pictures of a calibration's report, by file name."""
    found, shown = calibration.identification, error_in_words(calibration.measurements)
    pictures = {} if validation is None else {"tip_error_validation": _held_out_picture(validation, shown)}
    if held_out is not None:
        pictures["tip_error_held_out"] = _held_out_picture(held_out, shown)
    pictures["residuals"] = _residuals_picture(found)
    if maps is not None:
        pictures["workspace"] = _workspace_picture(maps)
    if calibration.compensation.values is not None:
        pictures["parameters"] = _parameters_picture(found)
    return pictures


def _held_out_picture(held_out: HeldOut, shown: str) -> Figure:
    """Draw the share of held-out poses with errors, as shown, below a value: before, after, floor, noise."""
    curves = (
        ("as described", held_out.before, _BEFORE, "-"),
        ("corrected", held_out.after, _AFTER, "-"),
        ("best commands (floor)", held_out.floor, _FLOOR, "--"),
        ("measurement noise", held_out.noise, _NOISE, ":"),
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
        axes.set_xlabel(f"{shown} [µm]")
        axes.set_ylabel("held-out poses below [%]")
        axes.set_ylim(0.0, 102.0)
        figure.legend(loc="outside upper center", ncols=4)
    return figure


def _parameters_picture(found: Identification) -> Figure:
    """Draw the identified parameters with two standard deviations, in units of their tolerances."""
    values = found.values / found.errors.tolerances
    drawn = np.sort(np.argsort(-np.abs(values), kind="stable")[:_MOST])
    values, spread = values[drawn], (found.sigmas / found.errors.tolerances)[drawn]  # as in the table
    places = np.arange(len(values))[::-1]
    with house_style():
        figure = new_figure(TWO_COLUMNS, 1.2 + 0.17 * len(values))
        figure.set_layout_engine("constrained")
        axes = figure.subplots()
        axes.axvspan(-1.0, 1.0, color="#EEEEEE", zorder=0)
        axes.axvline(0.0, color=INK, linewidth=0.7)
        axes.errorbar(values, places, xerr=2.0 * spread, fmt="o", markersize=3.0, color=_AFTER, ecolor=_NOISE)
        axes.set_yticks(places, [parameter_words(found.errors.names[k]) for k in drawn], fontsize=7.0)
        axes.set_ylim(-1.0, len(values))
        reach = max(_SHOWN, 1.1 * float(np.abs(values).max(initial=0.0)))
        if float((np.abs(values) + 2.0 * spread).max(initial=0.0)) > reach:
            axes.set_xlim(-reach, reach)  # longer lines leave the picture: unknown to more than these tolerances
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
        axes.axhline(1.0, color=_NOISE, linestyle=":", label="noise as stated")
        axes.plot(lines[~outliers], size[~outliers], "o", markersize=3.0, color=_AFTER, label="measurement")
        if outliers.any():
            axes.plot(lines[outliers], size[outliers], "x", color=_BEFORE, label="outlier")
        axes.set_yscale("log")
        axes.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axes.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        axes.minorticks_off()
        axes.set_xlabel("line of the file")
        axes.set_ylabel("residual [sigma]")
        figure.legend(loc="outside upper center", ncols=3)
    return figure


def _workspace_picture(errors: WorkspaceErrors) -> Figure:
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
