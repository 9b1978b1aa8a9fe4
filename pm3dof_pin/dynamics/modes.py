"""Natural frequencies and mode shapes of an elastic mechanism at a configuration.

The motions that keep the loops closed are Z, which strain the springs, with Z^T K_q Z = 1
(:mod:`pm3dof_pin.elastic.motions`), and N, which do not. N are the modes of frequency zero, known from kinematics
rather than from a small eigenvalue. In the other modes the momentum along N vanishes,

    Z' = Z - N (N^T M N)^-1 N^T M Z,

and the eigenvalues of Z'^T M Z' are 1 / omega^2. This is for small vibrations without load and damping.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.dynamics.beam_masses import vibrating_mass
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.motions import ElasticMotions, elastic_motions
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.tolerances import MASSLESS
from pm3dof_pin.typing import Array, Matrix, Vector


@dataclass(frozen=True, eq=False)
class Modes:
    """Natural modes at a configuration."""

    configuration: Configuration  #: the configuration, of the mechanism with virtual joints
    frequencies: Vector  #: of the modes that strain springs, ascending, shape=(k,) [Hz]
    shapes: Matrix  #: joint velocities in these modes, shape=(nv, k), of unit modal mass: shapes^T M shapes = 1
    twists: Matrix  #: twists [v; omega] of the tool in these modes, world axes, shape=(6, k)
    #: basis of the motions with all springs at rest, the modes of frequency zero, orthonormal in scaled numbers,
    #: shape=(nv, u)
    free_motions: Matrix
    free_twists: Matrix  #: twists of the tool in the free motions, shape=(6, u)
    without_mass: int  #: number of massless modes that strain springs; they have no frequency

    def body_twists(self, joints: Iterable[str]) -> Array:
        """Return the twists [v; omega] of the bodies that joints move, at the joints, world axes, shape=(k, joints, 6).

        Zero for joints that the mechanism does not have.
        """
        model = self.configuration.mechanism.model
        data, names = scratch_data(model), list(joints)
        pin.computeJointJacobians(model, data, np.array(self.configuration.q))
        twists = np.zeros((self.shapes.shape[1], len(names), 6))
        for index, name in enumerate(names):
            if model.existJointName(name):
                jacobian = pin.getJointJacobian(model, data, model.getJointId(name), pin.LOCAL_WORLD_ALIGNED)
                twists[:, index] = (jacobian @ self.shapes).T
        return twists


def natural_modes(
    model: ElasticModel,
    configuration: Configuration | ArrayLike,
    *,
    count: int | None = None,
    payloads: Payloads | None = None,
) -> Modes:
    """Compute the natural modes at a configuration.

    Example:
        >>> import pm3dof_pin as pm
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> pm.natural_modes(model, model.rigid.home, count=2).frequencies.round(2)
        array([162.56, 259.85])

    Args:
        model: the mechanism with its springs.
        configuration: an assembled configuration, see :meth:`ElasticModel.configuration`.
        count: number of modes to return, lowest first; all by default.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia` in its axes.

    Raises:
        InvalidValueError: the loops are not closed, a payload or `count` is invalid, or a length changed by a joint is
            not positive.
        FrameNotFoundError: a payload names a frame that the model does not have.
        DescriptionError: the mechanism has no tool frame.
    """
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    if count is not None and count < 0:
        raise InvalidValueError("count", count, "a nonnegative number of modes")
    elastic = model.configuration(configuration)
    motions = elastic_motions(model, elastic)
    mass = vibrating_mass(model, elastic, payloads=payloads)
    inverse_squares, directions, free = elastic_modes(motions, mass)
    kept = inverse_squares > 0.0
    chosen = np.flatnonzero(kept)[:count]
    shapes = (motions.elastic - free @ (free.T @ mass @ motions.elastic)) @ directions
    shapes = _with_definite_sign(shapes[:, chosen] / np.sqrt(inverse_squares[chosen]), elastic)
    return Modes(
        configuration=elastic,
        frequencies=frozen(1.0 / (2.0 * np.pi * np.sqrt(inverse_squares[chosen]))),
        shapes=frozen(shapes),
        twists=frozen(elastic.tool_jacobian @ shapes),
        free_motions=motions.unstrained,
        free_twists=frozen(elastic.tool_jacobian @ motions.unstrained),
        without_mass=int(np.count_nonzero(~kept)),
    )


def elastic_modes(motions: ElasticMotions, mass: Matrix) -> tuple[Vector, Matrix, Matrix]:
    """Return the natural modes in the elastic motions Z, and a basis N of the free motions that have mass.

    Returns:
        1 / omega_r^2, descending, zero for modes without mass, shape=(e,) [s^2]; the modes as combinations of Z,
        orthonormal, shape=(e, e); and N with N^T M N = 1, shape=(nv, u).
    """
    elastic, free = motions.elastic, motions.unstrained
    masses, turned = np.linalg.eigh(free.T @ mass @ free)
    heavy = masses > MASSLESS * masses.max(initial=0.0)
    free = free @ (turned[:, heavy] / np.sqrt(masses[heavy]))
    moved = elastic - free @ (free.T @ mass @ elastic)
    inverse_squares, directions = np.linalg.eigh(moved.T @ mass @ moved)
    inverse_squares, directions = inverse_squares[::-1], directions[:, ::-1]
    massless = inverse_squares <= MASSLESS * inverse_squares.max(initial=0.0)
    return np.where(massless, 0.0, inverse_squares), directions, free


def _with_definite_sign(shapes: Matrix, configuration: Configuration) -> Matrix:
    """Choose the sign of each shape so that its greatest scaled entry is positive."""
    if not shapes.size:
        return shapes
    scaled = shapes / configuration.mechanism.velocity_scale[:, None]
    greatest = np.abs(np.round(scaled / np.abs(scaled).max(axis=0), 6)).argmax(axis=0)
    turned: Matrix = shapes * np.sign(scaled[greatest, np.arange(shapes.shape[1])])
    return turned
