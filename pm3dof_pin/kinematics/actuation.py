"""The platform's independent motions, and the rates at which the actuated joints follow them."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import SingularConfigurationError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, Restriction
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix

_PIVOT_DIGITS = 9


def independent_motions(configuration: Configuration) -> Matrix:
    """Compute the velocities of all joints that belong to the platform's independent motions, shape=(nv, p).

    If the mechanism has motion coordinates, column k is the velocity at which coordinate k has rate 1 and the others 0.

    Otherwise column k is the velocity at which the tool has the k-th twist of a basis that is orthonormal in scaled
    numbers: the unit twists v_x, v_y, v_z (one characteristic length a second), omega_x, omega_y, omega_z, projected on
    the twists possible there; of these the p most independent ones, in this order, made orthonormal. A tool with six
    degrees of freedom gets the unit twists themselves.

    Where idle degrees of freedom leave a choice, the shortest velocity in scaled numbers is taken.

    Args:
        configuration: an assembled configuration.

    Raises:
        SingularConfigurationError: the motion coordinates are not independent there, or actuated joints or the tool can
            move without them.
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    dof = DegreesOfFreedom(configuration)
    names = configuration.mechanism.motion_coordinates
    if names:
        indices = configuration.mechanism.velocity_indices(names)
        driven = dof.over(np.eye(len(dof.scale))[indices])
        if driven.rank.rank < len(names):
            raise SingularConfigurationError(
                f"the motion coordinates {', '.join(names)} are not independent at {configuration}: "
                f"singular values {driven.rank.singular_values}"
            )
        velocities = driven.inverse / dof.scale[indices]
    else:
        driven = dof.at_tool
        velocities = driven.inverse @ _aligned_basis(driven.image)
    if Restriction(dof.actuators_and_tool, driven.motions).rank.rank > 0:
        raise SingularConfigurationError(
            f"actuated joints or the tool can move at {configuration} while "
            + (f"the motion coordinates {', '.join(names)} are" if names else "the tool is")
            + " at rest"
        )
    return frozen(dof.scale[:, None] * velocities)


def tool_motions(configuration: Configuration) -> Matrix:
    """Compute the tool's twists [v; omega], world axes, shape=(6, p), in the platform's :func:`independent_motions`.

    The tool's twist is this times the rates of the motions. Arguments and errors are those of
    :func:`independent_motions`.
    """
    return frozen(configuration.tool_jacobian @ independent_motions(configuration))


def actuation_jacobian(configuration: Configuration) -> Matrix:
    """Compute the actuated joints' rates, over those of the motions, in the :func:`independent_motions`.

    Shape=(number of actuated joints, p). For the tripod this is J_t, (8.9) of D. Zhang, Parallel Robotic Machine Tools
    (2010). Arguments and errors are those of :func:`independent_motions`.
    """
    motions = independent_motions(configuration)
    return frozen(motions[configuration.mechanism.actuated_indices])


def _aligned_basis(image: Matrix) -> Matrix:
    """Return the orthonormal basis of a space of scaled twists that depends on the space alone, shape=(6, p)."""
    count, projector = image.shape[1], image @ image.T
    # rounded, so that which of several equally good axes is taken does not hang on the last digits
    order = scipy.linalg.qr(np.round(projector, _PIVOT_DIGITS), mode="r", pivoting=True)[1]
    basis, triangle = np.linalg.qr(projector[:, np.sort(order[:count])])
    aligned: Matrix = basis * np.sign(np.diag(triangle))
    return aligned
