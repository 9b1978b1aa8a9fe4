"""A few closed poses around home, at which algorithms are watched while they are recorded as programs."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Matrix

_COUNT = 8
_SPREADS = (0.15, 0.05, 0.01)  # rad, or characteristic lengths; less where loops do not close from that far away
_TRIALS = 3  # for each pose wanted


def sample_poses(robot: Robot) -> Matrix:
    """Return closed configurations scattered about home, always the same ones, shape=(8, nq).

    Raises:
        ProgramError: the loops of the robot do not close near home.
    """
    generator = np.random.default_rng(0)
    home, found = robot.home.q, []
    for spread in _SPREADS:
        for _ in range(_TRIALS * _COUNT):
            tangent = spread * generator.uniform(-1.0, 1.0, robot.model.nv) * robot.velocity_scale
            moved = pin.integrate(robot.model, home, tangent)
            result = assemble(robot, moved)
            if result.converged:
                found.append(result.configuration.q)
            if len(found) == _COUNT:
                return np.array(found)
    raise ProgramError(f"{robot.name}: hardly any closed configuration found near home, expected {_COUNT}")
