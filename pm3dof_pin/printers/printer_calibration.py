"""Calibration of a delta printer from touches of its bed, in the parameters of its own firmware.

Of the firmware's sets of parameters that move nothing by more than a ruler would have missed, the smallest is taken
whose error at touches held out is within one standard error of the best one's (the rule of L. Breiman et al.,
Classification and Regression Trees, 1984). Heights determine the lengths of arms hardly: an error of all arms hides
behind radius and end stops, and the bow of a bed looks like one, with which prints would change their size. Distances
measured on a print tell them. Two of them or more are held out like touches, and all errors are compared in standard
deviations.

Changes are those of the numbers in the firmware. Each has two standard deviations: by what the touches say of the set
that was taken, as if all other numbers were exact, and by all of the firmware's parameters, the others known only as
well as by a ruler.
"""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import scipy

from pm3dof_pin.calibration.identifiability import Identifiability
from pm3dof_pin.calibration.identification import Identification, identify
from pm3dof_pin.calibration.linearisation import Loss
from pm3dof_pin.description.yaml_file import yaml_text
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import (
    CalibrationRefusedError,
    ConvergenceError,
    MeasurementError,
    OutputError,
    SingularConfigurationError,
    UnreachablePoseError,
)
from pm3dof_pin.files import read_text, replace_directory, write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.printers.bed_mesh import BedMesh
from pm3dof_pin.printers.delta_printer import DeltaPrinter
from pm3dof_pin.printers.firmware import FirmwareFile, read_firmware
from pm3dof_pin.printers.touches import Touches, are_clearly_smaller
from pm3dof_pin.typing import Array

_FOLDS = 10
_FAILURES = (ConvergenceError, SingularConfigurationError, UnreachablePoseError)
_RING = 24  # points
_ROBUST = 3  # touches a parameter from which outliers can be told
_OUTLIER = 6.0  # times the median size of held-out errors: one in 20,000 normal ones
_MISSED = 2.0  # tolerances, by which a number may be wrong unnoticed
_FEWEST = 4  # touches: those that tell three end stops and the radius
_CONTRADICTED = 2.0  # standard deviations by which distances are off
_IMPOSSIBLE = 6.0  # tolerances, by which no number is wrong
_UNEVEN = 20.0  # times the noise of a touch, more than any bed is uneven
_STEP = 1e-6  # of a difference quotient, in tolerances
_WRONG = "numbers, sizes of steps (microsteps, rotation_distance) or touches are wrong"
_PROBABILITIES = np.array([0.025, 0.975])
_SUMMARY = "calibration.yaml"


@dataclass(frozen=True, eq=False)
class Choice:
    """A set of the firmware's parameters, and its errors at touches and distances held out."""

    count: int  #: number of parameters
    loss: Loss  #: of the fits
    touches: Touches
    folds: Array  #: fold of each touch, then of each distance, shape=(touches + distances,)
    left_over: Array  #: measured minus predicted by each fit without a fold, shape=(folds, touches + distances) [m]

    @property
    def errors(self) -> Array:
        """Measured minus predicted of each touch and distance, fitted without it, shape=(touches + distances,) [m]."""
        return np.asarray(self.left_over[self.folds, np.arange(len(self.folds))])

    @property
    def held_out(self) -> Array:
        """The errors of touches, shape=(touches,) [m]."""
        return self.errors[: len(self.touches)]

    @property
    def mean_square(self) -> float:
        """Mean square of the errors of touches [m^2]."""
        return float(np.mean(self.held_out**2))

    @property
    def squares(self) -> Array:
        """Squared errors of touches, and of distances if there are two, in standard deviations."""
        return np.asarray((self.errors / self.touches.sigmas)[: _judged(self.touches)] ** 2)

    @property
    def score(self) -> float:
        """Mean of the squares, by which sets are compared."""
        return float(np.mean(self.squares))


@dataclass(frozen=True, eq=False)
class PrinterCalibration:
    """A calibrated printer."""

    file: FirmwareFile  #: the firmware's file
    before: DeltaPrinter  #: the printer as it was
    after: DeltaPrinter  #: the printer with identified parameters
    touches: Touches
    choices: tuple[Choice, ...]  #: the sets of parameters that were compared
    implausible: dict[int, tuple[str, ...]]  #: parameters that a set would move by more than a ruler misses
    chosen: Choice  #: the set that was taken
    identification: Identification
    identification_of_all: Identification  #: of the largest set that can be fitted
    errors_before: Array  #: heights and distances minus the old printer's, shape=(touches + distances,) [m]
    errors_after: Array  #: the same of the calibrated printer [m]
    mesh: BedMesh | None = None  #: what no parameter can express, if asked for and seen by the touches

    @property
    def heights_before(self) -> Array:
        """Touched heights minus those of the printer as it was, shape=(touches,) [m]."""
        return self.errors_before[: len(self.touches)]

    @property
    def heights_after(self) -> Array:
        """The same of the calibrated printer [m]."""
        return self.errors_after[: len(self.touches)]

    @property
    def held_out(self) -> Array:
        """Errors at touches held out, of the parameters taken and the mesh, if there is one, shape=(touches,) [m]."""
        return self.chosen.held_out if self.mesh is None else self.mesh.held_out

    @property
    def interval(self) -> tuple[float, float]:
        """Interval of the root mean square of the held-out errors, with a probability of 95 % [m]."""
        squares = self.held_out**2
        spread = float(np.var(squares) / len(squares))
        mean = float(np.mean(squares))
        freedom = 2.0 * mean**2 / max(spread, np.finfo(float).tiny)
        low, high = np.sqrt(mean * freedom / (2.0 * scipy.special.gammaincinv(0.5 * freedom, 1.0 - _PROBABILITIES)))
        return float(low), float(high)

    @property
    def distance_errors(self) -> dict[str, float]:
        """Errors of distances before and after, the latter held out if there are two, root mean square [m]."""
        own = len(self.touches)
        found = self.chosen.errors if _judged(self.touches) > own else self.errors_after
        return {"before": _rms(self.errors_before[own:]), "after": _rms(found[own:])}

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Combinations of all of the firmware's parameters that the touches do not determine."""
        return self.identification_of_all.identifiability.unidentified

    @property
    def touched_radius(self) -> float:
        """Distance of the farthest touch from the centre of the bed [m]."""
        return float(np.max(np.hypot(*_places(self.touches.travels, self.identification.errors.robot).T)))

    @property
    def print_scale(self) -> float:
        """Size of prints with the new numbers, relative to those with the old ones."""
        angles = np.linspace(0.0, 2.0 * np.pi, _RING, endpoint=False)
        outwards = np.column_stack([np.cos(angles), np.sin(angles)])
        radius = 0.5 * self.touched_radius
        travels = self.before.drives(np.column_stack([radius * outwards, np.zeros(_RING)])) - self.before.at_end_stops
        moved = _places(travels, self.identification.errors.apply(self.identification.values))
        return radius / float(np.mean(np.sum(outwards * moved, axis=1)))

    @property
    def gain(self) -> float:
        """Height errors of the printer as it was relative to held-out ones of the calibrated printer, rms."""
        return _rms(self.heights_before) / _rms(self.held_out)

    def summary(self) -> dict[str, Any]:
        """Return what was found as plain data; keys end in their unit."""
        return {
            "firmware": self.file.firmware,
            "touches": len(self.touches),
            "notes": list(self.file.notes),
            "touched_radius_m": self.touched_radius,
            "distances": len(self.touches.distances),
            "parameters_chosen": self.chosen.count,
            "held_out_rms_m": {str(choice.count): _rms(choice.held_out) for choice in self.choices},
            "height_error_before_rms_m": _rms(self.heights_before),
            "height_error_after_rms_m": _rms(self.heights_after),
            "height_error_held_out_rms_m": _rms(self.held_out),
            "height_error_held_out_95_percent_interval_m": list(self.interval),
            **({"distance_error_rms_m": self.distance_errors} if len(self.touches.distances) else {}),
            "bed_mesh": self.mesh is not None,
            "meshes_to_be_probed_again": [name for name in self.file.meshes if self.mesh is None or name != "default"],
            "gain": self.gain,
            "parameters_beyond_a_ruler": {str(count): list(names) for count, names in self.implausible.items()},
            "print_scale": self.print_scale,
            "not_determined": list(self.undetermined),
            "changes": self.changes,
            "printer": self.after.as_data(),
        }

    @property
    def changes(self) -> dict[str, dict[str, Any]]:
        """Return the change of each of the firmware's numbers that was taken, with both standard deviations."""
        found = self.identification
        names = found.errors.names
        values = self.after.numbers(names) - self.before.numbers(names)
        own, every = (self._sigmas(fit, names) for fit in (found, self.identification_of_all))
        units = ["rad" if name.startswith("angle") else "m" for name in names]
        return {
            name: {"value": value, "sigma_of_the_data": sigma, "sigma": max(sigma, whole), "unit": unit}
            for name, value, sigma, whole, unit in zip(
                names, values.tolist(), own.tolist(), every.tolist(), units, strict=True
            )
        }

    def _sigmas(self, fit: Identification, names: Sequence[str]) -> Array:
        """Return standard deviations of numbers of the firmware by those of a fit's parameters, shape=(names,)."""
        steps = np.diag(_STEP * fit.errors.tolerances)
        ends = [
            [self.before.displaced(fit.errors.named(fit.values + sign * step)).numbers(names) for step in steps]
            for sign in (1.0, -1.0)
        ]
        slopes = (np.array(ends[0]) - np.array(ends[1])) / (2.0 * np.diag(steps)[:, None])
        return np.asarray(np.sqrt(np.einsum("ij,ik,kj->j", slopes, fit.covariance, slopes)))

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
            write_text_atomically(folder / self.file.path.name, self.file.with_printer(self.after, self.mesh))
            text = yaml_text(self.summary())
            write_text_atomically(folder / _SUMMARY, text)
            for end, text in self.after.files(self.chosen.count).items():
                write_text_atomically(folder / "robot" / f"printer{end}", text)
        return Path(directory)


def calibrate_printer(
    path: Path | str, *, bed_mesh: bool = False, on_refusal: Literal["raise", "keep"] = "raise"
) -> PrinterCalibration:
    """Calibrate a delta printer from the file of its firmware.

    Args:
        path: Klipper's printer.cfg with saved touches or a bed mesh; a log of M665, M666 and touches of the bed of
            RepRapFirmware or Marlin; or RepRapFirmware's config.g or height map, each with the other beside it.
        bed_mesh: whether what no parameter can express becomes a bed mesh; Klipper only.
        on_refusal: "raise", or "keep" to return a calibration that does not predict touches clearly better than the
            printer's own numbers: these may have been fitted to the same touches.

    Raises:
        MeasurementError: the file has no delta printer, or no touches, or takes no bed mesh.
        CalibrationRefusedError: too few touches or in too small a part of the bed, no printer near the file's numbers
            fits them, or neither the result nor a mesh would be clearly better.
    """
    file = read_firmware(Path(path), read_text(Path(path)))
    if bed_mesh and not file.takes_mesh:
        raise MeasurementError(Path(path), f"a bed mesh is written for Klipper only, not for {file.firmware}")
    before = file.printer()
    touches = file.touches(before)
    least = before.counts[0]
    counted = _judged(touches) - len(touches)
    if len(touches) < (fewest := max(least + 1 - counted, _FEWEST)):
        seen = f"{len(touches)} touches" + (f" and {counted} distances" if counted else "")
        raise CalibrationRefusedError([f"{seen} for {least} parameters: touch at least {fewest} points"])
    sets = {count: _errors(before, count) for count in before.counts if count <= file.most_parameters}
    choices = [_held_out(touches, errors, count) for count, errors in sets.items()]
    fits: dict[int, Identification] = {}
    for choice in choices:
        with contextlib.suppress(*_FAILURES):
            fits[choice.count] = _fit(touches.measurements(), sets[choice.count], choice.loss)
    larger = {} if len(touches.distances) else {count: fit for count, fit in fits.items() if count > least}
    implausible = {count: names for count, fit in larger.items() if (names := _beyond_a_ruler(fit))}
    possible = [choice for choice in choices if choice.count in fits and choice.count not in implausible]
    best = min(possible, key=lambda choice: choice.score, default=None)
    if best is None or not np.isfinite(best.score):
        raise CalibrationRefusedError([f"no printer near these numbers fits the touches: {_WRONG}"])
    limit = best.score + float(np.std(best.squares) / np.sqrt(len(best.squares)))
    chosen = next(choice for choice in possible if choice.score <= limit)
    found = fits[chosen.count]
    after = before.displaced(found.errors.named(found.values))
    result = PrinterCalibration(
        file,
        before,
        after,
        touches,
        tuple(choices),
        implausible,
        chosen,
        found,
        fits[max(fits)],
        touches.errors(sets[least].robot),
        touches.errors(found.errors.apply(found.values)),
    )
    if bed_mesh:
        places = _places(touches.travels, found.errors.apply(found.values))
        folds = chosen.folds[: len(touches)]
        left_over = chosen.left_over[: folds.max() + 1, : len(touches)]
        mesh = BedMesh.fitted(places, -result.heights_after, -left_over, folds)
        result = replace(result, mesh=mesh)
    if on_refusal == "raise" and (reason := _refusal(result, fits[min(fits)])):
        raise CalibrationRefusedError([reason])
    return result


def _refusal(result: PrinterCalibration, smallest: Identification) -> str:
    """Say why a calibration is not to be taken: it is wrong, or not clearly better than the old numbers; "" if it is.

    Args:
        result: the calibration.
        smallest: the fit of the smallest set of parameters.
    """
    if _is_clearly_better(result):
        return _misfit(result) or _undetermined(smallest)
    own, new = (1e6 * _rms(values) for values in (result.heights_before, result.held_out))
    far = ""
    if _judged(result.touches) > len(result.touches):
        far = "; distances by {after:.0f} and {before:.0f} µm".format(
            **{name: 1e6 * value for name, value in result.distance_errors.items()}
        )
    text = f"touches held out would be off by {new:.0f} µm, and with the printer's own numbers by {own:.0f} µm{far}: "
    sizes = np.abs(result.heights_before)
    worst, usual = int(np.argmax(sizes)), float(np.median(sizes))
    if sizes[worst] > _OUTLIER * usual:
        return text + (
            f"with these, touch {worst}, counted from 0, is off by {1e3 * sizes[worst]:.3g} mm, and half of the "
            f"touches by at most {1e3 * usual:.2g} mm; it may be wrong"
        )
    return _misfit(result) or text + "it is calibrated as well as these touches tell"


def _is_clearly_better(result: PrinterCalibration) -> bool:
    """Tell whether all errors held out are smaller, or only those of distances that contradict the old numbers."""
    touches, judged = result.touches, _judged(result.touches)
    own, far = slice(len(touches)), slice(len(touches), judged)
    new = np.concatenate([result.held_out, result.chosen.errors[far]]) / touches.sigmas[:judged]
    old = result.errors_before[:judged] / touches.sigmas[:judged]
    if are_clearly_smaller(new, old):
        return True
    contradicts = judged > len(touches) and _rms(old[far]) > _CONTRADICTED
    return contradicts and are_clearly_smaller(new[far], old[far]) and not are_clearly_smaller(old[own], new[own])


def _misfit(result: PrinterCalibration) -> str:
    """Say in how far no printer near the file's numbers fits the touches; "" if one does."""
    found, rms = result.identification, _rms(result.heights_after)
    if found.noise_factor > _UNEVEN:
        return f"no printer near these numbers fits the touches, which it leaves off by {1e3 * rms:.2g} mm: {_WRONG}"
    far = np.abs(found.values) / found.errors.tolerances
    if far.max() <= _IMPOSSIBLE:
        return ""
    name = found.errors.names[int(np.argmax(far))]
    change = result.changes[name]
    unit, scale = ("mm", 1e3) if change["unit"] == "m" else ("degrees", np.degrees(1.0))
    return f"{name} would change by {scale * change['value']:+.3g} {unit}, more than any printer is off: {_WRONG}"


def _undetermined(fit: Identification) -> str:
    """Say what the touches do not determine, and why; "" if nothing."""
    if not (unseen := fit.identifiability.unidentified):
        return ""
    text = f"the touches do not determine {unseen[0]}: "
    if Identifiability.from_regressor(fit.errors.names, fit.rows[:, :, : len(fit.errors)]).unidentified:
        return text + "touch a wider part of the bed"
    return text + f"they scatter by {fit.noise_factor:.1f} times the noise of a probe about any printer"


def _errors(printer: DeltaPrinter, count: int) -> GeometricErrors:
    with tempfile.TemporaryDirectory() as folder:
        for end, text in printer.files(count).items():
            (Path(folder) / f"printer{end}").write_text(text, encoding="utf-8")
        return GeometricErrors.load(Path(folder) / "printer.urdf")


def _fit(measurements: Measurements, errors: GeometricErrors, loss: Loss) -> Identification:
    return identify(measurements, errors, prior=1.0, loss=loss)


def _beyond_a_ruler(fit: Identification) -> tuple[str, ...]:
    """Return the parameters that change by more than would have gone unnoticed."""
    sizes = np.abs(fit.values) / fit.errors.tolerances
    return tuple(fit.errors.names[k] for k in np.flatnonzero(sizes > _MISSED))


def _judged(touches: Touches) -> int:
    """Return how many errors count: those of touches, and of distances if one left out is told by another."""
    return len(touches) + (len(touches.distances) if len(touches.distances) > 1 else 0)


def _folds(touches: Touches) -> Array:
    """Return the fold of each touch and distance, -1 for a distance that is never held out; no fold has both."""
    generator, count = np.random.default_rng(0), len(touches)
    own = generator.permutation(np.arange(count) % min(_FOLDS, count))
    if (far := _judged(touches) - count) == 0:
        return np.concatenate([own, np.full(len(touches.distances), -1)])
    return np.concatenate([own, own.max() + 1 + generator.permutation(np.arange(far) % min(_FOLDS, far))])


def _held_out(touches: Touches, errors: GeometricErrors, count: int) -> Choice:
    """Return a set of parameters; fitted robustly if some touch is an outlier and others are then predicted better."""
    found = _with_loss(touches, errors, count, "squares")
    sizes = np.abs(found.held_out)
    if len(touches) < _ROBUST * len(errors) or sizes.max() < _OUTLIER * np.median(sizes):
        return found
    return min(found, _with_loss(touches, errors, count, "tukey"), key=lambda choice: choice.score)


def _with_loss(touches: Touches, errors: GeometricErrors, count: int, loss: Loss) -> Choice:
    folds = _folds(touches)
    left_over = np.full((int(folds.max()) + 1, len(folds)), np.inf)
    for fold in range(len(left_over)):
        with contextlib.suppress(*_FAILURES):
            found = _fit(touches.measurements(np.flatnonzero(folds != fold)), errors, loss)
            left_over[fold] = touches.errors(found.errors.apply(found.values))
    return Choice(count, loss, touches, folds, left_over)


def _places(travels: Array, robot: Robot) -> Array:
    return np.asarray(robot.forward(travels).positions[:, :2])


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))
