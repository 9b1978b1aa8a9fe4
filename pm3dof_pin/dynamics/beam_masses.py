"""Consistent masses of beams: each point of a beam moves as its bending line does, not with one of its ends.

The tree of bodies has a beam's mass in the body at its clamp and in lumps at the ends of its elements
(:mod:`pm3dof_pin.elastic.virtual_joints`). What is missing from the mass matrix of vibrations is

    T^T m T - (the same of the beam as a rigid part of that body) - (the lumps' share).

T maps velocities to the twist that an element would have at its end if it were rigid, and to its deflections; m is the
integral of the shape functions' products along the element: the cubics of bending, straight lines for shear, torsion
and elongation, with the rotary inertia of a round section (J. Przemieniecki, Theory of Matrix Structural Analysis,
1968, chapter 11). The total mass and the motions of the unstrained machine stay as described.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pm3dof_pin.arrays import frozen
from pm3dof_pin.dynamics.mass_matrix import mass_matrix
from pm3dof_pin.elastic.elastic_model import ElasticModel, SpringBlock
from pm3dof_pin.elastic.springs import CantileverSpring, JointLength
from pm3dof_pin.elastic.virtual_joints import lumps
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.loads import Payloads
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.programs.elimination import product, zeros
from pm3dof_pin.programs.graph import Scalar
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Indices, Matrix, Objects

_POINTS, _WEIGHTS = (0.5 * part for part in np.polynomial.legendre.leggauss(4))  # exact for the cubics' squares


@dataclass(frozen=True, eq=False)
class _Beam:
    """A beam with consistent mass; of one of its elements where a mass or length is asked for."""

    spring: CantileverSpring
    block: SpringBlock

    @property
    def elements(self) -> Iterator[tuple[Indices, tuple[float, float]]]:
        """The entries of v of each element's virtual joints, from the clamp, and its part of the lumps."""
        return zip(np.split(self.block.indices, self.spring.elements), lumps(self.spring), strict=True)

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return self.spring.mass / self.spring.elements

    @property
    def section(self) -> float:
        """Mass times the squared radius of gyration of the section about a diameter [kg m^2]."""
        return self.mass * self.spring.squared_gyration_radius

    @property
    def length(self) -> float:
        """Length, at the zero of a joint that changes it [m]."""
        length = self.spring.length
        return length.at_zero if isinstance(length, JointLength) else length / self.spring.elements


def vibrating_mass(model: ElasticModel, configuration: Configuration, *, payloads: Payloads | None = None) -> Matrix:
    """Compute the mass matrix of vibrations at a configuration of the model's `mechanism`, loops open, shape=(nv, nv).

    Payloads and errors as in :func:`~pm3dof_pin.dynamics.mass_matrix.mass_matrix`.
    """
    return frozen(mass_matrix(configuration, payloads=payloads) + consistent_masses(model, configuration)[0])


def beam_mass_numbers(model: ElasticModel) -> dict[str, float]:
    """Return the parameters of :func:`traced_consistent_masses` by name."""
    return {
        f"beam/{beam.spring.name}/{part}": value
        for beam in _beams(model)
        for part, value in (("mass", beam.mass), ("section", beam.section), ("length", beam.length))
    }


def consistent_masses(model: ElasticModel, configuration: Configuration) -> tuple[Matrix, Matrix]:
    """Return what the tree lacks at a configuration of its `mechanism`, of its mass matrix and of its momentum.

    Shape=(nv, nv), and per velocity along the axes of the base, shape=(3, nv) [kg, kg m, kg m^2].
    """
    tree = model.mechanism.model
    total, data = np.zeros((tree.nv + 3, tree.nv + 3)), scratch_data(tree)  # the base moves along, too
    pin.computeJointJacobians(tree, data, np.array(configuration.q))
    for beam in _beams(model):
        length = beam.length if beam.block.length is None else model.length(beam.block, configuration)
        parts = [
            length**power * (beam.mass * lines + beam.section * turns)
            for power, lines, turns in _integrals(beam.spring.components)
        ]
        inertia = np.sum(parts, axis=0)
        for indices, (lump, moment) in beam.elements:
            lumped = lump * beam.mass, moment * beam.mass * length**2
            joint = _joint_of(model, indices[-1])
            with_base = np.vstack([data.oMi[joint].rotation.T, np.zeros((3, 3))])
            at_end = np.hstack([pin.getJointJacobian(tree, data, joint, pin.LOCAL), with_base])
            total += _missing(at_end, indices, beam.block.indices, inertia, lumped, np.matmul)
    return total[: tree.nv, : tree.nv], total[tree.nv :, : tree.nv]


def traced_consistent_masses(model: ElasticModel, tree: Tree) -> Objects:
    """Record the first part of :func:`consistent_masses`."""
    total, values = zeros(len(tree.screws), len(tree.screws)), beam_mass_numbers(model)
    for beam in _beams(model):
        name = beam.spring.name
        mass, section, length = (
            tree.graph.parameter(key, values[key])
            for key in (f"beam/{name}/{part}" for part in ("mass", "section", "length"))
        )
        if beam.block.length is not None:
            length = length + tree.q[model.mechanism.single_joint(beam.block.length.joint).q_index]
        powers: dict[int, Scalar] = {
            -2: 1.0 / (length * length),
            -1: 1.0 / length,
            0: 1.0,
            1: length,
            2: length * length,
        }
        size = 6 + len(beam.spring.components)
        inertia = zeros(size, size)
        for power, lines, turns in _integrals(beam.spring.components):
            for factor, numbers in ((mass, lines), (section, turns)):
                for i, j in zip(*np.nonzero(numbers), strict=True):
                    inertia[i, j] = inertia[i, j] + float(numbers[i, j]) * (factor * powers[power])
        for indices, (lump, moment) in beam.elements:
            lumped = lump * mass, moment * mass * powers[2]
            at_end = tree.local_jacobian(_joint_of(model, indices[-1]))
            total = total + _missing(at_end, indices, beam.block.indices, inertia, lumped, product)
    return total


def _beams(model: ElasticModel) -> Iterator[_Beam]:
    for spring, block in zip(model.springs, model.blocks, strict=True):
        if isinstance(spring, CantileverSpring) and spring.mass > 0.0 and spring.mass_model == "consistent":
            yield _Beam(spring, block)


def _joint_of(model: ElasticModel, index: int) -> int:
    """Return the joint of an entry of v."""
    return list(model.mechanism.model.idx_vs).index(index, 1)


def _missing(
    at_end: NDArray[Any],
    indices: Indices,
    of_beam: Indices,
    inertia: NDArray[Any],
    lumped: tuple[Scalar, Scalar],
    times: Callable[[NDArray[Any], NDArray[Any]], NDArray[Any]],
) -> NDArray[Any]:
    """Return T^T m T less the rigid part and the lump, from the Jacobian of the element's end in its own axes."""
    rigid, clamp = at_end.copy(), at_end.copy()
    rigid[:, indices] = 0.0
    clamp[:, of_beam] = 0.0
    chosen = np.zeros((len(indices), at_end.shape[1]), dtype=at_end.dtype)
    chosen[range(len(indices)), indices] = 1.0
    moved = np.vstack([rigid, chosen])
    whole = times(moved.T, times(inertia, moved)) - times(clamp.T, times(inertia[:6, :6], clamp))
    (mass, moment), across = lumped, clamp[3:5]
    moved_lump = times(at_end[:3].T, at_end[:3]) - times(clamp[:3].T, clamp[:3])
    return np.asarray(whole - mass * moved_lump - moment * times(across.T, across))


def _integrals(components: tuple[str, ...]) -> Iterator[tuple[int, Matrix, Matrix]]:
    """Return the integrals of products of velocities, and of turns, over an element of length and mass 1, by power.

    Over the twist of the rigid element at its end and its deflections; they are the coefficients of powers of the
    length. Turns count for the moments of a round section, twice about its axis.
    """
    lines = {power: np.zeros((6 + len(components), 6 + len(components))) for power in range(-2, 3)}
    turns = {power: np.zeros_like(lines[0]) for power in lines}
    weights = np.array([1.0, 1.0, 2.0])
    for point, weight in zip(_POINTS + 0.5, _WEIGHTS, strict=True):
        shapes = _shapes(components, float(point))
        for first, a in shapes.items():
            for second, b in shapes.items():
                lines[first + second] += weight * a[:3].T @ b[:3]
                turns[first + second] += weight * (a[3:].T * weights) @ b[3:]
    for power in lines:
        yield power, lines[power], turns[power]


def _shapes(components: tuple[str, ...], part: float) -> dict[int, Matrix]:
    """Return the twist at a part of the way from the clamp, by the end's and deflections, by power of the length."""
    size = 6 + len(components)
    shapes = {power: np.zeros((6, size)) for power in (-1, 0, 1)}
    shapes[0][:, :6] = np.eye(6)
    shapes[1][0, 4], shapes[1][1, 3] = part - 1.0, 1.0 - part
    bent, tilt = part**2 * (3.0 - 2.0 * part), part**2 * (part - 1.0)
    steep, turn = 6.0 * part * (1.0 - part), part * (3.0 * part - 2.0)
    entries = {
        "x": ((0, 0, bent), (-1, 4, steep)),
        "y": ((0, 1, bent), (-1, 3, -steep)),
        "z": ((0, 2, part),),
        "rx": ((1, 1, -tilt), (0, 3, turn)),
        "ry": ((1, 0, tilt), (0, 4, turn)),
        "rz": ((0, 5, part),),
        "shear_x": ((0, 0, part),),
        "shear_y": ((0, 1, part),),
    }
    for column, component in enumerate(components, start=6):
        for power, row, value in entries[component]:
            shapes[power][row, column] = value
    return shapes
