"""Descriptions with the joints of URDF only: each turns about or slides along an axis of its child's frame.

A spherical joint becomes revolute joints about x, y and z through one point: equivalent as long as the second stays
away from 90 degrees. A planar or, for dialects without them, a floating joint becomes prismatic joints and then
revolute ones. The bodies between them have a mass of 0.01 g, which simulators need and which is negligible in statics.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.description import (
    IDENTITY,
    Body,
    Description,
    Frame,
    Inertial,
    Joint,
    JointType,
    Placement,
    Shape,
)
from pm3dof_pin.description.readers.elements import free_name

NEGLIGIBLE_MASS = 1e-5
"""Mass of bodies that need one and have none [kg]."""

NEGLIGIBLE_MOMENT = 1e-9
"""Moment of inertia of such bodies about every axis [kg m^2]."""

NEGLIGIBLE = Inertial(NEGLIGIBLE_MASS, IDENTITY, (*[NEGLIGIBLE_MOMENT] * 3, 0.0, 0.0, 0.0))
"""The inertia of such bodies."""

_AXES = {"x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0)}
_AT_SEAT = (*[0.0] * 6, 1.0)
_LIMITS: dict[JointType, float] = {"revolute": 2.0 * math.pi, "prismatic": 1000.0}
Floating: TypeAlias = Literal["any", "root", "none"]
"""Which floating joints a dialect has: all, those that let a body float in the world, or none."""

_Configurations: TypeAlias = Mapping[str, Mapping[str, tuple[float, ...]]]
_Part = tuple[str, str, JointType]
_BALL: tuple[_Part, ...] = (("", "x", "revolute"), ("_y", "y", "revolute"), ("_z", "z", "revolute"))
_PARTS: dict[JointType, tuple[_Part, ...]] = {
    "spherical": _BALL,
    "planar": (("", "x", "prismatic"), ("_along_y", "y", "prismatic"), ("_about_z", "z", "revolute")),
    "floating": (
        ("", "x", "prismatic"),
        ("_along_y", "y", "prismatic"),
        ("_along_z", "z", "prismatic"),
        *((f"_about_{axis}", axis, kind) for _, axis, kind in _BALL),
    ),
}
"""Replacements of joints: name suffix, axis and type."""


def with_simple_joints(description: Description, *, floating: Floating = "any") -> Description:
    """Return a description with fixed, revolute, continuous and prismatic joints, and the `floating` ones of a dialect.

    Those of the root alone are measured from its frame. Each joint moves a body in whose frame its own is; a body that
    stands elsewhere is fixed to a new one. A description that is so already is returned as it is. Helical joints stay.
    """
    on_root = {body.name for body in description.fixed_to(description.root.name)}
    free = {
        joint.name
        for joint in description.joints
        if joint.type == "floating" and (floating == "any" or (floating == "root" and joint.parent in on_root))
    }
    replaced = {joint.name for joint in description.joints if joint.type in _PARTS} - free
    seats = _seats(description, free) if floating == "root" else {}
    moved = {joint.name for joint in description.joints if not (joint.is_fixed or joint.child_placement.is_identity)}
    if not replaced and not moved and not seats and not any(joint.zero for joint in description.joints):
        return description
    bodies, joints, frames = dict(description.body_by_name), [], list(description.frames)
    links = {}  # by body that stands elsewhere, the new body that moves, and its own place in it
    for joint in description.joints:
        if joint.name in moved:
            name = free_name(f"{joint.name}_link", bodies)
            body, inner = bodies[joint.child], joint.child_placement
            bodies[name] = _moved_body(body, name, inner)
            bodies[body.name] = Body(body.name, origin=body.origin)
            links[body.name] = (name, inner)
            fixed = free_name(f"{body.name}_fixed", description.joint_by_name)
            joints.append(Joint(fixed, "fixed", name, body.name, inner, origin=joint.origin))
    for joint in description.joints:
        carrier, inner = links.get(joint.parent, (joint.parent, IDENTITY))
        child = links[joint.child][0] if joint.name in moved else joint.child
        placement = inner * joint.placement
        if joint.zero:
            placement = placement * Placement.from_se3(joint.motion(-joint.zero))
        joint = replace(joint, parent=carrier, child=child, placement=placement, zero=0.0)
        if not joint.is_fixed:
            joint = replace(joint, child_placement=IDENTITY)
        if joint.name in seats:
            joint = replace(joint, parent=description.root.name, placement=IDENTITY)
        if joint.name not in replaced:
            joints.append(joint)
            continue
        parts = _PARTS[joint.type]
        for suffix, axis, kind in parts:
            name = joint.child
            if suffix != parts[-1][0]:
                name = free_name(f"{joint.name}_{kind}_{axis}", bodies)
                bodies[name] = Body(name, NEGLIGIBLE, origin=joint.origin)
            most = _LIMITS[kind]
            part = replace(joint, name=joint.name + suffix, type=kind, parent=carrier, child=name, placement=placement)
            joints.append(replace(part, axis=_AXES[axis], lower=-most, upper=most, effort=0.0, velocity=0.0))
            carrier, placement = name, IDENTITY
    types = {joint.name: joint.type for joint in description.joints if joint.name in replaced}
    configurations = {
        name: {
            key: value for part in (_split(types, *entry) for entry in values.items()) for key, value in part.items()
        }
        for name, values in _with_seats(description.configurations, seats).items()
    }
    return replace(
        description,
        bodies=tuple(bodies.values()),
        joints=tuple(joints),
        frames=tuple(frames),
        configurations=configurations,
    )


def _seats(description: Description, free: Collection[str]) -> dict[str, Placement]:
    """Return where free joints are placed in the root, if not at its origin."""
    places = {
        joint.name: Placement.from_se3(description.zero_placements[joint.parent]) * joint.placement
        for joint in description.joints
        if joint.name in free
    }
    return {name: place for name, place in places.items() if not place.is_identity}


def _with_seats(configurations: _Configurations, seats: Mapping[str, Placement]) -> _Configurations:
    """Return configurations, home among them, whose free joints are measured from the root instead of their seats."""

    def placed(seat: Placement, numbers: Sequence[float]) -> tuple[float, ...]:
        return tuple(pin.SE3ToXYZQUAT(seat.se3 * pin.XYZQUATToSE3(np.array(numbers))).tolist())

    return {
        name: {**values, **{joint: placed(seat, values.get(joint, _AT_SEAT)) for joint, seat in seats.items()}}
        for name, values in {**({"home": {}} if seats else {}), **configurations}.items()
    }


def with_frames_as_bodies(description: Description) -> Description:
    """Return a description whose named frames are massless bodies on fixed joints."""
    bodies = tuple(Body(frame.name, origin=frame.origin) for frame in description.frames)
    joints = tuple(_fixed(frame) for frame in description.frames)
    return replace(description, bodies=description.bodies + bodies, joints=description.joints + joints, frames=())


def _fixed(frame: Frame) -> Joint:
    return Joint(f"{frame.name}_fixed", "fixed", frame.body, frame.name, frame.placement, origin=frame.origin)


def _moved_body(body: Body, name: str, placement: Placement) -> Body:
    """Return a body in other axes, in which its own are placed."""

    def moved(shapes: tuple[Shape, ...]) -> tuple[Shape, ...]:
        return tuple(replace(shape, placement=placement * shape.placement) for shape in shapes)

    inertial = body.inertial
    if inertial is not None:
        inertial = replace(inertial, placement=placement * inertial.placement)
    return Body(name, inertial, moved(body.visuals), moved(body.collisions), body.origin)


def _split(types: Mapping[str, JointType], name: str, values: tuple[float, ...]) -> dict[str, tuple[float, ...]]:
    """Return the coordinates of a joint, or of those that replace it."""
    kind = types.get(name)
    if kind is None:
        return {name: values}
    if kind == "planar":
        numbers = [*values[:2], math.atan2(values[3], values[2])]
    else:
        turn = Placement.from_quaternion((0.0, 0.0, 0.0), (values[-1], *values[-4:-1]))
        # R = Rx(a) Ry(b) Rz(c), and its transpose is Rz(-c) Ry(-b) Rx(-a)
        numbers = [*values[:-4], *(-angle for angle in turn.inverse().roll_pitch_yaw)]
    return {name + suffix: (number,) for (suffix, _, _), number in zip(_PARTS[kind], numbers, strict=True)}
