"""Mass matrices: of the tree of bodies, and of the motions that keep its loops closed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, listed
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, null_space
from pm3dof_pin.mechanism.configuration import Configuration, mechanism_of
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.typing import Matrix


def mass_matrix(configuration: Configuration, *, payloads: Payloads | None = None) -> Matrix:
    """Compute the mass matrix M of the tree of bodies, loops open, shape=(nv, nv) [kg, kg m, kg m^2].

    For payloads see :data:`~pm3dof_pin.mechanism.loads.Payloads`.

    Raises:
        FrameNotFoundError: a payload names a frame that the model does not have.
        InvalidValueError: a payload's mass is negative or not finite.
        DescriptionError: a body has moments of inertia that no body has.
    """
    mechanism = mechanism_of(configuration)
    mechanism.require_possible_inertias()
    model = model_with_payloads(mechanism, payloads)
    upper = np.triu(pin.crba(model, model.createData(), np.array(configuration.q)).reshape(model.nv, model.nv))
    return frozen(upper + np.triu(upper, 1).T)


def manifold_mass_matrix(
    configuration: Configuration, motions: ArrayLike | None = None, *, payloads: Payloads | None = None
) -> Matrix:
    """Compute the mass matrix on the constraint manifold, Z^T M Z: the kinetic energy is half of c^T (Z^T M Z) c.

    Z are `motions` that keep the loops closed, shape=(nv, p), v = Z c: by default those of
    :func:`~pm3dof_pin.kinematics.degrees_of_freedom.null_space`. With
    :func:`~pm3dof_pin.kinematics.actuation.independent_motions` it is the mass matrix of the motion coordinates.

    Raises:
        InvalidValueError: `motions` is not finite or has the wrong shape, or the loops are not closed.
        PM3DofError: see :func:`mass_matrix`.
    """
    z = null_space(configuration)[0] if motions is None else _checked(configuration, motions)
    product = z.T @ mass_matrix(configuration, payloads=payloads) @ z
    return frozen(0.5 * (product + product.T))


def drive_mass_matrix(configuration: Configuration, *, payloads: Payloads | None = None) -> Matrix:
    """Compute the mass matrix that the actuated joints feel: the kinetic energy is half of du^T M du, du their rates.

    Joints that these rates leave free, such as a rod that spins, take the shortest motion in scaled numbers; so do the
    rates themselves where there are more actuators than degrees of freedom. Shape=(u, u) [kg, kg m, kg m^2].

    Raises:
        SingularConfigurationError: the tool can move with the actuated joints at rest.
        PM3DofError: see :func:`manifold_mass_matrix`.
    """
    mechanism, dof = mechanism_of(configuration), DegreesOfFreedom(configuration)
    idle = dof.idle.motions.shape[1] if mechanism.tool_frame is not None else 0
    if dof.at_actuators.motions.shape[1] > idle:
        raise SingularConfigurationError(
            f"{mechanism.name}: the tool can move with the actuated joints at rest; at q = {listed(configuration.q)}"
        )
    motions = dof.scale[:, None] * dof.at_actuators.inverse / dof.scale[mechanism.actuated_indices]
    return manifold_mass_matrix(configuration, motions, payloads=payloads)


def _checked(configuration: Configuration, motions: ArrayLike) -> Matrix:
    return finite_array("motions", motions, (configuration.mechanism.model.nv, np.shape(motions)[-1]))
