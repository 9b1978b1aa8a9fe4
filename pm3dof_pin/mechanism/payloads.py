"""Payloads: bodies fixed to frames."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.exceptions import InvalidValueError

if TYPE_CHECKING:
    from pm3dof_pin.mechanism.mechanism import Mechanism

Payloads: TypeAlias = "Mapping[str, float | pin.Inertia]"
"""By frame: a point mass at the frame's origin [kg], or an inertia in the axes of the frame."""


def add_payloads(model: pin.Model, mechanism: Mechanism, payloads: Payloads) -> None:
    """Fix payloads to the bodies of a model.

    Args:
        model: a copy of the mechanism's model; changed.
        mechanism: the mechanism.
        payloads: see :data:`Payloads`.

    Raises:
        FrameNotFoundError: the model has no such frame.
        InvalidValueError: a mass is negative or no finite number.
    """
    for name, payload in payloads.items():
        frame = model.frames[mechanism.frame_id(name)]
        model.appendBodyToJoint(frame.parentJoint, _inertia(name, payload), frame.placement)


def _inertia(frame: str, payload: float | pin.Inertia) -> pin.Inertia:
    mass = float(finite_array(f"payload on {frame}", getattr(payload, "mass", payload), ()))
    if mass < 0.0:
        raise InvalidValueError(f"payload on {frame}", mass, "a mass that is not negative [kg]")
    return payload if isinstance(payload, pin.Inertia) else pin.Inertia(mass, np.zeros(3), np.zeros((3, 3)))
