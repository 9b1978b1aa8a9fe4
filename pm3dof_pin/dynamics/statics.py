"""Holding forces, and the balance of forces of actuators and loop closures with a load on the joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import ConvergenceError, SingularConfigurationError
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.singularity import singularities
from pm3dof_pin.mechanism.configuration import Configuration, mechanism_of
from pm3dof_pin.mechanism.loads import Payloads, Wrenches, generalised_forces, model_with_payloads, weight_scale
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Vector


@dataclass(frozen=True, eq=False)
class ActuatorForces:
    """Forces of the actuators and of the loop closures."""

    #: forces f along the actuated joints, in order, with the sign of their coordinates, shape=(number of actuated
    #: joints,) [N, N m]
    actuator_forces: Vector
    #: forces lambda in the rows of the constraint Jacobian, shape=(m,) [N, N m]: the held components of the wrench on
    #: frame b of each closure, opposite to that on frame a, in the axes of frame a; then of each coupling the force on
    #: the joint that follows
    closure_forces: Vector
    #: greatest entry of the residual of the balance [N]; moments are divided by the characteristic length
    residual: float
    #: whether no other actuator forces balance the load. Otherwise, as with more actuators than degrees of freedom,
    #: these have the least norm in scaled numbers
    actuator_forces_unique: bool
    #: whether no other closure forces balance the load with these actuator forces. Otherwise, as with redundant
    #: closures, they are undetermined for rigid bodies, and these have the least norm in scaled numbers
    closure_forces_unique: bool
    #: whether the load works on idle degrees of freedom, such as the spin of a rod whose centre of mass is off its
    #: axis. These motions do not move actuators or tool; the balance ignores them
    unbalanced_idle: bool = False


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
        SingularConfigurationError: no actuator forces hold the mechanism, as at a parallel singularity, or its drives
            do not determine its pose anywhere.
        FrameNotFoundError: a payload or wrench names a frame that the model does not have.
        InvalidValueError: a payload or wrench is not finite or has the wrong shape, or the loops are not closed.
    """
    mechanism = mechanism_of(configuration)
    model = model_with_payloads(mechanism, payloads)
    gravity = pin.computeGeneralizedGravity(model, scratch_data(model), np.array(configuration.q)).copy()
    external = generalised_forces(configuration, wrenches)
    reference = weight_scale(model, mechanism.characteristic_length)
    reference += float(np.linalg.norm(mechanism.velocity_scale * external))
    return balance(configuration, gravity - external, reference=reference)


def balance(configuration: Configuration, load: Vector, *, reference: float) -> ActuatorForces:
    """Solve A^T f + G^T lambda = load for the forces of the actuators and of the loop closures.

    A selects the actuated joints' rates from v, G is the constraint Jacobian. With Z a basis of the motions that keep
    the loops closed, the actuators are found from (A Z)^T f = Z^T load, then the closures from the remainder, both by
    singular value decomposition in scaled numbers: lengths are divided by the characteristic length, forces along an
    axis multiplied by it. Work of the load on idle motions, which leave actuators and tool at rest, is ignored. The
    load has shape=(nv,) [N, N m]; `reference`, the size of its terms [N m], sets the level of rounding.

    Raises:
        SingularConfigurationError: the load works on a motion of the tool that the actuated joints do not hold, or
            these do not determine the pose anywhere.
        InvalidValueError: the loops are not closed.
    """
    mechanism = configuration.mechanism
    if isinstance(mechanism, PlacedMechanism):
        mechanism.require_regular_drives(from_home=False)
    dof = DegreesOfFreedom(configuration)
    scaled = dof.scale * load
    rounding = SOLVED * (reference + float(np.linalg.norm(scaled)))
    idle = dof.idle.motions if mechanism.tool_frame is not None else dof.at_actuators.motions[:, :0]
    idle_load = idle @ (idle.T @ scaled)
    scaled = scaled - idle_load
    work = float(np.linalg.norm(dof.at_actuators.motions.T @ scaled))
    if work > rounding:
        raise SingularConfigurationError(
            f"{mechanism.name}: no actuator forces balance the load: {_name(configuration, dof)}; "
            f"residual {work / mechanism.characteristic_length:.3e} N; at {configuration.in_words}"
        )
    actuators = dof.at_actuators.inverse.T @ scaled
    left = scaled - dof.actuators.T @ actuators
    closures = dof.closures.inverse.T @ left
    left -= dof.closures.rows.T @ closures
    return ActuatorForces(
        frozen(actuators / dof.scale[mechanism.actuated_indices]),
        frozen(closures / mechanism.closure_scale),
        float(np.abs(left).max(initial=0.0)) / mechanism.characteristic_length,
        dof.at_actuators.rank.rank == len(actuators),
        dof.constraint_rank.rank == len(closures),
        bool(np.linalg.norm(idle_load) > rounding),
    )


def _name(configuration: Configuration, dof: DegreesOfFreedom) -> str:
    """Describe why the actuated joints do not hold a configuration."""
    count = dof.at_actuators.motions.shape[1]
    free = f"{count} degree{'s' if count > 1 else ''} of freedom left with the actuated joints at rest"
    if configuration.mechanism.tool_frame is None:
        return free
    try:
        kinds = [singularity.type for singularity in singularities(configuration)]
    except ConvergenceError:
        return free
    return f"{' and '.join(kinds)} singularity, {free}" if kinds else free
