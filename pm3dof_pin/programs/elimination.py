"""Orthogonal elimination on recorded numbers: sparse, with columns chosen while recording, and with doubt recorded.

The rows of a system are NumPy arrays of dtype object; structural zeros stay zeros. Which column is eliminated next is
decided once for all poses, by the values at the sample poses: a column that is zero at all of them is dropped, and
pivots are chosen by medians. What this takes for granted is recorded in a `Doubt`, to be asked at every pose.

Quantities are to be scaled so that one is the size of a column well away from zero.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.programs.graph import Number, Scalar, Truth, absolute, is_zero, less, maximum, minimum, select, sqrt
from pm3dof_pin.typing import Array, Objects

ZERO = 1e-9
"""Columns shorter than this times the longest at all sample poses are dropped."""

_SHARE = 0.1  # of the best pivot's relative length, which is enough for a pivot that keeps more zeros

PIVOT = 1e-5
"""Pivots below this leave a rank in doubt."""

DROPPED = 1e-9
"""Entries dropped as zero that are larger than this leave a rank in doubt."""


class Doubt:
    """The least pivot of choices made while recording, and the largest entry dropped as zero."""

    def __init__(self) -> None:
        self.pivot: Scalar = 1.0
        self.dropped: Scalar = 0.0

    def note_pivot(self, size: Scalar) -> None:
        """Record the size of a pivot."""
        self.pivot = minimum(self.pivot, size)

    def drop(self, entries: Sequence[Scalar]) -> None:
        """Record entries taken for zero."""
        for entry in entries:
            if not is_zero(entry):
                self.dropped = maximum(self.dropped, absolute(entry))

    def is_none(self, values: Objects) -> Truth:
        """Return whether nothing is in doubt, and values that depend on the choices are numbers."""
        finite = less(-1.0, total([entry * entry for entry in values.ravel()]))
        return less(PIVOT, self.pivot) & less(self.dropped, DROPPED) & finite


@dataclass(frozen=True)
class Reflection:
    """An orthogonal symmetric matrix 1 - v g^T on a few indices; or a rotation in a plane."""

    indices: tuple[int, ...]  #: what it acts on; the first is the pivot
    vector: tuple[Scalar, ...]  #: v; of a rotation, cosine and sine
    scaled: tuple[Scalar, ...] | None  #: g, a multiple of v; None for a rotation
    pivot: Scalar  #: what the pivot's entry becomes
    size: Scalar  #: its magnitude, the length of the vector

    def apply(self, numbers: list[Scalar] | dict[int, Scalar], *, transposed: bool = False) -> None:
        """Multiply a vector by the matrix or its transpose, in place."""
        values = [numbers[k] for k in self.indices]
        if len(values) == 1 or all(map(is_zero, values)):
            return
        if self.scaled is None:
            (first, second), (cosine, sine) = values, self.vector
            sine = -sine if transposed else sine
            numbers[self.indices[0]] = cosine * first + sine * second
            numbers[self.indices[1]] = cosine * second - sine * first
            return
        part = total([v * x for v, x in zip(self.vector, values, strict=True)])
        for k, x, g in zip(self.indices, values, self.scaled, strict=True):
            numbers[k] = x - part * g


@dataclass(frozen=True)
class Elimination:
    """A system after the elimination of columns."""

    columns: tuple[int, ...]  #: the eliminated columns, in their order
    dropped: tuple[int, ...]  #: columns that are zero when the others are eliminated
    pivot_rows: Objects  #: one row for each eliminated column, upper triangular in them, shape=(r, n)
    rest: Objects  #: the other rows, zero in all these columns, shape=(m - r, n)
    #: the orthogonal matrices that were applied to the rows, in their order
    reflections: tuple[Reflection, ...] = field(repr=False)
    rest_rows: tuple[int, ...]  #: which rows of the system became the rest

    def carry(self, columns: Objects) -> tuple[Objects, Objects]:
        """Apply the reflections to more columns of the system; return their part in the pivot rows and in the rest."""
        carried = zeros(*columns.shape)
        for c in range(columns.shape[1]):
            numbers = list(columns[:, c])
            for reflection in self.reflections:
                reflection.apply(numbers)
            carried[:, c] = numbers
        pivots = [reflection.indices[0] for reflection in self.reflections]
        return carried[pivots], carried[list(self.rest_rows)]

    def complement(self) -> Objects:
        """Return the rows that take the system to its rest, orthonormal, shape=(m - r, m)."""
        count = len(self.rest_rows) + len(self.columns)
        rows = zeros(len(self.rest_rows), count)
        for row, place in zip(rows, self.rest_rows, strict=True):
            numbers: list[Scalar] = [0.0] * count
            numbers[place] = 1.0
            for reflection in reversed(self.reflections):
                reflection.apply(numbers, transposed=True)
            row[:] = numbers
        return rows

    @property
    def cost(self) -> int:
        """Operations that applying the reflections to one more column costs."""
        return sum(4 * len(r.indices) for r in self.reflections if len(r.indices) > 1)


def eliminate(system: Objects, columns: Sequence[int], doubt: Doubt) -> Elimination:
    """Eliminate columns from a system of rows by Householder's reflections; the sparsest first, of equals the last."""
    rows = [list(row) for row in system]
    active = list(range(len(rows)))
    waiting = list(columns)
    original = {c: _lengths([row[c] for row in rows]) for c in waiting}
    largest = max((typical(lengths) for lengths in original.values()), default=0.0)
    done: list[int] = []
    dropped: list[int] = []
    pivots: list[int] = []
    reflections: list[Reflection] = []
    while waiting:
        fronts = {c: [i for i in active if not is_zero(rows[i][c])] for c in waiting}
        sizes = {}
        for c, front in fronts.items():
            lengths = _lengths([rows[i][c] for i in front])
            if not front or not np.nanmax(lengths) > ZERO * largest:
                doubt.drop([rows[i][c] for i in front])
                for i in front:
                    rows[i][c] = 0.0
                dropped.append(c)
            else:
                sizes[c] = typical(lengths) / typical(original[c])
        waiting = list(sizes)
        if not waiting:
            break
        enough = _SHARE * max(sizes.values())
        chosen = min((c for c in waiting if sizes[c] >= enough), key=lambda c: (len(fronts[c]), -c))
        reflection = reflect({i: rows[i][chosen] for i in fronts[chosen]})
        indices = reflection.indices
        for c in range(system.shape[1]):
            column: dict[int, Scalar] = {i: rows[i][c] for i in indices}
            if c == chosen:
                column = {**dict.fromkeys(indices, 0.0), indices[0]: reflection.pivot}
            else:
                reflection.apply(column)
            for i in indices:
                rows[i][c] = column[i]
        doubt.note_pivot(reflection.size)
        reflections.append(reflection)
        waiting.remove(chosen)
        done.append(chosen)
        pivots.append(indices[0])
        active.remove(indices[0])
    n = system.shape[1]
    return Elimination(
        tuple(done),
        tuple(dropped),
        np.array([rows[i] for i in pivots], dtype=object).reshape(len(pivots), n),
        np.array([rows[i] for i in active], dtype=object).reshape(len(active), n),
        tuple(reflections),
        tuple(active),
    )


def reflect(vector_entries: Mapping[int, Scalar]) -> Reflection:
    """Return the matrix that takes a vector, given by its entries that are not zero, to the index of the largest."""
    sizes = {k: typical(np.abs(samples(entry))) for k, entry in vector_entries.items()}
    indices = tuple(sorted(sizes, key=lambda k: -sizes[k]))
    entries = [vector_entries[k] for k in indices]
    if len(entries) == 1:
        return Reflection(indices, (1.0,), None, entries[0], absolute(entries[0]))
    size = sqrt(total([entry * entry for entry in entries]))
    if len(entries) == 2:
        inverse = 1.0 / size
        return Reflection(indices, (entries[0] * inverse, entries[1] * inverse), None, size, size)
    pivot = select(less(entries[0], 0.0), size, -size)
    vector = (entries[0] - pivot, *entries[1:])
    factor = -1.0 / (pivot * vector[0])
    return Reflection(indices, vector, tuple(factor * v for v in vector), pivot, size)


def solve_upper(triangle: Objects, right: Objects) -> Objects:
    """Return R^-1 B for an upper triangular R, shape=(n, n), and B, shape=(n, k)."""
    solution = zeros(*right.shape)
    for i in reversed(range(len(triangle))):
        inverse = 1.0 / triangle[i, i]
        for c in range(right.shape[1]):
            terms = [triangle[i, j] * solution[j, c] for j in range(i + 1, len(triangle))]
            solution[i, c] = (right[i, c] - total(terms)) * inverse
    return solution


def total(terms: Sequence[Scalar]) -> Scalar:
    """Return the sum."""
    result: Scalar = 0.0
    for term in terms:
        result = result + term
    return result


def product(a: Objects, b: Objects) -> Objects:
    """Return the matrix product; unlike `@` also where an axis is empty."""
    result = zeros(a.shape[0], b.shape[1])
    for i, row in enumerate(a):
        for j in range(b.shape[1]):
            result[i, j] = total([x * y for x, y in zip(row, b[:, j], strict=True) if not (is_zero(x) or is_zero(y))])
    return result


def samples(number: Scalar) -> Array | float:
    """Return the values at the sample poses."""
    return number.samples if isinstance(number, Number) else float(number)


def typical(values: Array | float) -> float:
    """Return the median over the samples at which a number exists; ProgramError where it exists at none."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not finite.size:
        raise ProgramError("a number of the program exists at none of its sample poses")
    return float(np.median(finite))


def zeros(rows: int, columns: int) -> Objects:
    """Return a matrix of zeros."""
    matrix = np.empty((rows, columns), dtype=object)
    matrix[:] = 0.0
    return matrix


def identity(size: int) -> Objects:
    """Return the unit matrix."""
    matrix = zeros(size, size)
    np.fill_diagonal(matrix, 1.0)
    return matrix


def _lengths(entries: Sequence[Scalar]) -> Array:
    """Return the length of a vector at every sample pose; one of size 0 where it has no entries."""
    squares = sum((np.square(samples(entry)) for entry in entries), np.zeros(1))
    lengths: Array = np.sqrt(squares)
    return lengths
