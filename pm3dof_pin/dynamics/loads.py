"""What acts on a mechanism beside its own weight: payloads fixed to frames, and dead wrenches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.payloads import Payloads, add_payloads
from pm3dof_pin.typing import Vector

Wrenches: TypeAlias = Mapping[str, ArrayLike]
"""Wrenches [f; m] on frames, at their origins, world axes, shape=(6,) [N, N m]."""


def model_with_payloads(mechanism: Mechanism, payloads: Payloads | None) -> pin.Model:
    """Return the mechanism's tree with payloads fixed to it; the mechanism's own model if there are none.

    Args:
        mechanism: the mechanism; stays as it is.
        payloads: see :data:`~pm3dof_pin.mechanism.payloads.Payloads`.

    Raises:
        FrameNotFoundError: the model has no such frame.
        InvalidValueError: a mass is negative or no finite number.
    """
    if not payloads:
        return mechanism.model
    model = mechanism.model.copy()
    add_payloads(model, mechanism, payloads)
    return model


def generalised_forces(configuration: Configuration, wrenches: Wrenches | None) -> Vector:
    """Return the generalised forces of wrenches on frames, the sum of J^T w, shape=(nv,) [N, N m].

    Args:
        configuration: where the frames are.
        wrenches: see :data:`Wrenches`.

    Raises:
        FrameNotFoundError: the model has no such frame.
        InvalidValueError: a wrench is not finite or not of shape (6,).
    """
    forces = np.zeros(configuration.mechanism.model.nv)
    for name, wrench in (wrenches or {}).items():
        forces += configuration.frame_jacobian(name).T @ finite_array(f"wrench on {name}", wrench, (6,))
    return forces
