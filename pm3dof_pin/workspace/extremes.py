"""The greatest tilts of a section or of a stack of sections, found between the rays that sampled them.

Extremes often are corners, where two limits bind, so that the best ray may end a good part of a degree short of them.
"""

from __future__ import annotations

import numpy as np

from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.typing import Array
from pm3dof_pin.workspace.rays import SCAN_STEP, crossings, tilts_at

# What the four extremes of a set are greatest in: -theta_x, theta_x, -theta_y, theta_y.
_OUTWARD = np.array([[-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]])
_MOST_ROUNDS = 60
_SMALLEST = 6e-5  # size of the window, against the first one, at which an extreme counts as found


def sampled_extremes(boundary: Array) -> Array:
    """Return those of the boundary points that have the least and greatest theta_x, then theta_y.

    Args:
        boundary: (radius, azimuth, z_e) of points, shape=(m, 3) [rad, rad, m].

    Returns:
        shape=(4, 3).
    """
    best: Array = boundary[np.argmax(tilts_at(boundary[:, 0], boundary[:, 1]) @ _OUTWARD.T, axis=0)]
    return best


def extreme_tilts(extremes: Array) -> Array:
    """Return least and greatest theta_x, then theta_y, of extremes, shape=(..., 4, 3) to (..., 2, 2) [rad]."""
    tilts = tilts_at(extremes[..., 0], extremes[..., 1])
    return np.stack([tilts[..., :2, 0], tilts[..., 2:, 1]], axis=-2)


def window(half_width: float, half_height: float = 0.0) -> Array:
    """Return offsets (azimuth, z_e) of the rays that :func:`refined_extremes` sends around an extreme.

    Args:
        half_width: greatest offset of the azimuth [rad].
        half_height: greatest offset of the height, 0 to stay in a section [m]. A corner wanders over the azimuth as the
            height grows, by about 1 deg for 1 mm on the chapter's machine: the width has to be enough to follow it.

    Returns:
        shape=(k, 2).
    """
    azimuths = half_width * np.linspace(-1.0, 1.0, 33 if half_height else 9)
    heights = half_height * np.linspace(-1.0, 1.0, 5) if half_height else np.zeros(1)
    return np.stack(np.meshgrid(azimuths, heights), axis=-1).reshape(-1, 2)


def refined_extremes(tripod: Tripod, starts: Array, window: Array) -> Array:
    """Move extreme boundary points to where they are extreme between the rays, and between the heights.

    The window around each moves to the best of its rays, and shrinks when that one is not at its edge.

    Args:
        tripod: the machine.
        starts: results of :func:`sampled_extremes`, shape=(n, 4, 3).
        window: result of :func:`window`.

    Returns:
        shape=(n, 4, 3), like `starts`.
    """
    outward = np.tile(_OUTWARD, (len(starts), 1))
    extremes, size = starts.reshape(-1, 3).copy(), np.ones(len(outward))
    value = np.sum(outward * tilts_at(extremes[:, 0], extremes[:, 1]), axis=1)
    greatest = window.max(axis=0)
    at_edge = np.any((np.abs(window) == greatest) & (greatest > 0.0), axis=1)
    shrinking = 1.0 / 3.0 if greatest[1] == 0.0 else 0.5  # slower where the corner has to be followed over the height
    for _ in range(_MOST_ROUNDS):
        if size.max() < _SMALLEST:
            break
        rays = extremes[:, None, 1:] + size[:, None, None] * window
        radii = _outermost_radii(tripod, outward, rays, extremes[:, 0])
        values = np.sum(tilts_at(radii, rays[..., 0]) * outward[:, None], axis=-1)
        winner = np.argmax(np.nan_to_num(values, nan=-np.inf), axis=1)
        index = np.arange(len(extremes)), winner
        better = values[index] > value
        extremes[better] = np.concatenate([radii[index][:, None], rays[index]], axis=-1)[better]
        value[better] = values[index][better]
        size *= np.where(better & at_edge[winner], 1.0, shrinking)
    return extremes.reshape(starts.shape)


def _outermost_radii(tripod: Tripod, outward: Array, rays: Array, radii: Array) -> Array:
    """Radius at which each ray (azimuth, z_e), shape=(m, k, 2), crosses the boundary near the radius given for its m.

    Of several crossings the one that is farthest outward; NaN where there is none.
    """
    samples = np.repeat(radii[:, None] + SCAN_STEP * np.arange(-3.0, 4.0), rays.shape[1], axis=0)
    azimuths, heights = rays.reshape(-1, 2).T
    crossed, found, _, _ = crossings(tripod, azimuths, heights, samples)
    order = np.argsort(np.sum(outward[crossed // rays.shape[1]] * tilts_at(found, azimuths[crossed]), axis=1))
    outermost = np.full(len(azimuths), np.nan)
    outermost[crossed[order]] = found[order]  # the farthest is written last
    return outermost.reshape(rays.shape[:2])
