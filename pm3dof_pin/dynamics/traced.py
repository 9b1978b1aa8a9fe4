"""Holding forces, inertia and vibrations of a mechanism on recorded numbers, and their programs.

The least motions S per actuator rate, v = S du with the loops closed, give both the forces that hold the weights,
S^T tau_g, and the inertia at the actuators, S^T M S. Vibrations are those of :mod:`pm3dof_pin.dynamics.modes`, with
strains of unit energy as coordinates: eigenvalues of a symmetric matrix, computed by LAPACK.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np
import pinocchio as pin

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.traced import Roots, elastic_program
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import cache, geometry, masses
from pm3dof_pin.programs.closed_motions import closed_motions
from pm3dof_pin.programs.elimination import DROPPED, Doubt, product, projected, samples
from pm3dof_pin.programs.graph import Graph, sqrt
from pm3dof_pin.programs.loops import checked_program
from pm3dof_pin.programs.masses import Masses
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Objects

_NO_MASS = 1e-15
"""Motions of less mass than this, relative to that of all bodies times the unit of length squared, are massless."""


def _drive_motions(tree: Tree, doubt: Doubt) -> Objects:
    """Record the least motion of all joints, in scaled numbers, at unit rate of each actuated joint, shape=(nv, u).

    Raises:
        ProgramError: the tool can move with all actuators at rest, at the sample poses; or there is no tool.
    """
    robot = tree.mechanism
    unit, driven = robot.characteristic_length, robot.actuated_indices.tolist()
    motions = closed_motions(tree, driven, robot.passive_indices.tolist(), unit, doubt)
    slides, rates = tree.slides, motions.rates
    if motions.idle.size:
        if robot.tool_frame is None:
            raise ProgramError(f"{robot.name} can move with all actuators at rest")
        jacobian = tree.jacobian(robot.tool_frame)
        jacobian[:3] = jacobian[:3] * (1.0 / unit)
        jacobian[:, slides] = jacobian[:, slides] * unit
        for entry in product(jacobian, motions.idle).ravel():
            if np.nanmax(np.abs(samples(entry))) > DROPPED:
                raise ProgramError(f"the tool of {robot.name} can move with all actuators at rest")
            doubt.drop([entry])
        rates = projected(motions.idle.T, rates.T, doubt, restored=True).T
    if len(motions.relations):
        rates = projected(motions.relations, rates, doubt, restored=True)
    rates[slides] = rates[slides] * unit
    columns = [k for k, index in enumerate(driven) if index in slides]
    rates[:, columns] = rates[:, columns] * (1.0 / unit)
    return rates


def _holding(tree: Tree, model: pin.Model, doubt: Doubt) -> Objects:
    """Record the forces of the actuators that hold the weights, shape=(u,) [N, N m]."""
    return product(_drive_motions(tree, doubt).T, Masses(tree, model).weights[:, None])[:, 0]


def _motions(tree: Tree, model: pin.Model, doubt: Doubt) -> Objects:
    """Record the least joint velocities, then the tool's twist, at unit rate of each drive, shape=(nv + 6, u)."""
    del model
    motions = _drive_motions(tree, doubt)
    return np.vstack([motions, product(tree.jacobian(tree.mechanism.frame_name()), motions)])


def _inertia(tree: Tree, model: pin.Model, doubt: Doubt) -> Objects:
    """Record the mass matrix of the actuated joints, shape=(u, u) [kg, kg m, kg m^2]."""
    motions = _drive_motions(tree, doubt)
    return _symmetric(motions, product(Masses(tree, model).matrix, motions))


def _vibrations(roots: Roots, model: pin.Model) -> Objects:
    """Record Z'^T M Z' of :mod:`pm3dof_pin.dynamics.modes`, its lower triangle row by row [s^2]."""
    elastic, tree, root, doubt = roots.model, roots.tree, roots.springs, Doubt()
    unit = elastic.mechanism.length_unit
    driven, passive = elastic.spring_indices.tolist(), elastic.passive_indices.tolist()
    motions = closed_motions(tree, driven, passive, unit, doubt)
    strained = projected(product(motions.relations, root), product(motions.rates, root), doubt)
    moved = np.hstack([motions.idle, strained])
    moved[tree.slides] = moved[tree.slides] * unit
    inertia = _symmetric(moved, product(Masses(tree, model).matrix, moved))
    reference = sum(body.mass for body in model.inertias) * unit**2
    for k in range(motions.idle.shape[1]):  # free motions follow such that their momentum is zero
        pivot, row = inertia[k, k], inertia[k].copy()
        if np.nanmax(np.abs(samples(pivot))) <= _NO_MASS * reference:
            doubt.drop([sqrt(pivot * (1.0 / reference))])
            continue
        inverse = 1.0 / pivot
        for i in range(k + 1, len(inertia)):
            for j in range(i, len(inertia)):
                inertia[i, j] = inertia[j, i] = inertia[i, j] - row[i] * (row[j] * inverse)
    first = motions.idle.shape[1]
    return roots.noted(inertia[first:, first:][np.tril_indices(len(inertia) - first)], doubt)


def _symmetric(a: Objects, b: Objects) -> Objects:
    """Return A^T B, which is symmetric."""
    result = product(a.T, b)
    for i in range(len(result)):
        result[i, :i] = result[:i, i]
    return result


def holding_program(robot: Robot, poses: Matrix) -> Program:
    """Record the holding forces, for printing in other languages; masses are constants, geometry parameters.

    Outputs: `forces`, shape=(u,); and `pivot`, the least pivot, small near singular poses.

    Raises:
        ProgramError: there is no program.
    """
    graph, doubt = Graph(), Doubt()
    tree = Tree(graph, robot, poses)
    forces = _holding(tree, robot.model, doubt)
    return graph.program("holding", {"forces": forces, "pivot": doubt.pivot})


def vibrations(elastic: ElasticModel, model: pin.Model, q: Matrix, threads: int | None = None) -> tuple[Array, Mask]:
    """Evaluate the matrix whose eigenvalues are 1 / omega^2; other arguments and errors as in :func:`of_drives`.

    Returns lower triangles for `eigvalsh`, shape=(n, e, e) [s^2]; and where nothing is in doubt, shape=(n,).
    """
    program = elastic_program(
        elastic,
        elastic.mechanism.frame_name(),
        "vibrations",
        lambda roots: _vibrations(roots, model),
        structure=tuple(masses.mass_pattern(model)),
        numbers=masses.mass_numbers(model),
    )
    entries, sound = program.with_doubt(q, threads)
    size = math.isqrt(2 * entries.shape[1])
    matrices = np.zeros((len(q), size, size))
    matrices[:, *np.tril_indices(size)] = entries
    return matrices, sound


def of_drives(
    name: Literal["holding_forces", "mass_matrix", "drive_motions"],
    robot: Robot,
    model: pin.Model,
    q: Matrix,
    threads: int | None = None,
) -> tuple[Array, Mask]:
    """Evaluate the holding forces, the mass matrix at the actuated joints or their motions, flat, at q, shape=(n, nq).

    Also returns where nothing is in doubt, shape=(n,). `model` is the robot's tree, or a copy with payloads.

    Raises:
        ProgramError: there is no program for this robot.
    """

    def trace() -> Program:
        poses = samples_near_home(robot)
        verify(robot, poses)
        doubt, tree = Doubt(), Tree(Graph(), robot, poses)
        record = {"holding_forces": _holding, "mass_matrix": _inertia, "drive_motions": _motions}[name]
        return checked_program(name, tree, record(tree, model, doubt), doubt)

    own = (robot.actuated_indices.tolist(), robot.characteristic_length, masses.mass_pattern(model))
    if name == "drive_motions":
        own = (*own[:2], [robot.tool_frame or ""])
    key = repr((name, *own, geometry.structure(robot), geometry.pattern(robot)))
    compiled = cache.known(key, trace)
    parameters = geometry.values(robot, compiled.program.parameters, masses.mass_numbers(model))
    return compiled.with_doubt(q, parameters, threads)
