"""Geometric parameters out of measurements: weighted, robust, regularised nonlinear least squares.

Minimised is sum_k rho(|r_k|^2) + |p / (k tolerance)|^2, with r_k what measurement k lacks of the closed-loop forward
kinematics, in units of its noise. Gauss-Newton on the exact Jacobians of :mod:`pm3dof_pin.errors.sensitivity`; in
each step the robust linear problem is solved to its end by reweighting (P. Holland and R. Welsch, 1977): first with
Huber's weights, which have one minimum, then from there with Tukey's, which leave gross outliers no say.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.special

from pm3dof_pin.arrays import frozen
from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.calibration.identifiability import RANK_TOLERANCE, Identifiability, NamedUnknowns, identifiability
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array

Loss = Literal["squares", "huber", "tukey"]

PRIOR = 3.0
"""k: standard deviation of the parameters before the measurements, in units of their tolerances, as in planning."""

PRIOR_DOMINATED = 0.9
"""A parameter whose standard deviation stays above this part of what it was before is dominated by the prior."""

_MAX_STEPS = 50
_DAMPING = 1e-4  # (1 / 100 tolerances)^2: further than that no linearisation reaches, should nothing else hold a step
_SMALL_STEP = 1e-8  # what a step changes of the residuals, in units of their sigma
_STUCK = 1e-4  # a step that rounding alone keeps from falling further
_REWEIGHTINGS = 200
_SETTLED = 1e-6  # change of weights
_HUBER = 0.95  # part of good measurements with full weight
_TUKEY = 4.685 / 1.96  # cut of Tukey's weights over Huber's bend, as for one dimension
_FALSE_ALARM = 0.01  # probability that a set of good measurements has an outlier named
_LEAST_FREEDOM = 0.2  # of the measurements


@dataclass(frozen=True, eq=False)
class Identification:
    """What measurements say about the parameters.

    Attributes:
        errors: the parameters.
        values: p, shape=(number of parameters,) [m, rad].
        covariance: of the values, given noise and prior; the noise is what the residuals show where that is more than
            the sigmas say, shape=(number of parameters, number of parameters).
        prior: k, standard deviation before the measurements in units of the tolerances; infinite for none.
        measurements: what was measured.
        poses: the calibrated machine's at the commands.
        residuals: measured minus calibrated machine, shape=(n, rows) [m, rad].
        weights: what robust weighting left of each measurement, 0 to 1, shape=(n,).
        noise_factor: how many times larger than the sigmas say the residuals scatter; at least 1 is assumed in the
            covariance.
        outliers: rows whose residual is no noise.
        identifiability: rank of the data and combinations that they say nothing about.
        steps: Gauss-Newton steps taken.
        elastic: the deflections under known wrenches; without unknowns where there were none.
        stiffness_logarithms: ln of how many times stiffer each spring is than described, shape=(springs,).
        stiffness_sigmas: standard deviation of each, shape=(springs,).
    """

    errors: GeometricErrors
    values: Array
    covariance: Array
    prior: float
    measurements: Measurements
    poses: Poses
    residuals: Array
    weights: Array
    noise_factor: float
    outliers: tuple[int, ...]
    identifiability: Identifiability
    steps: int
    elastic: ElasticTerm
    stiffness_logarithms: Array
    stiffness_sigmas: Array

    @property
    def stiffness(self) -> dict[str, tuple[float, float]]:
        """How many times stiffer each spring is than described, and the standard deviation of its logarithm."""
        pairs = zip(np.exp(self.stiffness_logarithms).tolist(), self.stiffness_sigmas.tolist(), strict=True)
        return dict(zip(self.elastic.springs, pairs, strict=True))

    @property
    def sigmas(self) -> Array:
        """Standard deviation of each parameter, shape=(number of parameters,) [m, rad]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def normalized_residuals(self) -> Array:
        """Residuals in units of the measurements' sigma, shape=(n, rows)."""
        return np.asarray(self.residuals / self.measurements.sigmas)

    @property
    def outlier_lines(self) -> tuple[int, ...]:
        """Lines of the file that are outliers."""
        return tuple(self.measurements.lines[row] for row in self.outliers)

    @cached_property
    def prior_dominated(self) -> tuple[str, ...]:
        """Parameters about which the measurements say next to nothing by themselves: the prior's value stands."""
        dominated = self.sigmas >= PRIOR_DOMINATED * self.prior * self.errors.tolerances
        return tuple(name for name, flag in zip(self.errors.names, dominated, strict=True) if flag)


def identify(
    measurements: Measurements,
    errors: GeometricErrors,
    *,
    prior: float = PRIOR,
    loss: Loss = "tukey",
) -> Identification:
    """Identify geometric parameters, and the stiffness of springs from measurements under known wrenches.

    Args:
        measurements: poses, positions or points.
        errors: the parameters, with their tolerances.
        prior: k, how many tolerances a parameter may be expected to be off. Infinite for no prior: then what cannot be
            told stays at its nominal value, and its deviation is infinite.
        loss: "squares", "huber", or "tukey" after Huber's.

    Raises:
        InvalidValueError: there are no measurements or no parameters, or the prior is not positive.
        ConvergenceError: the parameters did not settle, or the loops do not close with them.
        SingularConfigurationError: at a command the tool can move while all drives stand still.
    """
    if not len(measurements) or not len(errors):
        raise InvalidValueError(
            "identification", f"{len(measurements)} measurements, {len(errors)} parameters", "at least one of each"
        )
    if not prior > 0.0:
        raise InvalidValueError("prior", prior, "a positive multiple of the tolerances")
    elastic = ElasticTerm.of(errors.robot, measurements)
    x, previous = np.zeros(len(errors) + len(elastic.names)), np.inf
    poses = errors.robot.forward(measurements.commands)
    for step in range(1, _MAX_STEPS + 1):
        linear = _Linearised(measurements, errors, elastic, poses, x, prior)
        fit = linear.robust(loss)
        length = float(np.abs(linear.rows @ (fit.x - x)).max())
        x = fit.x
        poses = errors.apply(x[: len(errors)] * errors.tolerances).forward(measurements.commands, guess=poses.q)
        if length <= _SMALL_STEP or (length <= _STUCK and length >= 0.5 * previous):
            return _result(_Linearised(measurements, errors, elastic, poses, x, prior), fit, step)
        previous = length
    raise ConvergenceError(
        "identification", length, "sigmas", _MAX_STEPS, "a prior helps, unless the measurements are of another machine"
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Solution of one robust linear problem."""

    x: Array
    weights: Array
    noise_factor: float


class _Linearised:
    """The measurements' residuals as linear functions of the parameters, both in units of their deviations."""

    def __init__(
        self,
        measurements: Measurements,
        errors: GeometricErrors,
        elastic: ElasticTerm,
        poses: Poses,
        x: Array,
        prior: float,
    ) -> None:
        self.measurements, self.errors, self.elastic, self.poses = measurements, errors, elastic, poses
        self.prior = prior
        # the prior counts in tolerances of the geometry, and takes springs as they are
        springs = elastic.sigmas if np.isinf(prior) else elastic.sigmas / prior
        self.units = np.concatenate([errors.tolerances, springs])
        values, logarithms = np.split(x * self.units, [len(errors)])
        loaded = elastic.deflected(poses, logarithms)
        self.residuals = measurements.residuals(loaded)
        motions = [sensitivities(errors, poses, values).errors, elastic.derivatives(poses, logarithms)]
        derivatives = measurements.derivatives(loaded, np.concatenate(motions, axis=2))
        self.rows = derivatives / measurements.sigmas[:, :, None] * self.units
        self._start = x
        self._wanted = self.residuals / measurements.sigmas + self.rows @ x  # rows x = wanted - residual
        self._prior = 0.0 if np.isinf(prior) else 1.0 / prior
        self._count, self.dimension = self._wanted.shape

    def robust(self, loss: Loss) -> _Fit:
        weights, factor = np.ones(self._count), 1.0
        x = self._solve(weights, factor)
        for kind in {"squares": ("squares",), "huber": ("huber",), "tukey": ("huber", "tukey")}[loss]:
            for _ in range(_REWEIGHTINGS):
                last, last_factor = weights, factor
                squares = self.squares(x)
                factor = self.noise_factor(squares, weights)
                weights = _weights(squares / factor**2, self.dimension, kind)
                x = self._solve(weights, factor)
                if max(np.abs(weights - last).max(), abs(factor - last_factor)) < _SETTLED:
                    break
        return _Fit(x, weights, factor)

    def squares(self, x: Array) -> Array:
        """Return |r_k|^2, shape=(n,)."""
        return np.asarray(np.sum((self._wanted - self.rows @ x) ** 2, axis=1))

    def noise_factor(self, squares: Array, weights: Array) -> float:
        """Return how much the residuals scatter beyond their sigmas, at least 1; the median is deaf to outliers."""
        median = np.median(squares) / _chi_square_quantile(0.5, self.dimension)
        freedom = max(_LEAST_FREEDOM, 1.0 - self._used(weights) / (self._count * self.dimension))
        return float(max(1.0, np.sqrt(median / freedom)))

    def information(self, weights: Array, factor: float) -> Array:
        """Return the information on the parameters in units of the tolerances, without the prior."""
        return np.asarray(np.einsum("n,njk->jk", weights, self._blocks) / factor**2)

    @cached_property
    def _singular_values(self) -> Array:
        return np.asarray(np.linalg.svd(self.rows.reshape(-1, self.rows.shape[2]), compute_uv=False))

    def _used(self, weights: Array) -> float:
        """Return how many degrees of freedom the parameters take from the measurements."""
        s = self._singular_values
        s = s[s > RANK_TOLERANCE * s.max(initial=0.0)]
        return float(np.sum(s**2 / (s**2 + self._prior**2)))

    def _solve(self, weights: Array, factor: float) -> Array:
        if self._prior:
            # with a prior the normal equations are well conditioned, and many times quicker to weight again
            pull = np.einsum("n,nj->j", weights, self._pulls) / factor**2
            return np.asarray(scipy.linalg.solve(self.information(weights, factor) + self._prior_information, pull))
        scale, count = np.sqrt(weights) / factor, self.rows.shape[2]
        damping = np.sqrt(_DAMPING) * np.eye(count)
        matrix = np.concatenate([(scale[:, None, None] * self.rows).reshape(-1, count), damping])
        right = np.concatenate([(scale[:, None] * self._wanted).ravel(), damping @ self._start])
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=RANK_TOLERANCE)[0])

    @cached_property
    def _blocks(self) -> Array:
        """Information of each measurement, shape=(n, parameters, parameters)."""
        return np.asarray(np.swapaxes(self.rows, 1, 2) @ self.rows)

    @cached_property
    def _pulls(self) -> Array:
        return np.asarray(np.einsum("nij,ni->nj", self.rows, self._wanted))

    @cached_property
    def _prior_information(self) -> Array:
        return self._prior**2 * np.eye(self.rows.shape[2])


def _result(linear: _Linearised, fit: _Fit, steps: int) -> Identification:
    """Return what a fit says, given the problem linearised at its solution."""
    errors, measurements, count = linear.errors, linear.measurements, len(linear.errors)
    bound = _chi_square_quantile(1.0 - _FALSE_ALARM / len(measurements), linear.dimension) * fit.noise_factor**2
    information = linear.information(fit.weights, fit.noise_factor)
    values, covariance = fit.x * linear.units, _covariance(information, linear.prior, linear.units)
    unknowns = NamedUnknowns((*errors.names, *linear.elastic.names), linear.units)
    return Identification(
        errors=errors,
        values=frozen(values[:count]),
        covariance=frozen(covariance[:count, :count]),
        prior=linear.prior,
        measurements=measurements,
        poses=linear.poses,
        residuals=frozen(linear.residuals),
        weights=frozen(fit.weights),
        noise_factor=fit.noise_factor,
        outliers=tuple(int(row) for row in np.flatnonzero(linear.squares(fit.x) > bound)),
        identifiability=identifiability(unknowns, linear.rows),
        steps=steps,
        elastic=linear.elastic,
        stiffness_logarithms=frozen(values[count:]),
        stiffness_sigmas=frozen(np.sqrt(covariance.diagonal()[count:])),
    )


def _covariance(information: Array, prior: float, tolerances: Array) -> Array:
    """Return the covariance of the parameters; infinite for those that a singular information leaves open."""
    scale = np.outer(tolerances, tolerances)
    if np.isfinite(prior):
        return np.asarray(np.linalg.inv(information + np.eye(len(tolerances)) / prior**2) * scale)
    values, axes = np.linalg.eigh(information)
    known = values > (RANK_TOLERANCE**2 + np.finfo(float).eps) * 10.0 * values.max(initial=0.0)
    covariance = (axes[:, known] / values[known]) @ axes[:, known].T * scale
    open_ones = np.flatnonzero(np.abs(axes[:, ~known]).max(axis=1, initial=0.0) > 1e-6)
    covariance[open_ones, open_ones] = np.inf
    return np.asarray(covariance)


def _weights(squares: Array, dimension: int, loss: str) -> Array:
    """Return the weights of squared normalised residuals, shape=(n,)."""
    if loss == "squares":
        return np.ones_like(squares)
    bend = _chi_square_quantile(_HUBER, dimension)
    if loss == "huber":
        return np.asarray(np.sqrt(bend / np.maximum(squares, bend)))
    return np.asarray(np.clip(1.0 - squares / (_TUKEY**2 * bend), 0.0, None) ** 2)


def _chi_square_quantile(probability: float, dimension: int) -> float:
    return float(2.0 * scipy.special.gammaincinv(0.5 * dimension, probability))
