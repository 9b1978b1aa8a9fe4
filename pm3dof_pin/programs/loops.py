"""Loop closures and couplings on recorded numbers: errors, and their derivatives by joint.

Where all three translations are held, their errors are b - a, the vector from frame a's origin to frame b's, in the
tree's axes; where all three rotations are, half the sum of a_k x b_k over the frames' axes, which to first order is the
rotation vector from a to b. Otherwise they are components along the axes of frame a. The columns are the derivatives of
the errors where the loops are closed, and exact to first order nearby. Joints below both frames are omitted: they move
a closed loop as a whole.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from functools import reduce

import numpy as np

from pm3dof_pin.description.closure_types import ClosureType
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.mechanism.closure_wrenches import held_directions
from pm3dof_pin.mechanism.configuration import ASSEMBLED_TOLERANCE
from pm3dof_pin.programs.elimination import Doubt, zeros
from pm3dof_pin.programs.graph import Scalar, Truth, cos, is_zero, less, maximum, select, sin, sqrt
from pm3dof_pin.programs.graph import absolute as magnitude
from pm3dof_pin.programs.joints import Transform, cross, objects
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Objects


@dataclass(frozen=True, eq=False)
class Equations:
    """Equations of one closure or coupling, or of the tool."""

    error: Objects  #: shape=(m,) [m, rad]
    is_angular: tuple[bool, ...]  #: which entries are angles, shape=(m,)
    #: derivative of the error by the entries of v that it depends on, shape=(m,) each
    columns: Mapping[int, Objects]
    residual: Scalar  #: the largest entry of the error, plus 1 if a frame is rotated by more than 90 degrees


def loop_equations(tree: Tree) -> list[Equations]:
    """Return the equations of the mechanism's loop closures, then of its couplings."""
    closures = [_closure_equations(tree, index) for index in range(len(tree.mechanism.closures))]
    return closures + coupling_equations(tree)


def coupling_equations(tree: Tree) -> list[Equations]:
    """Return the equations of the mechanism's couplings."""
    return [_coupling_equation(tree, coupling) for coupling in tree.mechanism.couplings]


def scaled_rows(tree: Tree, equations: Iterable[Equations], unit: float) -> Objects:
    """Return the derivatives of equations by v, with linear errors and rates in units of length, shape=(m, nv)."""
    rows = []
    for equation in equations:
        for i, is_angular in enumerate(equation.is_angular):
            row = zeros(1, len(tree.screws))[0]
            for k, column in equation.columns.items():
                row[k] = column[i] if is_angular else column[i] * (1.0 / unit)
            rows.append(row)
    matrix: Objects = np.array(rows, dtype=object).reshape(len(rows), len(tree.screws))
    slides = tree.slides
    matrix[:, slides] = matrix[:, slides] * unit
    return matrix


def _closure_equations(tree: Tree, index: int) -> Equations:
    loop = tree.mechanism.closures[index]
    kind, (a, b) = loop.kind, closure_frames(tree, index)
    support_a, support_b = tree.support(loop.frame_a), tree.support(loop.frame_b)
    # where frame b can slide along an axis of frame a, this axis turns about frame a, but is needed at frame b
    point_a = a.translation if kind.holds_vectors else b.translation
    twists = {k: _motion(tree, k, b.translation) for k in support_b if k not in support_a}
    twists |= {k: -_motion(tree, k, point_a) for k in support_a if k not in support_b}
    rows, between = held_twist(kind, a, b), b.translation - a.translation
    columns = {k: apply_rows(rows, twist[:, None])[:, 0] for k, twist in twists.items()}
    linear = [row[:3] @ between for row in rows] if isinstance(rows, np.ndarray) else between[:rows]
    if kind.is_distance:
        linear = [linear[0] - tree.geometry.number(f"closure/{index}", "length")]
    linear = list(linear[: kind.size - len(kind.rotations)])
    angular, is_far = _angular_error(kind, a.rotation, b.rotation)
    error = objects([*linear, *angular])
    return Equations(error, kind.is_angular, columns, largest(error) + is_far)


def in_axes_of_first_frame(tree: Tree, index: int, equations: Equations) -> Equations:
    """Return the equations of a closure, the `index`-th of all equations, with vectors in the axes of its frame a."""
    closures = tree.mechanism.closures
    if index >= len(closures) or not closures[index].kind.holds_vectors:
        return equations
    axes = tree.frame(closures[index].frame_a).rotation.T

    def turned(vectors: Objects) -> Objects:
        return np.concatenate([axes @ part for part in vectors.reshape(-1, 3)])

    return replace(
        equations, error=turned(equations.error), columns={k: turned(c) for k, c in equations.columns.items()}
    )


def closure_frames(tree: Tree, index: int) -> tuple[Transform, Transform]:
    """Return the placements of a closure's frames, with the axes of its type."""
    loop = tree.mechanism.closures[index]
    a, b = tree.frame(loop.frame_a), tree.frame(loop.frame_b)
    if loop.bases is None:
        return a, b
    first, second = (objects(basis.tolist()) for basis in loop.bases)
    return Transform(a.rotation @ first, a.translation), Transform(b.rotation @ second, b.translation)


def held_twist(kind: ClosureType, a: Transform, b: Transform) -> Objects | int:
    """Return the rows that a closure takes from the relative twist of frame b, shape=(size, 6).

    A number instead says that it takes the first so many components as they are.
    """
    if kind.holds_vectors:
        return kind.size
    toward = b.translation - a.translation
    if kind.is_distance:
        toward = toward * (1.0 / sqrt(toward @ toward))
    linear, angular = held_directions(kind, a.rotation.T, b.rotation.T, toward)
    nothing = [0.0] * 3
    return objects([*([*v, *nothing] for v in linear), *([*nothing, *v] for v in angular)])


def apply_rows(rows: Objects | int, twists: Objects) -> Objects:
    """Return rows of :func:`held_twist` times twists, shape=(6, n)."""
    return twists[:rows] if isinstance(rows, int) else objects(rows @ twists)


def _angular_error(kind: ClosureType, a: Objects, b: Objects) -> tuple[list[Scalar], Scalar]:
    """Return the errors of the held rotations, and 1 if frames are so far apart that these may vanish too, else 0."""
    match kind.rotations:
        case (0, 1, 2):
            turn = _rotation_error(a, b)
            return list(turn if kind.holds_vectors else a.T @ turn), _far(a, b)
        case (0, 1):
            z = b[:, 2]
            return [-(a[:, 1] @ z), a[:, 0] @ z], select(less(a[:, 2] @ z, 0.0), 1.0, 0.0)
        case (2,):
            return [-(a[:, 0] @ b[:, 1])], 0.0
    return [], 0.0


def _coupling_equation(tree: Tree, coupling: Coupling) -> Equations:
    """Return the equation of a coupling; if a joint is continuous, its error is the sine of the angle that is left."""
    joint, *others = (tree.mechanism.single_joint(name) for name in (coupling.joint, *coupling.joints))
    columns = {joint.v_index: objects([1.0])}
    positions = [0.0 if other.is_continuous else tree.q[other.q_index] for other in others]
    for other, slope in zip(others, coupling.slopes(positions), strict=True):
        columns[other.v_index] = objects([-slope])
    value: Scalar = coupling.value(positions)
    is_far: Scalar = 0.0
    if joint.is_continuous or any(other.is_continuous for other in others):
        turns = [tree.q[k.q_index : k.q_index + 2] for k in (joint, *others) if k.is_continuous]
        ratios = [1] if joint.is_continuous else []
        ratios += [-int(c[0]) for c, other in zip(coupling.coefficients, others, strict=True) if other.is_continuous]
        angle = -value if joint.is_continuous else tree.q[joint.q_index] - value
        c, s = cos(angle), sin(angle)
        for (x, y), ratio in zip(turns, ratios, strict=True):
            for _ in range(abs(ratio)):
                c, s = (c * x - s * y, s * x + c * y) if ratio > 0 else (c * x + s * y, s * x - c * y)
        error, is_far = s, select(less(c, 0.0), 1.0, 0.0)
    else:
        error = tree.q[joint.q_index] - value
    return Equations(objects([error]), (not joint.translates,), columns, largest([error]) + is_far)


def closure_residual(tree: Tree) -> Scalar:
    """Return the largest residual of all closures and couplings, 0 if there are none."""
    return largest_residual(loop_equations(tree))


def checked_program(name: str, tree: Tree, values: Objects, doubt: Doubt) -> Program:
    """Return the program of `values` and of `sound`: 1 if the loops are closed and nothing is in doubt, else 0."""
    sound = doubt.is_none(values) & closed(tree)
    return tree.graph.program(name, {"values": values, "sound": select(sound, 1.0, 0.0)})


def closed(tree: Tree) -> Truth:
    """Return whether the loops are closed."""
    mechanism = tree.mechanism
    return less(
        closure_residual(tree), max(0.5 * ASSEMBLED_TOLERANCE * mechanism.length_unit, mechanism.closure_tolerance)
    )


def largest_residual(equations: Iterable[Equations]) -> Scalar:
    """Return the largest residual of the equations, 0 if there are none."""
    residuals = [equation.residual for equation in equations]
    return reduce(maximum, residuals) if residuals else 0.0


def _motion(tree: Tree, index: int, point: Objects) -> Objects:
    """Return the twist [v; omega] of a point at unit rate of an entry of v, shape=(6,)."""
    screw = tree.screws[index]
    return objects([*screw.velocity(point), *screw.angular])


def _rotation_error(a: Objects, b: Objects) -> Objects:
    """Return to first order the rotation vector from rotation a to b, shape=(3,)."""
    return objects(sum(cross(a[:, k], b[:, k]) for k in range(3)) * 0.5)


def _far(a: Objects, b: Objects) -> Scalar:
    """Return 1 if two rotations differ by more than 90 degrees, where their error may vanish too, else 0."""
    trace = sum(a[:, k] @ b[:, k] for k in range(3))
    return select(less(trace, 1.0), 1.0, 0.0)


def largest(numbers: Iterable[Scalar]) -> Scalar:
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
    placed, support = tree.frame(name), tree.support(name)
    tool = tree.in_world(placed)
    twists = {k: tree.turned_to_world(_motion(tree, k, placed.translation)) for k in support}
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


def _angle_equation(tool: Transform, component: str, targets: Mapping[str, Scalar]) -> tuple[Scalar, Objects, Scalar]:
    """Return the error of one angle, its derivative by angular velocity, and 1 if it, or ry, is over 90 degrees."""
    R = tool.rotation
    c, s = cos(targets[component]), sin(targets[component])
    if component == "ry":  # R02 = sin(ry)
        # the mirrored angle beyond 90 degrees has the same sine
        return R[0, 2] - s, cross(R[:, 2], objects([1.0, 0.0, 0.0])), select(less(c, 0.0), 1.0, 0.0)
    if component == "rx":  # R12 = -sin(rx) cos(ry), R22 = cos(rx) cos(ry)
        row, near = -(c * R[1, 2] + s * R[2, 2]), c * R[2, 2] - s * R[1, 2]
        return row, cross(R[:, 2], objects([0.0, -c, -s])), select(less(near, 0.0), 1.0, 0.0)
    # R01 = -cos(ry) sin(rz), R00 = cos(ry) cos(rz)
    row, near = -(c * R[0, 1] + s * R[0, 0]), c * R[0, 0] - s * R[0, 1]
    x = objects([1.0, 0.0, 0.0])
    gradient = -(cross(R[:, 1], x) * c + cross(R[:, 0], x) * s)
    return row, gradient, select(less(near, 0.0), 1.0, 0.0)
