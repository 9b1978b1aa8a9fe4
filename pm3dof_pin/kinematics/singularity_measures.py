"""Distances of many poses from each type of singularity: scaled Jacobians from a program, decomposed by LAPACK."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import BoundProgram, quantity_program
from pm3dof_pin.kinematics.mobility import Mobility
from pm3dof_pin.kinematics.pose_values import BatchOptions, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularity_distances
from pm3dof_pin.mechanism.configuration import ASSEMBLED_TOLERANCE
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.loops import largest_residual, loop_equations, scaled_rows
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_AT_ONCE = 256  # poses per block, whose matrices stay in the cache
_LEAST_SQUARE = 1e-6  # least square of a singular value of closures, relative to the greatest, that is squared
_ROUNDING, _ACCURATE = 1e-14, 1e-9  # of squares of size 1; relative, of those that are measured


def singularity_measures(
    robot: Robot,
    poses: Poses | ArrayLike,
    generic: Mobility,
    **options: Unpack[BatchOptions],
) -> Array:
    """Measure how far many poses are from each type of singularity.

    Args:
        robot: the robot.
        poses: solved poses, or configurations q with closed loops, shape=(..., nq) [m, rad].
        generic: mobility at a generic configuration, see :func:`~pm3dof_pin.kinematics.singularity.singularities`.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Returns:
        The measures of :func:`~pm3dof_pin.kinematics.singularity.singularity_distances`, in its order, shape=(..., k).

    Raises:
        PM3DofError: see there.
    """
    ranks = _ranks(generic)
    has_any = np.array(ranks) > 0

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        values, sound = _in_blocks(robot, q, ranks, threads, _measured, len(ranks))
        return values[:, has_any], sound

    return evaluate_at(
        robot,
        poses,
        "distances from singularities",
        (int(has_any.sum()),),
        program=program,
        reference=lambda q: [d.measure for d in singularity_distances(robot.configuration(q), generic=generic)],
        **options,
    ).values


def least_singularity_measures(
    robot: Robot,
    poses: Poses | ArrayLike,
    generic: Mobility,
    **options: Unpack[BatchOptions],
) -> Array:
    """Return the least of the :func:`singularity_measures` of each pose, in half the time, shape=(...); inf if none."""
    ranks = _ranks(generic)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        return _in_blocks(robot, q, ranks, threads, _least_measured, 1)

    def reference(q: Vector) -> float:
        found = singularity_distances(robot.configuration(q), generic=generic)
        return min((distance.measure for distance in found), default=np.inf)

    return evaluate_at(
        robot, poses, "distances from the nearest singularity", (), program=program, reference=reference, **options
    ).values


def _ranks(generic: Mobility) -> list[int]:
    return [d.rank for d in (generic.constraint_rank, generic.actuator_rank, generic.tool_rank, generic.idle_rank)]


def _in_blocks(
    robot: Robot,
    q: Matrix,
    ranks: list[int],
    threads: int | None,
    measured: Callable[[Robot, Array, Array, list[int]], tuple[Array, Mask]],
    count: int,
) -> tuple[Array, Mask]:
    """Return what is measured of the Jacobians of closures and tool, shape=(n, count), and a mask of sound poses."""
    jacobians = scaled_jacobians(robot)
    values, sound = np.zeros((len(q), count)), np.zeros(len(q), dtype=bool)
    for first in range(0, len(q), _AT_ONCE):
        part = slice(first, first + _AT_ONCE)
        groups = jacobians.compiled.program.split(jacobians(q[part], threads=threads))
        closed = groups["residual"] <= ASSEMBLED_TOLERANCE * robot.characteristic_length
        closed &= np.isfinite(q[part]).all(axis=1)  # without loops the residual is zero at any q
        rows = first + np.flatnonzero(closed)
        values[rows], sound[rows] = measured(robot, groups["closures"][closed], groups["tool"][closed], ranks)
    return values, sound


def _measured(robot: Robot, rows: Array, tool: Array, ranks: list[int]) -> tuple[Array, Mask]:
    """Return the measures, shape=(n, 4), at poses whose closures have their usual rank, and a mask of these."""
    values, sound = np.zeros((len(rows), 4)), np.zeros(len(rows), dtype=bool)
    if rows.shape[1] == ranks[0] > 0:
        values, sound = _by_squares(robot, rows, tool, ranks)
    left = np.flatnonzero(~sound)
    values[left], sound[left] = _by_singular_values(robot, rows[left], tool[left], ranks)
    return values, sound


def _least_measured(robot: Robot, rows: Array, tool: Array, ranks: list[int]) -> tuple[Array, Mask]:
    """Return the least measure, shape=(n, 1), and a mask of sound ones.

    What drives and tool see together is at least as large as what one of them sees of as many motions. The closures'
    eigenvalues are beyond a number if their squares less that number have a Cholesky factor.
    """
    values, sound = np.zeros((len(rows), 1)), np.zeros(len(rows), dtype=bool)
    if rows.shape[1] == ranks[0] > 0 and 0 < ranks[3] in ranks[1:3]:
        gram, limit = rows @ np.swapaxes(rows, 1, 2), _least_square(robot)
        greatest = np.abs(gram).sum(axis=2).max(axis=1)  # at least the greatest eigenvalue
        with suppress(np.linalg.LinAlgError):
            felt, count = _felt(robot, rows, tool, gram), len(robot.actuated_indices)
            parts = [felt[:, :count, :count], felt[:, count:, count:]]
            found = [np.linalg.eigvalsh(part)[:, -rank] for part, rank in zip(parts, ranks[1:3], strict=True) if rank]
            least = np.maximum(np.min(found, axis=0), 0.0)
            floor = np.maximum(least, limit * greatest)
            try:
                np.linalg.cholesky(gram - floor[:, None, None] * np.eye(ranks[0]))
            except np.linalg.LinAlgError:  # somewhere the closures are nearer to losing rank than drives and tool
                squares = np.linalg.eigvalsh(gram)
                least, floor, greatest = np.minimum(least, squares[:, 0]), squares[:, 0], squares[:, -1]
            values[:, 0] = np.sqrt(np.maximum(least, 0.0))
            sound = (floor >= limit * greatest) & (_ROUNDING * greatest <= _ACCURATE * least * floor)
    left = np.flatnonzero(~sound)
    if left.size:
        every, sound[left] = _measured(robot, rows[left], tool[left], ranks)
        values[left, 0] = np.where(np.array(ranks) > 0, every, np.inf).min(axis=1)
    return values, sound


def _by_singular_values(robot: Robot, rows: Array, tool: Array, ranks: list[int]) -> tuple[Array, Mask]:
    _, sizes, directions = np.linalg.svd(rows)
    count = (sizes > robot.rank_tolerance * sizes.max(axis=1, initial=0.0, keepdims=True)).sum(axis=1)
    free = np.swapaxes(directions[:, ranks[0] :], 1, 2)
    rates = free[:, robot.actuated_indices]
    motions = tool @ free
    seen = (rates, motions, np.concatenate([rates, motions], axis=1))
    values = [sizes, *(np.linalg.svd(matrix, compute_uv=False) for matrix in seen)]
    return _least(values, ranks), count == ranks[0]


def _by_squares(robot: Robot, rows: Array, tool: Array, ranks: list[int]) -> tuple[Array, Mask]:
    """Measure by eigenvalues of squares, in half the time; sound where rounding leaves the measures nine digits.

    With closures A of full rank and what is seen of the joints B, drives or tool, the singular values of B on the free
    motions are roots of eigenvalues of B P B^T, P = I - A^T (A A^T)^-1 A.
    """
    values, sound = np.zeros((len(rows), 4)), np.zeros(len(rows), dtype=bool)
    gram = rows @ np.swapaxes(rows, 1, 2)
    squares = np.linalg.eigvalsh(gram)
    greatest = squares[:, -1]
    known = np.flatnonzero(squares[:, 0] > _least_square(robot) * greatest)
    rows, tool, squares, greatest = rows[known], tool[known], squares[known], greatest[known]
    felt, count = _felt(robot, rows, tool, gram[known]), len(robot.actuated_indices)
    parts = (felt[:, :count, :count], felt[:, count:, count:], felt)
    found = [squares, *(np.linalg.eigvalsh(part) for part in parts)]
    least = _least([np.maximum(part[:, ::-1], 0.0) for part in found], ranks)
    rounding = _ROUNDING * greatest / squares[:, 0]
    wanted = np.where(np.array(ranks) > 0, least, np.inf).min(axis=1)
    values[known], sound[known] = np.sqrt(least), rounding <= _ACCURATE * wanted
    return values, sound


def _least_square(robot: Robot) -> float:
    return max(_LEAST_SQUARE, robot.rank_tolerance**2)


def _felt(robot: Robot, rows: Array, tool: Array, gram: Array) -> Array:
    """Return B P B^T for drives and tool, shape=(n, u + t, u + t), but for what they share only below its diagonal."""
    drives, turned = robot.actuated_indices, np.swapaxes(tool, 1, 2)
    count = len(drives)
    across = np.concatenate([rows[:, :, drives], rows @ turned], axis=2)
    felt = np.asarray(np.swapaxes(across, 1, 2) @ np.linalg.solve(-gram, across))
    felt[:, :count, :count] += np.eye(count)
    felt[:, count:, :count] += tool[:, :, drives]
    felt[:, count:, count:] += tool @ turned
    return felt


def _least(values: list[Array], ranks: list[int]) -> Array:
    """Return the least of as many values as the rank, of each type, shape=(n, 4)."""
    zero = np.zeros(len(values[0]))
    return np.stack(
        [v[:, rank - 1] if 0 < rank <= v.shape[1] else zero for v, rank in zip(values, ranks, strict=True)], axis=1
    )


def scaled_jacobians(robot: Robot) -> BoundProgram:
    """Return the program of the scaled Jacobians of closures and tool, and of the closure error, at q.

    Raises:
        ProgramError: there is no program for this robot.
    """

    def trace() -> Program:
        poses = samples_near_home(robot)
        verify(robot, poses)
        tree, unit = Tree(Graph(), robot, poses), robot.characteristic_length
        jacobian = tree.jacobian(robot.frame_name())
        jacobian[:3] = jacobian[:3] * (1.0 / unit)
        jacobian[:, tree.slides] = jacobian[:, tree.slides] * unit
        tool = jacobian[[TOOL_COMPONENTS.index(name) for name in robot.tool_motions]]
        equations = loop_equations(tree)
        closures, residual = scaled_rows(tree, equations, unit), largest_residual(equations)
        outputs = {"closures": closures, "tool": tool, "residual": residual}
        return tree.graph.program("jacobians", outputs)

    return quantity_program(robot, ("jacobians", robot.tool_motions, robot.characteristic_length), trace)
