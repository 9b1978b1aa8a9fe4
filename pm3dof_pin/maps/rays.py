"""Rays in sections of the reachable set, and where they cross its boundary.

A ray leaves the centre of a section in the direction of one azimuth, see
:class:`~pm3dof_pin.maps.limit_space.LimitSpace`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.maps.limit_space import Flags, LimitSpace
from pm3dof_pin.typing import Array

BOUNDARY_TOLERANCE = 1e-10  # how near to the boundary a crossing is found, as a radius


class Crossings(NamedTuple):
    """Crossings of rays with the boundary, ordered by ray and, on a ray, by radius.

    Attributes:
        rays: index of the ray, shape=(m,).
        radii: radius of the end within the limits, shape=(m,).
        leaving: whether the ray leaves the reachable set there or enters it, shape=(m,).
        limits: sums of the limits broken just across the boundary, shape=(m,).
    """

    rays: NDArray[np.intp]
    radii: Array
    leaving: NDArray[np.bool_]
    limits: Flags


def crossings(space: LimitSpace, azimuths: Array, levels: Array, samples: Array) -> Crossings:
    """Check the limits along rays, and close in every change by bisection to :data:`BOUNDARY_TOLERANCE`.

    A part of the set, or of its outside, that is thinner than the distance of the samples may be missed.

    Args:
        space: coordinates and limits.
        azimuths: direction of each ray, shape=(n,) [rad].
        levels: third coordinate of each ray, shape=(n,) [m, rad].
        samples: growing radii at which the limits are checked, for all rays or for each, shape=(k,) or (n, k).
    """
    radii = np.broadcast_to(samples, (len(azimuths), samples.shape[-1]))
    within = space.within(space.points(radii, azimuths[:, None]), levels[:, None])
    rays, sample = np.nonzero(within[:, 1:] != within[:, :-1])
    leaving = within[rays, sample]
    near, far = radii[rays, sample], radii[rays, sample + 1]
    inner, outer = np.where(leaving, near, far), np.where(leaving, far, near)
    longest = float(np.abs(far - near).max(initial=BOUNDARY_TOLERANCE))
    for _ in range(int(np.ceil(np.log2(longest / BOUNDARY_TOLERANCE)))):
        middle = 0.5 * (inner + outer)
        keeps = space.within(space.points(middle, azimuths[rays]), levels[rays])
        inner, outer = np.where(keeps, middle, inner), np.where(keeps, outer, middle)
    limits = space.flags(space.points(outer, azimuths[rays]), levels[rays])
    return Crossings(rays, inner, leaving, limits)
