"""The possible motions of an elastic mechanism: those that strain springs, and those with all springs at rest.

With v split into passive joints p and springs s, the loops stay closed to first order, G v = 0, if

    G_p v_p + G_s v_s = 0.

The null space of G_p contains the motions with all springs at rest. Eliminating v_p leaves E v_s = 0, with E = L^T G_s
and L the left null space of G_p: the relations that a statically indeterminate mechanism imposes on its springs, free
of dependent rows (redundant constraints). All ranks are decided by singular value decompositions of scaled kinematic
matrices, see :mod:`pm3dof_pin.kinematics.degrees_of_freedom`: they do not depend on stiffness, and a spring of 1e15 N/m
is harmless next to one of 1 N m/rad.

With K^-1 = U U^T the springs' compliance, v_s = U x and the energy is x^T x / 2. An orthonormal basis of the x with
E U x = 0 gives the motions Z, Z^T K_q Z = 1, and the compliance of any frame is C = (J Z) (J Z)^T.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE, RankDecision
from pm3dof_pin.mechanism.configuration import Configuration, require_assembled
from pm3dof_pin.singular_values import svd
from pm3dof_pin.typing import Matrix


@dataclass(frozen=True, eq=False)
class ElasticMotions:
    """The possible motions of an elastic mechanism at one configuration, as velocities of all its joints."""

    configuration: Configuration  #: the configuration, of the mechanism with virtual joints
    elastic: Matrix  #: basis Z of the motions that strain springs, Z^T K_q Z = 1, shape=(nv, e)
    whitened: Matrix  #: their spring strains in units of the springs, x of v_s = U x; orthonormal, shape=(s, e)
    #: basis of the same motions, independent of stiffness: orthonormal in scaled numbers at the springs, shape=(nv, e)
    kinematic: Matrix
    unstrained: Matrix  #: basis of the motions with all springs at rest, orthonormal in scaled numbers, shape=(nv, u)
    #: velocity that changes the closure error with the least strain of the springs, shape=(nv, m): a step `-closing @
    #: closure_error` closes the loops to first order
    closing: Matrix
    passive_rank: RankDecision  #: the rank decision on G_p
    relation_rank: RankDecision  #: the rank decision on E

    @property
    def redundant_constraints(self) -> int:
        """Number of dependent closure equations."""
        return len(self.closing.T) - self.passive_rank.rank - self.relation_rank.rank


def elastic_motions(model: ElasticModel, configuration: Configuration) -> ElasticMotions:
    """Compute the possible motions of an elastic mechanism at an assembled configuration of its `mechanism`.

    Singular values below RANK_TOLERANCE times the greatest of the scaled constraint Jacobian are treated as zero.

    Raises:
        InvalidValueError: the loops are not closed, or a length changed by a joint is not positive.
    """
    mechanism = model.mechanism
    require_assembled(configuration)
    scale, rows = mechanism.velocity_scale, mechanism.closure_scale
    closures = configuration.constraint_jacobian * scale / rows[:, None]
    passive, springs = model.passive_indices, model.spring_indices
    moving = closures[:, np.concatenate([passive, springs])]
    # the greatest singular value, exact to rounding from squares
    reference = float(np.sqrt(np.linalg.eigvalsh(moving @ moving.T)[-1])) if closures.size else 0.0

    left, right, passive_rank = _decompose(closures[:, passive], RANK_TOLERANCE * reference)
    kept = passive_rank.rank
    inverse = (right[:, :kept] / passive_rank.singular_values[:kept]) @ left[:, :kept].T
    relations = left[:, kept:].T @ closures[:, springs]
    relation_left, relation_right, relation_rank = _decompose(relations, RANK_TOLERANCE * reference)
    kept = relation_rank.rank

    root = model.scaled_compliance_root(configuration) / scale[springs, None]
    whitened_relations = relation_right[:, :kept].T @ root
    span, whitened = _row_space_and_complement(whitened_relations)
    # x of least norm with relations @ root @ x equal to the remaining closure error
    remainder = (relation_left[:, :kept] / relation_rank.singular_values[:kept]).T @ left[:, passive_rank.rank :].T
    restoring = (
        span @ np.linalg.solve(whitened_relations @ span, remainder) if kept else np.zeros((len(root), len(rows)))
    )

    def of_all_joints(strain: Matrix, error: Matrix | float = 0.0) -> Matrix:
        velocities = np.zeros((mechanism.model.nv, strain.shape[1]))
        velocities[springs] = strain
        velocities[passive] = inverse @ (error - closures[:, springs] @ strain)
        return frozen(scale[:, None] * velocities)

    unstrained = np.zeros((mechanism.model.nv, len(passive) - passive_rank.rank))
    unstrained[passive] = right[:, passive_rank.rank :]
    return ElasticMotions(
        configuration=configuration,
        elastic=of_all_joints(root @ whitened),
        whitened=frozen(whitened),
        kinematic=of_all_joints(relation_right[:, relation_rank.rank :]),
        unstrained=frozen(scale[:, None] * unstrained),
        closing=frozen(of_all_joints(root @ restoring, np.eye(len(rows))) / rows),
        passive_rank=passive_rank,
        relation_rank=relation_rank,
    )


def _decompose(matrix: Matrix, threshold: float) -> tuple[Matrix, Matrix, RankDecision]:
    """Return all left and right singular vectors, as columns, and the rank."""
    if not matrix.size:
        rows, columns = matrix.shape
        return np.eye(rows), np.eye(columns), RankDecision.from_singular_values(np.zeros(0), threshold)
    left, values, right = svd(matrix)
    return left, right.T, RankDecision.from_singular_values(values, threshold)


def _row_space_and_complement(rows: Matrix) -> tuple[Matrix, Matrix]:
    """Return orthonormal bases of the space spanned by independent rows and of its complement, as columns.

    Householder QR of rows^T with rows sorted by size and column pivoting: the rows of its result are accurate relative
    to their own size (A. Cox and N. Higham, 1998), for soft and stiff springs alike.
    """
    count, size = rows.shape
    if not count:
        return np.eye(size)[:, :0], np.eye(size)
    from scipy.linalg import qr  # slow to load

    order = np.argsort(-np.abs(rows).max(axis=0, initial=0.0), kind="stable")
    factor = qr(rows.T[order], pivoting=True)[0]
    basis = np.empty((size, size))
    basis[order] = factor
    return basis[:, :count], basis[:, count:]
