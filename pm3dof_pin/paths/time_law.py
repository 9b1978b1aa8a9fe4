"""Speeds along a path by a trapezoidal law with look-ahead over all of it.

At every point the speed is bounded: by the feed, by the speeds and accelerations of the drives, and at corners.
Between two points the tangential acceleration is at most A. With w = v^2 and D the integral of 2 A ds, the greatest
speeds that never exceed the bounds c are w_i = min over j <= i of (c_j - D_j) + D_i forward, and likewise backward.
Between points the speed rises at A up to the bound, stays, and falls at A. Corners: with a tolerance e the tool may go
round within it on an arc of radius r = e cos(t/2) / (1 - cos(t/2)) for a change of direction t, at v^2 = A r; without
one it stops.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pm3dof_pin.typing import Vector

SMOOTH = np.radians(0.5)
"""Changes of direction below this are no corners [rad]."""


class Speeds(NamedTuple):
    """The motion in time along a path of n points."""

    speed: Vector  #: at each point, shape=(n,) [m/s]
    acceleration: Vector  #: tangential, right after each point, shape=(n,) [m/s^2]
    duration: Vector  #: from the point before, shape=(n,) [s]


def corner_speed(cosine: Vector, tolerance: Vector, acceleration: float) -> Vector:
    """Return the greatest speed around corners, by the cosine of the change of direction, shape=(n,) [m/s]."""
    half = np.sqrt(np.clip(0.5 * (1.0 + cosine), 0.0, 1.0))
    with np.errstate(divide="ignore", invalid="ignore"):
        found = np.sqrt(acceleration * tolerance * half / (1.0 - half))
    return np.where(half >= np.cos(0.5 * SMOOTH), np.inf, found)


def look_ahead(length: Vector, bound: Vector, at: Vector, acceleration: Vector) -> Speeds:
    """Return the fastest motion within the bounds.

    Args:
        length: distance of each point from the one before, the first 0, shape=(n,) [m].
        bound: greatest speed at each point, and up to it from the point before, shape=(n,) [m/s].
        at: greatest speed at each point alone, such as at corners, shape=(n,) [m/s]; it starts and ends at rest.
        acceleration: greatest tangential acceleration up to each point, shape=(n,) [m/s^2].
    """
    at = np.minimum(at, bound)
    at[:-1] = np.minimum(at[:-1], bound[1:])
    at[[0, -1]] = 0.0
    along = np.cumsum(2.0 * acceleration * length)
    squares = np.minimum.accumulate(at**2 - along) + along
    squares = np.minimum.accumulate((squares + along)[::-1])[::-1] - along
    v = np.sqrt(np.maximum(squares, 0.0))
    first, last, top, a, s = v[:-1], v[1:], bound[1:], acceleration[1:], length[1:]
    with np.errstate(divide="ignore", invalid="ignore"):
        peak = np.minimum(np.sqrt(0.5 * (first**2 + last**2) + a * s), np.maximum(top, np.maximum(first, last)))
        cruise = np.maximum(s - (2.0 * peak**2 - first**2 - last**2) / (2.0 * a), 0.0)
        lasting = (2.0 * peak - first - last) / a + cruise / peak
    rounding = 1e-9 * peak
    after = np.where(peak > first + rounding, a, np.where(last < first - rounding, -a, 0.0))
    return Speeds(v, np.append(after, 0.0), np.insert(np.where(s > 0.0, lasting, 0.0), 0, 0.0))
