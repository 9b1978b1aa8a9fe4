"""Triangles over the part of a section within the limits, up to its exact outline.

Contours (contourpy) between the poses of a grid within the limits and the others say which sides of cells the outline
crosses, and bisection finds where. Poses and outline are triangulated together (Delaunay). So a section may have any
shape, with holes or in several parts.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from contourpy import contour_generator
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.path import Path
from matplotlib.tri import Triangulation
from numpy.typing import NDArray

from pm3dof_pin.figures.color_scale import ColorScale, kinds_of
from pm3dof_pin.figures.labels import drawn
from pm3dof_pin.figures.style import COLORMAP, END_LINE, LIMIT_LINE, collected
from pm3dof_pin.typing import Array, Mask

Within: TypeAlias = Callable[[Array], Mask]
"""Maps points of the section, shape=(n, 2), to whether they are within the limits."""

_HALVINGS = 10  # of the side of a cell
_CELLS = 80  # least number along each axis; coarser grids are subdivided
_MARGIN = 0.03  # of the axes, around a map
_TIP = 0.02  # of the axes; shorter ends of the grid are not mentioned
_FLAT = 1e-6  # area of a triangle that is left out, in cells
_DIGITS = 9  # of positions in cells, to find equal ones


@dataclass(frozen=True, eq=False)
class OutlinedMesh:
    """Points and triangles of a section."""

    axes: tuple[Array, Array]  #: increasing values of both coordinates of the grid
    points: Array  #: shape=(p, 2)
    triangles: NDArray[np.intp]  #: indices of points, shape=(t, 3)
    limit_lines: tuple[NDArray[np.intp], ...]  #: indices of the points along the outline due to limits, line by line
    end_lines: tuple[NDArray[np.intp], ...]  #: those where the grid ends without a limit
    fillable: Mask  #: poses of the grid excluded by a limit, whose values may be extrapolated, shape=(n, m)

    def values(self, field: Array) -> Array:
        """Interpolate a field over the grid linearly at the points, extrapolated from the last poses inside.

        Whole numbers stand for kinds, and points have that of the nearest pose.
        """
        if len(kinds_of(field)):
            from scipy.spatial import KDTree  # slow to load

            pose = np.argwhere(np.isfinite(field))
            spans = [axis[-1] - axis[0] or 1.0 for axis in self.axes]
            places = np.column_stack([axis[index] for axis, index in zip(self.axes, pose.T, strict=True)])
            nearest: Array = field[tuple(pose[KDTree(places / spans).query(self.points / spans)[1]].T)]
            return nearest
        filled, positive = np.where(np.isfinite(field), field, np.nan), bool(np.nanmin(field) > 0.0)
        filled = _extended(np.log(filled) if positive else filled, self.fillable)
        found = _bilinear(self.axes, filled, self.points)
        low, high = np.nanmin(field), np.nanmax(field)
        margin = 0.1 * (high - low)
        # extrapolated values must stay near the computed range
        clipped: Array = np.clip(
            np.exp(found) if positive else found,
            max(low - margin, low / 2) if positive else low - margin,
            high + margin,
        )
        return clipped

    def fine(self, fields: Array) -> Array:
        """Return fields, shape=(n, m, k), on an eight times finer grid, extrapolated like the values at the points.

        They are NaN further out.
        """
        known = np.moveaxis(np.where(np.isfinite(fields), fields, np.nan), -1, 0)
        filled = np.stack([_extended(field, self.fillable) for field in known], axis=-1)
        fine = [_subdivided(axis, 8 * (len(axis) - 1)) for axis in self.axes]
        places = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)
        return _bilinear(self.axes, filled, places)


def draw_map(
    axes: Axes, mesh: OutlinedMesh, values: Array, scale: ColorScale, units: Sequence[str], **changes: Any
) -> Triangulation | None:
    """Fill a map with the colours of values at its points, and draw its edges; return its triangles, if any."""
    triangulation = None
    if len(mesh.triangles):
        columns = [drawn(column, unit) for column, unit in zip(mesh.points.T, units, strict=True)]
        triangulation = Triangulation(*columns, mesh.triangles)
        axes.tricontourf(
            triangulation, values, levels=scale.levels, norm=scale.norm(), cmap=COLORMAP, extend=scale.extend
        )
    draw_edges(axes, mesh, units, **changes)
    return triangulation


def draw_edges(axes: Axes, mesh: OutlinedMesh, units: Sequence[str], **changes: Any) -> None:
    """Draw the edges of a map due to limits and to the end of the grid, in adjustable styles."""
    shown = np.column_stack([drawn(column, unit) for column, unit in zip(mesh.points.T, units, strict=True)])
    for lines, style in ((mesh.limit_lines, LIMIT_LINE), (mesh.end_lines, END_LINE)):
        pieces = [shown[line] for line in lines]
        axes.add_collection(LineCollection(pieces, clip_on=False, **collected(style | changes)), autolim=False)
    for fix, values, unit in ((axes.set_xlim, mesh.axes[0], units[0]), (axes.set_ylim, mesh.axes[1], units[1])):
        low, high = drawn(values[[0, -1]], unit)
        fix(low - _MARGIN * (high - low), high + _MARGIN * (high - low))


def edge_handles(meshes: Iterable[OutlinedMesh]) -> list[Line2D]:
    """Return legend entries for the edges of maps."""
    every = list(meshes)
    kinds = (("limit", "limit_lines", LIMIT_LINE), ("end of the grid", "end_lines", END_LINE))
    return [
        Line2D([], [], label=text, **style)
        for text, kind, style in kinds
        if any(_long(getattr(m, kind), m) for m in every)
    ]


def _long(lines: Iterable[NDArray[np.intp]], mesh: OutlinedMesh) -> bool:
    """Return whether lines are longer than the tip of a map."""
    spans = np.array([np.ptp(axis) for axis in mesh.axes])
    return any(np.abs(np.diff(mesh.points[line] / spans, axis=0)).sum() > _TIP for line in lines)


def outlined_mesh(
    first: Array, second: Array, inside: Mask, within: Within | None = None, excluded: Mask | None = None
) -> OutlinedMesh:
    """Triangulate the part of a section within the limits.

    `inside` are the poses of the grid with a value. Without limits, the mesh ends at the last of these. `excluded` are
    the poses excluded by a limit, by default all others.
    """
    axes = (np.asarray(first, dtype=float), np.asarray(second, dtype=float))
    fillable = ~inside if excluded is None else excluded & ~inside
    fine, nodes = axes, np.asarray(inside)
    if within is not None and min(nodes.shape) <= _CELLS:
        fine, nodes = _divided(axes, nodes, fillable, within)
    cell = np.array([np.ptp(axis) / max(len(axis) - 1, 1) for axis in fine])
    rings, ends = _rings(fine, nodes, within)
    places = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)[nodes]
    every = np.concatenate([places, *rings])
    _, kept, numbers = np.unique((every / cell).round(_DIGITS), axis=0, return_index=True, return_inverse=True)
    points, parts = every[kept], np.cumsum([len(places), *map(len, rings)])
    outlines = np.split(numbers.ravel(), parts)[1 : len(rings) + 1]
    limit_lines, end_lines = [], []
    for ring, at_end in zip(outlines, ends, strict=True):
        for line, is_end in _runs(ring, at_end):
            if is_end:
                end_lines.append(line)
            elif within is not None:
                limit_lines.append(line)
    triangles = _triangles(points / cell, outlines)
    return OutlinedMesh(axes, points, triangles, tuple(limit_lines), tuple(end_lines), fillable)


def _rings(axes: Sequence[Array], nodes: Mask, within: Within | None) -> tuple[list[Array], list[Mask]]:
    """Return the closed lines around the nodes inside, and which of their points are at the end of the grid."""
    found = contour_generator(z=np.pad(nodes, 1).T.astype(float)).lines(0.5) if nodes.any() else []
    indices = [np.asarray(line)[:-1] - 1.0 for line in found]
    low, high = (np.concatenate([np.empty((0, 2)), *(part(line) for line in indices)]) for part in (np.floor, np.ceil))
    last = np.array(nodes.shape) - 1
    swap = np.zeros((len(low), 1), dtype=bool)
    there = np.all((low >= 0) & (low <= last), axis=1)
    swap[there, 0] = nodes[tuple(low[there].astype(int).T)]
    inner, outer = np.where(swap, low, high), np.where(swap, high, low)
    at_end = np.any((outer < 0) | (outer > last), axis=1)

    def at(places: Array) -> Array:
        index = [np.arange(len(axis)) for axis in axes]
        return np.column_stack([np.interp(p, i, axis) for p, i, axis in zip(places.T, index, axes, strict=True)])

    low, high = np.zeros(len(inner)), np.where(at_end, 0.0, 1.0)
    for _ in range(_HALVINGS if within is not None and len(inner) else 0):
        middle = 0.5 * (low + high)
        keeps = within(at(inner + middle[:, None] * (outer - inner)))  # type: ignore[misc]
        low, high = np.where(keeps, middle, low), np.where(keeps, high, middle)
    points = at(inner + low[:, None] * (outer - inner))
    parts = np.cumsum([len(line) for line in indices])[:-1]
    return (np.split(points, parts), np.split(at_end, parts)) if indices else ([], [])


def _runs(ring: NDArray[np.intp], at_end: Mask) -> list[tuple[NDArray[np.intp], bool]]:
    """Divide a closed line into lines along the end of the grid and others."""
    is_end = at_end | np.roll(at_end, -1)  # of the piece from each point to the next, along the edge of the grid
    changes = np.flatnonzero(is_end != np.roll(is_end, 1))
    if not len(changes):
        return [(np.append(ring, ring[0]), bool(is_end[0]))]
    around = np.append(changes, changes[0] + len(ring))
    return [
        (ring[np.arange(start, stop + 1) % len(ring)], bool(is_end[start]))
        for start, stop in itertools.pairwise(around)
    ]


def _triangles(points: Array, outlines: Sequence[NDArray[np.intp]]) -> NDArray[np.intp]:
    """Triangulate points inside closed lines among them, shape=(t, 3)."""
    try:
        found = Triangulation(*points.T).triangles.astype(np.intp)
    except (RuntimeError, ValueError):  # fewer than three points, or all in a line
        return np.empty((0, 3), dtype=np.intp)
    corners = points[found]
    middles = corners.mean(axis=1)
    inside = np.zeros(len(found), dtype=bool)
    for outline in outlines:
        inside ^= Path(points[outline]).contains_points(middles)
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) < _FLAT
    kept: NDArray[np.intp] = found[inside & ~flat]
    return kept


def _subdivided(axis: Array, cells: int) -> Array:
    return np.interp(np.linspace(0, len(axis) - 1, cells + 1), range(len(axis)), axis)


def _divided(
    axes: tuple[Array, Array], nodes: Mask, fillable: Mask, within: Within
) -> tuple[tuple[Array, Array], Mask]:
    """Subdivide a coarse grid, and check the limits at new nodes with values or next to some."""
    first, second = (_subdivided(a, (len(a) - 1) * max(1, -(-_CELLS // (len(a) - 1)))) for a in axes)
    reached = _extended(np.where(nodes, 0.0, np.nan), fillable)
    places = np.stack(np.meshgrid(first, second, indexing="ij"), axis=-1)
    near = np.isfinite(_bilinear(axes, reached, places.reshape(-1, 2)))
    found = np.zeros(len(near), dtype=bool)
    found[near] = within(places.reshape(-1, 2)[near])
    return (first, second), found.reshape(places.shape[:2])


def _bilinear(axes: tuple[Array, Array], field: Array, places: Array) -> Array:
    """Interpolate a field, shape=(n, m, ...), at places, shape=(..., 2); NaN if a corner of the cell is."""
    parts = []
    for axis, along in zip(axes, np.moveaxis(places, -1, 0), strict=True):
        cell = np.clip(np.searchsorted(axis, along, side="right") - 1, 0, len(axis) - 2)
        parts.append((cell, (along - axis[cell]) / (axis[cell + 1] - axis[cell])))
    (row, down), (column, across) = parts
    down, across = (
        np.expand_dims(part, tuple(range(part.ndim, part.ndim + field.ndim - 2))) for part in (down, across)
    )
    upper, lower = ((1.0 - across) * field[r, column] + across * field[r, column + 1] for r in (row, row + 1))
    return np.asarray((1.0 - down) * upper + down * lower)


def _extended(field: Array, fillable: Mask) -> Array:
    """Extrapolate linearly from the last two poses inside to the next two rings of poses excluded by a limit."""
    for _ in range(2):
        wide = np.pad(field, 2, constant_values=np.nan)
        guesses = []
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1), (1, 1), (1, -1), (-1, 1), (-1, -1)):
            one, two = (
                wide[2 + k * di : wide.shape[0] - 2 + k * di, 2 + k * dj : wide.shape[1] - 2 + k * dj] for k in (1, 2)
            )
            guesses.append(np.where(np.isfinite(two), 2.0 * one - two, one))
        stack = np.stack(guesses)
        count = np.isfinite(stack).sum(axis=0)
        mean = np.nansum(stack, axis=0) / np.maximum(count, 1)
        field = np.where(fillable & ~np.isfinite(field) & (count > 0), mean, field)
    return field
