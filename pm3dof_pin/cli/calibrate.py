"""`pm3dof calibrate`."""

from __future__ import annotations

import logging
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pm3dof_pin.cli.error_parameters import closing_errors, load_errors
from pm3dof_pin.cli.options import THE_TRIPOD, Json
from pm3dof_pin.cli.output import message, print_result, table_lines
from pm3dof_pin.cli.pose_arguments import PackagePath, RobotName, ToolFrame
from pm3dof_pin.cli.progress import progress_bar

if TYPE_CHECKING:
    from pm3dof_pin.measuring.measurements import Measurements


_ROOMS = ("pm3dof_pin.measuring", "pm3dof_pin.calibration")


class MethodName(StrEnum):
    """How a machine is calibrated."""

    LM = "lm"
    NN = "nn"
    GP = "gp"
    LM_NN = "lm+nn"
    LM_GP = "lm+gp"


class LossName(StrEnum):
    """What residuals cost in the identification."""

    SQUARES = "squares"
    HUBER = "huber"
    TUKEY = "tukey"


def calibrate(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Measurements (CSV).")],
    out: Annotated[Path, typer.Option(help="Folder to write; an older calibration there is replaced.")],
    method: Annotated[
        MethodName,
        typer.Option(help="lm: geometric parameters; nn, gp: a learned correction; lm+nn, lm+gp: both."),
    ] = MethodName.LM_GP,
    robot: RobotName = THE_TRIPOD,
    own_frame: Annotated[
        bool, typer.Option("--own-frame", help="The instrument has a frame of its own: find the base in it first.")
    ] = False,
    eta: Annotated[float, typer.Option(help="Weight of the orientation in the tip error [m/rad].")] = 0.1,
    prior: Annotated[
        float, typer.Option(help="Sigma of the parameters before any measurement, in units of their tolerances.")
    ] = 3.0,
    loss: Annotated[LossName, typer.Option(help="Robustness of the identification.")] = LossName.TUKEY,
    seed: Annotated[int, typer.Option(min=0, help="Seed: the same seed, the same files.")] = 0,
    tool_frame: ToolFrame = None,
    package_path: PackagePath = None,
    as_json: Json = False,
) -> None:
    """Calibrate a machine from a file of measurements: parameters, corrections, a calibrated URDF and a report."""
    from pm3dof_pin.calibration.calibrate import Options
    from pm3dof_pin.calibration.calibrate import calibrate as calibrated
    from pm3dof_pin.calibration.judging import can_be_judged, held_out_errors, workspace_errors
    from pm3dof_pin.calibration.results import REPORT, summary_of, write_calibration
    from pm3dof_pin.description.robots import find_robot
    from pm3dof_pin.figures.calibration_report import report_as_html
    from pm3dof_pin.measuring.measurement_file import read_measurements

    with _warnings_as_messages():
        errors = closing_errors(load_errors(robot, tool_frame, package_path))
        measurements = read_measurements(file, errors.robot, own_frame=own_frame)
        with progress_bar("calibrating") as progress:
            calibration = calibrated(measurements, errors, Options(method.value, seed, eta, prior, loss.value))
            progress(1, 4)
            held_out = held_out_errors(calibration) if can_be_judged(calibration) else None
            progress(2, 4)
            maps = workspace_errors(calibration)
            progress(3, 4)
            name = find_robot(robot).name
            report = report_as_html(calibration, name, held_out, maps)
            folder = write_calibration(calibration, robot, out, held_out, report)
            progress(4, 4)
    summary = summary_of(calibration, name, held_out)
    print_result({"directory": str(folder)} | summary, _lines(summary, measurements), as_json=as_json)
    message(f"wrote {folder}, report in {folder / REPORT}")


class _warnings_as_messages:  # noqa: N801 - used like a function
    """Warnings of the calibration become lines on standard error."""

    def __enter__(self) -> None:
        self._handler = logging.StreamHandler()
        self._handler.setFormatter(logging.Formatter("pm3dof: warning: %(message)s"))
        for room in _ROOMS:
            logging.getLogger(room).addHandler(self._handler)

    def __exit__(self, *_: object) -> None:
        for room in _ROOMS:
            logging.getLogger(room).removeHandler(self._handler)


def _lines(summary: dict[str, Any], measurements: Measurements) -> list[str]:
    lines = [f"{len(measurements)} measurements, method {summary['method']}"]
    held_out = summary.get("held_out")
    if held_out is None:
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
    rows = [
        [text, *(f"{1e6 * number:.1f}" for number in held_out[key].values())]
        for key, text in names.items()
        if key in held_out
    ]
    return [*lines, *table_lines(["held-out poses, tip error [µm]", "mean", "95 %", "max"], rows)]
