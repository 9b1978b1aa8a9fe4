"""Mean cutting forces in milling, by the linear model of specific cutting pressures.

Y. Altintas, Manufacturing Automation, 2nd edition (2012), chapter 2: a tooth at the angle p cuts a chip of thickness
h = c sin p, with the feed per tooth c, and bears the tangential force K_t a h and the radial force K_r a h at a depth
of cut a. Averaged over a turn of a cutter with N teeth between entry and exit, with x along the feed, y to its left as
seen from the spindle, and the spindle turning clockwise (M3):

    F_x = N a c / (8 pi) [K_t cos 2p - K_r (2p - sin 2p)],   F_y = N a c / (8 pi) [K_t (2p - sin 2p) + K_r cos 2p].

Edge forces, axial forces of a helix and the variation within a turn are left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Matrix, Vector


@dataclass(frozen=True, kw_only=True)
class Milling:
    """A milling cut with constant immersion.

    Raises:
        InvalidValueError: a number is not positive, or the cut is wider than the cutter.
    """

    tangential: float  #: specific cutting pressure K_t [N/m^2]
    radial: float  #: specific cutting pressure K_r [N/m^2]
    depth: float  #: axial depth of cut [m]
    width: float  #: radial width of cut [m]
    diameter: float  #: of the cutter [m]
    rpm: float  #: speed of the spindle [1/min]
    teeth: float  #: number of teeth
    climb: float = 0.0  #: 1 for climb milling, the work to the right of the feed; 0 for conventional milling

    def __post_init__(self) -> None:
        """Check the numbers."""
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not (math.isfinite(value) and (value > 0.0 or entry.name == "climb")):
                raise InvalidValueError(f"{entry.name} of the milling cut", value, "a positive number")
        if self.width > self.diameter:
            raise InvalidValueError(
                "width of the milling cut", self.width, f"at most the diameter, {self.diameter:g} m"
            )

    def __call__(self, feed: Vector, direction: Matrix, spindle: Matrix) -> Matrix:
        """Return the mean forces on the tool.

        Args:
            feed: shape=(n,) [m/s].
            direction: of the feed, unit vectors, shape=(n, 3); zero for none.
            spindle: unit vectors from the tool point to the spindle, shape=(n, 3).

        Returns:
            Forces in the axes of the vectors, shape=(n, 3) [N]; zero for a feed along the spindle.
        """
        immersion = math.acos(1.0 - 2.0 * self.width / self.diameter)
        ends = (math.pi - immersion, math.pi) if self.climb else (0.0, immersion)
        cosine = math.cos(2.0 * ends[1]) - math.cos(2.0 * ends[0])
        turn = 2.0 * (ends[1] - ends[0]) - math.sin(2.0 * ends[1]) + math.sin(2.0 * ends[0])
        per_chip = self.teeth * self.depth / (8.0 * math.pi)
        along = per_chip * (self.tangential * cosine - self.radial * turn)
        left = per_chip * (self.tangential * turn + self.radial * cosine)
        flat = direction - np.einsum("ni,ni->n", direction, spindle)[:, None] * spindle
        chip = (feed / (self.teeth * self.rpm / 60.0))[:, None]
        return np.asarray(chip * (along * flat + left * np.cross(spindle, flat)))
