"""Geometric parameters out of measurements: weighted, robust, regularised nonlinear least squares.

Minimised is sum_k rho(|r_k|^2) + |p / (k tolerance)|^2 + |y / sigma|^2, with r_k what measurement k lacks of the
closed-loop forward kinematics, in units of its noise, p the machine's parameters and y those of the measuring itself
(:mod:`pm3dof_pin.measuring.nuisances`): the instrument's frame, offsets of targets, drift. Gauss-Newton on the exact
Jacobians of :mod:`pm3dof_pin.errors.sensitivity`; in each step the robust linear problem is solved to its end by
reweighting (P. Holland and R. Welsch, 1977): first with Huber's weights, which have one minimum, then from there with
Tukey's, which leave gross outliers no say. Their scales are those of Huber's fit (V. Yohai's MM-estimates, 1987), so
that each reweighting lowers one sum; and once the steps are small they keep to the minimum found, lest few rows with
outliers make them change for ever between two. Positions, angles and encoders have each a scale of their own: drives
that miss move some robots' tools along and turn none of them.
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
from pm3dof_pin.calibration.identifiability import REGRESSOR_TOLERANCE, Identifiability, NamedUnknowns, identifiability
from pm3dof_pin.errors.command_correction import command_jacobians, command_scales
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements, with_joints
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.typing import Array, Indices

Loss = Literal["squares", "huber", "tukey"]

PRIOR = 3.0
"""k: standard deviation of the parameters before the measurements, in units of their tolerances."""

PRIOR_DOMINATED = 0.9
"""A parameter whose standard deviation stays above this part of what it was before is dominated by the prior."""

_MAX_STEPS = 50
_DAMPING = 1e-4  # (1 / 100 tolerances)^2: further than that no linearisation reaches, should nothing else hold a step
_SMALL_STEP = 1e-6  # what a step changes of the residuals, in units of their sigma
_STUCK = 1e-4  # a step that rounding alone keeps from falling further
_NEAR = 1.0  # sigma that a step changes of the residuals, from which on the minimum is kept
_REWEIGHTINGS = 200
_SETTLED = 1e-6  # change of weights
_HUBER = 0.95  # part of good measurements with full weight
_TUKEY = 4.685 / 1.96  # cut of Tukey's weights over Huber's bend, as for one dimension
_FALSE_ALARM = 0.01  # probability that a set of good measurements has an outlier named
_LEAST_FREEDOM = 0.2  # of the measurements
_BELIEVED = 4.0  # parameters off by their tolerance, as which the tolerances count
_SMOOTH = 2.0  # times the noise: effects that grow over the workspace to as much do not stand out of it
_LEVELS: Array = np.linspace(1.0 / 128.0, 127.0 / 128.0, 64)  # probabilities that a mean is taken over
UNKNOWN = 1e3  # standard deviation beforehand, in a parameter's scale, that says nothing


@dataclass(frozen=True, eq=False)
class Identification:
    """What measurements say about the parameters."""

    errors: GeometricErrors  #: the parameters
    values: Array  #: p, shape=(number of parameters,) [m, rad]
    nuisances: Nuisances  #: what the measurements depend on besides
    #: y, shape=(number of nuisance parameters,) [m, rad]; 0 for a frame, which has become part of the registration of
    #: `measurements`
    nuisance_values: Array
    #: of p, the logarithms of stiffness and y together, given noise and prior; the noise is what the residuals show
    #: where that is more than the sigmas say, the prior a standard error of k wider
    joint_covariance: Array
    #: standard deviation of each parameter as one of the machine's parts, shape=(number of parameters,) [m, rad]. More
    #: than the covariance says, by what a smooth effect of something else, hidden in the noise, would shift it: that
    #: makes parameters wrong, but not the poses that they predict
    sigmas: Array
    prior: float  #: k, standard deviation before the measurements in units of the tolerances; infinite for none
    prior_error: float  #: relative standard error of k
    measurements: Measurements  #: what was measured, in the axes of the base as identified
    settled: Measurements  #: the same without what the nuisance parameters explain
    poses: Poses  #: the calibrated machine's at the commands
    residuals: Array  #: settled measurements minus calibrated machine, shape=(n, rows) [m, rad]
    weights: Array  #: what robust weighting left of each measurement, 0 to 1, shape=(n,)
    #: the same over the variance of each coordinate's noise, on average as for good ones, shape=(n, rows)
    certainties: Array
    #: how many times larger than the sigmas say the residuals scatter, alike for all coordinates of a kind, at least 1,
    #: shape=(rows,)
    noise_factors: Array
    outliers: tuple[int, ...]  #: rows whose residual is no noise
    #: derivatives of what is seen by all of these, in units of the tolerances and of the noise, shape=(n, rows,
    #: parameters)
    rows: Array
    steps: int  #: Gauss-Newton steps taken
    elastic: ElasticTerm  #: the deflections under known wrenches; without unknowns where there were none
    stiffness_logarithms: Array  #: ln of how many times stiffer each spring is than described, shape=(springs,)
    stiffness_sigmas: Array  #: standard deviation of each, shape=(springs,)

    @property
    def stiffness(self) -> dict[str, tuple[float, float]]:
        """How many times stiffer each spring is than described, and the standard deviation of its logarithm."""
        pairs = zip(np.exp(self.stiffness_logarithms).tolist(), self.stiffness_sigmas.tolist(), strict=True)
        return dict(zip(self.elastic.springs, pairs, strict=True))

    @property
    def covariance(self) -> Array:
        """Covariance of p, shape=(number of parameters, number of parameters)."""
        return self.joint_covariance[: len(self.errors), : len(self.errors)]

    @property
    def seen_covariance(self) -> Array:
        """Covariance of p and, where nuisances define them, of base and tool, shape=(p or p + 12, same).

        See :func:`pm3dof_pin.measuring.nuisances.datum_motions`.
        """
        datum = self.nuisances.datum_map()
        if not datum.any():
            return self.covariance
        count, first = len(self.errors), len(self.joint_covariance) - len(self.nuisances)
        chosen = np.zeros((count + 12, len(self.joint_covariance)))
        chosen[:count, :count] = np.eye(count)
        chosen[count:, first:] = datum
        known = np.where(np.isfinite(self.joint_covariance), self.joint_covariance, 0.0)
        return np.asarray(chosen @ known @ chosen.T)

    @property
    def scaled_values(self) -> Array:
        """All parameters in units of their scales: p, the logarithms of stiffness, y."""
        parts = (self.values / self.errors.tolerances, self.stiffness_logarithms / self.elastic.sigmas)
        return np.concatenate([*parts, self.nuisance_values / self.nuisances.scales])

    @property
    def shrinkage(self) -> Array:
        """How uncertain each parameter is, as a part of what it was before the measurements, shape=(parameters,)."""
        after = np.sqrt(np.diag(self.covariance))
        if np.isinf(self.prior):
            return np.asarray(np.isinf(after), dtype=float)
        return np.asarray(after / ((1.0 + self.prior_error) * self.prior * self.errors.tolerances))

    @property
    def nuisance_sigmas(self) -> Array:
        """Standard deviation of each nuisance parameter, shape=(number of nuisance parameters,) [m, rad]."""
        first = len(self.joint_covariance) - len(self.nuisances)
        return np.asarray(np.sqrt(np.diag(self.joint_covariance)[first:]))

    @property
    def noise_factor(self) -> float:
        """How many times larger than the sigmas say the residuals scatter, over all coordinates measured."""
        return float(np.sqrt(np.average(self.noise_factors**2, weights=self.measurements.seen.sum(axis=0))))

    @property
    def normalized_residuals(self) -> Array:
        """Residuals in units of the measurements' sigma, shape=(n, rows)."""
        return np.asarray(self.residuals / self.measurements.sigmas)

    @cached_property
    def expected_squares(self) -> Array:
        """Squares of the normalised residuals to be expected by the sigmas and what parameters absorb, shape=(n, rows).

        0 for what was not measured.
        """
        units = np.concatenate([self.errors.tolerances, self.elastic.sigmas, self.nuisances.scales])
        known = np.where(np.isfinite(self.joint_covariance), self.joint_covariance, 0.0) / np.outer(units, units)
        absorbed = np.einsum("nri,ij,nrj->nr", self.rows, known, self.rows, optimize=True) / self.noise_factors**2
        return np.asarray(np.where(self.measurements.seen, np.clip(1.0 - absorbed, 0.0, 1.0), 0.0))

    @property
    def outlier_lines(self) -> tuple[int, ...]:
        """Lines of the file that are outliers."""
        return tuple(self.measurements.lines[row] for row in self.outliers)

    @cached_property
    def identifiability(self) -> Identifiability:
        """Rank of the data beside nuisance parameters of which nothing is known beforehand, and what it leaves open."""
        machine = self.rows.shape[2] - len(self.nuisances)
        scales = np.concatenate([self.errors.tolerances, self.elastic.sigmas])
        unknowns = NamedUnknowns((*self.errors.names, *self.elastic.names), scales)
        return identifiability(unknowns, self.rows[:, :, :machine], self.rows[:, :, machine:])

    @cached_property
    def prior_dominated(self) -> tuple[str, ...]:
        """Parameters about which the measurements say next to nothing by themselves: the prior's value stands."""
        dominated = self.shrinkage >= PRIOR_DOMINATED
        return tuple(name for name, flag in zip(self.errors.names, dominated, strict=True) if flag)

    def settle(self, measurements: Measurements) -> Measurements:
        """Return other measurements of the session in this base, without what the nuisance parameters explain."""
        if measurements.registration is not None and self.measurements.registration is not None:
            measurements = measurements.registered_as(self.measurements.registration)
        poses = _poses_at(
            self.errors.apply(self.values), measurements, self.errors.robot.forward(measurements.commands).q
        )
        drives = tool_motions_by_drives(poses)
        return self.nuisances.removed(measurements, poses, drives, self.nuisance_values)


def prior_from_data(found: Identification) -> tuple[float, float]:
    """Return how many tolerances k parameters are off in the mean, as the measurements have it, and its relative error.

    The k under which the measurements are most likely (D. MacKay, Neural Computation 4, 1992): k^2 = |x|^2 / g with x
    the parameters in tolerances, identified with a generous prior, and g the number of them that are told. The
    tolerances' own word, k = 1, counts as much as some parameters that are told. At most that of the identification.
    The relative standard error of a standard deviation from so many is 1 / sqrt(2 (g + some)).
    """
    count = len(found.errors)
    measuring = found.rows[:, :, count:]
    scaled = np.sqrt(found.weights)[:, None, None] / found.noise_factors[:, None]
    blocks = (scaled * found.rows[:, :, :count]).reshape(-1, count)
    if measuring.shape[2]:
        others = (scaled * measuring).reshape(len(blocks), -1)
        blocks = blocks - others @ np.linalg.lstsq(others, blocks, rcond=REGRESSOR_TOLERANCE)[0]
    values, axes = np.linalg.eigh(blocks.T @ blocks)
    values = np.maximum(values, 0.0)
    most = found.prior if np.isfinite(found.prior) else PRIOR
    k, told = most, 0.0
    # the least-squares solution along each axis, from that with the prior
    start = axes.T @ (found.values / found.errors.tolerances)
    pulled = start * (values + (0.0 if np.isinf(found.prior) else 1.0 / found.prior**2))
    for _ in range(_MAX_STEPS):
        x = pulled / (values + 1.0 / k**2)
        told = float(np.sum(values / (values + 1.0 / k**2)))
        previous, k = k, min(float(np.sqrt((np.sum(x**2) + _BELIEVED) / (told + _BELIEVED))), most)
        if abs(k - previous) < 1e-3:
            break
    return k, float(1.0 / np.sqrt(2.0 * (told + _BELIEVED)))


def identify(
    measurements: Measurements,
    errors: GeometricErrors,
    *,
    prior: float = PRIOR,
    prior_error: float = 0.0,
    loss: Loss = "tukey",
    nuisances: Nuisances | None = None,
    start: Identification | None = None,
) -> Identification:
    """Identify geometric parameters, and the stiffness of springs from measurements under known wrenches.

    Args:
        measurements: poses, positions or points.
        errors: the parameters, with their tolerances.
        prior: k, how many tolerances a parameter may be expected to be off. Infinite for no prior: then what cannot be
            told stays at its nominal value, and its deviation is infinite.
        prior_error: relative standard error of k.
        loss: "squares", "huber", or "tukey" after Huber's.
        nuisances: what the measurements depend on besides; by default what they say themselves.
        start: what others of the same measurements told, in the same axes, to be quicker.

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
    if nuisances is None:
        nuisances = Nuisances.of(measurements, tuple(command.unit for command in errors.robot.commands))
    elastic = ElasticTerm.of(errors.robot, measurements)
    count = len(errors)
    frame = count + len(elastic.names) + nuisances.columns("frame")
    x, previous, fit = np.zeros(count + len(elastic.names) + len(nuisances)), np.inf, None
    poses = _poses_at(errors.robot, measurements)
    if start is not None:
        x = start.scaled_values
        poses = _poses_at(errors.apply(start.values), measurements, poses.q)
    for step in range(1, _MAX_STEPS + 1):
        linear = _Linearised(measurements, errors, elastic, nuisances, poses, x, prior)
        fit = linear.robust(loss, fit if previous < _NEAR else None)
        length = float(np.abs(linear.rows @ (fit.x - x)).max())
        x = fit.x
        if frame.size:
            # the frame found becomes part of the registration, so that it never is more than a small motion
            measurements = measurements.in_moved_base(x[frame] * linear.units[frame])
            x[frame] = 0.0
        poses = _poses_at(errors.apply(x[:count] * errors.tolerances), measurements, poses.q)
        if length <= _SMALL_STEP or (length <= _STUCK and length >= 0.5 * previous):
            linear = _Linearised(measurements, errors, elastic, nuisances, poses, x, prior)
            return _result(linear, fit, loss, prior_error, step)
        previous = length
    raise ConvergenceError(
        "identification", length, "sigmas", _MAX_STEPS, "a prior helps, unless the measurements are of another machine"
    )


def tool_motions_by_drives(poses: Poses, commands: Array | None = None) -> Array:
    """Return the tool's motion by each drive's joint, in the direction its counter counts, shape=(n, 6, commands)."""
    by_commands = command_jacobians(poses) if commands is None else commands
    return np.asarray(by_commands * np.abs(command_scales(poses)))


def _poses_at(robot: Robot, measurements: Measurements, guess: Array | None = None) -> Poses:
    """Return the robot's poses at the commands of the rows, each different one solved once."""
    numbers = measurements.pose_numbers
    _, first = np.unique(numbers, return_index=True)
    solved = robot.forward(measurements.commands[first], guess=None if guess is None else guess[first])
    return solved[numbers]


@dataclass(frozen=True, eq=False)
class _Fit:
    """Solution of one robust linear problem."""

    x: Array
    weights: Array
    noise_factors: Array


class _Linearised:
    """The measurements' residuals as linear functions of all parameters, both in units of their deviations."""

    def __init__(
        self,
        measurements: Measurements,
        errors: GeometricErrors,
        elastic: ElasticTerm,
        nuisances: Nuisances,
        poses: Poses,
        x: Array,
        prior: float,
    ) -> None:
        self.measurements, self.errors, self.poses, self.prior = measurements, errors, poses, prior
        self.elastic, self.nuisances = elastic, nuisances
        self.units = np.concatenate([errors.tolerances, elastic.sigmas, nuisances.scales])
        self.ends = np.cumsum([len(errors), len(elastic.names)])
        values, logarithms, measuring = np.split(x * self.units, self.ends)
        machine, drives = _tool_motions(errors, measurements, poses, values)
        loaded, by_stiffness = elastic.deflected(poses, logarithms)
        self.settled = nuisances.removed(measurements, loaded, drives, measuring)
        by_stiffness = with_joints(by_stiffness, len(measurements.joints))
        motions = [machine, by_stiffness, nuisances.motions(measurements, loaded, drives)]
        self.residuals = self.settled.residuals(loaded)
        derivatives = self.settled.derivatives(loaded, np.concatenate(motions, axis=2))
        self.rows = derivatives / measurements.sigmas[:, :, None] * self.units
        self._start = x
        self._wanted = self.residuals / measurements.sigmas + self.rows @ x  # rows x = wanted - residual
        self._sigmas = np.concatenate([np.full(len(errors), prior), np.ones(len(elastic.names)), nuisances.sigmas])
        self._precisions = 1.0 / self._sigmas**2
        self.kinds = _kinds(measurements)
        self.dimensions = measurements.seen @ self.kinds

    def robust(self, loss: Loss, start: _Fit | None) -> _Fit:
        """Solve it by reweighting, from the first or from a fit nearby, whose scale then stands."""
        weights, factors = np.ones(len(self._wanted)), np.ones(self.kinds.shape[1])
        if start is not None:
            weights, factors = start.weights, start.noise_factors
        x, dimensions = self._solve(weights, factors), self.dimensions.sum(axis=1)
        kinds = {"squares": ("squares",), "huber": ("huber",), "tukey": ("huber", "tukey")}[loss]
        for kind in kinds if start is None else kinds[-1:]:
            for _ in range(_REWEIGHTINGS):
                last, last_factors = weights, factors
                squares = self.squares(x)
                if start is None and kind != "tukey":
                    factors = self.noise_factors(squares)
                weights = _weights(squares @ factors**-2.0, dimensions, kind)
                x = self._solve(weights, factors)
                if max(np.abs(weights - last).max(), np.abs(factors - last_factors).max()) < _SETTLED:
                    break
        return _Fit(x, weights, factors)

    def squares(self, x: Array) -> Array:
        """Return |r_k|^2 of each kind of coordinate, shape=(n, kinds)."""
        return np.asarray((self._wanted - self.rows @ x) ** 2 @ self.kinds)

    def noise_factors(self, squares: Array) -> Array:
        """Return how much residuals scatter beyond their sigmas, at least 1; the median is deaf to outliers."""
        factors = np.ones(len(self._used))
        for kind, (used, own) in enumerate(zip(self._used, self.dimensions.T, strict=True)):
            if (seen := own > 0).any():
                median = np.median(squares[seen, kind] / _chi_square_quantile(0.5, own[seen]))
                freedom = max(_LEAST_FREEDOM, 1.0 - used / own.sum())
                factors[kind] = max(1.0, np.sqrt(median / freedom))
        return factors

    def covariance(self, certainties: Array, prior_error: float) -> Array:
        """Return the covariance of all parameters; infinite for those that a singular information leaves open.

        With the information I and the knowledge L beforehand it is C = (I + L)^-1 = C I C + C L C, the second what
        nobody has measured; the prior's error is that of the parameters' part of it.
        """
        scaled = (np.sqrt(certainties)[:, :, None] * self.rows).reshape(-1, len(self.units))
        information = scaled.T @ scaled
        unit = np.outer(self.units, self.units)
        if np.isfinite(self.prior):
            covariance = np.linalg.inv(information + np.diag(self._precisions))
            unmeasured = covariance[:, : self.ends[0]] / self.prior
            wider = (1.0 + prior_error) ** 2 - 1.0
            return np.asarray((covariance + wider * unmeasured @ unmeasured.T) * unit)
        # of a frame nothing is known beforehand either, but it is always seen beside a machine that is known
        known_before = np.where(self._sigmas < UNKNOWN, self._precisions, 0.0)
        values, axes = np.linalg.eigh(information + np.diag(known_before))
        known = values > (REGRESSOR_TOLERANCE**2 + np.finfo(float).eps) * 10.0 * values.max(initial=0.0)
        covariance = (axes[:, known] / values[known]) @ axes[:, known].T * unit
        open_ones = np.flatnonzero(np.abs(axes[:, ~known]).max(axis=1, initial=0.0) > 1e-6)
        covariance[open_ones, open_ones] = np.inf
        return np.asarray(covariance)

    def hidden_shifts(self, certainties: Array, factors: Array, covariance: Array) -> Array:
        """Return what shifts parameters and no residual shows, root sum of squares, shape=(number of parameters,).

        A coordinate of what is measured, of each target, may be off by :data:`_SMOOTH` times its noise, alike
        everywhere or in proportion to a command (one standard deviation over the measured ones).
        """
        commands = self.measurements.commands
        spread = commands.std(axis=0)
        moving = spread > 0.0
        varying = (commands - commands.mean(axis=0))[:, moving] / spread[moving]
        effects = _SMOOTH * np.column_stack([np.ones(len(commands)), varying])
        certain = (certainties * factors)[:, :, None] * self.rows
        numbers, pulls = self.measurements.target_numbers, []
        for number in np.unique(numbers):
            own = numbers == number
            pulls.append(np.einsum("nb,ncq->bcq", effects[own], certain[own]).reshape(-1, len(self.units)))
        known = np.where(np.isfinite(covariance), covariance, 0.0)[: self.ends[0]]
        shifts = (np.concatenate(pulls) / self.units) @ known.T
        return np.asarray(np.sqrt(np.sum(shifts**2, axis=0)))

    @cached_property
    def _used(self) -> Array:
        """How many degrees of freedom the parameters take from each kind of coordinate."""
        sigmas = np.minimum(self._sigmas, UNKNOWN)
        if np.isinf(self.prior):
            u, s, _ = np.linalg.svd((self.rows * sigmas).reshape(-1, len(sigmas)), full_matrices=False)
            told = u**2 @ (s > REGRESSOR_TOLERANCE * s.max(initial=0.0))
            return np.asarray(told.reshape(self.rows.shape[:2]).sum(axis=0) @ self.kinds)
        blocks = self._blocks.sum(axis=0) * np.outer(sigmas, sigmas)
        return np.asarray(np.einsum("kij,ji->k", blocks, np.linalg.inv(blocks.sum(axis=0) + np.eye(len(sigmas)))))

    def _solve(self, weights: Array, factors: Array) -> Array:
        if np.isfinite(self.prior):
            # with a prior the normal equations are well conditioned, and many times quicker to weight again
            shares = weights[:, None] / factors**2
            information = np.tensordot(shares, self._blocks, 2) + np.diag(self._precisions)
            return np.asarray(scipy.linalg.solve(information, np.einsum("nk,njk->j", shares, self._pulls)))
        scale, count = np.sqrt(weights)[:, None] / (self.kinds @ factors), self.rows.shape[2]
        known_before = self._sigmas < UNKNOWN
        held = np.diag(np.where(known_before, 1.0 / self._sigmas, np.sqrt(_DAMPING)))
        matrix = np.concatenate([(scale[:, :, None] * self.rows).reshape(-1, count), held])
        right = np.concatenate([(scale * self._wanted).ravel(), held @ np.where(known_before, 0.0, self._start)])
        return np.asarray(np.linalg.lstsq(matrix, right, rcond=REGRESSOR_TOLERANCE)[0])

    @cached_property
    def _blocks(self) -> Array:
        """Information of each kind of coordinate of a measurement, shape=(n, kinds, parameters, parameters)."""
        parts = [self.rows[:, own] for own in self.kinds.T > 0.0]
        return np.stack([np.swapaxes(part, 1, 2) @ part for part in parts], axis=1)

    @cached_property
    def _pulls(self) -> Array:
        return np.asarray(np.swapaxes(self.rows * self._wanted[:, :, None], 1, 2) @ self.kinds)


def _tool_motions(errors: GeometricErrors, measurements: Measurements, poses: Poses, p: Array) -> tuple[Array, Array]:
    """Return the motion of tool and encoders by parameters and drives at each row, each pose computed once."""
    numbers = measurements.pose_numbers
    _, first = np.unique(numbers, return_index=True)
    found = sensitivities(errors, poses[first], p, joints=tuple(measurements.joints))
    return found.errors[numbers], tool_motions_by_drives(poses[first], found.commands)[numbers]


def _result(linear: _Linearised, fit: _Fit, loss: Loss, prior_error: float, steps: int) -> Identification:
    """Return what a fit says, given the problem linearised at its solution."""
    errors, measurements, count = linear.errors, linear.measurements, len(linear.errors)
    dimensions, factors = linear.dimensions.sum(axis=1), linear.kinds @ fit.noise_factors
    bound = _chi_square_quantile(1.0 - _FALSE_ALARM / len(measurements), dimensions)
    values = np.split(fit.x * linear.units, linear.ends)
    certainties = (fit.weights / _usual_weights(dimensions, loss))[:, None] / factors**2
    covariance = linear.covariance(certainties, prior_error)
    hidden = linear.hidden_shifts(certainties, factors, covariance)
    # of many parameters the worst has to be within its bounds too: twice the error of k
    variances = np.diag(linear.covariance(certainties, 2.0 * prior_error))[:count]
    machine = int(linear.ends[1])
    return Identification(
        errors=errors,
        values=frozen(values[0]),
        nuisances=linear.nuisances,
        nuisance_values=frozen(values[2]),
        joint_covariance=frozen(covariance),
        sigmas=frozen(np.sqrt(variances + hidden**2)),
        prior=linear.prior,
        prior_error=prior_error,
        measurements=measurements,
        settled=linear.settled,
        poses=linear.poses,
        residuals=frozen(linear.residuals),
        weights=frozen(fit.weights),
        certainties=frozen(certainties),
        noise_factors=frozen(factors),
        outliers=tuple(int(row) for row in np.flatnonzero(linear.squares(fit.x) @ fit.noise_factors**-2.0 > bound)),
        rows=frozen(linear.rows),
        steps=steps,
        elastic=linear.elastic,
        stiffness_logarithms=frozen(values[1]),
        stiffness_sigmas=frozen(np.sqrt(covariance.diagonal()[count:machine])),
    )


def _kinds(measurements: Measurements) -> Array:
    """Return which columns of residuals are positions, which angles, and which each encoder's, shape=(rows, kinds)."""
    tool = np.repeat(np.arange(measurements.tool_columns // 3), 3)
    labels = np.concatenate([tool, len(tool) + np.arange(len(measurements.joints))])
    return np.asarray(labels[:, None] == np.unique(labels), dtype=float)


def _weights(squares: Array, dimensions: Indices, loss: str) -> Array:
    """Return the weights of squared normalised residuals, shape=(n,)."""
    if loss == "squares":
        return np.ones_like(squares)
    bend = _chi_square_quantile(_HUBER, dimensions)
    if loss == "huber":
        return np.asarray(np.sqrt(bend / np.maximum(squares, bend)))
    return np.asarray(np.clip(1.0 - squares / (_TUKEY**2 * bend), 0.0, None) ** 2)


def _usual_weights(dimensions: Indices, loss: str) -> Array:
    """Return the weights that good measurements have on average: all of their information is worth as much more."""
    kinds, which = np.unique(dimensions, return_inverse=True)
    usual = [
        np.mean(_weights(_chi_square_quantile(_LEVELS, kind), np.full(_LEVELS.shape, kind), loss)) for kind in kinds
    ]
    return np.asarray(usual)[which]


def _chi_square_quantile(probability: float | Array, dimensions: Indices) -> Array:
    return np.asarray(2.0 * scipy.special.gammaincinv(0.5 * np.maximum(dimensions, 1), probability))
