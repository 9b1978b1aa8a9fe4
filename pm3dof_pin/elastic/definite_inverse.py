"""The inverse of many small symmetric positive definite matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.typing import Array

_LOST = 1e-14  # pivots below this times their diagonal entry are rounding


def inverse_definite(matrix: ArrayLike) -> Array:
    """Return the exactly symmetric inverses of symmetric positive definite matrices by Cholesky; reads lower triangles.

    The relative accuracy is invariant under scaling of rows and columns, such as changes of units. Matrices that are
    not positive definite to rounding, or contain NaN, give NaN.
    """
    a = np.asarray(matrix, dtype=float)
    size = a.shape[-1]
    # d x d arrays over all matrices: every step below is one operation for all of them
    entries = np.ascontiguousarray(np.moveaxis(a.reshape(-1, size, size), 0, -1))
    with np.errstate(all="ignore"):
        lower = np.zeros_like(entries)
        for j in range(size):
            column = entries[j:, j] - np.einsum("ikn,kn->in", lower[j:, :j], lower[j, :j])
            pivot = np.where(column[0] > _LOST * entries[j, j], column[0], np.nan)
            lower[j:, j] = column / np.sqrt(pivot)
        inverse = np.zeros_like(entries)
        for i in range(size):
            known = np.einsum("kn,kjn->jn", lower[i, :i], inverse[:i, : i + 1])
            inverse[i, : i + 1] = -known / lower[i, i]
            inverse[i, i] = 1.0 / lower[i, i]
        result = np.empty_like(entries)
        for i in range(size):
            for j in range(i + 1):
                result[i, j] = result[j, i] = np.einsum("kn,kn->n", inverse[i:, i], inverse[i:, j])
        result[:, :, np.isnan(lower[-1, -1])] = np.nan
    return np.ascontiguousarray(np.moveaxis(result, -1, 0)).reshape(a.shape)
