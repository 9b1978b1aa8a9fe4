"""The report of a calibration: one self-contained HTML page with its pictures."""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from html import escape

import numpy as np
from matplotlib.figure import Figure

from pm3dof_pin.calibration.elastic_term import STIFFNESS_SIGMA
from pm3dof_pin.calibration.expectation import Expectation
from pm3dof_pin.calibration.fit import Fit
from pm3dof_pin.calibration.held_out import HeldOut, statistics
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.workspace_errors import WorkspaceErrors
from pm3dof_pin.figures.style import house_style

_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 60em; margin: 2em auto; padding: 0 1em; }
table { border-collapse: collapse; margin: 1em 0; } td, th { padding: .2em .8em; border-bottom: 1px solid #ddd; }
td:not(:first-child), th:not(:first-child) { text-align: right; } img { max-width: 100%; }
"""

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
    calibration: Fit,
    robot: str,
    pictures: Mapping[str, Figure],
    held_out: HeldOut | None,
    validation: HeldOut | None,
    maps: WorkspaceErrors | None,
    refusals: Sequence[str],
    expectation: Expectation,
) -> str:
    """Return the report of a calibration, with its pictures; identical calibrations give identical bytes."""
    options, found = calibration.options, calibration.identification
    of_validation, of_held_out = (pictures.get(f"tip_error_{kind}") for kind in ("validation", "held_out"))
    parts = [
        f"<h1>Calibration of {escape(robot)}</h1>",
        *(f"<p><b>Written with --force, although {escape(reason)}.</b></p>" for reason in refusals),
        *_expectation(expectation),
        f"<p>{len(calibration.measurements)} measurements ({found.measurements.measured}s), method "
        f"<b>{options.method}</b>: {_METHODS[options.method]}. Tip errors weigh rotations by {options.eta:g} m/rad. "
        f"Seed {options.seed}.</p>",
        *([] if validation is None else _accuracy(calibration, validation, of_validation, *_VALIDATION)),
        *_accuracy(calibration, held_out, of_held_out, *_CROSS_VALIDATION),
        *_budget(expectation),
        *_data(calibration, pictures["residuals"]),
    ]
    if maps is not None:
        floor = "The floor is the part that no command corrects." if maps.floor is not None else _NO_FLOOR
        parts += [
            "<h2>Over the workspace</h2>",
            f"<p>According to the calibration, with the other coordinates in the middle of their ranges. {floor}</p>",
            _image(pictures["workspace"], "maps of the tip error before and after"),
        ]
    if calibration.compensation.values is not None:
        parts += _parameters(found, pictures["parameters"])
    body = "\n".join(parts)
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        f"<title>Calibration of {escape(robot)}</title><style>{_STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


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
    return ["<h2>Measurements</h2>", f"<ul>{listed}</ul>", _image(residuals, "residual of each measurement")]


def _expectation(found: Expectation) -> list[str]:
    lines = (("To expect", found.text), ("Not seen", found.not_seen), ("To do next", found.next))
    return ["<p>" + "<br>".join(f"<b>{name}:</b> {escape(text)}." for name, text in lines) + "</p>"]


def _budget(expectation: Expectation) -> list[str]:
    words = {
        "floor": "not correctable by commands",
        "instrument": "instrument noise",
        "frame": "instrument frame",
        "targets": "target positions, drift, hysteresis",
        "parameters": "unobserved parameters",
        "learned": "learned part",
        "unmodelled": "unmodelled effects",
        "repeatability": "repeatability",
    }
    rows = [(words[name], f"{1e6 * value:.1f}") for name, value in expectation.budget.items()]
    total = float(np.sqrt(sum(value**2 for value in expectation.budget.values())))
    parts = [
        "<h2>Sources of the remaining error</h2>",
        "<p>Contributions to the tip error of the corrected machine, root mean square over the workspace; squares add "
        "up.</p>",
        _table(("source", "tip error [µm]"), [*rows, ("total", f"{1e6 * total:.1f}")]),
    ]
    for found in expectation.systematic:
        chance = "significant" if found.sure else "not significant"
        parts.append(
            f"<p>{found.kind.capitalize()}: {1e6 * found.tip:.1f} ± {1e6 * found.tip_sigma:.1f} µm at the tip, "
            f"{chance}. It is removed from the identification, not corrected.</p>"
        )
    repeated = expectation.repeated
    if repeated is not None:
        parts.append(
            f"<p>Repeated poses: the machine deviates from its mean by {1e6 * repeated.tip_sigma:.1f} µm at the tip "
            f"(rms, without noise; {repeated.freedom} degrees of freedom).</p>"
        )
        if len(repeated.poses):
            columns = (repeated.poses + 1, repeated.visits, 1e6 * repeated.accuracy, 1e6 * repeated.repeatability)
            numbers = [
                (f"{pose:.0f}", f"{visits:.0f}", f"{accuracy:.1f}", f"{spread:.1f}")
                for pose, visits, accuracy, spread in zip(*columns, strict=True)
            ]
            header = ("pose", "visits", "accuracy AP [µm]", "repeatability RP [µm]")
            parts += ["<p>As in ISO 9283, uncorrected, noise included:</p>", _table(header, numbers)]
    return parts


def _accuracy(calibration: Fit, held_out: HeldOut | None, picture: Figure | None, title: str, text: str) -> list[str]:
    heading = f"<h2>{title}</h2>"
    if held_out is None or picture is None:
        return [heading, "<p>Unknown: too few poses for a cross-validation.</p>"]
    units = sorted({command.unit for command in calibration.compensation.errors.robot.commands})
    joint_unit = ", ".join(f"µ{unit}" for unit in units)
    rows = [
        ("as described", held_out.before),
        ("corrected", held_out.after),
        ("best commands: floor", held_out.floor),
        ("measurement noise", held_out.noise),
        (f"corrected minus best commands, expected, each joint [{joint_unit}]", held_out.excess),
    ]
    kinds = ("as described", "corrected", "best commands: floor")
    rows += [(f"E of (8.15), {kind}", values) for kind, values in zip(kinds, held_out.energies, strict=True)]
    rows = [(name, values) for name, values in rows if np.isfinite(values).all()]
    numbers = [(name, *(f"{1e6 * number:.1f}" for number in statistics(values).values())) for name, values in rows]
    interval = ""
    if held_out.excess_interval is not None:
        low, high = (1e6 * value for value in held_out.excess_interval)
        interval = f"<p>For this machine, corrected minus best commands have a root mean square of {low:.1f} to "
        interval += f"{high:.1f} {joint_unit} with a probability of 95 %, given the finite number of poses.</p>"
    return [
        heading,
        f"<p>{text} Tip errors are in µm, as measured, and all include noise. The floor remains with the best "
        "possible commands: with fewer drives than degrees of freedom of a pose, commands cannot correct everything. "
        "E, the energy of the pose error, adds position and weighted rotation instead of their squares; the best "
        "commands are best for the tip error.</p>",
        _table(("tip error [µm]", "mean", "95 %", "max"), numbers),
        interval,
        _image(picture, "share of held-out poses below a tip error"),
        f"<p>{100.0 * held_out.within:.0f} % of the 95 % prediction intervals contain the measurement. In addition to "
        f"noise, {1e6 * calibration.compensation.scatter.tip_error:.1f} µm (rms) of the tip error are "
        "unexplained.</p>",
    ]


def _parameters(found: Identification, picture: Figure) -> list[str]:
    rows = [
        (name, f"{1e6 * value:.2f}", f"{1e6 * sigma:.2f}", f"{1e6 * tolerance:.0f}", f"µ{unit}")
        for name, value, sigma, tolerance, unit in zip(
            found.errors.names, found.values, found.sigmas, found.errors.tolerances, found.errors.units, strict=True
        )
    ]
    silent = [
        ("Combinations known no better than their tolerances", found.identifiability.unidentified),
        ("Parameters individually dominated by the prior", found.prior_dominated),
    ]
    remarks = "".join(f"<li>{text}: {escape('; '.join(names) or 'none')}.</li>" for text, names in silent)
    return [
        "<h2>Identified parameters</h2>",
        f"<p>{found.identifiability.identified} combinations of {len(found.identifiability.names)} parameters are "
        "known better than their tolerances. The grey band is the tolerance; before the measurements the standard "
        f"deviation was {found.prior:g} tolerances.</p>",
        f"<ul>{remarks}</ul>",
        _image(picture, "identified parameters with their uncertainties"),
        _table(("parameter", "value", "sigma", "tolerance", "unit"), rows),
        *_stiffness(found),
    ]


def _stiffness(found: Identification) -> list[str]:
    if not found.stiffness:
        return []
    rows = [(name, f"{factor:.3f}", f"{100.0 * sigma:.1f}") for name, (factor, sigma) in found.stiffness.items()]
    return [
        "<h2>Identified stiffness</h2>",
        "<p>From the deflections under the measured wrenches. A spring whose uncertainty remains at "
        f"{100.0 * STIFFNESS_SIGMA:.0f} % is as described: the measurements do not determine it.</p>",
        _table(("spring", "stiffness relative to the description", "sigma [%]"), rows),
    ]


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["<tr>" + "".join(f"<th>{escape(cell)}</th>" for cell in header) + "</tr>"]
    lines += ["<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows]
    return "<table>" + "\n".join(lines) + "</table>"


def _image(figure: Figure, text: str) -> str:
    buffer = io.BytesIO()
    with house_style():
        figure.savefig(buffer, format="svg", metadata={"Date": None})
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<p><img alt="{escape(text)}" src="data:image/svg+xml;base64,{data}"></p>'
