"""Measurements in the instrument's own frame: the base is found in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.registration import register
from pm3dof_pin.simulation.worlds import World

BASE = pin.SE3(pin.exp3(np.array([0.4, -1.9, 0.8])), np.array([2.1, -0.7, 1.3]))
"""Placement of the base in the frame of the instrument."""


def seen_from(base: pin.SE3, measurements: Measurements) -> Measurements:
    assert measurements.rotations is not None
    poses = np.tile(np.eye(4), (len(measurements), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = measurements.rotations, measurements.positions
    return Measurements.from_poses(measurements.commands, base.homogeneous @ poses)


@pytest.fixture(scope="module")
def described(tripod_nominal: Poses) -> Measurements:
    """A machine without errors."""
    return Measurements.from_poses(tripod_nominal.commands[:20], tripod_nominal.transforms[:20])


def test_the_base_is_found_to_rounding(described: Measurements) -> None:
    seen = seen_from(BASE, described)
    assert seen.rotations is not None
    found = register(seen.positions, described.positions, seen.rotations, described.rotations)
    np.testing.assert_allclose(found.base, BASE.homogeneous, atol=1e-12)
    np.testing.assert_allclose(found.rotations(seen.rotations), described.rotations, atol=1e-12)
    assert found.residual < 1e-12


def test_a_row_far_off_does_not_move_it(described: Measurements) -> None:
    seen = seen_from(BASE, described)
    seen.positions[4] += [0.0, 0.3, -0.2]
    assert seen.rotations is not None
    found = register(seen.positions, described.positions, seen.rotations, described.rotations)
    np.testing.assert_allclose(found.base, BASE.homogeneous, atol=1e-12)


def test_points_alone_tell_it_unless_they_lie_on_a_line() -> None:
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (12, 3))
    found = register(points @ BASE.rotation.T + BASE.translation, points)
    np.testing.assert_allclose(found.base, BASE.homogeneous, atol=1e-12)
    line = np.outer(np.linspace(0.0, 1.0, 12), [0.1, 0.2, 0.3])
    with pytest.raises(InvalidValueError, match="on one line"):
        register(line @ BASE.rotation.T, line)


def test_noise_turns_with_the_axes() -> None:
    """A quarter turn about z exchanges x and y; any rotation keeps the sum of the variances."""
    turned = register(np.eye(3) @ pin.exp3(np.array([0.0, 0.0, np.pi / 2])), np.eye(3))
    np.testing.assert_allclose(turned.sigmas(np.array([[1.0, 2.0, 3.0]])), [[2.0, 1.0, 3.0]], atol=1e-9)
    any_way = register(np.eye(3) @ BASE.rotation, np.eye(3))
    sigmas = np.array([[1.0, 2.0, 3.0, 4.0, 5.0, 6.0]])
    squares = any_way.sigmas(sigmas).reshape(2, 3) ** 2
    np.testing.assert_allclose(squares.sum(axis=1), [14.0, 77.0])
    # of independent errors along the instrument's axes, the diagonal of R S R^T in those of the base
    turn = BASE.rotation  # takes what was seen, the rows of B, to unit vectors
    expected = [np.diag(turn @ np.diag(part**2) @ turn.T) for part in sigmas.reshape(2, 3)]
    np.testing.assert_allclose(squares, expected, rtol=1e-9)


def test_a_base_found_elsewhere_in_its_own_axes() -> None:
    """What is at p in the first base is at M^-1 p in the one at M in it."""
    places = np.random.default_rng(0).normal(size=(5, 3))
    found = register(np.array([BASE.act(place) for place in places]), places)
    twist = np.array([0.3, -0.2, 0.5, 0.4, 1.1, -0.7])
    motion = pin.SE3(pin.exp3(twist[3:]), twist[:3])
    moved = found.moved(twist)
    seen = np.array([BASE.act(place) for place in places])
    np.testing.assert_allclose(moved.positions(seen), [motion.actInv(place) for place in places], atol=1e-9)
    np.testing.assert_allclose(moved.base, (BASE * motion).homogeneous, atol=1e-9)


@pytest.mark.usefixtures("few_folds")
def test_a_calibration_is_as_good_from_anywhere(
    tripod_errors: GeometricErrors, tripod_nominal: Poses, tmp_path: Path
) -> None:
    """Tip accuracy achievable by commands, by cross-validation, against a measurement in the base frame."""
    world = World.random("geometry", tripod_errors, np.random.default_rng(2))
    at_base = world.measure(tripod_nominal.commands[:24], np.random.default_rng(3))
    path = write_measurements(seen_from(BASE, at_base), tripod_errors.robot, tmp_path / "tracker.csv")
    elsewhere = read_measurements(path, tripod_errors.robot, own_frame=True)
    assert elsewhere.registration is not None
    # the base is found, except for errors that move everything alike
    np.testing.assert_allclose(elsewhere.registration.base, BASE.homogeneous, atol=5e-3)
    excess = [
        np.sqrt(np.mean(HeldOut.from_cross_validation(fit(measured, tripod_errors, Options("lm"))).excess ** 2))
        for measured in (at_base, elsewhere)
    ]
    assert excess[1] < 1.2 * excess[0]


def test_millimetres_and_the_frame_of_the_base_are_still_told(
    described: Measurements, tripod_errors: GeometricErrors, tmp_path: Path
) -> None:
    seen = seen_from(BASE, described)
    path = write_measurements(seen, tripod_errors.robot, tmp_path / "file.csv")
    assert "other axes" in read_measurements(path, tripod_errors.robot).warnings[0]
    seen.positions[:] *= 1000.0
    path = write_measurements(seen, tripod_errors.robot, tmp_path / "file.csv")
    with pytest.raises(MeasurementError, match="look like millimetres"):
        read_measurements(path, tripod_errors.robot, own_frame=True)
