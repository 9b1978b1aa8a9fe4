"""Compiled arithmetic on stiffness matrices, broadcast over any grid."""

from __future__ import annotations

import math

import numba

from pm3dof_pin.kernel_cache import KEEP

_LOST = 1e-14  # a pivot that falls below this times its diagonal entry is rounding


@numba.guvectorize(["void(float64[:,:], float64[:,:])"], "(d,d)->(d,d)", nopython=True, cache=KEEP)
def inverse_definite(matrix, inverse):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric positive definite matrix, exactly symmetric, by Cholesky's method in place.

    The method does not mind units: scaling rows and columns alike changes no relative error. What is not positive
    definite to rounding, or not a number, gives NaN.
    """
    size = matrix.shape[0]
    for j in range(size):  # lower triangle: L with A = L L^T
        for i in range(j, size):
            entry = matrix[i, j]
            for k in range(j):
                entry -= inverse[i, k] * inverse[j, k]
            if i > j:
                inverse[i, j] = entry / inverse[j, j]
            elif entry > _LOST * matrix[j, j]:
                inverse[j, j] = math.sqrt(entry)
            else:
                inverse[:] = math.nan
                return
    for j in range(size):  # lower triangle: X = L^-1
        inverse[j, j] = 1.0 / inverse[j, j]
        for i in range(j + 1, size):
            entry = inverse[i, j] * inverse[j, j]
            for k in range(j + 1, i):
                entry += inverse[i, k] * inverse[k, j]
            inverse[i, j] = -entry / inverse[i, i]
    for i in range(size):  # upper triangle: X^T X
        for j in range(i):
            entry = 0.0
            for k in range(i, size):
                entry += inverse[k, i] * inverse[k, j]
            inverse[j, i] = entry
    for i in range(size):
        entry = 0.0
        for k in range(i, size):
            entry += inverse[k, i] * inverse[k, i]
        inverse[i, i] = entry
    for i in range(size):
        for j in range(i):
            inverse[i, j] = inverse[j, i]
