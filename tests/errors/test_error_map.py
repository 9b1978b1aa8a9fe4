"""Error maps against simulated machines, exhaustive search and numerical optimisation of the commands."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
import scipy.optimize

from pm3dof_pin.errors.command_correction import best_commands
from pm3dof_pin.errors.error_map import ErrorMap, error_map, monte_carlo
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_error, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot


@pytest.fixture(scope="module")
def tripod_map(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> ErrorMap:
    return error_map(tripod_errors, tripod_nominal)


def test_root_sum_square_against_machines_with_closed_loops(
    tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """250 machines: the sampling error of an rms is about 1 / sqrt(2 * 250) at one pose, less over 40 together."""
    poses = tripod_nominal[:40]
    for distribution in ("normal", "uniform"):
        predicted = error_map(tripod_errors, poses, distribution=distribution)
        drawn = monte_carlo(tripod_errors, poses, 250, np.random.default_rng(0), distribution=distribution)
        ratio = drawn.tip_rms() / predicted.tip_rms
        assert abs(ratio.mean() - 1.0) < 0.03
        assert np.abs(ratio - 1.0).max() < 0.12
        covariance = np.einsum("kni,knj->nij", drawn.differences, drawn.differences) / 250
        weights = np.outer(tip_weights(), tip_weights()) / predicted.tip_rms[:, None, None] ** 2
        assert np.abs((covariance - predicted.covariance()) * weights).max() < 0.1


def test_the_worst_case_is_reached_in_a_corner_and_not_exceeded(tripod_errors: GeometricErrors) -> None:
    """All 64 corners of the tolerances of six parameters, by closed loops."""
    few = tripod_errors.select(tripod_errors.names[:30:5])
    poses = few.robot.forward([[0.26, 0.23, 0.24]])
    predicted = error_map(few, poses)
    corners = np.array(list(product([-1.0, 1.0], repeat=len(few)))) * few.tolerances
    reached = np.array(
        [
            pose_difference(poses.transforms, few.apply(p).forward(poses.commands, guess=poses.q).transforms)[0]
            for p in corners
        ]
    )
    np.testing.assert_allclose(
        np.abs(reached).max(axis=0), np.abs(predicted.effects[0]) @ predicted.greatest, rtol=5e-3
    )
    worst = tip_error(reached).max()
    assert 0.5 * predicted.worst_tip[0] < worst < 1.005 * predicted.worst_tip[0]


def test_what_commands_leave_is_what_an_optimiser_leaves(tripod_errors: GeometricErrors, tripod_map: ErrorMap) -> None:
    """The best commands, found by minimising the tip error of the closed loop itself."""
    rng = np.random.default_rng(3)
    for row in range(5):
        values = tripod_errors.sample(rng)
        machine, poses = tripod_errors.apply(values), tripod_map.poses[row : row + 1]

        def left(change: np.ndarray, machine: Robot = machine, poses: Poses = poses) -> np.ndarray:
            reached = machine.forward(poses.commands + change, guess=poses.q).transforms
            return (pose_difference(poses.transforms, reached) * tip_weights())[0]

        found = scipy.optimize.least_squares(left, np.zeros(3), xtol=1e-14, ftol=1e-14, gtol=1e-14, x_scale=1e-4)
        predicted = np.linalg.norm(tripod_map.uncompensable[row] @ values)
        assert np.linalg.norm(found.fun) == pytest.approx(predicted, rel=0.02)
        change = best_commands(
            tripod_map.sensitivities.commands[row : row + 1], tripod_map.sensitivities.errors[row : row + 1] @ values
        )
        np.testing.assert_allclose(change[0], found.x, atol=0.02 * np.abs(found.x).max())


def test_the_parts_are_at_right_angles(tripod_map: ErrorMap) -> None:
    np.testing.assert_allclose(tripod_map.compensable_rms**2 + tripod_map.uncompensable_rms**2, tripod_map.tip_rms**2)
    np.testing.assert_allclose(
        tripod_map.position_rms**2 + TIP_LENGTH**2 * tripod_map.orientation_rms**2, tripod_map.tip_rms**2
    )


def test_what_no_command_can_undo_is_in_the_middle(tripod_map: ErrorMap) -> None:
    """Errors of the legs move the platform in its three degrees of freedom; sideways the passive leg guides it."""
    legs = [k for k, p in enumerate(tripod_map.errors.parameters) if p.group in ("legs", "platform")]
    assert np.abs(tripod_map.uncompensable[:, :, legs]).max() < 1e-12
    ranking = tripod_map.ranking()
    assert sum(share.share for share in ranking) == pytest.approx(1.0)
    assert sum(share.uncompensable_share for share in ranking) == pytest.approx(1.0)
    assert (np.diff([share.share for share in ranking]) <= 1e-12).all()  # equal legs differ by rounding


def test_how_much_of_the_error_commands_can_undo(tripod_map: ErrorMap) -> None:
    """Three drives cannot correct six errors: between 40 and 70 % of the tip error remains, whatever the commands."""
    assert 0.4 < tripod_map.uncompensable_rms.mean() / tripod_map.tip_rms.mean() < 0.7


def test_six_drives_undo_everything() -> None:
    hexapod = Robot.load("hexapod")
    poses = reachable_poses(hexapod, 10, np.random.default_rng(0))
    result = error_map(GeometricErrors.load("hexapod"), poses)
    assert not result.uncompensable_rms.any()  # not rounding errors


def test_the_least_sensitive_region(tripod_map: ErrorMap) -> None:
    region = tripod_map.least_sensitive(0.1)
    assert region.sum() == 30
    assert tripod_map.tip_rms[region].max() < tripod_map.tip_rms[~region].min()
    with pytest.raises(InvalidValueError):
        tripod_map.least_sensitive(0.0)


def test_an_empty_map_is_refused(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    with pytest.raises(InvalidValueError, match="0 poses"):
        error_map(tripod_errors, tripod_nominal[:0])


def test_reachable_poses_are_within_limits_and_repeat(mechanism: Robot) -> None:
    poses, again = (reachable_poses(mechanism, 50, np.random.default_rng(5)) for _ in range(2))
    assert poses.within_limits.all()
    assert poses.q.tobytes() == again.q.tobytes()
    inner = reachable_poses(mechanism, 50, np.random.default_rng(5), margin=0.3)
    height = mechanism.single_joint("passive_slider_joint").q_index
    lower, upper = mechanism.lower_limits[height], mechanism.upper_limits[height]
    shares = (inner.q[:, height] - lower) / (upper - lower)
    assert shares.min() >= 0.3
    assert shares.max() <= 0.7
    assert sensitivities(GeometricErrors(mechanism, []), inner).errors.shape == (50, 6, 0)
