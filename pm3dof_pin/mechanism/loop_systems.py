"""The loop equations of a mechanism, split into systems that can be solved one after another.

Equations that determine their own joints are solved first, then those that do so given these joints; what shares joints
after that is solved together. Motions that leave the loops closed in any configuration, such as the spin of a rod
between two balls, are left out: one entry of v for each is at rest. The sign of the determinant of a system changes
only at a configuration at which the quantities given do not determine the joints: a singular one. Both engines split by
the same rules, each from its own Jacobians at the same closed configurations.
"""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.arrays import median
from pm3dof_pin.tolerances import MIN_LEVER
from pm3dof_pin.typing import Array, Mask, Matrix

ZERO = MIN_LEVER
"""Entries of scaled Jacobians up to this at all samples are treated as zero: lever arms as short as frames are off."""

RANK = 1e-6
"""Least relative singular value of equations that determine their joints."""

_SURPLUS = 1e-3  # of an entry that an equation holds besides its own unknowns, scaled

_EXACT_BITS = 53  # of whole numbers in floating point

_SHARE = 0.3  # of the greatest, of an entry that can stand for an idle motion; engines must not choose by rounding


@dataclass(frozen=True, eq=False)
class LoopEquations:
    """Equations of one closure, or of the tool: scaled derivatives by the entries of v, at sample configurations."""

    indices: tuple[int, ...]  #: the entries of v
    samples: Array  #: shape=(s, rows, number of indices)

    def moving(self, found: Iterable[int]) -> tuple[int, ...]:
        """Return the entries of v that move the equations and are not yet found."""
        sizes = np.nanmax(np.abs(self.samples), axis=(0, 1), initial=0.0)
        return tuple(sorted(k for k, size in zip(self.indices, sizes, strict=True) if size > ZERO and k not in found))


@dataclass(frozen=True, eq=False)
class LoopSystem:
    """Equations that are solved together for some entries of v."""

    equations: tuple[int, ...]  #: which equations, in order
    unknowns: tuple[int, ...]  #: the entries of v to solve for
    is_determined: bool  #: whether the equations determine the unknowns
    #: as many combinations of the rows as unknowns, which hold all equations, shape=(number of unknowns, rows); None if
    #: the unknowns are not determined, or there are more equations and no such combinations are the same at all samples
    rows: Matrix | None


def sign_weights(count: int) -> list[int]:
    """Return what each of some signs of determinants adds to the number of a branch if it differs from home's.

    Bits; of more signs than a floating-point number has bits, random numbers, so large that all sums are still exact
    and that two branches are hardly ever given the same one: of a million branches by 128 signs once in a hundred runs.
    """
    if count < _EXACT_BITS:
        return [1 << bit for bit in range(count)]
    generator, size = random.Random(count), _EXACT_BITS - count.bit_length()
    return [1 + generator.getrandbits(size) for _ in range(count)]


@dataclass(frozen=True, eq=False)
class IdleMotions:
    """Combinations of entries of v that leave all equations as they are, in any configuration."""

    moving: tuple[int, ...]  #: the entries of v that they move
    at_rest: tuple[int, ...]  #: as many of these as there are such motions, which are zero in place of them


def idle_motions(equations: Sequence[LoopEquations], held: Iterable[int]) -> IdleMotions:
    """Find the combinations of entries of v, apart from `held` ones, with the same zero derivatives at all samples."""
    entries = sorted({k for equation in equations for k in equation.moving(held)})
    if not entries:
        return IdleMotions((), ())
    matrices = [stacked([(e.indices, e.samples)], entries).reshape(-1, len(entries)) for e in equations]
    rows = np.concatenate(matrices)
    rows = rows[np.isfinite(rows).all(axis=1)]
    sizes, motions = np.linalg.eigh(rows.T @ rows)
    idle = motions[:, sizes <= len(rows) * ZERO**2]
    projection = idle @ idle.T  # which, unlike a basis, is unique
    moving = np.flatnonzero(np.diag(projection) > ZERO)
    at_rest: list[int] = []
    for _ in range(idle.shape[1]):
        shares = np.diag(projection)
        chosen = int(np.flatnonzero(shares >= _SHARE * shares.max())[0])
        projection = projection - np.outer(projection[:, chosen], projection[chosen]) / shares[chosen]
        at_rest.append(entries[chosen])
    return IdleMotions(tuple(entries[k] for k in moving), tuple(sorted(at_rest)))


def split(equations: Sequence[LoopEquations], held: Iterable[int]) -> tuple[list[LoopSystem], IdleMotions]:
    """Split equations into systems, in an order in which they can be solved, but for idle motions.

    The `held` entries of v are given.
    """
    waiting, given = list(range(len(equations))), set(held)
    idle = idle_motions(equations, given)
    found = given | set(idle.at_rest)
    systems: list[LoopSystem] = []
    while waiting:
        choices = (_system(equations, (index,), equations[index].moving(found)) for index in waiting)
        chosen = next((system for system in choices if system.is_determined), None)
        if chosen is None:
            break
        waiting.remove(chosen.equations[0])
        found |= set(chosen.unknowns)
        systems.append(chosen)
    systems += [_system(equations, *group) for group in joined(equations, found, waiting)]
    used = {index for system in systems for index in system.equations}
    spent = [LoopSystem((index,), (), False, None) for index in range(len(equations)) if index not in used]
    return _with_surplus(equations, [*systems, *spent], given | set(idle.at_rest)), idle


def _with_surplus(
    equations: Sequence[LoopEquations], systems: Iterable[LoopSystem], given: set[int]
) -> list[LoopSystem]:
    """Join systems whose equations hold unknowns of earlier ones, too: only together do they tell where they end.

    Of a plate on three cranks, two of them are a parallelogram, whose flat pose the third holds.
    """

    def moved_by(system: LoopSystem) -> set[int]:
        return {k for index in system.equations for k in equations[index].moving(given)}

    result: list[LoopSystem] = []
    for system in systems:
        earlier = moved_by(system) - set(system.unknowns)
        if not _holds(equations, system, tuple(sorted(earlier))):
            result += [system] if system.unknowns else []
            continue
        group = [s for s in result if set(s.unknowns) & earlier]
        while True:
            unknowns = {k for s in group for k in s.unknowns}
            needed = {k for s in (*group, system) for k in moved_by(s)}
            later = list[LoopSystem]()
            for other in (s for s in result if s not in group):
                if moved_by(other) & unknowns.union(*(s.unknowns for s in later)):
                    later.append(other)
            circular = [s for s in later if set(s.unknowns) & needed]
            if not circular:
                break
            group += circular
        members = sorted({index for s in (*group, system) for index in s.equations})
        whole = _system(equations, tuple(members), tuple(sorted(unknowns.union(system.unknowns))))
        result = [*(s for s in result if s not in group and s not in later), whole, *later]
    return result


def _holds(equations: Sequence[LoopEquations], system: LoopSystem, earlier: tuple[int, ...]) -> bool:
    """Tell whether a system's equations still restrict earlier unknowns once its own are eliminated."""
    parts = [(equations[index].indices, equations[index].samples) for index in system.equations]
    own, others = stacked(parts, system.unknowns), stacked(parts, earlier)
    finite = np.isfinite(own).all(axis=(1, 2)) & np.isfinite(others).all(axis=(1, 2))
    if not earlier or not finite.any() or (system.unknowns and not system.is_determined):
        return False
    basis = np.linalg.qr(own[finite])[0]
    rest = others[finite] - basis @ (np.swapaxes(basis, 1, 2) @ others[finite])
    return bool(median(np.abs(rest).max(axis=(1, 2))) > _SURPLUS)


def joined(
    equations: Sequence[LoopEquations], found: Iterable[int], indices: Iterable[int]
) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Group equations, by index, that share entries of v not yet found; return each group and these entries."""
    groups: list[tuple[list[int], set[int]]] = []
    for index in indices:
        members, unknowns = [index], set(equations[index].moving(found))
        for other in [other for other in groups if other[1] & unknowns]:
            groups.remove(other)
            members, unknowns = [*other[0], *members], unknowns | other[1]
        if unknowns:
            groups.append((members, unknowns))
    return [(tuple(sorted(members)), tuple(sorted(unknowns))) for members, unknowns in groups]


def stacked(parts: Sequence[tuple[tuple[int, ...], Array]], unknowns: Sequence[int]) -> Array:
    """Stack the rows of equations, (indices, shape=(..., rows, number of indices)), with columns by the unknowns."""
    samples = np.broadcast_shapes(*(values.shape[:-2] for _, values in parts))
    blocks = []
    for indices, values in parts:
        block = np.zeros((*samples, values.shape[-2], len(unknowns)))
        for column, k in enumerate(unknowns):
            if k in indices:
                block[..., column] = values[..., indices.index(k)]
        blocks.append(block)
    return np.concatenate(blocks, axis=-2)


def connected(pattern: Mask) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return the rows and columns of each connected block of a matrix of booleans, shape=(m, n)."""
    blocks: list[tuple[set[int], set[int]]] = []
    for row, entries in enumerate(pattern):
        rows, columns = {row}, set(np.flatnonzero(entries).tolist())
        for other in [other for other in blocks if other[1] & columns]:
            blocks.remove(other)
            rows, columns = rows | other[0], columns | other[1]
        blocks.append((rows, columns))
    return [(tuple(sorted(rows)), tuple(sorted(columns))) for rows, columns in blocks]


def signed_blocks(rates: Array) -> list[tuple[tuple[int, ...], tuple[int, ...]]]:
    """Return the blocks of the drives' rates by those of some quantities whose determinants have signs.

    Those that are square, and not singular at all samples, as of a platform on legs whose ends are similar hexagons.

    Args:
        rates: the scaled rates at samples, NaN where one is singular, shape=(s, drives, quantities).
    """
    blocks = connected(np.nanmax(np.abs(rates), axis=0, initial=0.0) > ZERO)
    known = rates[np.isfinite(rates).all(axis=(1, 2))]

    def is_regular(block: tuple[tuple[int, ...], tuple[int, ...]]) -> bool:
        rows, columns = block
        singular = np.linalg.svd(known[:, rows][:, :, columns], compute_uv=False)
        return bool(median(singular[:, -1]) > RANK * median(singular[:, 0]))

    return [block for block in blocks if len(block[0]) == len(block[1]) and (not len(known) or is_regular(block))]


def _system(equations: Sequence[LoopEquations], members: tuple[int, ...], unknowns: tuple[int, ...]) -> LoopSystem:
    matrices = stacked([(equations[index].indices, equations[index].samples) for index in members], unknowns)
    matrices = matrices[np.isfinite(matrices).all(axis=(1, 2))]
    samples, rows, columns = matrices.shape
    if not 0 < columns <= rows or not samples:
        return LoopSystem(members, unknowns, False, None)
    singular = np.linalg.svd(matrices, compute_uv=False)
    is_determined = bool(median(singular[:, -1]) > RANK * median(singular[:, 0]))
    return LoopSystem(members, unknowns, is_determined, _essential_rows(matrices) if is_determined else None)


def _essential_rows(matrices: Array) -> Matrix | None:
    """Return the combinations of rows that hold everything at all samples, if these are as many as the columns."""
    _, rows, columns = matrices.shape
    kept = np.flatnonzero(np.abs(matrices).max(axis=(0, 2)) > ZERO)
    if len(kept) == columns:
        return np.eye(rows)[kept]
    left, values, _ = np.linalg.svd(np.concatenate(list(matrices), axis=1), full_matrices=False)
    constant = not len(values) > columns or bool(values[columns] <= RANK * values[0])
    return np.asarray(left[:, :columns].T) if constant else None
