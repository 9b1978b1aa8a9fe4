"""Calibration from measurements to corrected commands: fit, evaluation, refusal of what would do harm, report."""

from __future__ import annotations

import contextlib
import logging
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import require_kind
from pm3dof_pin.calibration.assembled import assembled_rows
from pm3dof_pin.calibration.compensation import Compensated, Conditions
from pm3dof_pin.calibration.expectation import Expectation
from pm3dof_pin.calibration.fit import Fit, Method, fit, roughly
from pm3dof_pin.calibration.fit import Options as Options
from pm3dof_pin.calibration.folder import summary_of, write_calibration
from pm3dof_pin.calibration.heat import as_if_cold
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.refusals import doubts, likely_cause, refusals
from pm3dof_pin.calibration.workspace_errors import WorkspaceErrors
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.presets import with_free_zeros
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import (
    CalibrationRefusedError,
    ConvergenceError,
    InvalidValueError,
    PM3DofError,
    SingularConfigurationError,
    UnreachablePoseError,
    lines_in_words,
)
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.export_file import ColumnMap
from pm3dof_pin.measuring.measurement_file import TARGET_POINT_SIGMA, read_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import OnFailure

if TYPE_CHECKING:
    from matplotlib.figure import Figure

logger = logging.getLogger(__name__)

_FAILURES = (ConvergenceError, UnreachablePoseError, InvalidValueError, SingularConfigurationError)
_CLEARLY = float(np.log(20.0))  # logarithm of how much likelier rows are from which zeros are taken as unknown
_SAID = 0.02  # tolerances from which the zero of a drive is named
_WITHIN = 0.5  # least fraction of the validation poses within their bounds
_LISTED = 10  # parameters named in a warning


@dataclass(frozen=True, eq=False)
class Calibration(Fit):
    """A calibrated machine: what was fitted, how good it is, and what speaks against it."""

    held_out: HeldOut | None = None  #: cross-validation; None with too few poses
    validation: HeldOut | None = None  #: errors of separate measurements; None without any
    refusals: tuple[str, ...] = ()  #: why the calibration is refused, the likeliest cause last; none if it is accepted

    @cached_property
    def expectation(self) -> Expectation:
        """What to expect of the machine, what was not seen, and what to do next."""
        return Expectation.from_fit(self, self.held_out, self.validation)

    @cached_property
    def workspace_errors(self) -> WorkspaceErrors | None:
        """Tip errors before and after over two coordinates; None without two coordinates that have ranges."""
        return WorkspaceErrors.from_fit(self)

    def pictures(self) -> dict[str, Figure]:
        """Draw the pictures of the report, by file name."""
        from pm3dof_pin.calibration.report import calibration_pictures  # it loads matplotlib

        return calibration_pictures(self, self.held_out, self.workspace_errors, validation=self.validation)

    def report(self) -> str:
        """Return the report as one HTML page that holds its pictures; equal calibrations give equal bytes."""
        from pm3dof_pin.calibration.report import report_as_html  # it loads matplotlib

        return report_as_html(self, self.summary(), self.pictures(), self.workspace_errors)

    def summary(self) -> dict[str, Any]:
        """Return method and results as plain data, as in calibration.yaml; keys end in their unit."""
        return summary_of(self, self.held_out, self.validation, self.refusals, self.expectation)

    def save(self, directory: Path | str) -> Path:
        """Write summary, report, measurements, compensation and calibrated robot to a folder, and return the folder.

        The folder is replaced as a whole or not at all; see :mod:`pm3dof_pin.calibration.folder`.

        Raises:
            DescriptionError: the robot was not read from files.
            OutputError: the folder cannot be written, or it contains something other than a calibration.
        """
        return write_calibration(self, directory, self.summary(), self.report())

    def compensate(
        self,
        wanted: Poses | ArrayLike,
        conditions: Conditions | None = None,
        *,
        on_failure: OnFailure = "raise",
    ) -> Compensated:
        """Return the commands for desired poses of the tool.

        See :meth:`Compensation.compensate <pm3dof_pin.calibration.compensation.Compensation.compensate>`.
        """
        return self.compensation.compensate(wanted, conditions, on_failure=on_failure)


def calibrate(
    measurements: Measurements | Path | str,
    errors: GeometricErrors | Robot | Path | str,
    options: Options | Method | None = None,
    *,
    validation: Measurements | Path | str | None = None,
    on_refusal: Literal["raise", "keep"] = "raise",
    own_frame: bool = False,
    target_sigma: float = TARGET_POINT_SIGMA,
    tool_point_sigma: float = 0.0,
    columns: ColumnMap | Path | str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Calibration:
    """Calibrate a machine from measurements, judge the result, and refuse one that would be wrong for the machine.

    Parameters are identified and a correction learned (:func:`~pm3dof_pin.calibration.fit.fit`), then evaluated on
    measured poses held out in turn. Error parameters with which the loops cannot close are left out, and, where the fit
    fails, rows at which a machine out of tolerance cannot be assembled. If no error file says how well the drives'
    zeros are known, they are taken as unknown where that makes the measurements twenty times as likely, or where the
    result would be refused otherwise.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1)
        >>> machine = pm.SimulatedMachine.random(errors, generator, everything=False)
        >>> commands = pm.reachable_poses(errors.robot, 40, generator).commands
        >>> measurements = pm.Measurements.from_poses(commands, machine.measure(commands, generator))
        >>> calibration = pm.calibrate(measurements, errors, "lm")
        >>> calibration.refusals
        ()
        >>> calibration.identification.values.shape
        (40,)

    Args:
        measurements: poses, positions or points; or a file of them.
        errors: the error parameters with their tolerances, or a robot with those of its error file.
        options: method and settings; or the method alone.
        validation: separate measurements, or a file, to evaluate the calibration on; they are not fitted.
        on_refusal: "raise", or "keep" to return a refused calibration with its :attr:`~Calibration.refusals`.
        own_frame: for files: whether the instrument measured in its own frame.
        target_sigma: for files: standard deviation of the target positions, per coordinate [m]; 0 if known exactly.
        tool_point_sigma: for files: the same for the tool point, if that is the point seen [m].
        columns: for files: what they do not say of themselves; see :mod:`~pm3dof_pin.measuring.export_file`.
        progress: called with the number of steps done and the total.

    Raises:
        CalibrationRefusedError: the calibration is refused; or there can be none, whatever `on_refusal` is.
        MeasurementError: a file is unreadable or cannot be true.
        InvalidValueError: an argument of another kind.
    """
    options = Options(options) if isinstance(options, str) else options or Options()
    if on_refusal not in ("raise", "keep"):
        raise InvalidValueError("on_refusal", on_refusal, "raise or keep")
    errors = _errors_of(errors)
    undeclared = errors.parameters == all_parameters(errors.robot)
    errors, warnings = _closing(errors)

    def read(each: Measurements | Path | str, name: str) -> Measurements:
        if isinstance(each, (str, Path)):
            return read_measurements(
                each,
                errors.robot,
                own_frame=own_frame,
                target_sigma=target_sigma,
                tool_point_sigma=tool_point_sigma,
                columns=columns,
            )
        require_kind(name, each, Measurements, "pm.read_measurements")
        return each

    seen = as_if_cold(read(measurements, "measurements"), errors)
    others = None if validation is None else as_if_cold(read(validation, "validation"), errors)
    report_progress = progress or (lambda done, of: None)
    failure: PM3DofError | None = None
    try:
        fitted, held_out, against = _best_judged(seen, errors, options, undeclared=undeclared)
    except _FAILURES as error:
        failure = error
        if not isinstance(error, InvalidValueError) and not (kept := assembled_rows(seen, errors)).all():
            with contextlib.suppress(*_FAILURES):
                fitted, held_out, against = _best_judged(seen[kept], errors, options, undeclared=undeclared)
                lost = [line for line, is_kept in zip(seen.lines, kept, strict=True) if not is_kept]
                warnings.append(
                    f"{lines_in_words(lost)}left out: so near to a singular pose that machines out of tolerance "
                    "cannot be assembled there"
                )
                seen, failure = seen[kept], None
    if undeclared and failure is not None:
        other = _with_free_zeros(seen, errors, options)
        if other is not None and not other.against:
            (fitted, held_out, against), failure = other, None
    if failure is None and undeclared and (zeros := _zeros_in_words(fitted)):
        warnings.append(zeros)
    for warning in (*warnings, *(() if failure is not None else fitted.warnings)):
        logger.warning("%s", warning)
    if failure is not None:
        cause = likely_cause(seen, errors, options.eta)
        raise CalibrationRefusedError([str(failure), *filter(None, [cause])]) from failure
    report_progress(2, 4)
    if against:
        against += filter(None, [likely_cause(seen, errors, options.eta, fitted.identification)])
        if on_refusal == "raise":
            raise CalibrationRefusedError(against)
    further = [] if against else list(doubts(fitted, seen))
    if (scatter := fitted.compensation.scatter).long_tailed:
        further.append(
            "more poses than chance explains are far from where they should be: what is not explained counts "
            f"{scatter.tails:.1f} times in the 95 % bounds"
        )
    judged = None
    if others is not None:
        judged = HeldOut.from_validation(fitted, others)
        further += judged.notes
        if judged.within < _WITHIN:
            further.append(
                f"{100.0 * judged.within:.0f} % of the poses of {_name_of(validation)} are within their 95 % bounds: "
                "they may be from another machine or another state of it"
            )
    for warning in further:
        logger.warning("%s", warning)
    report_progress(3, 4)
    parts = {part.name: getattr(fitted, part.name) for part in fields(fitted)}
    parts["warnings"] = (*seen.warnings, *warnings, *fitted.warnings, *further)
    return Calibration(**parts, held_out=held_out, validation=judged, refusals=tuple(against))


class _Judged(NamedTuple):
    """A fit, judged."""

    fitted: Fit
    held_out: HeldOut | None  #: its cross-validation
    against: list[str]  #: what speaks against it


def _best_judged(seen: Measurements, errors: GeometricErrors, options: Options, *, undeclared: bool) -> _Judged:
    """Fit and judge; raises as :func:`fit`.

    With undeclared tolerances, nobody said that the drives are homed to absolute marks: their zeros are free if the
    measurements are more likely so by :data:`_CLEARLY`, or if something speaks against the fit otherwise.
    """
    if not undeclared:
        return _judged(fit(seen, errors, options, quiet=True))
    first, free = roughly(seen, errors, options), None
    with contextlib.suppress(*_FAILURES):
        free = roughly(seen, with_free_zeros(errors), options)
    likelier = free is not None and _odds(free, first, options) > _CLEARLY
    other = _with_free_zeros(seen, errors, options, free) if likelier else None
    if other is not None and not other.against:
        return other
    judged = _judged(fit(seen, errors, options, first=first, quiet=True))
    if judged.against and free is not None and not likelier:
        other = _with_free_zeros(seen, errors, options, free)
    return judged if other is None or other.against else other


def _odds(one: Identification, other: Identification, options: Options) -> float:
    """Return the logarithm of how much more likely one makes the rows that are outliers of neither."""
    rows = np.intersect1d(one.trusted, other.trusted)
    ours, theirs = (
        found.log_evidence(found.likely_prior() if options.prior is None else found.prior, rows)
        for found in (one, other)
    )
    return ours - theirs


def _with_free_zeros(
    seen: Measurements, errors: GeometricErrors, options: Options, first: Identification | None = None
) -> _Judged | None:
    """Fit with free zeros of the drives, and judge; None if that fails."""
    with contextlib.suppress(*_FAILURES):
        return _judged(fit(seen, with_free_zeros(errors), options, first=first, quiet=True))
    return None


def _judged(fitted: Fit) -> _Judged:
    held_out = HeldOut.from_cross_validation(fitted) if fitted.can_be_judged else None
    if held_out is not None:
        fitted = fitted.with_scatter(held_out.scatter)
    return _Judged(fitted, held_out, refusals(fitted, held_out))


def _zeros_in_words(fitted: Fit) -> str:
    """Name the zeros of drives that were free and are far off; "" if none was free."""
    found = fitted.identification
    zeros = [
        f"{name} {1e3 * value:.3g} m{parameter.unit}"
        for name, value, parameter in zip(found.errors.names, found.values, found.errors.parameters, strict=True)
        if parameter.group == "zeros" and abs(value) > _SAID * parameter.tolerance
    ]
    if all(parameter.group != "zeros" for parameter in found.errors.parameters):
        return ""
    return f"the zeros of the drives are far from the description, so they were taken as unknown: {', '.join(zeros)}"


def _errors_of(errors: GeometricErrors | Robot | Path | str) -> GeometricErrors:
    if isinstance(errors, (str, Path)):
        return GeometricErrors.load(errors)
    if isinstance(errors, Robot):
        file = None if errors.files is None else errors.files.errors
        return GeometricErrors(errors) if file is None else GeometricErrors.from_file(errors, file)
    require_kind("errors", errors, GeometricErrors, "pm.GeometricErrors.load")
    return errors


def _closing(errors: GeometricErrors) -> tuple[GeometricErrors, list[str]]:
    """Return the errors with which the loops can close, and a warning that names the others."""
    fitting = closable(errors)
    dropped = [name for name in errors.names if name not in fitting.names]
    if not dropped:
        return errors, []
    some = ", ".join(dropped[:_LISTED]) + (" ..." if len(dropped) > _LISTED else "")
    return fitting, [f"{len(dropped)} parameters are left out because the loops cannot close with them: {some}"]


def _name_of(validation: Measurements | Path | str | None) -> str:
    return "the validation" if isinstance(validation, Measurements) else str(validation)
