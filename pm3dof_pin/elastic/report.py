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

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.motions import ElasticMotions, elastic_motions
from pm3dof_pin.exceptions import FreeDirectionError, RigidDirectionError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE, RankDecision
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix, Vector

_NO_PART = 1e-6  # of a direction [m/rad, rad/m]: what is smaller is not named


@dataclass(frozen=True, eq=False)
class CartesianCompliance:
    """The elastic behaviour of one frame at one configuration, as :func:`cartesian_compliance` returns it.

    Twists are [v; omega], wrenches [f; m], at the frame's origin, world axes. "Orthonormal in scaled numbers" means
    with lengths divided by the characteristic length.
    """

    frame: str  #: the frame
    configuration: Configuration  #: the configuration, of the mechanism with virtual joints
    motions: ElasticMotions  #: the possible motions of the mechanism, with the rank decisions on its closures
    spring_names: tuple[str, ...]  #: names of the springs, in the order of `contributions`
    spring_coordinates: tuple[str, ...]  #: names of the joints with springs, in the order of `spring_forces`
    #: generalised forces in the springs for unit wrenches on the frame, the map a from wrenches to spring forces,
    #: shape=(s, 6). The part of a wrench that does work on a free direction is ignored
    spring_forces: Matrix
    #: compliance contribution of each spring, a_j K_j^-1 a_j^T, shape=(number of springs, 6, 6); their sum is C
    contributions: Matrix
    #: possible twists of the frame with all springs at rest, orthonormal in scaled numbers, shape=(6, f)
    free_directions: Matrix
    rigid_directions: Matrix  #: impossible twists of the frame, orthonormal in scaled numbers, shape=(6, r)
    _twists: Matrix  #: twists of the frame in the motions Z, shape=(6, e)
    _moved: Matrix  #: basis of the twists that the springs permit, in scaled numbers, shape=(6, m)

    @property
    def exists(self) -> bool:
        """Whether compliance and stiffness both exist, each the inverse of the other."""
        return not (self.free_directions.size or self.rigid_directions.size)

    @cached_property
    def compliance(self) -> Matrix:
        """C, twist = C wrench, symmetric, shape=(6, 6) [m/N, 1/N, rad/(N m)]; singular in rigid directions.

        Raises:
            FreeDirectionError: the frame has free directions; the message names them.
        """
        if self.free_directions.size:
            raise FreeDirectionError(self._message("moves freely, with all springs at rest", self.free_directions))
        return frozen(self._twists @ self._twists.T)

    @cached_property
    def stiffness(self) -> Matrix:
        """K, wrench = K twist, symmetric, shape=(6, 6) [N/m, N, N m/rad]; singular in free directions.

        Raises:
            RigidDirectionError: the frame has rigid directions; the message names them.
        """
        if self.rigid_directions.size:
            raise RigidDirectionError(self._message("is rigid", self.rigid_directions))
        # (P Z') (P Z')^T inverted by orthogonal triangularisation: forming the product would lose half the digits
        rows = self._moved.T @ self._twists
        size = np.linalg.norm(rows, axis=1)
        triangle = np.linalg.qr((rows / size[:, None]).T)[1]
        root = np.linalg.solve(triangle.T, self._moved.T / size[:, None])
        return frozen(root.T @ root)

    def stiffness_over(self, twists: ArrayLike) -> Matrix:
        """Return the stiffness of some motions of the frame, with all others held, shape=(p, p).

        For twist = T c, with T of shape=(6, p), this is T^T K T. It can exist where K does not, for example over the
        three motions of a planar mechanism. What is free has no stiffness.

        Raises:
            RigidDirectionError: the springs do not permit some of these motions; the message names them.
        """
        scale = self.configuration.mechanism.twist_scale[:, None]
        targets = finite_array("twists", twists, (6, np.shape(twists)[-1])) / scale
        free = self.free_directions / scale
        targets = targets - free @ (free.T @ targets)
        strains = np.linalg.lstsq(self._twists / scale, targets, rcond=RANK_TOLERANCE**2)[0]
        missed = np.abs(self._twists @ strains / scale - targets).max(initial=0.0)
        if missed > RANK_TOLERANCE * np.abs(targets).max(initial=0.0):
            raise RigidDirectionError(self._message("is rigid", self.rigid_directions))
        return frozen(strains.T @ strains)

    def _message(self, finding: str, directions: Matrix) -> str:
        robot = self.configuration.mechanism
        bases = "', '".join(robot.description.floating_bodies)
        cause = f"; the base '{bases}' floats: hold it (--hold-base, hold_base=True)" if bases else ""
        names = direction_names(directions)
        return f"frame '{self.frame}' {finding}: {names}{cause}; at {self.configuration.in_words}"


def cartesian_compliance(
    model: ElasticModel, configuration: Configuration | ArrayLike, *, frame: str | None = None
) -> CartesianCompliance:
    """Analyse the elastic behaviour of an unloaded frame by Pinocchio's Jacobians and singular values.

    It decides all ranks, and names free and rigid directions; :func:`~pm3dof_pin.elastic.batch.compliance` computes the
    matrices alone, at many poses, by the compiled program.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> tool = pm.cartesian_compliance(model, model.rigid.home)
        >>> tool.exists, tool.stiffness.shape
        (True, (6, 6))

    Args:
        model: the elastic mechanism.
        configuration: an assembled configuration of the rigid mechanism, or its q, shape=(nq,) [m, rad]; or a
            configuration of the mechanism with virtual joints.
        frame: the frame; the tool by default.

    Raises:
        FrameNotFoundError: the model has no such frame.
        DescriptionError: no frame is given, and the mechanism has no tool frame.
        InvalidValueError: the loops are not closed, or a length changed by a joint is not positive.
    """
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    elastic, name = model.configuration(configuration), model.mechanism.frame_name(frame)
    motions = elastic_motions(model, elastic)
    unit = model.mechanism.twist_scale[:, None]
    jacobian = elastic.frame_jacobian(name) / unit
    reference = RANK_TOLERANCE * float(np.linalg.norm(jacobian * model.mechanism.velocity_scale, 2))
    free, spanned = range_and_complement(jacobian @ motions.unstrained, reference)
    moved, rigid = range_and_complement(spanned.T @ jacobian @ motions.kinematic, reference)

    twists = unit * (spanned @ (spanned.T @ (jacobian @ motions.elastic)))
    strains = motions.whitened @ twists.T
    root = model.scaled_compliance_root(elastic)
    return CartesianCompliance(
        name,
        elastic,
        motions,
        model.spring_names,
        model.spring_coordinates,
        spring_forces=frozen(np.linalg.solve(root.T, strains)),
        contributions=frozen(np.stack([strains[rows].T @ strains[rows] for rows in model.spring_slices])),
        free_directions=frozen(unit * free),
        rigid_directions=frozen(unit * (spanned @ rigid)),
        _twists=frozen(twists),
        _moved=frozen(spanned @ moved / unit),
    )


def range_and_complement(columns: Matrix, threshold: float) -> tuple[Matrix, Matrix]:
    """Return orthonormal bases of the column space and of its complement."""
    left, values, _ = np.linalg.svd(columns) if columns.size else (np.eye(len(columns)), np.zeros(0), None)
    rank = RankDecision.from_singular_values(values, threshold).rank
    return left[:, :rank], left[:, rank:]


def direction_names(twists: Matrix) -> str:
    """Describe twists [v; omega], shape=(6, k), world axes, in words."""
    return "; ".join(_named(twist) for twist in twists.T)


def _named(twist: Vector) -> str:
    translation, rotation = twist[:3], twist[3:]
    turn, shift = np.linalg.norm(rotation), np.linalg.norm(translation)
    if turn <= _NO_PART:
        return f"translation along {_numbers(translation / shift)}"
    if shift <= _NO_PART:
        return f"rotation about {_numbers(rotation / turn)}"
    return f"rotation about {_numbers(rotation / turn)} with translation {_numbers(translation / turn)} m/rad"


def _numbers(vector: Vector) -> str:
    # adding zero turns minus zero into zero
    return f"({', '.join(f'{number + 0.0:.6g}' for number in np.round(vector, 9))})"
