"""`pm3dof calibrate`."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

import typer

from pm3dof_pin.cli.error_parameters import closing_errors
from pm3dof_pin.cli.options import Json, RobotErrorsOptions
from pm3dof_pin.cli.output import message, print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import PictureFormat, save

if TYPE_CHECKING:
    from pm3dof_pin.calibration.calibrate import Calibration
    from pm3dof_pin.measuring.measurements import Measurements


_ROOMS = ("pm3dof_pin.measuring", "pm3dof_pin.calibration")
_FEW = 0.5  # fraction of the validation poses within their bounds


MethodName: TypeAlias = Literal["lm", "nn", "gp", "lm+nn", "lm+gp"]
"""Calibration methods."""

TargetOffsets: TypeAlias = Literal["fixed", "estimate"]
"""Whether target positions are estimated or taken from the file."""


def calibrate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Measurements (CSV).")],
    out: Annotated[Path, typer.Option(help="Output folder; an earlier calibration in it is replaced.")],
    which: RobotErrorsOptions,
    method: Annotated[
        MethodName,
        typer.Option(help="lm: geometric parameters; nn, gp: a learned correction; lm+nn, lm+gp: both."),
    ] = "lm+gp",
    own_frame: Annotated[
        bool, typer.Option("--own-frame", help="Positions are in the instrument's own frame; locate the base first.")
    ] = False,
    target_offsets: Annotated[
        TargetOffsets,
        typer.Option(help="Positions of targets away from the tool point: estimated, or fixed as in the file."),
    ] = "estimate",
    target_sigma: Annotated[
        float, typer.Option(min=1e-9, help="Standard deviation of the file's target positions, per coordinate [m].")
    ] = 1e-3,
    tool_point_sigma: Annotated[
        float, typer.Option(min=0.0, help="Also estimate the tool point, with this prior standard deviation [m].")
    ] = 0.0,
    validation: Annotated[
        Path | None,
        typer.Option(metavar="FILE", help="Separate measurements, not fitted, to validate the calibration on."),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Write a result that would be refused, marked as forced.")
    ] = False,
    eta: Annotated[float, typer.Option(help="Weight of the orientation in the tip error [m/rad].")] = 0.1,
    prior: Annotated[
        float | None,
        typer.Option(
            help="Prior standard deviation of the parameters, in units of their tolerances; by default the most likely "
            "value from 1 to 3, given the measurements."
        ),
    ] = None,
    loss: Annotated[
        Literal["squares", "huber", "tukey"], typer.Option(help="Loss function of the identification.")
    ] = "tukey",
    seed: Annotated[int, typer.Option(min=0, help="Random seed; the same seed gives the same files.")] = 0,
    formats: Annotated[
        list[PictureFormat] | None,
        typer.Option("--format", help="Also write the report's pictures as files in this format; may be repeated."),
    ] = None,
    as_json: Json = False,
) -> None:
    """Calibrate a machine from measurements: parameters, corrections, a calibrated URDF and a report."""
    from pm3dof_pin.calibration.calibrate import Options
    from pm3dof_pin.calibration.judging import validated_errors
    from pm3dof_pin.calibration.objections import calibrate_and_object
    from pm3dof_pin.calibration.results import REPORT, summary_of, write_calibration
    from pm3dof_pin.calibration.verdict import verdict
    from pm3dof_pin.calibration.workspace_errors import workspace_errors
    from pm3dof_pin.description.robots import find_robot
    from pm3dof_pin.exceptions import CalibrationRefusedError
    from pm3dof_pin.figures.calibration import calibration_pictures
    from pm3dof_pin.figures.calibration_report import report_as_html
    from pm3dof_pin.measuring.measurement_file import read_measurements

    def read(path: Path) -> Measurements:
        sigma = target_sigma if target_offsets == "estimate" else 0.0
        return read_measurements(
            path, errors.robot, own_frame=own_frame, target_sigma=sigma, tool_point_sigma=tool_point_sigma
        )

    with _warnings_as_messages():
        errors = closing_errors(which.load_errors())
        measurements = read(file)
        others = None if validation is None else read(validation)
        options = Options(method, seed, eta, prior, loss)
        with progress_bar("calibrating") as progress:
            calibration, held_out, reasons = calibrate_and_object(
                measurements, errors, options, lambda done, _: progress(done, 4)
            )
            if reasons and not force:
                raise CalibrationRefusedError(reasons)
            on_others = None if others is None else validated_errors(calibration, others)
            if on_others is not None and on_others.within < _FEW:
                message(
                    f"pm3dof: warning: {100.0 * on_others.within:.0f} % of the poses of {validation} are within their "
                    "95 % bounds: they may be from another machine or another state of it"
                )
            maps = workspace_errors(calibration)
            progress(3, 4)
            name = find_robot(which.robot).name
            judgement = verdict(calibration, held_out, on_others)
            more: Any = {"validation": on_others, "objections": reasons, "judgement": judgement}
            pictures = calibration_pictures(calibration, held_out, maps, validation=on_others)
            report = report_as_html(calibration, name, held_out, maps, pictures=pictures, **more)
            folder = write_calibration(
                calibration, which.robot, out, held_out, report, errors_file=which.errors, **more
            )
            if formats:
                for picture, figure in pictures.items():
                    save(figure, folder / f"{picture}.png", formats)
            progress(4, 4)
    summary = summary_of(calibration, name, held_out, **more)
    for reason in reasons:
        message(f"pm3dof: forced despite: {reason}")
    print_result({"directory": str(folder)} | summary, _lines(summary, calibration), as_json=as_json)
    message(f"wrote {folder}, report in {folder / REPORT}")


@contextmanager
def _warnings_as_messages() -> Iterator[None]:
    """Print the calibration's warnings on standard error."""
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("pm3dof: warning: %(message)s"))
    for room in _ROOMS:
        logging.getLogger(room).addHandler(handler)
    try:
        yield
    finally:
        for room in _ROOMS:
            logging.getLogger(room).removeHandler(handler)


def _lines(summary: dict[str, Any], calibration: Calibration) -> list[str]:
    found = calibration.identification
    known, named = found.identifiability, []
    if len(found.nuisances):
        named = [f"also estimated: {', '.join(dict.fromkeys(part.kind for part in found.nuisances.parts))}"]
    measured = summary["measurements"]
    poses = "" if measured["count"] == measured["poses"] else f" of {measured['poses']} poses"
    lines = [
        f"{measured['count']} measurements{poses}, method {summary['method']}",
        "; ".join(
            [
                f"{known.rank} of {len(known.names)} parameters identified",
                *named,
                f"noise factor {found.noise_factor:.2f}",
            ]
        ),
    ]
    for kind in ("drift", "hysteresis"):
        if (moved := summary.get(kind)) is not None and moved["more_than_chance"]:
            size, sigma = (1e6 * moved[key] for key in ("tip_error_m", "tip_sigma_m"))
            lines.append(f"{kind} moved the tool by {size:.0f} ± {sigma:.0f} µm (tip error, rms)")
    if summary.get("validation") is None and summary.get("held_out") is None:
        return [*lines, "too few poses for a cross-validation"]
    names = {
        "tip_error_before_m": "as described",
        "tip_error_after_m": "corrected",
        "tip_error_floor_m": "best commands (floor)",
        "tip_noise_m": "measurement noise",
        "excess_joint_error_m": "corrected minus best commands",
        "excess_joint_error_rad": "corrected minus best commands [µrad]",
        "excess_joint_error_m_rad": "corrected minus best commands [µm, µrad]",
    }
    for kind, words in (("validation", "poses of the validation"), ("held_out", "held-out poses")):
        if kind in summary:
            rows = [
                [text, *(f"{1e6 * summary[kind][key][name]:.1f}" for name in ("mean", "percentile_95", "max"))]
                for key, text in names.items()
                if key in summary[kind]
            ]
            lines += table_lines([f"{words}, tip error [µm]", "mean", "95 %", "max"], rows)
            for key, text in names.items():
                if (between := summary[kind].get(key, {}).get("rms_95_percent_interval")) is not None:
                    low, high = (1e6 * value for value in between)
                    lines.append(f"{text}, rms of this machine: {low:.1f} to {high:.1f} with 95 % probability")
    return lines
