"""Programs of elastic mechanisms: recorded, verified against Pinocchio and compiled once per structure."""

from __future__ import annotations

import logging

import numpy as np

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import ElasticQuantity
from pm3dof_pin.elastic.traced import Roots, elastic_tree, has_like_springs, spring_parameters
from pm3dof_pin.exceptions import ProgramError, RigidDirectionError
from pm3dof_pin.kinematics.closing_programs import BoundProgram
from pm3dof_pin.programs import cache, geometry, loops
from pm3dof_pin.programs.graph import Graph, select
from pm3dof_pin.programs.program import Program

_logger = logging.getLogger(__name__)


def elastic_program(model: ElasticModel, frame: str, quantity: ElasticQuantity, *, closed: bool) -> BoundProgram:
    """Return the program of a quantity of a frame, compiled on first use for a structure.

    Unless the loops are known to be `closed`, the program checks them.

    Raises:
        ProgramError: there is no program for this mechanism, or it disagrees with Pinocchio.
    """
    name = (frame, quantity.name, closed)
    if name not in model.programs:
        key = repr((quantity.name, closed, *elastic_structure(model, frame)))
        try:
            compiled = cache.known(key, lambda: traced_quantity(model, frame, quantity, closed=closed))
            numbers = geometry.values(model.mechanism, compiled.program.parameters, spring_parameters(model))
            model.programs[name] = BoundProgram(compiled, numbers)
        except ProgramError as error:
            _logger.warning(
                "%s: %s is computed by Pinocchio, pose by pose: %s", model.mechanism.name, quantity.name, error
            )
            model.programs[name] = error
    found = model.programs[name]
    if isinstance(found, ProgramError):
        raise found
    return found


def traced_quantity(model: ElasticModel, frame: str, quantity: ElasticQuantity, *, closed: bool = False) -> Program:
    """Record a quantity as a program.

    The input is q of the rigid mechanism; outputs are the quantity and `sound`, 1 if nothing is in doubt, else 0.

    Raises:
        ProgramError: the mechanism has an unsupported joint, the frame is free or rigid at all sample poses, or the
            traced Jacobians differ from Pinocchio's.
    """
    graph = Graph()
    tree = elastic_tree(graph, model, frame)
    roots = Roots(graph, model, tree, frame)
    try:
        values = quantity.traced(roots)
    except RigidDirectionError:
        values = np.full(quantity.shape, np.nan)
    sound = roots.is_sound if closed else roots.is_sound & loops.closed(tree)
    return graph.program(quantity.name, {quantity.name: values, "sound": select(sound, 1.0, 0.0)})


def elastic_structure(model: ElasticModel, frame: str) -> tuple[object, ...]:
    """Return what programs depend on besides the quantity."""
    mechanism = model.mechanism
    entry = mechanism.model.frames[mechanism.frame_id(frame)]
    lengths = [block.length.joint if block.length else "" for block in model.blocks]
    coordinates = [(c.joint, c.tool, c.unit, c.scale) for c in model.rigid.declared_coordinates]
    return (
        *(coordinates, frame, entry.parentJoint, mechanism.length_unit),
        *(model.spring_indices.tolist(), model.passive_indices.tolist(), model.rigid_indices.tolist(), lengths),
        *(list(spring_parameters(model)), model.compliance_root[1].tolist(), has_like_springs(model)),
        *(geometry.structure(mechanism), geometry.pattern(mechanism, (frame,))),
    )
