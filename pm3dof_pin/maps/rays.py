"""Rays in sections of the reachable set, and their crossings with its boundary.

A ray leaves the centre of a section in the direction of one azimuth, see
:class:`~pm3dof_pin.maps.limit_space.LimitSpace`. Solvers take longest for poses out of reach. So a grid of poses is
first checked at coarse points, and from there only as far as the reachable set and one step beyond.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.arrays import with_neighbours
from pm3dof_pin.maps.limit_space import Flags, LimitSpace
from pm3dof_pin.typing import Array, Mask

BOUNDARY_TOLERANCE = 1e-10  # distance in radius from the boundary at which a crossing is accepted


class _Crossings(NamedTuple):
    """Crossings of rays with the boundary, ordered by ray and, on a ray, by radius; each field has shape=(m,)."""

    rays: NDArray[np.intp]
    radii: Array  #: radii of the points just within the limits
    leaving: NDArray[np.bool_]  #: whether the ray leaves the reachable set there or enters it
    limits: Flags  #: sums of the limits broken just across the boundary


class _Brackets(NamedTuple):
    """Neighbouring samples of rays, within the limits and outside, ordered by ray and, on a ray, by radius."""

    rays: NDArray[np.intp]
    inner: Array
    outer: Array


Index: TypeAlias = tuple[NDArray[np.intp], ...]

Contenders: TypeAlias = Callable[[NDArray[np.intp], Array, Array], Mask]
"""Function from rays, inner and outer radii to a mask of the crossings still of interest."""

_COARSE = 3  # every third point along each dimension of a grid is checked first


def explored(
    within: Callable[[tuple[NDArray[np.intp], ...]], Mask],
    shape: tuple[int, ...],
    *,
    first: int = 0,
    ring: bool = False,
) -> Mask:
    """Tell which points of a grid are within the limits, checking few of the others.

    Every third point along each dimension is checked (from `first` on along the last two), then the neighbours of
    points found within, until there are none left. A part of the set between those points, disconnected from the rest,
    may be missed, unless it is the whole set. With `ring`, the second to last dimension is periodic.
    """
    found, checked = np.zeros(shape, dtype=bool), np.zeros(shape, dtype=bool)
    unchecked = np.zeros(shape, dtype=bool)
    unchecked[..., first % _COARSE :: _COARSE, first % _COARSE :: _COARSE] = True
    unchecked[np.arange(shape[0]) % _COARSE != 0] = False
    closed = len(shape) - 2 if ring else None
    while unchecked.any():
        found[unchecked] = within(np.nonzero(unchecked))
        checked |= unchecked
        unchecked = with_neighbours(found, closed=closed) & ~checked if found.any() else ~checked
    return found


def crossings(space: LimitSpace, azimuths: Array, levels: Array, samples: Array) -> list[_Crossings]:
    """Check the limits along rays at increasing radii; bisect changes down to :data:`BOUNDARY_TOLERANCE`.

    Rays point in all azimuths [rad] at all levels [m, rad]; returns one result per level. A part of the set, or of its
    outside, that is thinner than the spacing of the samples may be missed.
    """

    def within(index: Index) -> Mask:
        level, ray, sample = index
        return space.within(space.points(samples[sample], azimuths[ray]), levels[level])

    count = len(azimuths)
    inside = explored(within, (len(levels), count, len(samples)), ring=True).reshape(-1, len(samples))
    all_azimuths, all_levels = np.tile(azimuths, len(levels)), np.repeat(levels, count)
    found = brackets(inside, np.broadcast_to(samples, inside.shape))
    leaving = found.inner < found.outer
    rays, inner, outer = closed_in(space, all_azimuths, all_levels, found)
    limits = space.flags(space.points(outer, all_azimuths[rays]), all_levels[rays])
    of_levels = np.split(np.arange(len(rays)), np.searchsorted(rays, count * np.arange(1, len(levels))))
    return [_Crossings(rays[part] % count, inner[part], leaving[part], limits[part]) for part in of_levels]


def brackets(within: Mask, radii: Array) -> _Brackets:
    """Return where neighbouring samples of rays differ, given masks and increasing radii, shape=(n, k)."""
    rays, sample = np.nonzero(within[:, 1:] != within[:, :-1])
    leaving = within[rays, sample]
    near, far = radii[rays, sample], radii[rays, sample + 1]
    return _Brackets(rays, np.where(leaving, near, far), np.where(leaving, far, near))


def closed_in(
    space: LimitSpace, azimuths: Array, levels: Array, start: _Brackets, contenders: Contenders | None = None
) -> _Brackets:
    """Bisect crossings, or only the contenders among them, down to :data:`BOUNDARY_TOLERANCE`."""
    rays, inner, outer = start
    longest = float(np.abs(outer - inner).max(initial=BOUNDARY_TOLERANCE))
    for _ in range(int(np.ceil(np.log2(longest / BOUNDARY_TOLERANCE)))):
        if contenders is not None:
            follow = contenders(rays, inner, outer)
            rays, inner, outer = rays[follow], inner[follow], outer[follow]
        middle = 0.5 * (inner + outer)
        keeps = space.within(space.points(middle, azimuths[rays]), levels[rays])
        inner, outer = np.where(keeps, middle, inner), np.where(keeps, outer, middle)
    return _Brackets(rays, inner, outer)
