"""Extremes of both coordinates in a section or a stack of sections, refined between the sampled rays.

Extremes are often corners where two limits bind, so the best ray may miss them by a good part of a degree.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.maps.limit_space import LimitSpace
from pm3dof_pin.maps.rays import brackets, closed_in
from pm3dof_pin.typing import Array, Mask

# Directions of the four extremes of a set: minus and plus the first coordinate, then the second.
_OUTWARD = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
_MOST_ROUNDS = 60
_SMALLEST = 6e-5  # size of the window, relative to the first one, at which an extreme counts as found


def extremes_of(
    space: LimitSpace, boundaries: Sequence[Array], half_width: float, half_level: float = 0.0
) -> tuple[Array, Array]:
    """Find the extremes of sets near given boundary points, (radius, azimuth, level), shape=(m, 3) each.

    Around each extreme, rays are tried in a window of half a width [rad] and, for a stack of sections, half a level. A
    corner shifts in azimuth as the level increases, by about 1 deg for 1 mm of height on the chapter's machine: the
    half width must be large enough to follow it.

    Returns the least and greatest first and second coordinates of each set, shape=(n, 2, 2) [m, rad], and their levels.
    """
    found = _refined(space, np.stack([_sampled(points) for points in boundaries]), _window(half_width, half_level))
    points = space.points(found[..., 0], found[..., 1])
    values = np.stack([points[..., :2, 0], points[..., 2:, 1]], axis=-2)
    return values, found[..., 2].reshape(-1, 2, 2)


def _sampled(boundary: Array) -> Array:
    """Return the (radius, azimuth, level) of least and greatest first and second coordinates, shape=(4, 3)."""
    best: Array = boundary[np.argmax(_directions(boundary[:, 0], boundary[:, 1]) @ _OUTWARD.T, axis=0)]
    return best


def _window(half_width: float, half_level: float) -> Array:
    """Return offsets (azimuth, level) of the rays around an extreme, shape=(k, 2)."""
    azimuths = half_width * np.linspace(-1.0, 1.0, 33 if half_level else 9)
    levels = half_level * np.linspace(-1.0, 1.0, 5) if half_level else np.zeros(1)
    return np.stack(np.meshgrid(azimuths, levels), axis=-1).reshape(-1, 2)


def _refined(space: LimitSpace, starts: Array, window: Array) -> Array:
    """Move extreme boundary points, shape=(n, 4, 3), to the true extremes between the rays and the levels.

    The window around each moves to its best ray, and shrinks when that ray is not at its edge.
    """
    outward = np.tile(_OUTWARD, (len(starts), 1))
    extremes, size = starts.reshape(-1, 3).copy(), np.ones(len(outward))
    value = np.sum(outward * _directions(extremes[:, 0], extremes[:, 1]), axis=1)
    greatest = window.max(axis=0)
    at_edge = np.any((np.abs(window) == greatest) & (greatest > 0.0), axis=1)
    shrinking = 1.0 / 3.0 if greatest[1] == 0.0 else 0.5  # slower if the corner must be followed over levels
    for _ in range(_MOST_ROUNDS):
        if size.max() < _SMALLEST:
            break
        rays = extremes[:, None, 1:] + size[:, None, None] * window
        radii = _outermost_radii(space, outward, rays, extremes[:, 0])
        values = np.sum(_directions(radii, rays[..., 0]) * outward[:, None], axis=-1)
        winner = np.argmax(np.nan_to_num(values, nan=-np.inf), axis=1)
        index = np.arange(len(extremes)), winner
        better = values[index] > value
        extremes[better] = np.concatenate([radii[index][:, None], rays[index]], axis=-1)[better]
        value[better] = values[index][better]
        size *= np.where(better & at_edge[winner], 1.0, shrinking)
    return extremes.reshape(starts.shape)


def _outermost_radii(space: LimitSpace, outward: Array, rays: Array, radii: Array) -> Array:
    """Radius at which each best ray crosses the boundary near its start radius, shape=(m, k); else NaN."""
    count = rays.shape[1]
    samples = np.repeat(radii[:, None] + space.ray_step * np.arange(-3.0, 4.0), count, axis=0)
    azimuths, levels = rays.reshape(-1, 2).T
    within = space.within(space.points(samples, azimuths[:, None]), levels[:, None])
    growth = np.sum(np.repeat(outward, count, axis=0) * _directions(np.ones(len(azimuths)), azimuths), axis=1)

    def contenders(crossed: NDArray[np.intp], inner: Array, outer: Array) -> Mask:
        best = np.full(len(radii), -np.inf)
        np.maximum.at(best, crossed // count, growth[crossed] * inner)
        return np.asarray(growth[crossed] * np.maximum(inner, outer) >= best[crossed // count])

    crossed, found, _ = closed_in(space, azimuths, levels, brackets(within, samples), contenders)
    order = np.argsort(growth[crossed] * found)
    outermost = np.full(len(azimuths), np.nan)
    outermost[crossed[order]] = found[order]  # the farthest is written last
    return outermost.reshape(rays.shape[:2])


def _directions(radii: Array, azimuths: Array) -> Array:
    return np.stack([radii * np.cos(azimuths), radii * np.sin(azimuths)], axis=-1)
