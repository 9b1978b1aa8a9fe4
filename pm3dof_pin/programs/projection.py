"""Rows times orthogonal matrices, on recorded numbers: projections, triangular forms, ranks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pm3dof_pin.programs.elimination import ZERO, Doubt, Reflection, reflect, samples, total, typical
from pm3dof_pin.programs.graph import Scalar, is_zero, sqrt
from pm3dof_pin.typing import Objects


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
    reflection = reflect(entries)
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
