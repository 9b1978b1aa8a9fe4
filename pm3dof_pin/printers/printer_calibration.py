"""Calibration of a delta printer from touches of its bed, in the parameters of its own firmware.

Of the firmware's sets of parameters the smallest is taken whose error at touches held out is within one standard error
of the best set's (the rule of L. Breiman et al., Classification and Regression Trees, 1984). Heights determine the
lengths of arms hardly: an error of all arms hides behind radius and end stops.
"""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy.special
import yaml

from pm3dof_pin.calibration.identification import Identification, identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import (
    CalibrationRefusedError,
    ConvergenceError,
    OutputError,
    SingularConfigurationError,
    UnreachablePoseError,
)
from pm3dof_pin.files import read_text, replace_directory, write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.printers.delta_printer import DeltaPrinter
from pm3dof_pin.printers.firmware import FirmwareFile, read_firmware
from pm3dof_pin.printers.touches import Touches
from pm3dof_pin.typing import Array

_FOLDS = 10
_FAILURES = (ConvergenceError, SingularConfigurationError, UnreachablePoseError)
_ROBUST = 3  # touches a parameter from which outliers are given less weight
_PROBABILITIES = np.array([0.025, 0.975])
_SUMMARY = "calibration.yaml"


@dataclass(frozen=True, eq=False)
class Choice:
    """A set of the firmware's parameters, and its errors at touches held out."""

    count: int  #: number of parameters
    held_out: Array  #: height minus prediction of each touch, fitted without it, shape=(touches,) [m]

    @property
    def mean_square(self) -> float:
        """Mean square of these errors [m^2]."""
        return float(np.mean(self.held_out**2))


@dataclass(frozen=True, eq=False)
class PrinterCalibration:
    """A calibrated printer."""

    file: FirmwareFile  #: the firmware's file
    before: DeltaPrinter  #: the printer as it was
    after: DeltaPrinter  #: the printer with identified parameters
    touches: Touches
    choices: tuple[Choice, ...]  #: the sets of parameters that were compared
    chosen: Choice  #: the set that was taken
    identification: Identification
    heights_before: Array  #: touched heights minus those of the printer as it was, shape=(touches,) [m]
    heights_after: Array  #: the same of the calibrated printer [m]
    undetermined: tuple[str, ...]  #: combinations of all of the firmware's parameters that the touches do not determine

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the root mean square of the held-out errors, with a probability of 95 % [m]."""
        squares = self.chosen.held_out**2
        spread = float(np.var(squares) / len(squares))
        mean = float(np.mean(squares))
        freedom = 2.0 * mean**2 / max(spread, np.finfo(float).tiny)
        low, high = np.sqrt(mean * freedom / (2.0 * scipy.special.gammaincinv(0.5 * freedom, 1.0 - _PROBABILITIES)))
        return float(low), float(high)

    @property
    def gain(self) -> float:
        """Height errors of the printer as it was relative to held-out ones of the calibrated printer, rms."""
        return _rms(self.heights_before) / _rms(self.chosen.held_out)

    def summary(self) -> dict[str, Any]:
        """Return what was found as plain data; keys end in their unit."""
        found = self.identification
        parameters = zip(found.errors.names, found.values, found.data_sigmas, found.errors.units, strict=True)
        return {
            "firmware": self.file.firmware,
            "touches": len(self.touches),
            "distances": len(self.touches.distances),
            "parameters_chosen": self.chosen.count,
            "held_out_rms_m": {str(choice.count): _rms(choice.held_out) for choice in self.choices},
            "height_error_before_rms_m": _rms(self.heights_before),
            "height_error_after_rms_m": _rms(self.heights_after),
            "height_error_held_out_rms_m": _rms(self.chosen.held_out),
            "height_error_held_out_95_percent_interval_m": list(self.interval),
            "gain": self.gain,
            "not_determined": list(self.undetermined),
            "changes": {
                name: {"value": float(value), "sigma_of_the_data": float(sigma), "unit": unit}
                for name, value, sigma, unit in parameters
            },
            "printer": self.after.as_data(),
        }

    def save(self, directory: Path | str) -> Path:
        """Write the firmware's file with the new numbers, a summary and the robot to a folder, and return the folder.

        Raises:
            OutputError: the folder cannot be written, holds something else, or is that of the printer's own file.
        """
        if Path(directory).resolve() == self.file.path.resolve().parent:
            raise OutputError(
                Path(directory), "holds the printer's own file, which is not replaced: choose another folder"
            )
        with replace_directory(directory, _SUMMARY) as folder:
            write_text_atomically(folder / self.file.path.name, self.file.with_printer(self.after))
            text = yaml.safe_dump(self.summary(), sort_keys=False, width=120, allow_unicode=True)
            write_text_atomically(folder / _SUMMARY, text)
            for end, text in self.after.files(self.chosen.count).items():
                write_text_atomically(folder / "robot" / f"printer{end}", text)
        return Path(directory)


def calibrate_printer(path: Path | str, *, on_refusal: Literal["raise", "keep"] = "raise") -> PrinterCalibration:
    """Calibrate a delta printer from the file of its firmware.

    Args:
        path: Klipper's printer.cfg with saved touches, or a log of M665, M666 and touches of the bed of RepRapFirmware
            or Marlin.
        on_refusal: "raise", or "keep" to return a calibration that does not predict touches better than the printer's
            own numbers: these may have been fitted to the same touches.

    Raises:
        MeasurementError: the file has no delta printer, or no touches.
        CalibrationRefusedError: too few touches, or the result would not be better.
    """
    file = read_firmware(Path(path), read_text(Path(path)))
    before = file.printer()
    touches = file.touches(before)
    least = before.counts[0]
    if len(touches) <= least:
        raise CalibrationRefusedError(
            [f"{len(touches)} touches for {least} parameters: touch at least {least + 1} points"]
        )
    sets = {count: _errors(before, count) for count in before.counts if count <= file.most_parameters}
    choices = [Choice(count, _held_out(touches, errors)) for count, errors in sets.items()]
    best = min(choices, key=lambda choice: choice.mean_square)
    if not np.isfinite(best.mean_square):
        cause = "no printer near these numbers fits the touches: numbers, sizes of steps or touches are wrong"
        raise CalibrationRefusedError([cause])
    limit = best.mean_square + float(np.std(best.held_out**2) / np.sqrt(len(touches)))
    chosen = next(choice for choice in choices if choice.mean_square <= limit)
    found = _fit(touches.measurements(), sets[chosen.count])
    after = before.displaced(found.errors.named(found.values))
    everything = sets[max(sets)]
    result = PrinterCalibration(
        file,
        before,
        after,
        touches,
        tuple(choices),
        chosen,
        found,
        touches.heights - _heights(touches, everything.robot),
        touches.heights - _heights(touches, found.errors.apply(found.values)),
        _fit(touches.measurements(), everything).identifiability.unidentified,
    )
    if not result.gain > 1.0 and on_refusal == "raise":
        own, new = (1e6 * _rms(values) for values in (result.heights_before, chosen.held_out))
        text = (
            f"touches held out would be off by {new:.2g} µm, and with the printer's own numbers by {own:.2g} µm: it is "
            "calibrated as well as these touches tell"
        )
        raise CalibrationRefusedError([text])
    return result


def _errors(printer: DeltaPrinter, count: int) -> GeometricErrors:
    with tempfile.TemporaryDirectory() as folder:
        for end, text in printer.files(count).items():
            (Path(folder) / f"printer{end}").write_text(text, encoding="utf-8")
        return GeometricErrors.load(Path(folder) / "printer.urdf")


def _fit(measurements: Measurements, errors: GeometricErrors) -> Identification:
    few = len(measurements) < _ROBUST * len(errors)  # too few to tell an outlier
    return identify(measurements, errors, prior=1.0, loss="squares" if few else "tukey")


def _held_out(touches: Touches, errors: GeometricErrors) -> Array:
    """Return the errors of touches predicted without them."""
    count = len(touches)
    folds = np.random.default_rng(0).permutation(np.arange(count) % min(_FOLDS, count))
    errors_at = np.zeros(count)
    for fold in range(int(folds.max()) + 1):
        shown, hidden = np.flatnonzero(folds != fold), np.flatnonzero(folds == fold)
        try:
            found = _fit(touches.measurements(shown), errors)
            reached = found.errors.apply(found.values).forward(touches.travels[hidden]).positions
            errors_at[hidden] = touches.heights[hidden] - reached[:, 2]
        except _FAILURES:
            errors_at[hidden] = np.inf
    return errors_at


def _heights(touches: Touches, robot: Robot) -> Array:
    return np.asarray(robot.forward(touches.travels).positions[:, 2])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
