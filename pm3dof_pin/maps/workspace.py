"""The reachable set over one to three coordinates: ranges, sections, volume, surface, and the limits that bind.

The limits are checked on a dense grid. Contours (contourpy) and surfaces (marching cubes of scikit-image) between the
poses within the limits and those beyond say which sides of cells the boundary crosses; bisection finds where. So the
set may have any shape, with holes and several parts; parts thinner than a cell may be missed.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import REACH
from pm3dof_pin.maps.datasets import NamedArray, NamedArrays, coordinate_attributes, dataset_attributes, flag_variable
from pm3dof_pin.maps.limit_space import Flags, LimitSpace, nodes
from pm3dof_pin.typing import Array, Mask, Vector

BRANCH = "branch"
"""Name of the limit that a pose is on another branch, behind a singular one."""

_SEARCH_POINTS = 33  # along each coordinate of the first grid
_MAX_SEARCHES = 24
_MAX_POINTS = 200  # of a search for a small set
_MAX_DISTANCE = 12.0  # size of the set, relative to the first box, at which it counts as endless
_TOLERANCE = 1e-9  # of an extreme, relative to the size of the set
_SECTION_TOLERANCE = 1e-5  # of the extremes of one section
_PATCH = {1: 25, 2: 13}  # points along each side of the patch in which an extreme is searched, by its dimensions
_COARSE_PATCH = {1: 7, 2: 5}  # for robots that no program solves, whose extremes are coarser too
_COARSER = 1e4
_HALVINGS = 7  # per patch
_LEAST_MOVE = 2.0**-14  # of the farthest
_BOUNDARY_HALVINGS, _FEW_HALVINGS = 12, 7  # of the side of a cell
_FEWEST_DIRECTIONS = 8
_ROUND_LEVELS = 8
_INTERVAL_POINTS, _PRECISE = 4001, 32  # over a single coordinate: points, and halvings of a step at an end


@dataclass(frozen=True, eq=False)
class WorkspaceSection:
    """The reachable part of a section: closed lines around its parts (anticlockwise) and its holes (clockwise).

    Points of the lines are within all limits, and just across the boundary some limit is broken.
    """

    space: LimitSpace  #: coordinates and limits
    level: float  #: the third coordinate [m, rad]
    lines: tuple[Array, ...]  #: points of each line, without repeating the first, shape=(m, 2) each [m, rad]
    limits: tuple[Flags, ...]  #: sums of the limits broken just across the boundary at each point
    #: least and greatest first coordinate, then second; NaN if the section is empty, shape=(2, 2) [m, rad]
    ranges: Array

    @property
    def empty(self) -> bool:
        """Whether no pose of the section is reachable, or fewer than a cell."""
        return not self.lines

    @property
    def points(self) -> Array:
        """Both coordinates of the boundary points, shape=(m, 2) [m, rad]."""
        return np.concatenate([np.empty((0, 2)), *self.lines])

    @property
    def area(self) -> float:
        """Area of the section in the plane of both coordinates, in the product of their units."""
        return sum(map(_area, self.lines))

    @property
    def limit_shares(self) -> dict[str, float]:
        """Share of the boundary's length at which each limit binds, coordinates relative to the section's ranges.

        Where several bind, each counts in part. All zero if the section is empty.
        """
        shares, scale = np.zeros(len(self.space.limits)), np.maximum(np.ptp(self.ranges, axis=1), 1e-12)
        for line, limits in zip(self.lines, self.limits, strict=True):
            sides = np.linalg.norm((np.roll(line, -1, axis=0) - line) / scale, axis=1)
            bits = (limits[:, None] & (1 << np.arange(len(shares)))) != 0
            shares += (sides + np.roll(sides, 1)) @ (bits / np.maximum(bits.sum(axis=1, keepdims=True), 1))
        return dict(zip(self.space.limits, (shares / (shares.sum() or 1.0)).tolist(), strict=True))


class Surface(NamedTuple):
    """Triangles of the boundary of a reachable set over three coordinates, anticlockwise from outside."""

    points: Array  #: just within the limits, shape=(p, 3) [m, rad]
    triangles: NDArray[np.intp]  #: indices of points, shape=(t, 3)
    limits: Flags  #: sums of the limits broken just across the boundary at the points, shape=(p,)


@dataclass(frozen=True, eq=False)
class Workspace:
    """The reachable set as a stack of sections."""

    space: LimitSpace  #: coordinates and limits
    level_range: Array  #: least and greatest third coordinate of the reachable set, shape=(2,) [m, rad]
    sections: tuple[WorkspaceSection, ...]  #: sections by increasing level; a single one for two coordinates
    ranges: Array  #: least and greatest first coordinate, then second, of the whole set, shape=(2, 2) [m, rad]
    range_levels: Array  #: the levels at which they are reached, shape=(2, 2) [m, rad]
    sections_at: Callable[[Array], Sequence[WorkspaceSection]]  #: finds sections at other levels

    @cached_property
    def levels(self) -> Array:
        """Levels of the sections, shape=(n,) [m, rad]."""
        return np.array([section.level for section in self.sections])

    @cached_property
    def areas(self) -> Array:
        """Areas of the sections, shape=(n,), in the product of both units."""
        return np.array([section.area for section in self.sections])

    @cached_property
    def outlines(self) -> Sequence[WorkspaceSection]:
        """Sections at round levels, for drawing; none if there are two coordinates, or the set is flat."""
        if not self.space.stacked or not np.ptp(self.level_range) > 0.0:
            return ()
        return self.sections_at(_round_levels(self.level_range, self.space.units[2]))

    @property
    def volume(self) -> float:
        """Volume between the first and the last section, by the trapezoidal rule over the areas."""
        return float(np.sum(0.5 * (self.areas[1:] + self.areas[:-1]) * np.diff(self.levels)))

    @property
    def limit_shares(self) -> dict[str, float]:
        """Share of the boundary at which each limit binds, averaged over the sections."""
        shares = [section.limit_shares for section in self.sections if not section.empty]
        total = sum(map(sum, (share.values() for share in shares))) or 1.0
        return {name: sum(share[name] for share in shares) / total for name in self.space.limits}

    def surface(self, count: int = 44) -> Surface:
        """Return the boundary over three coordinates, found on a grid of so many cells along each.

        Raises:
            InvalidValueError: there are two coordinates.
            UnreachablePoseError: the set is thinner than a cell everywhere.
        """
        if not self.space.stacked:
            raise InvalidValueError("coordinates", ", ".join(self.space.names), "three, for a surface")
        from skimage.measure import marching_cubes

        cells = max(round(count * self.space.density), 8)
        axes = [_padded(low, high, cells) for low, high in (*self.ranges, self.level_range)]
        inside = self.space.within_grid(axes)
        if not inside.any():
            raise UnreachablePoseError(f"the workspace of {self.space.machine} is too thin for a surface")
        solid = np.pad(inside, 1).astype(np.float32)
        places, faces, _, _ = marching_cubes(solid, 0.5)  # type: ignore[no-untyped-call]

        def node(index: Array) -> Array:
            return np.column_stack([a[0] + (a[1] - a[0]) * column for a, column in zip(axes, index.T, strict=True)])

        points, limits = _crossings(self.space, node, inside, places - 1.0)
        return Surface(points, np.asarray(faces[:, ::-1], dtype=np.intp), limits)

    def boundary(self) -> NamedArrays:
        """Return the boundary points of all sections over `point`: their coordinates [m, rad] and `binding_limits`.

        The latter are sums of the limits that bound the reachable set there.
        """
        space = self.space
        points = np.concatenate([section.points for section in self.sections])
        levels = np.repeat(self.levels, [len(section.points) for section in self.sections])
        limits = np.concatenate([np.empty(0), *(part for s in self.sections for part in s.limits)])
        columns = np.column_stack([points, levels])[:, : len(space.names)]
        binding = flag_variable(("point",), limits, space.limits, "limits that end the reachable set")
        return NamedArrays(
            {"binding_limits": binding},
            {
                name: NamedArray(("point",), column, coordinate_attributes(name, unit, space.machine))
                for name, unit, column in zip(space.names, space.units, columns.T, strict=True)
            },
            dataset_attributes(f"Boundary of the workspace of {space.machine} under its limits", space.machine),
        )


def workspace(space: LimitSpace, levels: int | ArrayLike = 61, directions: int = 360) -> Workspace:
    """Find the reachable set in sections: a number of equally spaced ones, or at increasing levels [m, rad].

    Sections have about as many boundary points as there are `directions`.

    Raises:
        InvalidValueError: fewer than two levels, levels not finite and increasing, fewer than 8 directions, or a set
            that has no end.
        UnreachablePoseError: no pose at all, or none at the given levels, is within the limits.
    """
    if directions < _FEWEST_DIRECTIONS:
        raise InvalidValueError("directions", directions, f"at least {_FEWEST_DIRECTIONS} boundary points")
    given = np.zeros(1) if not space.stacked or isinstance(levels, int) else np.asarray(levels, dtype=float)
    if space.stacked and (
        (isinstance(levels, int) and levels < 2)
        or (not isinstance(levels, int) and (given.ndim != 1 or len(given) < 2))
        or not np.all(np.isfinite(given))
        or np.any(np.diff(given) <= 0.0)
    ):
        raise InvalidValueError("levels", levels, "at least two finite, increasing numbers")
    inside, cell = _search(space)
    ends, places = _extents(space, inside, cell)
    level_range = ends[2] if space.stacked else np.zeros(2)
    if space.stacked and isinstance(levels, int):
        given = np.linspace(level_range[0], level_range[1], levels)

    def sections_at(levels: Array) -> Sequence[WorkspaceSection]:
        return _sections(space, levels, inside, cell, directions)

    sections = tuple(sections_at(given))
    if space.stacked and all(section.empty for section in sections):
        name, unit = space.names[2], space.units[2]
        place = f"{name} = {given[0]:g} {unit} and {given[-1]:g} {unit}"
        raise UnreachablePoseError(f"no pose between {place} is within the limits")
    range_levels = places[:2, :, 2] if space.stacked else np.zeros((2, 2))
    return Workspace(space, level_range, sections, ends[:2], range_levels, sections_at)


def _round_levels(ends: ArrayLike, unit: str) -> Array:
    """Return the levels between two that are round numbers of metres or degrees, at most eight [m, rad]."""
    factor = np.degrees(1.0) if unit == "rad" else 1.0
    low, high = factor * np.asarray(ends, dtype=float)
    size = high - low
    steps = (
        digit * 10.0**power for power in range(math.floor(math.log10(size)) - 1, 99) for digit in (1.0, 2.0, 2.5, 5.0)
    )
    step = next(step for step in steps if size / step <= _ROUND_LEVELS)
    whole = np.arange(math.ceil(low / step), math.floor(high / step) + 1)
    values = whole * step
    inside = (values > low + 0.02 * size) & (values < high - 0.02 * size)
    return np.asarray(values[inside] / factor)


class Interval(NamedTuple):
    """A part of the reachable set over a single coordinate."""

    ends: tuple[float, float]  #: [m, rad]
    limits: tuple[tuple[str, ...], tuple[str, ...]]  #: that are broken just beyond each end


def reachable_intervals(space: LimitSpace) -> list[Interval]:
    """Find the reachable set over a single coordinate, in increasing order.

    Raises:
        InvalidValueError: the space has more coordinates, or the set has no end.
        UnreachablePoseError: no pose is within the limits.
    """
    if len(space.names) != 1:
        raise InvalidValueError("coordinates", ", ".join(space.names), "a single one")
    inside, cell = _search(space)
    first, last = (float(end) for end in (inside.min() - cell[0], inside.max() + cell[0]))
    nodes = np.linspace(first, last, round(_INTERVAL_POINTS * space.density))[:, None]
    within = space.within(nodes)
    edges = np.flatnonzero(within[1:] != within[:-1])
    ends, flags = _crossings(
        space, lambda index: nodes[index[:, 0].astype(int)], within, 0.5 + edges[:, None].astype(float), _PRECISE
    )
    broken = [tuple(name for bit, name in enumerate(space.limits) if flag >> bit & 1) for flag in flags.tolist()]
    values = ends[:, 0].tolist()
    return [Interval((values[k], values[k + 1]), (broken[k], broken[k + 1])) for k in range(0, len(values), 2)]


def spaces_by_branch(space: LimitSpace) -> dict[int, LimitSpace]:
    """Divide a space that has all branches into one for each branch found in it, by number, home's first.

    Another branch is the limit :data:`BRANCH` of each.
    """
    judged = space.branches
    if judged is None:
        raise InvalidValueError("space", space.machine, "robot_space(..., all_branches=True)")
    inside, cell = _search(space)
    numbers, beyond = judged(inside)[1], np.uint32(1 << len(space.limits))

    def apart(number: int) -> LimitSpace:
        def broken_limits(points: Array) -> Flags:
            flags, branches = judged(points)
            return np.asarray(np.where((flags == 0) & (branches != number), beyond, flags))

        own = inside[numbers == number]
        box = np.stack([own.min(axis=0) - cell, own.max(axis=0) + cell], axis=-1)
        limits = (*space.limits, BRANCH)
        return replace(
            space,
            limits=limits,
            broken_limits=broken_limits,
            box=box,
            start=own[len(own) // 2],
            branches=None,
            over_grid=None,
        )

    return {number: apart(number) for number in np.unique(numbers).tolist()}


def workspace_section(space: LimitSpace, level: float, directions: int = 360) -> WorkspaceSection:
    """Find the reachable part of a section at a level [m, rad], with about as many boundary points as `directions`.

    Raises:
        InvalidValueError: the level is not finite, or there are fewer than 8 directions.
    """
    if not np.isfinite(level):
        raise InvalidValueError("level", level, "a finite number")
    if directions < _FEWEST_DIRECTIONS:
        raise InvalidValueError("directions", directions, f"at least {_FEWEST_DIRECTIONS} boundary points")
    return _sections(space, np.array([level], dtype=float), *_search(space), directions)[0]


def _extents(space: LimitSpace, inside: Array, cell: Array) -> tuple[Array, Array]:
    """Return the least and greatest value of each coordinate, shape=(d, 2), and the poses there, shape=(d, 2, d)."""
    starts = np.stack([inside[[np.argmin(column), np.argmax(column)]] for column in inside.T])
    d = len(cell)
    axes, sides = np.repeat(np.arange(d), 2), np.tile([-1.0, 1.0], d)
    places = _extremes(space, starts.reshape(-1, d), axes, sides, np.arange(d), cell, _TOLERANCE)
    return places[np.arange(2 * d), axes].reshape(d, 2), places.reshape(d, 2, d)


def _search(space: LimitSpace) -> tuple[Array, Array]:
    """Return poses of a grid within the limits, shape=(n, d), and its cell; the grid is as wide as the set.

    Raises:
        UnreachablePoseError: there are none.
        InvalidValueError: the set has no end.
    """
    fewest, box = max(9, round(_SEARCH_POINTS * space.density)), space.box
    count = fewest
    widest = _MAX_DISTANCE * np.ptp(box, axis=1)
    for _ in range(_MAX_SEARCHES):
        axes = [np.linspace(low, high, count) for low, high in box]
        inside, cell = nodes(axes)[space.within_grid(axes)], np.ptp(box, axis=1) / (count - 1)
        if space.within(space.start):
            inside = np.vstack([inside, space.start])
        if not len(inside):
            if count == fewest and space.limits[0] == "reach" and space.broken_limits(space.start) & 1:
                break  # not even home is in reach
            count = 2 * count - 1
            if count ** len(box) > _MAX_POINTS**3 * space.density:
                break
            continue
        low, high = inside.min(axis=0), inside.max(axis=0)
        wide = np.stack([low < box[:, 0] + 0.5 * cell, high > box[:, 1] - 0.5 * cell], axis=-1)
        if np.any(np.ptp(box, axis=1) > widest):
            expected = f"coordinates of {space.machine} that joint limits or its reach bound (--coordinate)"
            raise InvalidValueError("coordinates", ", ".join(space.names), expected)
        if wide.any():
            box = box + 0.5 * np.ptp(box, axis=1)[:, None] * np.where(wide, [-1.0, 1.0], 0.0)
            continue
        tight = np.stack([low - cell, high + cell], axis=-1)
        if np.all(np.ptp(tight, axis=1) > 0.5 * np.ptp(box, axis=1)):
            return inside, cell
        box = tight
    raise UnreachablePoseError(f"no pose of {space.machine} is within all limits: the workspace is empty")


def _extremes(
    space: LimitSpace,
    starts: Array,
    axes: NDArray[np.intp],
    sides: Array,
    free: ArrayLike,
    cell: Array,
    tolerance: float,
) -> Array:
    """Move poses of a set, shape=(m, d), to its extremes near them: along one axis each, down or up.

    Around each pose, a patch across its axis is moved along the axis by bisection as far as any of its points stays in
    the set. It then surrounds the last of them, and shrinks unless that was at its edge. If it does not, it is moved
    once more the way that the pose took, up to twice as far as such a move came last, so that it does not creep along
    ridges and into cusps. Coordinates that are not free do not change.
    """
    best, q = starts.copy(), space.within_from(starts, np.full((len(starts), space.nq), np.nan))[1]
    moved = np.flatnonzero(np.isin(np.arange(starts.shape[1]), free))
    d = len(moved) - 1
    side = np.linspace(-1.0, 1.0, (_PATCH if space.density == 1.0 else _COARSE_PATCH)[d])
    square = np.stack(np.meshgrid(*[side] * d, indexing="ij"), axis=-1).reshape(-1, d)
    at_edge = np.abs(square).max(axis=1) == 1.0
    offsets = np.zeros((len(starts), len(square), starts.shape[1]))
    for row, axis in zip(offsets, axes, strict=True):
        row[:, moved[moved != axis]] = square * cell[moved[moved != axis]]
    steps = np.zeros_like(starts)
    steps[np.arange(len(starts)), axes] = sides * cell[axes]
    size = np.full(len(starts), 2.0)
    length, former = size.copy(), best.copy()  # of such moves
    smallest = tolerance * _SEARCH_POINTS if space.density == 1.0 else min(_COARSER * tolerance * _SEARCH_POINTS, 0.05)
    while (active := np.flatnonzero(size > smallest)).size:
        patch = best[active, None] + size[active, None, None] * offsets[active]
        here, low, chosen, there = _pushed(space, patch, steps[active], size[active], cell, q[active])
        creeps = (low > 0.0) & (at_edge[chosen] | (low > 0.5 * size[active]))
        size[active[~creeps]] *= 0.5
        best[active[low > 0.0]], q[active[low > 0.0]] = here[low > 0.0], there[low > 0.0]
        active, here = active[creeps], here[creeps]
        way = here - former[active]
        way /= np.abs(way / cell)[np.arange(len(active)), axes[active], None]
        former[active] = here
        patch = here[:, None] + size[active, None, None] * offsets[active]
        here, low, _, there = _pushed(space, patch, way, length[active], cell, q[active])
        best[active[low > 0.0]], q[active[low > 0.0]] = here[low > 0.0], there[low > 0.0]
        length[active] = np.maximum(2.0 * low, size[active])
    return best


def _pushed(
    space: LimitSpace, patches: Array, steps: Array, lengths: Array, cell: Array, near: Array
) -> tuple[Array, Vector, NDArray[np.intp], Array]:
    """Move patches, shape=(m, k, d), as far as any of their points stays in the set.

    Configurations are found from those near the patches, shape=(m, nq). Returns the points in the middle of those that
    stay, shape=(m, d), how far they came in steps of the patches, at most the lengths and 0 if none stays, and their
    numbers, shape=(m,) each; and the configurations there, shape=(m, nq).
    """
    q = np.repeat(near[:, None], patches.shape[1], axis=1)
    alive = np.ones(patches.shape[:2], dtype=bool)
    low, high = np.zeros(len(patches)), lengths
    middle = _LEAST_MOVE * high  # points that stay behind at once are not tried farther
    for _ in range(_HALVINGS):
        owner, place = np.nonzero(alive & (high > 0.0)[:, None])
        if not owner.size:
            break
        inside, there = np.zeros_like(alive), q.copy()
        points = patches[owner, place] + middle[owner, None] * steps[owner]
        inside[owner, place], there[owner, place] = space.within_from(points, q[owner, place])
        farther = inside.any(axis=1)
        q[inside] = there[inside]
        alive[farther] = inside[farther]
        high = np.where(farther, high, np.where(low > 0.0, middle, 0.0))
        low = np.where(farther, middle, low)
        middle = 0.5 * (low + high)
    centre = np.sum(patches * alive[..., None], axis=1) / alive.sum(axis=1)[:, None]
    distance = np.sum(((patches - centre[:, None]) / cell) ** 2, axis=2)
    chosen = np.argmin(np.where(alive, distance, np.inf), axis=1)
    rows = np.arange(len(patches))
    return patches[rows, chosen] + low[:, None] * steps, low, chosen, q[rows, chosen]


def _sections(space: LimitSpace, levels: Array, known: Array, cell: Array, directions: int) -> list[WorkspaceSection]:
    """Return the sections at n levels, searched around known poses of the set on a grid of given cells."""
    from contourpy import contour_generator

    count, d = max(round(0.25 * directions * space.density), 4), len(cell)
    boxes = np.array([_section_box(known, cell, level) for level in levels])
    steps = np.ptp(boxes, axis=2) / count

    def node(index: Array) -> Array:
        layer = index[:, 0].astype(int)
        plane = boxes[layer, :, 0] + steps[layer] * index[:, 1:]
        return np.column_stack([plane, levels[layer]]) if d > 2 else plane

    def within(layer: int) -> Mask:
        axes = [low + step * np.arange(count + 1.0) for low, step in zip(boxes[layer, :, 0], steps[layer], strict=True)]
        return space.within_grid([*axes, levels[layer : layer + 1]][:d]).reshape(count + 1, count + 1)

    inside = np.stack([within(layer) for layer in range(len(levels))])
    rings = []  # of indices of sides of cells, (layer, first, second)
    for layer, filled in enumerate(inside):
        found = contour_generator(z=np.pad(filled, 1).T.astype(float)).lines(0.5) if filled.any() else []
        rings += [np.insert(np.asarray(line)[:-1] - 1.0, 0, layer, axis=1) for line in found]
    points, limits = _crossings(space, node, inside, np.concatenate([np.empty((0, 3)), *rings]))
    parts = np.cumsum([len(ring) for ring in rings])[:-1]
    lines = [*zip(np.split(points[:, :2], parts), np.split(limits, parts), strict=True)] if rings else []
    owners = [int(ring[0, 0]) for ring in rings]
    grouped = [[line for line, owner in zip(lines, owners, strict=True) if owner == k] for k in range(len(levels))]
    ranges = _section_ranges(space, levels, [[line for line, _ in group] for group in grouped], steps)
    return [
        WorkspaceSection(space, float(level), tuple(line for line, _ in group), tuple(own for _, own in group), ends)
        for level, group, ends in zip(levels, grouped, ranges, strict=True)
    ]


def _section_box(known: Array, cell: Array, level: float) -> Array:
    """Return a box around the section at a level, one cell wider than the known poses near it, shape=(2, 2)."""
    near = known[np.abs(known[:, 2] - level) <= 1.01 * cell[2]] if len(cell) > 2 else known
    points = (near if len(near) else known)[:, :2]
    return np.stack([points.min(axis=0) - 1.5 * cell[:2], points.max(axis=0) + 1.5 * cell[:2]], axis=-1)


def _section_ranges(space: LimitSpace, levels: Array, lines: Sequence[Sequence[Array]], cells: Array) -> Array:
    """Return the ranges of both coordinates of sections with given lines; NaN without lines, shape=(n, 2, 2)."""
    ranges = np.full((len(levels), 2, 2), np.nan)
    filled = [k for k, own in enumerate(lines) if own]
    if not filled:
        return ranges
    starts = []
    for k in filled:
        points = np.concatenate(lines[k])
        points = np.column_stack([points, np.full(len(points), levels[k])])[:, : len(space.names)]
        starts += [points[index(points[:, axis])] for axis in (0, 1) for index in (np.argmin, np.argmax)]
    axes, sides = np.tile([0, 0, 1, 1], len(filled)), np.tile([-1.0, 1.0], 2 * len(filled))
    cell = np.append(cells[filled].max(axis=0), np.ones(len(space.names) - 2))
    ends = _extremes(space, np.array(starts), axes, sides, np.arange(2), cell, _SECTION_TOLERANCE)
    ranges[filled] = ends[np.arange(len(ends)), axes].reshape(-1, 2, 2)
    return ranges


def _padded(low: float, high: float, cells: int) -> Array:
    """Return values from low to high, and one beyond each end."""
    step = (high - low) / cells
    return low + step * np.arange(-1.0, cells + 2.0)


def _crossings(
    space: LimitSpace, node: Callable[[Array], Array], inside: Mask, places: Array, halvings: int | None = None
) -> tuple[Array, Flags]:
    """Return where the boundary crosses sides of cells, given their middles as fractional indices, and its limits."""
    low, high = np.floor(places), np.ceil(places)
    index = low.astype(int)
    there = np.all((index >= 0) & (index < inside.shape), axis=1)
    kept = np.zeros((len(places), 1), dtype=bool)
    kept[there, 0] = inside[tuple(index[there].T)]
    inner, outer = (node(np.where(which, low, high)) for which in (kept, ~kept))
    halvings = halvings or (_BOUNDARY_HALVINGS if space.density == 1.0 else _FEW_HALVINGS)
    q = space.within_from(inner, np.full((len(inner), space.nq), np.nan))[1]
    for _ in range(halvings if len(inner) else 0):
        middle = 0.5 * (inner + outer)
        within, there = space.within_from(middle, q)
        keeps = within[:, None]
        inner, outer, q = np.where(keeps, middle, inner), np.where(keeps, outer, middle), np.where(keeps, there, q)
    limits = space.limits_from(outer, q)[0] if len(outer) else np.zeros(0, dtype=np.uint32)
    return inner, np.where(limits == 0, REACH, limits)  # a singular pose may be reached one way and not another


def _area(line: Array) -> float:
    """Return the area within a closed line, of arcs over its sides with the curvature at their ends; signed."""
    along = np.roll(line, -1, axis=0) - line
    before = np.roll(along, 1, axis=0)
    twice = np.sum(line[:, 0] * np.roll(line[:, 1], -1) - line[:, 1] * np.roll(line[:, 0], -1))
    lengths, turn = np.linalg.norm(along, axis=1), before[:, 0] * along[:, 1] - before[:, 1] * along[:, 0]
    last = np.roll(lengths, 1)
    curvature = 2.0 * turn / np.maximum(last * lengths * (last + lengths), 1e-300)
    return float(0.5 * twice + np.sum(lengths**3 * (curvature + np.roll(curvature, -1))) / 24.0)
