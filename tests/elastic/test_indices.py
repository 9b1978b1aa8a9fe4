"""Indices of K against their definitions: displacements under loads, and matrices with known spectra."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.elastic.indices import (
    axis_stiffness,
    characteristic_length,
    condensed_stiffness,
    condition_number,
    eigenvalues,
    principal_axes,
)
from pm3dof_pin.exceptions import InvalidValueError


@pytest.fixture(scope="module")
def matrices(tripod: Tripod, reachable_poses: np.ndarray) -> np.ndarray:
    return elastic_stiffness(tripod, reachable_poses[:200])


def test_compliance_inverts_stiffness(matrices: np.ndarray) -> None:
    inverse = inverse_definite(matrices)
    scale = np.sqrt(np.einsum("nii->ni", matrices))
    product = np.einsum("nij,njk->nik", matrices, inverse) / scale[:, :, None] * scale[:, None, :]
    np.testing.assert_allclose(product, np.broadcast_to(np.eye(6), product.shape), atol=1e-9)
    np.testing.assert_allclose(inverse_definite(inverse), matrices, rtol=1e-9, atol=1e-9 * matrices.max())
    np.testing.assert_array_equal(inverse, np.swapaxes(inverse, 1, 2))


def test_probe_at_the_centre_of_the_section(tripod: Tripod) -> None:
    """The leg springs in series: three links of equal inclination, k = 1 / (c^2 / k_a + 1 / k_t), 3 k n_z^2."""
    u = np.linspace(0.155, 0.325, 200_001)
    h = 0.37425 - u * np.cos(np.radians(50.0)) - 0.075
    heights = u * np.sin(np.radians(50.0)) + np.sqrt(0.353**2 - h**2) - 0.013
    h = np.interp(tripod.middle_height, heights, h)
    n_z = np.sqrt(1.0 - (h / 0.353) ** 2)
    cosine = h / 0.353 * np.cos(np.radians(50.0)) + n_z * np.sin(np.radians(50.0))
    expected = 3.0 * n_z**2 / (cosine**2 / 9.5950e7 + 1.0 / 1.5177e10)
    matrix = elastic_stiffness(tripod, [0.0, 0.0, tripod.middle_height])
    assert 1.0 / inverse_definite(matrix)[2, 2] == pytest.approx(expected, rel=1e-8)
    assert expected == pytest.approx(2.5e8, rel=0.02)


def test_condensed_blocks(matrices: np.ndarray) -> None:
    """Free: a pure force's displacement; held: the force that a pure translation needs."""
    force = np.array([1.0, -2.0, 0.5])
    for matrix in matrices[:20]:
        displacement = np.linalg.solve(matrix, np.concatenate([force, np.zeros(3)]))[:3]
        np.testing.assert_allclose(condensed_stiffness(inverse_definite(matrix)) @ displacement, force, rtol=1e-7)
        held = condensed_stiffness(inverse_definite(matrix), "rotation", "held")
        np.testing.assert_allclose(held, matrix[3:, 3:], rtol=1e-8, atol=1e-8 * matrix[3:, 3:].max())


def test_ellipsoid_of_a_known_matrix() -> None:
    turn = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]
    result = principal_axes(turn @ np.diag([5.0, 1.0, 3.0]) @ turn.T)
    np.testing.assert_allclose(result.values, [1.0, 3.0, 5.0])
    assert abs(result.axes[:, 0] @ turn[:, 1]) == pytest.approx(1.0)
    assert np.linalg.det(result.axes) == pytest.approx(1.0)


def test_eigenvalues_at_a_characteristic_length() -> None:
    matrix = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])
    np.testing.assert_allclose(eigenvalues(matrix, 0.5), [1.0, 2.0, 3.0, 16.0, 20.0, 24.0])
    assert condition_number(matrix, 0.5) == pytest.approx(24.0)
    assert characteristic_length(matrix) == pytest.approx(np.sqrt(15.0 / 6.0))


def test_a_free_motion_has_no_compliance() -> None:
    """Rank 5, and rank 5 to rounding with entries of very different units."""
    vectors = np.random.default_rng(1).normal(size=(5, 6)) * [1e5, 1e5, 1e5, 1e2, 1e2, 1.0]
    assert np.all(np.isnan(inverse_definite(vectors.T @ vectors)))
    assert np.all(np.isnan(inverse_definite(np.diag([1.0, 1.0, 1.0, 1.0, 1.0, 0.0]))))


def test_poses_out_of_reach_stay_nan(matrices: np.ndarray) -> None:
    some = matrices[:3].copy()
    some[1] = np.nan
    for values in (inverse_definite(some), eigenvalues(some, 0.1), principal_axes(some[:, :3, :3]).values):
        assert np.all(np.isnan(values[1]))
        assert np.all(np.isfinite(values[[0, 2]]))


def test_a_length_of_nothing_is_refused(matrices: np.ndarray) -> None:
    with pytest.raises(InvalidValueError, match="length"):
        eigenvalues(matrices, 0.0)


def test_where_all_axes_of_a_kind_are_rigid_the_other_kind_tells() -> None:
    """A compliance of 1e-15 m/N beside 1 rad/(N m) is that of a spring; one of 1e-33, of 1e-17 m, is rounding."""
    diagonals = np.array([[1e-15, 2e-15, 1e-15, 1.0, 1.0, 2.0], [1e-33, 2e-33, 0.0, 1.0, 1.0, 2.0]])
    expected = [[1e15, 5e14, 1e15, 1.0, 1.0, 0.5], [np.inf, np.inf, np.inf, 1.0, 1.0, 0.5]]
    np.testing.assert_allclose(axis_stiffness(diagonals, 0.3), expected, rtol=1e-12)
    turned = np.roll(diagonals, 3, axis=1)
    np.testing.assert_allclose(axis_stiffness(turned, 0.3), np.roll(expected, 3, axis=1), rtol=1e-12)


def test_rigid_axes_are_judged_by_their_own_kind_at_every_pose() -> None:
    """Lateral compliances of 1e-8 m/N beside rotations of 1e-4 rad/(N m), whose rounding errors may be as large."""
    diagonals = np.tile([1e-8, 2e-8, 1e-21, 1e-4, 5e-17, 2e-4], (2, 3, 1))
    diagonals[1] *= 10.0
    expected = np.tile([1e8, 5e7, np.inf, 1e4, np.inf, 5e3], (2, 3, 1))
    expected[1] /= 10.0
    np.testing.assert_allclose(axis_stiffness(diagonals), expected, rtol=1e-12)
