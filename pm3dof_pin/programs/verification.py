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
from pm3dof_pin.programs.loops import closure_equations
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
    for index in range(len(mechanism.closures)):
        columns = closure_equations(tree, index).columns
        size = mechanism.loop_kinematics.rows[index].stop - mechanism.loop_kinematics.rows[index].start
        resting = objects([0.0] * size)
        outputs[f"closure {index}"] = [x for k in range(model.nv) for x in columns.get(k, resting)]
    program = graph.program("verification", outputs)
    parameters = geometry.values(mechanism, program.parameters)
    at_random = program.split(program.evaluate(rows, parameters))
    at_samples = program.split(program.evaluate(closed, parameters))
    for q, k in ((q, k) for q in range(len(rows)) for k in range(len(frames))):
        _compare(mechanism, f"frame '{frames[k]}'", at_random[f"frame {k}"][q], _frame(mechanism, frames[k], rows[q]))
    for q, index in ((q, index) for q in range(len(closed)) for index in range(len(mechanism.closures))):
        loop = mechanism.closures[index]
        traced = at_samples[f"closure {index}"][q].reshape(model.nv, -1).T
        _compare(mechanism, f"closure {loop.frame_a}-{loop.frame_b}", traced, _closure(mechanism, index, closed[q]))


def _frame(mechanism: Mechanism, name: str, q: Array) -> Array:
    configuration = Configuration(mechanism, q)
    placement = configuration.frame_placement(name)
    return np.concatenate(
        [placement.rotation.ravel(), placement.translation, configuration.frame_jacobian(name).ravel()]
    )


def _closure(mechanism: Mechanism, index: int, q: Array) -> Array:
    """Return Pinocchio's rows of a closure, rotated from the axes of frame a to the world's."""
    configuration = Configuration(mechanism, q)
    rotation = configuration.frame_placement(mechanism.closures[index].frame_a).rotation
    rows = configuration.constraint_jacobian[mechanism.loop_kinematics.rows[index]]
    turned: Array = np.concatenate([rotation @ part for part in np.split(rows, len(rows) // 3)])
    return turned


def _compare(mechanism: Mechanism, name: str, traced: Array, expected: Array) -> None:
    difference = np.abs(traced - expected).max(initial=0.0)
    if not difference <= TOLERANCE:
        raise ProgramError(
            f"{mechanism.name}: {name}: traced Jacobian or placement differs by {difference:.1e} "
            f"from Pinocchio's, expected at most {TOLERANCE:.0e}"
        )
