"""A single-DoF joint of a model: where its coordinate and rate stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.description.coordinates import Unit
from pm3dof_pin.typing import Array, Vector


@dataclass(frozen=True)
class SingleJoint:
    """A single-DoF joint, prismatic (`translates`) or revolute: the indices of its coordinate in q and rate in v.

    For a continuous joint, q has cosine and sine from that index on.
    """

    name: str
    q_index: int
    v_index: int
    is_continuous: bool
    translates: bool

    @property
    def unit(self) -> Unit:
        """Unit of its coordinate, "m" or "rad"."""
        return "m" if self.translates else "rad"

    def coordinate(self, q: Array) -> Array:
        """Return the joint's coordinate in q, shape=(..., nq) [m, rad]."""
        first = q[..., self.q_index]
        return np.asarray(np.arctan2(q[..., self.q_index + 1], first) if self.is_continuous else first)

    def set_coordinate(self, q: Vector, value: float) -> None:
        """Write the joint's coordinate into q [m, rad]."""
        if self.is_continuous:
            q[self.q_index : self.q_index + 2] = np.cos(value), np.sin(value)
        else:
            q[self.q_index] = value
