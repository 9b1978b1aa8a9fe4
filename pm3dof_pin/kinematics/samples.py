"""Closed configurations near home, at which programs choose what they eliminate."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.kinematics.assembly import CLOSURE_TOLERANCE, assemble
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Matrix, Vector

_COUNT = 8
_DISTANCE = 0.1  # from home [rad, characteristic lengths]
_TRIALS = 10


def samples_near(mechanism: Mechanism, home: Vector) -> Matrix:
    """Find closed configurations near home, home itself first. Home alone would mislead where it is singular.

    The same ones every time, shape=(9, nq), or (8, nq) if the loops are not closed at home.

    Raises:
        ConvergenceError: the loops do not close there.
    """
    model, generator = mechanism.model, np.random.default_rng(0)
    first = [home] if np.abs(mechanism.loop_kinematics.closures(home)[0]).max(initial=0.0) <= CLOSURE_TOLERANCE else []
    rows: list[Vector] = []
    distance = _DISTANCE
    for _ in range(_TRIALS):
        for _ in range(_COUNT):
            tangent = mechanism.velocity_scale * generator.uniform(-distance, distance, model.nv)
            result = assemble(mechanism, pin.integrate(model, home, tangent))
            if result.converged:
                rows.append(result.q)
            if len(rows) == _COUNT:
                return np.array([*first, *rows])
        distance /= 2.0
    raise ConvergenceError(f"{mechanism.name}: closing the loops near home", result.residual, "m or rad", result.steps)
