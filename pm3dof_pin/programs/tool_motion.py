"""The motion of a frame as a linear function of sources: spring deflections, commands, geometric errors.

Unknowns are the frame's twist x, the rates of passive joints and the sources, in the equations of
:mod:`pm3dof_pin.programs.motion_equations`. Those connected through passive joints and sources form a *branch*. From
each branch the passive joints are eliminated by orthogonal transformations, sparsest first; the remaining equations
describe how the branch holds the frame.

Lengths are measured in a power of two near the mechanism's characteristic length, so that numbers compared with 1 are
of that size.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.programs.elimination import (
    DROPPED,
    Doubt,
    eliminate,
    identity,
    product,
    samples,
    solve_upper,
    total,
    triangular,
    without_zeros,
    zeros,
)
from pm3dof_pin.programs.graph import is_zero, sqrt
from pm3dof_pin.programs.joints import Transform, cross, objects
from pm3dof_pin.programs.motion_equations import Block, Column, motion_equations, widened
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Objects


@dataclass(frozen=True, eq=False)
class Displacement:
    """Small twists of everything beyond a place, and which closure frames they move, and whether the tool frame."""

    place: Transform
    frames: frozenset[str]
    local: Objects  #: twists [v; omega] at the place, in its axes, shape=(6, k)


@dataclass(frozen=True, eq=False)
class Lengthening:
    """Changes of the length of a closure of type "distance"."""

    closure: int  #: its number
    count: int = 1  #: how many of the same effect


@dataclass(frozen=True, eq=False)
class Branch:
    """How one branch holds the frame: twist @ x + motion @ s = 0 and relations @ s = 0, with its sources s."""

    sources: tuple[int, ...]  #: numbers of its sources
    twist: Objects  #: shape=(n, 6)
    motion: Objects  #: shape=(n, number of its sources)
    relations: Objects  #: equations among its sources, shape=(k, number of its sources)
    weighted: Objects  #: motion in other variables than its sources, see :func:`branches`, shape=(n, w)
    weighted_relations: Objects  #: relations in these, shape=(k, w)


def branches(
    tree: Tree,
    frame: str,
    passive: Sequence[Column],
    sources: Sequence[Column],
    doubt: Doubt,
    *,
    joined: Iterable[Sequence[int]] = (),
    weights: Callable[[tuple[int, ...], Objects], Objects] | None = None,
) -> list[Branch]:
    """Eliminate the passive joints.

    Args:
        tree: the mechanism.
        frame: the frame whose twist is sought.
        passive: the passive joints' columns.
        sources: the sources' columns.
        doubt: records pivots and dropped entries.
        joined: numbers of sources that must be in one branch.
        weights: function of the numbers of a branch's sources and its equations, shape=(m, number of its sources),
            that returns the equations in other variables, shape=(m, w); the sources themselves only decide ranks.
    """
    equations = motion_equations(tree, tree.mechanism.length_unit, passive, sources, frame)
    return _branches(equations.twist, equations.rates, equations.unknown, doubt, joined, weights)


def _branches(
    twist: Objects,
    rates: Objects,
    count: int,
    doubt: Doubt,
    joined: Iterable[Sequence[int]] = (),
    weights: Callable[[tuple[int, ...], Objects], Objects] | None = None,
) -> list[Branch]:
    """Eliminate the first columns of rates, `count` of them; the others are sources."""
    result = []
    for rows, members in _components(rates, [[count + k for k in group] for group in joined]):
        joints = [c for c in members if c < count]
        inputs = tuple(c - count for c in members if c >= count)
        motion = rates[np.ix_(rows, [count + k for k in inputs])]
        weighted = weights(inputs, motion) if weights else zeros(len(rows), 0)
        branch = _branch(rates[np.ix_(rows, joints)], motion, weighted, twist[rows], inputs, doubt)
        if len(branch.twist) or len(branch.relations):
            result.append(branch)
    return result


@dataclass(frozen=True, eq=False)
class Reading:
    """A given rate, linear or angular, that is a row, shape=(6,), times the frame's twist [v; omega]."""

    row: Objects
    is_length: bool


def response(
    tree: Tree,
    frame: str,
    passive: Sequence[Column],
    sources: Sequence[Column],
    doubt: Doubt,
    readings: Sequence[Reading] = (),
) -> Objects:
    """Record how a frame moves with its sources, with passive joints following and nothing strained.

    Sources are rates of joints, or of displacements anywhere; readings are further rates, given as components of the
    frame's motion; all other joints are fixed. Returns the frame's twist [v; omega] at its origin, world axes, for one
    unit of each source, then of each reading, shape=(6, s).

    Raises:
        ProgramError: at the sample poses, the frame can move with all sources at rest, or loops cannot close with a
            source.
    """
    held = branches(tree, frame, passive, sources, doubt)
    solution, strains = _solution(frame, held, len(sources), readings, doubt)
    _require_zero(strains, doubt)
    return _scaled(solution, [*(s.slides for s in sources), *(reading.is_length for reading in readings)], tree)


def response_to_displacements(
    tree: Tree,
    frame: str,
    passive: Sequence[Column],
    drives: Sequence[Column],
    displacements: Sequence[Displacement | Lengthening],
    doubt: Doubt,
    *,
    shared: bool = False,
) -> tuple[Objects, Objects]:
    """Record how a frame moves with displacements anywhere, and with drives, as :func:`response` does.

    The adjoint way: the sources are the equations themselves, whose number does not grow with that of the
    displacements. Their solution gives six covectors, and further ones that must vanish, for whatever moves the same
    frames; a displacement is their product with a twist, a lengthening opens one equation. Returns the frame's twists
    for one unit of each, shape=(6, k), and for one unit of each drive, shape=(6, u). If they are shared
    by more drives than degrees of freedom, these give way by the least norm, rates of slides in units of length.

    Raises:
        ProgramError: see :func:`response`.
    """
    count, unit, tool = len(drives), tree.mechanism.length_unit, tree.frame(frame).translation
    equations = motion_equations(tree, unit, passive, drives, frame, displaced=True)
    size = len(equations.rates)
    held = _branches(equations.twist, np.hstack([equations.rates, identity(size)]), equations.unknown, doubt)
    solve = partial(_shared_solution, drives=count) if shared else _solution
    solution, strains = solve(frame, held, count + size, (), doubt)
    _require_zero(strains[:, :count], doubt)
    by_drives = _scaled(solution[:, :count], [drive.slides for drive in drives], tree)
    by_rows = np.vstack([solution, strains])[:, count:]
    covectors: dict[frozenset[str], Objects] = {}
    results = []
    for moved in displacements:
        if isinstance(moved, Lengthening):
            rows = next(block.rows for block in equations.blocks if block.closure == moved.closure)
            results += [by_rows[:, rows] * (-1.0 / unit)] * moved.count
            continue
        if moved.frames not in covectors:
            covectors[moved.frames] = _covectors(by_rows, moved.frames, equations.blocks)
        along, about = np.split(covectors[moved.frames], 2, axis=1)
        lever = (tool - moved.place.translation) * (1.0 / unit)
        local = [along * (1.0 / unit)]
        if any(not is_zero(entry) for entry in moved.local[3:].ravel()):
            local.append(about + objects([cross(lever, row) for row in along]))
        turned = [product(part, moved.place.rotation) for part in local]
        results.append(
            sum(product(part, twists) for part, twists in zip(turned, np.split(moved.local, 2), strict=False))
        )
    found = np.hstack(results) if results else zeros(len(by_rows), 0)
    _require_zero(found[6:], doubt)
    return _scaled(found[:6], [False] * found.shape[1], tree), by_drives


def _covectors(by_rows: Objects, moved: frozenset[str], blocks: Iterable[Block]) -> Objects:
    """Return what a scaled twist at the tool of everything that moves some frames gives, shape=(n, 6)."""
    result = zeros(len(by_rows), 6)
    for block in blocks:
        if factor := sum(block.terms[name] for name in moved & block.terms.keys()):
            result = result + product(by_rows[:, block.rows], block.taken) * factor
    return result


def _solution(
    frame: str, held: Sequence[Branch], count: int, readings: Sequence[Reading], doubt: Doubt
) -> tuple[Objects, Objects]:
    """Return minus the frame's scaled twist for each source and reading, and equations that these must satisfy."""
    if not held and not readings:
        raise ProgramError(f"no branch carries '{frame}'")
    every = count + len(readings)
    given = zeros(len(readings), every)
    for k in range(len(readings)):
        given[k, count + k] = -1.0
    twists = np.vstack([*(branch.twist for branch in held), *(reading.row[None] for reading in readings)])
    motions = np.vstack([*(widened(branch.motion, branch.sources, every) for branch in held), given])
    result = eliminate(np.hstack([twists, motions]), range(6), doubt)
    if len(result.columns) < 6:
        raise ProgramError(f"'{frame}' can move with all sources at rest, at every sample pose")
    strains = [result.rest[:, 6:], *(widened(branch.relations, branch.sources, every) for branch in held)]
    return _back_substituted(result.pivot_rows, list(result.columns), doubt), np.vstack(strains)


def _back_substituted(rows: Objects, order: list[int], doubt: Doubt) -> Objects:
    """Solve six equations, upper triangular in the order of their first six columns, for all further columns."""
    triangle = rows[:, order]
    inverse = solve_upper(triangle, identity(6))
    size = sqrt(total([e * e for e in triangle.ravel()]) * total([e * e for e in inverse.ravel()]))
    doubt.note_pivot(6.0 / size)
    return solve_upper(triangle, rows[:, 6:])[np.argsort(order)]


def _shared_solution(
    frame: str, held: Sequence[Branch], count: int, readings: Sequence[Reading], doubt: Doubt, *, drives: int
) -> tuple[Objects, Objects]:
    """Return what :func:`_solution` does if the first sources, too many drives, give way by the least norm.

    Each branch's equations are combined to some whose coefficients of drives are orthonormal; what is left of the
    twist's equations is then the drives' least norm. Equations without drives are met exactly.
    """
    exact, weighted = [zeros(0, 6 + count)], [zeros(0, 6 + count)]
    for branch in held:
        rows = np.hstack([branch.twist, widened(branch.motion, branch.sources, count)])
        relations = np.hstack([zeros(len(branch.relations), 6), widened(branch.relations, branch.sources, count)])
        every = np.vstack([relations, rows])
        every[:, : 6 + drives] = without_zeros(every[:, : 6 + drives], doubt)
        first = eliminate(every, range(6, 6 + drives), doubt)
        exact.append(first.rest)
        triangle = triangular(first.pivot_rows[:, 6 : 6 + drives])
        weighted.append(solve_upper(triangle[::-1, ::-1], first.pivot_rows[::-1])[::-1])
    known = np.vstack(exact)
    known[:, :6] = without_zeros(known[:, :6], doubt)
    given = eliminate(known, range(6), doubt)
    left = np.vstack(weighted)
    for k, column in enumerate(given.columns):
        row = given.pivot_rows[k]
        inverse = 1.0 / row[column]
        for other in left:
            other -= row * (other[column] * inverse)
            other[column] = 0.0
    rest = eliminate(left, [k for k in range(6) if k not in given.columns], doubt)
    order = [*given.columns, *rest.columns]
    if len(order) < 6:
        raise ProgramError(f"'{frame}' can move with all sources at rest, at every sample pose")
    assert not readings
    return _back_substituted(np.vstack([given.pivot_rows, rest.pivot_rows]), order, doubt), given.rest[:, 6:]


def _require_zero(strains: Objects, doubt: Doubt) -> None:
    """Drop entries that are zero if the loops close with the sources; raise ProgramError if they are not."""
    for entry in strains.ravel():
        if np.max(np.abs(samples(entry))) > DROPPED:
            raise ProgramError("the loops cannot close with a source")
        doubt.drop([entry])


def _scaled(solution: Objects, are_lengths: Sequence[bool], tree: Tree) -> Objects:
    """Return twists in metres and radians, by one unit of each source."""
    unit = tree.mechanism.length_unit
    twists: Objects = solution * -1.0
    twists[:3] = twists[:3] * unit
    for k, is_length in enumerate(are_lengths):
        if is_length:
            twists[:, k] = twists[:, k] * (1.0 / unit)
    return twists


def _components(rates: Objects, joined: Iterable[Sequence[int]]) -> list[tuple[list[int], list[int]]]:
    """Return the connected components, as rows and columns."""
    owner = list(range(rates.shape[0] + rates.shape[1]))

    def find(k: int) -> int:
        while owner[k] != k:
            k = owner[k]
        return k

    def join(a: int, b: int) -> None:
        owner[find(a)] = find(b)

    m = rates.shape[0]
    for i, row in enumerate(rates):
        for c, entry in enumerate(row):
            if not is_zero(entry):
                join(i, m + c)
    for group in joined:
        for c in group[1:]:
            join(m + group[0], m + c)
    parts: dict[int, tuple[list[int], list[int]]] = {}
    for k in range(len(owner)):
        rows, members = parts.setdefault(find(k), ([], []))
        (rows if k < m else members).append(k if k < m else k - m)
    return [part for part in parts.values() if part[0]]


def _branch(
    passive: Objects, motion: Objects, weighted: Objects, twist: Objects, sources: tuple[int, ...], doubt: Doubt
) -> Branch:
    """Eliminate the passive joints of one branch, and the twist if there are more equations than it enters."""
    ports = [i for i, row in enumerate(twist) if not all(map(is_zero, row))]
    count = len(sources)
    selected = zeros(len(motion), len(ports))
    for k, row in enumerate(ports):
        selected[row, k] = 1.0
    carried = np.hstack([motion, weighted])
    wanted = weighted if weighted.shape[1] else motion
    filled = sum(not is_zero(entry) for entry in wanted.ravel())
    first = eliminate(passive, range(passive.shape[1]), doubt)
    complement = first.complement()
    held = product(complement, selected)
    explicit = 2 * len(complement) * filled  # cost of a product with the complement
    is_explicit = explicit < first.cost * wanted.shape[1]
    relations = zeros(0, carried.shape[1])
    if len(held) <= len(ports):
        rest = product(complement, carried) if is_explicit else first.carry(carried)[1]
    else:
        second = eliminate(held, range(len(ports)), doubt)
        held = second.pivot_rows
        in_turn = second.cost * wanted.shape[1] + min(explicit, first.cost * wanted.shape[1])
        if second.cost * len(motion) + explicit < in_turn:
            rest, relations = (product(rows, carried) for rows in second.carry(complement))
        else:
            rest, relations = second.carry(product(complement, carried) if is_explicit else first.carry(carried)[1])
        relations = relations[[k for k, row in enumerate(relations) if not all(map(is_zero, row))]]
    return Branch(
        sources,
        product(held, twist[ports]),
        *(rest[:, :count], relations[:, :count]),
        *(rest[:, count:], relations[:, count:]),
    )
