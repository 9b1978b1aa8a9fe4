"""Pinocchio's own models, as descriptions: for exports, and for loops given by its constraint models."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.description import (
    IDENTITY,
    Body,
    Description,
    Frame,
    Inertial,
    Joint,
    JointType,
    Placement,
)
from pm3dof_pin.description.origin import Origin
from pm3dof_pin.description.readers.elements import free_name
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError

_KINDS: dict[str, JointType] = {
    "Spherical": "spherical", "FreeFlyer": "floating", "Planar": "planar", "RUB": "continuous",
    "Unbounded": "continuous", "JointModelR": "revolute", "JointModelP": "prismatic", "JointModelH": "helical",
}  # fmt: skip
_MAX_FINITE = 1e300  # greater limits are none


def describe_model(model: pin.Model, closures: Iterable[LoopClosure] = ()) -> Description:
    """Return the description of a model's tree, with all fixed links of a body as frames on it.

    Raises:
        DescriptionError: a joint is none that a description has.
    """
    origin = Origin(model.name)
    names = {frame.name for frame in model.frames}
    bodies = [_name_of_body(model, joint, names) for joint in range(model.njoints)]
    frames = [
        Frame(frame.name, bodies[frame.parentJoint], Placement.from_se3(frame.placement))
        for frame in list(model.frames)[1:]
        if frame.type in (pin.FrameType.BODY, pin.FrameType.OP_FRAME, pin.FrameType.FIXED_JOINT)
        and frame.name != bodies[frame.parentJoint]
    ]
    neutral = pin.neutral(model)
    joints = [_joint(model, index, (bodies[model.parents[index]], bodies[index])) for index in range(1, model.njoints)]
    configurations = {
        entry.key(): {
            name: tuple(np.asarray(entry.data())[joint.idx_q : joint.idx_q + joint.nq].tolist())
            for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
        }
        for entry in model.referenceConfigurations
        if len(entry.data()) == len(neutral)
    }
    return Description(
        model.name or "robot",
        tuple(
            Body(name, Inertial.from_inertia(inertia) if inertia.mass or inertia.inertia.any() else None)
            for name, inertia in zip(bodies, model.inertias, strict=True)
        ),
        tuple(joints),
        tuple({frame.name: frame for frame in frames}.values()),
        tuple(closures),
        configurations=configurations,
        gravity=tuple(float(part) for part in model.gravity.linear),
        dialect="pinocchio",
        origin=origin,
    )


def closures_of_constraints(model: pin.Model, constraints: Iterable[Any]) -> tuple[LoopClosure, ...]:
    """Add the frames of Pinocchio's constraint models to a model, and return the closures they are.

    `LoopClosure` objects are returned as they are; point and frame anchors, and rigid constraints of contact type 3D
    and 6D, become closures "3d" and "6d".

    Raises:
        InvalidValueError: a constraint is none of these.
    """
    closures = []
    for index, constraint in enumerate(constraints):
        if isinstance(constraint, LoopClosure):
            closures.append(constraint)
            continue
        inner = constraint.extract() if isinstance(constraint, pin.ConstraintModel) else constraint
        kind = getattr(inner, "type", None)
        is_point = isinstance(inner, pin.PointAnchorConstraintModel) or kind == pin.ContactType.CONTACT_3D
        if not (is_point or isinstance(inner, pin.FrameAnchorConstraintModel) or kind == pin.ContactType.CONTACT_6D):
            expected = "loop closures, or Pinocchio's point or frame anchors"
            raise InvalidValueError("closures", type(inner).__name__, expected)
        names = []
        for end in (1, 2):
            joint, placement = getattr(inner, f"joint{end}_id"), getattr(inner, f"joint{end}_placement")
            name = free_name(f"closure{index + 1}_{'ab'[end - 1]}", {frame.name for frame in model.frames})
            model.addFrame(pin.Frame(name, joint, 0, placement, pin.FrameType.OP_FRAME))
            names.append(name)
        closures.append(LoopClosure(names[0], names[1], "3d" if is_point else "6d"))
    return tuple(closures)


def _name_of_body(model: pin.Model, joint: int, names: set[str]) -> str:
    """Name the body of a joint: the one in the joint's frame, if there is one."""
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint == joint and frame.placement.isIdentity(0.0):
            return str(frame.name)
    return "base" if joint == 0 else free_name(f"{model.names[joint]}_link", names)


def _joint(model: pin.Model, index: int, bodies: tuple[str, str]) -> Joint:
    name, joint = model.names[index], model.joints[index]
    kind = next((known for part, known in _KINDS.items() if part in joint.shortname()), None)
    placement = model.jointPlacements[index]
    if kind is None or (kind in ("revolute", "prismatic", "continuous") and joint.nv != 1):
        known = ", ".join(dict.fromkeys(_KINDS.values()))
        raise DescriptionError(model.name, f"joint '{name}'", f"expected one of {known}, not {joint.shortname()}")
    axis: tuple[float, ...] = (1.0, 0.0, 0.0)
    pitch = 0.0
    if joint.nv == 1:
        data = joint.createData()
        joint.calc(data, pin.neutral(model))
        subspace = np.asarray(data.S).reshape(6)
        along = subspace[:3] if kind == "prismatic" else subspace[3:]
        axis = tuple(float(part) for part in along)
        pitch = float(subspace[:3] @ along) if kind == "helical" else 0.0
    q, v = joint.idx_q, joint.idx_v
    limits = (model.lowerPositionLimit[q], model.upperPositionLimit[q]) if joint.nq == 1 else (-np.inf, np.inf)
    lower, upper, effort, velocity = (
        None if abs(limit) > _MAX_FINITE else float(limit)
        for limit in (*limits, model.upperEffortLimit[v], model.upperVelocityLimit[v])
    )
    return Joint(
        name,
        kind,
        *bodies,
        Placement.from_se3(placement) if not placement.isIdentity(0.0) else IDENTITY,
        axis=axis,
        lower=lower,
        upper=upper,
        effort=effort,
        velocity=velocity,
        damping=float(model.damping[v]),
        friction=float(model.upperDryFrictionLimit[v]),
        armature=float(model.armature[v]),
        pitch=pitch,
    )
