"""Speeds along a path with look-ahead over all of it: trapezoidal, or with bounded jerk.

At every point the speed is bounded: by the feed, by the speeds, accelerations and forces of the drives, and at corners.
Between two points the tangential acceleration is at most A. With w = v^2 and D the integral of 2 A ds, the greatest
speeds that never exceed the bounds c are w_i = min over j <= i of (c_j - D_j) + D_i forward, and likewise backward.
Between points the speed rises at A up to the bound, stays, and falls at A. Corners: with a tolerance e the tool may go
round within it on an arc of radius r = e cos(t/2) / (1 - cos(t/2)) for a change of direction t, at v^2 = A r; without
one it stops.

Bounded jerk: the place along the path is the mean of the trapezoidal one over the last T = 2 A / J. Its jerk is at most
2 A / T = J and its acceleration at most A; it stops where the other does, T later. It is where the trapezoidal law was
within T, so each bound c first spreads over the distance c T to both sides: then the mean keeps all of them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pm3dof_pin.arrays import large_array
from pm3dof_pin.typing import Indices, Vector

SMOOTH = np.radians(0.5)
"""Changes of direction below this are no corners [rad]."""

_BLOCK = 65536  # points at a time
_ROUNDS = 60  # of halving a time and Newton's steps; mostly six are enough
_CLOSE = 1e-12  # relative error of a time at which a point is reached


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


def look_ahead(
    length: Vector, bound: Vector, at: Vector, acceleration: Vector, *, averaged_over: float = 0.0
) -> Speeds:
    """Return the fastest trapezoidal motion within the bounds, or its mean over a time, which bounds the jerk.

    Args:
        length: distance of each point from the one before, the first 0, shape=(n,) [m].
        bound: greatest speed at each point, and up to it from the point before, shape=(n,) [m/s].
        at: greatest speed at each point alone, such as at corners, shape=(n,) [m/s]; it starts and ends at rest.
        acceleration: greatest tangential acceleration up to each point, shape=(n,) [m/s^2].
        averaged_over: the time T [s].
    """
    if averaged_over > 0.0:
        bound, acceleration = _spread(length, bound, at, acceleration, averaged_over)
    squares = _squares(length, bound, at, acceleration)
    found = Speeds(*(large_array(len(length)) for _ in range(3)))
    for first in range(0, len(length), _BLOCK):
        part = slice(first, first + _BLOCK)
        found.speed[part] = np.sqrt(np.maximum(squares[part], 0.0))
    tops = large_array(len(length))
    for first in range(0, len(length), _BLOCK):
        part = slice(first, min(first + _BLOCK, len(length)))
        end, top, a, s = found.speed[part], bound[part], acceleration[part], length[part]
        start = np.append(found.speed[first - 1] if first else 0.0, end[:-1])
        with np.errstate(divide="ignore", invalid="ignore"):
            peak = np.minimum(np.sqrt(0.5 * (start**2 + end**2) + a * s), np.maximum(top, np.maximum(start, end)))
            cruise = np.maximum(s - (2.0 * peak**2 - start**2 - end**2) / (2.0 * a), 0.0)
            lasting = (2.0 * peak - start - end) / a + cruise / peak
        found.duration[part] = np.where(s > 0.0, lasting, 0.0)
        tops[part] = peak
        rounding = 1e-9 * peak
        after = np.where(peak > start + rounding, a, np.where(end < start - rounding, -a, 0.0))
        found.acceleration[max(first - 1, 0) : part.stop - 1] = after if first else after[1:]
    if averaged_over > 0.0:
        return _averaged(length, found, tops, acceleration, averaged_over)
    return found


def _squares(length: Vector, bound: Vector, at: Vector, acceleration: Vector) -> Vector:
    """Return the greatest squares of speeds at points, by a pass forward and one backward, block by block."""
    count = len(length)
    squares = large_array(count)
    before = 0.0
    for first in range(0, count, _BLOCK):
        part = slice(first, min(first + _BLOCK, count))
        after = np.append(bound[first + 1 : part.stop + 1], [np.inf] if part.stop == count else [])
        limits = np.minimum(np.minimum(at[part], bound[part]), after) ** 2
        if first == 0:
            limits[0] = 0.0
        if part.stop == count:
            limits[-1] = 0.0
        along = np.cumsum(2.0 * acceleration[part] * length[part])
        reached = np.minimum(np.minimum.accumulate(limits - along), before) + along
        squares[part], before = np.minimum(reached, limits), float(min(reached[-1], limits[-1]))
    after_last, rising = np.inf, 0.0
    for first in range((count - 1) // _BLOCK * _BLOCK, -1, -_BLOCK):
        part = slice(first, min(first + _BLOCK, count))
        steps = 2.0 * acceleration[part] * length[part]
        back = np.append(np.cumsum(steps[:0:-1])[::-1], 0.0)  # from each point to the last of the block
        reached = np.minimum.accumulate((squares[part] - back)[::-1])[::-1]
        squares[part] = np.minimum(reached, after_last + rising) + back
        after_last, rising = float(squares[first]), float(steps[0])
    return squares


def _spread(length: Vector, bound: Vector, at: Vector, acceleration: Vector, time: float) -> tuple[Vector, Vector]:
    """Return bounds and accelerations that also hold as far away as the tool goes in a time at the bound."""
    places = np.cumsum(length)
    before = places - length
    far = np.where(np.isfinite(bound), bound, 0.0) * time
    near = np.where(np.isfinite(at), at, 0.0) * time
    lowest = _least_over(
        np.concatenate([bound, np.where(at > 0.0, at, np.inf)]),
        *_overlapped(
            places, np.concatenate([before - far, places - near]), np.concatenate([places + far, places + near])
        ),
    )
    return lowest, _least_over(acceleration, *_overlapped(places, before - far, places + far))


def _overlapped(places: Vector, lower: Vector, upper: Vector) -> tuple[Indices, Indices]:
    """Return the first and last of the steps up to the places that reach into ranges of length."""
    last = len(places) - 1
    first = np.minimum(np.searchsorted(places, lower, side="right"), last)
    return first, np.maximum(np.minimum(np.searchsorted(places, upper, side="left"), last), first)


def _least_over(values: Vector, first: Indices, last: Indices) -> Vector:
    """Return the least of the values whose range of steps, first to last, has each step; those of a power of two."""
    levels = np.frexp(last - first + 1)[1] - 1
    least = np.full(int(last.max(initial=0)) + 1, np.inf)
    for level in range(int(levels.max(initial=0)), -1, -1):
        rows = np.flatnonzero(levels == level)
        for start in (first[rows], last[rows] - 2**level + 1):
            np.minimum.at(least, start, values[rows])
        if level:
            half = 2 ** (level - 1)
            least[half:] = np.minimum(least[half:], least[:-half].copy())
    return least


def _averaged(length: Vector, speeds: Speeds, tops: Vector, acceleration: Vector, time: float) -> Speeds:
    """Return the mean of a trapezoidal motion over a time, at the same points; it lasts that much longer to a stop."""
    count = len(length)
    places = np.cumsum(length)
    rests = np.where((speeds.speed == 0.0) & (length > 0.0), time, 0.0)
    reached = np.cumsum(speeds.duration + np.append(0.0, rests[:-1]))  # when the trapezoidal motion arrives
    found = Speeds(*(large_array(count) for _ in range(3)))
    last_time = 0.0
    for first in range(0, count, _BLOCK):
        part = slice(first, min(first + _BLOCK, count))
        low, high = reached[first] - time, reached[part.stop - 1] + 2.0 * time
        begin = max(int(np.searchsorted(reached, low, side="right")) - 1, 0)
        end = min(int(np.searchsorted(reached, high, side="left")) + 1, count)
        motion = _Phases(slice(begin, end), speeds, tops, acceleration, length, reached, rests, places)
        stops = speeds.speed[part] == 0.0
        times = motion.when(places[part], reached[part], time)
        times = np.where(stops, reached[part] + rests[part], times)
        found.speed[part] = np.where(stops, 0.0, motion.mean_speed(times, time))
        found.acceleration[part] = (motion.speed(times) - motion.speed(times - time)) / time
        found.duration[part] = np.maximum(np.diff(times, prepend=last_time), 0.0)
        last_time = float(times[-1])
    return found


class _Phases:
    """A trapezoidal motion over some points, as phases of constant acceleration; at rest before and after them."""

    def __init__(
        self,
        part: slice,
        speeds: Speeds,
        tops: Vector,
        acceleration: Vector,
        length: Vector,
        reached: Vector,
        rests: Vector,
        places: Vector,
    ) -> None:
        rows = np.arange(part.start + 1, part.stop)
        start, end, peak = speeds.speed[rows - 1], speeds.speed[rows], tops[rows]
        a, moves = acceleration[rows], length[rows] > 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            up, down = (np.where(moves, (peak - v) / a, 0.0) for v in (start, end))
        whole = np.where(moves, speeds.duration[rows], 0.0)
        times = reached[rows] - whole
        self._origin = reached[part.start]
        self._place = places[part.start]
        away = times - self._origin
        knots = np.stack([away, away + up, away + np.maximum(whole - down, up), away + whole], axis=1).ravel()
        self._v = np.stack([start, peak, peak, end], axis=1).ravel()
        self._a = np.stack(
            [np.where(up > 0.0, a, 0.0), 0.0 * a, np.where(down > 0.0, -a, 0.0), 0.0 * a], axis=1
        ).ravel()
        s = np.stack(
            [
                places[rows - 1],
                places[rows - 1] + 0.5 * (start + peak) * up,
                places[rows] - 0.5 * (peak + end) * down,
                places[rows],
            ],
            axis=1,
        ).ravel()
        self._t, self._s = knots, s - self._place
        steps = np.diff(knots)
        v, a4, s4 = self._v[:-1], self._a[:-1], self._s[:-1]
        self._area = np.insert(np.cumsum(s4 * steps + v * steps**2 / 2.0 + a4 * steps**3 / 6.0), 0, 0.0)

    def _phase(self, times: Vector) -> tuple[Indices, Vector, Vector]:
        index = np.maximum(np.searchsorted(self._t, times - self._origin, side="right") - 1, 0)
        since = times - self._origin - self._t[index]
        return index, since, np.where((since < 0.0) | (index == len(self._t) - 1), 0.0, 1.0)

    def speed(self, times: Vector) -> Vector:
        """Return the speed at times, shape=(n,) [m/s]."""
        index, since, moving = self._phase(times)
        return moving * (self._v[index] + self._a[index] * since)

    def mean_speed(self, times: Vector, over: float) -> Vector:
        """Return the mean speed over the last part of times, shape=(n,) [m/s]."""
        return (self._away(times) - self._away(times - over)) / over

    def _away(self, times: Vector) -> Vector:
        index, since, moving = self._phase(times)
        return np.asarray(self._s[index] + moving * (self._v[index] * since + 0.5 * self._a[index] * since**2))

    def _areas(self, times: Vector) -> Vector:
        """Return the integral of the place over time."""
        index, since, moving = self._phase(times)
        curved = self._v[index] * since**2 / 2.0 + self._a[index] * since**3 / 6.0
        return np.asarray(self._area[index] + self._s[index] * since + moving * curved)

    def when(self, places: Vector, earliest: Vector, over: float) -> Vector:
        """Return when the mean place over the last part of time is at places, shape=(n,) [s]."""
        wanted = places - self._place
        low, high = earliest.copy(), earliest + over
        times = 0.5 * (low + high)
        for _ in range(_ROUNDS):
            off = (self._areas(times) - self._areas(times - over)) / over - wanted
            low, high = np.where(off < 0.0, times, low), np.where(off < 0.0, high, times)
            with np.errstate(divide="ignore", invalid="ignore"):
                better = times - off / self.mean_speed(times, over)
            inside = (better > low) & (better < high)
            following = np.where(inside, better, 0.5 * (low + high))
            done = np.abs(following - times).max(initial=0.0) < _CLOSE * max(1.0, float(high.max(initial=0.0)))
            times = following
            if done:
                break
        return times
