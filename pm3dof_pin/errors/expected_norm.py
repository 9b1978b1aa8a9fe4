"""The mean length of a normal vector: what (8.15) is on average over machines, since E_xyz is no square."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import elliprg

from pm3dof_pin.typing import Array

_EXPONENTS = np.arange(-72.0, 72.25, 0.5)  # the integrand falls as exp(-|y| / 2); spacing enough for ten digits


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
    """Return E |x| of x normal in space, of mean 0, by the eigenvalues of its covariance, shape=(..., 3).

    It is 2 sqrt(2 / pi), the mean length where all three are 1, times the mean of sqrt(sum s_i u_i^2) over the sphere,
    which is B. Carlson's R_G (DLMF 19.16.3).
    """
    s = np.asarray(spreads, dtype=float).clip(min=0.0)
    return np.asarray(2.0 * np.sqrt(2.0 / np.pi) * elliprg(s[..., 0], s[..., 1], s[..., 2]))
