"""Choice of poses to measure: for parameters, for learning, or in the least sensitive region (the chapter's rule).

With the scaled regressor blocks A_j of the measured poses j, and parameters with prior standard deviations of k
times their tolerances,

    M = 1 / k^2 + sum_j A_j^T A_j

is the information in units of the tolerances, regular for any number of poses, and M^-1 the covariance afterwards.
k = 3 by default: machines are found out of tolerance, and a plan should rely on measurements. D-optimal poses
maximise det M (V. Fedorov, Theory of Optimal Experiments, 1972, here with a prior); tip-optimal ones minimise the
predicted tip error over test poses, the mean of tr(B M^-1 B^T), with B the tip's motion by the parameters.

A learned correction without parameters needs other poses, because it only knows what is near its data.
Space-filling poses are as far from each other as possible, chosen greedily (T. Gonzalez, 1985); those of least process
variance greedily minimise the remaining variance of a Gaussian process over the test poses (J. Sacks et al., Design
and analysis of computer experiments, 1989). Which strategy suits which method was found on simulated machines:
docs/calibration_poses.md.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import solve_triangular

from pm3dof_pin.arrays import require_choice, require_kind
from pm3dof_pin.calibration.candidate_information import CandidateInformation, Criterion, Determinant, TipVariance
from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.calibration.fit import Method
from pm3dof_pin.calibration.gaussian_process import GaussianProcess
from pm3dof_pin.calibration.identifiability import Identifiability, seen_directions, stacked_regressor
from pm3dof_pin.calibration.prior import PRIOR, Prior
from pm3dof_pin.calibration.spacing import MIN_DISTANCE, Spacing
from pm3dof_pin.errors.error_budget import error_budget
from pm3dof_pin.errors.error_map import ErrorMap, error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.presets import nearly_free
from pm3dof_pin.errors.sensitivity import Sensitivities
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.nuisances import datum_motions, seen_datum_map
from pm3dof_pin.typing import Array, Indices, Mask

Strategy = Literal["d-optimal", "tip-optimal", "space-filling", "process-variance", "least-sensitive", "random"]
STRATEGIES: tuple[Strategy, ...] = get_args(Strategy)

STRATEGY_OF_METHOD: dict[Method, Strategy] = {
    "lm": "d-optimal",
    "nn": "space-filling",
    "gp": "process-variance",
    "lm+nn": "process-variance",
    "lm+gp": "process-variance",
}
"""The strategy for each calibration method."""

LOCATED = 0.1
"""Standard deviation of a datum's placement beyond which it is nowhere [m, rad]: derivatives hold no farther than that,
and a fit to such measurements does not converge."""

_PROCESS_NOISE = 0.05  # standard deviation of a measured deviation's noise, over that of the deviations
_MAX_PASSES = 50
_MIN_GAIN = 1e-9
_MAX_CHANGES = 100  # rows of poses exchanged, after which their information is computed anew
_LARGE = 128  # unknowns, from which directions that no candidate sees are left out
_UNSEEN = 1e-7  # rows of all candidates, in standard deviations of the prior


@dataclass(frozen=True, eq=False)
class Plan:
    """Poses to be measured."""

    strategy: Strategy  #: strategy by which they were chosen
    indices: Indices  #: their indices among the candidates, shape=(n,)
    poses: Poses  #: the poses, of the robot as described
    #: remaining tip error after calibration with them, root mean square over the test poses, as far as the parameters
    #: describe the machine [m]
    predicted_tip_rms: float
    identifiability: Identifiability  #: what they identify


@dataclass(frozen=True, eq=False)
class _PlannedPoses:
    """Candidates or test poses, and the effects of a machine's errors there."""

    map: ErrorMap  #: the error map over them
    #: tip-weighted motion of the tool by each unknown of the machine at one tolerance, shape=(n, 6, unknowns) [m]
    effects: Array
    #: commands scaled to -1 .. 1 over their ranges, then the varying wrench components over their greatest value,
    #: shape=(n, commands + k)
    inputs: Array

    @classmethod
    def under(cls, sensitivity_map: ErrorMap, wrenches: Array | None) -> _PlannedPoses:
        """Pair poses with wrenches on the tool, shape=(m, 6), cycling through the wrenches if m differs."""
        poses, weights = sensitivity_map.poses, sensitivity_map.weights[:, None]
        robot, errors = poses.robot, sensitivity_map.errors
        own = None if wrenches is None else np.resize(wrenches, (len(poses), 6))
        elastic = ElasticTerm.under(robot, own)
        by_springs = elastic.derivatives(poses, np.zeros(len(elastic.names))) * elastic.sigmas * weights
        lower, upper = coordinate_ranges(robot, robot.command_coordinates)
        inputs = (poses.commands - 0.5 * (upper + lower)) / (0.5 * (upper - lower))
        if wrenches is not None and own is not None:
            greatest = np.abs(wrenches).max(axis=0)
            inputs = np.hstack([inputs, own[:, greatest > 0.0] / greatest[greatest > 0.0]])
        effects = np.concatenate([sensitivity_map.weighted * errors.tolerances, by_springs], axis=2)
        return cls(sensitivity_map, effects, inputs)


class PlanningProblem:
    """Candidates for measurements, and the poses at which the machine must be accurate afterwards.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> errors, generator = pm.GeometricErrors.load("pm3dof"), np.random.default_rng(0)
        >>> candidates, judges = (pm.reachable_poses(errors.robot, count, generator) for count in (200, 50))
        >>> problem = pm.PlanningProblem(errors, candidates, judges)
        >>> len(problem.plan(12, "tip-optimal", generator, restarts=1).poses)
        12

    Args:
        errors: the parameters, with their tolerances.
        candidates: poses of the robot as described that may be measured.
        test_poses: poses at which the tip error is predicted; the candidates by default.
        instrument: what is measured; full poses by default.
        eta: weight of the orientation in the tip error [m/rad].
        min_distance: see :data:`~pm3dof_pin.calibration.spacing.MIN_DISTANCE`.
        prior: see :data:`~pm3dof_pin.calibration.prior.PRIOR`.
        wrenches: known wrenches on the tool at each candidate, world axes, shape=(candidates, 6) [N, N m]; with them,
            the stiffness of the springs is unknown too, and the predicted tip error is that under such wrenches.
        sources: all sources of error, which determine where the machine is least sensitive; by default its geometry.
        found: the sensitivities at the candidates, if they are known already.

    Attributes:
        prior: see the argument.
        instrument: what is measured.
        unknowns: names of the parameters, and of the logarithms of the springs' stiffness where wrenches are given.
        tolerances: of the unknowns, shape=(unknowns,).
        sigmas: prior standard deviation of the unknowns, in tolerances, shape=(unknowns,).
        regressor: what each candidate measures, scaled, shape=(candidates, rows of a pose, unknowns).
        measured: the candidates, with the effects of errors there.
        tested: the test poses, likewise.

    Raises:
        InvalidValueError: the loops cannot close with an error, the distance is negative, or the prior is not positive.
        SingularConfigurationError: at some pose the tool can move with all drives locked.
    """

    def __init__(
        self,
        errors: GeometricErrors,
        candidates: Poses,
        test_poses: Poses | None = None,
        *,
        instrument: Instrument | None = None,
        eta: float = TIP_LENGTH,
        min_distance: float = MIN_DISTANCE,
        prior: float = PRIOR,
        wrenches: Array | None = None,
        sources: ErrorSources | None = None,
        found: Sensitivities | None = None,
    ) -> None:
        require_kind("errors", errors, GeometricErrors, "pm.GeometricErrors.load")
        require_kind("candidates", candidates, Poses, "Robot.solve")
        if not (np.isfinite(prior) and prior > 0.0):
            raise InvalidValueError("prior", prior, "a positive multiple of the tolerances")
        self.errors, self.candidates, self._sources = errors, candidates, sources
        self.instrument = instrument or Instrument()
        elastic = ElasticTerm.under(errors.robot, wrenches)
        self.unknowns, self.tolerances = elastic.with_parameters(errors)
        candidate_map = error_map(errors, candidates, eta=eta, found=found)
        self.regressor, self.nuisance_regressor, self.nuisances = stacked_regressor(
            errors, candidates, self.instrument, elastic, candidate_map.sensitivities
        )
        self._rows = np.concatenate([self.regressor, self.nuisance_regressor], axis=2)
        tests = candidate_map if test_poses is None else error_map(errors, test_poses, eta=eta)
        self.measured, self.tested = (_PlannedPoses.under(each, wrenches) for each in (candidate_map, tests))
        self.prior = prior
        before = Prior(prior, nearly_free(errors)).of_all(len(elastic.names), self.nuisances.sigmas)
        self.sigmas, self._prior = before[: len(self.unknowns)], np.diag(before**-2.0)
        # base and tool are as the measurements define them, here all candidates
        shown = self.nuisances.datum_map()
        if shown[6:].any():
            own = np.r_[: len(errors), len(self.unknowns) : self._rows.shape[2]]
            units = np.concatenate([errors.tolerances, self.nuisances.scales])
            known = np.linalg.inv(self.information(np.arange(len(candidates))))[np.ix_(own, own)]
            known *= np.outer(units, units)
            shown = seen_datum_map(self.nuisances, tests.sensitivities.errors, tests.poses, tests.weights, known)
        datum = datum_motions(tests.poses) @ (shown * self.nuisances.scales)
        effects = np.concatenate([self.tested.effects, datum * tests.weights[:, None]], axis=2)
        effects = effects.reshape(-1, self._rows.shape[2]) / np.sqrt(len(tests.poses))
        if len(effects) > effects.shape[1]:
            effects = np.asarray(np.linalg.qr(effects, mode="r"))  # of the same squares
        self._effects, self._tip = effects, effects.T @ effects
        self._spacing = Spacing(candidates, min_distance, confined=self.instrument.confines)
        self._exchanges: dict[tuple[type[Criterion], tuple[int, ...]], Indices] = {}

    @cached_property
    def least_sensitive(self) -> Mask:
        """Mask of the candidates in the region least sensitive to errors, shape=(candidates,)."""
        if self._sources is None:
            return self.measured.map.least_sensitive()
        measured = self.measured.map
        found = measured.sensitivities if self._sources.errors is self.errors else None
        return error_budget(self._sources, self.candidates, eta=measured.eta, found=found).least_sensitive()

    def plan(self, count: int, strategy: Strategy, generator: np.random.Generator, *, restarts: int = 10) -> Plan:
        """Choose poses.

        Args:
            count: number of poses.
            strategy: one of :data:`STRATEGIES`.
            generator: source of the random numbers.
            restarts: number of starts of the optimal strategies; the best result is taken.

        Raises:
            InvalidValueError: an unknown strategy, or too few candidates far enough from each other.
        """
        require_choice("strategy", strategy, Strategy)
        chosen = self._chosen(count, strategy, generator, restarts)
        return Plan(
            strategy,
            chosen,
            self.candidates[chosen],
            self.predicted_tip_rms(chosen),
            Identifiability.from_regressor(self.unknowns, self.regressor[chosen], self.nuisance_regressor[chosen]),
        )

    @cached_property
    def _visible(self) -> tuple[Array, Array | None]:
        """The candidates' rows in the directions that any of them sees, and these directions as columns, if fewer.

        What none of them sees keeps its prior, however the poses are chosen. Of large machines most parameters move
        others' combinations, and exchanging poses takes time with the square of the directions.
        """
        size = self._rows.shape[2]
        if size < _LARGE:
            return self._rows, None
        deviations = np.diag(self._prior) ** -0.5
        directions = deviations[:, None] * seen_directions(self._rows.reshape(-1, size) * deviations, _UNSEEN)
        return self._rows @ directions, directions

    def information(self, indices: ArrayLike) -> Array:
        """Return M for some candidates, in units of the tolerances, shape=(parameters and nuisances, same)."""
        rows = self._rows[np.asarray(indices, dtype=np.intp)].reshape(-1, self._rows.shape[2])
        return np.asarray(self._prior + rows.T @ rows)

    def predicted_sigmas(self, indices: ArrayLike) -> dict[str, float]:
        """Return the standard deviation of each unknown after measuring some candidates, by name [m, rad, 1]."""
        spread = np.sqrt(np.diag(np.linalg.inv(self.information(indices))))[: len(self.unknowns)]
        return dict(zip(self.unknowns, (spread * self.tolerances).tolist(), strict=True))

    def unlocated(self, indices: ArrayLike) -> list[str]:
        """Return the unknowns of datums' placements that some candidates leave open: worse than :data:`LOCATED`."""
        spread = np.sqrt(np.diag(np.linalg.inv(self.information(indices))))[len(self.unknowns) :]
        kinds = {each.kind.name for each in self.instrument.placed}
        chosen = [column for kind in sorted(kinds) for column in self.nuisances.columns(kind)]
        sigmas = spread * self.nuisances.scales
        return [self.nuisances.names[column] for column in chosen if sigmas[column] > LOCATED]

    def predicted_tip_rms(self, indices: ArrayLike) -> float:
        """Return the remaining tip error after measuring some candidates, over the test poses [m].

        Without any, it is that of a machine known only by the prior.
        """
        # without any measurement, base and tool are given
        known = slice(None) if np.size(indices) else slice(len(self.unknowns))
        factor = np.linalg.cholesky(self.information(indices)[known, known])
        return float(np.linalg.norm(solve_triangular(factor, self._effects[:, known].T, lower=True)))

    def accuracy_curve(self, counts: Sequence[int], strategy: Strategy, seeds: Iterable[int]) -> Array:
        """Return the predicted tip error against the number of poses, shape=(counts, seeds) [m]; see :meth:`plan`.

        NaN where so many poses do not fit apart.
        """
        require_choice("strategy", strategy, Strategy)

        def predicted(count: int, seed: int) -> float:
            try:
                chosen = self._chosen(count, strategy, np.random.default_rng(seed), restarts=1)
            except InvalidValueError:
                return float("nan")
            return self.predicted_tip_rms(chosen)

        every = list(seeds)
        return np.array([[predicted(count, seed) for seed in every] for count in counts])

    def _chosen(self, count: int, strategy: Strategy, generator: np.random.Generator, restarts: int) -> Indices:
        chooser: dict[Strategy, Callable[[], Indices]] = {
            "d-optimal": lambda: self._optimal(count, generator, restarts, Determinant()),
            "tip-optimal": lambda: self._optimal(count, generator, restarts, Determinant(), TipVariance(self._tip)),
            "space-filling": lambda: self._space_filling(count, generator),
            "process-variance": lambda: self._least_process_variance(count),
            "least-sensitive": lambda: self._spacing.draw(np.flatnonzero(self.least_sensitive), count, generator),
            "random": lambda: self._spacing.draw(np.arange(len(self.candidates)), count, generator),
        }
        return np.sort(chooser[strategy]())

    def _space_filling(self, count: int, generator: np.random.Generator) -> Indices:
        """Repeatedly take the candidate farthest from those taken, starting from a random one."""
        chosen = [int(generator.integers(len(self.candidates)))]
        distances = np.full(len(self.candidates), np.inf)
        while len(chosen) < count:
            distances = np.minimum(distances, self._spacing.from_pose(chosen[-1]))
            chosen.append(int(np.argmax(distances)))
        self._spacing.require(chosen)
        return np.array(chosen, dtype=np.intp)

    def _least_process_variance(self, count: int) -> Indices:
        """Repeatedly take the candidate that most reduces a Gaussian process's variance over the test poses.

        With the Cholesky factor L of the poses taken, the covariance of candidates and tests is K - L S, of which only
        the sums of squares of its rows are followed.
        """
        drives = range(self.candidates.commands.shape[1])
        inputs, tests = (poses.inputs[:, : len(drives)] for poses in (self.measured, self.tested))
        across = [GaussianProcess.typical_covariance(inputs, tests, drive) for drive in drives]
        squares = [np.einsum("nt,nt->n", covariance, covariance) for covariance in across]
        own = [GaussianProcess.typical_variance(inputs) for _ in drives]
        most = min(count, len(inputs))
        seen = np.zeros((len(drives), most, len(inputs)))  # L^T of each drive, over the candidates
        steps = np.zeros((len(drives), most, len(tests)))  # S
        chosen: list[int] = []
        taken = np.zeros(len(self.candidates), dtype=bool)
        while (number := len(chosen)) < count:
            gains = sum(square / (variance + _PROCESS_NOISE**2) for square, variance in zip(squares, own, strict=True))
            best = int(np.argmax(np.where(taken, -np.inf, gains)))
            if taken[best]:
                self._spacing.require([best, best])
            chosen.append(best)
            taken |= self._spacing.near(best)
            for drive in drives:
                before, stepped = seen[drive, :number], steps[drive, :number]
                column = GaussianProcess.typical_covariance(inputs, inputs[best][None], drive)[:, 0]
                scale = np.sqrt(own[drive][best] + _PROCESS_NOISE**2)
                row = (column - before[:, best] @ before) / scale
                step = (across[drive][best] - before[:, best] @ stepped) / scale
                along = across[drive] @ step - (stepped @ step) @ before
                squares[drive] += row * (row * (step @ step) - 2.0 * along)
                own[drive] = own[drive] - row**2
                seen[drive, number], steps[drive, number] = row, step
        return np.array(chosen, dtype=np.intp)

    def _optimal(self, count: int, generator: np.random.Generator, restarts: int, *criteria: Criterion) -> Indices:
        """Exchange poses for better ones until none is found, from several random starts, and return the best.

        The last criterion decides; earlier ones only provide better starts.
        """
        best, best_value = np.empty(0, dtype=np.intp), -np.inf
        everything = np.arange(len(self.candidates))
        for _ in range(max(1, restarts)):
            chosen = self._spacing.draw(everything, count, generator)
            for criterion in criteria:
                chosen = self._exchanged(chosen, criterion)
            value = criteria[-1].value(self.information(chosen))
            if value > best_value:
                best, best_value = chosen, value
        return best

    def _exchanged(self, start: Indices, criterion: Criterion) -> Indices:
        """Return what exchanging leads to from a start; strategies, and rehearsals of a plan, have starts in common."""
        key = type(criterion), tuple(start.tolist())
        if key not in self._exchanges:
            self._exchanges[key] = self._exchange(start, criterion)
        return self._exchanges[key]

    def _exchange(self, start: Indices, criterion: Criterion) -> Indices:
        chosen, (rows, directions) = start.copy(), self._visible
        tip = criterion.tip
        if directions is not None and tip is not None:
            tip = directions.T @ tip @ directions

        def state_of(indices: Indices) -> CandidateInformation:
            information = self.information(indices)
            if directions is not None:
                information = directions.T @ information @ directions
            return CandidateInformation.from_rows(rows, information, tip)

        near = np.array([self._spacing.near(int(index)) for index in chosen])
        state, kept = state_of(chosen), 0  # kept: places in a row that no other candidate fills better
        for visit in range(_MAX_PASSES * len(chosen)):
            if kept == len(chosen):
                break
            place = visit % len(chosen)
            without = state.changed(chosen[place], -1.0) or state_of(np.delete(chosen, place))
            gains = criterion.gains(without)
            others = np.delete(near, place, axis=0).any(axis=0)
            gains[others] = -np.inf
            winner = int(np.argmax(gains))
            if gains[winner] > gains[chosen[place]] + _MIN_GAIN * abs(gains[chosen[place]]):
                chosen[place], near[place] = winner, self._spacing.near(winner)
                after = without.changed(winner, 1.0) if state.changes.shape[1] < _MAX_CHANGES else None
                state, kept = after or state_of(chosen), 0
            kept += 1
        return chosen


def order_with_references(poses: Poses, every: int, seed: int) -> Indices:
    """Return an order of poses that reveals drift and scatter: random, with one pose repeated between the others.

    Random order decorrelates time from the coordinates; the central pose is repeated after `every` others.
    """
    commands = poses.commands
    spread = np.maximum(np.ptp(commands, axis=0), np.finfo(float).tiny)
    reference = int(np.argmin(np.linalg.norm((commands - commands.mean(axis=0)) / spread, axis=1)))
    others = np.random.default_rng(seed).permutation(np.delete(np.arange(len(commands)), reference))
    order = [reference]
    for start in range(0, len(others), every):
        order += [*others[start : start + every].tolist(), reference]
    return np.array(order, dtype=np.intp)
