"""The wrenches that loop closures exert on the bodies they join, and the directions in which they act."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closure_types import ClosureType
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Matrix, Vector

Vectors: TypeAlias = Any
"""Vectors in a sequence, each with its components first: numbers, recorded ones, or arrays."""


def held_directions(kind: ClosureType, a: Vectors, b: Vectors, toward: Any) -> tuple[Vectors, Vectors]:
    """Return the directions along and about which a closed closure holds frame b relative to frame a.

    Given are the axes x, y, z of both frames and, for a distance, the unit vector from the origin of frame a to that of
    frame b, all in the same axes as the result.
    """
    if kind.is_distance:
        return [toward], []
    if kind.rotations == (2,):
        (x, y, z), (p, q, r) = a[0], b[1]
        return [a[k] for k in kind.translations], [[y * r - z * q, z * p - x * r, x * q - y * p]]
    return [a[k] for k in kind.translations], [a[k] for k in kind.rotations]


def closure_wrenches(configuration: Configuration, forces: Vector) -> list[tuple[Vector, Vector]]:
    """Return the wrenches [f; m] of each closure on its bodies, at their frames' origins, in world axes [N, N m].

    The first is on the body of frame a, the second on that of frame b. `forces` are those in the rows of the constraint
    Jacobian, shape=(m,).
    """
    mechanism, wrenches = configuration.mechanism, []
    for index, rows in enumerate(mechanism.loop_kinematics.rows[: len(mechanism.closures)]):
        a, b = _ends(configuration, index)
        force, moment = _force_and_moment(mechanism.closures[index].kind, a, b, forces[rows])
        reaction = np.concatenate([-force, -moment - np.cross(b.translation - a.translation, force)])
        wrenches.append((reaction, np.concatenate([force, moment])))
    return wrenches


def turning_stiffness(configuration: Configuration, forces: Vector) -> Matrix:
    """Return the derivative of the closures' generalised forces by joint motions that turn their directions.

    Only of types that hold some components of a vector: the directions of these matter. Shape=(nv, nv).
    """
    mechanism = configuration.mechanism
    result = np.zeros((mechanism.model.nv, mechanism.model.nv))
    for index, rows in enumerate(mechanism.loop_kinematics.rows[: len(mechanism.closures)]):
        loop = mechanism.closures[index]
        if loop.kind.holds_vectors:
            continue
        a, b = _ends(configuration, index)
        force, moment = _force_and_moment(loop.kind, a, b, forces[rows])
        on_a, on_b = (configuration.frame_jacobian(name) for name in (loop.frame_a, loop.frame_b))
        between, apart = b.translation - a.translation, on_b[:3] - on_a[:3]
        if loop.kind.is_distance:
            length = np.linalg.norm(between)
            toward = between / length
            by_force = (forces[rows][0] / length) * (apart - np.outer(toward, toward @ apart))
        else:
            by_force = -pin.skew(force) @ on_a[3:]
        by_moment = -pin.skew(moment) @ on_a[3:]
        if loop.kind.rotations == (2,):
            x, y = a.rotation[:, 0], b.rotation[:, 1]
            by_moment = forces[rows][-1] * (np.outer(x, y @ on_a[3:]) - np.outer(y, x @ on_b[3:]))
        by_reaction = -by_moment - pin.skew(between) @ by_force + pin.skew(force) @ apart
        result += on_b[:3].T @ by_force + on_b[3:].T @ by_moment
        result += on_a[3:].T @ by_reaction - on_a[:3].T @ by_force
    return result


def _placed_axes(mechanism: Mechanism, index: int, a: pin.SE3, b: pin.SE3) -> tuple[pin.SE3, pin.SE3]:
    """Return placements of a closure's frames with the axes of its type."""
    if (bases := mechanism.closures[index].bases) is None:
        return a, b
    return a * pin.SE3(bases[0], np.zeros(3)), b * pin.SE3(bases[1], np.zeros(3))


def _ends(configuration: Configuration, index: int) -> tuple[pin.SE3, pin.SE3]:
    loop = configuration.mechanism.closures[index]
    a, b = (configuration.frame_placement(name) for name in (loop.frame_a, loop.frame_b))
    return _placed_axes(configuration.mechanism, index, a, b)


def _force_and_moment(kind: ClosureType, a: pin.SE3, b: pin.SE3, forces: Vector) -> tuple[Vector, Vector]:
    between = b.translation - a.translation
    toward = between / np.linalg.norm(between) if kind.is_distance else between
    linear, angular = held_directions(kind, a.rotation.T, b.rotation.T, toward)
    along, about = forces[: len(linear)], forces[len(linear) :]
    return np.array(linear).reshape(-1, 3).T @ along, np.array(angular).reshape(-1, 3).T @ about
