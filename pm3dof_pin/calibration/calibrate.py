"""From measurements to a compensation, by one of five methods, and how good it is on poses it has not seen."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.gaussian_process import GaussianProcess
from pm3dof_pin.calibration.identification import PRIOR, Identification, Loss, identify, measured_residuals
from pm3dof_pin.calibration.measurements import Measurements
from pm3dof_pin.calibration.neural_network import NeuralNetwork
from pm3dof_pin.calibration.pseudo_error import (
    InputScale,
    PseudoErrorModel,
    control_inverse,
    pseudo_errors,
)
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, tip_weights
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array

logger = logging.getLogger(__name__)

Method = Literal["lm", "nn", "gp", "lm+nn", "lm+gp"]
METHODS: tuple[Method, ...] = get_args(Method)

LEAST_POSES = 4
"""Fewest measurements that anything is learned from."""

_FOLDS = 5
_SAME = 1e-9  # [m, rad], commands that differ by less are one pose
_FLOOR_SEEN = 1e-3  # of whole poses no direction is unseen, but near a singular pose none of use can be tiny


@dataclass(frozen=True)
class Options:
    """How to calibrate.

    Attributes:
        method: "lm" (parameters, least squares), "nn" (neural network), "gp" (Gaussian process), or both.
        seed: of networks and folds.
        eta: weight of the orientation in the tip error [m/rad].
        prior: standard deviation of the parameters beforehand, in units of their tolerances.
        loss: of the identification.
    """

    method: Method = "lm+gp"
    seed: int = 0
    eta: float = TIP_LENGTH
    prior: float = PRIOR
    loss: Loss = "tukey"

    def __post_init__(self) -> None:
        """Check the method.

        Raises:
            InvalidValueError: there is no such method.
        """
        if self.method not in METHODS:
            raise InvalidValueError("method", self.method, f"one of {', '.join(METHODS)}")


@dataclass(frozen=True, eq=False)
class Calibration:
    """A calibrated machine.

    Attributes:
        options: how it was calibrated.
        measurements: what was measured.
        identification: the parameters identified; by the methods without parameters for finding outliers only.
        compensation: what to command the machine by.
    """

    options: Options
    measurements: Measurements
    identification: Identification
    compensation: Compensation


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Errors at measured poses, predicted by calibrations that were not shown them. Outliers are left out.

    Attributes:
        rows: which measurements, shape=(n,).
        before: tip error of the machine as described, shape=(n,) [m].
        after: tip error with the corrected commands, the measurements' noise included, shape=(n,) [m].
        floor: tip error with the best commands, the measurements' noise included, shape=(n,) [m].
        noise: tip error that the measurements' noise amounts to, root mean square over its distribution, shape=(n,)
            [m].
        excess: by how much the corrected commands miss the best ones, root mean square over the joints, shape=(n,) [m,
            rad].
    """

    rows: NDArray[np.intp]
    before: Array
    after: Array
    floor: Array
    noise: Array
    excess: Array


def calibrate(measurements: Measurements, errors: GeometricErrors, options: Options | None = None) -> Calibration:
    """Calibrate a machine.

    Measurements that the identification names as outliers are shown to no learned model either.

    Args:
        measurements: poses, positions or points.
        errors: the parameters, with their tolerances.
        options: how.

    Raises:
        InvalidValueError: too few measurements, or those of another frame or machine.
        ConvergenceError: the parameters did not settle.
        SingularConfigurationError: at a command the tool can move with all commands held.
        MissingPackageError: a network is wanted and scikit-learn is not installed.
    """
    how = options or Options()
    identification = identify(measurements, errors, prior=how.prior, loss=how.loss)
    _warn(identification)
    nominal = errors.mechanism.forward(measurements.commands)
    compensation = Compensation(errors, eta=how.eta)
    if "lm" in how.method:
        compensation = replace(compensation, values=identification.values, covariance=identification.covariance)
    trusted = np.setdiff1d(np.arange(len(measurements)), identification.outliers)
    _check_seen(measurements[trusted], nominal[trusted], how)
    if how.method != "lm":
        compensation = _learned(compensation, measurements[trusted], nominal[trusted], how)
    unexplained = _unexplained(compensation, measurements[trusted], nominal[trusted])
    return Calibration(how, measurements, identification, replace(compensation, unexplained=unexplained))


def held_out_errors(calibration: Calibration) -> HeldOut:
    """Judge a calibration by cross-validation: the same method, shown four fifths of the poses at a time.

    Measurements at the same commands, of several targets or repeated, are hidden together.

    Args:
        calibration: what to judge.

    Raises:
        InvalidValueError: too few poses.
    """
    measurements, how = calibration.measurements, calibration.options
    errors = calibration.compensation.errors
    rows, poses = _trusted_poses(calibration)
    count = len(np.unique(poses))
    if count <= LEAST_POSES:
        raise InvalidValueError("measurements", f"{count} poses", f"more than {LEAST_POSES} for a cross-validation")
    nominal = errors.mechanism.forward(measurements.commands)
    predicted = np.zeros((len(rows), nominal.commands.shape[1]))
    folds = np.random.default_rng(how.seed).permutation(np.arange(count) % min(_FOLDS, count))[poses]
    for fold in range(int(folds.max()) + 1):
        shown, hidden = rows[folds != fold], rows[folds == fold]
        part = _quiet(measurements[shown], errors, how)
        conditions = {name: values[hidden] for name, values in measurements.conditions.items()}
        predicted[folds == fold] = part.deviations(nominal[hidden], conditions)
    return _judged(rows, measurements[rows], nominal[rows], predicted, how.eta)


def can_be_judged(calibration: Calibration) -> bool:
    """Tell whether there are enough poses for :func:`held_out_errors`, each part of them with enough to learn from."""
    return len(np.unique(_trusted_poses(calibration)[1])) > LEAST_POSES + 1


def _trusted_poses(calibration: Calibration) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the measurements that are no outliers, and the number of the pose of each, in order of appearance."""
    measurements = calibration.measurements
    rows = np.setdiff1d(np.arange(len(measurements)), calibration.identification.outliers)
    places = np.round(measurements.commands[rows] / _SAME)
    _, first, poses = np.unique(places, axis=0, return_index=True, return_inverse=True)
    return rows, np.argsort(np.argsort(first))[poses.reshape(-1)]


def _judged(
    rows: NDArray[np.intp], measurements: Measurements, nominal: Poses, predicted: Array, eta: float
) -> HeldOut:
    weights = tip_weights(eta)[: measurements.sigmas.shape[1]]
    true = pseudo_errors(measurements, nominal, eta)
    best = true.left
    if measurements.measured == "pose":
        best = pseudo_errors(measurements, nominal, eta, seen=_FLOOR_SEEN).left
    corrected = nominal.robot.forward(nominal.commands + predicted, guess=nominal.q)
    after = measured_residuals(measurements, corrected) * weights
    missed = np.einsum("nij,nj->ni", true.control, true.deviations - predicted)
    excess = np.einsum("nij,nj->ni", control_inverse(true.control), missed)  # what is not seen is not judged
    return HeldOut(
        rows,
        np.linalg.norm(true.before, axis=1),
        np.linalg.norm(after, axis=1),
        np.linalg.norm(best, axis=1),
        np.linalg.norm(measurements.sigmas * weights, axis=1),
        np.sqrt(np.mean(excess**2, axis=1)),
    )


def _quiet(measurements: Measurements, errors: GeometricErrors, how: Options) -> Compensation:
    """Return the compensation alone, without warnings about a part of the data."""
    compensation = Compensation(errors, eta=how.eta)
    if "lm" in how.method:
        found = identify(measurements, errors, prior=how.prior, loss=how.loss)
        compensation = replace(compensation, values=found.values, covariance=found.covariance)
    if how.method == "lm":
        return compensation
    return _learned(compensation, measurements, errors.mechanism.forward(measurements.commands), how)


def _learned(compensation: Compensation, measurements: Measurements, nominal: Poses, how: Options) -> Compensation:
    if len(measurements) < LEAST_POSES:
        raise InvalidValueError(
            "measurements", f"{len(measurements)} poses", f"at least {LEAST_POSES} to learn a pseudo-error from"
        )
    found = pseudo_errors(measurements, compensation.model_poses(nominal), how.eta)
    scale = InputScale.of(nominal.robot, measurements)
    inputs = scale.scaled(measurements.commands, measurements.conditions)
    noise = np.einsum("nii->ni", found.covariances)
    learned: PseudoErrorModel
    if "nn" in how.method:
        learned = NeuralNetwork.fit(inputs, found.deviations, how.seed)
    else:
        learned = GaussianProcess.fit(inputs, found.deviations, noise)
    return replace(compensation, learned=learned, inputs=scale)


def _unexplained(compensation: Compensation, measurements: Measurements, nominal: Poses) -> float:
    """Return the tip error that no command corrects and no parameter explains, root mean square without noise [m]."""
    found = pseudo_errors(measurements, compensation.model_poses(nominal), compensation.eta)
    n, rows = found.left.shape
    weights = tip_weights(compensation.eta)[:rows]
    noise = (measurements.sigmas * weights) ** 2
    across = np.eye(rows) - found.control @ control_inverse(found.control)
    expected = np.einsum("nii,ni->", across, noise)
    return float(np.sqrt(max(0.0, (np.sum(found.left**2) - expected) / n)))


def _check_seen(measurements: Measurements, nominal: Poses, how: Options) -> None:
    try:
        found = pseudo_errors(measurements, nominal, how.eta)
    except ConvergenceError as error:
        raise InvalidValueError(
            "measurements", f"seen where no commands bring the machine ({error})", "poses near those of the commands"
        ) from error
    seen = int(np.linalg.matrix_rank(control_inverse(found.control)).max())
    drives = found.control.shape[2]
    if seen < drives:
        advice = "" if measurements.measured == "pose" else ": measure poses, or targets off the tool point"
        logger.warning("a measurement shows %d of %d motions of the drives%s", seen, drives, advice)
    if how.method != "lm" and measurements.points.any():
        logger.warning("a single target shows no whole pose, so a learned correction is poor: method lm does better")


def _warn(identification: Identification) -> None:
    rank, names = identification.identifiability.rank, identification.errors.names
    if identification.identifiability.poses * identification.residuals.shape[1] < len(names):
        logger.warning(
            "%d measurements give %d equations for %d parameters: too few; %d combinations are identified, the rest "
            "keeps its nominal value as far as the tolerances allow",
            len(identification.measurements),
            identification.residuals.size,
            len(names),
            rank,
        )
    if identification.outliers:
        logger.warning(
            "outliers, left out of what is learned: lines %s", ", ".join(map(str, identification.outlier_lines))
        )
