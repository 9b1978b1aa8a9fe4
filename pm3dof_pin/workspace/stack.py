"""The whole reachable set as a stack of sections: range of heights, volume, greatest tilts."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.limits import Limit, broken_limits
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.typing import Array
from pm3dof_pin.workspace.extremes import extreme_tilts, refined_extremes, sampled_extremes, window
from pm3dof_pin.workspace.rays import poses_at
from pm3dof_pin.workspace.section import WorkspaceSection, boundary_points, limit_shares, workspace_sections

HEIGHT_TOLERANCE = 1e-10  # how near to the ends of the range of heights they are found [m]

_TILT_STEP = float(np.radians(2.5))  # grid on which the range of heights is looked for
_HEIGHT_STEP = 2e-3
_AZIMUTH_WINDOW = float(np.radians(6.0))


@dataclass(frozen=True, eq=False)
class Workspace:
    """The reachable set as a stack of sections.

    Attributes:
        height_range: least and greatest z_e of the reachable set, shape=(2,) [m].
        sections: sections in the order of growing height.
        tilt_ranges: least and greatest theta_x, then theta_y, found between the sections too, shape=(2, 2) [rad].
        tilt_range_heights: the heights at which they are reached, shape=(2, 2) [m].
    """

    height_range: Array
    sections: tuple[WorkspaceSection, ...]
    tilt_ranges: Array
    tilt_range_heights: Array

    @cached_property
    def heights(self) -> Array:
        """Heights of the sections, shape=(n,) [m]."""
        return np.array([section.z_e for section in self.sections])

    @cached_property
    def areas(self) -> Array:
        """Areas of the sections, shape=(n,) [rad^2]."""
        return np.array([section.area for section in self.sections])

    @property
    def volume(self) -> float:
        """Volume between the first and the last section, by the trapezoidal rule over the areas [rad^2 m]."""
        return float(np.sum(0.5 * (self.areas[1:] + self.areas[:-1]) * np.diff(self.heights)))

    @property
    def limit_shares(self) -> dict[Limit, float]:
        """Share of the boundary points of all sections at which each limit binds."""
        return limit_shares(np.concatenate([section.limits for section in self.sections]))


def workspace(tripod: Tripod, heights: int | ArrayLike = 61, directions: int = 360) -> Workspace:
    """Find the reachable set of the machine, section by section.

    Args:
        tripod: the machine.
        heights: number of sections, equally spaced over the whole range of heights, or the heights themselves,
            growing, shape=(n,) [m].
        directions: number of rays in each section.

    Raises:
        InvalidValueError: fewer than two heights, heights that are not finite and growing, or fewer than 8 directions.
        UnreachablePoseError: no pose at all, or none at the given heights, is within the limits.
    """
    low, high = height_range(tripod)
    stack = np.linspace(low, high, heights) if isinstance(heights, int) else np.asarray(heights, dtype=float)
    if stack.ndim != 1 or len(stack) < 2 or not np.all(np.isfinite(stack)) or np.any(np.diff(stack) <= 0.0):
        raise InvalidValueError("heights", heights, "at least two finite heights in growing order")
    sections = tuple(workspace_sections(tripod, stack, directions))
    boundary = np.concatenate([boundary_points(section) for section in sections])
    if len(boundary) == 0:
        raise UnreachablePoseError(f"no pose between z_e = {stack[0]:g} m and {stack[-1]:g} m is within the limits")
    rays = window(_AZIMUTH_WINDOW, float(np.diff(stack).max()))
    extremes = refined_extremes(tripod, sampled_extremes(boundary)[None], rays)[0]
    return Workspace(np.array([low, high]), sections, extreme_tilts(extremes), extremes[:, 2].reshape(2, 2))


def height_range(tripod: Tripod) -> tuple[float, float]:
    """Find the least and greatest z_e of the reachable set.

    Looked for over tilts on a grid of 2.5 deg that contains the level platform, and over heights in steps of 2 mm
    between the stops of the passive prismatic joint; then closed in by bisection to :data:`HEIGHT_TOLERANCE`.

    Raises:
        UnreachablePoseError: no pose of the grid is within the limits.
    """
    steps = int(tripod.parameters.universal_limit / _TILT_STEP)
    tilt = _TILT_STEP * np.arange(-steps, steps + 1)
    tilts = np.stack(np.meshgrid(tilt, tilt, indexing="ij"), axis=-1).reshape(-1, 2)
    lowest, highest = tripod.bounds[4:]
    heights = np.linspace(lowest, highest, int(np.ceil((highest - lowest) / _HEIGHT_STEP)) + 1)
    reachable = np.flatnonzero([_any_reachable(tripod, tilts, z_e) for z_e in heights])
    if len(reachable) == 0:
        raise UnreachablePoseError("no pose of the platform is within all joint limits: the workspace is empty")
    first, last = reachable[0], reachable[-1]
    low = _end_of_heights(tripod, tilts, heights[first], heights[max(first - 1, 0)])
    high = _end_of_heights(tripod, tilts, heights[last], heights[min(last + 1, len(heights) - 1)])
    return low, high


def _any_reachable(tripod: Tripod, tilts: Array, z_e: float) -> bool:
    return bool(np.any(broken_limits(tripod, poses_at(tilts, z_e)) == 0))


def _end_of_heights(tripod: Tripod, tilts: Array, inner: float, outer: float) -> float:
    while abs(outer - inner) > HEIGHT_TOLERANCE:
        middle = 0.5 * (inner + outer)
        inner, outer = (middle, outer) if _any_reachable(tripod, tilts, middle) else (inner, middle)
    return float(inner)
