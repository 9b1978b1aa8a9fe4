"""Pose errors against exact angles, Pinocchio's logarithm and the chapter's explicit matrix."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy import cos, sin

from pm3dof_pin.chapter.kinematics import rotation
from pm3dof_pin.errors import pose_error
from pm3dof_pin.exceptions import InvalidValueError

ANGLES = [0.0, 1e-17, 1e-12, 1e-8, 1e-4, 0.5, 2.0, np.pi - 1e-4, np.pi - 1e-10, np.pi]


def _pose(turn: np.ndarray, position: np.ndarray) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = pin.exp3(turn), position
    return pose


@pytest.mark.parametrize("angle", ANGLES)
def test_angles_are_kept_to_the_last_digits(angle: float) -> None:
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    real = _pose(angle * axis, np.zeros(3))
    assert pose_error.orientation_error(np.eye(4), real) == pytest.approx(angle, rel=1e-12, abs=1e-15)
    vector = pose_error.rotation_vector(real[:3, :3])
    assert np.linalg.norm(vector) == pytest.approx(angle, rel=1e-12, abs=1e-15)
    if 0.0 < angle < np.pi - 1e-9:
        np.testing.assert_allclose(vector / angle, axis, atol=1e-9)


def test_it_is_the_angle_between_any_two_poses() -> None:
    rng = np.random.default_rng(0)
    first, turn = pin.exp3(rng.normal(size=3)), np.array([3e-7, 4e-7, 0.0])
    ideal, real = np.eye(4), np.eye(4)
    ideal[:3, :3], real[:3, :3] = first, pin.exp3(turn) @ first
    real[:3, 3] = [0.003, 0.004, 0.0]
    assert pose_error.orientation_error(ideal, real) == pytest.approx(5e-7, rel=1e-8)
    assert pose_error.position_error(ideal, real) == pytest.approx(0.005)
    assert pose_error.energy(ideal, real, eta=200.0) == pytest.approx(0.005 + 1e-4)
    np.testing.assert_allclose(pose_error.pose_difference(ideal, real), [0.003, 0.004, 0.0, *turn], atol=1e-15)
    assert pose_error.tip_error([3.0, 0.0, 0.0, 0.0, 8.0, 0.0], eta=0.5) == pytest.approx(5.0)


def test_differences_add_up_again() -> None:
    rng = np.random.default_rng(1)
    turns = rng.normal(size=(50, 3)) * np.logspace(-12, 0, 50)[:, None]
    ideal = np.array([_pose(rng.normal(size=3), rng.normal(size=3)) for _ in turns])
    steps = np.concatenate([rng.normal(size=(50, 3)), turns], axis=1)
    np.testing.assert_allclose(
        pose_error.pose_difference(ideal, pose_error.moved_pose(ideal, steps)), steps, atol=1e-14
    )
    np.testing.assert_allclose(pose_error.rotation_matrix(turns), [pin.exp3(turn) for turn in turns], atol=1e-15)


def test_quaternions_are_pinocchios() -> None:
    rng = np.random.default_rng(2)
    for turn in rng.normal(size=(100, 3)) * 3.0:
        x, y, z, w = pin.Quaternion(pin.exp3(turn)).coeffs() * np.sign(pin.Quaternion(pin.exp3(turn)).w)
        np.testing.assert_allclose(pose_error.quaternion(pin.exp3(turn)), [w, x, y, z], atol=1e-14)
        many = 3.0 * np.array([[[w, x, y, z]], [[-w, -x, -y, -z]]])
        np.testing.assert_allclose(pose_error.rotation_of_quaternion(many)[:, 0], [pin.exp3(turn)] * 2, atol=1e-14)


@pytest.mark.parametrize("angle", [0.0, 1e-12, 1e-6, 1.999e-3, 2.001e-3, 0.5, 3.0])
def test_the_derivative_of_the_rotation_vector_is_pinocchios(angle: float) -> None:
    axes = np.random.default_rng(4).normal(size=(9, 3))
    turns = np.array([pin.exp3(angle * axis / np.linalg.norm(axis)) for axis in axes])
    rates = pose_error.rotation_vector_rates(turns.reshape(3, 3, 3, 3)).reshape(9, 3, 3)
    np.testing.assert_allclose(rates, [pin.Jlog3(turn) for turn in turns], atol=1e-10)


def test_the_matrix_of_8_12_with_its_erratum() -> None:
    psi, theta, phi = 0.4, -0.7, 1.1
    printed = [
        [cos(psi) * cos(theta), cos(psi) * sin(theta) * sin(phi) - sin(psi) * cos(phi),
         cos(psi) * sin(theta) * cos(phi) + sin(psi) * sin(phi)],
        [sin(psi) * cos(theta), sin(psi) * sin(theta) * sin(phi) + cos(psi) * cos(phi),
         sin(psi) * sin(theta) * cos(phi) - cos(psi) * sin(phi)],
        [-sin(theta), cos(theta) * sin(phi), cos(theta) * cos(phi)],
    ]  # fmt: skip
    np.testing.assert_allclose(pose_error.chapter_rotation([psi, theta, phi]), printed, atol=1e-15)
    np.testing.assert_allclose(pose_error.chapter_angles(printed), [psi, theta, phi], atol=1e-15)


def test_the_angles_of_the_tripod() -> None:
    """Relations of the errata: theta = asin(c_x s_y), psi = atan2(s_x s_y, c_y), phi = atan2(s_x, c_x c_y)."""
    x, y = np.random.default_rng(3).uniform(-0.8, 0.8, (2, 100))
    expected = [np.arctan2(sin(x) * sin(y), cos(y)), np.arcsin(cos(x) * sin(y)), np.arctan2(sin(x), cos(x) * cos(y))]
    np.testing.assert_allclose(pose_error.chapter_angles(rotation(x, y)), np.transpose(expected), atol=1e-14)


def test_arguments_are_checked() -> None:
    with pytest.raises(InvalidValueError, match=r"\(\.\.\., 4, 4\)"):
        pose_error.position_error(np.zeros(3), np.zeros(3))
    with pytest.raises(InvalidValueError, match="eta"):
        pose_error.energy(np.eye(4), np.eye(4), eta=-1.0)


def test_a_reflection_is_no_orientation() -> None:
    mirror = np.diag([1.0, 1.0, -1.0, 1.0])
    with pytest.raises(InvalidValueError, match="reflection"):
        pose_error.orientation_error(np.eye(4), mirror)
