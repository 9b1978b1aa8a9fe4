"""Confidence interval of the root mean square of one machine's errors over many poses.

At pose i the error is m_i + E_i x + G_i s_i. m is known; x, independent standard normal, are the errors of the
parameters, the same at all poses; s is the scatter, of covariance V (:mod:`pm3dof_pin.calibration.scatter`). Over n
poses, with A = sum E^T E / n and v = sum E^T m / n, the mean square has

    mean = sum |m|^2 / n + tr A + sum tr G V G^T / n,   variance = 2 tr A^2 + 4 |v|^2 + that of the estimate of V,

and is approximated by a scaled chi square with the same two moments (F. Satterthwaite, Biometrics Bulletin 2, 1946).
"""

from __future__ import annotations

import numpy as np
import scipy.special

from pm3dof_pin.calibration.pseudo_error import control_inverse
from pm3dof_pin.calibration.scatter import Scatter
from pm3dof_pin.typing import Array

COVERAGE = 0.95
"""Probability of intervals and of error bounds."""

_PROBABILITIES = np.array([0.5 - 0.5 * COVERAGE, 0.5 + 0.5 * COVERAGE])


def rms_interval(
    fixed: Array, effects: Array, scatter: Scatter, control: Array, gains: Array | None = None
) -> tuple[float, float]:
    """Return the interval that holds the root mean square with the probability :data:`COVERAGE`.

    Args:
        fixed: m, shape=(n, k).
        effects: E, effects of one standard deviation in each direction of the parameters, shape=(n, k, directions).
        scatter: V.
        control: tip-weighted motion of the tool by the drives' joints, which the scatter depends on, shape=(n, 6,
            drives).
        gains: G, shape=(n, k, 6); None for the tip-weighted error itself, k = 6.
    """
    count = len(fixed)
    gains = np.broadcast_to(np.eye(6), (count, 6, 6)) if gains is None else gains
    flat, known = np.concatenate(effects) / np.sqrt(count), fixed.ravel() / np.sqrt(count)
    product, scattered = flat.T @ flat, np.einsum("nij,njk,nik->", gains, scatter.covariances(control), gains) / count
    mean = float(known @ known + np.trace(product) + scattered)
    variance = 2.0 * np.sum(product**2) + 4.0 * np.sum((known @ flat) ** 2)
    variance += scatter.mean_square_variance(gains, control)
    freedom = 2.0 * mean**2 / float(variance)
    low, high = np.sqrt(2.0 * mean * scipy.special.gammaincinv(0.5 * freedom, _PROBABILITIES) / freedom).tolist()
    return low, high


def excess_interval(effects: Array, scatter: Scatter, control: Array) -> tuple[float, float] | None:
    """Return the interval of the commands' difference from the best ones, over poses and drives' joints [m, rad].

    None without directions, or near a singular pose, where commands can be far off and hardly move the tool.

    Args:
        effects: effects on the tip-weighted error, shape=(n, 6, directions) [m].
        scatter: further scatter.
        control: tip-weighted motion by the drives' joints, shape=(n, 6, drives).
    """
    gains = control_inverse(control) / np.sqrt(control.shape[2])
    if not effects.size or np.linalg.matrix_rank(gains).min() < control.shape[2]:
        return None
    return rms_interval(np.zeros(gains.shape[:2]), gains @ effects, scatter, control, gains)
