"""Orthogonal algorithms on recorded numbers: sparse elimination, projection, ranks, singular values.

The rows of a system are NumPy arrays of dtype object; structural zeros stay zeros. The order of elimination is decided
once for all poses, by the values at the sample poses: a column that is zero at all of them is dropped, and pivots are
chosen by medians. The assumptions are recorded in a `Doubt`, which is checked at every pose.

Quantities must be scaled such that columns well away from zero have lengths of about one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce

import numpy as np

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.programs.graph import Number, Scalar, Truth, absolute, is_zero, less, maximum, minimum, select, sqrt
from pm3dof_pin.typing import Array, Objects

ZERO = 1e-9
"""Columns shorter than this times the longest at all sample poses are dropped."""

_SHARE = 0.1  # of the best pivot's relative length; sufficient for a pivot that keeps more zeros
_SHORT = 1e-3  # of the longest column: a shorter one, as of a rod's spin about an axis that is rounded, leads no row

PIVOT = 1e-5
"""Smaller pivots leave a rank in doubt."""

_SPREAD = 1e-3
"""Least ratio of a basis' pivots: errors are rounding over its square, some 1e-10 then."""

_OF_USUAL = 0.1  # of the usual ratio: where that is less by units, it is no loss

_SWEEPS = 6  # of rotations, for singular values
_TINY = 1e-300
_BELOW_ROUNDING = 1e-18  # compared with 1; its square exists in single precision too

DROPPED = 1e-9
"""Larger entries dropped as zero leave a rank in doubt."""


class Doubt:
    """The least pivot chosen while recording, and the largest entry dropped as zero."""

    def __init__(self) -> None:
        self.pivot: Scalar = 1.0
        self.dropped: Scalar = 0.0

    def note_pivot(self, size: Scalar) -> None:
        """Record the size of a pivot."""
        self.pivot = minimum(self.pivot, size)

    def note_basis(self, triangle: Objects) -> None:
        """Record how far apart the pivots are by which a basis of motions is combined to others."""
        sizes = [absolute(entry) for entry in triangle.diagonal()]
        if len(sizes) > 1:
            spread = reduce(minimum, sizes) / reduce(maximum, sizes)
            self.note_pivot(spread * (PIVOT / min(_SPREAD, _OF_USUAL * typical(samples(spread)))))

    def drop(self, entries: Sequence[Scalar]) -> None:
        """Record entries assumed to be zero."""
        for entry in entries:
            if not is_zero(entry):
                self.dropped = maximum(self.dropped, absolute(entry))

    def is_none(self, values: Objects) -> Truth:
        """Return whether nothing is in doubt, and values that depend on the choices are not NaN."""
        finite = less(-1.0, total([entry * entry for entry in values.ravel()]))
        return less(PIVOT, self.pivot) & less(self.dropped, DROPPED) & finite


@dataclass(frozen=True)
class Reflection:
    """An orthogonal symmetric matrix 1 - v g^T on a few indices; or a rotation in a plane."""

    indices: tuple[int, ...]  #: the indices it acts on; the first is the pivot
    vector: tuple[Scalar, ...]  #: v; for a rotation, cosine and sine
    scaled: tuple[Scalar, ...] | None  #: g, a multiple of v; None for a rotation
    pivot: Scalar  #: the pivot's entry afterwards
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

    columns: tuple[int, ...]  #: the eliminated columns, in order
    dropped: tuple[int, ...]  #: columns that are zero once the others are eliminated
    pivot_rows: Objects  #: one row for each eliminated column, upper triangular in them, shape=(r, n)
    rest: Objects  #: the other rows, zero in all these columns, shape=(m - r, n)
    #: the orthogonal matrices applied to the rows, in order
    reflections: tuple[Reflection, ...] = field(repr=False)
    places: tuple[int, ...]  #: which rows of the system became the pivot rows
    rest_places: tuple[int, ...]  #: which rows of the system became the rest

    def carry(self, columns: Objects) -> tuple[Objects, Objects]:
        """Apply the reflections to more columns of the system; return their parts in the pivot rows and in the rest."""
        carried = zeros(*columns.shape)
        for c in range(columns.shape[1]):
            numbers = list(columns[:, c])
            for reflection in self.reflections:
                reflection.apply(numbers)
            carried[:, c] = numbers
        return carried[list(self.places)], carried[list(self.rest_places)]

    def back(self, pivots: Sequence[Scalar]) -> Objects:
        """Return the right-hand side that has these parts in the pivot rows and none in the rest, shape=(m,)."""
        return self._carried_back(dict(zip(self.places, pivots, strict=True)))

    def complement(self) -> Objects:
        """Return the orthonormal rows that map the system to its rest, shape=(m - r, m)."""
        rows = [self._carried_back({place: 1.0}) for place in self.rest_places]
        return np.array(rows, dtype=object).reshape(len(rows), len(self.rest_places) + len(self.places))

    def _carried_back(self, entries: Mapping[int, Scalar]) -> Objects:
        """Apply the transposed reflections, in reverse order, to a vector given by its nonzero entries."""
        numbers = [entries.get(place, 0.0) for place in range(len(self.rest_places) + len(self.places))]
        for reflection in reversed(self.reflections):
            reflection.apply(numbers, transposed=True)
        return np.array(numbers, dtype=object)

    @property
    def cost(self) -> int:
        """Number of operations to apply the reflections to one more column."""
        return sum(4 * len(r.indices) for r in self.reflections if len(r.indices) > 1)


def eliminate(
    system: Objects, columns: Sequence[int], doubt: Doubt, *, turns: Sequence[int] | None = None
) -> Elimination:
    """Eliminate columns from a system of rows by Householder reflections: the sparsest first, of equals the last.

    Given the `turns` of columns, those of a lower one come before the others.
    """
    rows = [list(row) for row in system]
    active = list(range(len(rows)))
    usual = {c: typical(_lengths([row[c] for row in rows])) for c in columns}
    largest = max(usual.values(), default=0.0)
    usual = {c: max(length, _SHORT * largest) for c, length in usual.items()}
    done: list[int] = []
    dropped: list[int] = []
    places: list[int] = []
    reflections: list[Reflection] = []
    changed = list(columns)
    fronts: dict[int, list[int]] = {}
    sizes: dict[int, float] = {}
    while True:
        for c in changed:
            front = fronts[c] = [i for i in active if not is_zero(rows[i][c])]
            lengths = _lengths([rows[i][c] for i in front])
            if not front or not np.fmax.reduce(lengths) > ZERO * largest:
                doubt.drop([rows[i][c] for i in front])
                for i in front:
                    rows[i][c] = 0.0
                dropped.append(c)
                sizes.pop(c, None)
            else:
                sizes[c] = typical(lengths) / usual[c]
        if not sizes:
            break
        chosen = _pivot(rows, fronts, sizes, turns)
        touched: set[int] = set()
        kept: list[int] = []
        groups = _alike(fronts[chosen], rows)
        for group in groups:
            kept += group
            if len(kept) > 1 or len(groups) == 1:
                reflection = _reflect({i: rows[i][chosen] for i in kept}, may_vanish=group is not groups[-1])
                touched.update(_apply(reflection, rows, chosen))
                reflections.append(reflection)
                kept = [reflection.indices[0]]
        doubt.note_pivot(reflection.size)
        del sizes[chosen]
        done.append(chosen)
        places += kept
        active.remove(kept[0])
        changed = sorted(touched & sizes.keys())
    n = system.shape[1]
    return Elimination(
        tuple(done),
        tuple(dropped),
        np.array([rows[i] for i in places], dtype=object).reshape(len(places), n),
        np.array([rows[i] for i in active], dtype=object).reshape(len(active), n),
        tuple(reflections),
        tuple(places),
        tuple(active),
    )


def _pivot(
    rows: Sequence[Sequence[Scalar]],
    fronts: Mapping[int, list[int]],
    sizes: Mapping[int, float],
    turns: Sequence[int] | None,
) -> int:
    """Return the first column in order that is not much shorter than the others in its rows."""
    ordered = sorted(sizes, key=lambda c: (turns[c] if turns else 0, len(fronts[c]), -c))
    for c in ordered:
        if sizes[c] >= _SHARE:  # of one
            return c
        near = (other for other in ordered if any(not is_zero(rows[i][other]) for i in fronts[c]))
        if sizes[c] >= _SHARE * max(sizes[other] for other in near):
            return c
    raise AssertionError("the longest column is not shorter than others")


def _alike(front: Sequence[int], rows: Sequence[Sequence[Scalar]]) -> list[list[int]]:
    """Return groups of rows with their zeros in the same columns, those with most zeros first.

    Reflected one group after the other, they share their zeros with few others: of a closure with redundant equations,
    these do not enter those of other loops.
    """
    groups: dict[tuple[bool, ...], list[int]] = {}
    for i in front:
        groups.setdefault(tuple(map(is_zero, rows[i])), []).append(i)
    return [groups[pattern] for pattern in sorted(groups, key=sum, reverse=True)]


def _apply(reflection: Reflection, rows: Sequence[list[Scalar]], column: int) -> list[int]:
    """Apply the reflection that leaves one entry of a column to all rows, in place; return the columns that change."""
    indices = reflection.indices
    touched = [c for c in range(len(rows[0])) if not all(is_zero(rows[i][c]) for i in indices)]
    for c in touched:
        entries: dict[int, Scalar] = {i: rows[i][c] for i in indices}
        if c == column:
            entries = {**dict.fromkeys(indices, 0.0), indices[0]: reflection.pivot}
        else:
            reflection.apply(entries)
        for i in indices:
            rows[i][c] = entries[i]
    return touched


def _reflect(vector_entries: Mapping[int, Scalar], *, may_vanish: bool = False) -> Reflection:
    """Return the matrix that maps a vector, given by its nonzero entries, to the index of the largest.

    Of vectors that may vanish at a pose, the largest entry is changed by far less than rounding: any matrix serves
    then, but it must exist.
    """
    sizes = {k: typical(np.abs(samples(entry))) for k, entry in vector_entries.items()}
    indices = tuple(sorted(sizes, key=lambda k: -sizes[k]))
    entries = [vector_entries[k] for k in indices]
    if len(entries) == 1:
        return Reflection(indices, (1.0,), None, entries[0], absolute(entries[0]))
    if may_vanish:
        entries[0] = entries[0] + _BELOW_ROUNDING
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
        known = product(triangle[i : i + 1, i + 1 :], solution[i + 1 :])[0]
        solution[i] = (right[i] - known) * inverse
    return solution


def projected(relations: Objects, rows: Objects, doubt: Doubt, *, restored: bool = False) -> Objects:
    """Return the part of rows orthogonal to independent relations, shape=(m, n - k); (m, n) if restored.

    If restored, it is in the original coordinates instead of an orthonormal basis of that space.
    """
    stack = [list(row) for row in (*relations, *rows)]
    left = list(range(relations.shape[1]))
    reflections = []
    for i in range(len(relations)):
        entries = {c: stack[i][c] for c in left if not is_zero(stack[i][c])}
        reflections.append(_turn(entries, stack[i + 1 :]))
        left.remove(reflections[-1].indices[0])
        earlier = [stack[i][reflection.indices[0]] for reflection in reflections[:-1]]
        if not all(map(is_zero, earlier)):
            square = reflections[-1].size * reflections[-1].size
            doubt.note_pivot(sqrt(square / (square + total([entry * entry for entry in earlier]))))
    parts = stack[len(relations) :]
    shape = (len(parts), relations.shape[1])
    if not restored:
        return np.array(parts, dtype=object).reshape(shape)[:, left]
    for row in parts:
        for reflection in reversed(reflections):
            row[reflection.indices[0]] = 0.0
        for reflection in reversed(reflections):
            reflection.apply(row, transposed=True)
    return np.array(parts, dtype=object).reshape(shape)


def compressed(rows: Objects) -> Objects:
    """Return rows times an orthogonal matrix, such that no more columns than rows are left."""
    return triangular(rows) if rows.shape[1] > len(rows) else rows


def triangular(rows: Objects) -> Objects:
    """Return rows times an orthogonal matrix, in lower triangular form."""
    stack = [list(row) for row in rows]
    left, taken = list(range(rows.shape[1])), []
    for i, row in enumerate(stack):
        entries = {c: row[c] for c in left if not is_zero(row[c])}
        if not entries:
            continue
        reflection = _turn(entries, stack[i + 1 :])
        for c in reflection.indices:
            row[c] = 0.0
        row[reflection.indices[0]] = reflection.pivot
        left.remove(reflection.indices[0])
        taken.append(reflection.indices[0])
    return np.array(stack, dtype=object).reshape(rows.shape)[:, taken]


def _turn(entries: dict[int, Scalar], rows: Sequence[list[Scalar]]) -> Reflection:
    """Apply the reflection that leaves only the largest entry of a row to the other rows."""
    reflection = _reflect(entries)
    for row in rows:
        reflection.apply(row)
    return reflection


def rank(rows: Objects, *, relative: bool = False) -> int:
    """Return the rank at the median sample pose; singular values are compared with 1, or else with the greatest."""
    if not rows.size:
        return 0
    count = max(np.size(samples(entry)) for entry in rows.ravel())
    values = np.empty((count, *rows.shape))
    for (i, j), entry in np.ndenumerate(rows):
        values[:, i, j] = samples(entry)
    sizes = np.linalg.svd(values[np.isfinite(values).all(axis=(1, 2))], compute_uv=False)
    return int(typical((sizes > ZERO * (sizes[:, :1] if relative else 1.0)).sum(axis=1)))


def squared_singular_values(rows: Objects) -> list[Scalar]:
    """Return the squared singular values of rows in ascending order, each to high relative accuracy.

    One-sided Jacobi rotations (J. Demmel and K. Veselic, SIAM J. Matrix Anal. Appl. 13, 1992), a fixed number.
    """
    work = compressed(rows)
    for _ in range(_SWEEPS if len(rows) > 3 else _SWEEPS - 1):
        for i in range(len(work)):
            for j in range(i + 1, len(work)):
                work[[i, j]] = _orthogonal(work[i], work[j])
    return _ascending([total([entry * entry for entry in row]) for row in work])


def _orthogonal(a: Objects, b: Objects) -> Objects:
    """Rotate two rows into orthogonal ones."""
    aa, bb, ab = (total(list(x * y)) for x, y in ((a, a), (b, b), (a, b)))
    difference, twice = bb - aa, 2.0 * ab
    size = absolute(difference) + sqrt(difference * difference + twice * twice) + _TINY
    tangent = select(less(difference, 0.0), -twice, twice) / size
    cosine = 1.0 / sqrt(1.0 + tangent * tangent)
    sine = cosine * tangent
    return np.stack([cosine * a - sine * b, sine * a + cosine * b])


def _ascending(numbers: list[Scalar]) -> list[Scalar]:
    result = list(numbers)
    for end in range(len(result) - 1, 0, -1):
        for k in range(end):
            result[k], result[k + 1] = minimum(result[k], result[k + 1]), maximum(result[k], result[k + 1])
    return result


def total(terms: Sequence[Scalar]) -> Scalar:
    """Return the sum."""
    result: Scalar = 0.0
    for term in terms:
        result = result + term
    return result


def product(a: Objects, b: Objects) -> Objects:
    """Return the matrix product; unlike `@`, also for empty axes."""
    result = zeros(a.shape[0], b.shape[1])
    for i, row in enumerate(a):
        terms = [(x, b[k]) for k, x in enumerate(row) if not is_zero(x)]
        for j in range(b.shape[1]):
            result[i, j] = total([x * other[j] for x, other in terms if not is_zero(other[j])])
    return result


def samples(number: Scalar) -> Array | float:
    """Return the values at the sample poses."""
    return number.samples if isinstance(number, Number) else float(number)


def typical(values: Array | float) -> float:
    """Return the median over the samples at which a number exists; ProgramError if it exists at none."""
    finite = np.asarray(values)[np.isfinite(values)]
    if not finite.size:
        raise ProgramError("a number of the program is undefined at all sample poses")
    finite.sort()
    middle = len(finite) // 2
    return float(finite[middle] if len(finite) % 2 else (finite[middle - 1] + finite[middle]) / 2.0)


def zeros(rows: int, columns: int) -> Objects:
    """Return a matrix of zeros."""
    matrix = np.empty((rows, columns), dtype=object)
    matrix[:] = 0.0
    return matrix


def without_zeros(rows: Objects, doubt: Doubt) -> Objects:
    """Return rows in which entries that vanish at all sample poses, compared with 1, are zeros."""
    kept = rows.copy()
    for place, entry in np.ndenumerate(rows):
        if np.nanmax(np.abs(samples(entry))) <= DROPPED:
            doubt.drop([entry])
            kept[place] = 0.0
    return kept


def identity(size: int) -> Objects:
    """Return the identity matrix."""
    matrix = zeros(size, size)
    np.fill_diagonal(matrix, 1.0)
    return matrix


def _lengths(entries: Sequence[Scalar]) -> Array:
    """Return the length of a vector at every sample pose; an array of size 0 if it has no entries."""
    squares = sum((np.square(samples(entry)) for entry in entries), np.zeros(1))
    lengths: Array = np.sqrt(squares)
    return lengths
