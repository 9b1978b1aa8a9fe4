"""What of the closures moves the tool: covectors, and combinations of redundant closures that nothing moves.

Closures that are a little open, by e, move the tool by the covectors times e while the drives are held. Joints that
move one closure only are eliminated there, by orthogonal transformations of its few rows; the rest is one dense
problem, about as large as there are legs instead of joints. The least norm is the same after such transformations.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE
from pm3dof_pin.typing import Array, Indices, Mask

_SOUND = 0.1 / RANK_TOLERANCE  # a square matrix of lower condition has no singular value near the tolerance


class RankInDoubtError(ArithmeticError):
    """Singular values decide, more slowly."""


class Covectors(NamedTuple):
    """Rows that act on the openings of all closures, shape=(n, ..., closures)."""

    tool: Array  #: the tool's motion, shape=(n, 6, closures)
    unmet: Array  #: random combinations that no joint moves, shape=(n, 0 or 2, closures)


def covectors(
    closures: Sequence[tuple[Array, Indices]], tool: Array, free: Indices, driven: Indices, excess: int
) -> Covectors:
    """Return the covectors of closures at n poses, from the columns that move them.

    Args:
        closures: of each closure its rows, shape=(n, rows, moving), and the numbers of their columns, shape=(moving,).
        tool: the tool's motion by all columns, shape=(n, 6, columns).
        free: columns of joints that follow.
        driven: columns of drives.
        excess: how many more drives there are than degrees of freedom; they give way by the least norm.

    Raises:
        RankInDoubtError: of the followers, or of relations between the drives.
    """
    movers = np.zeros(tool.shape[2], dtype=np.intp)
    for _, moving in closures:
        movers[moving] += 1
    alone, place = np.zeros(tool.shape[2], dtype=bool), np.full(tool.shape[2], -1)
    alone[free] = movers[free] == 1
    rest = np.concatenate([free[~alone[free]], driven if excess else driven[:0]])
    place[rest] = np.arange(len(rest))
    through, parts, reduced = tool[:, :, rest], [], []
    for rows, moving in closures:
        own, others = alone[moving], place[moving] >= 0
        inverse, beyond = _pseudo_inverses(rows[:, :, own])
        fixed = tool[:, :, moving[own]] @ inverse
        through[:, :, place[moving[others]]] -= fixed @ rows[:, :, others]
        left = np.zeros((len(tool), beyond.shape[1], len(rest)))
        left[:, :, place[moving[others]]] = beyond @ rows[:, :, others]
        parts.append((fixed, beyond))
        reduced.append(left)
    followers = len(rest) - (len(driven) if excess else 0)
    passive, drives = np.split(np.concatenate(reduced, axis=1), [followers], axis=2)
    by_passive, by_drives = np.split(through, [followers], axis=2)
    inverse, beyond = _pseudo_inverses(passive)
    acting, unmet = by_passive @ inverse, np.zeros((len(tool), 0, passive.shape[1]))
    if excess:
        given, relations = np.linalg.qr(np.swapaxes(beyond @ drives, 1, 2))
        unrelated, _ = _pseudo_inverses(np.swapaxes(relations, 1, 2))
        acting = acting + (by_drives - acting @ drives) @ given @ unrelated @ beyond
    elif beyond.shape[1]:
        unmet = np.random.default_rng(0).standard_normal((2, beyond.shape[1])) @ beyond
    bounds = np.cumsum([beyond.shape[1] for _, beyond in parts])[:-1]
    pieces = zip(parts, np.split(acting, bounds, axis=2), np.split(unmet, bounds, axis=2), strict=True)
    whole = [(fixed + own @ beyond, lost @ beyond) for (fixed, beyond), own, lost in pieces]
    return Covectors(*(np.concatenate(part, axis=2) for part in zip(*whole, strict=True)))


def _pseudo_inverses(matrices: Array) -> tuple[Array, Array]:
    """Return inverses by the least norm, shape=(n, columns, rows), and orthonormal combinations of rows that vanish.

    Raises:
        RankInDoubtError: columns may depend on each other.
    """
    count = matrices.shape[2]
    if matrices.shape[1] <= count:
        found, sound = inverses(matrices)
        beyond = np.empty((len(matrices), 0, matrices.shape[1]))
    else:
        turned, triangular = np.linalg.qr(matrices, mode="complete")
        within, beyond = np.split(np.swapaxes(turned, 1, 2), [count], axis=1)
        found, sound = inverses(triangular[:, :count])
        found = found @ within
    if not sound.all():
        raise RankInDoubtError
    return found, beyond


def inverses(matrices: Array) -> tuple[Array, Mask]:
    """Return inverses, much faster than by singular values, and where they leave no doubt about the rank."""
    if matrices.shape[1] == matrices.shape[2]:
        with contextlib.suppress(np.linalg.LinAlgError):  # some are singular
            found = np.linalg.inv(matrices)
            condition = np.linalg.norm(matrices, axis=(1, 2)) * np.linalg.norm(found, axis=(1, 2))
            return np.asarray(found), np.asarray(condition < _SOUND)
    return matrices, np.zeros(len(matrices), dtype=bool)
