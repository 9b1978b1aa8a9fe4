"""Comparison of traced geometry with Pinocchio, run before programs are recorded, again only after changes."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.elimination import samples
from pm3dof_pin.programs.graph import Graph, Scalar, is_zero
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.programs.loops import loop_equations
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Array

TOLERANCE = 1e-10
"""Largest permitted difference between traced Jacobians and Pinocchio's."""

_RANDOM_POSES = 5

_passed: set[str] = set()


def verify(mechanism: Mechanism, closed: ArrayLike, *, dense: bool = False) -> None:
    """Compare traced placements and Jacobians with Pinocchio's.

    Frames of the closures and the tool are compared at random configurations, closed or not; the derivatives of the
    closure errors at closed configurations, shape=(s, nq).

    Raises:
        ProgramError: a difference exceeds :data:`TOLERANCE`, or a joint type is not supported.
    """
    closed = np.asarray(closed, dtype=float)
    content = geometry.structure(mechanism), geometry.numbers(mechanism), closed.tolist(), dense
    key = hashlib.sha256(repr(content).encode()).hexdigest()
    if key not in _passed:
        _verify(mechanism, closed, dense=dense)
        _passed.add(key)


def _verify(mechanism: Mechanism, closed: Array, *, dense: bool) -> None:
    model, generator = mechanism.model, np.random.default_rng(0)
    tangents = generator.uniform(-1.0, 1.0, (_RANDOM_POSES, model.nv)) * mechanism.velocity_scale
    rows = np.array([pin.integrate(model, pin.neutral(model), tangent) for tangent in tangents])
    every = np.concatenate([rows, closed])
    tree = Tree(Graph(), mechanism, every, dense=dense)
    configurations = [Configuration(mechanism, q) for q in every]
    for name in geometry.frame_names(mechanism):
        frame = tree.frame(name)
        traced = _values([*frame.rotation.ravel(), *frame.translation, *tree.jacobian(name).ravel()], len(every))
        for row, configuration in enumerate(configurations[: len(rows)]):
            _compare(mechanism, f"frame '{name}'", traced[row], _frame(configuration, name))
    for index, (name, equations) in enumerate(zip(mechanism.constraint_names, loop_equations(tree), strict=True)):
        resting = objects([0.0] * len(equations.error))
        columns = [equations.columns.get(k, resting) for k in range(model.nv)]
        traced = _values([x for column in columns for x in column], len(every))
        for row, configuration in enumerate(configurations[len(rows) :], len(rows)):
            # the same function where the loops are closed, and differing by as much as a description leaves them open
            tolerance = TOLERANCE + 2.0 * configuration.closure_residual
            expected = _closure(configuration, index)
            _compare(mechanism, f"closure {name}", traced[row].reshape(model.nv, -1).T, expected, tolerance)


def _values(numbers: Sequence[Scalar], count: int) -> Array:
    """Return the values of traced numbers at the poses of their tree, shape=(count, numbers)."""
    values = np.zeros((count, len(numbers)))
    for column, number in enumerate(numbers):
        if not is_zero(number):
            values[:, column] = samples(number)
    return values


def _frame(configuration: Configuration, name: str) -> Array:
    placement = configuration.frame_placement(name)
    return np.concatenate(
        [placement.rotation.ravel(), placement.translation, configuration.frame_jacobian(name).ravel()]
    )


def _closure(configuration: Configuration, index: int) -> Array:
    """Return Pinocchio's rows of a closure or coupling; if the world's axes serve, rotated to them from frame a's."""
    mechanism = configuration.mechanism
    rows: Array = configuration.constraint_jacobian[mechanism.loop_kinematics.rows[index]]
    for loop in mechanism.closures[index : index + 1]:
        if loop.kind.holds_vectors:
            rotation = configuration.frame_placement(loop.frame_a).rotation
            rows = np.concatenate([rotation @ part for part in np.split(rows, len(rows) // 3)])
    return rows


def _compare(mechanism: Mechanism, name: str, traced: Array, expected: Array, tolerance: float = TOLERANCE) -> None:
    difference = np.abs(traced - expected).max(initial=0.0)
    if not difference <= tolerance:
        raise ProgramError(
            f"{mechanism.name}: {name}: traced Jacobian or placement differs by {difference:.1e} "
            f"from Pinocchio's, expected at most {tolerance:.0e}"
        )
