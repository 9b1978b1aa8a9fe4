"""Scaling of coordinates: the unit of each, and the period of those that are periodic."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Vector


def units_of(mechanism: Mechanism, coordinates: Iterable[Coordinate]) -> Vector:
    """Return the change of each coordinate as its joint, or the tool, moves by a characteristic length or a radian."""
    length = mechanism.characteristic_length
    return np.array([abs(c.scale) * (length if c.unit == "m" else 1.0) for c in coordinates])


def turns_of(mechanism: Mechanism, coordinates: Iterable[Coordinate]) -> Vector:
    """Return the periods of coordinates; infinite for those that are not periodic [rad]."""
    return np.array(
        [
            2.0 * np.pi * abs(c.scale)
            if (mechanism.single_joint(c.joint).is_continuous if c.joint is not None else c.tool in ("rx", "ry", "rz"))
            else np.inf
            for c in coordinates
        ]
    )
