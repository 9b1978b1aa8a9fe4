"""The reachable set over the coordinates of a robot: solid, sections, and ranges over the third one (Fig. 8.2)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, PathPatch, Rectangle
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from pm3dof_pin.figures.labels import axis_label, drawn, plain, symbol
from pm3dof_pin.figures.style import (
    INK,
    ONE_COLUMN,
    TWO_COLUMNS,
    house_style,
    limit_styles,
    new_figure,
    round_ticks,
    spring_colors,
    towards_viewer,
)
from pm3dof_pin.maps.limit_space import Flags
from pm3dof_pin.maps.workspace import Workspace, WorkspaceSection
from pm3dof_pin.typing import Array

_SMOOTHING = 12  # steps in and out
_SPREADING = 4  # steps to neighbours
_OUTLINES = 6  # number of drawn outlines of sections
_DASHES = 36  # per edge of the printed box
_ELEVATION, _AZIMUTH = 18.0, -60.0  # of the view of the solid [deg]
_BOX = np.array([1.0, 1.0, 1.1])  # sides of the drawing
_LIGHT = np.array([0.35, -0.75, 0.55])
_MARGIN = 1.07


def workspace_figure(workspace: Workspace, printed: Array | None = None) -> Figure:
    """Draw the reachable set coloured by the binding limit, with printed ranges, shape=(3, 2) [m, rad], for comparison.

    The set may have any shape. For two coordinates, the only section is drawn.
    """
    sheet = _Sheet(workspace, printed)
    with house_style():
        figure = new_figure(TWO_COLUMNS, 4.7) if workspace.space.stacked else new_figure(ONE_COLUMN, 3.9)
        figure.suptitle(
            f"Reachable set under all {'' if printed is None else 'joint '}limits: {plain(workspace.space.machine)}"
        )
        # placed manually: layout engines do not know the size of labels in 3D
        if workspace.space.stacked:
            _draw_solid(figure.add_axes((-0.035, 0.05, 0.625, 0.92), projection="3d"), sheet)
            _draw_outlines(figure.add_axes((0.655, 0.475, 0.325, 0.455)), sheet)
            _draw_profile(figure.add_axes((0.655, 0.095, 0.325, 0.27)), sheet)
        else:
            _draw_outlines(figure.add_axes((0.17, 0.2, 0.78, 0.72)), sheet)
        _add_legend(figure, sheet)
    return figure


def branches_figure(workspaces: Mapping[int, Workspace]) -> Figure:
    """Draw the reachable set of every branch in a colour of its own, by number; for three coordinates as solids."""
    first = next(iter(workspaces.values()))
    space, sheets = first.space, [_Sheet(own, None) for own in workspaces.values()]
    colors = dict(zip(workspaces, spring_colors(len(workspaces)), strict=True))
    limits = np.stack([sheet.limits for sheet in sheets])
    ends = np.stack([limits[..., 0].min(axis=0), limits[..., 1].max(axis=0)], axis=-1)
    labels = [f"branch {number}{' (of home)' if number == 0 else ''}" for number in workspaces]
    with house_style():
        figure = new_figure(ONE_COLUMN, 3.9)
        figure.suptitle(f"Branches of the reachable set: {plain(space.machine)}")
        if space.stacked:
            axes: Any = figure.add_axes((0.0, 0.1, 0.88, 0.85), projection="3d")
            solids = [sheet.solid()[0] for sheet in sheets]
            scale = _BOX / np.ptp(ends, axis=1)
            faces = np.concatenate(solids)
            tints = np.repeat([to_rgba(color) for color in colors.values()], [len(own) for own in solids], axis=0)
            tint = _shaded(tints, faces * scale)
            axes.add_collection3d(
                Poly3DCollection(faces, facecolors=tint, edgecolors=tint, linewidths=0.25, rasterized=True)
            )
            axes.set(zlim=ends[2], zlabel=sheets[0].labels[2])
            axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
            axes.set_box_aspect(_BOX, zoom=0.85)
        else:
            axes = figure.add_axes((0.17, 0.2, 0.78, 0.72))
            axes.set_aspect("equal" if sheets[0].same_unit else "auto")
            for sheet, color in zip(sheets, colors.values(), strict=True):
                rings = [sheet.drawn(line) for line in sheet.sections[0].lines]
                outline = Path.make_compound_path(*(Path(np.vstack([ring, ring[:1]]), closed=True) for ring in rings))
                axes.add_patch(PathPatch(outline, facecolor=color, edgecolor=INK, linewidth=0.8, alpha=0.8))
        axes.set(xlim=ends[0], ylim=ends[1], xlabel=sheets[0].labels[0], ylabel=sheets[0].labels[1])
        round_ticks(axes)
        handles = [Patch(color=color, label=label) for color, label in zip(colors.values(), labels, strict=True)]
        figure.legend(handles=handles, loc="lower left", ncols=3)
    return figure


class _Sheet:
    """The drawn data: coordinates in display units, colours of the limits, and the ends of the axes."""

    def __init__(self, workspace: Workspace, printed: Array | None) -> None:
        space = workspace.space
        self.workspace = workspace
        self.units = space.units
        self.labels = [axis_label(name, unit) for name, unit in zip(space.names, space.units, strict=True)]
        self.same_unit = space.units[0] == space.units[1]
        self.printed = None
        if printed is not None:
            self.printed = np.array([drawn(row, unit) for row, unit in zip(printed, space.units, strict=True)])
        self.limits = self._axes_limits()
        # if several limits bind, the first is shown; those shown have individual colours
        self.surface = workspace.surface() if space.stacked else None
        drawn_limits = [limits for section in self.sections for limits in section.limits]
        flags = np.concatenate([*drawn_limits, *([self.surface.limits] if self.surface else [])])
        self.shown_limits = [space.limits[k] for k in np.unique(_first(flags[flags > 0]))]
        self.styles = limit_styles([*self.shown_limits, *(n for n in space.limits if n not in self.shown_limits)])

    def _axes_limits(self) -> Array:
        ranges = [drawn(row, unit) for row, unit in zip(self.workspace.ranges, self.units, strict=False)]
        spans = np.array(ranges if self.printed is None else np.concatenate([ranges, self.printed[:2]], axis=1))
        low, high = spans.min(axis=1), spans.max(axis=1)
        if self.units[0] == self.units[1] == "rad" and np.all((low < 0.0) & (high > 0.0)):
            reach = _MARGIN * float(np.abs(spans).max())
            plane = np.array([[-reach, reach], [-reach, reach]])
        else:
            half = 0.5 * _MARGIN * (high - low)
            half = np.full(2, half.max()) if self.same_unit else half
            plane = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1)
        if not self.workspace.space.stacked:
            return plane
        levels = drawn(self.workspace.level_range, self.units[2])
        ends = levels if self.printed is None else np.concatenate([levels, self.printed[2]])
        return np.vstack([plane, [ends.min(), ends.max()]])

    def drawn(self, points: Array) -> Array:
        """Return points over the first two or three coordinates in display units."""
        columns = zip(np.moveaxis(points, -1, 0), self.units, strict=False)
        return np.stack([drawn(column, unit) for column, unit in columns], axis=-1)

    def outline(self, section: WorkspaceSection) -> tuple[Array, Array]:
        """Return the pieces of a section's lines, shape=(m, 2, 2), in display units, and their colours."""
        pieces, colors = [np.empty((0, 2, 2))], [np.empty((0, 4))]
        for line, limits in zip(section.lines, section.limits, strict=True):
            points, color = self.drawn(line), self.colors(limits)
            middles = 0.5 * (points + np.roll(points, -1, axis=0))  # each half has the colour of its end
            pieces += [np.stack([points, middles], axis=1), np.stack([middles, np.roll(points, -1, axis=0)], axis=1)]
            colors += [color, np.roll(color, -1, axis=0)]
        return np.concatenate(pieces), np.concatenate(colors)

    def solid(self) -> tuple[Array, Array]:
        """Return the faces of the surface, shape=(n, 4, 3), in display units, and the limits behind them.

        Triangles between several limits are divided among their corners, along smooth lines.
        """
        surface = self.surface
        assert surface is not None
        points = _smoothed(self.drawn(surface.points), surface.triangles)[surface.triangles]
        weights = _spread(_first(surface.limits), surface.triangles)
        limits, weights = weights.argmax(axis=1)[surface.triangles], weights[surface.triangles]
        mixed = np.any(limits != limits[:, :1], axis=1)
        whole = points[~mixed][:, [0, 1, 2, 2]]
        corners, own, weights = points[mixed], limits[mixed], weights[mixed]
        ends = np.roll(corners, -1, axis=1), np.roll(own, -1, axis=1), np.roll(weights, -1, axis=1)
        crossed = own != ends[1]
        # where the limits of both ends weigh the same
        lead, lost = (
            np.take_along_axis(each, own[..., None], axis=2) - np.take_along_axis(each, ends[1][..., None], axis=2)
            for each in (weights, ends[2])
        )
        part = np.where(crossed[..., None], lead / np.where(crossed[..., None], lead - lost, 1.0), 0.5)
        sides = corners + part * (ends[0] - corners)
        middle = (sides * crossed[..., None]).sum(axis=1) / np.maximum(crossed.sum(axis=1), 1)[:, None]
        parts = [np.stack([corners[:, k], sides[:, k], middle, sides[:, k - 1]], axis=1) for k in range(3)]
        return np.concatenate([whole, *parts]), np.concatenate([limits[~mixed, 0], *own.T])

    def colors(self, flags: Flags) -> Array:
        """Return the colour of each set of limits, that of the first if several bind, shape=(..., 4)."""
        return self.limit_colors[_first(flags)]

    @property
    def limit_colors(self) -> Array:
        """Colour of each limit, shape=(n, 4)."""
        return np.array([to_rgba(self.styles[name][0]) for name in self.workspace.space.limits])

    @cached_property
    def sections(self) -> list[WorkspaceSection]:
        """Return the sections whose outlines are drawn: at round levels, or else equally spaced without the ends."""
        sections = self.workspace.sections
        if len(sections) == 1:
            return list(sections)
        found = [section for section in self.workspace.outlines if not section.empty]
        if len(found) > 1:
            return found
        indices = np.linspace(0, len(sections) - 1, _OUTLINES + 2).round().astype(int)[1:-1]
        return [sections[index] for index in np.unique(indices) if not sections[index].empty]


def _smoothed(points: Array, triangles: NDArray[np.intp]) -> Array:
    """Return the vertices of a surface without the saw teeth that a grid of cells leaves at sharp edges.

    By steps in and out that keep the volume (G. Taubin, 1995); edges are rounded by less than a cell.
    """
    sizes = np.ptp(points, axis=0)
    smoothed: Array = points / sizes
    mean = _mean_of_neighbours(len(points), triangles)
    for step in range(_SMOOTHING):
        smoothed = smoothed + (-0.53 if step % 2 else 0.5) * (mean(smoothed) - smoothed)
    return np.asarray(smoothed * sizes)


def _spread(limits: NDArray[np.intp], triangles: NDArray[np.intp]) -> Array:
    """Return the weight of each limit at each vertex, shape=(vertices, limits): its part among the neighbours."""
    weights: Array = np.eye(int(limits.max(initial=0)) + 1)[limits]
    mean = _mean_of_neighbours(len(limits), triangles)
    for _ in range(_SPREADING):
        weights = 0.5 * (weights + mean(weights))
    return weights


def _mean_of_neighbours(count: int, triangles: NDArray[np.intp]) -> Callable[[Array], Array]:
    """Return what takes values at vertices, shape=(count, k), to the means of their neighbours' along the edges.

    Vertices of no triangle keep zeros.
    """
    pairs = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    start, end = np.concatenate([pairs, pairs[:, ::-1]]).T
    numbers = np.bincount(start, minlength=count)
    ends = end[np.argsort(start, kind="stable")]
    joined = np.flatnonzero(numbers)
    firsts = (np.cumsum(numbers) - numbers)[joined]

    def mean(values: Array) -> Array:
        means = np.zeros_like(values)
        means[joined] = np.add.reduceat(values[ends], firsts) / numbers[joined, None]
        return means

    return mean


def _first(flags: Flags) -> NDArray[np.intp]:
    """Return the number of the first limit in each set of limits."""
    lowest = flags & -flags.astype(np.int64)
    return np.asarray(np.log2(np.maximum(lowest, 1)).astype(np.intp))


def _draw_solid(axes: Any, sheet: _Sheet) -> None:
    scale = _BOX / np.ptp(sheet.limits, axis=1)
    towards = towards_viewer(_ELEVATION, _AZIMUTH)
    solid, limits = sheet.solid()
    facing = _normals(solid * scale) @ towards > -1e-3  # hidden back faces would show as a fringe
    colors = _shaded(sheet.limit_colors[limits], solid * scale)
    levels = drawn([section.level for section in sheet.sections], sheet.units[2])
    lines = [
        _raised(sheet.outline(s)[0], level, towards / scale) for s, level in zip(sheet.sections, levels, strict=True)
    ]
    lines += [] if sheet.printed is None else [_dashed(sheet.printed)]
    edges = np.concatenate([np.empty((0, 4, 3)), *lines]) + 0.02 * towards / scale
    all_colors = np.concatenate([colors[facing], np.tile(to_rgba(INK), (len(edges), 1))])
    axes.add_collection3d(
        Poly3DCollection(
            np.concatenate([solid[facing], edges]),
            facecolors=all_colors,
            edgecolors=all_colors,
            linewidths=0.25,
            joinstyle="bevel",  # mitres of thin faces would form spikes
            rasterized=True,
        )
    )
    axes.set(xlim=sheet.limits[0], ylim=sheet.limits[1], zlim=sheet.limits[2])
    axes.set_xlabel(sheet.labels[0], labelpad=-2)
    axes.set_ylabel(sheet.labels[1], labelpad=-2)
    axes.set_zlabel(sheet.labels[2], labelpad=5)
    round_ticks(axes, 4, 4)
    axes.tick_params(axis="z", pad=3)
    axes.tick_params(axis="x", pad=-1)
    axes.tick_params(axis="y", pad=-1)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_box_aspect(_BOX, zoom=0.95)


def _normals(faces: Array) -> Array:
    normals = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _shaded(colors: Array, faces: Array) -> Array:
    """Return colours of faces, shape=(n, 4), darker where they turn away from the light."""
    shade = 0.68 + 0.32 * _normals(faces) @ (_LIGHT / np.linalg.norm(_LIGHT))
    return np.column_stack([colors[:, :3] * shade[:, None], colors[:, 3]])


def _raised(outline: Array, level: float, towards: Array) -> Array:
    """Return the part of an outline that faces the viewer, as flat polygons at its level, shape=(n, 4, 3)."""
    along = outline[:, 1] - outline[:, 0]
    corners = outline[along[:, 1] * towards[0] - along[:, 0] * towards[1] > 0.0]
    return _flat_quadrilaterals(np.concatenate([corners, np.full((*corners.shape[:2], 1), level)], axis=2))


def _flat_quadrilaterals(lines: Array) -> Array:
    """Return the segments of lines, shape=(n, k, 3), as flat polygons (p, q, q, p), to be sorted with a body's."""
    start, end = lines[:, :-1], lines[:, 1:]
    return np.stack([start, end, end, start], axis=2).reshape(-1, 4, 3)


def _dashed(ranges: Array) -> Array:
    """Return every second piece of the edges of a box, shape=(m, 4, 3)."""
    corners = np.array(list(itertools.product(*ranges)))
    edges = [(p, q) for p in range(8) for q in range(p) if np.sum(corners[p] != corners[q]) == 1]
    lines = np.stack([np.linspace(corners[p], corners[q], _DASHES) for p, q in edges])
    return _flat_quadrilaterals(lines)[::2]


def _draw_outlines(axes: Any, sheet: _Sheet) -> None:
    for place, section in enumerate(sheet.sections):
        pieces, colors = sheet.outline(section)
        axes.add_collection(LineCollection(list(pieces), colors=colors, linewidths=1.2, capstyle="round"))
        if sheet.workspace.space.stacked:
            # each level is labelled on its own line, in its own direction
            points = sheet.drawn(section.points)
            x, y = points[int((place + 0.25) * len(points) / len(sheet.sections))]
            box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}
            level = float(drawn(section.level, sheet.units[2]))
            text = f"{level:.4g}".replace("-", "\N{MINUS SIGN}")
            axes.text(x, y, text, fontsize=6.5, ha="center", va="center", bbox=box)
    if sheet.workspace.space.stacked:
        axes.set_title(f"on the lines: {sheet.labels[2]}", fontsize=7.0, pad=3.0)
    if sheet.printed is not None:
        axes.add_patch(_rectangle(sheet.printed[0], sheet.printed[1]))
    axes.set(xlabel=sheet.labels[0], ylabel=sheet.labels[1], aspect="equal" if sheet.same_unit else "auto")
    axes.set(xlim=sheet.limits[0], ylim=sheet.limits[1])
    round_ticks(axes)


def _draw_profile(axes: Any, sheet: _Sheet) -> None:
    """Draw the ranges of both coordinates over the third, in their common unit or else relative to the axes."""
    space = sheet.workspace.space
    levels = drawn(sheet.workspace.levels, sheet.units[2])
    ranges = np.array([section.ranges for section in sheet.workspace.sections])
    for axis, color in enumerate((INK, "#D55E00")):
        values = drawn(ranges[:, axis], sheet.units[axis])
        if not sheet.same_unit:
            low, high = sheet.limits[axis]
            values = (values - low) / (high - low)
        axes.fill_betweenx(levels, values[:, 0], values[:, 1], color=color, alpha=0.12, linewidth=0)
        axes.plot(values[:, 0], levels, color=color, label=symbol(space.names[axis]))
        axes.plot(values[:, 1], levels, color=color)
    if sheet.printed is not None:
        axes.add_patch(_rectangle(sheet.printed[0], sheet.printed[2]))
    both = f"{symbol(space.names[0])}, {symbol(space.names[1])}"
    unit = f"[{'deg' if sheet.units[0] == 'rad' else sheet.units[0]}]"
    ends = sheet.limits[:2] if sheet.same_unit else np.array([[0.0, 1.0]])
    axes.set(
        xlabel=f"range of {both} {unit if sheet.same_unit else '[relative to the axes above]'}", ylabel=sheet.labels[2]
    )
    axes.set(xlim=(ends[:, 0].min(), ends[:, 1].max()))
    axes.margins(y=0.05)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.legend(loc="center")


def _rectangle(across: Array, up: Array) -> Rectangle:
    return Rectangle(
        (across[0], up[0]), np.ptp(across), np.ptp(up), fill=False, linestyle=(0, (4, 3)), edgecolor=INK, linewidth=0.9
    )


def _add_legend(figure: Figure, sheet: _Sheet) -> None:
    handles: list[Any] = [Patch(color=sheet.styles[k][0], label=sheet.styles[k][1]) for k in sheet.shown_limits]
    if sheet.printed is not None:
        handles.append(Line2D([], [], color=INK, linestyle=(0, (4, 3)), linewidth=0.9, label="printed ranges"))
    figure.legend(handles=handles, loc="lower left", ncols=min(3, max(1, len(handles))))
