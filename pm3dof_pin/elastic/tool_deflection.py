"""Tool deflection under wrenches at many poses, spring by spring, and the effect of stiffer springs.

For small deflections dx = C w, where C is the sum of the springs' contributions, C = sum_j C_j. Scaling spring j by a
factor k_j changes C by dC / d ln k_j = -C_j, whether or not the mechanism is statically determinate.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.elastic.batch import elastic_model, evaluate
from pm3dof_pin.elastic.quantities import compliance_by_spring
from pm3dof_pin.elastic.springs import RIGID, with_contact
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Engine

_STIFFNESSES = (
    *("stiffness", "bending_stiffness", "torsional_stiffness", "axial_stiffness", "shear_stiffness", "matrix"),
)


def spring_deflections(poses: Poses, wrenches: Array) -> Array:
    """Return the tool deflection under wrenches due to each spring at n poses, shape=(n, springs, 6) [m, rad].

    The sum over the springs is the tool's displacement; the derivative of the displacement by the logarithm of a
    spring's stiffness is minus its part. Wrenches are at the tool point, world axes, shape=(n, 6) [N, N m].

    Raises:
        DescriptionError: the robot has no springs, or no tool frame.
        FreeDirectionError: the tool can move with all springs at rest.
        InvalidValueError: wrenches have the wrong shape or are not finite, or a pose is unsolved.
    """
    checked = finite_array("wrenches", wrenches, (len(poses), 6))
    model = elastic_model(poses.robot)
    engine: Engine = poses.robot.engine if len(poses) >= PROGRAM_FROM else "pinocchio"
    parts = evaluate(model, poses, compliance_by_spring(model), engine=engine).values
    return np.asarray(np.einsum("nsij,nj->nsi", parts, checked))


def stiffened(robot: Robot, factors: Mapping[str, float]) -> Robot:
    """Return a robot with the stiffness of springs multiplied by factors, by name.

    Raises:
        InvalidValueError: there is no spring of this name, or a factor is not positive.
    """
    names = [str(entry.get("name")) for entry in robot.springs]
    for name, factor in factors.items():
        if name not in names:
            raise InvalidValueError("spring", name, f"one of {', '.join(names)}")
        if not (np.isfinite(factor) and factor > 0.0):
            raise InvalidValueError(f"stiffness factor of {name}", factor, "a positive number")
    return robot.replace(springs=stiffened_entries(robot.springs, factors, robot.source))


def stiffened_entries(
    springs: Iterable[Mapping[str, Any]], factors: Mapping[str, float], source: Path | str
) -> list[dict[str, Any]]:
    """Return entries of springs, as in a closures file, with the stiffness of those named multiplied by factors.

    Those that name a contact of the catalogue get its numbers. Messages are about the `source`.

    Raises:
        DescriptionError: an entry names no contact of the catalogue.
    """
    found = []
    for entry in springs:
        own, name = dict(entry), str(entry.get("name"))
        if name in factors:
            own = with_contact(entry, source, f"spring '{name}'")
            own |= {
                key: (factors[name] * np.asarray(value, dtype=float)).tolist()
                for key, value in own.items()
                if key in _STIFFNESSES and value != RIGID
            }
        found.append(own)
    return found
