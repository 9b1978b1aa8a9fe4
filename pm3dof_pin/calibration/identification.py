"""Geometric parameters from measurements: weighted, robust, regularised nonlinear least squares.

Minimised is sum_k rho(|r_k|^2) + |p / (k tolerance)|^2 + |y / sigma|^2, with r_k the residual of measurement k to the
closed-loop forward kinematics, in units of its noise, p the machine's parameters and y those of the measurement set-up
(:mod:`pm3dof_pin.measuring.nuisances`): the instrument's frame, offsets of targets, drift. Gauss-Newton on the exact
Jacobians of :mod:`pm3dof_pin.errors.sensitivity`; in each step the robust linear problem
(:mod:`pm3dof_pin.calibration.linearisation`) is solved to convergence. Once the steps are small they stay at the
minimum found, so that a few outlying rows cannot make them alternate between two.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import scipy

from pm3dof_pin.arrays import frozen
from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.calibration.identifiability import REGRESSOR_TOLERANCE, Identifiability
from pm3dof_pin.calibration.linearisation import UNKNOWN, Linearisation, Loss, RobustFit
from pm3dof_pin.calibration.prior import PRIOR, Prior
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, tip_weights
from pm3dof_pin.errors.presets import nearly_free
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import Nuisances, seen_datum_map
from pm3dof_pin.typing import Array, Indices

PRIOR_DOMINATED = 0.9
"""A parameter whose standard deviation stays above this fraction of the prior's is dominated by the prior."""

ROUGHLY = 3e-2
"""A precision that no statistic of the residuals notices: it adds half a thousandth to their noise."""

_MAX_STEPS = 50
_SMALL_STEP = 1e-6  # change of the residuals by a step, in units of their sigma
_STUCK = 1e-4  # the same, for a step that only rounding keeps from shrinking further
_SLOW = 1e-2  # the same after many steps, still small against the noise
_SLOWLY = 0.1  # of the step before: not quadratic convergence, as where derivatives are approximate
_FARTHEST = 10.0  # times the last change of a solution, to extrapolate
_SECANTS = 6  # of so many steps
_INDEPENDENT = 1e-2  # relative size of changes that differ from each other by more than nonlinearity
_FEW = 3  # steps, in which quadratic convergence is nearly at its end
_NEAR = 1.0  # the same, below which the minimum is kept
_SEARCHING = 10  # many steps, after which the minimum is kept however long they are: with few rows, noise has two fits
_SMOOTH = 2.0  # times the noise: smooth effects of this size over the workspace do not stand out from it
_OF_MEDIAN = 1.4  # standard error of a variance by the median of squares, over that by their mean
_BELIEVED = 4.0  # weight of the tolerances' own value, as a number of parameters


@dataclass(frozen=True, eq=False)
class Identification:
    """Parameters identified from measurements, with their uncertainty."""

    errors: GeometricErrors  #: the parameters
    values: Array  #: p, shape=(number of parameters,) [m, rad]
    nuisances: Nuisances  #: other parameters of the measurements
    #: y, shape=(number of nuisance parameters,) [m, rad]; 0 for a frame, which becomes part of the registration of
    #: `measurements`
    nuisance_values: Array
    #: joint covariance of p, the logarithms of stiffness and y, given noise and prior. The noise is that of the
    #: residuals if larger than the sigmas say; the prior is one standard error of k wider
    joint_covariance: Array
    #: shifts of p, the logarithms of stiffness and y by effects that no parameter describes, as large as residuals show
    #: beyond the noise and chance, shape=(effects, parameters): predicted poses are as uncertain where nothing was seen
    beyond: Array
    #: standard deviation of each parameter with what the data cannot tell, shape=(number of parameters,) [m, rad]:
    #: larger than :attr:`data_sigmas` by the shift from smooth unmodelled effects that would be hidden in the noise.
    #: They falsify parameters, but not what was seen of the poses predicted from these
    sigmas: Array
    prior: Prior  #: of the parameters
    measurements: Measurements  #: the measurements, in the axes of the identified base
    settled: Measurements  #: the same, minus the effects of the nuisance parameters
    poses: Poses  #: of the calibrated machine at the commands
    residuals: Array  #: settled measurements minus calibrated machine, shape=(n, rows) [m, rad]
    weights: Array  #: robust weight of each measurement, 0 to 1, shape=(n,)
    #: the weights over the noise variance of each coordinate, normalised by those of good measurements, shape=(n, rows)
    certainties: Array
    #: ratio of the residuals' scatter to the sigmas, the same for all coordinates of a kind, at least 1,
    #: shape=(rows,)
    noise_factors: Array
    outliers: tuple[int, ...]  #: rows whose residual is not noise
    #: derivatives of the measured coordinates by all these parameters, in units of tolerances and noise, shape=(n,
    #: rows, parameters)
    rows: Array
    steps: int  #: Gauss-Newton steps taken
    elastic: ElasticTerm  #: the deflections under known wrenches; without unknowns if there are none
    stiffness_logarithms: Array  #: ln of each spring's stiffness over that of the description, shape=(springs,)

    @classmethod
    def from_fit(cls, problem: Linearisation, fit: RobustFit, loss: Loss, steps: int) -> Identification:
        """Return the results of a fit of a problem linearised at the solution; arguments as for :func:`identify`."""
        errors, factors = problem.errors, problem.kinds @ fit.noise_factors
        ends = np.cumsum([len(errors), len(problem.elastic.names)])
        values, logarithms, measuring = np.split(fit.x * problem.units, ends)
        certainties = problem.certainties(fit, loss)
        # the worst of many parameters must be within its bounds too: twice the error of k
        covariance, worst = problem.covariances(certainties, (problem.prior.error, 2.0 * problem.prior.error))
        hidden = problem.shifts(certainties, _SMOOTH * factors, covariance)
        variances = np.diag(worst) + np.sum(hidden**2, axis=0)
        # what residuals show beyond the noise and chance, shared by effects of all kinds, may as much be hidden in the
        # parameters
        seen = np.maximum(problem.kinds @ problem.dimensions.sum(axis=0), 1.0)
        excess = factors**2 * (1.0 - _OF_MEDIAN * np.sqrt(2.0 / seen)) - 1.0
        beyond = np.sqrt(np.maximum(excess, 0.0) / (1.0 + problem.measurements.commands.shape[1]))
        return cls(
            errors=errors,
            values=frozen(values),
            nuisances=problem.nuisances,
            nuisance_values=frozen(measuring),
            joint_covariance=frozen(covariance),
            beyond=frozen(problem.shifts(certainties, beyond, covariance)),
            sigmas=frozen(np.sqrt(variances[: len(errors)])),
            prior=problem.prior,
            measurements=problem.measurements,
            settled=problem.settled,
            poses=problem.poses,
            residuals=frozen(problem.residuals),
            weights=frozen(fit.weights),
            certainties=frozen(certainties),
            noise_factors=frozen(factors),
            outliers=tuple(problem.outliers(fit).tolist()),
            rows=frozen(problem.rows),
            steps=steps,
            elastic=problem.elastic,
            stiffness_logarithms=frozen(logarithms),
        )

    @property
    def stiffness_sigmas(self) -> Array:
        """Standard deviation of each logarithm of stiffness, shape=(springs,)."""
        return np.asarray(np.sqrt(np.diag(self.joint_covariance)[len(self.errors) : self._first_nuisance]))

    @property
    def stiffness(self) -> dict[str, tuple[float, float]]:
        """Each spring's stiffness over that of the description, and the standard deviation of the ratio's logarithm."""
        pairs = zip(np.exp(self.stiffness_logarithms).tolist(), self.stiffness_sigmas.tolist(), strict=True)
        return dict(zip(self.elastic.springs, pairs, strict=True))

    @property
    def stiffness_shares(self) -> dict[str, float]:
        """Share of the data in what is known of each spring: 1 minus its variance over the prior's, from 0 to 1."""
        shares = np.clip(1.0 - (self.stiffness_sigmas / self.elastic.sigmas) ** 2, 0.0, 1.0)
        return dict(zip(self.elastic.springs, shares.tolist(), strict=True))

    @property
    def data_sigmas(self) -> Array:
        """Standard deviation of each parameter by what the data say, given noise and prior, shape=(parameters,)."""
        return np.asarray(np.sqrt(np.diag(self.covariance)))

    @property
    def covariance(self) -> Array:
        """Covariance of p, shape=(number of parameters, number of parameters)."""
        return self.joint_covariance[: len(self.errors), : len(self.errors)]

    @property
    def seen_covariance(self) -> Array:
        """Covariance of p and, where nuisances define them, of base and tool, shape=(p or p + 12, same).

        See :func:`pm3dof_pin.measuring.nuisances.datum_motions`.
        """
        chosen = self.seen_map
        if not chosen[len(self.errors) :].any():
            beyond = self.beyond[:, : len(self.errors)]
            return np.asarray(self.covariance + beyond.T @ beyond)
        return np.asarray(chosen @ self.known_covariance @ chosen.T)

    @cached_property
    def seen_map(self) -> Array:
        """Map of all parameters to p, then to base and tool as nuisances define them, shape=(p + 12, parameters).

        The tool is as the points seen show it if it is known better so, over the measured poses: see
        :func:`pm3dof_pin.measuring.nuisances.seen_datum_map`.
        """
        count, datum = len(self.errors), self.nuisances.datum_map()
        if datum[6:].any() and np.isfinite(self.joint_covariance).all():
            poses = self.poses[self.measurements.first_rows]
            weights = tip_weights(TIP_LENGTH, self.errors.robot.tool_motions)
            own = np.r_[:count, self._first_nuisance : len(self.joint_covariance)]
            motions = sensitivities(self.errors, poses, self.values).errors
            covariance = self.known_covariance[np.ix_(own, own)]
            datum = seen_datum_map(self.nuisances, motions, poses, weights, covariance)
        chosen = np.zeros((count + 12, len(self.joint_covariance)))
        chosen[:count, :count] = np.eye(count)
        chosen[count:, self._first_nuisance :] = datum
        return frozen(chosen)

    @cached_property
    def known_covariance(self) -> Array:
        """The joint covariance with the shifts by what is beyond the noise, and without infinite variances.

        Undetermined parameters move nothing that was seen.
        """
        return np.asarray(self._finite_covariance + self.beyond.T @ self.beyond)

    @property
    def _finite_covariance(self) -> Array:
        return np.where(np.isfinite(self.joint_covariance), self.joint_covariance, 0.0)

    @property
    def _first_nuisance(self) -> int:
        return len(self.joint_covariance) - len(self.nuisances)

    @cached_property
    def units(self) -> Array:
        """The scales of all parameters, shape=(parameters,) [m, rad, 1]."""
        return np.concatenate([self.errors.tolerances, self.elastic.sigmas, self.nuisances.scales])

    @property
    def scaled_values(self) -> Array:
        """All parameters in units of their scales: p, the logarithms of stiffness, y."""
        return np.concatenate([self.values, self.stiffness_logarithms, self.nuisance_values]) / self.units

    @property
    def shrinkage(self) -> Array:
        """Standard deviation of each parameter relative to the prior's, shape=(parameters,)."""
        after = np.sqrt(np.diag(self.covariance))
        if np.isinf(self.prior.k):
            return np.asarray(np.isinf(after), dtype=float)
        return np.asarray(after / (self.prior.widening * self.prior.sigmas * self.errors.tolerances))

    @property
    def nuisance_sigmas(self) -> Array:
        """Standard deviation of each nuisance parameter, shape=(number of nuisance parameters,) [m, rad]."""
        return np.asarray(np.sqrt(np.diag(self.joint_covariance)[self._first_nuisance :]))

    def nuisance_covariance(self, kind: str) -> Array:
        """Return the covariance of the nuisance parameters of a kind, shape=(k, k) [m, rad]."""
        columns = self._first_nuisance + self.nuisances.columns(kind)
        return self.joint_covariance[np.ix_(columns, columns)]

    @property
    def noise_factor(self) -> float:
        """Ratio of the residuals' scatter to the sigmas, over all coordinates measured."""
        return float(np.sqrt(np.average(self.noise_factors**2, weights=self.measurements.seen.sum(axis=0))))

    @property
    def normalized_residuals(self) -> Array:
        """Residuals in units of the measurements' sigma, shape=(n, rows)."""
        return np.asarray(self.residuals / self.measurements.sigmas)

    @cached_property
    def expected_squares(self) -> Array:
        """Expected squares of the normalised residuals, reduced by what parameters absorb, shape=(n, rows).

        0 for coordinates that were not measured.
        """
        known = self._finite_covariance / np.outer(self.units, self.units)
        absorbed = np.einsum("nri,ij,nrj->nr", self.rows, known, self.rows, optimize=True) / self.noise_factors**2
        return np.asarray(np.where(self.measurements.seen, np.clip(1.0 - absorbed, 0.0, 1.0), 0.0))

    @property
    def trusted(self) -> Indices:
        """The rows that are not outliers."""
        return np.setdiff1d(np.arange(len(self.measurements)), self.outliers)

    @property
    def outlier_lines(self) -> tuple[int, ...]:
        """Lines of the file with outliers."""
        return tuple(self.measurements.lines[row] for row in self.outliers)

    @cached_property
    def identifiability(self) -> Identifiability:
        """Rank of the data given nuisance parameters without priors, and the combinations it leaves open."""
        names, _ = self.elastic.with_parameters(self.errors)
        rows = self.rows / self.noise_factors[:, None]
        return Identifiability.from_regressor(names, *np.split(rows, [len(names)], axis=2))

    @cached_property
    def prior_dominated(self) -> tuple[str, ...]:
        """Parameters and springs (`spring.ln_k`) that measurements hardly determine: they keep the prior's value."""
        names, _ = self.elastic.with_parameters(self.errors)
        dominated = np.concatenate([self.shrinkage, self.stiffness_sigmas / self.elastic.sigmas]) >= PRIOR_DOMINATED
        return tuple(name for name, flag in zip(names, dominated, strict=True) if flag)

    def linearised(self, measurements: Measurements) -> Linearisation:
        """Return other measurements of the session in this base, linearised at the identified parameters."""
        if measurements.registration is not None and self.measurements.registration is not None:
            measurements = measurements.registered_as(self.measurements.registration)
        robot = self.errors.robot
        poses = _poses_at(self.errors.apply(self.values), measurements, robot.forward(measurements.commands).q)
        elastic = self.elastic.of(measurements, robot)
        return Linearisation.at(
            measurements, self.errors, elastic, self.nuisances, self.prior, poses, self.scaled_values
        )

    def likely_prior(self) -> Prior:
        """Return the prior with the most likely k, the parts' typical error in units of tolerances, and its error.

        k maximises the likelihood of the measurements (D. MacKay, Neural Computation 4, 1992): k^2 = |x|^2 / g, with
        x the parameters in tolerances, identified with a generous prior, and g the effective number of them that the
        data determine. The tolerances' own value, k = 1, counts as much as some of these. k is at most that of the
        identification. The relative standard error of a standard deviation from so many is 1 / sqrt(2 (g + some)).
        """
        parts = self.prior.parts
        scaled = np.sqrt(self.weights)[:, None, None] / self.noise_factors[:, None]
        blocks = (scaled * self.rows[:, :, parts]).reshape(scaled.shape[0] * scaled.shape[1], len(parts))
        others = (scaled * np.delete(self.rows, parts, axis=2)).reshape(len(blocks), -1)
        if others.size:
            blocks = blocks - others @ np.linalg.lstsq(others, blocks, rcond=REGRESSOR_TOLERANCE)[0]
        values, axes = np.linalg.eigh(blocks.T @ blocks)
        values = np.maximum(values, 0.0)
        most = self.prior.k if np.isfinite(self.prior.k) else PRIOR
        k, effective = most, 0.0
        # the least-squares solution along each axis, from the one with the prior
        start = axes.T @ (self.values / self.errors.tolerances)[parts]
        pulled = start * (values + self.prior.k**-2.0)
        for _ in range(_MAX_STEPS):
            x = pulled / (values + 1.0 / k**2)
            effective = float(np.sum(values / (values + 1.0 / k**2)))
            previous, k = k, min(float(np.sqrt((np.sum(x**2) + _BELIEVED) / (effective + _BELIEVED))), most)
            if abs(k - previous) < 1e-3:
                break
        return replace(self.prior, k=k, error=float(1.0 / np.sqrt(2.0 * (effective + _BELIEVED))))

    def log_evidence(self, prior: Prior, rows: Indices) -> float:
        """Return the logarithm of the likelihood of some rows, averaged over all parameters by a prior.

        It is ln p(y) of y ~ N(0, F + A S A^T), with the noise F found, the derivatives A and the prior S, and that of
        k, for which the tolerances' own value counts as in :meth:`likely_prior`. Constants that depend on the
        measurements alone are left out: compare the same rows.
        """
        seen = self.measurements.seen[rows]
        noise = np.broadcast_to(self.noise_factors, seen.shape)[seen]
        scaled = self.rows[rows][seen] / noise[:, None]
        off = self.normalized_residuals[rows][seen] / noise + scaled @ self.scaled_values
        expected = prior.of_all(len(self.elastic.names), self.nuisances.sigmas)
        effects = scaled * np.minimum(expected, UNKNOWN)
        factor = np.linalg.cholesky(np.eye(effects.shape[1]) + effects.T @ effects)
        amounts = scipy.linalg.cho_solve((factor, True), effects.T @ off, check_finite=False)
        misfit = np.sum((off - effects @ amounts) ** 2) + np.sum(amounts**2)
        known = _BELIEVED * (np.log(prior.k) + 0.5 / prior.k**2) if np.isfinite(prior.k) else 0.0
        return float(-0.5 * misfit - np.sum(np.log(np.diag(factor))) - np.sum(np.log(noise)) - known)


def identify(
    measurements: Measurements,
    errors: GeometricErrors,
    *,
    prior: float = PRIOR,
    prior_error: float = 0.0,
    loss: Loss = "tukey",
    nuisances: Nuisances | None = None,
    start: Identification | None = None,
    precision: float = _SMALL_STEP,
) -> Identification:
    """Identify geometric parameters, and the stiffness of springs from measurements under known wrenches.

    Args:
        measurements: poses, positions or points.
        errors: the parameters, with their tolerances.
        prior: k, expected size of the parameters' errors in tolerances, but of nearly free ones; see
            :mod:`pm3dof_pin.calibration.prior`. If infinite, there is no prior: what is not identifiable stays at its
            nominal value, and its deviation is infinite.
        prior_error: relative standard error of k.
        loss: "squares", "huber", or "tukey" after Huber's.
        nuisances: other parameters of the measurements; by default those that they imply.
        start: an earlier identification from part of the same measurements, in the same axes, as a faster start.
        precision: change of the residuals at which to stop, in units of their sigma.

    Raises:
        InvalidValueError: there are no measurements or no parameters, or the prior is not positive.
        ConvergenceError: the parameters did not converge, or the loops do not close with them.
        SingularConfigurationError: at some command the tool can move with all drives locked.
    """
    if not len(measurements) or not len(errors):
        problem = f"{len(measurements)} measurements, {len(errors)} parameters"
        raise InvalidValueError("identification", problem, "at least one of each")
    expected = Prior(prior, nearly_free(errors), prior_error)
    if nuisances is None:
        nuisances = Nuisances.from_measurements(measurements, tuple(command.unit for command in errors.robot.commands))
    elastic = ElasticTerm.from_measurements(errors.robot, measurements)
    count = len(errors)
    frame = count + len(elastic.names) + nuisances.columns("frame")
    x, previous, fit = np.zeros(count + len(elastic.names) + len(nuisances)), np.inf, None
    poses = _poses_at(errors.robot, measurements)
    if start is not None:
        x = start.scaled_values
        poses = _poses_at(errors.apply(start.values), measurements, poses.q)
    solutions: list[Array] = []
    changes: list[Array] = []
    for step in range(1, _MAX_STEPS + 1):
        linear = Linearisation.at(measurements, errors, elastic, nuisances, expected, poses, x)
        fit = linear.robust(loss, fit if previous < _NEAR or step > _SEARCHING else None)
        change = linear.rows @ (fit.x - x)
        length = float(np.abs(change).max())
        stuck = _SLOW if step > _SEARCHING else _STUCK
        done = length <= precision or (length <= stuck and length >= 0.5 * previous)
        slowly = step > _FEW and length > _SLOWLY * previous and not frame.size
        solutions.append(fit.x)
        changes.append(change)
        x = fit.x if done or not slowly else _extrapolated(solutions[-_SECANTS:], changes[-_SECANTS:])
        if frame.size:
            # the frame found becomes part of the registration, so that it remains a small motion
            measurements = measurements.in_moved_base(x[frame] * linear.units[frame])
            x[frame] = 0.0
        poses = _poses_at(errors.apply(x[:count] * errors.tolerances), measurements, poses.q)
        if done:
            linear = Linearisation.at(measurements, errors, elastic, nuisances, expected, poses, x)
            return Identification.from_fit(linear, fit, loss, step)
        previous = length
    raise ConvergenceError(
        "identification", length, "sigmas", _MAX_STEPS, "use a prior; check that the measurements are of this machine"
    )


def _extrapolated(solutions: Sequence[Array], changes: Sequence[Array]) -> Array:
    """Return the secants' zero, given the last solutions and the changes of the residuals that led to them.

    D. Anderson, Journal of the ACM 12, 1965.
    """
    last = changes[-1].ravel()
    differences = np.stack([last - change.ravel() for change in changes[:-1]], axis=1)
    amounts = np.linalg.lstsq(differences, last, rcond=_INDEPENDENT)[0]
    amounts /= max(1.0, float(np.abs(amounts).sum()) / _FARTHEST)
    return np.asarray(solutions[-1] - (solutions[-1] - np.array(solutions[:-1])).T @ amounts)


def _poses_at(robot: Robot, measurements: Measurements, guess: Array | None = None) -> Poses:
    """Return the robot's poses at the commands of the rows, solving each distinct command once."""
    numbers = measurements.pose_numbers
    _, first = np.unique(numbers, return_index=True)
    solved = robot.forward(measurements.commands[first], guess=None if guess is None else guess[first])
    return solved[numbers]
