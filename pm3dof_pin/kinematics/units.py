"""Scales and periods of coordinates, and the one judge of whether their values are in another unit."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import Coordinate, Unit
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Array, Vector

_TURN = 2.0 * math.pi
_DEGREE = math.radians(1.0)
_METRES_BEYOND = 50.0  # lengths above this multiple of the greatest magnitude in range are suspected
_RADIANS_BEYOND = 5.0  # angles likewise
_MIN_SUSPECTED_ANGLE = 3.2  # angles up to half a turn are not suspected [rad]
_MIN_SUSPECTED_PART = 0.25  # of the numbers: samples around a range leave it by less
_MARGIN = 0.5  # permitted distance from a range without zero, in millimetres, relative to the range


def coordinate_scales(mechanism: Mechanism, coordinates: Iterable[Coordinate]) -> Vector:
    """Return the change of each coordinate as its joint, or the tool, moves by a characteristic length or a radian."""
    length = mechanism.characteristic_length
    return np.array([abs(c.scale) * (length if c.unit == "m" else 1.0) for c in coordinates])


def coordinate_periods(mechanism: Mechanism, coordinates: Iterable[Coordinate]) -> Vector:
    """Return the periods of coordinates; infinite for those that are not periodic [rad]."""
    return np.array([_TURN * abs(c.scale) if _is_periodic(mechanism, c) else np.inf for c in coordinates])


def _is_periodic(mechanism: Mechanism, coordinate: Coordinate) -> bool:
    if coordinate.joint is not None:
        return mechanism.single_joint(coordinate.joint).is_continuous
    return coordinate.tool in ("rx", "ry", "rz")


@dataclass(frozen=True)
class UnitSlip:
    """Numbers in millimetres or degrees instead of metres or radians."""

    index: int  #: the number farthest from zero
    unit: str  #: their unit: "millimetres" or "degrees"
    expected: str  #: what was expected


def unit_slip(robot: PlacedMechanism, coordinate: Coordinate, values: ArrayLike) -> UnitSlip | None:
    """Judge whether values of a coordinate are in millimetres or degrees, by its range: see :func:`slip_in_range`.

    Without a range, lengths are judged by the machine's size, and rotations of the tool by one turn: a batch that goes
    or spans further is in degrees. Joints that turn without end are not judged.
    """
    lower, upper = robot.range_of(coordinate)
    if math.isfinite(upper - lower):
        return slip_in_range(values, coordinate.unit, lower, upper)
    if coordinate.unit == "m":
        home = robot.home.tool_placement.translation if coordinate.tool is not None else np.zeros(3)
        size = max(robot.characteristic_length * abs(coordinate.scale), np.abs(home).max()) + abs(coordinate.offset)
        return slip_in_range(values, "m", -size, size)
    if coordinate.tool is None:
        return None
    first, last = _ends(np.asarray(values, dtype=float))
    if last - first <= _TURN * (1.0 + 1e-9):
        return None
    slip = slip_in_range(values, "rad", -_TURN, _TURN, beyond=0.0)
    return replace(slip, expected=f"radians, over at most a turn of {_TURN:.4g}") if slip else None


def slip_in_range(
    values: ArrayLike, unit: Unit, lower: float, upper: float, *, beyond: float | None = None
) -> UnitSlip | None:
    """Judge whether values [m, rad] that should be in a finite range are in millimetres or degrees.

    They are, if a quarter of them are far outside (or `beyond` in magnitude), and in the other unit all would be
    sensible: not far from the range, or angles of at most a turn.
    """
    numbers = np.asarray(values, dtype=float)
    most = max(abs(lower), abs(upper))
    if unit == "m":
        limit, factor, word, base = _METRES_BEYOND * most, 1e-3, "millimetres", "metres"
    else:
        limit, factor, word, base = max(_RADIANS_BEYOND * most, _MIN_SUSPECTED_ANGLE), _DEGREE, "degrees", "radians"
    limit = limit if beyond is None else beyond
    if max(map(abs, _ends(numbers))) <= limit:
        return None
    numbers = numbers.reshape(-1)
    finite = numbers[np.isfinite(numbers) & (numbers != 0.0)]
    sizes, nearest = factor * np.abs(finite), min(abs(lower), abs(upper)) if lower * upper > 0.0 else 0.0
    plausible = sizes <= _TURN if unit == "rad" else (sizes <= limit) & (sizes >= nearest - _MARGIN * (upper - lower))
    if not finite.size or not plausible.all() or (np.abs(finite) > limit).mean() < _MIN_SUSPECTED_PART:
        return None
    index = int(np.nan_to_num(np.abs(numbers)).argmax())
    return UnitSlip(index, word, f"{base} from {lower:.4g} to {upper:.4g}")


def _ends(numbers: Array) -> tuple[float, float]:
    """Return the least and greatest number, zero included, NaN not."""
    return float(np.fmin.reduce(numbers, axis=None, initial=0.0)), float(
        np.fmax.reduce(numbers, axis=None, initial=0.0)
    )
