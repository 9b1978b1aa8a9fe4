"""The Cartesian compliance of a frame on recorded numbers: C = X X^T, X being its twist per normalised spring strain.

With the springs' compliance c = U U^T and v_s = U y, y are normalised spring strains: the energy is y^T y / 2, and
under a wrench on the frame y has the least norm the closures permit. The equations of
:mod:`pm3dof_pin.programs.tool_motion`, triangularised again, are

    [R; 0] x = [A1; A2] y,

and with A1 projected onto the null space of A2, X = R^-1 A1. Stiff and soft springs are only combined by orthogonal
transformations; rigid directions and serial arms need no special treatment. If a branch has more strains than
equations, they are first reduced to as many.

Ranks are decided on the equations without the springs, independently of their stiffness.

A program is recorded and compiled once for a structure of mechanism and springs; their numbers are its parameters.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent, tool_coordinates
from pm3dof_pin.elastic.elastic_model import ElasticModel, SpringBlock
from pm3dof_pin.exceptions import ProgramError, RigidDirectionError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import BoundProgram
from pm3dof_pin.programs import cache, geometry, loops
from pm3dof_pin.programs.elimination import (
    Doubt,
    Elimination,
    compressed,
    eliminate,
    identity,
    product,
    projected,
    rank,
    solve_upper,
    total,
    triangular,
    without_zeros,
    zeros,
)
from pm3dof_pin.programs.graph import Graph, Scalar, Truth, absolute, is_zero, select, sqrt
from pm3dof_pin.programs.motion_equations import joint_columns, widened
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tool_motion import Branch, Reading, branches, response
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Objects

_LIKE = 1e4  # ratio of roots of compliances, by which the pivots of doubt lose accuracy

_logger = logging.getLogger(__name__)


def elastic_program(
    model: ElasticModel,
    frame: str,
    name: str,
    record: Callable[[Roots], Objects],
    *,
    closed: bool = False,
    structure: tuple[object, ...] = (),
    numbers: Mapping[str, float] | None = None,
) -> BoundProgram:
    """Return the program of a quantity of a frame, compiled on first use for a structure.

    Its input is q of the rigid mechanism; its outputs are the quantity, and 1 if nothing is in doubt, else 0. Unless
    the loops are known to be `closed`, the program checks them.

    Args:
        model: the elastic mechanism.
        frame: the frame.
        name: name of the quantity.
        record: records the quantity from the roots of the frame's compliance and stiffness.
        closed: whether the loops are known to be closed.
        structure: what the program depends on besides the model.
        numbers: values of the parameters that `record` adds.

    Raises:
        ProgramError: there is no program for this mechanism, or it disagrees with Pinocchio.
    """
    added = dict(numbers or {})
    place = (frame, name, closed, structure, *added.items())
    if place not in model.programs:
        key = repr((name, closed, structure, *_structure(model, frame)))
        try:
            compiled = cache.known(key, lambda: traced_program(model, frame, name, record, closed=closed))
            values = geometry.values(model.mechanism, compiled.program.parameters, _spring_parameters(model) | added)
            model.programs[place] = BoundProgram(compiled, values)
        except ProgramError as error:
            _logger.warning("%s: %s is computed by Pinocchio, pose by pose: %s", model.mechanism.name, name, error)
            model.programs[place] = error
    found = model.programs[place]
    if isinstance(found, ProgramError):
        raise found
    return found


def traced_program(
    model: ElasticModel, frame: str, name: str, record: Callable[[Roots], Objects], *, closed: bool = False
) -> Program:
    """Record a quantity; arguments as in :func:`elastic_program`.

    Raises:
        ProgramError: the mechanism has an unsupported joint, the frame is free at all sample poses, or the traced
            Jacobians differ from Pinocchio's.
    """
    samples = model.embed(samples_near_home(model.rigid))
    verify(model.mechanism, samples)
    graph = Graph()
    q = zeros(1, model.mechanism.model.nq)[0]
    q[model.rigid_indices] = [
        graph.input(f"q[{k}]", column) for k, column in enumerate(samples[:, model.rigid_indices].T)
    ]
    tree = Tree(graph, model.mechanism, samples, (frame,), positions=q, in_working_axes=True)
    roots = Roots(model, tree, frame)
    values = record(roots)
    sound = roots.is_sound if closed else roots.is_sound & loops.closed(tree)
    return graph.program(name, {name: values, "sound": select(sound, 1.0, 0.0)})


def _structure(model: ElasticModel, frame: str) -> tuple[object, ...]:
    """Return what programs depend on besides the quantity."""
    mechanism = model.mechanism
    entry = mechanism.model.frames[mechanism.frame_id(frame)]
    lengths = [block.length.joint if block.length else "" for block in model.blocks]
    coordinates = [(c.joint, c.tool, c.unit, c.scale) for c in model.rigid.declared_coordinates]
    return (
        *(coordinates, frame, entry.parentJoint, mechanism.length_unit),
        *(model.spring_indices.tolist(), model.passive_indices.tolist(), model.rigid_indices.tolist(), lengths),
        *(list(_spring_parameters(model)), model.compliance_root[1].tolist(), _has_like_springs(model)),
        *(geometry.structure(mechanism), geometry.pattern(mechanism, (frame,))),
    )


def _component_rows(rotation: Objects) -> Objects:
    """Return the rates of x, y, z, rx, ry, rz, R = Rx Ry Rz, as a linear function of the twist, shape=(6, 6)."""
    rows = identity(6)
    cosine = sqrt(rotation[1, 2] * rotation[1, 2] + rotation[2, 2] * rotation[2, 2])
    inverse = 1.0 / cosine
    cx, sx = rotation[2, 2] * inverse, -rotation[1, 2] * inverse
    tangent = rotation[0, 2] * inverse
    rows[3, 3:] = [1.0, sx * tangent, -cx * tangent]
    rows[4, 3:] = [0.0, cx, sx]
    rows[5, 3:] = [0.0, -sx * inverse, cx * inverse]
    return rows


class Roots:
    """Roots of the compliance and the stiffness of a frame, recorded on first use.

    Attributes:
        is_sound: whether nothing is in doubt in the roots used so far.
        model: the elastic mechanism.
        tree: its tree, recorded at q of the rigid mechanism with virtual joints at zero.
        springs: the root U of the springs' compliance, v_s = U y, translations in units of length, shape=(s, s).
    """

    def __init__(self, model: ElasticModel, tree: Tree, frame: str) -> None:
        self.is_sound: Truth = np.True_
        self.model, self.tree, self.springs = model, tree, _spring_root(model, tree)
        self._frame = frame
        self._unit = model.mechanism.length_unit

    @cached_property
    def compliance(self) -> Objects:
        """X with C = X X^T, shape=(6, n); ProgramError if the frame moves with all springs at rest, at every sample."""
        return self._compliance(by_spring=False)

    @cached_property
    def compliance_by_spring(self) -> Objects:
        """X with a column for each entry of the model's spring_indices, shape=(6, s); raises as above."""
        return self._compliance(by_spring=True)

    @cached_property
    def stiffness(self) -> Objects:
        """X with K = X X^T, shape=(6, n); RigidDirectionError if the springs of a branch are rigid somewhere."""
        doubt = Doubt()
        held = _held(self.model, self.tree, self._frame, self.springs, doubt)
        rows = _whitened([_branch_rows(branch, doubt) for branch in held], doubt)
        if rows is None:
            raise RigidDirectionError("the springs of a branch are rigid in some direction")
        rows[:, :3] = rows[:, :3] * (1.0 / self._unit)
        return self.noted(self.tree.turned_to_world(rows.T), doubt)

    def coordinate_stiffness(self, components: Sequence[ToolComponent] = ()) -> Objects:
        """X with X X^T the stiffness of components of the twist, or of the declared coordinates, shape=(p, n).

        Directions in which the frame is rigid are excluded: it does not move there.

        Raises:
            ProgramError: the frame does not follow the coordinates alone, at the sample poses.
        """
        doubt = Doubt()
        held = _held(self.model, self.tree, self._frame, self.springs, doubt)
        rows = _whitened([_branch_rows(branch, doubt) for branch in held], doubt, without_rigid=True)
        assert rows is not None
        rows[:, :3] = rows[:, :3] * (1.0 / self._unit)
        return self.noted(product(rows, self._coordinate_twists(components, doubt)).T, doubt)

    def _coordinate_twists(self, chosen: Sequence[ToolComponent], doubt: Doubt) -> Objects:
        """Return the frame's twists at unit rates of the motions, all springs at rest, shape=(6, p)."""
        mechanism = self.model.mechanism
        coordinates = tool_coordinates(chosen) or self.model.rigid.declared_coordinates
        given = {c.joint: mechanism.single_joint(c.joint).v_index for c in coordinates if c.joint is not None}
        passive = [k for k in self.model.rigid_velocity_indices if k not in given.values()]
        twist = identity(6)
        rotation = self.tree.in_world(self.tree.frame(self._frame)).rotation
        components = twist if chosen else _component_rows(rotation)
        components = np.hstack([self.tree.turned_from_world(part) for part in np.hsplit(components, 2)])
        readings = [Reading(components[TOOL_COMPONENTS.index(c.tool)], c.unit == "m") for c in coordinates if c.tool]
        twists = response(
            self.tree,
            self._frame,
            joint_columns(self.tree, passive, self._frame),
            joint_columns(self.tree, given.values(), self._frame),
            doubt,
            readings,
        )
        places = {c.name: k for k, c in enumerate(sorted(coordinates, key=lambda c: c.joint is None))}
        ordered: Objects = twists[:, [places[c.name] for c in coordinates]]
        for k, coordinate in enumerate(coordinates):
            if coordinate.joint is not None:
                ordered[:, k] = ordered[:, k] * (1.0 / coordinate.scale)
        return ordered

    def _compliance(self, *, by_spring: bool) -> Objects:
        doubt = Doubt()
        held = _held(self.model, self.tree, self._frame, self.springs, doubt)
        if by_spring:
            triangle, strains, order = _condensed_as_one(held, self.springs, doubt)
        else:
            triangle, strains, order = _condensed(held, self.springs, doubt, like=_has_like_springs(self.model))
        inverse = solve_upper(triangle, identity(6))
        columns = product(inverse, strains)
        columns = columns[np.argsort(order)]
        with np.errstate(invalid="ignore"):  # constants, where the frame is free at every pose
            columns[:3] = columns[:3] * self._unit
        columns = self.tree.turned_to_world(columns)
        size = sqrt(total([e * e for e in triangle.ravel()]) * total([e * e for e in inverse.ravel()]))
        doubt.note_pivot(6.0 / size)
        return self.noted(columns, doubt)

    def noted(self, root: Objects, doubt: Doubt) -> Objects:
        """Return recorded numbers, and take note of their doubt."""
        self.is_sound = self.is_sound & doubt.is_none(root)
        return root


def _held(model: ElasticModel, tree: Tree, frame: str, root: Objects, doubt: Doubt) -> list[Branch]:
    """Record how branches hold a frame; sources are spring rates, `weighted` as few spring strains as possible."""

    def strains(sources: tuple[int, ...], motion: Objects) -> Objects:
        own = product(motion, root[np.ix_(sources, sources)])
        parts: dict[tuple[int, ...], list[int]] = {}
        for c in range(own.shape[1]):
            rows = tuple(i for i in range(len(own)) if not is_zero(own[i, c]))
            parts.setdefault(rows, []).append(c)
        blocks = []
        for rows, columns in parts.items():
            turned = compressed(own[np.ix_(rows, columns)])
            blocks.append(zeros(len(own), turned.shape[1]))
            blocks[-1][list(rows)] = turned
        return np.hstack(blocks) if blocks else own

    numbers = {int(index): k for k, index in enumerate(model.spring_indices)}
    return branches(
        tree,
        frame,
        joint_columns(tree, model.passive_indices, frame),
        joint_columns(tree, model.spring_indices, frame),
        doubt,
        joined=[[numbers[int(index)] for index in block.indices] for block in model.blocks],
        weights=strains,
    )


def _spring_root(model: ElasticModel, tree: Tree) -> Objects:
    graph = tree.graph
    values = _spring_parameters(model)
    root = zeros(len(model.spring_indices), len(model.spring_indices))
    _, powers = model.compliance_root
    for block, rows in zip(model.blocks, model.spring_slices, strict=True):
        length: Scalar = 1.0
        if block.length is not None:
            name = f"spring/{block.name}/length"
            joint = model.mechanism.single_joint(block.length.joint)
            length = graph.parameter(name, values[name]) + tree.q[joint.q_index]
        for (i, j), name in _root_entries(block).items():
            if name in values:
                factor = 1.0 if block.length is None else _power(length, powers[rows][i])
                root[rows, rows][i, j] = graph.parameter(name, values[name]) * factor
    return root


def _spring_parameters(model: ElasticModel) -> dict[str, float]:
    """Return the numbers of the springs that are parameters of programs, by name."""
    slides = model.mechanism.velocity_scale[model.spring_indices] != 1.0
    scaled = model.compliance_root[0] / np.where(slides, model.mechanism.length_unit, 1.0)[:, None]
    values: dict[str, float] = {}
    for block, rows in zip(model.blocks, model.spring_slices, strict=True):
        entries = {name: float(scaled[rows, rows][place]) for place, name in _root_entries(block).items()}
        values |= {name: entry for name, entry in entries.items() if entry != 0.0}
        if block.length is not None:
            values[f"spring/{block.name}/length"] = block.length.at_zero
    return values


def _root_entries(block: SpringBlock) -> dict[tuple[int, int], str]:
    """Name the entries of a spring's lower triangular root."""
    size = len(block.indices)
    return {(i, j): f"spring/{block.name}/U{i}{j}" for i in range(size) for j in range(i + 1)}


def _has_like_springs(model: ElasticModel) -> bool:
    """Return whether the springs are similar enough in stiffness, in scaled units, to appear in pivots."""
    sizes = np.abs([value for name, value in _spring_parameters(model).items() if not name.endswith("/length")])
    return bool(sizes.max() < _LIKE * sizes.min())


def _power(length: Scalar, power: float) -> Scalar:
    """Return a power whose exponent is a multiple of 1/2."""
    halves = round(2.0 * power)
    result: Scalar = sqrt(length) if halves % 2 else 1.0
    for _ in range(abs(halves) // 2):
        result = result * length
    return 1.0 / result if halves < 0 else result


@dataclass(frozen=True, eq=False)
class _Rows:
    """Equations twist @ x + strain @ y = 0, and their coefficients of the spring rates."""

    twist: Objects
    strain: Objects
    motion: Objects


def _branch_rows(branch: Branch, doubt: Doubt) -> _Rows:
    """Insert the springs into a branch: with its relations, and no more strains than equations."""
    relations = branch.weighted_relations
    if rank(branch.relations) < len(relations):
        relations = _independent(relations, branch.relations, doubt)
    strain = compressed(projected(relations, branch.weighted, doubt))
    return _Rows(branch.twist, strain, branch.motion)


def _condensed(
    held: Sequence[Branch], root: Objects, doubt: Doubt, *, like: bool
) -> tuple[Objects, Objects, list[int]]:
    """Return R and the projected A1 of the frame, and the order of its twist's entries in both.

    If springs are similar and those of each branch are elastic in all its directions, the equations are first solved
    for the strains, which is less work: A1 is then 1, and the pivots depend on the springs' stiffness.
    """
    rows = [_branch_rows(branch, doubt) for branch in held]
    if like and (whitened := _whitened(rows, doubt)) is not None:
        triangle, order = _triangle(eliminate(whitened, range(6), Doubt()))
        return triangle, identity(6), order
    strains, motions = _diagonal([r.strain for r in rows]), _diagonal([r.motion for r in rows])
    twists = np.vstack([zeros(0, 6), *(r.twist for r in rows)])
    result = eliminate(np.hstack([twists, strains, motions]), range(6), doubt)
    triangle, order = _triangle(result)
    width = 6 + strains.shape[1]
    relations, rates = result.rest[:, 6:width], result.rest[:, width:]
    above = _diagonal([branch.relations for branch in held])
    if rank(np.vstack([above, rates])) < rank(above) + len(rates):
        if len(above):
            return _condensed_as_one(held, root, doubt)
        relations = _independent(relations, rates, doubt)
    return triangle, projected(relations, result.pivot_rows[:, 6:width], doubt), order


def _condensed_as_one(held: Sequence[Branch], root: Objects, doubt: Doubt) -> tuple[Objects, Objects, list[int]]:
    """Do the same with all springs at once: for dependent relations, or if springs are needed individually."""
    twists, motions = (
        np.vstack([zeros(0, 6), *(b.twist for b in held)]),
        np.vstack([zeros(0, len(root)), *(widened(b.motion, b.sources, len(root)) for b in held)]),
    )
    result = eliminate(np.hstack([twists, motions]), range(6), doubt)
    triangle, order = _triangle(result)
    rates = np.vstack([*(widened(b.relations, b.sources, len(root)) for b in held), result.rest[:, 6:]])
    relations = product(rates, root)
    if rank(rates) < len(rates):
        relations = _independent(relations, rates, doubt)
    strains = projected(relations, product(result.pivot_rows[:, 6:], root), doubt, restored=True)
    return triangle, strains, order


def _triangle(result: Elimination) -> tuple[Objects, list[int]]:
    """Return the triangle of the frame's twist, and the order of the twist's entries in it."""
    if len(result.columns) < 6:
        raise ProgramError("the frame can move with all springs at rest, at every sample pose")
    order = list(result.columns)
    return result.pivot_rows[:, order], order


def _independent(relations: Objects, rates: Objects, doubt: Doubt) -> Objects:
    """Return independent relations with the same solutions; dependence is decided by the spring rates."""
    width = relations.shape[1]
    return eliminate(
        np.hstack([relations, without_zeros(rates, doubt)]), range(width, width + rates.shape[1]), doubt
    ).pivot_rows[:, :width]


def _whitened(branches_rows: Sequence[_Rows], doubt: Doubt, *, without_rigid: bool = False) -> Objects | None:
    """Return the equations solved for the strains, shape=(n, 6).

    Equations without springs are omitted, or the result is None.
    """
    blocks = []
    for rows in branches_rows:
        strain, twist = rows.strain, rows.twist
        if rank(strain, relative=True) < len(strain):
            if not without_rigid:
                return None
            count = strain.shape[1]
            separate = eliminate(np.hstack([strain, twist]), range(count), Doubt()).pivot_rows
            strain, twist = separate[:, :count], separate[:, count:]
        triangle = triangular(strain)
        solution = zeros(*twist.shape)
        for i, row in enumerate(triangle):
            if i:
                doubt.note_pivot(absolute(row[i]) / sqrt(total([entry * entry for entry in row])))
            inverse = 1.0 / row[i]
            for c in range(6):
                solution[i, c] = (twist[i, c] - total([row[j] * solution[j, c] for j in range(i)])) * inverse
        blocks.append(solution)
    return np.vstack([zeros(0, 6), *blocks])


def _diagonal(blocks: Sequence[Objects]) -> Objects:
    """Return a block-diagonal matrix."""
    matrix = zeros(sum(len(block) for block in blocks), sum(block.shape[1] for block in blocks))
    row, column = 0, 0
    for block in blocks:
        matrix[row : row + len(block), column : column + block.shape[1]] = block
        row, column = row + len(block), column + block.shape[1]
    return matrix
