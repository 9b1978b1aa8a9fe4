"""What each candidate would add to the information of chosen poses, followed while poses are exchanged.

With the information M of the chosen poses, candidates are judged by A M^-1 A^T alone, and by A M^-1 Q M^-1 A^T where
the tip's variance tr(Q M^-1) matters. A pose that comes or goes changes M by a matrix of the rank of its few rows, and
these small blocks by Woodbury's formula: a number of operations linear in the parameters, not quadratic.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
import scipy.linalg

from pm3dof_pin.typing import Array

_NEARLY_ALONE = 1e-7
"""If less of some direction's information remains without a pose, a difference would cancel."""


@dataclass(frozen=True, eq=False)
class CandidateInformation:
    """What every candidate shows of the inverse information of chosen poses, M^-1 = M_0^-1 + U D U^T."""

    rows: Array  #: A of all candidates, shape=(n, r, p)
    tip: Array | None  #: Q, shape=(p, p)
    inverse: Array  #: M_0^-1 of the poses chosen first, shape=(p, p)
    changes: Array  #: U, by the poses that came and went since then, shape=(p, m)
    weights: Array  #: D, shape=(m, m)
    seen: Array  #: A M^-1 A^T, shape=(n, r, r)
    seen_tip: Array | None  #: A M^-1 Q M^-1 A^T, shape=(n, r, r)

    @classmethod
    def from_rows(cls, rows: Array, information: Array, tip: Array | None) -> CandidateInformation:
        """Compute it from M, shape=(p, p)."""
        root = np.linalg.inv(np.linalg.cholesky(information)).T
        along = (rows.reshape(-1, rows.shape[2]) @ root).reshape(rows.shape)
        seen, seen_tip = along @ np.swapaxes(along, 1, 2), None
        if tip is not None:
            seen_tip = (along @ (root.T @ tip @ root)) @ np.swapaxes(along, 1, 2)
        return cls(rows, tip, root @ root.T, np.zeros((len(root), 0)), np.zeros((0, 0)), seen, seen_tip)

    def changed(self, index: int, sign: float) -> CandidateInformation | None:
        """Return it with (1) or without (-1) a candidate among the chosen; None if it must be computed from rows."""
        block = self.rows[index]
        inner = np.eye(len(block)) + sign * self.seen[index]
        if np.linalg.eigvalsh(inner)[0] < _NEARLY_ALONE:
            return None
        along, middle = self._solved(block.T), -sign * np.linalg.inv(inner)
        weighted = None if self.tip is None else self.tip @ along
        columns = along if weighted is None else np.hstack([along, self._solved(weighted)])
        # the rows of all candidates are read once: memory limits this product
        products = (self.rows.reshape(-1, self.rows.shape[2]) @ columns).reshape(*self.rows.shape[:2], -1)
        shown = products[..., : along.shape[1]]
        moved = shown @ middle
        seen, seen_tip = self.seen + moved @ np.swapaxes(shown, 1, 2), None
        if weighted is not None and self.seen_tip is not None:
            crossed = moved @ np.swapaxes(products[..., along.shape[1] :], 1, 2)
            twice = moved @ (along.T @ weighted) @ np.swapaxes(moved, 1, 2)
            seen_tip = self.seen_tip + crossed + np.swapaxes(crossed, 1, 2) + twice
        changes, weights = np.hstack([self.changes, along]), scipy.linalg.block_diag(self.weights, middle)
        return CandidateInformation(self.rows, self.tip, self.inverse, changes, weights, seen, seen_tip)

    def _solved(self, columns: Array) -> Array:
        """Return M^-1 times columns."""
        return np.asarray(self.inverse @ columns + self.changes @ (self.weights @ (self.changes.T @ columns)))


class Criterion(Protocol):
    """What a plan makes as great as possible."""

    @property
    def tip(self) -> Array | None:
        """Q, if the criterion needs it, shape=(p, p)."""
        ...

    def value(self, information: Array) -> float:
        """Return the criterion of an information, shape=(p, p)."""
        ...

    def gains(self, state: CandidateInformation) -> Array:
        """Return the gain by each candidate, shape=(n,)."""
        ...


class Determinant:
    """log det M."""

    tip = None

    def value(self, information: Array) -> float:
        """See :class:`Criterion`."""
        return float(np.linalg.slogdet(information)[1])

    def gains(self, state: CandidateInformation) -> Array:
        """Return log det(1 + A M^-1 A^T)."""
        return np.asarray(np.linalg.slogdet(np.eye(state.seen.shape[1]) + state.seen)[1])


class TipVariance:
    """Minus the predicted tip variance, tr(Q M^-1)."""

    def __init__(self, tip: Array) -> None:
        self.tip = tip

    def value(self, information: Array) -> float:
        """See :class:`Criterion`."""
        return -float(np.trace(np.linalg.solve(information, self.tip)))

    def gains(self, state: CandidateInformation) -> Array:
        """Return the reduction of the variance, tr((1 + A M^-1 A^T)^-1 A M^-1 Q M^-1 A^T)."""
        assert state.seen_tip is not None
        inner = np.eye(state.seen.shape[1]) + state.seen
        return np.asarray(np.einsum("nii->n", np.linalg.solve(inner, state.seen_tip)))
