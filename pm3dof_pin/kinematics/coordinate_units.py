"""How far coordinates are apart: what counts as one of each, and which come back to where they were."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Vector


def units_of(mechanism: Mechanism, coordinates: Iterable[Coordinate]) -> Vector:
    """Return by how much coordinates change as a joint, or the tool, moves by a characteristic length or a radian."""
    length = mechanism.characteristic_length
    return np.array([abs(c.scale) * (length if c.unit == "m" else 1.0) for c in coordinates])


def turns_of(mechanism: Mechanism, coordinates: Iterable[Coordinate]) -> Vector:
    """Return after how much coordinates are where they were; infinite for those that are not [rad]."""
    return np.array(
        [
            2.0 * np.pi * abs(c.scale)
            if (mechanism.single_joint(c.joint).is_continuous if c.joint is not None else c.tool in ("rx", "ry", "rz"))
            else np.inf
            for c in coordinates
        ]
    )
