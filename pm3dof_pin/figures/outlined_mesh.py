"""Triangles over the part of a section within the limits, up to its exact outline.

Cells crossed by the outline are cut where it crosses their sides, and a few more points follow the outline in between.
This works for sections of any shape, with holes or in several parts.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.lines import Line2D
from matplotlib.tri import Triangulation
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from pm3dof_pin.figures.color_scale import ColorScale
from pm3dof_pin.figures.labels import drawn
from pm3dof_pin.figures.style import COLORMAP, END_LINE, LIMIT_LINE, collected
from pm3dof_pin.typing import Array, Mask

Within: TypeAlias = Callable[[Array], Mask]
"""Maps points of the section, shape=(n, 2), to whether they are within the limits."""

_HALVINGS = 10  # of the side of a cell
_BETWEEN = 3  # points of the outline between two sides of a cell
_NEAREST = 1e-4  # of the side of a cell, to avoid degenerate triangles
_CELLS = 40  # least number along each axis; coarser grids are subdivided
_MARGIN = 0.03  # of the axes, around a map
_TIP = 0.02  # of the axes; shorter ends of the grid are not mentioned
_CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1))  # of a cell, in cyclic order


@dataclass(frozen=True, eq=False)
class OutlinedMesh:
    """Points and triangles of a section."""

    axes: tuple[Array, Array]  #: increasing values of both coordinates of the grid
    points: Array  #: shape=(p, 2)
    triangles: NDArray[np.intp]  #: indices of points, shape=(t, 3)
    limit_lines: Array  #: points along the outline due to limits, one short line per cell, shape=(n, k, 2)
    end_lines: Array  #: sides of cells where the grid ends without a limit, shape=(m, 2, 2)
    fillable: Mask  #: poses of the grid excluded by a limit, whose values may be extrapolated, shape=(n, m)

    def values(self, field: Array) -> Array:
        """Interpolate a field over the grid linearly at the points, extrapolated from the last poses inside."""
        filled, positive = np.where(np.isfinite(field), field, np.nan), bool(np.nanmin(field) > 0.0)
        filled = _extended(np.log(filled) if positive else filled, self.fillable)
        found = np.asarray(_interpolator(self.axes, filled)(self.points))
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
        fine = [
            np.interp(np.linspace(0, len(axis) - 1, 8 * (len(axis) - 1) + 1), range(len(axis)), axis)
            for axis in self.axes
        ]
        places = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)
        return np.asarray(_interpolator(self.axes, filled)(places))


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
    for lines, style in ((mesh.limit_lines, LIMIT_LINE), (joined(mesh.end_lines), END_LINE)):
        pieces = [np.column_stack([drawn(c, u) for c, u in zip(line.T, units, strict=True)]) for line in lines]
        axes.add_collection(LineCollection(pieces, clip_on=False, **collected(style | changes)), autolim=False)
    for fix, values, unit in ((axes.set_xlim, mesh.axes[0], units[0]), (axes.set_ylim, mesh.axes[1], units[1])):
        low, high = drawn(values[[0, -1]], unit)
        fix(low - _MARGIN * (high - low), high + _MARGIN * (high - low))


def joined(lines: Array) -> list[Array]:
    """Join successive connected lines, shape=(n, k, 2), so that dashes are continuous."""
    chains: list[list[Array]] = []
    for line in lines:
        if chains and np.array_equal(chains[-1][-1][-1], line[0]):
            chains[-1].append(line[1:])
        else:
            chains.append([line])
    return [np.concatenate(chain) for chain in chains]


def edge_handles(meshes: Iterable[OutlinedMesh]) -> list[Line2D]:
    """Return legend entries for the edges of maps."""
    every = list(meshes)
    kinds = (("limit", "limit_lines", LIMIT_LINE), ("end of the grid", "end_lines", END_LINE))
    return [
        Line2D([], [], label=text, **style)
        for text, kind, style in kinds
        if any(_long(getattr(m, kind), m) for m in every)
    ]


def _long(lines: Array, mesh: OutlinedMesh) -> bool:
    """Return whether lines are longer than the tip of a map."""
    spans = np.array([np.ptp(axis) for axis in mesh.axes])
    return bool(len(lines) and np.any(np.abs(np.diff(lines, axis=1)).sum(axis=(0, 1)) > _TIP * spans))


def outlined_mesh(
    first: Array, second: Array, inside: Mask, within: Within | None = None, excluded: Mask | None = None
) -> OutlinedMesh:
    """Triangulate the part of a section within the limits.

    `inside` are the poses of the grid with a value. Without limits, the mesh ends at the last of these. `excluded` are
    the poses excluded by a limit, by default all others.
    """
    axes = (np.asarray(first, dtype=float), np.asarray(second, dtype=float))
    fillable = ~inside if excluded is None else excluded & ~inside
    x, y, nodes = axes[0], axes[1], np.asarray(inside)
    if within is not None and min(len(x), len(y)) <= _CELLS:
        x, y, nodes = _divided(axes, nodes, fillable, within)
    numbers = np.full(nodes.shape, -1)
    numbers[nodes] = np.arange(np.count_nonzero(nodes))
    points = [np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)[nodes]]
    sides = _Sides(x, y, nodes, within, len(points[0]))
    points.append(sides.points)
    triangles, pairs, owners = _cut_cells(numbers, nodes, sides)
    known = np.concatenate(points)
    lines = np.empty((0, 2, 2))
    if len(pairs):
        lines = known[pairs]
        if within is not None:
            lines = _followed(lines, within, 0.5 * np.hypot(np.diff(x).max(), np.diff(y).max()))
            between = lines[:, 1:-1].reshape(-1, 2)
            triangles += _fans(owners, pairs, len(known), _BETWEEN)
            known = np.concatenate([known, between])
        else:
            triangles += _fans(owners, pairs, len(known), 0)
    joined = np.concatenate(triangles) if triangles else np.empty((0, 3), dtype=np.intp)
    limit_lines = lines if within is not None else np.empty((0, 2, 2))
    return OutlinedMesh(axes, known, joined, limit_lines, _end_lines(known, numbers, sides), fillable)


class _Sides:
    """Points, shape=(c, 2), where the outline crosses sides of cells, and their numbers by side, -1 for none."""

    def __init__(self, x: Array, y: Array, nodes: Mask, within: Within | None, start: int) -> None:
        places: list[Array] = []
        self.along: list[NDArray[np.intp]] = []
        for axis in (0, 1):
            low, high = [nodes.take(range(a, nodes.shape[axis] - 1 + a), axis=axis) for a in (0, 1)]
            crossed = low != high
            numbers = np.full(crossed.shape, -1)
            numbers[crossed] = start + sum(len(found) for found in places) + np.arange(np.count_nonzero(crossed))
            self.along.append(numbers)
            i, j = np.nonzero(crossed)
            ends = [np.stack([x[i], y[j]], axis=-1), np.stack([x[i + (axis == 0)], y[j + (axis == 1)]], axis=-1)]
            swap = ~low[crossed]
            inner, outer = np.where(swap[:, None], ends[::-1], ends)
            places.append(_crossing(inner, outer, within))
        self.points = np.concatenate(places)


def _crossing(inner: Array, outer: Array, within: Within | None) -> Array:
    """Locate the outline between points inside and points outside, shape=(n, 2)."""
    low, high = np.zeros(len(inner)), np.ones(len(inner))
    for _ in range(_HALVINGS if within is not None and len(inner) else 0):
        middle = 0.5 * (low + high)
        keeps = within(inner + middle[:, None] * (outer - inner))  # type: ignore[misc]
        low, high = np.where(keeps, middle, low), np.where(keeps, high, middle)
    return np.asarray(inner + np.clip(low, _NEAREST, 1.0 - _NEAREST)[:, None] * (outer - inner))


def _divided(axes: tuple[Array, Array], nodes: Mask, fillable: Mask, within: Within) -> tuple[Array, Array, Mask]:
    """Subdivide a coarse grid, and check the limits at new nodes with values or next to some."""
    fine = [
        np.interp(np.linspace(0, len(a) - 1, (len(a) - 1) * max(1, -(-_CELLS // (len(a) - 1))) + 1), range(len(a)), a)
        for a in axes
    ]
    reached = _extended(np.where(nodes, 0.0, np.nan), fillable)
    places = np.stack(np.meshgrid(*fine, indexing="ij"), axis=-1)
    near = np.isfinite(_interpolator(axes, reached)(places.reshape(-1, 2)))
    found = np.zeros(len(near), dtype=bool)
    found[near] = within(places.reshape(-1, 2)[near])
    return fine[0], fine[1], found.reshape(places.shape[:2])


def _interpolator(axes: tuple[Array, Array], field: Array) -> RegularGridInterpolator:
    """Return a bilinear interpolator that tolerates points slightly outside due to rounding."""
    return RegularGridInterpolator(axes, field, bounds_error=False, fill_value=None)


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


def _cut_cells(
    numbers: NDArray[np.intp], nodes: Mask, sides: _Sides
) -> tuple[list[NDArray[np.intp]], NDArray[np.intp], NDArray[np.intp]]:
    """Return triangles of cells, pairs of points where the outline crosses a cell, and a corner to fan from."""
    n, m = nodes.shape[0] - 1, nodes.shape[1] - 1
    corners = [numbers[i : n + i, j : m + j] for i, j in _CORNERS]
    along, up = sides.along
    edges = [along[:, :-1], up[1:, :], along[:, 1:], up[:-1, :]]  # from each corner to the next
    pattern = np.sum([(corner >= 0).astype(int) << k for k, corner in enumerate(corners)], axis=0)
    triangles: list[NDArray[np.intp]] = []
    pairs: list[NDArray[np.intp]] = []
    owners: list[NDArray[np.intp]] = []
    for which in range(1, 16):
        cells = np.nonzero(pattern == which)
        if not cells[0].size:
            continue
        ring: list[NDArray[np.intp]] = []
        cut: list[tuple[int, int]] = []
        for k in range(4):
            inside, following = bool(which >> k & 1), bool(which >> (k + 1) % 4 & 1)
            if inside:
                ring.append(corners[k][cells])
            if inside != following:
                ring.append(edges[k][cells])
                if inside:
                    cut.append((len(ring) - 1, -1))
                elif cut and cut[-1][1] < 0:
                    cut[-1] = (cut[-1][0], len(ring) - 1)
                else:  # the outline entered the cell before the first corner
                    cut.insert(0, (-1, len(ring) - 1))
        cut = [(a if a >= 0 else cut[-1][0], b if b >= 0 else cut[0][1]) for a, b in cut]
        cut = list(dict.fromkeys(cut))
        ends = {end for pair in cut for end in pair}
        free = [k for k in range(len(ring)) if k not in ends]
        start = free[len(free) // 2]  # opposite to the outline
        order = [(start + k) % len(ring) for k in range(len(ring))]
        for a, b in itertools.pairwise(order[1:]):
            if (a, b) not in cut:
                triangles.append(np.stack([ring[start], ring[a], ring[b]], axis=-1))
        for a, b in cut:
            pairs.append(np.stack([ring[a], ring[b]], axis=-1))
            owners.append(ring[start])
    if not pairs:
        return triangles, np.empty((0, 2), dtype=np.intp), np.empty(0, dtype=np.intp)
    return triangles, np.concatenate(pairs), np.concatenate(owners)


def _fans(owners: NDArray[np.intp], pairs: NDArray[np.intp], start: int, between: int) -> list[NDArray[np.intp]]:
    """Return the triangles from one corner of each cell to the outline in it."""
    chain = np.concatenate(
        [pairs[:, :1], start + np.arange(len(pairs) * between).reshape(len(pairs), between), pairs[:, 1:]], axis=1
    )
    return [np.stack([owners, chain[:, k], chain[:, k + 1]], axis=-1) for k in range(between + 1)]


def _followed(chords: Array, within: Within, most: float) -> Array:
    """Insert points of the outline between the ends of its chords, shape=(n, 2, 2); on the chord if none is near."""
    part = np.linspace(0.0, 1.0, _BETWEEN + 2)[1:-1]
    along = chords[:, 1] - chords[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    across = np.stack([along[:, 1], -along[:, 0]], axis=-1) / np.maximum(lengths, 1e-300)[:, None]
    places = (chords[:, :1] + part[:, None] * along[:, None]).reshape(-1, 2)
    reach = np.repeat(across * np.minimum(0.5 * lengths, most)[:, None], _BETWEEN, axis=0)
    inside = within(places)
    reach = np.where(inside[:, None], reach, -reach)  # cells are anticlockwise, so that outside is on the right
    found = within(places + reach) != inside
    inner = np.where(inside[:, None], places, places + reach)
    outer = np.where(inside[:, None], places + reach, places)
    moved = np.where(found[:, None], _crossing(inner, outer, within), places)
    return np.concatenate([chords[:, :1], moved.reshape(len(chords), _BETWEEN, 2), chords[:, 1:]], axis=1)


def _end_lines(points: Array, numbers: NDArray[np.intp], sides: _Sides) -> Array:
    """Return the sides of cells along the edge of the grid that are inside."""
    lines = []
    for nodes, cuts in (
        (numbers[:, 0], sides.along[0][:, 0]),
        (numbers[:, -1], sides.along[0][:, -1]),
        (numbers[0], sides.along[1][0]),
        (numbers[-1], sides.along[1][-1]),
    ):
        start, stop = nodes[:-1], nodes[1:]
        first, last = np.where(start >= 0, start, cuts), np.where(stop >= 0, stop, cuts)
        drawn = (first >= 0) & (last >= 0)
        lines.append(np.stack([first[drawn], last[drawn]], axis=-1))
    joined = np.concatenate(lines)
    return points[joined] if len(joined) else np.empty((0, 2, 2))
