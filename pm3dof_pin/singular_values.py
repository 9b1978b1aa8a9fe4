"""Singular value decompositions of large matrices, such as the Jacobians of many loops."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.typing import Matrix, Vector


def svd(matrix: Matrix, *, full_matrices: bool = True) -> tuple[Matrix, Vector, Matrix]:
    """Return the singular value decomposition of a matrix, U, s, V^T.

    LAPACK's divide and conquer, which is fast, does not converge for some matrices of several hundred rows: these are
    decomposed by QR iteration.

    Raises:
        LinAlgError: the matrix is not finite.
    """
    try:
        left, values, right = np.linalg.svd(matrix, full_matrices=full_matrices)
    except np.linalg.LinAlgError:
        if not np.isfinite(matrix).all():
            raise
        from scipy.linalg import svd as svd_by_iteration  # slow to load

        left, values, right = svd_by_iteration(matrix, full_matrices=full_matrices, lapack_driver="gesvd")
    return left, values, right
