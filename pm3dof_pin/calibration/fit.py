"""The fit of a calibration to measurements, by one of five methods: identification first, then learning.

It trusts the measurements; :func:`pm3dof_pin.calibration.calibrate.calibrate` judges them and the result.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np

from pm3dof_pin.calibration.caution import Gain
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.identification import ROUGHLY, Identification, identify
from pm3dof_pin.calibration.learned_part import InputScale, LearnedPart, fitted_model
from pm3dof_pin.calibration.linearisation import Loss
from pm3dof_pin.calibration.prior import PRIOR
from pm3dof_pin.calibration.pseudo_error import control_inverse, motions_seen, pseudo_errors
from pm3dof_pin.calibration.scatter import Scatter
from pm3dof_pin.calibration.session_effects import SessionEffects
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements

logger = logging.getLogger(__name__)

Method = Literal["lm", "nn", "gp", "lm+nn", "lm+gp"]
METHODS: tuple[Method, ...] = get_args(Method)

MIN_POSES = 4
"""Fewest measurements to learn from."""

SMOOTH = 1.5
"""Noise factor from which the remaining errors are taken to vary smoothly over the poses instead of scattering."""


@dataclass(frozen=True)
class Options:
    """Options of a calibration."""

    #: "lm" (parameters, least squares), "nn" (neural network), "gp" (Gaussian process), or both
    method: Method = "lm+gp"
    seed: int = 0  #: random seed of networks and folds
    eta: float = TIP_LENGTH  #: weight of the orientation in the tip error [m/rad]
    #: prior standard deviation of the parameters but nearly free zeros of drives, in units of their tolerances; None
    #: for the value, up to 3, under which the measurements are most likely
    prior: float | None = None
    loss: Loss = "tukey"  #: loss of the identification

    def __post_init__(self) -> None:
        """Check the method."""
        if self.method not in METHODS:
            raise InvalidValueError("method", self.method, f"one of {', '.join(METHODS)}")

    @property
    def identifies(self) -> bool:
        """Whether the method identifies parameters."""
        return "lm" in self.method

    @property
    def learns(self) -> bool:
        """Whether the method learns a correction."""
        return self.method != "lm"


@dataclass(frozen=True, eq=False)
class Fit:
    """What was fitted to measurements: parameters, a learned part, and the compensation by both."""

    options: Options  #: options used, with the prior that was chosen
    measurements: Measurements  #: the measurements
    #: identified parameters; for methods without parameters, used only to find outliers
    identification: Identification
    compensation: Compensation  #: corrects the commands
    gain: Gain | None  #: gain of the corrections over the workspace; None for a method without parameters
    warnings: tuple[str, ...] = ()  #: what measurements and fit leave in doubt

    @property
    def chance_of_harm(self) -> float:
        """Probability that corrected commands are worse than uncorrected ones, given the identified parameters.

        See :mod:`pm3dof_pin.calibration.caution`. 0 for a method without parameters.
        """
        values = self.compensation.values
        return 0.0 if self.gain is None or values is None else self.gain.chance_of_harm(values)

    @property
    def part_corrected(self) -> float:
        """Fraction of the parameters' correction that is certain enough to be applied; 1 for all of it."""
        values = self.compensation.values
        return 1.0 if self.gain is None or values is None else self.gain.part(values)

    @property
    def scatters(self) -> bool:
        """Whether the remaining errors scatter from pose to pose: the noise factor is below :data:`SMOOTH`."""
        return self.identification.noise_factor < SMOOTH

    def tip_interval(self, wanted: Poses) -> tuple[float, float] | None:
        """Return :meth:`~pm3dof_pin.calibration.compensation.Compensation.rms_interval` if it :attr:`scatters`."""
        return self.compensation.rms_interval(wanted) if self.scatters else None

    @property
    def can_be_judged(self) -> bool:
        """Whether there are enough poses for a cross-validation, with enough to learn from in each fold."""
        return int(self.measurements[self.identification.trusted].pose_numbers.max(initial=-1)) > MIN_POSES

    def with_scatter(self, scatter: Scatter) -> Fit:
        """Return the calibration with the error scatter found by a cross-validation."""
        return replace(self, compensation=replace(self.compensation, scatter=scatter))


def fit(
    measurements: Measurements,
    errors: GeometricErrors,
    options: Options | None = None,
    *,
    first: Identification | None = None,
    quiet: bool = False,
) -> Fit:
    """Fit parameters and a learned part to measurements.

    Measurements that the identification rejects as outliers are not used for learning either.

    Args:
        measurements: poses, positions or points.
        errors: the parameters, with their tolerances.
        options: method and settings.
        first: what :func:`roughly` finds, if that is known.
        quiet: whether to return warnings without logging them.

    Raises:
        InvalidValueError: too few measurements, or measurements of another frame or machine.
        ConvergenceError: the parameters did not converge.
        SingularConfigurationError: at some command the tool can move with all drives locked.
    """
    options = options or Options()
    k, error = options.prior, 0.0
    if k is None:
        first = first or roughly(measurements, errors, options)
        likely = first.likely_prior()
        k, error = likely.k, likely.error
    shown = measurements if first is None else first.measurements
    identification = identify(shown, errors, prior=k, prior_error=error, loss=options.loss, start=first)
    options = replace(options, prior=identification.prior.k)
    shown = identification.settled[identification.trusted]
    nominal = errors.robot.forward(shown.visits.commands)
    warnings = (*_gaps(identification), *_unseen_motions(shown, nominal, options))
    for warning in () if quiet else warnings:
        logger.warning("%s", warning)
    used = identification if options.identifies else None
    gain = None if used is None else _gain(used, options.eta)
    compensation = compensation_from(shown, errors, options, used, gain)
    if options.identifies:
        shown = compensation.without_loads(shown)
    session = SessionEffects.from_identification(identification)
    compensation = replace(compensation, scatter=_scatter(compensation, shown, identification), session=session)
    return Fit(options, identification.measurements, identification, compensation, gain, warnings)


def roughly(measurements: Measurements, errors: GeometricErrors, options: Options) -> Identification:
    """Identify parameters to :data:`ROUGHLY`, with a generous prior unless one is given; raises as :func:`identify`."""
    prior = PRIOR if options.prior is None else options.prior
    return identify(measurements, errors, prior=prior, loss=options.loss, precision=ROUGHLY)


def _scatter(compensation: Compensation, shown: Measurements, identification: Identification) -> Scatter:
    """Return the noise-free scatter that remains in the calibration measurements.

    In the directions that drives correct, the learned part states its own uncertainty.
    """
    visits = shown.visits
    nominal = compensation.errors.robot.forward(visits.commands)
    model = compensation.model_poses(nominal)
    found, control = pseudo_errors(shown, model, compensation.eta), weighted_control(model, compensation.eta)
    units, counted = [command.unit for command in nominal.robot.commands], compensation.weights > 0.0
    if compensation.learned is not None:
        across = found.seen.shown - found.control @ control_inverse(found.control)
        covariances = across @ found.seen.covariances @ np.swapaxes(across, 1, 2)
        return Scatter.from_errors(found.left, covariances, across, np.zeros_like(control), units, counted=counted)
    used = float(len(identification.errors)) if compensation.values is not None else 0.0
    freedom = max(0.2, 1.0 - used / max(1.0, float(np.einsum("nii->", found.seen.shown))))
    seen = found.at_commands
    errors = seen.errors / np.sqrt(freedom)
    return Scatter.from_errors(errors, seen.covariances, seen.shown, control, units, counted=counted)


def compensation_from(
    measurements: Measurements,
    errors: GeometricErrors,
    options: Options,
    identification: Identification | None,
    gain: Gain | None = None,
    similar: LearnedPart | None = None,
) -> Compensation:
    """Combine identified parameters (None for the robot as described) with a part learned from measurements.

    The parameters' correction is reduced to what is certain enough: see :mod:`pm3dof_pin.calibration.caution`. Its gain
    is computed unless it is given. A learned part `similar` to that sought, of most of the same measurements, is where
    its search starts.

    Raises:
        InvalidValueError: too few measurements to learn from.
    """
    compensation = Compensation(errors, eta=options.eta)
    if identification is not None:
        whole = Compensation.from_identification(identification, options.eta)
        compensation = _cautious(whole, gain or _gain(identification, options.eta))
        measurements = compensation.without_loads(measurements)
    if not options.learns:
        return compensation
    visits = measurements.visits
    if len(visits) < MIN_POSES:
        expected = f"at least {MIN_POSES} to learn a pseudo-error from"
        raise InvalidValueError("measurements", problem=f"has {len(visits)} poses", expected=expected)
    nominal = errors.robot.forward(visits.commands)
    found = pseudo_errors(measurements, compensation.model_poses(nominal), options.eta)
    scale = InputScale.from_measurements(nominal.robot, visits)
    inputs = scale.scaled(visits.commands, visits.conditions)
    variances = np.einsum("nii->ni", found.covariances)
    start = similar.model if similar is not None and similar.inputs.conditions == scale.conditions else None
    model = fitted_model(options.method, inputs, found.deviations, variances, options.seed, start)
    return replace(compensation, learned=LearnedPart(model, scale))


def _unseen_motions(measurements: Measurements, nominal: Poses, options: Options) -> Iterator[str]:
    """Say which motions of the drives the measurements do not show."""
    seen, possible, whole = motions_seen(measurements, nominal, options.eta)
    if seen < possible and not measurements.joints:  # encoders show more, but of the tool only by the model
        advice = "" if measurements.measured == "pose" else ": measure poses, or targets away from the tool point"
        yield f"each measurement shows {seen} of the {possible} motions of the drives{advice}"
    if options.learns and measurements.points.any() and not whole:
        yield (
            "the targets do not show the full pose at every visit, so a learned correction is poor; use method lm, or "
            "three targets at each"
        )


def _gaps(identification: Identification) -> Iterator[str]:
    """Say that equations are missing, and which rows are outliers."""
    count, equations = len(identification.errors), int(identification.measurements.seen.sum())
    if equations < count:
        yield (
            f"{len(identification.measurements)} measurements give {equations} equations for {count} parameters, too "
            f"few: {identification.identifiability.identified} combinations are identified, the rest stay near their "
            "nominal values, within the tolerances"
        )
    if identification.outliers:
        yield f"outliers, not used for learning: lines {', '.join(map(str, identification.outlier_lines))}"


def _gain(found: Identification, eta: float) -> Gain:
    """Return the gain given noise and tolerances: what is beyond them was found to do no more harm."""
    known = replace(found, beyond=np.zeros_like(found.beyond))
    return Gain.from_compensation(Compensation.from_identification(known, eta))


def _cautious(compensation: Compensation, gain: Gain) -> Compensation:
    """Return a compensation reduced to what is certain enough.

    The rest stays uncertain: it is added to the covariance.
    """
    assert compensation.covariance is not None
    values = gain.sure_values()
    left_out = np.zeros(len(compensation.covariance))
    left_out[: len(values)] = gain.identified - values
    return replace(compensation, values=values, covariance=compensation.covariance + np.outer(left_out, left_out))
