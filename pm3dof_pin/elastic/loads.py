"""Loads on an elastic mechanism, dead wrenches, payloads, weight, efforts of joints: forces and derivatives by q."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.closure_wrenches import closure_wrenches, turning_stiffness
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads, add_payloads, weight_scale
from pm3dof_pin.typing import Matrix, Vector

_WITHOUT_DERIVATIVES = ("JointModelComposite", "JointModelSphericalZYX", "JointModelUniversal")


@dataclass(frozen=True, eq=False)
class Loads:
    """External loads on a mechanism.

    Example:
        >>> import pm3dof_pin as pm
        >>> loads = pm.Loads(wrenches={"O_e": [0.0, 0.0, -500.0, 0.0, 0.0, 0.0]}, payloads={"O_e": 2.0})

    Attributes:
        wrenches: dead wrenches [f; m] by frame, at its origin: they move with the point and keep their direction in
            the world, shape=(6,) [N, N m].
        payloads: bodies fixed to frames, by frame, which add their weight: a point mass at the frame's origin [kg], or
            a `pin.Inertia` in the axes of the frame.
        own_weight: whether the mechanism's bodies have weight, in the model's gravity.
        efforts: constant forces [N] or torques [N m] of joints of one degree of freedom, by name, positive along the
            joint's coordinate, as :func:`~pm3dof_pin.elastic.preload.preload` finds; without effect where a drive
            without a spring holds the joint.
    """

    wrenches: Mapping[str, ArrayLike] = field(default_factory=dict)
    payloads: Payloads = field(default_factory=dict)
    own_weight: bool = False
    efforts: Mapping[str, float] = field(default_factory=dict)


class AppliedLoads:
    """Loads on one mechanism, each with a factor; their `size` is the sum of forces times length and of moments [N m].

    Raises:
        FrameNotFoundError: the model has no such frame.
        JointNotFoundError: the model has no such joint.
        InvalidValueError: a wrench, effort or mass is not finite or of the wrong shape, a mass is negative, or a joint
            with an effort has several degrees of freedom.
        DescriptionError: the model has joints for which Pinocchio's derivatives are wrong.
    """

    def __init__(self, mechanism: Robot, loads: Iterable[tuple[float, Loads]]) -> None:
        _check_joints(mechanism)
        self._mechanism = mechanism
        self._wrenches: list[tuple[int, Vector]] = []
        weightless = mechanism.model.copy()
        weightless.gravity = pin.Motion.Zero()
        self._weightless = (weightless, weightless.createData())
        self._weights: list[tuple[pin.Model, pin.Data]] = []
        self._efforts = np.zeros(mechanism.model.nv)
        self.size = 0.0
        for factor, load in loads:
            for name, effort in load.efforts.items():
                index = mechanism.single_joint(name).v_index
                force = factor * float(finite_array(f"effort of {name}", effort, ()))
                self._efforts[index] += force
                self.size += abs(force) * float(mechanism.velocity_scale[index])
            for name, wrench in load.wrenches.items():
                array = factor * finite_array(f"wrench on {name}", wrench, (6,))
                self._wrenches.append((mechanism.frame_id(name), array))
                self.size += float(np.abs(array) @ mechanism.twist_scale)
            if load.own_weight or load.payloads:
                model = _weight_model(mechanism, load, factor)
                self._weights.append((model, model.createData()))
                self.size += weight_scale(model, mechanism.characteristic_length)

    def forces(self, configuration: Configuration) -> Vector:
        """Return the generalised forces of the loads, shape=(nv,) [N, N m]."""
        q = np.array(configuration.q)
        model, data = self._weightless
        forces = self._efforts.copy()
        for frame, wrench in self._wrenches:
            jacobian = pin.computeFrameJacobian(model, data, q, frame, pin.LOCAL_WORLD_ALIGNED)
            forces += jacobian.reshape(6, model.nv).T @ wrench
        for weight_model, weight_data in self._weights:
            forces -= pin.computeGeneralizedGravity(weight_model, weight_data, q).reshape(model.nv)
        return forces

    def resistance(self, configuration: Configuration, closure_forces: Vector) -> Matrix:
        """Return the loads' contribution to the tangent stiffness, -d(forces + G^T lambda)/dq, shape=(nv, nv).

        The closure forces, lambda of :class:`~pm3dof_pin.elastic.loaded_state.LoadedState`, are also treated as dead.
        For motions that keep the loops closed this makes no difference: G' = A(q) G has the same null space, and the
        contribution of dA is in the range of G^T.
        """
        q = np.array(configuration.q)
        model, data = self._weightless
        pin.computeJointJacobians(model, data, q)
        external = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
        turning = np.zeros((model.nv, model.nv))
        closures = zip(self._mechanism.closures, closure_wrenches(configuration, closure_forces), strict=True)
        reactions = [
            (self._mechanism.frame_id(name), wrench)
            for loop, pair in closures
            for name, wrench in zip((loop.frame_a, loop.frame_b), pair, strict=True)
        ]
        turning += turning_stiffness(configuration, closure_forces)
        for frame_id, wrench in [*self._wrenches, *reactions]:
            frame = model.frames[frame_id]
            joint, point = frame.parentJoint, frame.placement.translation
            turn = data.oMi[joint].rotation
            force, moment = turn.T @ wrench[:3], turn.T @ wrench[3:]
            external[joint] = external[joint] + pin.Force(force, moment + np.cross(point, force))
            # a wrench of fixed direction in the world turns relative to the joint
            jacobian = pin.getJointJacobian(model, data, joint, pin.LOCAL).reshape(6, model.nv)
            skew = pin.skew(force)
            turning += jacobian.T @ np.vstack([skew, pin.skew(point) @ skew + pin.skew(moment)]) @ jacobian[3:]
        resistance: Matrix = _static_derivatives(model, data, q, external) - turning
        for weight_model, weight_data in self._weights:
            none = pin.StdVec_Force([pin.Force.Zero() for _ in range(model.njoints)])
            resistance += _static_derivatives(weight_model, weight_data, q, none)
        return resistance


def _weight_model(mechanism: Robot, loads: Loads, factor: float) -> pin.Model:
    """Return a model of everything that has weight, with gravity times a factor."""
    model = mechanism.model.copy()
    model.gravity = pin.Motion(factor * mechanism.model.gravity.vector)
    if not loads.own_weight:
        for joint in range(model.njoints):
            model.inertias[joint] = pin.Inertia.Zero()
    add_payloads(model, mechanism, loads.payloads)
    return model


def _static_derivatives(model: pin.Model, data: pin.Data, q: Vector, external: pin.StdVec_Force) -> Matrix:
    derivatives: Matrix = pin.computeStaticTorqueDerivatives(model, data, q, external).reshape(model.nv, model.nv)
    return derivatives


def _check_joints(mechanism: Robot) -> None:
    model = mechanism.model
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        if joint.shortname() in _WITHOUT_DERIVATIVES:
            expected = f"is a {joint.shortname()}, expected single-DoF joints for a loaded stiffness"
            raise DescriptionError(mechanism.source, f"joint '{name}'", expected)
