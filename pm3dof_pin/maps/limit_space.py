"""Two or three coordinates of a machine and the limits over them, in which the reachable set is searched."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.labels import limit_names
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

Flags: TypeAlias = NDArray[np.uint32]

_SAMPLES = 24  # samples along a ray from the middle of a coordinate's range to its end
_OUTSIDE = 1.5  # least length of a ray, in half ranges
_FARTHEST = 12.0  # greatest length
_DIRECTIONS = 24
_LEVELS = 9
_PLANE = 2
_MOST_COORDINATES = 3
_BATCH = 200_000  # poses at a time


@dataclass(frozen=True, eq=False)
class LimitSpace:
    """Coordinates and the limits over them.

    Sections are over the first two coordinates and stacked along the third, if there is one. A ray of a section starts
    at its centre: radius r and azimuth phi mean centre + r scale (cos phi, sin phi).
    """

    machine: str  #: name of the machine
    names: tuple[str, ...]  #: names of the coordinates, two or three
    units: tuple[str, ...]  #: "m" or "rad" of each
    limits: tuple[str, ...]  #: names of the limits, from the lowest bit
    #: function from values of the coordinates, shape=(..., number of coordinates) [m, rad], to the sums of the limits
    #: they break, shape=(...); zero within all
    broken_limits: Callable[[Array], Flags]
    centre: Array  #: start of the rays in a section, shape=(2,) [m, rad]
    scale: Array  #: length of radius 1 along each coordinate, shape=(2,) [m, rad]
    reach: float  #: radius beyond which no pose is within the limits
    ray_step: float  #: step of radii at which the limits are checked
    #: range in which the third coordinate is searched; zeros if there are only two [m, rad]
    level_range: tuple[float, float]
    level_step: float  #: step of levels at which the limits are checked [m, rad]

    @property
    def stacked(self) -> bool:
        """Whether there is a third coordinate."""
        return len(self.names) > _PLANE

    def within(self, points: Array, levels: Array | float) -> NDArray[np.bool_]:
        """Tell which points of sections, shape=(..., 2), are within the limits at levels that broadcast to (...)."""
        within: NDArray[np.bool_] = self.flags(points, levels) == 0
        return within

    def flags(self, points: Array, levels: Array | float) -> Flags:
        """Return the sums of the limits that points of sections break, shape=(...)."""
        if not self.stacked:
            return self.broken_limits(points)
        third = np.broadcast_to(levels, points.shape[:-1])
        return self.broken_limits(np.concatenate([points, third[..., None]], axis=-1))

    def limit_shares(self, limits: Flags) -> dict[str, float]:
        """Return the share of each limit in sums of limits, shape=(m,); if several bind, each counts in part."""
        bits = np.stack([(limits & (1 << bit)) != 0 for bit in range(len(self.limits))], axis=-1)
        parts = bits / np.maximum(bits.sum(axis=-1, keepdims=True), 1)
        return dict(zip(self.limits, (parts.sum(axis=0) / max(len(limits), 1)).tolist(), strict=True))

    def points(self, radii: Array, azimuths: Array) -> Array:
        """Return the coordinates at radii and azimuths, shape=(..., 2) [m, rad]."""
        directions = np.stack([radii * np.cos(azimuths), radii * np.sin(azimuths)], axis=-1)
        return np.asarray(self.centre + self.scale * directions)


def robot_space(
    robot: Robot,
    names: tuple[str, ...] | None = None,
    fixed: Mapping[str, float] | None = None,
) -> LimitSpace:
    """Return two or three coordinates of a robot with the limits over them, not counting declared ranges.

    By default the first ones, with those of equal units in the sections; others are at home unless fixed [m, rad].

    Raises:
        InvalidValueError: an unknown coordinate, fewer than two or more than three, or unbounded ones.
        ConvergenceError: the loops do not close at home.
    """
    robot.assemble()  # at home, where searches start
    chosen = names or _default_names(robot)
    if not _PLANE <= len(set(chosen)) == len(chosen) <= _MOST_COORDINATES:
        raise InvalidValueError(
            "coordinates", ", ".join(chosen) or "none", "two for the sections, and optionally one to stack them"
        )
    coordinates = [robot.coordinate(name) for name in chosen]
    places = [robot.coordinates.index(coordinate) for coordinate in coordinates]
    home = np.array(robot.home_coordinates)
    broken = limits_over(robot, chosen, fixed)

    ends = []
    for coordinate, place in zip(coordinates, places, strict=True):
        width = robot.characteristic_length if coordinate.unit == "m" else np.pi
        low, high = robot.range_of(coordinate)
        ends.append(
            (low if np.isfinite(low) else home[place] - width, high if np.isfinite(high) else home[place] + width)
        )
    centres, halves = np.mean(ends, axis=1), 0.5 * np.ptp(ends, axis=1)
    level, half_level = (centres[_PLANE], halves[_PLANE]) if len(chosen) > _PLANE else (0.0, 0.0)
    space = LimitSpace(
        machine=robot.name,
        names=chosen,
        units=tuple(coordinate.unit for coordinate in coordinates),
        limits=limit_names(robot),
        broken_limits=broken,
        centre=centres[:_PLANE],
        scale=halves[:_PLANE],
        reach=_OUTSIDE,
        ray_step=1.0 / _SAMPLES,
        level_range=(level - _OUTSIDE * half_level, level + _OUTSIDE * half_level),
        level_step=half_level / _SAMPLES,
    )
    return _wide_enough(space, level, half_level)


def limits_over(
    robot: Robot, names: Sequence[str], fixed: Mapping[str, float] | None = None
) -> Callable[[Array], Flags]:
    """Return a robot's limits over some coordinates, see :attr:`LimitSpace.broken_limits`; others at home or fixed."""
    complete = coordinates_over(robot, names, fixed)

    def broken(values: Array) -> Flags:
        rows = values.reshape(-1, len(names))
        flags = np.empty(len(rows), dtype=np.uint32)
        for first in range(0, len(rows), _BATCH):
            part = slice(first, first + _BATCH)
            flags[part] = robot.solve(complete(rows[part]), on_failure="nan").broken_limits
        return flags.reshape(values.shape[:-1])

    return broken


def coordinates_over(
    robot: Robot, names: Sequence[str], fixed: Mapping[str, float] | None = None
) -> Callable[[Array], Array]:
    """Return a function that completes coordinates, shape=(n, m), to all of them; others at home or fixed."""
    places = [robot.coordinates.index(robot.coordinate(name)) for name in names]
    home = np.array(robot.home_coordinates)
    for name, value in (fixed or {}).items():
        home[robot.coordinates.index(robot.coordinate(name))] = value

    def complete(values: Array) -> Array:
        rows = np.tile(home, (len(values), 1))
        rows[:, places] = values
        return rows

    return complete


def _default_names(robot: Robot) -> tuple[str, ...]:
    first = robot.coordinates[:_MOST_COORDINATES]
    for stacked in reversed(first):
        others = [coordinate for coordinate in first if coordinate is not stacked]
        if len(first) == _MOST_COORDINATES and others[0].unit == others[1].unit:
            return (*(coordinate.name for coordinate in others), stacked.name)
    return tuple(coordinate.name for coordinate in first)


def _wide_enough(space: LimitSpace, level: float, half_level: float) -> LimitSpace:
    """Widen a space until no pose around it is within the limits; InvalidValueError if they have no end."""
    azimuths = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    radii, up = np.array([0.0, 0.25, 0.5, 0.75, 1.0]), np.array([-1.0, 1.0])
    while True:
        levels = np.linspace(*space.level_range, _LEVELS)[:, None]
        ring = space.points(np.full((_LEVELS, _DIRECTIONS), space.reach), azimuths)
        wide = bool(space.within(ring, levels).any())
        discs = space.points(space.reach * radii[:, None], azimuths)
        tall = space.level_range[1] - level
        high = space.stacked and any(bool(space.within(discs, level + end * tall).any()) for end in up)
        if not wide and not high:
            return space
        if space.reach > _FARTHEST or tall > _FARTHEST * half_level > 0.0:
            expected = f"coordinates of {space.machine} that joint limits or its reach bound (--coordinate)"
            raise InvalidValueError("coordinates", ", ".join(space.names), expected)
        tall *= 1.5 if high else 1.0
        space = replace(
            space, reach=space.reach * (1.5 if wide else 1.0), level_range=(float(level - tall), float(level + tall))
        )
