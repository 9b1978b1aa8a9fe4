"""A plan of measurements: candidates that the instrument can see and the machine can take, poses chosen from them.

Candidates are within all limits and declared ranges, touch what the instrument touches, and keep away from singular
poses, where errors of the parts move the tool several times as far as usual: D-optimal poses would seek these. Machines
with errors of three tolerances are assembled at the poses chosen; candidates at which one cannot be are replaced, and
if that does not end, all at which one cannot be are left out.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.calibration.assembled import OUT_OF_TOLERANCE, assembled
from pm3dof_pin.calibration.fit import MIN_POSES, Method
from pm3dof_pin.calibration.identifiability import minimum_poses
from pm3dof_pin.calibration.linearisation import UNKNOWN
from pm3dof_pin.calibration.planning import (
    STRATEGIES,
    STRATEGY_OF_METHOD,
    Plan,
    PlanningProblem,
    Strategy,
    order_with_references,
)
from pm3dof_pin.calibration.rehearsal import Rehearsal
from pm3dof_pin.calibration.sag import sag_in_words
from pm3dof_pin.calibration.spacing import MIN_DISTANCE, Spacing, require_room
from pm3dof_pin.errors.command_correction import command_jacobians
from pm3dof_pin.errors.error_map import ErrorMap, error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable, sensitivities
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.table import placed_instrument
from pm3dof_pin.measuring.measurement_file import TARGET_POINT_SIGMA
from pm3dof_pin.measuring.observation import planned_measurements, touching_poses
from pm3dof_pin.measuring.wrenches import WRENCH_COLUMNS
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Indices

logger = logging.getLogger(__name__)

SINGULAR = 3.0
"""Times the median sensitivity to errors of the parts: beyond it a candidate is too near to a singular pose."""
MACHINES = 30
"""Number of machines out of tolerance that must be assembled at every planned pose."""

DEFAULT_POSES = 9
TRIED = (6, 9, 12, 16, 20, 25, 30, 40, 50, 60, 80, 100)
"""Numbers of poses tried until an accuracy is reached."""
SEEDS = range(10)

CANDIDATES = 2000
"""Number of random poses to choose from."""
FEWER_CANDIDATES = 500
"""The same for robots of more than :data:`MANY_PARAMETERS`, where exchanging and judging one takes long."""
MANY_PARAMETERS = 200

_STARTS, _FEWER_STARTS = 10, 3  # of exchanging poses, of robots of few parameters and of many
_TESTS = 300
_ROUNDS = 8  # of replacing poses at which some machine cannot be assembled, before all candidates are tried
_USUAL = 1.2  # times the median sensitivity: poses below it are never left out for being as sensitive as another
_FEWEST = 0.3  # fraction of the candidates that must remain
_CLOSED_AT = 20  # poses chosen among, at which loops must close with the errors
_NAMED = 4  # unknowns in a message
_MORE = 4  # times as many candidates are drawn where only some are usable
_ONCE: tuple[Strategy, ...] = ("space-filling", "least-sensitive", "random")


@dataclass(frozen=True, eq=False)
class MeasurementPlan:
    """Poses to measure, in their order, and what they tell."""

    problem: PlanningProblem  #: the candidates that were left, and the instrument
    plan: Plan  #: the poses chosen
    order: Indices  #: order in which to measure them; some twice with references
    loads: dict[str, Array]  #: wrenches by column, for each pose in this order
    excess: dict[int, float]  #: excess tip error over the best commands, by number of poses tried [m]
    accurate: bool | None  #: whether the accuracy asked for is reached; None if none was
    machines: int  #: number of machines, three tolerances out, that were assembled at every pose
    near_singular: int  #: candidates left out because they are near singular poses
    #: candidates left out because one of the machines cannot be assembled there, or at a pose as sensitive as that
    not_assembled: int
    seed: int  #: of the random numbers

    @property
    def poses(self) -> Poses:
        """The poses in the order to measure them."""
        return self.plan.poses[self.order]

    @cached_property
    def minimum_poses(self) -> int:
        """Least number of poses that identify as much as all candidates."""
        rows = 2 * len(self.problem.errors)
        return minimum_poses(self.problem.regressor[:rows], self.problem.nuisance_regressor[:rows])

    @property
    def can_be_checked(self) -> bool:
        """Whether measurements of these poses can contradict what is identified from them, as `calibrate` demands."""
        known, nuisances = self.plan.identifiability.identified, self.problem.nuisances
        equations = len(self.plan.indices) * self.problem.regressor.shape[1]
        return len(self.plan.indices) > MIN_POSES or equations > known + int(np.sum(nuisances.sigmas >= UNKNOWN))

    @cached_property
    def by_strategy(self) -> dict[Strategy, float]:
        """Predicted tip error with as many poses of each strategy, rms [m]; NaN with too few candidates."""
        return {name: self._predicted(name) for name in STRATEGIES}

    @cached_property
    def sag(self) -> str:
        """How far the bodies' weight moves the tool, in words, where that may refuse a calibration; otherwise ""."""
        return sag_in_words(self.problem.errors, self.plan.poses, self.problem.tested.map.eta)

    def _predicted(self, strategy: Strategy) -> float:
        if strategy == self.plan.strategy:
            return self.plan.predicted_tip_rms
        return float(self.problem.accuracy_curve([len(self.plan.indices)], strategy, seeds(strategy, self.seed)).mean())


def seeds(strategy: Strategy, seed: int = 0) -> Sequence[int]:
    """Return several seeds to average over for strategies that depend on them, one for the others."""
    return SEEDS if strategy in _ONCE else [seed]


def plan_measurements(
    errors: GeometricErrors,
    poses: int | None = None,
    *,
    instrument: Instrument | str = "tracker",
    sigma: float | None = None,
    point: tuple[float, float, float] | None = None,
    centres: tuple[tuple[float, float, float], ...] = (),
    known_centres: bool = False,
    joints: tuple[str, ...] = (),
    length: float | None = None,
    target_sigma: float = TARGET_POINT_SIGMA,
    method: Method = "lm",
    strategy: Strategy | None = None,
    accuracy: float | None = None,
    among: Poses | None = None,
    candidates: int | None = None,
    margin: float = 0.0,
    min_distance: float = MIN_DISTANCE,
    prior: float = 3.0,
    wrench: Sequence[float] | None = None,
    references: int | None = None,
    machines: int = MACHINES,
    seed: int = 0,
) -> MeasurementPlan:
    """Choose poses to measure for a calibration.

    Example:
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.calibration.measurement_plan import plan_measurements
        >>> errors = pm.GeometricErrors.load("hexapod")
        >>> found = plan_measurements(errors, 12, instrument="ballbar", candidates=100, machines=2)
        >>> len(found.poses)
        12

    Args:
        errors: the parameters with their tolerances; those with which the loops cannot close are left out.
        poses: number of poses, 9 by default.
        instrument: what is measured, or its name in :data:`pm3dof_pin.measuring.instruments.table.INSTRUMENTS`.
        sigma: for names: noise of a coordinate [m].
        point: for names: the ball, stylus or target, in tool axes [m].
        centres: for names: where distances start, or the instrument is, base axes [m].
        known_centres: for names: whether the centres were measured beforehand; otherwise they are estimated.
        joints: for names: passive joints that are locked.
        length: for names: length of a ballbar [m].
        target_sigma: for names: standard deviation of the target's coordinates on the tool [m]; 0 if known exactly.
        method: calibration method, which determines the strategy.
        strategy: another strategy.
        accuracy: instead of a number of poses: the excess tip error over the best commands to reach, rms [m].
        among: poses to choose from, by default random ones.
        candidates: number of these, by default :data:`CANDIDATES` or :data:`FEWER_CANDIDATES`.
        margin: part of each coordinate's range to exclude at either end.
        min_distance: see :data:`~pm3dof_pin.calibration.spacing.MIN_DISTANCE`.
        prior: prior standard deviation of the parameters, in tolerances.
        wrench: greatest known wrench on the tool, shape=(6,) [N, N m]; stiffness is then unknown too.
        references: order the poses at random, and repeat one after so many others.
        machines: number of machines, three tolerances out, to be assembled at every pose.
        seed: of the random numbers.

    Raises:
        InvalidValueError: an argument is out of range, or there are too few candidates.
        UnreachablePoseError: the instrument is out of reach, or hardly any candidate can be assembled.
    """
    robot, generator = errors.robot, np.random.default_rng(seed)
    if among is None:
        require_room(robot, poses or 1, min_distance)
    errors = closable(errors, None if among is None else among[:_CLOSED_AT])
    many = len(errors) > MANY_PARAMETERS
    candidates = candidates or (FEWER_CANDIDATES if many else CANDIDATES)
    drawn = among
    if drawn is None:
        drawn = _declared(reachable_poses(robot, candidates, generator, margin=margin))
        if len(drawn) < candidates:
            more = _declared(reachable_poses(robot, _MORE * candidates, generator, margin=margin))
            drawn = more[np.arange(min(candidates, len(more)))] if len(more) > len(drawn) else drawn
    tests = _declared(reachable_poses(robot, min(candidates, _TESTS), generator))
    if isinstance(instrument, str):
        instrument = placed_instrument(
            instrument,
            drawn,
            sigma=sigma,
            point=point,
            centres=centres,
            length=length,
            known_centres=known_centres,
            joints=joints,
            target_sigma=target_sigma,
        )
    choices = touching_poses(drawn, instrument)
    choices = _declared(choices) if among is None else choices
    spacing = Spacing(choices, min_distance, confined=instrument.confines)
    spacing.draw(np.arange(len(choices)), poses or 1, np.random.default_rng(seed))  # before work
    found, near_singular, sizes = sensitivities(errors, choices), 0, np.zeros(len(choices))
    if among is None:
        sizes = _sizes(error_map(errors, choices, found=found))
        regular = sizes <= SINGULAR
        near_singular = int((~regular).sum())
        choices, sizes, found = choices[regular], sizes[regular], found[regular]
    whole = instrument.measured == "pose" and not (instrument.targets or instrument.encoders or instrument.tilts_only)
    if not whole and (accuracy is not None or method != "lm"):
        raise InvalidValueError("method", method, "lm, without an accuracy, for instruments that do not see full poses")
    chosen, dropped = strategy or STRATEGY_OF_METHOD[method], 0
    wrenches = None
    if wrench is not None:
        wrenches = np.random.default_rng([seed, 1]).uniform(-1.0, 1.0, (len(choices), 6)) * np.asarray(wrench)
    for attempt in itertools.count(1):
        problem = PlanningProblem(
            errors,
            choices,
            tests,
            instrument=instrument,
            min_distance=min_distance,
            prior=prior,
            wrenches=wrenches,
            sources=ErrorSources(errors),
            found=found,
        )
        tried = _rehearsed(problem, chosen, method, poses, accuracy, seed) if whole else {}
        count = max(tried, default=poses or DEFAULT_POSES)
        starts = _FEWER_STARTS if many else _STARTS
        plan = problem.plan(count, chosen, np.random.default_rng(seed), restarts=starts)
        open_ = ~assembled(errors, plan.poses, machines, seed)
        if not open_.any():
            break
        if attempt == _ROUNDS:
            kept = assembled(errors, choices, machines, seed)
            if kept.sum() < count:
                raise UnreachablePoseError(
                    f"{robot.name}: machines {OUT_OF_TOLERANCE:g} tolerances out can be assembled at {int(kept.sum())} "
                    f"of {len(kept)} poses to choose from, and {count} are planned; a greater margin leaves out the "
                    "ends of the ranges"
                )
        else:  # where one machine cannot be assembled, no other pose as sensitive as that is taken either
            kept = np.ones(len(choices), dtype=bool)
            kept[plan.indices[open_]] = False
            tighter = kept & (sizes < max(_USUAL, float(sizes[plan.indices[open_]].min())))
            kept = tighter if among is None and tighter.sum() > _FEWEST * len(kept) else kept
        dropped += int((~kept).sum())
        choices, sizes, found = choices[kept], sizes[kept], found[kept]
        wrenches = None if wrenches is None else wrenches[kept]
    _require_sight(plan.poses, instrument)
    _require_places(problem, plan)
    order = np.arange(count) if references is None else order_with_references(plan.poses, references, seed)
    loads = {}
    if wrenches is not None:
        columns = zip(WRENCH_COLUMNS, wrenches[plan.indices][order].T, strict=True)
        loads = {name: values for name, values in columns if values.any()}
    accurate = None if accuracy is None else tried[count] <= accuracy
    return MeasurementPlan(problem, plan, order, loads, tried, accurate, machines, near_singular, dropped, seed)


def _declared(poses: Poses) -> Poses:
    """Return the poses within the declared ranges of the coordinates, or all if none is."""
    lower, upper = np.array([poses.robot.range_of(coordinate) for coordinate in poses.robot.coordinates]).T
    within = ((poses.coordinates >= lower - SAME) & (poses.coordinates <= upper + SAME)).all(axis=1)
    return poses[within] if within.any() else poses


def _sizes(effects: ErrorMap) -> Array:
    """Return how far errors of the parts move the tool at each pose, relative to the median, shape=(n,)."""
    sizes = np.linalg.norm(effects.weighted * effects.errors.tolerances, axis=(1, 2))
    return np.asarray(sizes / np.median(sizes))


def _require_sight(poses: Poses, instrument: Instrument) -> None:
    """Raise InvalidValueError for an instrument that sees no motion of the drives, whatever it tells of the parts."""
    if instrument.locked or instrument.encoders:
        return
    seen = planned_measurements(poses, instrument)
    drives = command_jacobians(poses)[seen.pose_numbers] * np.ptp(poses.commands, axis=0)
    if not (np.abs(seen.derivatives(poses[seen.pose_numbers], drives)) > seen.sigmas[:, :, None]).any():
        problem = f"sees nothing of what the drives of {poses.robot.name} move, so no command could be corrected"
        raise InvalidValueError("instrument", problem=problem, expected="another one, or another point")


def _require_places(problem: PlanningProblem, plan: Plan) -> None:
    """Raise InvalidValueError if what the rows are measured against cannot be located by them."""
    if not (names := problem.unlocated(plan.indices)):
        return
    some = ", ".join(names[:_NAMED]) + (" ..." if len(names) > _NAMED else "")
    if problem.unlocated(np.arange(len(problem.candidates))):
        why = f"stays on a line or at one place, which does not tell {some}"
        raise InvalidValueError("the point seen", problem=why, expected="one beside it, that turns with the tool")
    raise InvalidValueError("poses", problem=f"are too few to tell {some}", expected=f"more than {len(plan.indices)}")


def _rehearsed(
    problem: PlanningProblem, strategy: Strategy, method: Method, poses: int | None, accuracy: float | None, seed: int
) -> dict[int, float]:
    """Return the excess tip error over the best commands, by number of poses [m], until one is accurate enough."""
    rehearsal = Rehearsal(problem, np.random.default_rng(seed))
    tried: dict[int, float] = {}
    for count in [poses or DEFAULT_POSES] if accuracy is None else TRIED:
        if method != "lm" and count < MIN_POSES:
            continue
        try:
            plan = problem.plan(count, strategy, np.random.default_rng(seed), restarts=1)
        except InvalidValueError:
            if not tried:
                raise
            break
        tried[count] = rehearsal.excess(plan.indices, method, seed)
        if accuracy is not None and tried[count] <= accuracy:
            break
    return tried
