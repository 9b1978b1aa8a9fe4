"""Closed configurations near home, at which programs choose their eliminations."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pm3dof_pin.exceptions import ConvergenceError, ProgramError
from pm3dof_pin.kinematics.assembly import CLOSURE_TOLERANCE, assemble
from pm3dof_pin.typing import Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

_COUNT = 8
_DISTANCE = 0.1  # from home [rad, characteristic lengths]
_TRIALS = 10


def samples_near_home(robot: Robot) -> Matrix:
    """Find closed configurations near home, home itself first. Home alone would mislead if it is singular.

    Deterministic, shape=(9, nq), or (8, nq) if the loops are not closed at home.

    Raises:
        ProgramError: the loops do not close near home.
    """
    home, model, generator = robot.home.q, robot.model, np.random.default_rng(0)
    first = [home] if robot.home.closure_residual <= CLOSURE_TOLERANCE else []
    rows: list[Vector] = []
    distance = _DISTANCE
    for _ in range(_TRIALS):
        for _ in range(_COUNT):
            tangent = robot.velocity_scale * generator.uniform(-distance, distance, model.nv)
            result = assemble(robot, pin.integrate(model, home, tangent))
            if result.converged:
                rows.append(result.q)
            if len(rows) == _COUNT:
                return np.array([*first, *rows])
        distance /= 2.0
    error = ConvergenceError(f"{robot.name}: closing the loops near home", result.residual, "m or rad", result.steps)
    raise ProgramError(str(error))
