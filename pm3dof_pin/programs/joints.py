"""Joints on recorded numbers: displacement, screws and step of every joint type of Pinocchio's URDF and MJCF readers.

Multi-DoF joints that are chains of simple ones (universal, translation, spherical ZYX, composite) are treated as such
chains.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import pinocchio as pin

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.programs.geometry import Geometry
from pm3dof_pin.programs.graph import Scalar, cos, is_zero, sin, sqrt
from pm3dof_pin.typing import Objects

_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}


def objects(numbers: Any) -> Objects:
    """Return numbers as an array of objects."""
    return np.array(numbers, dtype=object)


def cross(a: Sequence[Scalar] | Objects, b: Sequence[Scalar] | Objects) -> Objects:
    """Return the cross product of two vectors."""
    return objects([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


@dataclass(frozen=True, eq=False)
class Transform:
    """A placement in the world, translation in metres."""

    rotation: Objects
    translation: Objects

    def __mul__(self, other: Transform) -> Transform:
        return Transform(self.rotation @ other.rotation, self.translation + self.rotation @ other.translation)


@dataclass(frozen=True, eq=False)
class Screw:
    """A column of the joint Jacobian: the motion at unit rate of one entry of v, in world axes."""

    angular: Objects  #: angular velocity, shape=(3,)
    linear: Objects  #: velocity of the point, shape=(3,)
    point: Objects  #: a point of the moving body, shape=(3,) [m]

    def velocity(self, point: Objects) -> Objects:
        """Return the velocity of a point of the moving body, shape=(3,)."""
        if all(is_zero(entry) for entry in self.angular):
            return self.linear
        return objects(self.linear + cross(self.angular, point - self.point))


class SimpleJoint(Protocol):
    """A simple joint, with `nq` entries of q and `nv` of v."""

    @property
    def nq(self) -> int:
        """Number of its entries of q."""

    @property
    def nv(self) -> int:
        """Number of its entries of v."""

    def displacement(self, q: Objects) -> Transform:
        """Return the placement of the moving body relative to the fixed one."""

    def screws(self, moving: Transform) -> list[Screw]:
        """Return the columns of the joint Jacobian, from the placement of the moving body in the world."""

    def rate(self, q: Objects, v: Objects) -> Objects:
        """Return dq/dt at the velocity v."""

    def step(self, q: Objects, v: Objects) -> Objects:
        """Move q along a tangent vector: equal to Pinocchio's `integrate` to first order."""


_NO_MOTION = objects([0.0, 0.0, 0.0])
_NO_ROTATION = objects(np.eye(3).tolist())


@dataclass(frozen=True, eq=False)
class _Revolute:
    """A revolute joint about an axis, a unit vector."""

    axis: Objects
    nq = 1
    nv = 1

    def displacement(self, q: Objects) -> Transform:
        return Transform(_rotation(self.axis, cos(q[0]), sin(q[0])), _NO_MOTION)

    def screws(self, moving: Transform) -> list[Screw]:
        return [Screw(moving.rotation @ self.axis, _NO_MOTION, moving.translation)]

    def rate(self, q: Objects, v: Objects) -> Objects:
        return v

    def step(self, q: Objects, v: Objects) -> Objects:
        return objects(q + v)


@dataclass(frozen=True, eq=False)
class _Continuous(_Revolute):
    """A continuous revolute joint: q is the cosine and the sine of its angle."""

    nq = 2

    def displacement(self, q: Objects) -> Transform:
        return Transform(_rotation(self.axis, q[0], q[1]), _NO_MOTION)

    def rate(self, q: Objects, v: Objects) -> Objects:
        return objects([-(q[1] * v[0]), q[0] * v[0]])

    def step(self, q: Objects, v: Objects) -> Objects:
        return q if is_zero(v[0]) else _normalised(q + self.rate(q, v))


@dataclass(frozen=True, eq=False)
class _Prismatic:
    """A prismatic joint along an axis, a unit vector."""

    axis: Objects
    nq = 1
    nv = 1

    def displacement(self, q: Objects) -> Transform:
        return Transform(_NO_ROTATION, self.axis * q[0])

    def screws(self, moving: Transform) -> list[Screw]:
        return [Screw(_NO_MOTION, moving.rotation @ self.axis, moving.translation)]

    def rate(self, q: Objects, v: Objects) -> Objects:
        return v

    def step(self, q: Objects, v: Objects) -> Objects:
        return objects(q + v)


class _Spherical:
    """A ball joint: q is a quaternion (x, y, z, w), v the angular velocity in axes of the moving body."""

    nq = 4
    nv = 3

    def displacement(self, q: Objects) -> Transform:
        x, y, z, w = q
        return Transform(
            objects(
                [
                    [1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
                    [2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x)],
                    [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)],
                ]
            ),
            _NO_MOTION,
        )

    def screws(self, moving: Transform) -> list[Screw]:
        return [Screw(axis, _NO_MOTION, moving.translation) for axis in moving.rotation.T]

    def step(self, q: Objects, v: Objects) -> Objects:
        return q if all(map(is_zero, v)) else _normalised(q + self.rate(q, v))

    def rate(self, q: Objects, v: Objects) -> Objects:
        half = v * 0.5
        return objects([*(half * q[3] + cross(q[:3], half)), -(q[:3] @ half)])


class _FreeFlyer:
    """A free body: q is a position and a quaternion, v the twist in axes of the moving body."""

    nq = 7
    nv = 6

    def displacement(self, q: Objects) -> Transform:
        return Transform(_Spherical().displacement(q[3:]).rotation, q[:3])

    def screws(self, moving: Transform) -> list[Screw]:
        slides = [Screw(_NO_MOTION, axis, moving.translation) for axis in moving.rotation.T]
        return slides + _Spherical().screws(moving)

    def rate(self, q: Objects, v: Objects) -> Objects:
        return objects([*(self.displacement(q).rotation @ v[:3]), *_Spherical().rate(q[3:], v[3:])])

    def step(self, q: Objects, v: Objects) -> Objects:
        turned = _Spherical().step(q[3:], v[3:])
        return objects([*(q[:3] + self.rate(q, v)[:3]), *turned])


class _Planar:
    """A planar joint: q is x, y and cosine and sine of the angle, v the twist in axes of the moving body."""

    nq = 4
    nv = 3

    def displacement(self, q: Objects) -> Transform:
        return Transform(_rotation(objects(_AXES["Z"]), q[2], q[3]), objects([q[0], q[1], 0.0]))

    def screws(self, moving: Transform) -> list[Screw]:
        x, y, z = moving.rotation.T
        slides = [Screw(_NO_MOTION, axis, moving.translation) for axis in (x, y)]
        return [*slides, Screw(z, _NO_MOTION, moving.translation)]

    def rate(self, q: Objects, v: Objects) -> Objects:
        turned = _Continuous(objects(_AXES["Z"])).rate(q[2:], v[2:])
        return objects([q[2] * v[0] - q[3] * v[1], q[3] * v[0] + q[2] * v[1], *turned])

    def step(self, q: Objects, v: Objects) -> Objects:
        turned = _Continuous(objects(_AXES["Z"])).step(q[2:], v[2:])
        return objects([*(q[:2] + self.rate(q, v)[:2]), *turned])


@dataclass(frozen=True, eq=False)
class ChainJoint:
    """A simple joint, fixed at a placement, in the chain of a Pinocchio joint; indices are the first ones."""

    placement: Transform
    joint: SimpleJoint
    q_index: int
    v_index: int


def chain(model: pin.Model, index: int, geometry: Geometry) -> Iterator[ChainJoint]:
    """Yield the chain of simple joints of a Pinocchio joint; ProgramError for unsupported types."""
    name = model.names[index]
    first = placement_of(geometry, name)
    yield from _links(name, model.joints[index], first, geometry)


def _links(name: str, model_joint: Any, first: Transform, geometry: Geometry) -> Iterator[ChainJoint]:
    kind = model_joint.shortname().removeprefix("JointModel")
    concrete = model_joint.extract() if hasattr(model_joint, "extract") else model_joint
    if kind == "Composite":
        for k, part in enumerate(concrete.joints):
            part_name = f"{name}[{k}]"
            part_placement = placement_of(geometry, part_name)
            yield from _links(part_name, part, first * part_placement if k == 0 else part_placement, geometry)
        return
    q_index, v_index = model_joint.idx_q, model_joint.idx_v
    no_offset = Transform(_NO_ROTATION, _NO_MOTION)
    for k, joint in enumerate(_simple_joints(name, kind, geometry)):
        yield ChainJoint(first if k == 0 else no_offset, joint, q_index, v_index)
        q_index, v_index = q_index + joint.nq, v_index + joint.nv


def _simple_joints(name: str, kind: str, geometry: Geometry) -> list[SimpleJoint]:
    x, y, z = (objects(_AXES[letter]) for letter in "XYZ")
    if len(kind) == 2 and kind[0] in "RP" and kind[1] in _AXES:
        axis = objects(_AXES[kind[1]])
        return [_Revolute(axis) if kind[0] == "R" else _Prismatic(axis)]
    if len(kind) == 4 and kind[:3] == "RUB" and kind[3] in _AXES:
        return [_Continuous(objects(_AXES[kind[3]]))]
    match kind:
        case "RevoluteUnaligned":
            return [_Revolute(geometry.vector(name, "axis"))]
        case "PrismaticUnaligned":
            return [_Prismatic(geometry.vector(name, "axis"))]
        case "RevoluteUnboundedUnaligned":
            return [_Continuous(geometry.vector(name, "axis"))]
        case "Universal":
            return [_Revolute(geometry.vector(name, "axis1")), _Revolute(geometry.vector(name, "axis2"))]
        case "SphericalZYX":
            return [_Revolute(z), _Revolute(y), _Revolute(x)]
        case "Translation":
            return [_Prismatic(x), _Prismatic(y), _Prismatic(z)]
        case "Spherical":
            return [_Spherical()]
        case "Planar":
            return [_Planar()]
        case "FreeFlyer":
            return [_FreeFlyer()]
    raise ProgramError(f"joint '{name}': programs do not support joints of type {kind}")


def placement_of(geometry: Geometry, name: str) -> Transform:
    """Return the placement of a joint or frame on its body."""
    return Transform(geometry.rotation(name), geometry.vector(name, "p"))


def _rotation(axis: Objects, c: Scalar, s: Scalar) -> Objects:
    """Return the rotation about an axis by the angle of this cosine and sine (Rodrigues)."""
    x, y, z = axis
    one = 1.0 - c
    return objects(
        [
            [_diagonal(x, c), x * y * one - z * s, x * z * one + y * s],
            [x * y * one + z * s, _diagonal(y, c), y * z * one - x * s],
            [x * z * one - y * s, y * z * one + x * s, _diagonal(z, c)],
        ]
    )


def _diagonal(entry: Scalar, c: Scalar) -> Scalar:
    if isinstance(entry, float) and abs(entry) == 1.0:
        return 1.0
    return c + entry * entry * (1.0 - c)


def _normalised(numbers: Objects) -> Objects:
    length = sqrt(numbers @ numbers)
    return objects(numbers / length)
