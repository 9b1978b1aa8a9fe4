"""Holding forces: forces of the actuators and the loop closures at rest."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pm3dof_pin.dynamics.force_balance import ActuatorForces, balance
from pm3dof_pin.mechanism.configuration import Configuration, mechanism_of
from pm3dof_pin.mechanism.loads import Payloads, Wrenches, generalised_forces, model_with_payloads, weight_scale


def holding_forces(
    configuration: Configuration,
    *,
    payloads: Payloads | None = None,
    wrenches: Wrenches | None = None,
) -> ActuatorForces:
    """Compute the forces that hold a configuration against gravity, payloads and wrenches.

    Virtual work on rigid bodies without friction: A^T f + G^T lambda = tau_g - sum J^T w, where tau_g are the
    generalised forces that hold the tree of bodies, payloads included, against `model.gravity`.

    Example:
        A payload of 2 kg on the tool:

        >>> import pm3dof_pin as pm
        >>> pm.holding_forces(pm.load("pm3dof").home, payloads={"O_e": 2.0}).actuator_forces.round(3)
        array([12.928, 12.928, 12.928])

    Args:
        configuration: an assembled configuration.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia` in its axes.
        wrenches: external wrenches [f; m], by frame, at its origin, world axes, shape=(6,) [N, N m].

    Raises:
        SingularConfigurationError: no actuator forces hold the mechanism, as at a parallel singularity.
        FrameNotFoundError: a payload or wrench names a frame that the model does not have.
        InvalidValueError: a payload or wrench is not finite or has the wrong shape, or the loops are not closed.
    """
    mechanism = mechanism_of(configuration)
    model = model_with_payloads(mechanism, payloads)
    gravity = pin.computeGeneralizedGravity(model, model.createData(), np.array(configuration.q))
    external = generalised_forces(configuration, wrenches)
    reference = weight_scale(model, mechanism.characteristic_length)
    reference += float(np.linalg.norm(mechanism.velocity_scale * external))
    return balance(configuration, gravity - external, reference=reference)
