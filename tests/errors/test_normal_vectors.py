"""Quantiles of the length of normal vectors, against chi square distributions and the cumulants of their sum."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.stats

from pm3dof_pin.errors.normal_vectors import covariance_root, expected_norm, norm_quantiles
from pm3dof_pin.exceptions import InvalidValueError


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_equal_deviations_without_a_mean_are_exact(probability: float) -> None:
    """|x|^2 / s is chi square with as many degrees of freedom as x has entries."""
    for size, spread in ((3, 4.0), (6, 1e-10)):
        found = norm_quantiles(np.zeros(size), spread * np.eye(size), probability)
        assert found == pytest.approx(np.sqrt(spread * scipy.stats.chi2.ppf(probability, size)), rel=1e-12)


@pytest.mark.parametrize("distance", [0.3, 1.5, 6.0])
def test_a_mean_shifts_the_quantile(distance: float) -> None:
    """Noncentral chi square: three cumulants give its upper quantiles within three per mille."""
    mean = distance * np.array([2.0, -1.0, 2.0]) / 3.0
    for probability in (0.9, 0.95, 0.99):
        exact = np.sqrt(scipy.stats.ncx2.ppf(probability, 3, distance**2))
        assert norm_quantiles(mean, np.eye(3), probability) == pytest.approx(exact, rel=3e-3)


def test_the_first_three_cumulants() -> None:
    """The cumulants of a sum of s_i chi^2_1(m_i^2 / s_i) are 2^(r-1) (r-1)! (sum s_i^r + r sum s_i^(r-1) m_i^2)."""
    rng = np.random.default_rng(4)
    axes, _ = np.linalg.qr(rng.standard_normal((6, 6)))
    spreads, along = np.array([4.0, 1.0, 0.5, 0.1, 0.01, 0.0]), np.array([0.3, -2.0, 1.0, 0.0, 0.7, 0.2])
    k1, k2, k3 = (
        2.0 ** (r - 1) * (1, 1, 2)[r - 1] * np.sum(spreads**r + r * spreads ** (r - 1) * along**2) for r in (1, 2, 3)
    )
    # a gamma distribution of these cumulants, shifted: shape 4 k2^3 / k3^2, scale k3 / (2 k2)
    gamma = scipy.stats.gamma(4.0 * k2**3 / k3**2, scale=k3 / (2.0 * k2))
    for probability in (0.5, 0.95):
        expected = np.sqrt(k1 + gamma.ppf(probability) - gamma.mean())
        found = norm_quantiles(axes @ along, (axes * spreads) @ axes.T, probability)
        assert found == pytest.approx(expected, rel=1e-10)


def test_the_first_three_cumulants_with_a_part_of_either_sign() -> None:
    """Moments of |m + e + c|^2 and |m + e - c|^2, by the cumulants of normal vectors, averaged."""
    rng = np.random.default_rng(7)
    root, mean, part = rng.standard_normal((3, 3)), np.array([0.4, -0.3, 0.8]), np.array([0.9, 0.5, -0.7])
    normal = root @ root.T

    def moments(shift: np.ndarray) -> np.ndarray:
        k1 = np.trace(normal) + shift @ shift
        k2 = 2.0 * np.trace(normal @ normal) + 4.0 * shift @ normal @ shift
        k3 = 8.0 * np.trace(normal @ normal @ normal) + 24.0 * shift @ normal @ normal @ shift
        return np.array([k1, k2 + k1**2, k3 + 3.0 * k2 * k1 + k1**3])

    first, second, third = 0.5 * (moments(mean + part) + moments(mean - part))
    k2, k3 = second - first**2, third - 3.0 * second * first + 2.0 * first**3
    gamma = scipy.stats.gamma(4.0 * k2**3 / k3**2, scale=k3 / (2.0 * k2))
    expected = np.sqrt(first + gamma.ppf(0.95) - gamma.mean())
    found = norm_quantiles(mean, normal + np.outer(part, part), 0.95, part[:, None])
    assert found == pytest.approx(expected, rel=1e-10)


def test_a_coverage_below_one_half_is_refused() -> None:
    with pytest.raises(InvalidValueError, match="coverage"):
        norm_quantiles(np.zeros(3), np.eye(3), 0.4)


def test_the_mean_length_of_a_shifted_vector() -> None:
    """In a plane, Rice's distribution; in space without spread along two axes, the folded normal one."""
    mean, spread = np.array([0.8, -0.6]), 0.49
    assert expected_norm(mean, spread * np.eye(2)) == pytest.approx(
        scipy.stats.rice(1.0 / 0.7, scale=0.7).mean(), rel=1e-9
    )
    folded = scipy.stats.foldnorm(1.5 / 0.4, scale=0.4).mean()
    assert expected_norm([1.5, 0.0, 0.0], np.diag([0.16, 0.0, 0.0])) == pytest.approx(folded, rel=1e-9)


def test_the_root_of_a_covariance_of_a_plane_stays_in_the_plane() -> None:
    """Two independent numbers in three components, three more without any: no spread where there is none."""
    rng = np.random.default_rng(0)
    for _ in range(200):
        columns = np.zeros((6, 2))
        columns[[0, 1, 5]] = 1e-6 * rng.standard_normal((3, 2))
        covariance = columns @ columns.T
        root = covariance_root(covariance)
        np.testing.assert_allclose(root @ root.T, covariance, atol=1e-14 * covariance.max())
