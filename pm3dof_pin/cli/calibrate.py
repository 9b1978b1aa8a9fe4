"""`pm3dof calibrate`."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import typer

from pm3dof_pin.calibration.calibrate import Calibration, Options
from pm3dof_pin.calibration.calibrate import calibrate as calibrate_machine
from pm3dof_pin.calibration.folder import ACCURACIES, REPORT, accuracy_rows
from pm3dof_pin.cli.error_options import RobotErrorsOptions
from pm3dof_pin.cli.instrument_options import TargetOffsets
from pm3dof_pin.cli.options import ColumnsOf, Json
from pm3dof_pin.cli.output import message, print_result, progress_bar, table_lines
from pm3dof_pin.cli.pictures import PictureFormat, save
from pm3dof_pin.printers.firmware import is_of_firmware
from pm3dof_pin.printers.printer_calibration import calibrate_printer

_ROOMS = ("pm3dof_pin.csv_table", "pm3dof_pin.measuring", "pm3dof_pin.calibration")


MethodName: TypeAlias = Literal["lm", "nn", "gp", "lm+nn", "lm+gp"]
"""Calibration methods."""


def calibrate(
    file: Annotated[
        Path, typer.Argument(metavar="FILE", help="Measurements (CSV), or a printer's printer.cfg, config.g or log.")
    ],
    out: Annotated[Path, typer.Option(help="Output folder; an earlier calibration in it is replaced.")],
    which: RobotErrorsOptions,
    columns: ColumnsOf = None,
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
            help="Prior standard deviation of the parameters but nearly free zeros of drives, in units of their "
            "tolerances; by default the most likely value up to 3, given the measurements."
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
    bed_mesh: Annotated[
        bool, typer.Option("--bed-mesh", help="printer.cfg: also write what no parameter can express as a bed mesh.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Calibrate a machine from measurements: parameters, corrections, a calibrated URDF and a report.

    Or a delta printer from touches of its bed: FILE is Klipper's printer.cfg, a log with M665, M666 and G30, or the
    config.g of a Duet beside its heightmap.csv.
    """
    if is_of_firmware(file):
        _calibrate_printer(file, out, bed_mesh=bed_mesh, force=force, as_json=as_json)
        return

    with _warnings_as_messages(), progress_bar("calibrating") as progress:
        calibration = calibrate_machine(
            file,
            which.load_errors(),
            Options(method, seed, eta, prior, loss),
            validation=validation,
            on_refusal="keep" if force else "raise",
            own_frame=own_frame,
            target_sigma=target_sigma if target_offsets == "estimate" else 0.0,
            tool_point_sigma=tool_point_sigma,
            columns=columns,
            progress=lambda done, of: progress(done, of + 1),
        )
        folder = calibration.save(out)
        if formats:
            for picture, figure in calibration.pictures().items():
                save(figure, folder / f"{picture}.png", formats)
        progress(1, 1)
    for reason in calibration.refusals:
        message(f"pm3dof: forced despite: {reason}")
    summary = calibration.summary()
    print_result({"directory": str(folder)} | summary, _lines(summary, calibration), as_json=as_json)
    message(f"wrote {folder}, report in {folder / REPORT}")


def _calibrate_printer(file: Path, out: Path, *, bed_mesh: bool, force: bool, as_json: bool) -> None:
    found = calibrate_printer(file, bed_mesh=bed_mesh, on_refusal="keep" if force else "raise")
    folder = found.save(out)
    summary = found.summary()
    low, high = (1e6 * value for value in summary["height_error_held_out_95_percent_interval_m"])
    sizes = ", ".join(f"{1e6 * value:z.0f} µm with {count}" for count, value in summary["held_out_rms_m"].items())
    far = f" and {summary['distances']} distances" if summary["distances"] else ""
    lines = [
        f"{summary['firmware']}, {summary['touches']} touches{far}, up to "
        f"{1e3 * summary['touched_radius_m']:.0f} mm from the centre",
        f"error of a touch, held out: {sizes} parameters; {summary['parameters_chosen']} are taken",
        f"height error, rms: {1e6 * summary['height_error_before_rms_m']:z.0f} µm before, "
        f"{1e6 * summary['height_error_held_out_rms_m']:.0f} µm after ({low:.0f} to {high:.0f} with 95 % probability)",
        *(
            f"distances, rms: {1e6 * errors['before']:z.0f} µm before, {1e6 * errors['after']:.0f} µm after"
            for errors in ([summary["distance_error_rms_m"]] if summary["distances"] else [])
        ),
        *(
            f"{count} parameters are not taken: {', '.join(names)} would be off by more than a ruler misses, and the "
            "bow of a bed looks the same"
            for count, names in summary["parameters_beyond_a_ruler"].items()
        ),
        f"size of prints: {100.0 * (summary['print_scale'] - 1.0):+z.2f} %"
        + ("" if summary["distances"] else "; heights tell it hardly, so measure a print"),
        *(f"not determined by these touches: {words}" for words in summary["not_determined"]),
    ]
    if bed_mesh:
        words = "included" if summary["bed_mesh"] else "none: it would predict touches held out no better"
        lines.append(f"bed mesh: {words}")
    if meshes := summary["meshes_to_be_probed_again"]:
        lines.append(f"bed meshes probed with the old numbers, to be probed again: {', '.join(meshes)}")
    scales = {"m": (1e3, "mm"), "rad": (math.degrees(1.0), "deg")}
    rows = []
    for name, change in summary["changes"].items():
        scale, unit = scales[change["unit"]]
        sigmas = (f"{scale * change[key]:z.4f}" for key in ("sigma_of_the_data", "sigma"))
        rows.append([name, f"{scale * change['value']:+.4f}", *sigmas, unit])
    heads = ["number", "change", "sigma of the touches alone", "sigma with what they cannot tell", "unit"]
    lines += ["", *table_lines(heads, rows)]
    for note in summary["notes"]:
        message(f"pm3dof: warning: {note}")
    print_result({"directory": str(folder)} | summary, lines, as_json=as_json)
    message(f"wrote {folder / found.file.path.name}")


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
                f"{known.identified} of {len(known.names)} parameters identified"
                if calibration.options.identifies
                else "no parameters identified: corrections are learned from the deviations of the commands",
                *named,
                f"noise factor {found.noise_factor:z.2f}",
            ]
        ),
    ]
    if found.stiffness:
        undetermined = [spring for spring in found.stiffness if f"{spring}.ln_k" in found.prior_dominated]
        held = ", ".join(name for name in found.stiffness if name not in undetermined)
        lines.append(
            f"stiffness determined by the data: {held or 'none'}; as described: {', '.join(undetermined) or 'none'}"
        )
    for kind in ("drift", "hysteresis"):
        if (moved := summary.get(kind)) is not None and moved["more_than_chance"]:
            size, sigma = (1e6 * moved[key] for key in ("tip_error_m", "tip_sigma_m"))
            lines.append(f"{kind} moved the tool by {size:z.0f} ± {sigma:z.0f} µm (tip error, rms)")
    if summary.get("validation") is None and summary.get("held_out") is None:
        return [*lines, "too few poses for a cross-validation"]
    shown = measured["error_seen"]
    for kind, words in (("validation", "poses of the validation"), ("held_out", "held-out poses")):
        if kind in summary:
            rows = [[text, *row] for text, row in accuracy_rows(summary[kind]).items() if not text.startswith("E of")]
            lines += table_lines([f"{words}, {shown} [µm]", "mean", "95 %", "max"], rows)
            for key, text in ACCURACIES.items():
                if (between := summary[kind].get(key, {}).get("rms_95_percent_interval")) is not None:
                    low, high = (1e6 * value for value in between)
                    lines.append(f"{text}, rms of this machine: {low:z.1f} to {high:z.1f} with 95 % probability")
    return lines
