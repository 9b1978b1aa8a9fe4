"""Loop closures on recorded numbers: errors, and their derivatives by joint.

Errors are in world axes: for a 3d closure b - a, the vector from frame a's origin to frame b's; for a 6d closure also
half the sum of a_k x b_k over the frames' axes, which to first order is the rotation vector from a to b. The columns
are the derivatives of the errors where the loops are closed, and exact to first order nearby. Joints below both frames
are omitted: they move a closed loop as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import reduce

import numpy as np

from pm3dof_pin.mechanism.configuration import ASSEMBLED_TOLERANCE
from pm3dof_pin.programs.graph import Scalar, Truth, cos, is_zero, less, maximum, select, sin
from pm3dof_pin.programs.graph import absolute as magnitude
from pm3dof_pin.programs.joints import Placement, cross, objects
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Objects


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of one closure, or of the tool."""

    error: Objects  #: shape=(m,) [m, rad]
    is_angular: tuple[bool, ...]  #: which entries are angles, shape=(m,)
    #: derivative of the error by the entries of v that it depends on, shape=(m,) each
    columns: Mapping[int, Objects]
    residual: Scalar  #: the largest entry of the error, plus 1 if a frame is rotated by more than 90 degrees


def closure_equations(tree: Tree, index: int) -> Equations:
    """Return the equations of the mechanism's loop closure of this index."""
    loop = tree.mechanism.closures[index]
    a, b = tree.frame(loop.frame_a), tree.frame(loop.frame_b)
    support_a, support_b = tree.support(loop.frame_a), tree.support(loop.frame_b)
    columns = {k: _motion(tree, k, b.translation) for k in support_b if k not in support_a}
    columns |= {k: -_motion(tree, k, a.translation) for k in support_a if k not in support_b}
    error = b.translation - a.translation
    if loop.type == "3d":
        error, columns = error, {k: column[:3] for k, column in columns.items()}
        return Equations(error, (False,) * 3, columns, largest(error))
    error = objects([*error, *_rotation_error(a.rotation, b.rotation)])
    return Equations(error, (False,) * 3 + (True,) * 3, columns, largest(error) + _far(a.rotation, b.rotation))


def closure_residual(tree: Tree) -> Scalar:
    """Return the largest residual of all closures, 0 if there are none."""
    return largest_residual(closure_equations(tree, index) for index in range(len(tree.mechanism.closures)))


def closed(tree: Tree) -> Truth:
    """Return whether the loops are closed."""
    return less(closure_residual(tree), 0.5 * ASSEMBLED_TOLERANCE * tree.mechanism.length_unit)


def largest_residual(equations: Iterable[Equations]) -> Scalar:
    """Return the largest residual of the equations, 0 if there are none."""
    residuals = [equation.residual for equation in equations]
    return reduce(maximum, residuals) if residuals else 0.0


def _motion(tree: Tree, index: int, point: Objects) -> Objects:
    """Return the twist [v; omega] of a point at unit rate of an entry of v, world axes, shape=(6,)."""
    screw = tree.screws[index]
    return objects([*screw.velocity(point), *screw.angular])


def _rotation_error(a: Objects, b: Objects) -> Objects:
    """Return to first order the rotation vector from rotation a to b, world axes, shape=(3,)."""
    return objects(sum(cross(a[:, k], b[:, k]) for k in range(3)) * 0.5)


def _far(a: Objects, b: Objects) -> Scalar:
    """Return 1 if two rotations differ by more than 90 degrees, where their error may vanish too, else 0."""
    trace = sum(a[:, k] @ b[:, k] for k in range(3))
    return select(less(trace, 1.0), 1.0, 0.0)


def largest(numbers: Objects) -> Scalar:
    """Return the largest magnitude among numbers; 0 if there are none."""
    result: Scalar = 0.0
    for number in numbers:
        if not is_zero(number):
            result = magnitude(number) if is_zero(result) else maximum(result, magnitude(number))
    return result


def swing(tree: Tree, index: int) -> tuple[Scalar, Scalar]:
    """Return the squared sine and the cosine of the angle between the z axes of a closure's frames."""
    loop = tree.mechanism.closures[index]
    za, zb = (tree.frame(name).rotation[:, 2] for name in (loop.frame_a, loop.frame_b))
    normal = cross(za, zb)
    return normal @ normal, za @ zb


def tool_equations(tree: Tree, components: tuple[str, ...], targets: Mapping[str, Scalar]) -> Equations:
    """Return the equations that bring components of the tool's pose to targets, by name.

    With all of rx, ry, rz, orientations are compared as a whole, and the error has no singularity; with fewer, angle by
    angle, in R = Rx(rx) Ry(ry) Rz(rz).
    """
    name = tree.mechanism.tool_frame
    assert name is not None
    tool, support = tree.frame(name), tree.support(name)
    twists = {k: _motion(tree, k, tool.translation) for k in support}
    errors: list[Scalar] = []
    gradients: list[Objects] = []
    angular: list[bool] = []
    residual: Scalar = 0.0
    for axis, component in enumerate("xyz"):
        if component in components:
            errors.append(tool.translation[axis] - targets[component])
            gradients.append(objects(np.eye(6)[axis].tolist()))
            angular.append(False)
    if {"rx", "ry", "rz"} <= set(components):
        target = _target_rotation(targets)
        errors += list(_rotation_error(target, tool.rotation))
        gradients += [objects(np.eye(6)[3 + axis].tolist()) for axis in range(3)]
        angular += [True] * 3
        residual = _far(target, tool.rotation)
    else:
        for component in ("rx", "ry", "rz"):
            if component in components:
                error, gradient, is_far = _angle_equation(tool, component, targets)
                errors.append(error)
                gradients.append(objects([0.0, 0.0, 0.0, *gradient]))
                angular.append(True)
                residual = residual + is_far
    rows = objects(errors)
    columns = {k: objects([gradient @ twist for gradient in gradients]) for k, twist in twists.items()}
    return Equations(rows, tuple(angular), columns, largest(rows) + residual)


def _target_rotation(targets: Mapping[str, Scalar]) -> Objects:
    cx, cy, cz = (cos(targets[name]) for name in ("rx", "ry", "rz"))
    sx, sy, sz = (sin(targets[name]) for name in ("rx", "ry", "rz"))
    return objects(
        [
            [cy * cz, -(cy * sz), sy],
            [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -(sx * cy)],
            [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
        ]
    )


def _angle_equation(tool: Placement, component: str, targets: Mapping[str, Scalar]) -> tuple[Scalar, Objects, Scalar]:
    """Return the error of one angle, its derivative by angular velocity, and 1 if the angle is over 90 degrees off."""
    R = tool.rotation
    c, s = cos(targets[component]), sin(targets[component])
    if component == "ry":  # R02 = sin(ry)
        return R[0, 2] - s, cross(R[:, 2], objects([1.0, 0.0, 0.0])), 0.0
    if component == "rx":  # R12 = -sin(rx) cos(ry), R22 = cos(rx) cos(ry)
        row, near = -(c * R[1, 2] + s * R[2, 2]), c * R[2, 2] - s * R[1, 2]
        return row, cross(R[:, 2], objects([0.0, -c, -s])), select(less(near, 0.0), 1.0, 0.0)
    # R01 = -cos(ry) sin(rz), R00 = cos(ry) cos(rz)
    row, near = -(c * R[0, 1] + s * R[0, 0]), c * R[0, 0] - s * R[0, 1]
    x = objects([1.0, 0.0, 0.0])
    gradient = -(cross(R[:, 1], x) * c + cross(R[:, 0], x) * s)
    return row, gradient, select(less(near, 0.0), 1.0, 0.0)
