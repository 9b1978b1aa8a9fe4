"""Inverse dynamics: the actuator forces of a motion that keeps the loops closed."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, listed
from pm3dof_pin.dynamics.mass_matrix import mass_matrix
from pm3dof_pin.dynamics.statics import ActuatorForces, balance
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError, first_words
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, Restriction
from pm3dof_pin.mechanism.configuration import Configuration, mechanism_of
from pm3dof_pin.mechanism.loads import Payloads, Wrenches, generalised_forces, model_with_payloads, weight_scale
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Matrix, Vector


class _JointMotion(NamedTuple):
    """Velocity and acceleration of all joints: v and dv/dt, shape=(nv,) [SI].

    `idle` are the motions that remain with the given joints, and thus actuated joints and tool, at rest, such as the
    spin of a link about its own axis, shape=(nv, k), orthonormal in scaled numbers. Their share in velocity and
    acceleration is that of least norm in scaled numbers.
    """

    velocity: Vector
    acceleration: Vector
    idle: Matrix


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """The forces of a motion, and the motion itself: v and dv/dt, shape=(nv,) [SI]."""

    forces: ActuatorForces
    velocity: Vector
    acceleration: Vector


def inverse_dynamics(
    configuration: Configuration,
    rates: ArrayLike,
    accelerations: ArrayLike,
    *,
    joints: Iterable[str] | None = None,
    payloads: Payloads | None = None,
    wrenches: Wrenches | None = None,
) -> InverseDynamics:
    """Compute the actuator forces of a motion, given by some joints' rates and accelerations.

    The motion of all joints follows from the loops; the recursive Newton-Euler algorithm gives the
    forces of the open tree, and virtual work on the motions of the closed loops those of the actuators. Rigid bodies,
    no friction. Idle degrees of freedom are not driven: they accelerate freely under the forces.

    Example:
        All drives at 0.1 m/s, without acceleration:

        >>> import pm3dof_pin as pm
        >>> motion = pm.inverse_dynamics(pm.load("pm3dof").home, [0.1, 0.1, 0.1], [0.0, 0.0, 0.0])
        >>> motion.forces.actuator_forces.round(3)
        array([6.022, 6.022, 6.022])

    Args:
        configuration: an assembled configuration.
        rates: rates of the given joints, shape=(number of joints,) [m/s, rad/s].
        accelerations: accelerations of the given joints, shape=(number of joints,) [m/s^2, rad/s^2].
        joints: single-DoF joints that determine the motion, such as the mechanism's `motion_coordinates`; the
            actuated joints by default.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia` in its axes.
        wrenches: external wrenches [f; m], by frame, at its origin, world axes, shape=(6,) [N, N m].

    Raises:
        SingularConfigurationError: the joints do not determine the motion, or no actuator forces drive it.
        InvalidValueError: the loops do not permit these rates or accelerations, or are not closed; or an argument is
            not finite or has the wrong shape.
        FrameNotFoundError: a payload or wrench names a frame that the model does not have.
        JointNotFoundError: the model has no such joint.
        DescriptionError: the mechanism has no tool frame, or a body has impossible moments of inertia.
    """
    mechanism = mechanism_of(configuration)
    mechanism.require_possible_inertias()
    motion = _loop_motion(configuration, rates, accelerations, joints=joints)
    model = model_with_payloads(mechanism, payloads)
    external = generalised_forces(configuration, wrenches)
    load = pin.rnea(model, scratch_data(model), np.array(configuration.q), motion.velocity, motion.acceleration)
    load = load - external
    free = np.zeros(model.nv)
    if motion.idle.size:
        # nothing drives these motions: their generalised forces vanish, and massless ones stay at rest
        mass, idle = mass_matrix(configuration, payloads=payloads), motion.idle
        free = idle @ np.linalg.lstsq(idle.T @ mass @ idle, -idle.T @ load)[0]
        load = load + mass @ free
    reference = weight_scale(model, mechanism.characteristic_length)
    reference += float(np.linalg.norm(mechanism.velocity_scale * external))
    forces = balance(configuration, load, reference=reference)
    return InverseDynamics(forces, motion.velocity, frozen(motion.acceleration + free))


def _loop_motion(
    configuration: Configuration,
    rates: ArrayLike,
    accelerations: ArrayLike,
    *,
    joints: Iterable[str] | None = None,
) -> _JointMotion:
    """Compute the motion of all joints from that of some, with closed loops: G v = 0, G dv/dt + dG/dt v = 0.

    Arguments and errors as in :func:`inverse_dynamics`.
    """
    mechanism = mechanism_of(configuration)
    names = mechanism.actuated_joints if joints is None else tuple(joints)
    indices = mechanism.velocity_indices(names)
    dof = DegreesOfFreedom(configuration)
    given = dof.over(np.eye(len(dof.scale))[indices])
    if Restriction(dof.actuators_and_tool, given.motions).rank.rank > 0:
        raise SingularConfigurationError(
            f"{mechanism.name}: actuated joints or the tool can move while {first_words(names) or 'no joint'} "
            f"are at rest; at {configuration.in_words}"
        )
    start = finite_array("rates", rates, indices.shape) / dof.scale[indices]
    wanted = finite_array("accelerations", accelerations, indices.shape) / dof.scale[indices]
    units = dof.scale[indices]
    v = _reached("rates", given, start, np.zeros_like(dof.scale), units)
    drift = mechanism.loop_kinematics.drift(configuration.q, dof.scale * v)
    a = _reached("accelerations", given, wanted, -dof.closures.inverse @ (drift / mechanism.closure_scale), units)
    return _JointMotion(frozen(dof.scale * v), frozen(dof.scale * a), frozen(dof.scale[:, None] * given.motions))


def _reached(argument: str, given: Restriction, numbers: Vector, start: Vector, units: Vector) -> Vector:
    """Add to a scaled start, shape=(nv,), the least closed-loop motion that gives joints the requested numbers."""
    missing = numbers - given.rows @ start
    motion: Vector = start + given.inverse @ missing
    left = np.linalg.norm(numbers - given.rows @ motion)
    if left > SOLVED * (np.linalg.norm(numbers) + np.linalg.norm(given.rows @ start)):
        raise InvalidValueError(argument, listed(units * numbers), "values that the loops permit")
    return motion
