"""Newton and damped steps that close all loops, as programs."""

from __future__ import annotations

import itertools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, Coordinate, ToolComponent
from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loop_systems import (
    ZERO,
    LoopEquations,
    LoopSystem,
    joined,
    sign_weights,
    signed_blocks,
    split,
)
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.programs.elimination import Doubt, eliminate, solve_upper, total, typical, zeros
from pm3dof_pin.programs.elimination import samples as number_samples
from pm3dof_pin.programs.graph import (
    Graph,
    Number,
    Scalar,
    Truth,
    absolute,
    atan2,
    cos,
    is_zero,
    less,
    maximum,
    minimum,
    select,
    sin,
    sqrt,
)
from pm3dof_pin.programs.joints import Transform, cross, objects
from pm3dof_pin.programs.loops import (
    Equations,
    in_axes_of_first_frame,
    largest,
    largest_residual,
    loop_equations,
    tool_equations,
)
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.tolerances import ROUNDING, SIGN
from pm3dof_pin.typing import Array, Matrix, Objects

_MIN_DAMPING = 1e-8
"""Least damping of damped steps, relative to the squared error."""

_LONGEST_STEP = 0.5
"""Longest damped step [rad, characteristic lengths]: for longer ones the linear model of a rotation is poor."""

_REGULAR = 1.0 - 2.0**-10
"""Regularity of configurations at least as far from singular ones as usual."""

_SHARE = 0.3  # of the length of the most independent equation; sufficient for one with fewer entries
_MAX_GROWTH = 30  # terms by which a product may be longer than its factors; a dense matrix of 8 rows is expanded
_Form = dict[tuple[int, ...], Scalar]  # an exterior form: coefficients by ascending columns

_MAX_BITS = 30  # of the mode, which leaves seven digits for the regularity


@dataclass(frozen=True)
class Task:
    """The prescribed quantities when loops are closed."""

    joints: tuple[str, ...] = ()  #: single-DoF joints held at given coordinates
    #: components of the tool's placement with targets, R = Rx(rx) Ry(ry) Rz(rz)
    tool: tuple[ToolComponent, ...] = ()

    @classmethod
    def from_coordinates(cls, coordinates: Iterable[Coordinate]) -> Task:
        """Return the task of prescribing coordinates: joints first, then the tool."""
        given = tuple(coordinates)
        return cls(tuple(c.joint for c in given if c.joint is not None), tuple(c.tool for c in given if c.tool))


def closing_program(mechanism: Mechanism, task: Task, samples: ArrayLike, *, dense: bool = False) -> Program:
    """Record one Newton step.

    Closures, and the tool's equations, that determine their joints are solved one by one; others that share joints are
    solved together. Overconstrained systems are solved by least squares; where loops, or a serial arm's tool, leave
    joints free, the step is the shortest. Of joints with loops that can move while the tool rests, or spin without
    effect, some are at rest, chosen at the samples, shape=(s, nq), see :class:`Tree`. Convergence is quadratic if the
    loops can be closed.

    Inputs: q; `margin` and `jump`, initially 1 and 0; the coordinates of the held joints and the targets of the tool,
    in the order of the task. Outputs: the new `q`, with the held joints at their coordinates; the new `margin` and
    `jump`; and `residual`. The first three are the state of an iteration.

    `margin` encodes the distance of q from singular configurations before the step, and its assembly mode. In (0, 1) it
    is the least determinant or pivot of the systems, relative to the usual one at the samples. If it is 2 c less, c
    positive, the bits of c say which systems' determinants have another sign than at the first sample: a singular
    configuration lies between, see :func:`regularity_and_mode`. `jump` is the previous one plus the largest joint
    motion of this step [rad, characteristic lengths], `residual` the largest error before the step [m, rad].

    Raises:
        ProgramError: the model has a joint of an unsupported type.
        JointNotFoundError: the model has no such joint.
        InvalidValueError: a held joint has several degrees of freedom, or the samples have the wrong shape.
    """
    given = _given(mechanism, task, samples, ("margin", "jump"), dense)
    tree, equations, scale, slides, held, (_, jump), _ = given
    regularity: Scalar = _REGULAR
    mode: Scalar = 0.0
    longest: Scalar = 0.0
    moves: dict[int, Objects] = {}
    systems, _ = split([_at_samples(equation) for equation in equations], held)
    for bit, system in enumerate(_stacked(equations, systems, task)):
        solution, size, is_flipped, _ = system.solved(-system.error[:, None], moves)
        moves |= dict(zip(system.unknowns, solution, strict=True))
        regularity = minimum(regularity, size)
        mode = mode + select(is_flipped, 2.0**bit, 0.0) if bit < _MAX_BITS else mode
        longest = maximum(longest, largest(solution[:, 0]))
    velocities = {k: move[0] * (scale if k in slides else 1.0) for k, move in moves.items()}
    outputs = {
        "q": tree.step(velocities),
        "margin": regularity - 2.0 * mode,
        "jump": jump + longest,
        "residual": largest_residual(given.unscaled),
    }
    return tree.graph.program("closing", outputs)


def damped_closing_program(mechanism: Mechanism, task: Task, samples: ArrayLike, *, dense: bool = False) -> Program:
    """Record one damped step, for distant starts and singular configurations.

    Levenberg-Marquardt on all equations that share joints, as in :func:`~pm3dof_pin.kinematics.assembly.assemble`: the
    damping is proportional to the square of the error (J. Fan and Y. Yuan, Computing 74, 2005), which keeps convergence
    quadratic; a step that increases the error is undone, and the next one is shorter.

    Inputs: q; `best`, nq numbers, unused before the second step; `damping`, initially 0.1; `cost`, initially infinite;
    then as for :func:`closing_program`. Outputs, the state of an iteration: `q`, `best`, `damping`, and `cost`, the
    least squared error so far, lengths in characteristic lengths; and `residual`.

    Arguments and errors as in :func:`closing_program`.
    """
    nq = mechanism.model.nq
    names = (*(f"best[{k}]" for k in range(nq)), "damping", "cost")
    given = _given(mechanism, task, samples, names, dense)
    tree, equations, scale, slides, held, (*best, damping, cost), _ = given
    error: Scalar = sum((equation.error @ equation.error for equation in equations), start=0.0)
    is_worse = less(cost, error)
    size = select(is_worse, damping * 100.0, maximum(damping * 0.1, _MIN_DAMPING))
    moves: dict[int, Scalar] = {}
    at_samples = [_at_samples(equation) for equation in equations]
    for members, unknowns in joined(at_samples, held, range(len(equations))):
        system = _System.of([equations[k] for k in members], unknowns)
        move = _damped(system.matrix, -system.error, sqrt(size * error))
        moves |= dict(zip(unknowns, move, strict=True))
    longest = largest(objects(list(moves.values())))
    share = select(less(_LONGEST_STEP, longest), _LONGEST_STEP / longest, 1.0) if moves else 1.0
    moved = tree.step({k: move * share * (scale if k in slides else 1.0) for k, move in moves.items()})
    outputs: dict[str, Any] = {
        "q": [select(is_worse, old, new) for old, new in zip(best, moved, strict=True)],
        "best": [select(is_worse, old, new) for old, new in zip(best, tree.q, strict=True)],
        "damping": size,
        "cost": minimum(cost, error),
        "residual": largest_residual(given.unscaled),
    }
    return tree.graph.program("damped_closing", outputs)


class _Given(NamedTuple):
    """Common to both kinds of steps: the tree, its equations, and the free entries of v."""

    tree: Tree
    equations: list[Equations]  #: scaled
    scale: float
    slides: set[int]
    held: set[int]
    state: list[Number]
    unscaled: list[Equations]


def _given(mechanism: Mechanism, task: Task, samples: ArrayLike, state: tuple[str, ...], dense: bool) -> _Given:
    graph, rows = Graph(), np.array(samples, dtype=float)
    if rows.ndim != 2 or rows.shape[1] != mechanism.model.nq:
        raise ShapeError("samples", rows.shape, f"(s, {mechanism.model.nq})")
    q = objects([graph.input(f"q[{k}]", rows[:, k]) for k in range(mechanism.model.nq)])
    further = [graph.input(name, np.zeros(len(rows))) for name in state]
    held = [mechanism.single_joint(name) for name in task.joints]
    for joint in held:
        coordinate = graph.input(joint.name, joint.coordinate(rows))
        if joint.is_continuous:
            q[joint.q_index : joint.q_index + 2] = cos(coordinate), sin(coordinate)
        else:
            q[joint.q_index] = coordinate
    tree = Tree(graph, mechanism, rows, positions=q, dense=dense, in_working_axes=True)
    unscaled = loop_equations(tree)
    if task.tool:
        unscaled.append(tool_equations(tree, task.tool, _targets(graph, mechanism, task, rows)))
    equations = [_scaled(tree, equation) for equation in unscaled]
    slides, indices = set(tree.slides), {joint.v_index for joint in held}
    return _Given(tree, equations, mechanism.length_unit, slides, indices, further, unscaled)


def _targets(graph: Graph, mechanism: Mechanism, task: Task, samples: Array) -> dict[str, Number]:
    """Add the targets to the inputs; their samples are the tool's placements."""
    rows = tool_components([Configuration(mechanism, q).tool_placement.homogeneous for q in samples])
    return {name: graph.input(name, rows[:, TOOL_COMPONENTS.index(name)]) for name in task.tool}


def placement_component(tool: Transform, name: str) -> Scalar:
    """Record a component of a placement, the angles those of R = Rx(rx) Ry(ry) Rz(rz)."""
    R = tool.rotation
    if name in "xyz":
        return tool.translation["xyz".index(name)]  # type: ignore[no-any-return]
    if name == "rx":
        return atan2(-R[1, 2], R[2, 2])
    if name == "ry":
        return atan2(R[0, 2], sqrt(R[0, 0] * R[0, 0] + R[0, 1] * R[0, 1]))
    return atan2(-R[0, 1], R[0, 0])


def regularity_and_mode(margin: Array) -> tuple[Array, Array]:
    """Decode `margin`: return regularities, in (0, 1), and assembly modes, 0 being that of the samples."""
    mode = -np.floor(0.5 * margin)
    return margin + 2.0 * mode, mode


def branch_number(tree: Tree, task: Task, drives: Sequence[int]) -> Scalar:
    """Record which branch a closed configuration is on: 0 for that of the first sample.

    Its bits, or the sum of :func:`~pm3dof_pin.mechanism.loop_systems.sign_weights`, say which determinants have another
    sign than there: those of the systems that the loops form with the quantities of the task given, then those of the
    drives' rates by the rates of these quantities, shape=(drives, quantities), block by block, unless the quantities do
    not determine the drives. `drives` are their entries of v.
    Between configurations on different branches there is a singular one, serial or parallel, see
    :mod:`pm3dof_pin.kinematics.branches`.
    """
    held, systems, idle_entries = _closed_systems(tree, task)
    count = len(held) + len(task.tool)
    flips: list[Truth] = []
    rates: dict[int, Objects] = {k: objects(np.eye(count)[column].tolist()) for column, k in enumerate(held)}
    at_rest = set(idle_entries)
    for system in systems:
        solution, _, is_flipped, idle = system.solved(system.tool_columns(count, len(task.tool)), rates)
        rates |= dict(zip(system.unknowns, solution, strict=True))
        at_rest |= {system.unknowns[k] for k in idle}
        if system.rows is not None and not (
            len(system.unknowns) <= 3 and np.array_equal(system.rows, system.selection)
        ):
            is_flipped = _is_flipped(_determinant(system.square(system.unknowns)))
        flips.append(is_flipped)
    if at_rest & set(drives):  # the quantities do not determine the drives: theirs are some rates of many
        return _sum_of_flips(flips)
    matrix = np.vstack([zeros(0, count), *(rates.get(k, zeros(1, count)) for k in drives)])
    entries = np.broadcast_arrays(np.zeros(1), *(number_samples(entry) for entry in matrix.ravel()))
    for rows, columns in signed_blocks(np.stack(entries, axis=-1)[:, 1:].reshape(len(entries[0]), *matrix.shape)):
        determinants = [_determinant(matrix[np.ix_(rows, columns)])]
        determinants += _minor(systems, held, count, [drives[row] for row in rows], columns)
        flips.append(_is_flipped(min(determinants, key=tree.graph.operations)))
    return _sum_of_flips(flips)


def _sum_of_flips(flips: list[Truth]) -> Scalar:
    """Return the number of a branch from the signs that differ; the last ones may be constant and do not count."""
    number: Scalar = 0.0
    while flips and isinstance(flips[-1], np.bool_):
        flips.pop()
    for is_flipped, weight in zip(flips, sign_weights(len(flips)), strict=True):
        number = number + select(is_flipped, float(weight), 0.0)
    return number


def same_side(
    graph: Graph, mechanism: Mechanism, task: Task, samples: Matrix, q: Objects, before: Objects, *, dense: bool = False
) -> Truth:
    """Record whether no overconstrained system of the loops is singular between two closed configurations, not far off.

    Such a system has no determinant of its own, as the equations that are independent change with the configuration.
    But they span almost the same space at both, and J(q)^T J(before) has a positive determinant, unless there is a
    singular configuration between them. True if there are no such systems.
    """
    if not _without_sign(Tree(Graph(), mechanism, samples, in_working_axes=True), task):
        return np.True_
    tree = Tree(graph, mechanism, samples, positions=q, dense=dense, in_working_axes=True)
    other = Tree(graph, mechanism, samples, positions=before, geometry=tree.geometry)
    is_same: Truth = np.True_
    for a, b in zip(_without_sign(tree, task), _without_sign(other, task), strict=True):
        is_same = is_same & ~_is_flipped(_determinant(a.matrix.T @ b.matrix))
    return is_same


def _without_sign(tree: Tree, task: Task) -> list[_System]:
    """Return the systems whose determinants have no sign though they are determined."""
    _, systems, _ = _closed_systems(tree, task)
    return [system for system in systems if system.rows is None and system.is_determined]


def _closed_systems(tree: Tree, task: Task) -> tuple[list[int], list[_System], tuple[int, ...]]:
    """Return the entries of v that a task holds, the systems with the tool at its targets, and what is idle."""
    held = [tree.mechanism.single_joint(name).v_index for name in task.joints]
    equations = loop_equations(tree)
    if task.tool:
        tool = tree.in_world(tree.frame(tree.mechanism.frame_name()))
        equations.append(tool_equations(tree, task.tool, {name: placement_component(tool, name) for name in task.tool}))
    scaled = [_scaled(tree, equation) for equation in equations]
    found, idle = split([_at_samples(equation) for equation in scaled], set(held))
    # overconstrained loops may have square systems in other axes
    turned = {k for system in found if system.is_determined and system.rows is None for k in system.equations}
    if turned:
        for k in turned:
            scaled[k] = _scaled(tree, in_axes_of_first_frame(tree, k, equations[k]))
        found, _ = split([_at_samples(equation) for equation in scaled], set(held))
    return held, _stacked(scaled, found, task), idle.moving


def _minor(
    systems: Sequence[_System], held: Sequence[int], count: int, drives: Sequence[int], given: Sequence[int]
) -> list[Scalar]:
    """Return a minor of the drives' rates by those of the quantities given, up to a constant factor, if possible.

    By Cramer's rule it is the ratio of two determinants of the loops' equations, both sparse: with the drives given in
    place of these quantities, and with the quantities. It takes square systems, otherwise nothing is returned.
    """
    if not systems or any(system.rows is None for system in systems):
        return []
    if list(drives) == [held[k] for k in given if k < len(held)]:  # the quantities are the drives, and the minor is 1
        return []
    columns = [held[k] for k in given if k < len(held) and held[k] not in drives]
    columns += [k for system in systems for k in system.unknowns if k not in drives]
    tool = [k for k in given if k >= len(held)]
    blocks = [
        np.hstack([system.square(columns), system.selection @ system.tool_columns(count, count - len(held))[:, tool]])
        for system in systems
    ]
    matrix = np.vstack(blocks)
    if matrix.shape[0] != matrix.shape[1]:
        return []
    result = _determinant(matrix)
    for system in systems:
        result = result / _determinant(system.square(system.unknowns))
    return [result]


class _Solved(NamedTuple):
    """Solutions of a system."""

    values: Objects  #: shape=(number of unknowns, number of right-hand sides)
    regularity: Scalar
    is_flipped: Truth  #: whether the determinant has another sign than at the first sample
    at_rest: tuple[int, ...] = ()  #: which unknowns the system does not determine


@dataclass(frozen=True, eq=False)
class _System:
    """Scaled equations that are solved together: columns by the entries of v, and errors."""

    columns: Mapping[int, Objects]  #: derivative of the errors by the entries of v, shape=(m,) each
    error: Objects  #: shape=(m,)
    unknowns: tuple[int, ...]  #: the entries of v to solve for; the others are held, or known by then
    rows: Matrix | None  #: combinations of the rows to solve, see :class:`LoopSystem`; None for all by least squares
    has_tool: bool  #: whether its last rows are those of the tool's targets
    is_determined: bool  #: whether the equations determine the unknowns
    count: int  #: of closures, the tool included

    @classmethod
    def of(
        cls,
        equations: Sequence[Equations],
        unknowns: tuple[int, ...],
        rows: Matrix | None = None,
        has_tool: bool = False,
        is_determined: bool = False,
    ) -> _System:
        """Stack equations."""
        columns = {
            k: np.concatenate([e.columns.get(k, objects([0.0] * len(e.error))) for e in equations])
            for k in sorted({k for equation in equations for k in equation.columns})
        }
        error = np.concatenate([equation.error for equation in equations])
        return cls(columns, error, unknowns, rows, has_tool, is_determined, len(equations))

    @property
    def matrix(self) -> Objects:
        """Derivatives by the unknowns, shape=(m, number of unknowns)."""
        return np.stack([self.columns[k] for k in self.unknowns], axis=1)

    def tool_columns(self, count: int, size: int) -> Objects:
        """Return the right-hand sides for unit rates of the last `size` of `count` quantities, those of the tool."""
        right = zeros(len(self.error), count)
        if size and self.has_tool:
            right[-size:, count - size :] = np.eye(size)
        return right

    @cached_property
    def selection(self) -> Matrix:
        """As many of the equations as unknowns, which hold all of them, as a matrix of zeros and ones: sparse ones."""
        assert self.rows is not None
        left, chosen = self.rows.copy(), list[int]()
        entries = [sum(not is_zero(column[k]) for column in self.columns.values()) for k in range(len(self.error))]
        while len(chosen) < len(left):
            lengths = np.linalg.norm(left, axis=0)
            best = min(np.flatnonzero(lengths >= _SHARE * lengths.max()), key=entries.__getitem__)
            left -= np.outer(left[:, best], left[:, best] @ left) / lengths[best] ** 2
            chosen.append(int(best))
        return np.eye(len(self.error))[sorted(chosen)]

    def square(self, columns: Sequence[int]) -> Objects:
        """Return derivatives of the selected equations by entries of v, shape=(number of unknowns, number of these)."""
        kept = np.argmax(self.selection, axis=1)
        nothing = objects([0.0] * len(self.error))
        return np.stack([self.columns.get(k, nothing)[kept] for k in columns], axis=1)

    def solved(self, right: Objects, known: Mapping[int, Objects]) -> _Solved:
        """Solve for the unknowns, for right-hand sides, shape=(m, k), and known rates, shape=(k,) each."""
        for k, rate in known.items():
            if k in self.columns:
                moved = [not is_zero(entry) for entry in self.columns[k]]
                right = right.copy()
                right[moved] -= np.outer(self.columns[k][moved], rate)
        if self.rows is None:
            kept = [not all(map(is_zero, row)) for row in self.matrix]
            # drives that a tool at its targets leaves free behind loops are sought over the commands: this is sparser
            is_sparse = self.is_determined or (self.has_tool and self.count > 1)
            solved = _solved_by_elimination if is_sparse else _solved_by_least_norm
            return solved(self.matrix[kept], right[kept])
        matrix, right = _combined(self.rows, self.matrix), _combined(self.rows, right)
        return _solved_directly(matrix, right) if len(matrix) <= 3 else _solved_by_elimination(matrix, right)


def _combined(weights: Array, rows: Objects) -> Objects:
    """Return weights @ rows without the terms that are zero, most of them in large systems."""
    sums = [np.sum([own[k] * rows[k] for k in np.flatnonzero(own)], axis=0) for own in weights]
    return np.array(sums, dtype=object).reshape(len(weights), rows.shape[1])


def _scaled(tree: Tree, equations: Equations) -> Equations:
    """Divide lengths by the unit."""
    scale, slides = tree.mechanism.length_unit, tree.slides
    rows = objects([1.0 if is_angular else 1.0 / scale for is_angular in equations.is_angular])
    per_length = objects([scale if is_angular else 1.0 for is_angular in equations.is_angular])
    columns = {k: c * (per_length if k in slides else rows) for k, c in equations.columns.items()}
    return replace(equations, error=equations.error * rows, columns=columns)


def _at_samples(equations: Equations) -> LoopEquations:
    """Return the derivatives of equations at the samples."""
    entries = np.broadcast_arrays(np.zeros(1), *(number_samples(x) for c in equations.columns.values() for x in c))
    table = np.stack(entries, axis=-1)[:, 1:].reshape(-1, len(equations.columns), len(equations.error))
    return LoopEquations(tuple(equations.columns), np.swapaxes(table, 1, 2))


def _stacked(equations: list[Equations], systems: Iterable[LoopSystem], task: Task) -> list[_System]:
    """Stack the equations of each system; those of the tool are the last of all."""
    tool = len(equations) - 1 if task.tool else None
    return [
        _System.of([equations[k] for k in s.equations], s.unknowns, s.rows, tool in s.equations, s.is_determined)
        for s in systems
    ]


def _damped(matrix: Objects, right: Objects, damping: Scalar) -> Objects:
    """Return the damped least-squares solution, for a right-hand side, shape=(m,)."""
    size = matrix.shape[1]
    rows = objects([[damping if i == j else 0.0 for j in range(size)] for i in range(size)])
    extended = np.concatenate([right, objects([0.0] * size)])
    return np.asarray(_solved_by_elimination(np.vstack([matrix, rows]), extended[:, None])[0][:, 0])


def _solved_directly(matrix: Objects, right: Objects) -> _Solved:
    """Solve a square system of up to three unknowns by Cramer's rule; the regularity is the determinant."""
    determinant, adjugate = _by_cofactors(matrix)
    usual = _usual(determinant)
    if usual == 0.0:
        return _solved_by_elimination(matrix, right)
    inverse = 1.0 / determinant
    return _Solved((adjugate @ right) * inverse, absolute(determinant * (1.0 / usual)), _is_flipped(determinant))


def _by_cofactors(matrix: Objects) -> tuple[Scalar, Objects]:
    """Return determinant and adjugate of a matrix of up to three rows."""
    if len(matrix) == 1:
        return matrix[0, 0], objects([[1.0]])
    if len(matrix) == 2:
        (a, b), (c, d) = matrix
        return a * d - b * c, objects([[d, -b], [-c, a]])
    a, b, c = matrix.T
    adjugate = np.stack([cross(b, c), cross(c, a), cross(a, b)])
    return a @ adjugate[0], adjugate


def _solved_by_elimination(matrix: Objects, right: Objects) -> _Solved:
    """Solve any system by least squares; the regularity is the least pivot, the determinant their product."""
    size = matrix.shape[1]
    result = eliminate(np.hstack([matrix, right]), range(size), Doubt())
    columns = list(result.columns)
    solution = zeros(size, right.shape[1])
    if not columns:
        return _Solved(solution, _REGULAR, np.False_, result.dropped)
    triangle = result.pivot_rows[:, columns]
    solution[columns] = solve_upper(triangle, result.pivot_rows[:, size:])
    is_square = len(matrix) == size == len(columns)
    is_flipped = _is_flipped(math.prod(np.diag(triangle))) if is_square else np.False_
    return _Solved(solution, _least_pivot(triangle), is_flipped, result.dropped)


def _solved_by_least_norm(matrix: Objects, right: Objects) -> _Solved:
    """Solve a system that leaves unknowns free by the shortest of its solutions; the regularity is the least pivot.

    Equations are eliminated instead of unknowns, A^T = Q R, and x = Q R^-T b: no choice of unknowns can be singular at
    a regular configuration.
    """
    size = matrix.shape[1]
    result = eliminate(matrix.T, range(len(matrix)), Doubt())
    triangle = result.pivot_rows[:, list(result.columns)]
    backwards = slice(None, None, -1)
    parts = solve_upper(triangle.T[backwards, backwards], right[list(result.columns)][backwards])[backwards]
    solution = np.stack([result.back(column) for column in parts.T], axis=1) if right.size else zeros(size, 0)
    motions = result.complement()
    free = [k for k in range(size) if any(np.nanmax(np.abs(number_samples(x))) > ZERO for x in motions[:, k])]
    return _Solved(solution, _least_pivot(triangle), np.False_, tuple(free))


def _least_pivot(triangle: Objects) -> Scalar:
    """Return the least pivot of a triangular matrix, relative to the usual ones."""
    least: Scalar = _REGULAR
    for pivot in np.diag(triangle):
        least = minimum(least, absolute(pivot * (1.0 / (_usual(pivot) or 1.0))))
    return least


def _determinant(matrix: Objects) -> Scalar:
    """Return the determinant of a sparse square matrix, or its negative, the same everywhere.

    The rows are multiplied by the exterior product, two by two, in an order that keeps the products short: a column
    without entries in other rows must be in all their terms (a Laplace expansion along groups of rows). If they become
    long all the same, the matrix is made triangular instead.
    """
    forms: list[_Form] = [{(k,): entry for k, entry in enumerate(row) if not is_zero(entry)} for row in matrix]
    while len(forms) > 1:
        columns = [frozenset(itertools.chain.from_iterable(form)) for form in forms]
        entries = Counter(itertools.chain.from_iterable(columns))
        choices: list[tuple[int, int, int]] = []
        for i, j in itertools.combinations(range(len(forms)), 2):
            degree = sum(len(next(iter(forms[k]), ())) for k in (i, j))
            joint = columns[i] | columns[j]
            inside = sum(entries[k] == (k in columns[i]) + (k in columns[j]) for k in joint)
            growth = math.comb(len(joint) - inside, max(degree - inside, 0)) - len(forms[i]) - len(forms[j])
            choices.append((growth, i, j))
        growth, i, j = min(choices)
        if growth > _MAX_GROWTH:
            result = eliminate(matrix, range(len(matrix)), Doubt())
            return 0.0 if result.dropped else math.prod(np.diag(result.pivot_rows[:, list(result.columns)]))
        second, first = forms.pop(j), forms.pop(i)
        others = frozenset[int]().union(*(c for k, c in enumerate(columns) if k not in (i, j)))
        forms.append(_exterior_product(first, second, (columns[i] | columns[j]) - others))
    return forms[0].get(tuple(range(len(matrix))), 0.0) if forms else 1.0


def _exterior_product(first: _Form, second: _Form, inside: frozenset[int]) -> _Form:
    """Return the exterior product of two forms, but for the terms that lack one of some columns."""
    terms: dict[tuple[int, ...], list[Scalar]] = {}
    for (a, x), (b, y) in itertools.product(first.items(), second.items()):
        both = set(a) | set(b)
        if len(both) == len(a) + len(b) and both >= inside:
            inversions = sum(j < i for i in a for j in b)
            terms.setdefault(tuple(sorted(both)), []).append(-(x * y) if inversions % 2 else x * y)
    sums = {columns: total(parts) for columns, parts in terms.items()}
    return {columns: entry for columns, entry in sums.items() if not is_zero(entry)}


def _usual(number: Scalar) -> float:
    """Return the median magnitude at the samples, 0 if that is a rounding error."""
    median = typical(np.abs(number_samples(number)))
    return median if median > ROUNDING else 0.0


def _is_flipped(determinant: Scalar) -> Truth:
    """Return whether a determinant has another sign than at the first sample, beyond rounding."""
    first = float(np.sign(np.ravel(number_samples(determinant))[0]))
    return less(determinant * first, -SIGN * _usual(determinant))
