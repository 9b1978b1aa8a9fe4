"""The reachable part of a section: boundary, area, ranges, and the limits that bind.

Rays leave the centre of the section in equally spaced directions, and every crossing with the boundary is kept. So a
section may exclude its centre, have holes, or be crossed several times by a ray, and its area is still correct. If
each ray leaves the set once and never re-enters it, the section is called star-shaped, and its boundary is one closed
line; this holds for every section of the chapter's machine.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.extremes import extremes_of
from pm3dof_pin.maps.limit_space import Flags, LimitSpace
from pm3dof_pin.maps.rays import crossings
from pm3dof_pin.typing import Array


@dataclass(frozen=True, eq=False)
class WorkspaceSection:
    """The reachable part of a section.

    Boundary points are ordered by ray and, on a ray, by radius. Each lies within all limits, and within 1e-10 in
    radius of a pose that breaks one.
    """

    space: LimitSpace  #: coordinates and limits
    level: float  #: the third coordinate [m, rad]
    azimuths: Array  #: directions of the rays, equally spaced over the circle, shape=(n,) [rad]
    rays: NDArray[np.intp]  #: index of the ray of each boundary point, shape=(m,)
    radii: Array  #: distance of each boundary point from the centre, shape=(m,)
    leaving: NDArray[np.bool_]  #: whether the ray leaves the reachable set there or enters it, shape=(m,)
    limits: Flags  #: sums of the limits broken just across the boundary, shape=(m,)
    #: least and greatest first coordinate, then second, also found between the rays; NaN if the section is empty,
    #: shape=(2, 2) [m, rad]
    ranges: Array

    @property
    def empty(self) -> bool:
        """Whether no pose of the section is reachable."""
        return len(self.rays) == 0

    @property
    def star_shaped(self) -> bool:
        """Whether every ray starts within the limits and leaves them once: the boundary is then one closed line."""
        return bool(np.array_equal(self.rays, np.arange(len(self.azimuths))) and np.all(self.leaving))

    @property
    def points(self) -> Array:
        """Both coordinates of the boundary points, shape=(m, 2) [m, rad]."""
        return self.space.points(self.radii, self.azimuths[self.rays])

    @property
    def polar_points(self) -> Array:
        """(radius, azimuth, level) of the boundary points, shape=(m, 3)."""
        return np.stack([self.radii, self.azimuths[self.rays], np.full(len(self.rays), self.level)], axis=-1)

    @property
    def area(self) -> float:
        """Area of the section in the plane of both coordinates, in the product of their units."""
        signed = np.where(self.leaving, 0.5, -0.5) * self.radii**2
        return float(signed.sum() * 2.0 * np.pi / len(self.azimuths) * np.prod(self.space.scale))

    @property
    def limit_shares(self) -> dict[str, float]:
        """Share of the boundary points at which each limit binds; all zero if the section is empty."""
        return self.space.limit_shares(self.limits)


def workspace_section(space: LimitSpace, level: float | None = None, directions: int = 360) -> WorkspaceSection:
    """Find the reachable part of a section at a level [m, rad], by default in the middle of the searched range.

    Raises:
        InvalidValueError: the level is not finite, or there are fewer than 8 directions.
    """
    height = 0.5 * sum(space.level_range) if level is None else float(level)
    if not np.isfinite(height):
        raise InvalidValueError("level", level, "a finite number")
    return workspace_sections(space, np.array([height]), directions)[0]


def workspace_sections(
    space: LimitSpace, levels: Array, directions: int, *, ranges: bool = True
) -> list[WorkspaceSection]:
    """Find the reachable parts at n levels as :func:`workspace_section`; without ranges in half the time."""
    if directions < 8:
        raise InvalidValueError("directions", directions, "at least 8 rays")
    samples = np.linspace(0.0, space.reach, int(np.ceil(space.reach / space.ray_step)) + 1)
    azimuths = 2.0 * np.pi * np.arange(directions) / directions
    sections = [
        WorkspaceSection(space, float(level), azimuths, *found, np.full((2, 2), np.nan))
        for level, found in zip(levels, crossings(space, azimuths, levels, samples), strict=True)
    ]
    return _with_ranges(space, sections, 2.0 * np.pi / directions) if ranges else sections


def _with_ranges(space: LimitSpace, sections: list[WorkspaceSection], half_width: float) -> list[WorkspaceSection]:
    """Fill in the ranges of all sections at once: programs are faster on long arrays."""
    filled = [section for section in sections if not section.empty]
    if not filled:
        return sections
    ranges = iter(extremes_of(space, [section.polar_points for section in filled], half_width)[0])
    return [section if section.empty else replace(section, ranges=next(ranges)) for section in sections]
