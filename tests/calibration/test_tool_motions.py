"""Only the declared motions of a tool count in tip errors, and with eta = 0 no orientation does."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.pseudo_error import seen_errors
from pm3dof_pin.calibration.refusals import refusals
from pm3dof_pin.calibration.scatter import Scatter
from pm3dof_pin.errors.error_map import error_map
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.error_sums import kinematic_sum
from pm3dof_pin.errors.pose_error import tip_error, tip_weights
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import circle_of_targets
from pm3dof_pin.measuring.measurements import Measurements

FIVE_BAR = Path(__file__).parents[1] / "machines" / "five_bar"


@pytest.fixture(scope="module")
def pen() -> Robot:
    return Robot.load(FIVE_BAR).replace(tool_motions=("x", "y"))


@pytest.fixture(scope="module")
def poses(pen: Robot) -> Poses:
    return reachable_poses(pen, 20, np.random.default_rng(2))


def test_what_is_not_declared_has_no_weight() -> None:
    np.testing.assert_array_equal(tip_weights(0.2, ("z", "rx", "ry")), [0.0, 0.0, 1.0, 0.2, 0.2, 0.0])
    assert tip_error([3.0, 4.0, 5.0, 6.0, 7.0, 8.0], 0.1, ("x", "y")) == pytest.approx(5.0)


@pytest.mark.usefixtures("programs_for_few_poses")
def test_maps_count_declared_motions(pen: Robot, poses: Poses) -> None:
    errors = closable(GeometricErrors(pen), poses)
    found = error_map(errors, poses)
    moved = found.sensitivities.errors[:, :2] * errors.tolerances
    expected = np.sqrt(np.sum(moved**2, axis=(1, 2)))
    assert np.abs(found.sensitivities.errors[:, 2:]).max() > 0.1
    np.testing.assert_allclose(found.tip_rms, expected, rtol=1e-12)
    np.testing.assert_allclose(kinematic_sum(ErrorSources(errors), poses, "tip_rms").values, expected, rtol=1e-9)


def test_the_pen_of_a_five_bar_is_corrected_to_where_it_is_wanted(pen: Robot, poses: Poses) -> None:
    """Two drives bring it there exactly, whatever its coupler's orientation."""
    errors = closable(GeometricErrors(pen), poses)
    truth = errors.sample(np.random.default_rng(3))
    answer = Compensation(errors, truth, np.zeros((len(errors), len(errors)))).compensate(poses)
    reached = errors.apply(truth).forward(answer.commands, guess=poses.q)
    np.testing.assert_allclose(reached.positions[:, :2], poses.positions[:, :2], atol=1e-9)
    assert answer.predicted_error.max() < 1e-9


def test_a_scatter_has_no_part_that_does_not_count() -> None:
    counted = np.array([1.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    generator, sigma = np.random.default_rng(1), 2e-5
    errors = sigma * generator.standard_normal((4000, 6)) * counted
    shown = np.tile(np.diag(counted), (4000, 1, 1))
    found = Scatter.from_errors(
        errors, 1e-6 * sigma**2 * shown, shown, np.zeros((4000, 6, 2)), ("rad", "rad"), counted=counted > 0.0
    )
    assert found.tip_error == pytest.approx(np.sqrt(2.0) * sigma, rel=0.05)
    np.testing.assert_allclose(
        found.covariances(np.zeros((1, 6, 2))), sigma**2 * np.diag(counted)[None], atol=0.1 * sigma**2
    )


def test_without_weight_the_position_remains(tripod_nominal: Poses) -> None:
    """Of full poses, and of four targets, which show it as their mean does."""
    poses = tripod_nominal[:8]
    shift = 1e-5 * np.random.default_rng(4).standard_normal((8, 3))
    full = Measurements.from_poses(poses.commands, poses.transforms)
    seen = replace(full, positions=full.positions + shift)
    found = seen_errors(seen, poses, 0.0)
    np.testing.assert_allclose(found.errors, np.hstack([shift, np.zeros((8, 3))]), atol=1e-15)
    rows = np.repeat(np.arange(8), 4)
    points = np.tile(circle_of_targets(4), (8, 1))
    at = poses.positions[rows] + np.einsum("nij,nj->ni", poses.rotations[rows], points) + shift[rows]
    targets = Measurements(poses.commands[rows], at, None, np.full((32, 3), 1e-5), points)
    found = seen_errors(targets, poses, 0.0)
    np.testing.assert_allclose(found.errors[:, :3], shift, atol=1e-12)
    expected = np.zeros((8, 6, 6))
    expected[:, range(3), range(3)] = 1e-10 / 4.0
    np.testing.assert_allclose(found.covariances, expected, atol=1e-16)


def test_a_ballbar_above_the_plane_of_a_pen_shows_it(pen: Robot, poses: Poses) -> None:
    """The height, which is not declared, explains its part of a distance: h / d of it along the bar."""
    centre = np.array([0.1, 0.9, 0.3])
    bars = poses.positions - centre
    distances = np.linalg.norm(bars, axis=1)
    sigmas = np.full((len(poses), 3), np.inf)
    sigmas[:, 0] = 1e-6
    off = 1e-4
    seen = Measurements(
        poses.commands,
        poses.positions,
        None,
        sigmas,
        np.zeros((len(poses), 3)),
        distances=distances + off,
        origins=np.tile(centre, (len(poses), 1)),
        partners=np.full(len(poses), -1),
    )
    expected = off * bars / distances[:, None] * [1.0, 1.0, 0.0]
    np.testing.assert_allclose(seen_errors(seen, poses).errors[:, :3], expected, atol=1e-12)


@pytest.mark.filterwarnings("error")
@pytest.mark.usefixtures("few_folds")
def test_eta_of_zero_calibrates_positions(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    truth = tripod_errors.sample(np.random.default_rng(8))
    nominal = tripod_nominal[:20]
    reached = tripod_errors.apply(truth).forward(nominal.commands, guess=nominal.q)
    seen = Measurements.from_poses(nominal.commands, reached.transforms)
    found = fit(seen, tripod_errors, Options("lm", eta=0.0), quiet=True)
    held_out = HeldOut.from_cross_validation(found)
    assert refusals(found, held_out) == []
    off = np.linalg.norm(reached.positions - nominal.positions, axis=1)
    np.testing.assert_allclose(held_out.before, off, rtol=1e-6)
    assert held_out.floor.mean() < held_out.after.mean() < 1.02 * held_out.floor.mean()
