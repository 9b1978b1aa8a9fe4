"""The reachable set over coordinates as a stack of sections: ranges, volume, and the limits that bind."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import with_neighbours
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.maps.extremes import extremes_of
from pm3dof_pin.maps.labels import coordinate_attributes, dataset_attributes, flag_attributes, flag_type
from pm3dof_pin.maps.limit_space import LimitSpace
from pm3dof_pin.maps.rays import Index, explored
from pm3dof_pin.maps.workspace_section import WorkspaceSection, workspace_sections
from pm3dof_pin.typing import Array, Mask

if TYPE_CHECKING:
    import xarray as xr

LEVEL_TOLERANCE = 1e-10  # accuracy of the ends of the range of levels

_PLANE_STEPS = 2.5  # steps along a ray per step of the grid on which the range of levels is searched
_AZIMUTH_WINDOW = float(np.radians(6.0))
_LEAST_LEVELS = 2


@dataclass(frozen=True, eq=False)
class Workspace:
    """The reachable set as a stack of sections."""

    space: LimitSpace  #: coordinates and limits
    level_range: Array  #: least and greatest third coordinate of the reachable set, shape=(2,) [m, rad]
    sections: tuple[WorkspaceSection, ...]  #: sections by increasing level; a single one for two coordinates
    #: least and greatest first coordinate, then second, also found between the sections, shape=(2, 2) [m, rad]
    ranges: Array
    range_levels: Array  #: the levels at which they are reached, shape=(2, 2) [m, rad]

    @cached_property
    def levels(self) -> Array:
        """Levels of the sections, shape=(n,) [m, rad]."""
        return np.array([section.level for section in self.sections])

    @cached_property
    def areas(self) -> Array:
        """Areas of the sections, shape=(n,), in the product of both units."""
        return np.array([section.area for section in self.sections])

    @property
    def volume(self) -> float:
        """Volume between the first and the last section, by the trapezoidal rule over the areas."""
        return float(np.sum(0.5 * (self.areas[1:] + self.areas[:-1]) * np.diff(self.levels)))

    @property
    def limit_shares(self) -> dict[str, float]:
        """Share of the boundary points of all sections at which each limit binds."""
        return self.space.limit_shares(np.concatenate([section.limits for section in self.sections]))

    def boundary(self) -> xr.Dataset:
        """Return the boundary points of all sections over `point`: their coordinates [m, rad] and `binding_limits`.

        The latter are sums of the limits that bound the reachable set there.
        """
        import xarray as xr

        space = self.space
        points = np.concatenate([section.points for section in self.sections])
        levels = np.repeat(self.levels, [len(section.rays) for section in self.sections])
        limits = np.concatenate([section.limits for section in self.sections]).astype(flag_type(space.limits))
        columns = np.column_stack([points, levels])[:, : len(space.names)]
        return xr.Dataset(
            {"binding_limits": ("point", limits, flag_attributes(space.limits, "limits that end the reachable set"))},
            coords={
                name: ("point", column, coordinate_attributes(name, unit, space.machine))
                for name, unit, column in zip(space.names, space.units, columns.T, strict=True)
            },
            attrs=dataset_attributes(f"Boundary of the workspace of {space.machine} under its limits", space.machine),
        )


def workspace(space: LimitSpace, levels: int | ArrayLike = 61, directions: int = 360) -> Workspace:
    """Find the reachable set in sections: a number of equally spaced ones, or at increasing levels [m, rad].

    Raises:
        InvalidValueError: fewer than two levels, levels not finite and increasing, or fewer than 8 directions.
        UnreachablePoseError: no pose at all, or none at the given levels, is within the limits.
    """
    if not space.stacked:
        return _of_one_section(space, directions)
    low, high = level_range(space)
    stack = np.linspace(low, high, levels) if isinstance(levels, int) else np.asarray(levels, dtype=float)
    if stack.ndim != 1 or len(stack) < _LEAST_LEVELS or not np.all(np.isfinite(stack)) or np.any(np.diff(stack) <= 0.0):
        raise InvalidValueError("levels", levels, "at least two finite, increasing numbers")
    sections = tuple(workspace_sections(space, stack, directions))
    boundary = np.concatenate([section.polar_points for section in sections])
    if len(boundary) == 0:
        name, unit = space.names[2], space.units[2]
        place = f"{name} = {stack[0]:g} {unit} and {stack[-1]:g} {unit}"
        raise UnreachablePoseError(f"no pose between {place} is within the limits")
    ranges, at = extremes_of(space, [boundary], _AZIMUTH_WINDOW, float(np.diff(stack).max()))
    return Workspace(space, np.array([low, high]), sections, ranges[0], at[0])


def _of_one_section(space: LimitSpace, directions: int) -> Workspace:
    (section,) = workspace_sections(space, np.zeros(1), directions)
    if section.empty:
        raise UnreachablePoseError(f"no pose of {space.machine} is within all limits: the workspace is empty")
    return Workspace(space, np.zeros(2), (section,), section.ranges, np.zeros((2, 2)))


def level_range(space: LimitSpace) -> tuple[float, float]:
    """Find the least and greatest third coordinate of the reachable set; UnreachablePoseError if the set is empty.

    Searched over a grid of the other two that contains the centre of the sections, and over levels in steps, then
    refined by bisection to :data:`LEVEL_TOLERANCE`.
    """
    steps = int(space.reach / (_PLANE_STEPS * space.ray_step))
    offsets = _PLANE_STEPS * space.ray_step * np.arange(-steps, steps + 1)
    plane = space.centre + space.scale * np.stack(np.meshgrid(offsets, offsets, indexing="ij"), axis=-1)
    lowest, highest = space.level_range
    levels = np.linspace(lowest, highest, int(np.ceil((highest - lowest) / space.level_step)) + 1)

    def within(index: Index) -> Mask:
        level, *place = index
        return space.within(plane[tuple(place)], levels[level])

    found = explored(within, (len(levels), *plane.shape[:2]), first=steps)
    reachable = np.flatnonzero(found.any(axis=(1, 2)))
    if len(reachable) == 0:
        raise UnreachablePoseError(f"no pose of {space.machine} is within all limits: the workspace is empty")
    ends = []
    for last, beyond in ((reachable[0], max(reachable[0] - 1, 0)), (reachable[-1], reachable[-1] + 1)):
        points = plane[with_neighbours(found[last])]  # a slanting set may end outside its section at this level
        ends.append(_end_of_levels(space, points, levels[last], levels[min(beyond, len(levels) - 1)]))
    return ends[0], ends[1]


def _end_of_levels(space: LimitSpace, points: Array, inner: float, outer: float) -> float:
    while abs(outer - inner) > LEVEL_TOLERANCE:
        middle = 0.5 * (inner + outer)
        reachable = space.within(points, middle)
        if reachable.any():
            inner, points = middle, points[reachable]
        else:
            outer = middle
    return float(inner)
