"""How far wrenches move the tool at many poses, spring by spring, and what stiffer springs change of it.

Small deflections: dx = C w with C the sum of what the springs add, C = sum_j C_j. Scaling all of spring j by a factor
k_j changes C by dC / d ln k_j = -C_j, whether the mechanism is statically determinate or not.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.elastic.batch import elastic_model, evaluate
from pm3dof_pin.elastic.quantities import compliance_by_spring
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Engine

_PROGRAM_FROM = 100  # poses
_STIFFNESSES = ("stiffness", "bending_stiffness", "torsional_stiffness", "axial_stiffness", "matrix")


def spring_deflections(poses: Poses, wrenches: Array, *, engine: Engine | None = None) -> Array:
    """Return how far each spring lets wrenches move the tool at n poses, shape=(n, springs, 6) [m, rad].

    Their sum over the springs is the tool's displacement, minus each of them its derivative by the logarithm of that
    spring's stiffness. Wrenches are at the tool's point, world axes, shape=(n, 6) [N, N m].

    Raises:
        DescriptionError: the robot has no springs, or no tool frame.
        FreeDirectionError: the tool can move with all springs at rest.
        InvalidValueError: wrenches of another shape or not finite, or a pose that is not solved.
    """
    checked = finite_array("wrenches", wrenches, (len(poses), 6))
    model = elastic_model(poses.robot)
    chosen: Engine = engine or ("program" if len(poses) >= _PROGRAM_FROM else "pinocchio")
    parts = evaluate(model, poses, compliance_by_spring(model), engine=chosen).values
    return np.asarray(np.einsum("nsij,nj->nsi", parts, checked))


def stiffened(robot: Robot, factors: Mapping[str, float]) -> Robot:
    """Return a robot with all stiffness of some springs, by name, multiplied by factors.

    Raises:
        InvalidValueError: there is no spring of a name, or a factor is not positive.
    """
    names = [str(entry.get("name")) for entry in robot.springs]
    for name, factor in factors.items():
        if name not in names:
            raise InvalidValueError("spring", name, f"one of {', '.join(names)}")
        if not (np.isfinite(factor) and factor > 0.0):
            raise InvalidValueError(f"stiffness factor of {name}", factor, "a positive number")
    return robot.replace(springs=stiffened_entries(robot.springs, factors))


def stiffened_entries(springs: Iterable[Mapping[str, Any]], factors: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the entries of springs, as in a closures file, with those named stiffer by factors."""
    return [
        {
            key: (factor * np.asarray(value, dtype=float)).tolist() if key in _STIFFNESSES else value
            for key, value in entry.items()
        }
        for entry, factor in ((entry, factors.get(str(entry.get("name")), 1.0)) for entry in springs)
    ]
