"""Plans for learned corrections, and rehearsals of them: against their definitions and a closed formula."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.calibration import rehearsal
from pm3dof_pin.calibration.planning import STRATEGY_OF_METHOD, PlanningProblem
from pm3dof_pin.calibration.rehearsal import Rehearsal
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.tool_deflection import stiffened
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument


@pytest.fixture(scope="module")
def tests(mechanism: Robot) -> Poses:
    return reachable_poses(mechanism, 60, np.random.default_rng(1))


@pytest.fixture(scope="module")
def problem(tripod_errors: GeometricErrors, mechanism: Robot, tests: Poses) -> PlanningProblem:
    candidates = reachable_poses(mechanism, 400, np.random.default_rng(0))
    return PlanningProblem(tripod_errors, candidates, tests, prior=1.0)


def test_space_filling_poses_are_far_apart(problem: PlanningProblem) -> None:
    def least_distance(strategy: str, seed: int) -> float:
        u = problem.plan(12, strategy, np.random.default_rng(seed)).poses.commands  # type: ignore[arg-type]
        return float(np.linalg.norm(u[:, None] - u, axis=2)[np.triu_indices(12, 1)].min())

    filling = [least_distance("space-filling", seed) for seed in range(5)]
    assert min(filling) > 1.5 * max(least_distance("random", seed) for seed in range(5))


def test_the_process_is_left_with_less_variance(problem: PlanningProblem, tests: Poses) -> None:
    """By the textbook formula, k** - k*^T (K + noise)^-1 k*, with an explicit kernel."""
    robot = problem.errors.robot
    ends = np.array([robot.range_of(command) for command in robot.command_coordinates])

    def scaled(poses: Poses) -> np.ndarray:
        return (poses.commands - ends.mean(axis=1)) / (0.5 * np.ptp(ends, axis=1))

    def kernel(a: np.ndarray, b: np.ndarray, drive: int) -> np.ndarray:
        squares = (a[:, None] - b) ** 2
        smooth = 0.25 * np.exp(-0.5 * squares.sum(axis=2) / 2.5**2)
        return 0.25 * (1.0 + a @ b.T) + smooth + 0.01 * np.exp(-0.5 * squares[:, :, drive] / 0.25**2)

    def left(poses: Poses) -> float:
        x, y = scaled(poses), scaled(tests)
        variances = []
        for drive in range(3):
            across = kernel(x, y, drive)
            known = np.linalg.solve(kernel(x, x, drive) + 0.05**2 * np.eye(len(x)), across)
            variances.append(np.mean(np.diagonal(kernel(y, y, drive)) - np.sum(across * known, axis=0)))
        return float(np.mean(variances))

    planned = left(problem.plan(15, "process-variance", np.random.default_rng(0)).poses)
    for other in ("random", "d-optimal", "least-sensitive"):
        assert planned < left(problem.plan(15, other, np.random.default_rng(0)).poses)  # type: ignore[arg-type]


def test_too_many_poses_for_their_distance(tripod_errors: GeometricErrors, tests: Poses) -> None:
    problem = PlanningProblem(tripod_errors, tests, min_distance=0.4)
    for strategy in ("space-filling", "process-variance"):
        with pytest.raises(InvalidValueError, match="distance"):
            problem.plan(30, strategy, np.random.default_rng(0))  # type: ignore[arg-type]


def test_parameters_alone_leave_what_the_formula_says(
    problem: PlanningProblem, tests: Poses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without waves: the mean of tr(P B M^-1 B^T P), P projects on correctable motions, B the motion by parameters."""
    monkeypatch.setattr(rehearsal, "WAVES", 0.0)
    chosen = problem.plan(12, "random", np.random.default_rng(3)).indices
    errors = problem.errors
    motion = sensitivities(errors, tests)
    weights = np.array([1.0, 1.0, 1.0, TIP_LENGTH, TIP_LENGTH, TIP_LENGTH])[:, None]
    rows = problem.regressor[chosen].reshape(-1, len(errors))
    covariance = np.linalg.inv(np.eye(len(errors)) + rows.T @ rows)
    squares = []
    for by_errors, by_commands in zip(motion.errors, motion.commands, strict=True):
        control = weights * by_commands
        effect = control @ np.linalg.pinv(control) @ (weights * by_errors * errors.tolerances)
        squares.append(np.trace(effect @ covariance @ effect.T))
    rehearsed = Rehearsal(problem, np.random.default_rng(0), machines=200).excess(chosen, "lm")
    assert rehearsed == pytest.approx(np.sqrt(np.mean(squares)), rel=0.08)


def test_unknown_springs_are_rehearsed(
    tripod_errors: GeometricErrors, mechanism: Robot, tests: Poses, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Under wrenches: the formula above, the deflection by each spring by finite differences of its stiffness."""
    monkeypatch.setattr(rehearsal, "WAVES", 0.0)
    candidates, tests = reachable_poses(mechanism, 60, np.random.default_rng(0)), tests[:20]
    wrenches = np.random.default_rng(1).uniform(-500.0, 500.0, (60, 6)) * [1.0, 1.0, 1.0, 0.1, 0.1, 0.1]
    problem = PlanningProblem(tripod_errors, candidates, tests, prior=1.0, wrenches=wrenches)
    springs = [entry["name"] for entry in mechanism.springs]
    weights = np.array([1.0, 1.0, 1.0, TIP_LENGTH, TIP_LENGTH, TIP_LENGTH])

    def by_springs(poses: Poses, loads: np.ndarray) -> np.ndarray:
        columns = []
        for name in springs:
            robots = (stiffened(mechanism, {name: float(np.exp(change))}) for change in (-1e-4, 1e-4))
            matrices = (compliance(robot, Poses(robot, poses.q), engine="pinocchio") for robot in robots)
            soft, stiff = (np.einsum("nij,nj->ni", matrix, loads) for matrix in matrices)
            columns.append((stiff - soft) / 2e-4)
        return np.stack(columns, axis=2) * 0.3  # a stiffness is known to a third beforehand

    chosen, motion = np.arange(0, 60, 4), sensitivities(tripod_errors, tests)
    of_candidates = sensitivities(tripod_errors, candidates[chosen]).errors * tripod_errors.tolerances
    loaded = np.concatenate([of_candidates, by_springs(candidates[chosen], wrenches[chosen])], axis=2)
    rows = (loaded / problem.instrument.sigmas[:, None]).reshape(-1, loaded.shape[2])
    covariance = np.linalg.inv(np.eye(loaded.shape[2]) + rows.T @ rows)
    effects = (
        np.concatenate([motion.errors * tripod_errors.tolerances, by_springs(tests, wrenches[:20])], axis=2)
        * weights[:, None]
    )
    squares = []
    for effect, by_commands in zip(effects, motion.commands, strict=True):
        control = weights[:, None] * by_commands
        undone = control @ np.linalg.pinv(control) @ effect
        squares.append(np.trace(undone @ covariance @ undone.T))
    rehearsed = Rehearsal(problem, np.random.default_rng(0), machines=200).excess(chosen, "lm")
    assert rehearsed == pytest.approx(np.sqrt(np.mean(squares)), rel=0.08)


def test_the_least_sensitive_region_is_that_of_all_sources(tripod_errors: GeometricErrors, mechanism: Robot) -> None:
    """By the sum of squares of the sources: 500 N sideways deflect the low poses least."""
    candidates = reachable_poses(mechanism, 60, np.random.default_rng(0))
    sources = ErrorSources(tripod_errors, wrench=[500.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    problem = PlanningProblem(tripod_errors, candidates, sources=sources)
    weights = np.array([1.0, 1.0, 1.0, TIP_LENGTH, TIP_LENGTH, TIP_LENGTH])
    found = sources.at(candidates)
    squares = np.sum((sum(source.shift for source in found) * weights) ** 2, axis=1)
    squares = squares + sum(np.sum((source.effects * weights[:, None]) ** 2, axis=(1, 2)) for source in found)
    np.testing.assert_array_equal(problem.least_sensitive, squares <= np.sort(squares)[11])
    alone = PlanningProblem(tripod_errors, candidates)
    heights = candidates.coordinates[:, 2]
    assert heights[problem.least_sensitive].mean() < heights[alone.least_sensitive].mean() - 0.03


@pytest.mark.usefixtures("small_networks")
def test_more_poses_are_better_for_every_method(problem: PlanningProblem) -> None:
    tried = Rehearsal(problem, np.random.default_rng(0), machines=2)
    for method, strategy in STRATEGY_OF_METHOD.items():
        plans = [problem.plan(count, strategy, np.random.default_rng(0), restarts=1).indices for count in (8, 20)]
        few, many = (tried.excess(plan, method) for plan in plans)
        assert 0.0 < many < few


def test_what_cannot_be_rehearsed(problem: PlanningProblem, tests: Poses) -> None:
    with pytest.raises(InvalidValueError, match="learn from"):
        Rehearsal(problem, np.random.default_rng(0), machines=1).excess([0, 1], "gp")
    with pytest.raises(InvalidValueError, match="machines"):
        Rehearsal(problem, np.random.default_rng(0), machines=0)
    seen = PlanningProblem(problem.errors, tests[:20], instrument=Instrument("position"))
    with pytest.raises(InvalidValueError, match="full poses"):
        Rehearsal(seen, np.random.default_rng(0))


def test_the_command(answer: Callable[..., dict[str, Any]], run: Callable[..., Any], tmp_path: Path) -> None:
    words = ("calibration-plan", "--candidates", "100", "--out", "plan.csv")
    result = answer(*words, "--method", "gp", "--accuracy", "3e-5", cwd=tmp_path)
    assert result["strategy"] == STRATEGY_OF_METHOD["gp"]
    counts = [int(count) for count in result["excess_tip_rms_by_poses_m"]]
    assert result["poses"] == counts[-1] == max(counts)
    *worse, last = result["excess_tip_rms_by_poses_m"].values()
    assert last <= 3e-5 < min(worse, default=1.0)
    assert run(*words, "--poses", "9", "--accuracy", "1e-5", cwd=tmp_path).returncode == 2
    assert run(*words, "--positions", "--method", "gp", cwd=tmp_path).returncode == 2
