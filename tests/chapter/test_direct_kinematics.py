"""Direct kinematics: round trip, quadratic convergence, every assembly mode."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.direct_kinematics import all_assembly_modes, direct_kinematics, newton
from pm3dof_pin.chapter.kinematics import inverse_kinematics
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError


def test_way_back_over_the_whole_workspace(tripod: Tripod, reachable_poses: np.ndarray) -> None:
    poses = direct_kinematics(tripod, inverse_kinematics(tripod, reachable_poses))
    np.testing.assert_allclose(poses, reachable_poses, rtol=0, atol=1e-11)


def test_convergence_is_quadratic(tripod: Tripod) -> None:
    """Stopped one step later each time, the error falls quadratically: e_(k+1) <= C e_k^2 with one C."""
    pose = np.array([0.6, -0.5, 0.47])
    u = inverse_kinematics(tripod, pose)
    errors = []
    for steps in range(1, 7):
        stopped = newton(tripod, u, most_steps=steps)
        errors.append(np.abs(stopped.poses - pose).max())
    useful = [(a, b) for a, b in itertools.pairwise(errors) if 1e-7 < a < 0.05]
    assert len(useful) >= 2
    assert all(b < 2.0 * a**2 for a, b in useful)


def test_all_modes_close_the_loops_and_contain_the_pose(tripod: Tripod, reachable_poses: np.ndarray) -> None:
    for pose in reachable_poses[:30]:
        u = inverse_kinematics(tripod, pose)
        modes = all_assembly_modes(tripod, u)
        assert len(modes) % 2 == 0
        assert np.abs(modes - pose).max(axis=1).min() < 1e-9
        assert np.all(newton(tripod, u, modes).residual < 1e-13)


def multistart(tripod: Tripod, u: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Every solution that Newton's method finds from 6,000 random starts, sorted by height."""
    spread = np.array([np.pi, np.pi, 0.8])
    result = newton(tripod, u, generator.uniform(-1.0, 1.0, (6_000, 3)) * spread)
    poses = result.poses[result.converged]
    turned = np.concatenate([np.cos(poses[:, :2]), np.sin(poses[:, :2]), poses[:, 2:]], axis=1)
    found: list[np.ndarray] = []
    for candidate in turned:
        if all(np.abs(candidate - other).max() > 1e-6 for other in found):
            found.append(candidate)
    return np.array(sorted(found, key=lambda entry: -entry[4]))


@pytest.mark.parametrize("case", range(12))
def test_all_modes_are_those_of_many_random_starts(tripod: Tripod, case: int) -> None:
    generator = np.random.default_rng(case)
    home = tripod.parameters.slider_home
    u = np.full(3, home) if case == 0 else home + generator.uniform(-0.085, 0.085, 3)
    if case == 1:
        u[2] = u[0]  # mirror-symmetric
    modes = all_assembly_modes(tripod, u)
    expected = multistart(tripod, u, generator)
    turned = np.concatenate([np.cos(modes[:, :2]), np.sin(modes[:, :2]), modes[:, 2:]], axis=1)
    assert len(turned) == len(expected)
    for mode in turned:
        assert np.abs(expected - mode).max(axis=1).min() < 1e-6


def test_travels_that_cannot_be_assembled(tripod: Tripod) -> None:
    apart = [-2.0, 0.24, 3.0]
    assert len(all_assembly_modes(tripod, apart)) == 0
    with pytest.raises(ConvergenceError, match=r"direct kinematics at u = \(-2, 0.24, 3\) m.*residual"):
        direct_kinematics(tripod, apart)


def test_newton_tells_which_of_many_failed(tripod: Tripod) -> None:
    result = newton(tripod, [[0.24, 0.24, 0.24], [-2.0, 0.24, 3.0]])
    np.testing.assert_array_equal(result.converged, [True, False])
    assert result.residual[1] > 1e-3


@pytest.mark.parametrize("u", [[0.24, 0.24], [np.nan, 0.24, 0.24], 0.24])
def test_nonsense_travels_are_refused(tripod: Tripod, u: object) -> None:
    with pytest.raises(InvalidValueError, match=r"^u "):
        direct_kinematics(tripod, u)  # type: ignore[arg-type]
    with pytest.raises(InvalidValueError, match=r"^u "):
        all_assembly_modes(tripod, u)  # type: ignore[arg-type]


def test_a_machine_with_four_legs_and_travels_that_do_not_fit(tripod: Tripod) -> None:
    angles = np.radians([0.0, 90.0, 180.0, 270.0])
    four = Tripod(dataclasses.replace(tripod.parameters, base_joint_angles=angles, platform_joint_angles=angles))
    u = inverse_kinematics(four, [0.1, -0.2, 0.5])
    np.testing.assert_allclose(direct_kinematics(four, u), [0.1, -0.2, 0.5], atol=1e-11)
    with pytest.raises(ConvergenceError, match=r"u = \(1, 0, 0, 0\) m did not converge"):
        direct_kinematics(four, [1.0, 0.0, 0.0, 0.0])


def test_all_legs_count_where_the_first_three_do_not_tell_the_pose(tripod: Tripod) -> None:
    """Two of them are one beside the other."""
    angles = np.radians([0.0, 0.0, 120.0, 240.0])
    four = Tripod(dataclasses.replace(tripod.parameters, base_joint_angles=angles, platform_joint_angles=angles))
    u = inverse_kinematics(four, [0.1, -0.2, 0.5])
    np.testing.assert_allclose(direct_kinematics(four, u), [0.1, -0.2, 0.5], atol=1e-11)
