"""Programs of elastic mechanisms: recorded, compared with Pinocchio and compiled once for each structure."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import ElasticQuantity
from pm3dof_pin.elastic.traced import Roots, elastic_tree, has_like_springs, spring_parameters
from pm3dof_pin.exceptions import ConvergenceError, ProgramError, RigidDirectionError
from pm3dof_pin.kinematics.degrees_of_freedom import ASSEMBLED_TOLERANCE
from pm3dof_pin.kinematics.samples import samples_near
from pm3dof_pin.programs import cache, geometry
from pm3dof_pin.programs.elimination import total
from pm3dof_pin.programs.graph import Graph, Truth, less, select
from pm3dof_pin.programs.llvm import Compiled
from pm3dof_pin.programs.loops import closure_equations
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tool_motion import DROPPED, PIVOT, length_unit
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix

_logger = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class _ElasticProgram:
    """A compiled program with the numbers of one model."""

    compiled: Compiled
    parameters: Array

    def __call__(self, q: Matrix, threads: int | None = None) -> tuple[Array, Mask]:
        """Evaluate at q of the rigid mechanism, shape=(n, nq): flat values, and where nothing is in doubt."""
        return self.compiled.with_doubt(q, self.parameters, threads)


def elastic_program(model: ElasticModel, frame: str, quantity: ElasticQuantity, *, closed: bool) -> _ElasticProgram:
    """Return the program of a quantity of a frame, compiled if no model of this structure needed it before.

    Loops not known to be `closed` are checked by the program.

    Raises:
        ProgramError: there is no program for this mechanism, or it does not agree with Pinocchio.
    """
    name = (frame, quantity.name, closed)
    if name not in model.programs:
        key = repr((quantity.name, closed, *elastic_structure(model, frame)))
        try:
            compiled = cache.known(key, lambda: traced_quantity(model, frame, quantity, closed=closed))
            model.programs[name] = _ElasticProgram(compiled, elastic_parameters(model, compiled.program.parameters))
        except ProgramError as error:
            _logger.warning(
                "%s: %s is computed by Pinocchio, pose by pose: %s", model.mechanism.name, quantity.name, error
            )
            model.programs[name] = error
    found = model.programs[name]
    if isinstance(found, ProgramError):
        raise found
    assert isinstance(found, _ElasticProgram)
    return found


def traced_quantity(model: ElasticModel, frame: str, quantity: ElasticQuantity, *, closed: bool = False) -> Program:
    """Record a quantity as a program.

    Inputs are q of the rigid mechanism; outputs the quantity and `sound`, 1 where nothing is in doubt, else 0.

    Raises:
        ProgramError: the mechanism has a joint for which there is no program, the frame is free or rigid at all sample
            poses, or the traced Jacobians are not Pinocchio's.
    """
    try:
        poses = samples_near(model.rigid, model.rigid.home.q)
    except ConvergenceError as error:
        raise ProgramError(str(error)) from error
    verify(model.mechanism, model.embed(poses))
    graph = Graph()
    q = np.array([graph.input(f"q[{k}]", poses[:, k]) for k in range(poses.shape[1])], dtype=object)
    tree = elastic_tree(graph, model, q, poses, frame)
    roots = Roots(graph, model, tree, frame)
    try:
        values = quantity.traced(roots)
    except RigidDirectionError:
        values = np.full(quantity.shape, np.nan)
    sound: Truth = np.True_
    for root in roots.used:
        trace = total([total([entry * entry for entry in row]) for row in root.columns])  # NaN if an entry is
        sound = sound & less(PIVOT, root.pivot) & less(root.dropped, DROPPED) & less(-1.0, trace)
    if not closed:
        tolerance = 0.5 * ASSEMBLED_TOLERANCE * length_unit(model.mechanism.characteristic_length)
        for index in range(len(model.mechanism.closures)):
            sound = sound & less(closure_equations(tree, index).residual, tolerance)
    return graph.program(quantity.name, {quantity.name: values, "sound": select(sound, 1.0, 0.0)})


def elastic_structure(model: ElasticModel, frame: str) -> tuple[object, ...]:
    """Return what programs depend on besides what they compute."""
    mechanism = model.mechanism
    entry = mechanism.model.frames[mechanism.frame_id(frame)]
    lengths = [block.length.joint if block.length else "" for block in model.blocks]
    coordinates = [(c.joint, c.tool, c.unit, c.scale) for c in model.rigid.declared_coordinates]
    return (
        *(coordinates, frame, entry.parentJoint, length_unit(mechanism.characteristic_length)),
        *(model.spring_indices.tolist(), model.passive_indices.tolist(), model.rigid_indices.tolist(), lengths),
        *(list(spring_parameters(model)), model.compliance_root[1].tolist(), has_like_springs(model)),
        *(geometry.structure(mechanism), geometry.pattern(mechanism, (frame,))),
    )


def elastic_parameters(model: ElasticModel, names: tuple[str, ...]) -> Array:
    """Return the values of a program's parameters that are springs or geometry, shape=(number of names,)."""
    springs = spring_parameters(model)
    others = [name for name in names if name not in springs]
    found = springs | dict(zip(others, geometry.values(model.mechanism, others), strict=True))
    return np.array([found[name] for name in names])
