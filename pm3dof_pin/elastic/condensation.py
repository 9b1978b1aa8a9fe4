"""The 6 x 6 Cartesian compliance and stiffness of any frame of a closed-chain mechanism, by condensation.

With the motions Z of :mod:`pm3dof_pin.elastic.motions`, C = (J Z) (J Z)^T for a frame with Jacobian J, and K = C^-1. C
is the solution J dq/dw of

    [ K_q  G^T ] [dq    ]   [J^T w]
    [ G     0  ] [lambda] = [0    ]

and also describes singular cases. A frame that can move with all springs at rest has free directions: no compliance
exists, and the stiffness is zero there. A frame that the springs cannot move in a direction is rigid in it: no
stiffness exists, and the compliance is zero there. Both are reported by name, never inverted. Motions with the springs
and the frame at rest, such as a link spinning about its own axis, and redundant constraints have no effect.

For a serial robot with springs k at its joints, C = J diag(1/k) J^T, the special case without G.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, listed
from pm3dof_pin.elastic.directions import direction_names, range_and_complement
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.motions import ElasticMotions, elastic_motions
from pm3dof_pin.exceptions import FreeDirectionError, RigidDirectionError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix, Vector


@dataclass(frozen=True, eq=False)
class _Decomposition:
    """The analysis of one frame by singular values; the first attributes as in the report."""

    motions: ElasticMotions
    spring_forces: Matrix
    contributions: Matrix
    free_directions: Matrix
    rigid_directions: Matrix
    twists: Matrix
    moved: Matrix


class CartesianCompliance:
    """The elastic behaviour of one frame at one configuration. Read-only.

    Returned by :func:`~pm3dof_pin.elastic.report.cartesian_compliance`. Twists are [v; omega], wrenches [f; m], at the
    frame's origin, world axes. "Orthonormal in scaled numbers" means with lengths divided by the characteristic length.
    Attributes are computed on first use.

    Attributes:
        frame: the frame.
    """

    def __init__(
        self,
        model: ElasticModel,
        configuration: Configuration | Vector,
        frame: str,
        matrices: Matrix | None = None,
    ) -> None:
        self.frame = frame
        self._model = model
        self._given = configuration
        self._matrices = matrices  # C and K from the program, if nothing is in doubt

    @cached_property
    def configuration(self) -> Configuration:
        """The configuration, of the mechanism with virtual joints."""
        return self._model.configuration(self._given)

    @property
    def motions(self) -> ElasticMotions:
        """The possible motions of the mechanism, with the rank decisions on its closures."""
        return self.decomposition.motions

    @property
    def spring_names(self) -> tuple[str, ...]:
        """Names of the springs, in the order of :attr:`contributions`."""
        return self._model.spring_names

    @property
    def spring_coordinates(self) -> tuple[str, ...]:
        """Names of the joints with springs, in the order of :attr:`spring_forces`."""
        return self._model.spring_coordinates

    @property
    def spring_forces(self) -> Matrix:
        """Generalised forces in the springs for unit wrenches on the frame, shape=(s, 6).

        The map a from wrenches to spring forces. The part of a wrench that does work on a free direction is ignored.
        """
        return self.decomposition.spring_forces

    @property
    def contributions(self) -> Matrix:
        """Compliance contribution of each spring, a_j K_j^-1 a_j^T, shape=(number of springs, 6, 6); their sum is C."""
        return self.decomposition.contributions

    @property
    def free_directions(self) -> Matrix:
        """Possible twists of the frame with all springs at rest, orthonormal in scaled numbers, shape=(6, f)."""
        return self.decomposition.free_directions

    @property
    def rigid_directions(self) -> Matrix:
        """Impossible twists of the frame, orthonormal in scaled numbers, shape=(6, r)."""
        return self.decomposition.rigid_directions

    @property
    def exists(self) -> bool:
        """Whether compliance and stiffness both exist, each the inverse of the other."""
        if self._matrices is not None and not np.isnan(self._matrices[1, 0, 0]):
            return True
        return not (self.free_directions.size or self.rigid_directions.size)

    @cached_property
    def decomposition(self) -> _Decomposition:
        """The rank decisions, and what is computed with them."""
        return _decomposed(self._model, self.configuration, self.frame)

    @cached_property
    def compliance(self) -> Matrix:
        """C, twist = C wrench, symmetric, shape=(6, 6) [m/N, 1/N, rad/(N m)]; singular in rigid directions.

        Raises:
            FreeDirectionError: the frame has free directions; the message names them.
        """
        if self._matrices is not None:
            return frozen(self._matrices[0])
        if self.free_directions.size:
            raise FreeDirectionError(self._message("moves freely, with all springs at rest", self.free_directions))
        twists = self.decomposition.twists
        return frozen(twists @ twists.T)

    @cached_property
    def stiffness(self) -> Matrix:
        """K, wrench = K twist, symmetric, shape=(6, 6) [N/m, N, N m/rad]; singular in free directions.

        Raises:
            RigidDirectionError: the frame has rigid directions; the message names them.
        """
        if self._matrices is not None and not np.isnan(self._matrices[1, 0, 0]):
            return frozen(self._matrices[1])
        if self.rigid_directions.size:
            raise RigidDirectionError(self._message("is rigid", self.rigid_directions))
        # (P Z') (P Z')^T inverted by orthogonal triangularisation: forming the product would lose half the digits
        moved = self.decomposition.moved
        rows = moved.T @ self.decomposition.twists
        size = np.linalg.norm(rows, axis=1)
        triangle = np.linalg.qr((rows / size[:, None]).T)[1]
        root = np.linalg.solve(triangle.T, moved.T / size[:, None])
        return frozen(root.T @ root)

    def stiffness_over(self, twists: ArrayLike) -> Matrix:
        """Return the stiffness of some motions of the frame, with all others held, shape=(p, p).

        For twist = T c, with T of shape=(6, p), this is T^T K T. It can exist where K does not, for example over the
        three motions of a planar mechanism.

        Raises:
            RigidDirectionError: the springs do not permit some of these motions; the message names them.
            FreeDirectionError: the frame has free directions; the message names them.
        """
        if self.free_directions.size:
            raise FreeDirectionError(self._message("moves freely, with all springs at rest", self.free_directions))
        scale = self.configuration.mechanism.twist_scale[:, None]
        targets = finite_array("twists", twists, (6, np.shape(twists)[-1])) / scale
        strains = np.linalg.lstsq(self.decomposition.twists / scale, targets, rcond=RANK_TOLERANCE**2)[0]
        missed = np.abs(self.decomposition.twists @ strains / scale - targets).max(initial=0.0)
        if missed > RANK_TOLERANCE * np.abs(targets).max(initial=0.0):
            raise RigidDirectionError(self._message("is rigid", self.rigid_directions))
        return frozen(strains.T @ strains)

    def _message(self, finding: str, directions: Matrix) -> str:
        return f"frame '{self.frame}' {finding}: {direction_names(directions)}; at q = {listed(self.configuration.q)}"


def condensed(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    *,
    frame: str | None = None,
) -> CartesianCompliance:
    """Compute the elastic behaviour of a frame from Pinocchio's Jacobians and singular values.

    Arguments and errors as in :func:`~pm3dof_pin.elastic.report.cartesian_compliance`.
    """
    given = configuration if isinstance(configuration, Configuration) else model.rigid.checked_positions(configuration)
    report = CartesianCompliance(model, given, model.mechanism.frame_name(frame))
    _ = report.decomposition  # raise errors immediately
    return report


def _decomposed(model: ElasticModel, configuration: Configuration, frame: str) -> _Decomposition:
    motions = elastic_motions(model, configuration)
    jacobian = configuration.frame_jacobian(frame)
    twist_scale = model.mechanism.twist_scale
    scaled = jacobian / twist_scale[:, None]
    reference = RANK_TOLERANCE * float(np.linalg.norm(scaled * model.mechanism.velocity_scale, 2))
    free, spanned = range_and_complement(scaled @ motions.unstrained, reference)
    moved, rigid = range_and_complement(spanned.T @ scaled @ motions.kinematic, reference)

    twists = twist_scale[:, None] * (spanned @ (spanned.T @ (scaled @ motions.elastic)))
    strains = motions.whitened @ twists.T
    root = model.scaled_compliance_root(configuration)
    return _Decomposition(
        motions=motions,
        spring_forces=frozen(np.linalg.solve(root.T, strains)),
        contributions=frozen(np.stack([strains[rows].T @ strains[rows] for rows in model.spring_slices])),
        free_directions=frozen(twist_scale[:, None] * free),
        rigid_directions=frozen(twist_scale[:, None] * (spanned @ rigid)),
        twists=frozen(twists),
        moved=frozen(spanned @ moved / twist_scale[:, None]),
    )
