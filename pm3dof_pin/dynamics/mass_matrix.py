"""Mass matrices of the tree of bodies, and of the motions that keep its loops closed."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.mechanism.configuration import Configuration, mechanism_of
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.typing import Matrix


def mass_matrix(configuration: Configuration, *, payloads: Payloads | None = None) -> Matrix:
    """Compute the mass matrix M of the tree of bodies, loops open, shape=(nv, nv) [kg, kg m, kg m^2].

    For payloads see :data:`~pm3dof_pin.mechanism.loads.Payloads`.

    Raises:
        FrameNotFoundError: a payload names a frame that the model does not have.
        InvalidValueError: a payload's mass is negative or not finite.
        DescriptionError: a body has impossible moments of inertia.
    """
    mechanism = mechanism_of(configuration)
    mechanism.require_possible_inertias()
    model = model_with_payloads(mechanism, payloads)
    upper = np.triu(pin.crba(model, scratch_data(model), np.array(configuration.q)).reshape(model.nv, model.nv))
    return frozen(upper + np.triu(upper, 1).T)


def drive_mass_matrix(configuration: Configuration, *, payloads: Payloads | None = None) -> Matrix:
    """Compute the mass matrix at the actuated joints: the kinetic energy is du^T M du / 2 for their rates du.

    Joints left free by these rates, such as a spinning rod, take the motion of least norm in scaled numbers; so do the
    rates themselves if there are more actuators than degrees of freedom. Shape=(u, u) [kg, kg m, kg m^2].

    Raises:
        SingularConfigurationError: the tool can move with the actuated joints at rest, here or everywhere.
        InvalidValueError: the loops are not closed.
        PM3DofError: as :func:`mass_matrix`.
    """
    mechanism, dof = mechanism_of(configuration), DegreesOfFreedom(configuration)
    if isinstance(mechanism, PlacedMechanism):
        mechanism.require_regular_drives(from_home=False)
    idle = dof.idle.motions.shape[1] if mechanism.tool_frame is not None else 0
    if dof.at_actuators.motions.shape[1] > idle:
        raise SingularConfigurationError(
            f"{mechanism.name}: the tool can move with the actuated joints at rest; at {configuration.in_words}"
        )
    motions = dof.scale[:, None] * dof.at_actuators.inverse / dof.scale[mechanism.actuated_indices]
    product = motions.T @ mass_matrix(configuration, payloads=payloads) @ motions
    return frozen(0.5 * (product + product.T))
