"""Normally distributed vectors: samples of a given covariance, mean lengths and quantiles of lengths."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Matrix

_ROUNDING = 1e-6  # of the greatest standard deviation; its square is well above rounding
_SYMMETRIC = 1e-3  # skewness that counts as none
_EXPONENTS = np.arange(-72.0, 72.25, 0.5)  # the integrand decays as exp(-|y| / 2); this spacing gives ten digits


def expected_norm(mean: ArrayLike, covariance: ArrayLike) -> Array:
    """Return E |x| of x normal with a mean, shape=(..., k), and a covariance, which may be singular, shape=(...).

    With Q = |x|^2 and L(t) = E exp(-t Q) = prod_i (1 + 2 s_i t)^(-1/2) exp(-t m_i^2 / (1 + 2 s_i t)), s_i the
    eigenvalues and m_i the mean along their axes, E sqrt(Q) = 1 / (2 sqrt(pi)) * integral over t from 0 to infinity of
    (1 - L(t)) t^(-3/2) dt, by the trapezoidal rule in ln t, which converges exponentially.
    """
    m, c = np.asarray(mean, dtype=float), np.asarray(covariance, dtype=float)
    if m.shape[-1] == 3 and not m.any():
        return mean_radius(np.broadcast_to(np.linalg.eigvalsh(c), np.broadcast_shapes(c.shape[:-1], m.shape)))
    spread, axes = np.linalg.eigh(c)
    spread = np.broadcast_to(spread.clip(min=0.0), np.broadcast_shapes(spread.shape, m.shape))
    along = np.einsum("...ij,...i->...j", axes, m) ** 2
    size = (spread + along).sum(axis=-1)
    unit = np.where(size > 0.0, size, 1.0)[..., None]
    spread, along = spread / unit, along / unit
    total = np.zeros(size.shape)
    for y in _EXPONENTS:
        t = np.exp(y)
        wide = 1.0 + 2.0 * spread * t
        logarithm = np.sum(-0.5 * np.log1p(2.0 * spread * t) - t * along / wide, axis=-1)
        total += -np.expm1(logarithm) * np.exp(-0.5 * y)
    step = _EXPONENTS[1] - _EXPONENTS[0]
    return np.asarray(np.sqrt(size) * total * step / (2.0 * np.sqrt(np.pi)))


def mean_radius(spreads: ArrayLike) -> Array:
    """Return E |x| of a normal x in space with zero mean, from the eigenvalues of its covariance, shape=(..., 3).

    It is 2 sqrt(2 / pi), the mean length where all three are 1, times the mean of sqrt(sum s_i u_i^2) over the sphere,
    which is B. Carlson's R_G (DLMF 19.16.3).
    """
    s = np.asarray(spreads, dtype=float).clip(min=0.0)
    from scipy.special import elliprg

    return np.asarray(2.0 * np.sqrt(2.0 / np.pi) * elliprg(s[..., 0], s[..., 1], s[..., 2]))


def norm_quantiles(means: Array, covariances: Array, probability: float, signed: Array | None = None) -> Array:
    """Return the lengths that normal vectors do not exceed with a probability, shape=(...).

    Means have shape=(..., k), covariances shape=(..., k, k). The square of the length, Q = |m + e|^2 with e of
    covariance C, has the cumulants

        k1 = tr C + m.m,   k2 = 2 tr C^2 + 4 m.C m,   k3 = 8 tr C^3 + 24 m.C^2 m.

    A scaled and shifted chi square distribution with the same three (E. Pearson, Biometrika 46, 1959) gives its upper
    quantiles, from 90 to 99 % to within 1.5 % of the length. It is not accurate for low ones.

    Parts c of the covariance, in the columns of `signed`, shape=(..., k, d), are not normal but added or subtracted
    with equal probability. As their squares are certain, each reduces k2 by 2 |c|^4 and k3 by
    24 |c|^2 (c.C c + (m.c)^2) - 16 |c|^6. Quantiles are then within 10 %, instead of up to twice too long.

    Raises:
        InvalidValueError: the probability is not at least 0.5 and less than 1.
    """
    if not 0.5 <= probability < 1.0:
        raise InvalidValueError("coverage", probability, "a probability from 0.5 to 1, such as 0.95")
    second = covariances @ covariances
    moved = np.einsum("...ij,...j->...i", covariances, means)
    first = np.einsum("...ii->...", covariances) + np.sum(means**2, axis=-1)
    variance = 2.0 * np.einsum("...ii->...", second) + 4.0 * np.sum(means * moved, axis=-1)
    third = 8.0 * np.einsum("...ij,...ji->...", second, covariances) + 24.0 * np.sum(moved**2, axis=-1)
    if signed is not None:
        sizes = np.sum(signed**2, axis=-2)
        mixed = np.sum(signed * (covariances @ signed), axis=-2) + np.einsum("...ij,...i->...j", signed, means) ** 2
        variance = variance - 2.0 * np.sum(sizes**2, axis=-1)
        variance = np.where(variance > _ROUNDING**2 * first**2, variance, 0.0)
        third = third - np.sum(24.0 * sizes * mixed - 16.0 * sizes**3, axis=-1)
        third = np.maximum(third, _SYMMETRIC * variance**1.5) * (variance > 0.0)  # chi squares have a positive skewness
    spreads = third > 0.0
    safe_third = np.where(spreads, third, 1.0)
    freedom = np.where(spreads, 8.0 * variance**3 / safe_third**2, 1.0)
    scale = np.where(spreads, safe_third / (4.0 * np.where(spreads, variance, 1.0)), 0.0)
    from scipy.special import gammaincinv

    quantile = 2.0 * gammaincinv(0.5 * freedom, probability)
    return np.asarray(np.sqrt(np.maximum(first + scale * (quantile - freedom), 0.0)))


def correlated_normal(covariance: ArrayLike, count: int, generator: np.random.Generator) -> Matrix:
    """Draw normal vectors, shape=(count, k), of a covariance as for :func:`covariance_root`."""
    root = covariance_root(np.asarray(covariance, dtype=float))
    draws: Matrix = generator.standard_normal((count, len(root))) @ root.T
    return draws


def covariance_root(covariance: Array) -> Array:
    """Return A such that A A^T is the given covariance, which may be singular, shape=(..., k, k).

    A is based on the symmetric root of the correlations, which is unique even if some are zero and axes are arbitrary.

    Raises:
        InvalidValueError: the covariance is not symmetric and positive semidefinite.
    """
    scale = np.sqrt(np.einsum("...ii->...i", covariance).clip(min=0.0))
    # the root of a rounding error is large, so entries without a spread are measured by a small part of the greatest
    floor = _ROUNDING * scale.max(axis=-1, initial=0.0, keepdims=True)
    unit = np.where(floor > 0.0, np.maximum(scale, floor), 1.0)
    values, axes = np.linalg.eigh(covariance / (unit[..., :, None] * unit[..., None, :]))
    if not np.allclose(covariance, np.swapaxes(covariance, -1, -2)) or values.min(initial=0.0) < -1e-9:
        raise InvalidValueError("covariance", covariance.tolist(), "a symmetric positive semidefinite matrix")
    root = (axes * np.sqrt(values.clip(min=0.0))[..., None, :]) @ np.swapaxes(axes, -1, -2)
    return np.asarray(unit[..., :, None] * root)
