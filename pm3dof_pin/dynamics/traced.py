"""Holding forces, inertia and vibrations of a mechanism on recorded numbers, and their programs.

The least motions S per actuator rate, v = S du with the loops closed, give both the forces that hold the weights,
S^T tau_g, and the inertia at the actuators, S^T M S. Vibrations are those of :mod:`pm3dof_pin.dynamics.modes`, with
strains of unit energy as coordinates: eigenvalues of a symmetric matrix, computed by LAPACK.
"""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from pm3dof_pin.dynamics.beam_masses import beam_mass_numbers, traced_consistent_masses
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.traced import Roots, elastic_program
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.closing_programs import BoundProgram, quantity_program
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import masses
from pm3dof_pin.programs.closed_motions import all_motions, closed_motions
from pm3dof_pin.programs.elimination import (
    DROPPED,
    Doubt,
    eliminate,
    identity,
    product,
    projected,
    samples,
    solve_upper,
)
from pm3dof_pin.programs.graph import Graph, sqrt
from pm3dof_pin.programs.loops import checked_program
from pm3dof_pin.programs.masses import Masses
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Objects

_NO_MASS = 1e-15
"""Motions of less mass than this, relative to that of all bodies times the unit of length squared, are massless."""


class _DriveMotions(NamedTuple):
    """The least motion S = N B of all joints at unit rate of each drive; B is None where it is the identity."""

    motions: Objects  #: N, shape=(nv, m) [m, rad]
    shares: Objects | None  #: B, shape=(m, u)

    @property
    def matrix(self) -> Objects:
        """S, shape=(nv, u)."""
        return self.motions if self.shares is None else product(self.motions, self.shares)

    def felt(self, forces: Objects) -> Objects:
        """Return S^T f for forces of all joints, shape=(nv,)."""
        at_motions = product(self.motions.T, forces[:, None])
        return (at_motions if self.shares is None else product(self.shares.T, at_motions))[:, 0]

    def inertia(self, masses: Masses) -> Objects:
        """Return S^T M S."""
        at_motions = _symmetric(self.motions, masses.times(self.motions))
        return at_motions if self.shares is None else _symmetric(self.shares, product(at_motions, self.shares))


def _drive_motions(tree: Tree, robot: Robot, doubt: Doubt) -> _DriveMotions:
    """Record the least motions of all joints at unit rate of each actuated joint.

    Errors as :func:`_own_drive_motions`.
    """
    if len(robot.placing_drives) < len(robot.command_coordinates):
        attempt = Doubt()
        if (found := _shared_drive_motions(tree, attempt)) is not None:
            doubt.note_pivot(attempt.pivot)
            doubt.drop([attempt.dropped])
            return found
    return _DriveMotions(_own_drive_motions(tree, doubt), None)


def _shared_drive_motions(tree: Tree, doubt: Doubt) -> _DriveMotions | None:
    """Record the motions of more drives than degrees of freedom; None if joints can move with all drives at rest.

    With all motions N of the loops and their rates at the drives A = Q R, the least motions are N A^+ = N R^-1 Q^T:
    a number of operations linear in the drives, where relations among these would be eliminated in the third power.
    """
    robot = tree.mechanism
    unit, driven = robot.characteristic_length, robot.actuated_indices.tolist()
    motions = all_motions(tree, [*robot.passive_indices.tolist(), *driven], unit, doubt)
    rates = motions[driven]
    result = eliminate(rates, range(rates.shape[1]), doubt)
    if result.dropped:
        return None
    columns = list(result.columns)
    triangle = result.pivot_rows[:, columns]
    doubt.note_basis(triangle)
    lower = triangle.T[::-1, ::-1]  # of which the other triangle is empty, from the end
    across = solve_upper(lower, rates[:, columns].T[::-1])[::-1]
    shares = solve_upper(triangle, across)
    motions = motions[:, columns]
    motions[tree.slides] = motions[tree.slides] * unit
    sliding = [k for k, index in enumerate(driven) if index in tree.slides]
    shares[:, sliding] = shares[:, sliding] * (1.0 / unit)
    return _DriveMotions(motions, shares)


def _own_drive_motions(tree: Tree, doubt: Doubt) -> Objects:
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


def _holding(tree: Tree, robot: Robot, model: pin.Model, doubt: Doubt) -> Objects:
    """Record the forces of the actuators that hold the weights, shape=(u,) [N, N m]."""
    return _drive_motions(tree, robot, doubt).felt(Masses(tree, model).weights)


def _motions(tree: Tree, robot: Robot, model: pin.Model, doubt: Doubt) -> Objects:
    """Record the least joint velocities, then the tool's twist, at unit rate of each drive, shape=(nv + 6, u)."""
    del model
    motions = _drive_motions(tree, robot, doubt).matrix
    return np.vstack([motions, product(tree.jacobian(tree.mechanism.frame_name()), motions)])


def _inertia(tree: Tree, robot: Robot, model: pin.Model, doubt: Doubt) -> Objects:
    """Record the mass matrix of the actuated joints, shape=(u, u) [kg, kg m, kg m^2]."""
    return _drive_motions(tree, robot, doubt).inertia(Masses(tree, model))


def _vibrations(roots: Roots, model: pin.Model) -> Objects:
    """Record Z'^T M Z' of :mod:`pm3dof_pin.dynamics.modes`, its lower triangle row by row [s^2]."""
    doubt = Doubt()
    return roots.noted(_vibrating(roots, model, doubt)[0], doubt)


def _vibrating_tool(roots: Roots, model: pin.Model, frame: str) -> Objects:
    """Record the same, and in the motions Z' the twist of the tool and the strains in units of the springs.

    Raises:
        ProgramError: the tool can move with all springs at rest, at the sample poses.
    """
    doubt = Doubt()
    masses, idle, strained, whitened = _vibrating(roots, model, doubt)
    jacobian = roots.tree.jacobian(frame)
    for entry in product(jacobian, idle).ravel():
        if np.nanmax(np.abs(samples(entry))) > DROPPED:
            raise ProgramError(f"the tool of {roots.model.mechanism.name} can move with all springs at rest")
        doubt.drop([entry])
    twists = product(jacobian, strained)
    return roots.noted(np.concatenate([masses, twists.ravel(), whitened.ravel()]), doubt)


def _vibrating(roots: Roots, model: pin.Model, doubt: Doubt) -> tuple[Objects, Objects, Objects, Objects]:
    """Return the lower triangle of Z'^T M Z', the free motions N, the motions Z, and their whitened strains."""
    elastic, tree, root = roots.model, roots.tree, roots.springs
    unit = elastic.mechanism.length_unit
    driven, passive = elastic.spring_indices.tolist(), elastic.passive_indices.tolist()
    motions = closed_motions(tree, driven, passive, unit, doubt)
    relations = product(motions.relations, root)
    count = len(motions.rates)
    both = projected(relations, np.vstack([product(motions.rates, root), identity(len(root))]), doubt)
    strained, whitened = both[:count], both[count:]
    moved = np.hstack([motions.idle, strained])
    moved[tree.slides] = moved[tree.slides] * unit
    whole = Masses(tree, model).matrix + traced_consistent_masses(elastic, tree)
    inertia = _symmetric(moved, product(whole, moved))
    reference = sum(body.mass for body in model.inertias) * unit**2
    first = motions.idle.shape[1]
    for k in range(first):  # free motions follow such that their momentum is zero
        pivot, row = inertia[k, k], inertia[k].copy()
        if np.nanmax(np.abs(samples(pivot))) <= _NO_MASS * reference:
            doubt.drop([sqrt(pivot * (1.0 / reference))])
            continue
        inverse = 1.0 / pivot
        for i in range(k + 1, len(inertia)):
            for j in range(i, len(inertia)):
                inertia[i, j] = inertia[j, i] = inertia[i, j] - row[i] * (row[j] * inverse)
    triangle = inertia[first:, first:][np.tril_indices(len(inertia) - first)]
    return triangle, moved[:, :first], moved[:, first:], whitened


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
    tree = Tree(graph, robot, poses, in_working_axes=True)
    forces = _holding(tree, robot, robot.model, doubt)
    return graph.program("holding", {"forces": forces, "pivot": doubt.pivot})


def vibrations_program(elastic: ElasticModel, model: pin.Model) -> BoundProgram:
    """Return the program of the lower triangle of the matrix whose eigenvalues are 1 / omega^2, row by row [s^2].

    `model` is the mechanism's tree, or a copy with payloads. Errors as in :func:`of_drives`.
    """
    return elastic_program(
        elastic,
        elastic.mechanism.frame_name(),
        "vibrations",
        lambda roots: _vibrations(roots, model),
        **_mass_parameters(elastic, model),
    )


def vibrations(elastic: ElasticModel, model: pin.Model, q: Matrix, threads: int | None = None) -> tuple[Array, Mask]:
    """Evaluate the matrix whose eigenvalues are 1 / omega^2; other arguments and errors as in :func:`of_drives`.

    Returns lower triangles for `eigvalsh`, shape=(n, e, e) [s^2]; and where nothing is in doubt, shape=(n,).
    """
    entries, sound = vibrations_program(elastic, model).with_doubt(q, threads)
    return _triangles(entries, math.isqrt(2 * entries.shape[1])), sound


def vibrating_tools(
    elastic: ElasticModel, model: pin.Model, q: Matrix, threads: int | None = None
) -> tuple[tuple[Array, Array, Array], Mask]:
    """Evaluate what receptances of the tool need; arguments and errors as in :func:`vibrations`.

    Returns the same lower triangles, shape=(n, e, e) [s^2], and for the motions that they belong to, of strain energy
    1/2, the twist of the tool, shape=(n, 6, e), and the strains in units of the springs, shape=(n, s, e); and the mask.
    """
    frame = elastic.mechanism.frame_name()
    program = elastic_program(
        elastic,
        frame,
        "vibrating_tool",
        lambda roots: _vibrating_tool(roots, model, frame),
        **_mass_parameters(elastic, model),
    )
    entries, sound = program.with_doubt(q, threads)
    rows = 6 + len(elastic.spring_indices)
    # e (e + 1) / 2 + rows e entries
    size = round(math.sqrt((rows + 0.5) ** 2 + 2 * entries.shape[1]) - rows - 0.5)
    count = size * (size + 1) // 2
    parts = entries[:, count:].reshape(len(entries), rows, size)
    return (_triangles(entries[:, :count], size), parts[:, :6], parts[:, 6:]), sound


def _mass_parameters(elastic: ElasticModel, model: pin.Model) -> dict[str, Any]:
    """Return the arguments of `elastic_program` for programs with the masses of vibrations."""
    beams = beam_mass_numbers(elastic)
    structure = (*masses.mass_pattern(model), *beams)
    return {"structure": structure, "numbers": masses.mass_numbers(model) | beams}


def _triangles(entries: Matrix, size: int) -> Array:
    """Return lower triangular matrices of n rows of entries, shape=(n, size, size)."""
    matrices = np.zeros((len(entries), size, size))
    matrices[:, *np.tril_indices(size)] = entries
    return matrices


def drives_program(
    name: Literal["holding_forces", "mass_matrix", "drive_motions"], robot: Robot, model: pin.Model
) -> BoundProgram:
    """Return the program of a quantity of the drives at q; arguments and errors as in :func:`of_drives`."""

    def trace() -> Program:
        poses = samples_near_home(robot)
        verify(robot, poses)
        doubt, tree = Doubt(), Tree(Graph(), robot, poses, in_working_axes=True)
        record = {"holding_forces": _holding, "mass_matrix": _inertia, "drive_motions": _motions}[name]
        return checked_program(name, tree, record(tree, robot, model, doubt), doubt)

    own = (name, robot.actuated_indices.tolist(), robot.characteristic_length, robot.tool_frame)
    return quantity_program(robot, own, trace, model=None if name == "drive_motions" else model)


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
    return drives_program(name, robot, model).with_doubt(q, threads)
