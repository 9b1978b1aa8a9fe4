"""Comparison of traced geometry with Pinocchio, run before programs are recorded, again only after changes."""

from __future__ import annotations

import hashlib

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.programs.loops import loop_equations
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Array

TOLERANCE = 1e-10
"""Largest permitted difference between traced Jacobians and Pinocchio's."""

_RANDOM_POSES = 5

_passed: set[str] = set()


def verify(mechanism: Mechanism, samples: ArrayLike, *, dense: bool = False) -> None:
    """Compare traced placements and Jacobians with Pinocchio's.

    Frames of the closures and the tool are compared at random configurations, closed or not; the derivatives of the
    closure errors at the samples, where the loops are closed.

    Raises:
        ProgramError: a difference exceeds :data:`TOLERANCE`, or a joint type is not supported.
    """
    closed = np.asarray(samples, dtype=float)
    content = geometry.structure(mechanism), geometry.numbers(mechanism), closed.tolist(), dense
    key = hashlib.sha256(repr(content).encode()).hexdigest()
    if key not in _passed:
        _verify(mechanism, closed, dense=dense)
        _passed.add(key)


def _verify(mechanism: Mechanism, closed: Array, *, dense: bool) -> None:
    model, generator = mechanism.model, np.random.default_rng(0)
    tangents = generator.uniform(-1.0, 1.0, (_RANDOM_POSES, model.nv)) * mechanism.velocity_scale
    rows = np.array([pin.integrate(model, pin.neutral(model), tangent) for tangent in tangents])
    graph = Graph()
    tree = Tree(graph, mechanism, closed, dense=dense)
    outputs = {}
    frames = geometry.frame_names(mechanism)
    for k, name in enumerate(frames):
        frame = tree.frame(name)
        outputs[f"frame {k}"] = [*frame.rotation.ravel(), *frame.translation, *tree.jacobian(name).ravel()]
    for index, equations in enumerate(loop_equations(tree)):
        resting = objects([0.0] * len(equations.error))
        outputs[f"closure {index}"] = [x for k in range(model.nv) for x in equations.columns.get(k, resting)]
    program = graph.program("verification", outputs)
    parameters = geometry.values(mechanism, program.parameters)
    at_random = program.split(program.evaluate(rows, parameters))
    at_samples = program.split(program.evaluate(closed, parameters))
    for row, q in enumerate(rows):
        configuration = Configuration(mechanism, q)
        for k, name in enumerate(frames):
            _compare(mechanism, f"frame '{name}'", at_random[f"frame {k}"][row], _frame(configuration, name))
    for row, q in enumerate(closed):
        configuration = Configuration(mechanism, q)
        # both are the same function where the loops are closed, and differ by as much as a description leaves them open
        tolerance = TOLERANCE + 2.0 * configuration.closure_residual
        for index, name in enumerate(mechanism.constraint_names):
            traced = at_samples[f"closure {index}"][row].reshape(model.nv, -1).T
            _compare(mechanism, f"closure {name}", traced, _closure(configuration, index), tolerance)


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
