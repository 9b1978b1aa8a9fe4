"""Measurements linearised in all parameters, and the robust fit of the linear problem.

Reweighting after Holland and Welsch (1977): first with Huber's weights, which have one minimum, then from there with
Tukey's, which ignore gross outliers. Their scales are those of Huber's fit (V. Yohai's MM-estimates, 1987), so that
each reweighting lowers the same sum. Positions, angles and encoders each have their own scale: on some robots, drive
errors shift the tool but do not rotate it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import scipy

from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.calibration.identifiability import REGRESSOR_TOLERANCE
from pm3dof_pin.calibration.prior import Prior
from pm3dof_pin.errors.command_correction import command_jacobians, command_scales
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements, with_joints
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.typing import Array, Indices, Mask

Loss = Literal["squares", "huber", "tukey"]

UNKNOWN = 1e3
"""Prior standard deviation, in a parameter's scale, that is uninformative."""

_DAMPING = 1e-4  # (1 / 100 tolerances)^2: no linearisation is valid beyond that, if nothing else limits a step
_REWEIGHTINGS = 200
_USED_KNOWN = 5  # reweightings, after which the degrees of freedom that parameters use up hardly change
_SETTLED = 1e-6  # change of weights
_NEARLY_SETTLED = 1e-4  # the same while the problem changes too
_HUBER = 0.95  # fraction of good measurements with full weight
_TUKEY = 4.685 / 1.96  # cut of Tukey's weights over Huber's bend, as for one dimension
_FALSE_ALARM = 0.01  # probability of naming an outlier in a set of good measurements
_MIN_FREEDOM = 0.2  # of the measurements
_AT_ONCE = 512  # rows, to stay in cache
_FEW_WEIGHTED = 0.3  # of the measurements, for which those with other weights than 1 are subtracted
_LEVELS: Array = np.linspace(1.0 / 128.0, 127.0 / 128.0, 64)  # probabilities to average over


@dataclass(frozen=True, eq=False)
class RobustFit:
    """Solution of one robust linear problem."""

    x: Array  #: all parameters, in units of their scales
    weights: Array  #: of each measurement, 0 to 1, shape=(n,)
    noise_factors: Array  #: of each kind of coordinate, shape=(kinds,)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """Residuals as linear functions of all parameters: p, the logarithms of stiffness, nuisance parameters.

    Parameters are in units of their scales, residuals in units of the measurements' sigmas.
    """

    measurements: Measurements
    settled: Measurements  #: measurements minus the effects of the nuisance parameters
    errors: GeometricErrors
    elastic: ElasticTerm
    nuisances: Nuisances
    prior: Prior  #: of p
    poses: Poses  #: of the machine, for each row
    start: Array  #: the parameters there, shape=(parameters,)
    residuals: Array  #: measurements minus the machine's prediction, shape=(n, rows) [m, rad]
    rows: Array  #: derivatives of the measured coordinates by the parameters, scaled, shape=(n, rows, parameters)

    @classmethod
    def at(
        cls,
        measurements: Measurements,
        errors: GeometricErrors,
        elastic: ElasticTerm,
        nuisances: Nuisances,
        prior: Prior,
        poses: Poses,
        start: Array,
    ) -> Linearisation:
        """Linearise measurements about the parameters `start`, given the machine's poses there."""
        units = np.concatenate([errors.tolerances, elastic.sigmas, nuisances.scales])
        ends = np.cumsum([len(errors), len(elastic.names)])
        values, logarithms, measuring = np.split(start * units, ends)
        # each pose is computed once
        numbers = measurements.pose_numbers
        first = np.unique(numbers, return_index=True)[1]
        found = sensitivities(errors, poses[first], values, joints=tuple(measurements.joints))
        drives = tool_motions_by_drives(poses[first], found.commands)[numbers]
        loaded, by_stiffness = elastic.deflected(poses, logarithms)
        settled = nuisances.removed(measurements, loaded, drives, measuring)
        by_stiffness = with_joints(by_stiffness, len(measurements.joints))
        motions = [found.errors[numbers], by_stiffness, nuisances.motions(measurements, loaded, drives)]
        rows = settled.derivatives(loaded, np.concatenate(motions, axis=2))
        rows /= measurements.sigmas[:, :, None]
        rows *= units
        residuals = settled.residuals(loaded)
        return cls(measurements, settled, errors, elastic, nuisances, prior, poses, start, residuals, rows)

    def __getitem__(self, rows: Indices | Mask) -> Linearisation:
        """Return the problem restricted to some rows."""
        parts = {name: getattr(self, name)[rows] for name in ("measurements", "settled", "poses", "residuals", "rows")}
        return replace(self, **parts)

    @cached_property
    def units(self) -> Array:
        """The scales of the parameters, shape=(parameters,) [m, rad, 1]."""
        return np.concatenate([self.errors.tolerances, self.elastic.sigmas, self.nuisances.scales])

    @cached_property
    def sigmas(self) -> Array:
        """Prior standard deviations of the parameters, in their scales, shape=(parameters,)."""
        return self.prior.of_all(len(self.elastic.names), self.nuisances.sigmas)

    @cached_property
    def kinds(self) -> Array:
        """Masks of the residual columns by kind: positions, angles, and each encoder, shape=(rows, kinds)."""
        tool = np.repeat(np.arange(self.measurements.tool_columns // 3), 3)
        labels = np.concatenate([tool, len(tool) + np.arange(len(self.measurements.joints))])
        return np.asarray(labels[:, None] == np.unique(labels), dtype=float)

    @cached_property
    def dimensions(self) -> Array:
        """Number of measured coordinates of each kind, shape=(n, kinds)."""
        return np.asarray(self.measurements.seen @ self.kinds)

    def left_over(self, x: Array) -> Array:
        """Return the residuals at parameters x, in sigmas, shape=(n, rows)."""
        return np.asarray(self._targets - self.rows @ x)

    @cached_property
    def _targets(self) -> Array:
        return np.asarray(self.residuals / self.measurements.sigmas + self.rows @ self.start)

    def robust(self, loss: Loss, start: RobustFit | None) -> RobustFit:
        """Solve the problem by reweighting, from scratch or from a nearby fit, whose scale is then kept."""
        weights, factors = np.ones(len(self.rows)), np.ones(self.kinds.shape[1])
        if start is not None:
            weights, factors = start.weights, start.noise_factors
        x, dimensions = self._solve(weights, factors), self.dimensions.sum(axis=1)
        used, settled = np.zeros(0), _NEARLY_SETTLED if start is None else _SETTLED
        kinds = {"squares": ("squares",), "huber": ("huber",), "tukey": ("huber", "tukey")}[loss]
        for kind in kinds if start is None else kinds[-1:]:
            for step in range(_REWEIGHTINGS):
                last, last_factors = weights, factors
                squares = self.squares(x)
                if start is None and kind != "tukey":
                    used = self._used(factors) if step < _USED_KNOWN else used
                    factors = self.noise_factors(squares, used)
                weights = _weights(squares @ factors**-2.0, dimensions, kind)
                x = self._solve(weights, factors)
                if max(np.abs(weights - last).max(), np.abs(factors - last_factors).max()) < settled:
                    break
        return RobustFit(x, weights, factors)

    def squares(self, x: Array) -> Array:
        """Return |r_k|^2 of each kind of coordinate, shape=(n, kinds)."""
        return np.asarray(self.left_over(x) ** 2 @ self.kinds)

    def noise_factors(self, squares: Array, used: Array) -> Array:
        """Return the ratio of the residuals' scatter to their sigmas, at least 1; the median ignores outliers.

        Args:
            squares: of the residuals, shape=(n, kinds).
            used: degrees of freedom that the parameters use up, shape=(kinds,): less where the noise is larger.
        """
        factors = np.ones(len(used))
        for kind, (lost, own) in enumerate(zip(used, self.dimensions.T, strict=True)):
            if (seen := own > 0).any():
                median = np.median(squares[seen, kind] / _chi_square_quantile(0.5, own[seen]))
                freedom = max(_MIN_FREEDOM, 1.0 - lost / own.sum())
                factors[kind] = max(1.0, np.sqrt(median / freedom))
        return factors

    def certainties(self, fit: RobustFit, loss: Loss) -> Array:
        """Return a fit's weights over the noise variance, normalised by those of good rows, shape=(n, rows)."""
        usual = _usual_weights(self.dimensions.sum(axis=1), loss)
        return np.asarray((fit.weights / usual)[:, None] / (self.kinds @ fit.noise_factors) ** 2)

    def outliers(self, fit: RobustFit) -> Indices:
        """Return the rows whose residuals are not noise, shape=(k,)."""
        bound = _chi_square_quantile(1.0 - _FALSE_ALARM / len(self.rows), self.dimensions.sum(axis=1))
        return np.flatnonzero(self.squares(fit.x) @ fit.noise_factors**-2.0 > bound)

    def covariances(self, certainties: Array, prior_errors: Sequence[float]) -> list[Array]:
        """Return the covariance of all parameters for each relative error of the prior's k.

        Infinite for those that a singular information leaves undetermined.

        With the information I of the measurements and L of the prior, it is C = (I + L)^-1 = C I C + C L C. The second
        term is what was not measured; the error of k affects the part of it that k scales.
        """
        information = _information(self.rows, np.sqrt(certainties))
        unit = np.outer(self.units, self.units)
        if np.isfinite(self.prior.k):
            # as a square it stays positive semidefinite, which the inverse of hardly known parameters does not
            factor = np.linalg.cholesky(information + np.diag(1.0 / self.sigmas**2))
            root = scipy.linalg.solve_triangular(factor, np.eye(len(factor)), lower=True, check_finite=False)
            covariance = root.T @ root
            unmeasured = covariance[:, self.prior.parts] / self.prior.k
            widened = unmeasured @ unmeasured.T * unit
            return [covariance * unit + ((1.0 + error) ** 2 - 1.0) * widened for error in prior_errors]
        # a frame has no prior either, but it is always seen together with a known machine
        known_before = np.where(self.sigmas < UNKNOWN, 1.0 / self.sigmas**2, 0.0)
        values, axes = np.linalg.eigh(information + np.diag(known_before))
        known = values > (REGRESSOR_TOLERANCE**2 + np.finfo(float).eps) * 10.0 * values.max(initial=0.0)
        covariance = (axes[:, known] / values[known]) @ axes[:, known].T * unit
        unknown = np.flatnonzero(np.abs(axes[:, ~known]).max(axis=1, initial=0.0) > 1e-6)
        covariance[unknown, unknown] = np.inf
        return [np.asarray(covariance)] * len(prior_errors)

    def shifts(self, certainties: Array, sizes: Array, covariance: Array) -> Array:
        """Return the shifts of all parameters by effects that no parameter describes, shape=(effects, parameters).

        Each measured coordinate, of each target, may be off by its size, in units of its sigma, shape=(rows,), either
        constantly or in proportion to a command (one standard deviation over the measured ones).
        """
        commands = self.measurements.commands
        spread = commands.std(axis=0)
        moving = spread > 0.0
        varying = (commands - commands.mean(axis=0))[:, moving] / spread[moving]
        effects = np.column_stack([np.ones(len(commands)), varying])
        certain = (certainties * sizes)[:, :, None] * self.rows
        numbers, pulls = self.measurements.target_numbers, []
        for number in np.unique(numbers):
            own = numbers == number
            pulls.append(np.einsum("nb,ncq->bcq", effects[own], certain[own]).reshape(-1, len(self.units)))
        known = np.where(np.isfinite(covariance), covariance, 0.0)
        return np.asarray((np.concatenate(pulls) / self.units) @ known)

    def _used(self, factors: Array) -> Array:
        """Return the degrees of freedom that the parameters use up in each kind of coordinate, given noise factors."""
        if np.isinf(self.prior.k):
            rows = self.rows * np.minimum(self.sigmas, UNKNOWN)
            u, s, _ = np.linalg.svd(rows.reshape(-1, len(self.sigmas)), full_matrices=False)
            leverages = u**2 @ (s > REGRESSOR_TOLERANCE * s.max(initial=0.0))
            return np.asarray(leverages.reshape(self.rows.shape[:2]).sum(axis=0) @ self.kinds)
        if (gram := self._gram) is not None:
            noise = np.tile(self.kinds @ factors**2, len(self.rows))
            factor = scipy.linalg.cholesky(gram + np.diag(noise), lower=True, overwrite_a=True, check_finite=False)
            inverse, _ = scipy.linalg.lapack.dpotri(factor, lower=True, overwrite_c=True)
            leverages = 1.0 - noise * np.diag(inverse)
            return np.asarray(leverages.reshape(self.rows.shape[:2]).sum(axis=0) @ self.kinds)
        sigmas = np.minimum(self.sigmas, UNKNOWN)
        unit = np.outer(sigmas, sigmas)
        blocks = [own * (unit / factor**2) for own, factor in zip(self._informations, factors, strict=True)]
        inverse = np.linalg.inv(sum(blocks, np.eye(len(self.sigmas))))
        return np.array([np.sum(block * inverse) for block in blocks])

    @cached_property
    def _gram(self) -> Array | None:
        """Products of the rows with each other, in units of the prior; None unless there are fewer than parameters."""
        rows = (self.rows * np.minimum(self.sigmas, UNKNOWN)).reshape(-1, len(self.sigmas))
        return rows @ rows.T if len(rows) < len(self.sigmas) else None

    @cached_property
    def _informations(self) -> list[Array]:
        """The information of each kind of coordinate at the noise of its sigmas."""
        every = np.ones(self.rows.shape[:2])
        return [_information(self.rows[:, own], every[:, own]) for own in self.kinds.T > 0.0]

    def _weighted_information(self, weights: Array, factors: Array) -> Array:
        """Return the information of weighted measurements; of those whose weight is 1, most often, it is known."""
        less = np.flatnonzero(weights != 1.0)
        if len(less) > _FEW_WEIGHTED * len(weights):
            return _information(self.rows, np.sqrt(weights)[:, None] / (self.kinds @ factors))
        known = [own / factor**2 for own, factor in zip(self._informations, factors, strict=True)]
        excess = _information(self.rows[less], np.sqrt(1.0 - weights[less])[:, None] / (self.kinds @ factors))
        return np.asarray(np.sum(known, axis=0) - excess)

    @cached_property
    def _seen(self) -> tuple[Array, Array, Array | None]:
        """Rows and prior standard deviations of what can be seen, and its directions in the machine's parameters.

        With fewer measured coordinates than parameters, those that are not seen stay at zero: there are as many
        directions as coordinates, orthogonal in units of the prior, shape=(parameters, directions). Otherwise None.
        """
        rows, machine = self.rows.reshape(-1, len(self.sigmas)), len(self.errors) + len(self.elastic.names)
        if len(rows) >= machine:
            return rows, self.sigmas, None
        basis, triangle = np.linalg.qr((rows[:, :machine] * self.sigmas[:machine]).T)
        sigmas = np.concatenate([np.ones(basis.shape[1]), self.sigmas[machine:]])
        return np.hstack([triangle.T, rows[:, machine:]]), sigmas, basis

    def _solve(self, weights: Array, factors: Array) -> Array:
        scale, count = np.sqrt(weights)[:, None] / (self.kinds @ factors), self.rows.shape[2]
        if (self.sigmas < UNKNOWN).all() and self._gram is not None:
            # of fewer equations than parameters, all of which have a prior, weights scale rows and columns
            each = scale.ravel()
            matrix = self._gram * each * each[:, None]
            matrix.flat[:: len(each) + 1] += 1.0
            factor = scipy.linalg.cho_factor(matrix, overwrite_a=True, check_finite=False)
            found = each * scipy.linalg.cho_solve(factor, each * self._targets.ravel(), check_finite=False)
            return np.asarray(self.sigmas**2 * (found @ self.rows.reshape(-1, count)))
        if np.isfinite(self.prior.k):
            # with a prior the normal equations are well conditioned, and much faster to reweight
            rows, sigmas, basis = self._seen
            if basis is None:
                information = self._weighted_information(weights, factors)
            else:
                information = _information(rows[:, None], scale.reshape(-1, 1))
            information.flat[:: len(sigmas) + 1] += 1.0 / sigmas**2
            right = (scale**2 * self._targets).ravel() @ rows
            factor = scipy.linalg.cho_factor(information, overwrite_a=True, check_finite=False)
            found = np.asarray(scipy.linalg.cho_solve(factor, right, check_finite=False))
            if basis is None:
                return found
            seen = basis.shape[1]
            return np.concatenate([self.sigmas[: len(basis)] * (basis @ found[:seen]), found[seen:]])
        known_before = self.sigmas < UNKNOWN
        regularised = np.diag(np.where(known_before, 1.0 / self.sigmas, np.sqrt(_DAMPING)))
        matrix = np.concatenate([(scale[:, :, None] * self.rows).reshape(-1, count), regularised])
        right = np.concatenate([(scale * self._targets).ravel(), regularised @ np.where(known_before, 0.0, self.start)])
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=REGRESSOR_TOLERANCE)[0])


def _information(rows: Array, scale: Array) -> Array:
    """Return the information of rows, shape=(n, rows, parameters), times factors, shape=(n, rows)."""
    found = np.zeros((rows.shape[2], rows.shape[2]))
    for first in range(0, len(rows), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        scaled = (scale[part, :, None] * rows[part]).reshape(-1, rows.shape[2])
        found += scaled.T @ scaled
    return found


def tool_motions_by_drives(poses: Poses, commands: Array | None = None) -> Array:
    """Return the tool's motion by each drive's joint, positive as its counter, shape=(n, 6, commands)."""
    by_commands = command_jacobians(poses) if commands is None else commands
    return np.asarray(by_commands * np.abs(command_scales(poses)))


def _weights(squares: Array, dimensions: Indices, loss: str) -> Array:
    """Return the weights of squared normalised residuals, shape=(n,)."""
    if loss == "squares":
        return np.ones_like(squares)
    bend = _chi_square_quantile(_HUBER, dimensions)
    if loss == "huber":
        return np.asarray(np.sqrt(bend / np.maximum(squares, bend)))
    return np.asarray(np.clip(1.0 - squares / (_TUKEY**2 * bend), 0.0, None) ** 2)


def _usual_weights(dimensions: Indices, loss: str) -> Array:
    """Return the average weights of good measurements, by which their information is divided."""
    kinds, which = np.unique(dimensions, return_inverse=True)
    usual = [
        np.mean(_weights(_chi_square_quantile(_LEVELS, kind), np.full(_LEVELS.shape, kind), loss)) for kind in kinds
    ]
    return np.asarray(usual)[which]


def _chi_square_quantile(probability: float | Array, dimensions: Indices) -> Array:
    return np.asarray(2.0 * scipy.special.gammaincinv(0.5 * np.maximum(dimensions, 1), probability))
