"""Singular values of recorded matrices, by a fixed number of rotations."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.programs.elimination import total
from pm3dof_pin.programs.graph import Scalar, absolute, less, maximum, minimum, select, sqrt
from pm3dof_pin.programs.projection import compressed
from pm3dof_pin.typing import Objects

_SWEEPS = 6
_TINY = 1e-300


def squared_singular_values(rows: Objects) -> list[Scalar]:
    """Return the squared singular values of rows in ascending order, each to high relative accuracy.

    One-sided Jacobi rotations (J. Demmel and K. Veselic, SIAM J. Matrix Anal. Appl. 13, 1992), a fixed number.
    """
    work = compressed(rows)
    for _ in range(_SWEEPS if len(rows) > 3 else _SWEEPS - 1):
        for i in range(len(work)):
            for j in range(i + 1, len(work)):
                work[[i, j]] = _orthogonal(work[i], work[j])
    return _sorted([total([entry * entry for entry in row]) for row in work])


def _orthogonal(a: Objects, b: Objects) -> Objects:
    """Rotate two rows into orthogonal ones."""
    aa, bb, ab = (total(list(x * y)) for x, y in ((a, a), (b, b), (a, b)))
    difference, twice = bb - aa, 2.0 * ab
    size = absolute(difference) + sqrt(difference * difference + twice * twice) + _TINY
    tangent = select(less(difference, 0.0), -twice, twice) / size
    cosine = 1.0 / sqrt(1.0 + tangent * tangent)
    sine = cosine * tangent
    return np.stack([cosine * a - sine * b, sine * a + cosine * b])


def _sorted(numbers: list[Scalar]) -> list[Scalar]:
    result = list(numbers)
    for end in range(len(result) - 1, 0, -1):
        for k in range(end):
            result[k], result[k + 1] = minimum(result[k], result[k + 1]), maximum(result[k], result[k + 1])
    return result
