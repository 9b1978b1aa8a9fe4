"""The degrees of freedom of a configuration: the velocities that keep its loops closed, and how they are counted.

Degrees of freedom are the velocities v with G v = 0. Ranks and directions are decided on scaled numbers: linear
velocities, and the corresponding rows of Jacobians, are divided by :attr:`Mechanism.characteristic_length`; angular
velocities are unchanged. Ranks are decided where singular values fall by more than a factor, see :class:`RankDecision`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.mechanism.configuration import Configuration, require_assembled
from pm3dof_pin.singular_values import svd
from pm3dof_pin.tolerances import RANK_CEILING, RANK_GAP
from pm3dof_pin.typing import Matrix, Vector

RANK_TOLERANCE = 1e-6
"""Singular values below this times their reference are treated as zero."""


@dataclass(frozen=True, eq=False)
class RankDecision:
    """How the rank of a scaled matrix was decided."""

    rank: int  #: number of singular values above the threshold
    threshold: float  #: singular values above it count
    singular_values: Vector  #: singular values of the scaled matrix, descending, shape=(min(rows, columns),)

    @classmethod
    def by_gap(cls, singular_values: Vector, reference: float, ceiling: float) -> RankDecision:
        """Decide where singular values, in descending order, first fall by :data:`RANK_GAP` to little enough.

        That is to `ceiling` times a reference, the greatest singular value before a restriction. If they fall nowhere
        like that, those above the ceiling count. The threshold is the geometric mean of the values at the gap.
        """
        values, limit = singular_values, ceiling * reference
        noise = np.finfo(float).eps * reference
        above = np.concatenate([[reference], values])[: len(values)]
        falls = (values <= limit) & (above > RANK_GAP * np.maximum(values, noise))
        if not falls.any():
            return cls.from_singular_values(values, limit)
        first = int(np.argmax(falls))
        return cls.from_singular_values(values, float(np.sqrt(above[first] * max(values[first], noise))))

    @property
    def is_borderline(self) -> bool:
        """Whether the singular values fall by less than :data:`RANK_GAP` where the rank was decided."""
        return self.gap < RANK_GAP

    @classmethod
    def from_singular_values(cls, singular_values: Vector, threshold: float) -> RankDecision:
        """Count the singular values above a threshold; they are in descending order."""
        return cls(int(np.count_nonzero(singular_values > threshold)), threshold, frozen(singular_values))

    @property
    def gap(self) -> float:
        """Ratio of the least singular value above the threshold to the greatest below; infinite if none is below."""
        kept, dropped = self.singular_values[: self.rank], self.singular_values[self.rank :]
        if not kept.size or not dropped.size or dropped[0] == 0.0:
            return float("inf")
        return float(kept[-1] / dropped[0])

    def least(self, expected_rank: int) -> float:
        """Return the smallest singular value that an expected rank includes; 0 if there are fewer."""
        return float(self.singular_values[expected_rank - 1]) if 0 < expected_rank <= len(self.singular_values) else 0.0


def scaled_closures(configuration: Configuration) -> Matrix:
    """Return the Jacobian of the closures in scaled numbers, shape=(constraints, nv)."""
    mechanism = configuration.mechanism
    scaled: Matrix = configuration.constraint_jacobian * mechanism.velocity_scale / mechanism.closure_scale[:, None]
    return scaled


class DegreesOfFreedom:
    """The scaled degrees of freedom of a configuration, and their effect on the actuated joints and the tool.

    Raises:
        InvalidValueError: the loops are not closed.
    """

    def __init__(self, configuration: Configuration) -> None:
        require_kind("configuration", configuration, Configuration, "Poses.configuration")
        mechanism = configuration.mechanism
        require_assembled(configuration)
        self.scale = mechanism.velocity_scale
        self.twist_scale = mechanism.twist_scale
        self._configuration = configuration
        self._ceiling = mechanism.rank_tolerance
        self.closures = Restriction(scaled_closures(configuration), np.eye(mechanism.model.nv), self._ceiling)
        self.constraint_rank = self.closures.rank
        self.basis = self.closures.motions
        self.count = self.basis.shape[1]

    @cached_property
    def actuators(self) -> Matrix:
        """Rows that select the actuated joints' rates from a scaled velocity."""
        return np.eye(len(self.scale))[self._configuration.mechanism.actuated_indices]

    @cached_property
    def twist(self) -> Matrix:
        """Jacobian of the tool in scaled numbers, shape=(6, nv)."""
        scaled: Matrix = self._configuration.tool_jacobian * self.scale / self.twist_scale[:, None]
        return scaled

    @cached_property
    def tool(self) -> Matrix:
        """The rows of the tool's Jacobian that make up its motion, see :attr:`Mechanism.tool_motions`."""
        return self.twist[[TOOL_COMPONENTS.index(name) for name in self._configuration.mechanism.tool_motions]]

    @property
    def actuators_and_tool(self) -> Matrix:
        """Rows of :attr:`actuators` and :attr:`tool`, stacked."""
        return np.vstack([self.actuators, self.tool])

    @cached_property
    def at_actuators(self) -> Restriction:
        """The degrees of freedom restricted to the actuated joints."""
        return self.over(self.actuators)

    @cached_property
    def at_tool(self) -> Restriction:
        """The degrees of freedom restricted to the tool."""
        return self.over(self.tool)

    @cached_property
    def idle(self) -> Restriction:
        """The degrees of freedom restricted to actuated joints and tool."""
        return self.over(self.actuators_and_tool)

    def over(self, rows: Matrix) -> Restriction:
        """Restrict the degrees of freedom to rows of scaled numbers, shape=(k, nv)."""
        return Restriction(rows, self.basis, self._ceiling)


class Restriction:
    """Rows of scaled numbers, restricted to the motions of a basis.

    Args:
        rows: shape=(k, nv).
        basis: orthonormal motions, shape=(nv, f).
        ceiling: see :meth:`RankDecision.by_gap`.

    Attributes:
        rows: the rows, shape=(k, nv).
        rank: the rank decision on `rows @ basis`.
        directions: orthonormal motions of the basis, in descending order of their effect on the rows, shape=(nv, f);
            the first of them belong to the singular values.
        motions: those of them with no effect on the rows, shape=(nv, f - rank).
        image: orthonormal basis of the values of the rows, shape=(k, rank).
        inverse: motion of least norm for given values of the rows, shape=(nv, k).
    """

    def __init__(self, rows: Matrix, basis: Matrix, ceiling: float = RANK_CEILING) -> None:
        self.rows = rows
        left, values, right = svd(rows @ basis)
        self.rank = RankDecision.by_gap(values, float(np.linalg.norm(rows, 2)) if rows.size else 0.0, ceiling)
        rank = self.rank.rank
        self.directions: Matrix = basis @ right.T
        self.motions: Matrix = self.directions[:, rank:]
        self.image: Matrix = left[:, :rank]
        self.inverse: Matrix = (self.directions[:, :rank] / values[:rank]) @ self.image.T
