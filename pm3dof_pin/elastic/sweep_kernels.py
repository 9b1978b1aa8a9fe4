"""Compiled condensation of one configuration after another: orthogonal elimination with rank checks.

Matrices are kept by columns, `a[c]` being column c, so that all inner loops run along memory.
"""

from __future__ import annotations

import math

import numba
import numpy as np

from pm3dof_pin.kernel_cache import KEEP

CLEAR = 1e-3
"""A pivot above this times the size of the equations is independent of those before it without a doubt."""

NEGLIGIBLE = 1e-11
"""What is left below this times the size of the equations is rounding. A pivot in between leaves the rank in doubt."""

_SHARE = 0.1  # of the longest column's length, which is enough for a pivot: an early one keeps more zeros
_SUMS = {"reassoc", "contract", "nsz"}  # sums in any order, to be done several terms at a time; NaN stays NaN


@numba.njit(cache=KEEP, nogil=True, error_model="numpy", fastmath=_SUMS)
def _product(x, y):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(x.shape[0]):
        total += x[i] * y[i]
    return total


@numba.njit(cache=KEEP, nogil=True, error_model="numpy", fastmath=_SUMS)
def _triangularise(a, first, stop, row, rows, limit, share, order, squares):  # type: ignore[no-untyped-def]
    """Householder's elimination with column pivoting of columns first .. stop - 1 in rows row .. rows - 1.

    The reflections act on all columns from `first` on; columns are swapped with all their rows, and `order` with them.
    It ends when no column is longer than `limit`. What stands below the diagonal is not cleared.

    Returns:
        The number of pivots and the least of them.
    """
    least = math.inf
    count = min(stop - first, rows - row)
    for k in range(count):
        top, pivot = row + k, first + k
        largest = 0.0
        for c in range(pivot, stop):
            column = a[c, top:rows]
            squares[c] = _product(column, column)
            largest = max(largest, squares[c])
        if not math.sqrt(largest) > limit:
            return k, least
        best = pivot
        while squares[best] < share * share * largest:
            best += 1
        size = math.sqrt(squares[best])
        least = min(least, size)
        if best != pivot:
            order[best], order[pivot] = order[pivot], order[best]
            for i in range(a.shape[1]):
                a[best, i], a[pivot, i] = a[pivot, i], a[best, i]
        mirror = a[pivot, top:rows]
        head = mirror[0]
        mirror[0] = head + math.copysign(size, head)
        factor = 1.0 / (size * (size + abs(head)))
        for c in range(pivot + 1, a.shape[0]):
            column = a[c, top:rows]
            part = factor * _product(mirror, column)
            if part != 0.0:
                for i in range(mirror.shape[0]):
                    column[i] -= part * mirror[i]
        mirror[0] = -math.copysign(size, head)
    return count, least


@numba.njit(cache=KEEP, nogil=True, error_model="numpy", fastmath=_SUMS)
def _condense(a, passive, root, first_of_block, factors, place, b, order, squares, compliance):  # type: ignore[no-untyped-def]
    """Compute the compliance of one configuration; return False if a rank is in doubt or the frame is free.

    a: columns of passive joints, then of springs; scaled closure rows, then six rows of the frame's Jacobian.
    """
    columns, rows = a.shape[0], a.shape[1] - 6
    springs = columns - passive
    closures_size, frame_size = 0.0, 0.0
    for c in range(columns):
        order[c] = c - passive
        closures_size += _product(a[c, :rows], a[c, :rows])
        frame_size += _product(a[c, rows:], a[c, rows:])
    closures_size, frame_size = math.sqrt(closures_size), math.sqrt(frame_size)

    # passive joints: eliminated from the closures and from the frame's Jacobian
    rank, least = _triangularise(a, 0, passive, 0, rows, NEGLIGIBLE * closures_size, _SHARE, order, squares)
    if least < CLEAR * closures_size:
        return False
    for k in range(rank):
        pivot = a[k, rows:]
        for i in range(6):
            pivot[i] /= a[k, k]
        for c in range(k + 1, columns):
            column, part = a[c, rows:], a[c, k]
            for i in range(6):
                column[i] -= part * pivot[i]
    for c in range(rank, passive):
        for i in range(rows, rows + 6):
            if not abs(a[c, i]) <= NEGLIGIBLE * frame_size:
                return False

    # relations that the closures put on the springs
    relations, least = _triangularise(
        a, passive, columns, rank, rows, NEGLIGIBLE * closures_size, _SHARE, order, squares
    )
    if least < CLEAR * closures_size:
        return False

    # relations and frame in units of the springs; the frame's part at right angles to the relations is what is left
    held = b[: relations + 6]
    held[:] = 0.0
    for c in range(passive, columns):
        spring = order[c]
        for k in range(first_of_block[spring], spring + 1):
            factor, into = factors[spring] * root[spring, k], place[k]
            if factor != 0.0:
                for i in range(min(relations, c - passive + 1)):
                    held[i, into] += factor * a[c, rank + i]
                for i in range(6):
                    held[relations + i, into] += factor * a[c, rows + i]
    _triangularise(held, 0, relations, 0, springs, 0.0, 1.0, order, squares)
    for i in range(6):
        for j in range(i + 1):
            compliance[i, j] = _product(held[relations + i, relations:], held[relations + j, relations:])
            compliance[j, i] = compliance[i, j]
    return True


@numba.njit(cache=KEEP, nogil=True, error_model="numpy")
def condense_all(  # type: ignore[no-untyped-def]
    closures, frames, indices, passive, scale, units, root, first_of_block, factors, place, compliances
):
    """Compute the compliances of many configurations.

    Args:
        closures: constraint Jacobians, shape=(n, m, nv).
        frames: Jacobians of the frame, shape=(n, 6, nv).
        indices: columns of the passive joints, then of the springs, shape=(p + s,).
        passive: p.
        scale: what the velocities of these columns are measured on, shape=(p + s,).
        units: what the rows of `closures`, then of `frames`, are measured on, shape=(m + 6,).
        root: root of the springs' compliance, lower triangular in blocks, shape=(s, s).
        first_of_block: first spring coordinate of the block of each, shape=(s,).
        factors: what multiplies the rows of the root at each configuration, shape=(n, s); NaN flags it.
        place: place of each spring coordinate when the softest come first, shape=(s,).
        compliances: where to put the results, shape=(n, 6, 6).

    Returns:
        Which configurations are done, shape=(n,); the others need singular value decompositions.
    """
    count, rows, _ = closures.shape
    columns = indices.shape[0]
    springs = columns - passive
    done = np.zeros(count, dtype=np.bool_)
    a = np.empty((columns, rows + 6))
    b = np.empty((min(rows, springs) + 6, springs))
    order = np.empty(max(columns, rows + 6), dtype=np.int64)
    squares = np.empty(max(columns, rows + 6))
    for n in range(count):
        for i in range(rows + 6):
            row = closures[n, i] if i < rows else frames[n, i - rows]
            per_unit = 1.0 / units[i]
            for c in range(columns):
                a[c, i] = row[indices[c]] * scale[c] * per_unit
        if not math.isnan(factors[n].sum()):
            result = compliances[n]
            done[n] = _condense(a, passive, root, first_of_block, factors[n], place, b, order, squares, result)
            for i in range(6):
                for j in range(6):
                    result[i, j] *= units[rows + i] * units[rows + j]
    return done
