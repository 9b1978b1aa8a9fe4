"""What an instrument's file says of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.datum import Datum, DatumKind
from pm3dof_pin.measuring.instrument import Instrument, PlacedDatum, Point, as_points
from pm3dof_pin.typing import Array

TOOL_POINT = (0.0, 0.0, 0.0)


@dataclass(frozen=True, eq=False)
class Setting:
    """Where an instrument is to be used, and what is given of it."""

    poses: Poses  #: where the machine can go, or where it is measured
    sigma: float  #: noise of a coordinate [m], of tilts [rad]
    point: Point | None = None  #: the ball, stylus or target, in tool axes [m]
    centres: tuple[Point, ...] = ()  #: about where the instrument is, base axes [m]
    length: float | None = None  #: the only distance that can be measured [m]
    joints: tuple[str, ...] = ()  #: passive joints that are locked

    def points(self, targets: tuple[Point, ...]) -> Array:
        """Return the positions of targets on the tool at all poses, shape=(n, 3) [m]."""
        offsets = np.einsum("nij,kj->nki", self.poses.rotations, np.array(targets))
        return np.asarray((self.poses.positions[:, None] + offsets).reshape(-1, 3))

    @property
    def targets(self) -> tuple[Point, ...]:
        """The one target."""
        return (self.point or TOOL_POINT,)

    @property
    def middle(self) -> Array:
        """The median position of the target, shape=(3,) [m]."""
        return np.asarray(np.median(self.points(self.targets), axis=0))

    def extent(self, points: Array) -> float:
        """Return the greater of the extent of points and the machine's size [m]."""
        reach = float(np.linalg.norm(points - np.median(points, axis=0), axis=1).max())
        return max(reach, self.poses.robot.characteristic_length)

    def at(self, *placed: PlacedDatum, stops: bool = False) -> Instrument:
        """Return an instrument that measures the one target against something."""
        return Instrument("position", position_sigma=self.sigma, targets=self.targets, placed=placed, stops=stops)

    def one(self, kind: DatumKind, axes: Array, place: Array, touch: tuple[float, ...] | None = None) -> PlacedDatum:
        """Return the one thing measured against: where all poses touch it already, at the centre given, or at a place.

        Args:
            kind: what it is.
            axes: its axes as rows, shape=(3, 3).
            place: its origin, shape=(3,) [m].
            touch: the only numbers that can be measured.
        """
        points = self.points(self.targets)
        if self.centres:
            place = np.array(self.centres[0])
        elif touch is not None and len(points) >= kind.min_rows:
            found = Datum.fitted(kind, 1, points, np.tile(touch, (len(points), 1)))
            if np.abs(found.residuals(points)).max() < TOUCHING:
                axes, place = found.axes, found.origin
        return PlacedDatum(kind, as_points([place])[0], as_points(axes), touch)


TOUCHING = 1e-8
"""A point nearer than this touches [m]."""


@dataclass(frozen=True)
class InstrumentKind:
    """An instrument: what it is called, what its rows are measured against, where it stands."""

    name: str  #: of `--instrument`
    sees: str  #: what it sees of a pose, in words
    unknown: str  #: what is estimated beside the machine, in words
    sigma: float  #: usual noise of a coordinate [m], of tilts [rad]
    place: Callable[[Setting], Instrument]  #: the instrument, placed where it sees or touches the poses
    datum: DatumKind | None = None  #: what its rows are measured against, if that is of unknown placement
    centres: int = 1  #: greatest number of centres that can be given

    def placed(self, setting: Setting) -> Instrument:
        """Place it; raise InvalidValueError for more centres than it has, or a length or noise that is not positive."""
        if not (np.isfinite(setting.sigma) and setting.sigma > 0.0):
            raise InvalidValueError("sigma", setting.sigma, "a positive number")
        if setting.length is not None and not (np.isfinite(setting.length) and setting.length > 0.0):
            raise InvalidValueError("length", setting.length, "a positive number of metres")
        if len(setting.centres) > self.centres:
            raise InvalidValueError("centres", len(setting.centres), f"{self.centres or 'none'} for a {self.name}")
        return self.place(setting)
