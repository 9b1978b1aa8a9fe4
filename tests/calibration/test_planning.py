"""Plans against exhaustive search and simulated calibrations."""

from __future__ import annotations

from copy import copy
from functools import partial
from itertools import combinations

import numpy as np
import pytest

from pm3dof_pin.calibration import planning
from pm3dof_pin.calibration.gaussian_process import GaussianProcess
from pm3dof_pin.calibration.planning import STRATEGIES, PlanningProblem, order_with_references
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.simulation.simulated_machine import GeometricSource, SimulatedMachine

SEEDS = range(5)


@pytest.fixture(scope="module")
def candidates(mechanism: Robot) -> Poses:
    return reachable_poses(mechanism, 2000, np.random.default_rng(0))


@pytest.fixture(scope="module")
def problem(tripod_errors: GeometricErrors, candidates: Poses, tripod_nominal: Poses) -> PlanningProblem:
    return PlanningProblem(tripod_errors, candidates, tripod_nominal)


@pytest.fixture(scope="module")
def small(tripod_errors: GeometricErrors, candidates: Poses, tripod_nominal: Poses) -> PlanningProblem:
    return PlanningProblem(tripod_errors, candidates[:300], tripod_nominal[:50])


@pytest.mark.parametrize("strategy", ["d-optimal", "tip-optimal"])
def test_nothing_better_exists_among_few(
    tripod_errors: GeometricErrors, candidates: Poses, tripod_nominal: Poses, strategy: str
) -> None:
    """All 1,820 choices of 4 out of 16."""
    small = PlanningProblem(tripod_errors, candidates[:16], tripod_nominal[:50], min_distance=0.0)

    def value(chosen: tuple[int, ...]) -> float:
        if strategy == "d-optimal":
            return float(np.linalg.slogdet(small.information(chosen))[1])
        return -small.predicted_tip_rms(chosen)

    best = max(map(value, combinations(range(16), 4)))
    plan = small.plan(4, strategy, np.random.default_rng(0), restarts=5)  # type: ignore[arg-type]
    assert value(tuple(plan.indices)) == pytest.approx(best, rel=1e-12)


@pytest.mark.parametrize("strategy", ["d-optimal", "tip-optimal"])
def test_directions_that_no_candidate_sees_change_no_plan(
    small: PlanningProblem, strategy: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Every parameter twice: the differences are invisible, and plans are those of an exchange among all unknowns."""
    doubled = copy(small)
    size = small._rows.shape[2]
    both = np.hstack([np.eye(size), np.eye(size)])
    doubled._rows, doubled._tip = small._rows @ both, both.T @ small._tip @ both
    doubled._prior = np.kron(np.eye(2), small._prior)
    plans = []
    for large in (10 * size, 1):  # without and with the search for visible directions
        doubled.__dict__.pop("_visible", None)
        monkeypatch.setattr(planning, "_LARGE", large)
        plans.append(doubled._chosen(8, strategy, np.random.default_rng(4), 1))  # type: ignore[arg-type]
    assert doubled._visible[0].shape[2] <= size
    np.testing.assert_array_equal(*plans)


def test_each_pose_leaves_the_least_variance_of_processes(small: PlanningProblem) -> None:
    """By the posterior covariance of each drive's process given all poses before, solved for at once."""
    drives = range(small.candidates.commands.shape[1])
    inputs, tests = small.measured.inputs[:, : len(drives)], small.tested.inputs[:, : len(drives)]
    chosen: list[int] = []
    for _ in range(15):
        gains = np.zeros(len(inputs))
        for drive in drives:
            between = partial(GaussianProcess.typical_covariance, drive=drive)
            known = between(inputs[chosen], inputs[chosen]) + planning._PROCESS_NOISE**2 * np.eye(len(chosen))
            seen = np.linalg.solve(known, between(inputs[chosen], inputs))
            across = between(inputs, tests) - seen.T @ between(inputs[chosen], tests)
            own = np.diag(between(inputs, inputs)) - np.sum(between(inputs[chosen], inputs) * seen, axis=0)
            gains += np.sum(across**2, axis=1) / (own + planning._PROCESS_NOISE**2)
        taken = [row for each in chosen for row in np.flatnonzero(small._spacing.near(each))]
        gains[taken] = -np.inf
        chosen.append(int(np.argmax(gains)))
    np.testing.assert_array_equal(small.plan(15, "process-variance", np.random.default_rng(0)).indices, sorted(chosen))


@pytest.mark.parametrize("count", [9, 20])
def test_optimal_plans_beat_random_ones(problem: PlanningProblem, count: int) -> None:
    """By 1.4 times or more in predicted tip error, mean over five seeds; the chapter's rule is worse than random."""
    predicted = {s: problem.accuracy_curve([count], s, SEEDS).mean() for s in ("random", "least-sensitive")}
    d_optimal = problem.accuracy_curve([count], "d-optimal", SEEDS[:3]).mean()
    tip_optimal = problem.accuracy_curve([count], "tip-optimal", [0]).mean()
    assert predicted["random"] / d_optimal > 1.4
    assert predicted["least-sensitive"] / d_optimal > 2.0
    assert tip_optimal < d_optimal


@pytest.mark.parametrize(("count", "prior", "least"), [(9, 1.0, 1.4), (20, 1.0, 1.2), (20, 1e4, 1.4)])
def test_the_gain_rests_on_how_far_tolerances_are_believed(
    problem: PlanningProblem, tripod_nominal: Poses, count: int, prior: float, least: float
) -> None:
    other = PlanningProblem(problem.errors, problem.candidates[:800], tripod_nominal, prior=prior)
    random = other.accuracy_curve([count], "random", SEEDS).mean()
    assert random / other.accuracy_curve([count], "d-optimal", [0]).mean() > least


def test_the_prediction_is_what_a_calibration_attains(
    tripod_errors: GeometricErrors, candidates: Poses, tripod_nominal: Poses
) -> None:
    """Random machines are measured with noise by closed loops, and their parameters estimated to first order."""
    problem = PlanningProblem(tripod_errors, candidates[:500], tripod_nominal[:60], prior=1.0)
    plan = problem.plan(12, "d-optimal", np.random.default_rng(0), restarts=1)
    instrument, rng = Instrument(), np.random.default_rng(1)
    finer = Instrument("pose", instrument.position_sigma / 10, instrument.angle_sigma / 10)
    blocks = problem.regressor[plan.indices].reshape(-1, len(tripod_errors))
    tests = sensitivities(tripod_errors, tripod_nominal[:60]).errors
    squares = []
    for _ in range(60):
        truth = 0.1 * tripod_errors.sample(rng)  # small, so that one linear step suffices
        machine = SimulatedMachine(tripod_errors.robot, GeometricSource(tripod_errors, truth))
        measured = machine.measure(plan.poses.commands, rng, instrument=finer)
        rows = (10.0 * pose_difference(plan.poses.transforms, measured) / instrument.sigmas).ravel()
        found = 0.1 * tripod_errors.tolerances * np.linalg.solve(problem.information(plan.indices), blocks.T @ rows)
        squares.append(np.mean(tip_error(tests @ (found - truth)) ** 2))
    assert 10.0 * np.sqrt(np.mean(squares)) == pytest.approx(plan.predicted_tip_rms, rel=0.1)


def test_plans_keep_their_distance_and_limits(small: PlanningProblem) -> None:
    for strategy in STRATEGIES:
        plan = small.plan(15, strategy, np.random.default_rng(2), restarts=1)
        assert len(set(plan.indices)) == 15
        assert plan.poses.within_limits.all()
        shares = plan.poses.commands / 0.17  # the stroke
        distances = np.sqrt(np.mean((shares[:, None] - shares) ** 2, axis=2)) + np.eye(15)
        assert distances.min() >= 0.05
        assert plan.identifiability.rank == 40
        assert plan.identifiability.observability.O1 > 0.0


def test_the_chapters_rule_stays_in_its_region(small: PlanningProblem) -> None:
    plan = small.plan(12, "least-sensitive", np.random.default_rng(0))
    assert small.measured.map.least_sensitive(0.2)[plan.indices].all()


def test_the_same_seed_gives_the_same_plan(small: PlanningProblem) -> None:
    for strategy in STRATEGIES:
        first, again = (small.plan(9, strategy, np.random.default_rng(4), restarts=2) for _ in range(2))
        np.testing.assert_array_equal(first.indices, again.indices)


def test_more_poses_predict_better(small: PlanningProblem) -> None:
    curve = small.accuracy_curve([0, 3, 9, 30], "d-optimal", [0])[:, 0]
    assert np.all(np.diff(curve) < 0.0)


def test_what_cannot_be_planned_is_refused(problem: PlanningProblem, tripod_errors: GeometricErrors) -> None:
    with pytest.raises(InvalidValueError, match="at most about"):
        problem.plan(700, "random", np.random.default_rng(0))
    with pytest.raises(InvalidValueError, match="strategy"):
        problem.plan(3, "best", np.random.default_rng(0))  # type: ignore[arg-type]
    for wrong in ({"min_distance": -1.0}, {"prior": 0.0}):
        with pytest.raises(InvalidValueError):
            PlanningProblem(tripod_errors, problem.candidates[:3], **wrong)


def test_other_machines_are_planned_too() -> None:
    errors = GeometricErrors.load("hexapod")
    poses = reachable_poses(errors.robot, 80, np.random.default_rng(0))
    problem = PlanningProblem(errors, poses[:60], poses[60:])
    plan = problem.plan(10, "d-optimal", np.random.default_rng(0), restarts=1)
    assert plan.predicted_tip_rms < problem.predicted_tip_rms([])


def test_reference_poses_stand_between_the_others(tripod_nominal: Poses) -> None:
    order = order_with_references(tripod_nominal[:14], 4, 0)
    reference = order[0]
    np.testing.assert_array_equal(np.flatnonzero(order == reference), [0, 5, 10, 15, 17])
    assert sorted(set(order.tolist())) == list(range(14))
    assert len(order) == 13 + 5
