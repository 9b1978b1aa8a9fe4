"""Tolerance allocation against the closed form at one pose, the conditions of an optimum, and random search."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from pm3dof_pin.errors.error_map import ErrorMap, error_map, monte_carlo
from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter
from pm3dof_pin.errors.tolerances import Rule, allocate_tolerances
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses

TARGET = 1e-4


@pytest.fixture(scope="module")
def tripod_map(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> ErrorMap:
    return error_map(tripod_errors, tripod_nominal)


def _squares(errors: ErrorMap) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Effect of each class on the squared tip error at each pose, and its number of parameters times tolerance."""
    labels = [f"{p.group} [{p.unit}]" for p in errors.errors.parameters]
    names = list(dict.fromkeys(labels))
    each = np.sum((errors.sensitivities.errors * np.repeat([1.0, 0.1], 3)[:, None]) ** 2, axis=1)
    squares = np.array([each[:, [label == name for label in labels]].sum(axis=1) for name in names]).T
    costs = np.array(
        [
            sum(p.tolerance for p, label in zip(errors.errors.parameters, labels, strict=True) if label == n)
            for n in names
        ]
    )
    return squares, costs, names


@pytest.mark.parametrize("rule", ["equal_contributions", "least_cost"])
@pytest.mark.parametrize("compensated", [False, True])
def test_the_target_is_met_and_just_met(tripod_map: ErrorMap, rule: Rule, compensated: bool) -> None:
    allocation = allocate_tolerances(tripod_map, TARGET, rule, compensated=compensated)
    assert allocation.tip_rms.max() == pytest.approx(TARGET, rel=1e-9)
    assert sum(allocation.shares.values()) == pytest.approx(1.0)


def test_at_one_pose_the_least_cost_has_a_closed_form(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """min sum c / t under sum a t^2 = T^2: t = (c / a)^(1/3) times a constant, by Lagrange."""
    one = error_map(tripod_errors, tripod_nominal[:1])
    squares, costs, names = _squares(one)
    shape = np.cbrt(costs / squares[0])
    expected = shape * TARGET / np.sqrt(squares[0] @ shape**2)
    allocation = allocate_tolerances(one, TARGET, "least_cost")
    np.testing.assert_allclose([allocation.tolerances[name] for name in names], expected, rtol=1e-5)
    assert allocation.cost == pytest.approx(np.sum(costs / expected))


def test_over_the_workspace_nothing_cheaper_is_found(tripod_map: ErrorMap) -> None:
    squares, costs, names = _squares(tripod_map)
    best = allocate_tolerances(tripod_map, TARGET, "least_cost")
    tolerances = np.array([best.tolerances[name] for name in names])
    assert best.cost <= allocate_tolerances(tripod_map, TARGET, "equal_contributions").cost
    rng = np.random.default_rng(0)
    for spread in (1e-3, 1e-2, 0.1, 0.5):
        for _ in range(500):
            other = tolerances * np.exp(spread * rng.standard_normal(len(names)))
            other *= TARGET / np.sqrt((squares @ other**2).max())
            assert np.sum(costs / other) > best.cost * (1.0 - 1e-7)


def test_machines_made_to_the_tolerances_are_as_good_as_wanted(tripod_map: ErrorMap) -> None:
    best = allocate_tolerances(tripod_map, TARGET, "least_cost")
    made = [
        GeometricParameter(p.name, p.place, p.motion, p.axis, p.group, best.tolerances[f"{p.group} [{p.unit}]"])
        for p in tripod_map.errors.parameters
    ]
    errors = GeometricErrors(tripod_map.errors.robot, made)
    worst = tripod_map.poses[[np.argmax(best.tip_rms)]]
    drawn = monte_carlo(errors, worst, 250, np.random.default_rng(1))
    assert drawn.tip_rms()[0] == pytest.approx(TARGET, rel=0.1)


def test_no_target_is_refused(tripod_map: ErrorMap) -> None:
    with pytest.raises(InvalidValueError, match="target"):
        allocate_tolerances(tripod_map, 0.0, "least_cost")


@pytest.mark.parametrize("distribution", ["normal", "uniform"])
def test_as_many_machines_as_said_stay_within_the_target_everywhere(
    distribution: str, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """Closed loops of machines with the allocated tolerances; for the root mean square most exceed it somewhere."""
    poses = tripod_nominal[:40]
    mapped = error_map(tripod_errors, poses, distribution=distribution)  # type: ignore[arg-type]
    outside = {}
    for coverage, machines in ((0.95, 150), (None, 40)):
        allocated = allocate_tolerances(mapped, TARGET, "least_cost", coverage=coverage).tolerances
        finite = {name: min(value, 1.0) for name, value in allocated.items()}
        narrowed = GeometricErrors(
            tripod_errors.robot,
            [replace(p, tolerance=finite[f"{p.group} [{p.unit}]"]) for p in tripod_errors.parameters],
        )
        drawn = monte_carlo(narrowed, poses, machines, np.random.default_rng(5), distribution=distribution)  # type: ignore[arg-type]
        tips = np.linalg.norm(drawn.differences * np.repeat([1.0, 0.1], 3), axis=2)
        outside[coverage] = float(np.mean(tips.max(axis=1) > TARGET))
    assert 0.005 <= outside[0.95] <= 0.1  # 150 machines tell 5 % to 1.8 %
    assert outside[None] > 0.4


def test_half_widths_are_half_widths(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    normal, uniform = (
        allocate_tolerances(
            error_map(tripod_errors, tripod_nominal[:50], distribution=kind), TARGET, "least_cost"
        ).tolerances
        for kind in ("normal", "uniform")
    )
    for name, sigma in normal.items():
        assert uniform[name] == pytest.approx(np.sqrt(3.0) * sigma, rel=1e-6)


def test_a_target_in_micrometres_is_refused(tripod_map: ErrorMap) -> None:
    with pytest.raises(InvalidValueError, match="100 µm are 1e-4"):
        allocate_tolerances(tripod_map, 100.0, "least_cost")


def test_the_bound_at_a_pose_covers(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    poses = tripod_nominal[:20]
    bound = error_map(tripod_errors, poses).tip_bound(0.95)
    drawn = monte_carlo(tripod_errors, poses, 250, np.random.default_rng(2))
    within = np.linalg.norm(drawn.differences * np.repeat([1.0, 0.1], 3), axis=2) <= bound
    assert within.mean() == pytest.approx(0.95, abs=0.02)
