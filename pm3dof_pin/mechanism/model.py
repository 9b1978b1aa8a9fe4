"""Pinocchio's model of a described robot, made joint by joint.

Bodies that fixed joints connect become one, as in Pinocchio's own readers; all bodies, joints and frames keep their
names as frames of the model. Children of a body follow in the order of their joints' names if the robot was read from a
URDF, as urdfdom has it, otherwise in the order of the description.
"""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.description import Description, Joint
from pm3dof_pin.typing import Vector

UNLIMITED = float(np.finfo(float).max)
"""Pinocchio's limit of an unlimited coordinate."""

_ON_CIRCLE = 1.01  # its limit of cosines, sines and quaternions
_AXES = {"100": "X", "010": "Y", "001": "Z"}


def build_model(description: Description) -> pin.Model:
    """Return Pinocchio's model of the tree, with the named configurations as its reference configurations.

    Effort, speed and position limits that are not given are infinite, friction and damping zero. The armature of a
    joint includes the rotors of its drives, by the square of their gears.
    """
    model = pin.Model()
    model.name = description.name
    model.gravity = pin.Motion(np.array(description.gravity), np.zeros(3))
    builder = _Builder(description, model)
    builder.add_tree()
    for frame in description.frames:
        joint, placement, parent = builder.places[frame.body]
        placed = placement * frame.placement.se3
        model.addFrame(pin.Frame(frame.name, joint, parent, placed, pin.FrameType.OP_FRAME), False)
    _set_constants(description, model)
    for name, values in description.configurations.items():
        model.referenceConfigurations[name] = _configuration(model, values)
    return model


class _Builder:
    def __init__(self, description: Description, model: pin.Model) -> None:
        self.description = description
        self.model = model
        #: by body, the index of the joint that carries it, its placement in that joint, and its frame
        self.places: dict[str, tuple[int, pin.SE3, int]] = {}

    def add_tree(self) -> None:
        root = self.description.root
        inertia = pin.Inertia.Zero() if root.inertial is None else root.inertial.inertia
        frame = pin.Frame(root.name, 0, 0, pin.SE3.Identity(), pin.FrameType.BODY, inertia)
        self.places[root.name] = (0, pin.SE3.Identity(), self.model.addFrame(frame))
        pending = self._children(root.name)
        while pending:
            joint = pending.pop()
            self._add(joint)
            pending += self._children(joint.child)

    def _children(self, body: str) -> list[Joint]:
        """Return the joints that a body carries, the first last."""
        joints = self.description.joints_below[body]
        return (sorted(joints, key=_name) if self.description.dialect == "urdf" else list(joints))[::-1]

    def _add(self, joint: Joint) -> None:
        model = self.model
        carrier, placement, frame = self.places[joint.parent]
        body = self.description.body_by_name[joint.child]
        inertia = None if body.inertial is None else body.inertial.inertia
        placed = placement if joint.placement.is_identity else placement * joint.placement.se3
        inner = joint.child_placement.se3
        if joint.is_fixed:
            inertia = pin.Inertia.Zero() if inertia is None else inner.act(inertia)
            frame = model.addFrame(pin.Frame(joint.name, carrier, frame, placed, pin.FrameType.FIXED_JOINT, inertia))
            inner = placed if joint.child_placement.is_identity else placed * inner
        else:
            if joint.zero:
                placed = placed * joint.motion(-joint.zero)
            carrier = model.addJoint(carrier, _joint_model(joint), placed, joint.name)
            frame = model.addJointFrame(carrier, frame)
            if inertia is not None:
                model.appendBodyToJoint(carrier, inertia, inner)
        self.places[joint.child] = (carrier, inner, model.addBodyFrame(joint.child, carrier, inner, frame))


def _name(joint: Joint) -> str:
    return joint.name


def _joint_model(joint: Joint) -> pin.JointModel:
    """Return Pinocchio's model of a movable joint."""
    match joint.type:
        case "spherical":
            return pin.JointModelSpherical()
        case "floating":
            return pin.JointModelFreeFlyer()
        case "planar":
            return pin.JointModelPlanar()
        case "revolute":
            kind, unaligned = "R", pin.JointModelRevoluteUnaligned
        case "continuous":
            kind, unaligned = "RUB", _unbounded
        case "prismatic":
            kind, unaligned = "P", pin.JointModelPrismaticUnaligned
        case "helical":
            kind, unaligned = "H", pin.JointModelHelicalUnaligned
        case _:
            raise joint.origin.error(f"joint '{joint.name}'", "expected a movable joint")
    letter = _AXES.get("".join(f"{x:g}" for x in joint.axis))
    if letter is not None:
        aligned = getattr(pin, f"JointModel{kind}{letter}")
        return aligned(joint.pitch) if kind == "H" else aligned()
    axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
    return unaligned(axis, joint.pitch) if kind == "H" else unaligned(axis)


def _unbounded(axis: Vector) -> pin.JointModel:
    """Return a continuous joint about any axis, which Pinocchio's bindings have no constructor for."""
    xyz = " ".join(map(repr, axis.tolist()))
    ends = f'<parent link="a"/><child link="b"/><axis xyz="{xyz}"/>'
    joint = f'<link name="a"/><link name="b"/><joint name="j" type="continuous">{ends}</joint>'
    return pin.buildModelFromXML(f'<robot name="r">{joint}</robot>').joints[1]


def _set_constants(description: Description, model: pin.Model) -> None:
    """Set limits, friction, damping and armature of all joints, in arrays that Pinocchio copies whole."""
    lower, upper = np.full(model.nq, -np.inf), np.full(model.nq, np.inf)
    effort, velocity = np.full(model.nv, np.inf), np.full(model.nv, np.inf)
    friction, damping, armature = np.zeros(model.nv), np.zeros(model.nv), np.zeros(model.nv)
    joints = description.joint_by_name
    for name, index, rate, nq in zip(model.names, model.idx_qs, model.idx_vs, model.nqs, strict=True):
        if (joint := joints.get(name)) is None:
            continue
        if nq == 1:
            lower[index] = -UNLIMITED if joint.lower is None else joint.lower
            upper[index] = UNLIMITED if joint.upper is None else joint.upper
        elif joint.type == "floating":
            lower[index + 3 : index + 7], upper[index + 3 : index + 7] = -_ON_CIRCLE, _ON_CIRCLE
        elif joint.type == "planar":
            lower[index + 2 : index + 4], upper[index + 2 : index + 4] = -_ON_CIRCLE, _ON_CIRCLE
        else:
            lower[index : index + nq], upper[index : index + nq] = -_ON_CIRCLE, _ON_CIRCLE
        rates = slice(rate, rate + (nq if nq == 1 else joint.dof))
        effort[rates] = math.inf if joint.effort is None else joint.effort
        velocity[rates] = math.inf if joint.velocity is None else joint.velocity
        friction[rates], damping[rates], armature[rates] = joint.friction, joint.damping, joint.armature
    for drive in description.drives:
        joint_id = model.getJointId(drive.joint)
        if joint_id < model.njoints and model.joints[joint_id].nv == 1:
            armature[model.idx_vs[joint_id]] += drive.gear**2 * drive.rotor_inertia
    model.lowerPositionLimit, model.upperPositionLimit = lower, upper
    model.lowerEffortLimit, model.upperEffortLimit = -effort, effort
    model.lowerVelocityLimit, model.upperVelocityLimit = -velocity, velocity
    model.lowerDryFrictionLimit, model.upperDryFrictionLimit = -friction, friction
    model.damping, model.armature = damping, armature


def _configuration(model: pin.Model, values: Mapping[str, tuple[float, ...]]) -> Vector:
    """Return a named configuration; joints that are not named stay neutral."""
    q = pin.neutral(model)
    for name, numbers in values.items():
        joint = model.joints[model.getJointId(name)]
        if len(numbers) == 1 and joint.nq == 2:
            numbers = (math.cos(numbers[0]), math.sin(numbers[0]))
        q[joint.idx_q : joint.idx_q + joint.nq] = numbers
    return np.asarray(pin.normalize(model, q))
