"""The masses of a mechanism on recorded numbers: weights, and the mass matrix of the tree of bodies.

The ten numbers of every body with mass (mass, first moment and inertia in the axes of its joint) and gravity are
parameters, so that payloads need no new program; zeros are constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.programs.elimination import product, zeros
from pm3dof_pin.programs.graph import Scalar, is_zero
from pm3dof_pin.programs.joints import cross, objects
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.tolerances import LAST_DIGITS
from pm3dof_pin.typing import Objects

_ENTRIES = ("m", "h0", "h1", "h2", "I00", "I01", "I11", "I02", "I12", "I22")  # in Pinocchio's order
_ORIGIN = objects([0.0, 0.0, 0.0])
_PAIR = 11  # operations for an entry of the mass matrix
_BODY = 60  # operations for a body in each motion


def mass_numbers(model: pin.Model) -> dict[str, float]:
    """Return gravity, the masses and the inertia of rotors of a model by name."""
    found = {f"gravity/{k}": float(entry) for k, entry in enumerate(model.gravity.linear)}
    found |= {f"armature/{k}": float(entry) for k, entry in enumerate(model.armature)}
    for index in range(1, model.njoints):
        entries = zip(_ENTRIES, model.inertias[index].toDynamicParameters(), strict=True)
        found |= {f"mass/{model.names[index]}/{entry}": float(value) for entry, value in entries}
    return {name: value if abs(value) > LAST_DIGITS else 0.0 for name, value in found.items()}


def mass_content(model: pin.Model) -> bytes:
    """Return what :func:`mass_numbers` are read from, to tell whether they are the same."""
    bodies = (inertia.toDynamicParameters().tobytes() for inertia in model.inertias)
    return b"".join([model.gravity.vector.tobytes(), model.armature.tobytes(), *bodies])


def mass_pattern(model: pin.Model) -> list[str]:
    """Return which :func:`mass_numbers` are constants, being zero."""
    return [name for name, value in mass_numbers(model).items() if value == 0.0]


@dataclass(frozen=True, eq=False)
class _Body:
    """Mass, first moment and inertia about the world's origin, in its axes."""

    mass: Scalar
    moment: Objects
    inertia: Objects

    def __add__(self, other: _Body) -> _Body:
        return _Body(self.mass + other.mass, self.moment + other.moment, self.inertia + other.inertia)

    def momentum(self, twist: Objects) -> Objects:
        """Return momentum and angular momentum about the world's origin, at its twist [v; omega] there, shape=(6,)."""
        velocity, angular = twist[:3], twist[3:]
        linear = self.mass * velocity + cross(angular, self.moment)
        return np.concatenate([linear, self.inertia @ angular + cross(self.moment, velocity)])


class Masses:
    """The masses on a traced tree, from its model, or a copy with payloads."""

    def __init__(self, tree: Tree, model: pin.Model) -> None:
        self._tree = tree
        self._numbers: dict[str, Scalar] = {
            name: tree.graph.parameter(name, value) if value else 0.0 for name, value in mass_numbers(model).items()
        }
        self._bodies = [self._body(index) for index in range(model.njoints)]
        self._parents = list(model.parents)
        self._carried = self._bodies.copy()
        for index in reversed(range(1, model.njoints)):
            self._carried[model.parents[index]] += self._carried[index]
        above = [tree.carrying(index) for index in range(model.njoints)]
        self._joints = [  # each with its own entries of v, and with those of all that carry it
            (index, above[index][len(above[model.parents[index]]) :], above[index]) for index in range(1, model.njoints)
        ]
        #: twists [v; omega] of what each entry of v moves, about the world's origin
        self._twists = [np.concatenate([screw.velocity(_ORIGIN), screw.angular]) for screw in tree.screws]

    @property
    def weights(self) -> Objects:
        """Generalised forces that hold the tree of bodies against gravity, shape=(nv,) [N, N m]."""
        gravity = self._tree.turned_from_world(objects([self._numbers[f"gravity/{k}"] for k in range(3)]))
        forces: Objects = zeros(1, len(self._twists))[0]
        for joint, own, _ in self._joints:
            for k in own:
                forces[k] = -(gravity @ self._carried[joint].momentum(self._twists[k])[:3])
        return forces

    @property
    def matrix(self) -> Objects:
        """Mass matrix of the tree of bodies and of rotors, shape=(nv, nv) [kg, kg m, kg m^2]."""
        matrix = zeros(len(self._twists), len(self._twists))
        for joint, own, above in self._joints:
            for k in own:
                momentum = self._carried[joint].momentum(self._twists[k])
                for i in above:
                    matrix[i, k] = matrix[k, i] = self._twists[i] @ momentum
        for k in range(len(matrix)):
            matrix[k, k] = matrix[k, k] + self._numbers[f"armature/{k}"]
        return matrix

    def times(self, motions: Objects) -> Objects:
        """Return the mass matrix times motions of all joints, shape=(nv, m).

        Few motions of long chains take fewer operations body by body, as their number does not grow with the square of
        that of the joints.
        """
        pairs, count = sum(len(own) * len(above) for _, own, above in self._joints), motions.shape[1]
        moved = np.array([sum(not is_zero(entry) for entry in row) for row in motions])
        terms = sum(moved[k] + moved[i] for _, own, above in self._joints for k in own for i in above)
        if pairs * _PAIR + 2 * terms <= count * len(motions) * _BODY:
            return product(self.matrix, motions)
        result = zeros(*motions.shape)
        for c, rates in enumerate(motions.T):
            twists = [zeros(1, 6)[0]]
            for joint, own, _ in self._joints:
                twists.append(sum((self._twists[k] * rates[k] for k in own), twists[self._parents[joint]]))
            momenta = [body.momentum(twist) for body, twist in zip(self._bodies, twists, strict=True)]
            for joint, own, _ in reversed(self._joints):
                momenta[self._parents[joint]] = momenta[self._parents[joint]] + momenta[joint]
                for k in own:
                    result[k, c] = self._twists[k] @ momenta[joint] + self._numbers[f"armature/{k}"] * rates[k]
        return result

    def _body(self, index: int) -> _Body:
        if not index:
            return _Body(0.0, _ORIGIN, zeros(3, 3))
        name = self._tree.mechanism.model.names[index]
        own = [self._numbers[f"mass/{name}/{entry}"] for entry in _ENTRIES]
        if all(map(is_zero, own)):
            return _Body(0.0, _ORIGIN, zeros(3, 3))
        m, hx, hy, hz, xx, xy, yy, xz, yz, zz = own
        placement = self._tree.body(index)
        turned, place = placement.rotation @ objects([hx, hy, hz]), placement.translation
        inertia = placement.rotation @ objects([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ placement.rotation.T
        shift = turned + turned + m * place  # parallel axes: the moment about the joint counts twice
        return _Body(m, turned + m * place, inertia + _across(place, shift))


def _across(a: Objects, b: Objects) -> Objects:
    """Return a.b 1 - (a b^T + b a^T) / 2, shape=(3, 3)."""
    outer = np.outer(a, b)
    matrix: Objects = np.diag([a @ b] * 3) - 0.5 * (outer + outer.T)
    return matrix
