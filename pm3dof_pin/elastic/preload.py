"""Preload: internal forces of more drives than degrees of freedom, which balance each other and stiffen the machine."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE, DegreesOfFreedom
from pm3dof_pin.mechanism.configuration import Configuration

_BALANCED = 1e-9  # remaining power of the drives on any motion, relative to that of the given forces


def preload(model: ElasticModel, configuration: Configuration, forces: Mapping[str, float]) -> Loads:
    """Return the drives' forces that balance each other: some as given, the others the least that do.

    On every motion that keeps the loops closed their power is zero, so that nothing moves; but they stress the machine,
    and the stress turns with its links. :func:`~pm3dof_pin.elastic.loaded.loaded_equilibrium` under these loads has the
    tangent stiffness of the preloaded machine, geometric stiffness included. Least in newtons,
    moments divided by the characteristic length.

    Args:
        model: the elastic mechanism; drives that carry preload have springs.
        configuration: assembled configuration of the rigid mechanism.
        forces: forces [N] or torques [N m] of some drives by joint, positive along the joint's coordinate.

    Raises:
        InvalidValueError: the forces are not finite, one is of a joint that is not actuated or of a drive without a
            spring, or the other drives cannot balance them, as where none is redundant; or the loops are open.
    """
    robot, dof = model.rigid, DegreesOfFreedom(configuration)
    drives = list(robot.actuated_joints)
    for name in forces:
        if name not in drives:
            raise InvalidValueError("preload", name, f"an actuated joint of {robot.name}: {', '.join(drives)}")
    given = np.array([name in forces for name in drives], dtype=bool)
    scale = dof.scale[robot.actuated_indices]
    scaled = np.zeros(len(drives))
    scaled[given] = finite_array("preload", [forces[name] for name in drives if name in forces], (len(forces),))
    scaled *= scale
    rates = dof.actuators @ dof.basis
    wanted = -rates[given].T @ scaled[given]
    scaled[~given] = np.linalg.lstsq(rates[~given].T, wanted, rcond=RANK_TOLERANCE)[0]
    if np.abs(rates.T @ scaled).max(initial=0.0) > _BALANCED * np.abs(scaled[given]).max(initial=0.0):
        told = ", ".join(f"{name}={force:g}" for name, force in forces.items())
        rank = int(np.linalg.matrix_rank(rates, tol=RANK_TOLERANCE))
        expected = f"forces that the other drives balance: {len(drives)} drives move {rank} degrees of freedom"
        raise InvalidValueError("preload", told, expected)
    found: dict[str, float] = dict(zip(drives, (scaled / scale).tolist(), strict=True))
    locked = set(model.locked_indices.tolist())
    for name in drives:
        if found[name] and model.mechanism.single_joint(name).v_index in locked:
            raise InvalidValueError("preload", name, "a drive with a spring (--drive-stiffness)")
    return Loads(efforts=found)
