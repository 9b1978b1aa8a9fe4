"""Newton and damped steps that close all loops, as programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent
from pm3dof_pin.exceptions import ShapeError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.tool_components import tool_components
from pm3dof_pin.programs.elimination import Doubt, eliminate, solve_upper, typical
from pm3dof_pin.programs.graph import (
    Graph,
    Number,
    Scalar,
    Truth,
    absolute,
    cos,
    is_zero,
    less,
    maximum,
    minimum,
    select,
    sin,
    sqrt,
)
from pm3dof_pin.programs.joints import cross, objects
from pm3dof_pin.programs.loops import Equations, largest, largest_residual, loop_equations, tool_equations
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Array, Objects

_ROUNDING = 1e-12
"""Scaled determinants and pivots up to this are treated as zero."""

_RANK = 1e-6
"""Least relative singular value of equations that determine their joints."""

_LEAST_DAMPING = 1e-8
"""Least damping of damped steps, relative to the squared error."""

_LONGEST_STEP = 0.5
"""Longest damped step [rad, characteristic lengths]: for longer ones the linear model of a rotation is poor."""

_REGULAR = 1.0 - 2.0**-10
"""Regularity of configurations at least as far from singular ones as usual."""

_MOST_BITS = 30  # of the mode, which leaves seven digits for the regularity


@dataclass(frozen=True)
class Task:
    """The prescribed quantities when loops are closed."""

    joints: tuple[str, ...] = ()  #: single-DoF joints held at given coordinates
    #: components of the tool's placement with targets, R = Rx(rx) Ry(ry) Rz(rz)
    tool: tuple[ToolComponent, ...] = ()


def closing_program(mechanism: Mechanism, task: Task, samples: ArrayLike, *, dense: bool = False) -> Program:
    """Record one Newton step.

    Closures, and the tool's equations, that determine their joints are solved one by one; others that share joints are
    solved together. Overconstrained systems are solved by least squares; of joints with redundant motions, some are
    kept at rest, chosen at the samples, shape=(s, nq), see :class:`Tree`. Convergence is quadratic if the loops can be
    closed.

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
    tree, equations, scale, slides, held, (_, jump) = given
    regularity: Scalar = _REGULAR
    mode: Scalar = 0.0
    longest: Scalar = 0.0
    moves: dict[int, Scalar] = {}
    for bit, system in enumerate(_systems([_scaled(e, scale, slides) for e in equations], held)):
        matrix, right = system.reduced(moves)
        solution, size, is_flipped = _solved(matrix, right)
        moves |= dict(zip(system.unknowns, solution, strict=True))
        regularity = minimum(regularity, size)
        mode = mode + select(is_flipped, 2.0**bit, 0.0) if bit < _MOST_BITS else mode
        longest = maximum(longest, largest(solution))
    velocities = {k: move * (scale if k in slides else 1.0) for k, move in moves.items()}
    outputs = {
        "q": tree.step(velocities),
        "margin": regularity - 2.0 * mode,
        "jump": jump + longest,
        "residual": largest_residual(equations),
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
    tree, equations, scale, slides, held, (*best, damping, cost) = _given(mechanism, task, samples, names, dense)
    scaled = [_scaled(equation, scale, slides) for equation in equations]
    error: Scalar = sum((equation.error @ equation.error for equation in scaled), start=0.0)
    is_worse = less(cost, error)
    size = select(is_worse, damping * 100.0, maximum(damping * 0.1, _LEAST_DAMPING))
    moves: dict[int, Scalar] = {}
    for system in _joined([_system(equation, held) for equation in scaled]):
        matrix, right = system.reduced({})
        moves |= dict(zip(system.unknowns, _damped(matrix, right, sqrt(size * error)), strict=True))
    longest = largest(objects(list(moves.values())))
    share = select(less(_LONGEST_STEP, longest), _LONGEST_STEP / longest, 1.0) if moves else 1.0
    moved = tree.step({k: move * share * (scale if k in slides else 1.0) for k, move in moves.items()})
    outputs: dict[str, Any] = {
        "q": [select(is_worse, old, new) for old, new in zip(best, moved, strict=True)],
        "best": [select(is_worse, old, new) for old, new in zip(best, tree.q, strict=True)],
        "damping": size,
        "cost": minimum(cost, error),
        "residual": largest_residual(equations),
    }
    return tree.graph.program("damped_closing", outputs)


class _Given(NamedTuple):
    """Common to both kinds of steps: the tree, its equations, and the free entries of v."""

    tree: Tree
    equations: list[Equations]
    scale: float
    slides: set[int]
    held: set[int]
    state: list[Number]


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
    tree = Tree(graph, mechanism, rows, positions=q, dense=dense)
    equations = loop_equations(tree)
    if task.tool:
        equations.append(tool_equations(tree, task.tool, _targets(graph, mechanism, task, rows)))
    return _Given(tree, equations, mechanism.length_unit, set(tree.slides), {joint.v_index for joint in held}, further)


def _targets(graph: Graph, mechanism: Mechanism, task: Task, samples: Array) -> dict[str, Number]:
    """Add the targets to the inputs; their samples are the tool's placements."""
    rows = tool_components([Configuration(mechanism, q).tool_placement.homogeneous for q in samples])
    return {name: graph.input(name, rows[:, TOOL_COMPONENTS.index(name)]) for name in task.tool}


def regularity_and_mode(margin: Array) -> tuple[Array, Array]:
    """Decode `margin`: return regularities, in (0, 1), and assembly modes, 0 being that of the samples."""
    mode = -np.floor(0.5 * margin)
    return margin + 2.0 * mode, mode


@dataclass(frozen=True, eq=False)
class _System:
    """Scaled equations that are solved together: columns by the entries of v, and errors."""

    columns: Mapping[int, Objects]  #: derivative of the errors by the entries of v, shape=(m,) each
    error: Objects  #: shape=(m,)
    unknowns: tuple[int, ...]  #: the entries of v to solve for; the others are held, or known by then

    def reduced(self, known: Mapping[int, Scalar]) -> tuple[Objects, Objects]:
        """Return matrix and right-hand side in the unknowns, given the others, without zero rows."""
        matrix = np.stack([self.columns[k] for k in self.unknowns], axis=1)
        right = -self.error
        for k, move in known.items():
            if k in self.columns:
                right = right - self.columns[k] * move
        kept = [not all(map(is_zero, row)) for row in matrix]
        return matrix[kept], right[kept]

    @property
    def is_determined(self) -> bool:
        """Whether there are unknowns, and the rows have full column rank at most of the samples."""
        if not self.unknowns or len(matrix := self.reduced({})[0]) < len(self.unknowns):
            return False
        entries = [x.samples if isinstance(x, Number) else np.array([float(x)]) for x in matrix.ravel()]
        values = np.stack(np.broadcast_arrays(*entries), axis=-1).reshape(-1, *matrix.shape)
        singular = np.linalg.svd(values[np.isfinite(values).all(axis=(1, 2))], compute_uv=False)
        return typical(singular[:, -1]) > _RANK * typical(singular[:, 0])


def _scaled(equations: Equations, scale: float, slides: set[int]) -> Equations:
    """Divide lengths by the scale."""
    rows = objects([1.0 if is_angular else 1.0 / scale for is_angular in equations.is_angular])
    per_length = objects([scale if is_angular else 1.0 for is_angular in equations.is_angular])
    columns = {k: c * (per_length if k in slides else rows) for k, c in equations.columns.items()}
    return Equations(equations.error * rows, equations.is_angular, columns, equations.residual)


def _systems(equations: list[Equations], held: set[int]) -> list[_System]:
    """Group equations into systems, in an order in which they can be solved.

    Equations that determine all their joints are solved alone; then those that do so given the joints found; the rest
    are joined where they share joints.
    """
    waiting, found, systems = list(equations), set(held), []
    while waiting:
        choices = ((equation, _system(equation, found)) for equation in waiting)
        equation, system = next((choice for choice in choices if choice[1].is_determined), (None, None))
        if equation is None or system is None:
            break
        waiting.remove(equation)
        found |= set(system.unknowns)
        systems.append(system)
    return systems + _joined([_system(equation, found) for equation in waiting])


def _joined(systems: list[_System]) -> list[_System]:
    """Join systems that share unknowns; omit those without any."""
    joined: list[_System] = []
    for system in systems:
        if system.unknowns:
            sharing = [other for other in joined if set(other.unknowns) & set(system.unknowns)]
            joined = [other for other in joined if other not in sharing]
            joined.append(_union([*sharing, system]))
    return joined


def _system(equations: Equations, found: set[int]) -> _System:
    free = [k for k, column in equations.columns.items() if k not in found and not all(map(is_zero, column))]
    return _System(equations.columns, equations.error, tuple(sorted(free)))


def _union(systems: list[_System]) -> _System:
    """Stack systems."""
    names = {k for system in systems for k in system.columns}
    columns = {
        k: np.concatenate([s.columns.get(k, objects([0.0] * len(s.error))) for s in systems]) for k in sorted(names)
    }
    unknowns = {k for system in systems for k in system.unknowns}
    return _System(columns, np.concatenate([system.error for system in systems]), tuple(sorted(unknowns)))


def _solved(matrix: Objects, right: Objects) -> tuple[Objects, Scalar, Truth]:
    """Return solution, regularity, and whether the determinant has another sign than at the first sample."""
    direct = matrix.shape[0] == matrix.shape[1] <= 3
    return _solved_directly(matrix, right) if direct else _solved_by_elimination(matrix, right)


def _damped(matrix: Objects, right: Objects, damping: Scalar) -> Objects:
    """Return the damped least-squares solution."""
    size = matrix.shape[1]
    rows = objects([[damping if i == j else 0.0 for j in range(size)] for i in range(size)])
    extended = np.concatenate([right, objects([0.0] * size)])
    return _solved_by_elimination(np.vstack([matrix, rows]), extended)[0]


def _solved_directly(matrix: Objects, right: Objects) -> tuple[Objects, Scalar, Truth]:
    """Solve a square system of up to three unknowns by Cramer's rule; the regularity is the determinant."""
    size = len(matrix)
    if size == 1:
        determinant, adjugate = matrix[0, 0], objects([[1.0]])
    elif size == 2:
        (a, b), (c, d) = matrix
        determinant, adjugate = a * d - b * c, objects([[d, -b], [-c, a]])
    else:
        a, b, c = matrix.T
        adjugate = np.stack([cross(b, c), cross(c, a), cross(a, b)])
        determinant = a @ adjugate[0]
    usual = _usual(determinant)
    if usual == 0.0:
        return _solved_by_elimination(matrix, right)
    inverse = 1.0 / determinant
    return (adjugate @ right) * inverse, absolute(determinant * (1.0 / usual)), _is_flipped(determinant)


def _solved_by_elimination(matrix: Objects, right: Objects) -> tuple[Objects, Scalar, Truth]:
    """Solve any system by least squares; the regularity is the least pivot, the determinant their product."""
    size = matrix.shape[1]
    result = eliminate(np.hstack([matrix, right[:, None]]), range(size), Doubt())
    columns = list(result.columns)
    solution = objects([0.0] * size)
    if not columns:
        return solution, _REGULAR, np.False_
    triangle = result.pivot_rows[:, columns]
    solution[columns] = solve_upper(triangle, result.pivot_rows[:, size:])[:, 0]
    orientation: Scalar = 1.0
    least: Scalar = _REGULAR
    for pivot in np.diag(triangle):
        orientation = orientation * pivot
        least = minimum(least, absolute(pivot * (1.0 / (_usual(pivot) or 1.0))))
    is_square = len(matrix) == size == len(columns)
    return solution, least, _is_flipped(orientation) if is_square else np.False_


def _usual(number: Scalar) -> float:
    """Return the median magnitude at the samples, 0 if that is a rounding error."""
    median = typical(np.abs(number.samples if isinstance(number, Number) else number))
    return median if median > _ROUNDING else 0.0


def _is_flipped(determinant: Scalar) -> Truth:
    """Return whether a determinant has another sign than at the first sample."""
    first = determinant.samples[0] if isinstance(determinant, Number) else determinant
    return less(determinant * float(np.sign(first)), 0.0)
