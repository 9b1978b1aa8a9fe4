"""Loads on a mechanism other than its own weight: payloads fixed to frames, and dead wrenches."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Vector

if TYPE_CHECKING:
    from pm3dof_pin.mechanism.configuration import Configuration
    from pm3dof_pin.mechanism.mechanism import Mechanism

Payloads: TypeAlias = "Mapping[str, float | pin.Inertia]"
"""By frame: a point mass at its origin [kg], or an inertia in its axes."""

Wrenches: TypeAlias = Mapping[str, ArrayLike]
"""Wrenches [f; m] on frames, at their origins, world axes, shape=(6,) [N, N m]."""


def add_payloads(model: pin.Model, mechanism: Mechanism, payloads: Payloads) -> None:
    """Add :data:`Payloads` to the bodies of `model`, a copy of the mechanism's model.

    Raises:
        FrameNotFoundError: the model has no such frame.
        InvalidValueError: a mass is negative or not finite.
    """
    for name, payload in payloads.items():
        frame = model.frames[mechanism.frame_id(name)]
        model.appendBodyToJoint(frame.parentJoint, _inertia(name, payload), frame.placement)


def model_with_payloads(mechanism: Mechanism, payloads: Payloads | None) -> pin.Model:
    """Return a mechanism's model with payloads, see :func:`add_payloads`; the model itself if there are none."""
    if not payloads:
        return mechanism.model
    model = mechanism.model.copy()
    add_payloads(model, mechanism, payloads)
    return model


def generalised_forces(configuration: Configuration, wrenches: Wrenches | None) -> Vector:
    """Return the generalised forces of :data:`Wrenches`: the sum of J^T w, shape=(nv,) [N, N m].

    Raises:
        FrameNotFoundError: the model has no such frame.
        InvalidValueError: a wrench is not finite or not of shape (6,).
    """
    forces = np.zeros(configuration.mechanism.model.nv)
    for name, wrench in (wrenches or {}).items():
        forces += configuration.frame_jacobian(name).T @ finite_array(f"wrench on {name}", wrench, (6,))
    return forces


def weight_scale(model: pin.Model, length: float) -> float:
    """Return the weight of all moving bodies times a length [N m]."""
    mass = sum(inertia.mass for inertia in list(model.inertias)[1:])
    return float(mass * np.linalg.norm(model.gravity.linear) * length)


def _inertia(frame: str, payload: float | pin.Inertia) -> pin.Inertia:
    mass = float(finite_array(f"payload on {frame}", getattr(payload, "mass", payload), ()))
    if mass < 0.0:
        raise InvalidValueError(f"payload on {frame}", mass, "a nonnegative mass [kg]")
    return payload if isinstance(payload, pin.Inertia) else pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
