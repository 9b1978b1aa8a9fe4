"""How large a normally distributed error is at most, with a given probability: upper quantiles of its length.

The square of the length, Q = |m + e|^2 with e of covariance C, has the cumulants

    k1 = tr C + m.m,   k2 = 2 tr C^2 + 4 m.C m,   k3 = 8 tr C^3 + 24 m.C^2 m.

A scaled and shifted chi square law with the same three (E. Pearson, Biometrika 46, 1959) has its upper quantiles: from
90 to 99 % to within 1.5 % of the length. Low ones it has not.
"""

from __future__ import annotations

import numpy as np
import scipy.special

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


def norm_quantiles(means: Array, covariances: Array, probability: float) -> Array:
    """Return the lengths that normal vectors do not exceed with a probability, shape=(...).

    Means have shape=(..., k), covariances shape=(..., k, k).

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
    spreads = third > 0.0
    safe_third = np.where(spreads, third, 1.0)
    freedom = np.where(spreads, 8.0 * variance**3 / safe_third**2, 1.0)
    scale = np.where(spreads, safe_third / (4.0 * np.where(spreads, variance, 1.0)), 0.0)
    quantile = 2.0 * scipy.special.gammaincinv(0.5 * freedom, probability)
    return np.asarray(np.sqrt(np.maximum(first + scale * (quantile - freedom), 0.0)))
