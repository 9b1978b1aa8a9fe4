"""Instruments: what they measure of a pose, and with what noise."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.measuring.datum import Datum, DatumKind
from pm3dof_pin.typing import Array

Measured = Literal["pose", "position"]
Point: TypeAlias = tuple[float, float, float]

TARGET_SIGMA = 15e-6
"""Noise of each coordinate of a laser tracker's target [m]."""
ENCODER_ZERO = {"m": 5e-3, "rad": 5e-2}
"""Prior standard deviation of an encoder's zero, by the unit of its joint [m, rad]."""
TARGET_COUNT = 4
TARGET_RADIUS = 0.15
"""Distance of the targets from the tool point [m]."""


@dataclass(frozen=True)
class PlacedDatum:
    """Something that points are measured against, and about where it is."""

    kind: DatumKind  #: what it is
    origin: Point  #: about where, base axes [m]
    axes: tuple[Point, ...] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))  #: as rows
    touch: tuple[float, ...] | None = None  #: the only numbers that can be measured, such as a ballbar's length [m]
    idle: tuple[int, ...] = ()  #: see :class:`~pm3dof_pin.measuring.datum.Datum`

    def datum(self, values: Array, number: int = 1) -> Datum:
        """Return the datum, with what was measured against it, shape=(n, dimension) [m]."""
        axes, origin, scales = np.array(self.axes), np.array(self.origin), np.ones(len(values))
        return Datum(self.kind, number, axes, origin, values, scales, idle=self.idle)


@dataclass(frozen=True)
class Instrument:
    """What is measured of a pose, and its noise; by default as for :meth:`with_targets`."""

    measured: Measured = "pose"  #: "pose", or "position" for the tool point alone
    position_sigma: float = TARGET_SIGMA / 2.0  #: noise of each coordinate [m]
    #: noise about each axis [rad]; irrelevant for positions
    angle_sigma: float = TARGET_SIGMA / (TARGET_RADIUS * np.sqrt(2.0))
    own_frame: bool = False  #: whether it measures in its own, initially unknown frame
    #: targets seen one by one instead of the tool point, in tool axes [m]
    targets: tuple[Point, ...] = ()
    target_sigma: float = 0.0  #: prior standard deviation of the targets' coordinates [m]; 0 if known exactly
    encoders: tuple[str, ...] = ()  #: passive joints whose encoders are read at each pose, with the noise above
    #: where the joints with encoders are locked, if they are: then nothing else is seen [m, rad]
    locked: tuple[float, ...] = ()
    tilts_only: bool = False  #: whether of a pose only the turns about x and y are seen, as by a level
    placed: tuple[PlacedDatum, ...] = ()  #: what the targets are measured against instead, one row for each
    known_centres: bool = False  #: whether the centres of spheres were measured beforehand, and are known exactly
    stops: bool = False  #: whether the machine goes on until it touches, so that a row has no number but its commands

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
    def confines(self) -> bool:
        """Whether it sees some poses only: those that touch, are at one distance, or where joints are locked."""
        return bool(self.locked) or any(each.touch is not None for each in self.placed)

    @property
    def covariance(self) -> Array:
        """Covariance of a measured pose [translation; rotation vector], shape=(6, 6) [m^2, rad^2]."""
        return np.diag(np.repeat([self.position_sigma, self.angle_sigma], 3) ** 2)


def as_points(rows: Iterable[Array]) -> tuple[Point, ...]:
    """Return the rows of an array as points, shape=(n, 3) [m]."""
    return tuple((float(x), float(y), float(z)) for x, y, z in rows)


def circle_of_targets(count: int = TARGET_COUNT) -> tuple[Point, ...]:
    """Return targets evenly spaced on a circle of :data:`TARGET_RADIUS` around the tool point, tool axes [m]."""
    around = 2.0 * np.pi * np.arange(count) / count
    return as_points(TARGET_RADIUS * np.stack([np.cos(around), np.sin(around), 0.0 * around], axis=1))
