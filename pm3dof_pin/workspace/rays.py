"""Rays in the plane of tilts, and where they cross the boundary of the reachable set.

A ray leaves the level platform at one height z_e in the direction of one azimuth:
theta_x = r cos(azimuth), theta_y = r sin(azimuth).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.chapter.limits import broken_limits
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.typing import Array

SCAN_STEP = float(np.radians(1.0))  # distance at which the limits are looked at along a ray [rad]
BOUNDARY_TOLERANCE = 1e-10  # how near to the boundary a crossing is found [rad]

_BISECTIONS = int(np.ceil(np.log2(SCAN_STEP / BOUNDARY_TOLERANCE)))


class Crossings(NamedTuple):
    """Crossings of rays with the boundary, ordered by ray and, on a ray, by radius.

    Attributes:
        rays: index of the ray, shape=(m,).
        radii: radius of the end within the limits, shape=(m,) [rad].
        leaving: whether the ray leaves the reachable set there or enters it, shape=(m,).
        limits: sums of :class:`~pm3dof_pin.chapter.limits.Limit` broken just across the boundary, shape=(m,).
    """

    rays: NDArray[np.intp]
    radii: Array
    leaving: NDArray[np.bool_]
    limits: NDArray[np.uint8]


def crossings(tripod: Tripod, azimuths: Array, heights: Array, samples: Array) -> Crossings:
    """Look at the limits along rays, and close in every change by bisection to :data:`BOUNDARY_TOLERANCE`.

    A part of the set, or of its outside, that is thinner than the distance of the samples may be missed.

    Args:
        tripod: the machine.
        azimuths: direction of each ray, shape=(n,) [rad].
        heights: height of each ray, shape=(n,) [m].
        samples: growing radii at which the limits are looked at, no farther apart than :data:`SCAN_STEP`, for all rays
            or for each, shape=(k,) or (n, k) [rad].
    """
    radii = np.broadcast_to(samples, (len(azimuths), samples.shape[-1]))
    within = _within(tripod, radii, azimuths[:, None], heights[:, None])
    rays, sample = np.nonzero(within[:, 1:] != within[:, :-1])
    leaving = within[rays, sample]
    near, far = radii[rays, sample], radii[rays, sample + 1]
    inner, outer = np.where(leaving, near, far), np.where(leaving, far, near)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inner + outer)
        keeps = _within(tripod, middle, azimuths[rays], heights[rays])
        inner, outer = np.where(keeps, middle, inner), np.where(keeps, outer, middle)
    limits = broken_limits(tripod, poses_at(tilts_at(outer, azimuths[rays]), heights[rays]))
    return Crossings(rays, inner, leaving, limits)


def tilts_at(radii: Array, azimuths: Array) -> Array:
    """Return (theta_x, theta_y) at polar coordinates, shape=(..., 2) [rad]."""
    return np.stack([radii * np.cos(azimuths), radii * np.sin(azimuths)], axis=-1)


def poses_at(tilts: Array, heights: Array | float) -> Array:
    """Return (theta_x, theta_y, z_e) of tilts, shape=(..., 2), and heights that broadcast to (...)."""
    z_e = np.broadcast_to(heights, tilts.shape[:-1])
    return np.concatenate([tilts, z_e[..., None]], axis=-1)


def _within(tripod: Tripod, radii: Array, azimuths: Array, heights: Array) -> NDArray[np.bool_]:
    within: NDArray[np.bool_] = broken_limits(tripod, poses_at(tilts_at(radii, azimuths), heights)) == 0
    return within
