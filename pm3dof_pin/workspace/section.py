"""The reachable tilts at one height: boundary, area, ranges, and which limit binds where.

Rays leave the level platform in equally spaced directions, and every crossing of the boundary is kept. So a section may
be without its centre, have holes, or be met several times by a ray, and its area is still right. Where each ray leaves
the set once and never comes back, the section is called star-shaped, and its boundary is one closed line; every section
of the chapter's machine is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.chapter.limits import Limit
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array
from pm3dof_pin.workspace.extremes import extreme_tilts, refined_extremes, sampled_extremes, window
from pm3dof_pin.workspace.rays import SCAN_STEP, crossings, tilts_at


@dataclass(frozen=True, eq=False)
class WorkspaceSection:
    """The reachable tilts at one height.

    Boundary points are ordered by ray and, on a ray, by radius. Each lies within all limits, no farther than 1e-10 rad
    from a tilt that breaks one.

    Attributes:
        z_e: the height [m].
        azimuths: directions of the rays from the theta_x axis, equally spaced over the circle, shape=(n,) [rad].
        rays: index of the ray of each boundary point, shape=(m,).
        radii: distance of each boundary point from the level platform, shape=(m,) [rad].
        leaving: whether the ray leaves the reachable set there or enters it, shape=(m,).
        limits: sums of :class:`~pm3dof_pin.chapter.limits.Limit` broken just across the boundary, shape=(m,).
        tilt_ranges: least and greatest theta_x, then theta_y, found between the rays too; NaN if the section is empty,
            shape=(2, 2) [rad].
    """

    z_e: float
    azimuths: Array
    rays: NDArray[np.intp]
    radii: Array
    leaving: NDArray[np.bool_]
    limits: NDArray[np.uint8]
    tilt_ranges: Array

    @property
    def empty(self) -> bool:
        """Whether no tilt is reachable at this height."""
        return len(self.rays) == 0

    @property
    def star_shaped(self) -> bool:
        """Whether every ray starts within the limits and leaves them once: the boundary is then one closed line."""
        return bool(np.array_equal(self.rays, np.arange(len(self.azimuths))) and np.all(self.leaving))

    @property
    def tilts(self) -> Array:
        """(theta_x, theta_y) of the boundary points, shape=(m, 2) [rad]."""
        return tilts_at(self.radii, self.azimuths[self.rays])

    @property
    def area(self) -> float:
        """Area of the section in the plane of tilts, the integral of r^2 / 2 over the directions [rad^2]."""
        signed = np.where(self.leaving, 0.5, -0.5) * self.radii**2
        return float(signed.sum() * 2.0 * np.pi / len(self.azimuths))

    @property
    def limit_shares(self) -> dict[Limit, float]:
        """Share of the boundary points at which each limit binds; all zero if the section is empty."""
        return limit_shares(self.limits)


def workspace_section(tripod: Tripod, z_e: float | None = None, directions: int = 360) -> WorkspaceSection:
    """Find the reachable tilts at one height.

    Args:
        tripod: the machine.
        z_e: height [m]; by default the middle height, the section of Table 8.3.
        directions: number of rays.

    Raises:
        InvalidValueError: the height is not finite, or there are fewer than 8 directions.
    """
    height = tripod.middle_height if z_e is None else float(z_e)
    if not np.isfinite(height):
        raise InvalidValueError("z_e", z_e, "a finite height in metres")
    return workspace_sections(tripod, np.array([height]), directions)[0]


def workspace_sections(tripod: Tripod, heights: Array, directions: int) -> list[WorkspaceSection]:
    """Find the reachable tilts at each of several heights, shape=(n,) [m]; as :func:`workspace_section` n times."""
    if directions < 8:
        raise InvalidValueError("directions", directions, "at least 8 rays")
    outside = 1.001 * np.sqrt(2.0) * tripod.parameters.universal_limit  # beyond both angles of the platform's joint
    samples = np.linspace(0.0, outside, int(np.ceil(outside / SCAN_STEP)) + 1)
    azimuths = 2.0 * np.pi * np.arange(directions) / directions
    sections = []
    for z_e in heights:
        found = crossings(tripod, azimuths, np.full(directions, z_e), samples)
        sections.append(WorkspaceSection(float(z_e), azimuths, *found, np.full((2, 2), np.nan)))
    return _with_ranges(tripod, sections, 2.0 * np.pi / directions)


def boundary_points(section: WorkspaceSection) -> Array:
    """Return (radius, azimuth, z_e) of the boundary points, shape=(m, 3) [rad, rad, m]."""
    return np.stack([section.radii, section.azimuths[section.rays], np.full(len(section.rays), section.z_e)], axis=-1)


def limit_shares(limits: NDArray[np.uint8]) -> dict[Limit, float]:
    """Return the share of each limit in sums of limits; where several bind, each counts in equal parts.

    Args:
        limits: sums of :class:`~pm3dof_pin.chapter.limits.Limit`, shape=(m,).
    """
    bits = np.stack([(limits & limit) != 0 for limit in Limit], axis=-1)
    parts = bits / np.maximum(bits.sum(axis=-1, keepdims=True), 1)
    return dict(zip(Limit, (parts.sum(axis=0) / max(len(limits), 1)).tolist(), strict=True))


def _with_ranges(tripod: Tripod, sections: list[WorkspaceSection], half_width: float) -> list[WorkspaceSection]:
    """Fill in the ranges of all sections at once: the kernels like long arrays."""
    filled = [section for section in sections if not section.empty]
    if not filled:
        return sections
    starts = np.stack([sampled_extremes(boundary_points(section)) for section in filled])
    ranges = iter(extreme_tilts(refined_extremes(tripod, starts, window(half_width))))
    return [section if section.empty else replace(section, tilt_ranges=next(ranges)) for section in sections]
