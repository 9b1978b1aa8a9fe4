"""The share of each spring in the compliance, for a load or along a direction.

Compliances of springs add: C = sum_j C_j with C_j = a_j a_j^T / k_j, where a_j is the force in spring j per wrench at
the tool. The displacement of the point of load along a wrench W is W^T C W, and each spring's part of it is W^T C_j W.
The same parts give the derivatives: dC / dk_j = -C_j / k_j.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


def shares(contributions: ArrayLike, wrench: ArrayLike) -> Array:
    """Return the share of each spring in the deflection along a wrench W at the tool, shape=(..., s); the sum is 1.

    NaN where the contributions C_j, shape=(..., s, 6, 6), are NaN or all zero along W.

    Raises:
        InvalidValueError: the wrench is not of shape (..., 6), not finite or zero.
    """
    w = np.asarray(wrench, dtype=float)
    if w.shape[-1:] != (6,) or not np.all(np.isfinite(w)) or not np.all(np.any(w != 0.0, axis=-1)):
        raise InvalidValueError("wrench", w.tolist(), "six finite numbers [f; m], not all zero")
    energies: Array = np.einsum("...i,...sij,...j->...s", w, np.asarray(contributions, dtype=float), w)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(energies / energies.sum(axis=-1, keepdims=True))
