"""Instruments: what they measure of a pose, and with what noise."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array

Measured = Literal["pose", "position"]

TARGET_SIGMA = 15e-6
"""Noise of each coordinate of a laser tracker's target [m]."""
ENCODER_ZERO = {"m": 5e-3, "rad": 5e-2}
"""Prior standard deviation of an encoder's zero, by the unit of its joint [m, rad]."""
TARGET_COUNT = 4
TARGET_RADIUS = 0.15
"""Distance of the targets from the tool point [m]."""


@dataclass(frozen=True)
class Instrument:
    """What is measured of a pose, and its noise; by default as for :meth:`with_targets`."""

    measured: Measured = "pose"  #: "pose", or "position" for the tool point alone
    position_sigma: float = TARGET_SIGMA / 2.0  #: noise of each coordinate [m]
    #: noise about each axis [rad]; irrelevant for positions
    angle_sigma: float = TARGET_SIGMA / (TARGET_RADIUS * np.sqrt(2.0))
    own_frame: bool = False  #: whether it measures in its own, initially unknown frame
    #: targets seen one by one instead of the tool point, in tool axes [m]
    targets: tuple[tuple[float, float, float], ...] = ()
    target_sigma: float = 0.0  #: prior standard deviation of the targets' coordinates [m]; 0 if known exactly
    encoders: tuple[str, ...] = ()  #: passive joints whose encoders are read at each pose, with the noise above
    tilts_only: bool = False  #: whether of a pose only the turns about x and y are seen, as by a level
    #: points, of unknown place by default, from which the distances of the targets are measured, base axes [m]
    centres: tuple[tuple[float, float, float], ...] = ()
    known_centres: bool = False  #: whether these points were measured beforehand, and are known exactly
    length: float | None = None  #: the only distance that can be measured, of a ballbar [m]
    datum: str = ""  #: "plane", "line", "socket" or "camera" of unknown placement that the targets are measured against
    datum_place: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: about where it is, base axes [m]
    datum_axes: tuple[tuple[float, float, float], ...] = ()  #: about its axes, as rows, base axes
    touches: bool = False  #: whether the first target must touch the datum

    def __post_init__(self) -> None:
        """Check the noise."""
        for name, sigma in (("position_sigma", self.position_sigma), ("angle_sigma", self.angle_sigma)):
            if not (np.isfinite(sigma) and sigma > 0.0):
                raise InvalidValueError(name, sigma, "a positive number")

    @classmethod
    def with_targets(
        cls, sigma: float = TARGET_SIGMA, count: int = TARGET_COUNT, radius: float = TARGET_RADIUS
    ) -> Instrument:
        """Return a tracker with noise `sigma` [m] that sees targets evenly spaced on a circle around the tool point.

        The centre of n targets is known n^(1/2) times better than one target, orientation about an axis in the plane
        of the circle to sigma / (radius (n / 2)^(1/2)); about its normal it is even better, which is not used.

        Raises:
            InvalidValueError: fewer than 3 targets, or a size or noise that is not positive.
        """
        if not (np.isfinite(sigma) and sigma > 0.0):
            raise InvalidValueError("noise of a target", sigma, "a positive number of metres")
        if count < 3 or not radius > 0.0:
            raise InvalidValueError(
                "targets", problem=f"are {count} at {radius} m", expected="at least 3 at a positive radius"
            )
        return cls("pose", sigma / np.sqrt(count), sigma / (radius * np.sqrt(count / 2.0)))

    @property
    def sigmas(self) -> Array:
        """Noise of each measured coordinate of a pose, shape=(6,), or (3,) for positions [m, rad]."""
        full = np.repeat([self.position_sigma, self.angle_sigma], 3)
        if self.tilts_only:
            full[[0, 1, 2, 5]] = np.inf
        return full if self.measured == "pose" else full[:3]

    @property
    def covariance(self) -> Array:
        """Covariance of a measured pose [translation; rotation vector], shape=(6, 6) [m^2, rad^2]."""
        return np.diag(np.repeat([self.position_sigma, self.angle_sigma], 3) ** 2)
