"""The reachable set over the coordinates of a robot: solid, sections and ranges over the third one (Fig. 8.2)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MaxNLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from pm3dof_pin.figures.labels import axis_label, drawn, plain, symbol
from pm3dof_pin.figures.space import flat_quadrilaterals, towards_viewer
from pm3dof_pin.figures.style import INK, ONE_COLUMN, TWO_COLUMNS, house_style, limit_styles, new_figure
from pm3dof_pin.maps.workspace import Workspace
from pm3dof_pin.maps.workspace_section import WorkspaceSection
from pm3dof_pin.typing import Array

_OUTLINES = 6  # sections whose outline is drawn
_DASHES = 36  # pieces of an edge of the printed box
_ELEVATION, _AZIMUTH = 18.0, -60.0  # where the solid is seen from [deg]
_BOX = np.array([1.0, 1.0, 1.1])  # sides of the drawing
_LIGHT = np.array([0.35, -0.75, 0.55])
_MARGIN = 1.07
_HALVINGS = 14
_NEAR = 0.3  # of a radius


@dataclass(frozen=True, eq=False)
class PrintedRanges:
    """Labelled ranges of the coordinates, shape=(3, 2) [m, rad], that are drawn beside the reachable set."""

    ranges: Array
    label: str = "printed ranges"


def workspace_figure(workspace: Workspace, printed: PrintedRanges | None = None) -> Figure:
    """Draw the reachable set with the limit that ends it in colour, printed ranges beside it.

    Star-shaped sections are joined to a solid; of others, which may have holes or several parts, the boundary points
    are drawn. Where one limit takes over from another between two rays, the limits are asked again. Of two coordinates
    the one section is drawn.
    """
    sheet = _Sheet(workspace, printed)
    with house_style():
        figure = new_figure(TWO_COLUMNS, 4.7) if workspace.space.stacked else new_figure(ONE_COLUMN, 3.9)
        figure.suptitle(
            f"Reachable set under all {'joint ' if printed else ''}limits: {plain(workspace.space.machine)}"
        )
        # placed by hand: no layout engine knows the size of labels in space
        if workspace.space.stacked:
            _draw_solid(figure.add_axes((-0.035, 0.05, 0.625, 0.92), projection="3d"), sheet)
            _draw_outlines(figure.add_axes((0.655, 0.475, 0.325, 0.455)), sheet)
            _draw_profile(figure.add_axes((0.655, 0.095, 0.325, 0.27)), sheet)
        else:
            _draw_outlines(figure.add_axes((0.17, 0.2, 0.78, 0.72)), sheet)
        _add_legend(figure, sheet)
    return figure


class _Sheet:
    """What is drawn: coordinates in the units of the picture, colours of the limits, and the ends of the axes."""

    def __init__(self, workspace: Workspace, printed: PrintedRanges | None) -> None:
        space = workspace.space
        self.workspace = workspace
        self.units = space.units
        self.labels = [axis_label(name, unit) for name, unit in zip(space.names, space.units, strict=True)]
        self.same_unit = space.units[0] == space.units[1]
        # where several limits bind the first is shown; those that are shown have colours of their own
        flags = np.concatenate([section.limits for section in workspace.sections])
        lowest = np.log2((flags & -flags.astype(np.int64))[flags > 0]).astype(int)
        self.shown_limits = [space.limits[k] for k in np.unique(lowest)]
        self.styles = limit_styles([*self.shown_limits, *(n for n in space.limits if n not in self.shown_limits)])
        self.printed_label = "" if printed is None else printed.label
        self.printed = None
        if printed is not None:
            self.printed = np.array([drawn(row, unit) for row, unit in zip(printed.ranges, space.units, strict=True)])
        self.limits = self._axes_limits()
        colors = np.array([to_rgba(self.styles[name][0]) for name in space.limits])
        self.color_of = np.vstack([colors, to_rgba(self.styles["reach"][0])])

    def _axes_limits(self) -> Array:
        ranges = [drawn(row, unit) for row, unit in zip(self.workspace.ranges, self.units, strict=False)]
        spans = np.array(ranges if self.printed is None else np.concatenate([ranges, self.printed[:2]], axis=1))
        low, high = spans.min(axis=1), spans.max(axis=1)
        if self.same_unit and np.all((low < 0.0) & (high > 0.0)):
            reach = _MARGIN * float(np.abs(spans).max())
            plane = np.array([[-reach, reach], [-reach, reach]])
        else:
            half = 0.5 * _MARGIN * (high - low)
            half = np.full(2, half.max()) if self.same_unit else half
            plane = np.stack([0.5 * (low + high) - half, 0.5 * (low + high) + half], axis=1)
        if not self.workspace.space.stacked:
            return plane
        levels = drawn(self.workspace.levels, self.units[2])
        ends = levels if self.printed is None else np.concatenate([levels, self.printed[2]])
        return np.vstack([plane, [ends.min(), ends.max()]])

    def points(self, section: WorkspaceSection) -> Array:
        """Boundary points as drawn, shape=(m, 2) or (m, 3) with the level."""
        levels = np.full(len(section.rays), section.level)
        return self.placed(section.radii, section.azimuths[section.rays], levels)

    def placed(self, radii: Array, azimuths: Array, levels: Array) -> Array:
        """Points as drawn, shape=(m, 2) or (m, 3) with the level."""
        space = self.workspace.space
        columns = [*space.points(radii, azimuths).T, *([levels] if space.stacked else [])]
        return np.column_stack([drawn(column, unit) for column, unit in zip(columns, self.units, strict=False)])

    def ring(self, section: WorkspaceSection) -> Array:
        """Closed outline of a star-shaped section."""
        points = self.points(section)
        return np.concatenate([points, points[:1]])

    def first(self, flags: NDArray[np.uint32]) -> NDArray[np.intp]:
        """Number of the first limit in each sum of limits; that after the last for none."""
        bits = (np.asarray(flags)[..., None] >> np.arange(len(self.color_of) - 1, dtype=np.uint32)) & 1
        return np.where(bits.any(axis=-1), bits.argmax(axis=-1), len(self.color_of) - 1)

    def colors(self, flags: NDArray[np.uint32]) -> Array:
        """Colour for each sum of limits; where several bind, that of the first, shape=(..., 4)."""
        found: Array = self.color_of[self.first(flags)]
        return found

    @property
    def closed(self) -> bool:
        """Whether the faces between sections are a closed body: it ends in points."""
        sections = self.workspace.sections
        areas = self.workspace.areas
        return all(section.star_shaped for section in sections) and bool(areas[[0, -1]].max() < 1e-2 * areas.max())

    @property
    def shown(self) -> list[WorkspaceSection]:
        """Sections whose outline is drawn: equally spaced, without the ends."""
        sections = self.workspace.sections
        if len(sections) == 1:
            return list(sections)
        indices = np.linspace(0, len(sections) - 1, _OUTLINES + 2).round().astype(int)[1:-1]
        return [sections[index] for index in np.unique(indices) if not sections[index].empty]


def _draw_solid(axes: Any, sheet: _Sheet) -> None:
    scale = _BOX / np.ptp(sheet.limits, axis=1)
    faces, colors = _faces(sheet)
    towards = towards_viewer(_ELEVATION, _AZIMUTH)
    if sheet.closed:  # what faces away is behind the rest, and would show as a fringe around it
        facing = _normals(faces * scale) @ towards > -1e-3
        faces, colors = faces[facing], colors[facing]
    outlines = [_outline(sheet, section, towards / scale if sheet.closed else None) for section in sheet.shown]
    lines = np.concatenate(
        [np.empty((0, 4, 3)), *outlines, *([] if sheet.printed is None else [_dashed(sheet.printed)])]
    )
    lines = lines + 0.02 * towards / scale
    all_colors = np.concatenate([_shaded(colors, faces * scale), np.tile(to_rgba(INK), (len(lines), 1))])
    axes.add_collection3d(
        Poly3DCollection(
            np.concatenate([faces, lines]),
            facecolors=all_colors,
            edgecolors=all_colors,
            linewidths=0.25,
            joinstyle="bevel",  # mitres of thin faces would stand out as spikes
            rasterized=True,
        )
    )
    for section in sheet.workspace.sections:
        if not section.star_shaped:
            axes.scatter(*sheet.points(section).T, color=sheet.colors(section.limits), s=1.0, depthshade=False)
    axes.set(xlim=sheet.limits[0], ylim=sheet.limits[1], zlim=sheet.limits[2])
    axes.set_xlabel(sheet.labels[0], labelpad=-2)
    axes.set_ylabel(sheet.labels[1], labelpad=-2)
    axes.set_zlabel(sheet.labels[2], labelpad=3)
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.tick_params(axis="z", pad=1)
    axes.tick_params(axis="x", pad=-1)
    axes.tick_params(axis="y", pad=-1)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_box_aspect(_BOX, zoom=0.95)


def _outline(sheet: _Sheet, section: WorkspaceSection, towards: Array | None) -> Array:
    """Return the outline of a star-shaped section as flat polygons, or what of it faces the viewer."""
    if not section.star_shaped:
        return np.empty((0, 4, 3))
    pieces = flat_quadrilaterals(sheet.ring(section)[None])
    if towards is None:
        return pieces
    outward = np.cross(pieces[:, 1] - pieces[:, 0], [0.0, 0.0, 1.0])
    return pieces[outward @ towards > 0.0]


def _faces(sheet: _Sheet) -> tuple[Array, Array]:
    """Quadrilaterals between neighbouring star-shaped sections, shape=(n, 4, 3), and their colours, shape=(n, 4)."""
    faces, colors = [np.empty((0, 4, 3))], [np.empty((0, 4))]
    for lower, upper in itertools.pairwise(sheet.workspace.sections):
        if lower.star_shaped and upper.star_shaped:
            corners = _cells(sheet.ring(lower), sheet.ring(upper))
            binding = [sheet.first(section.limits) for section in (lower, upper)]
            owners = _cells(*(np.append(limit, limit[0])[:, None] for limit in binding))[..., 0].astype(np.intp)
            mixed = np.any(owners != owners[:, :1], axis=1)
            parts, own = _cut(sheet, lower, upper, corners[mixed], owners[mixed], np.flatnonzero(mixed))
            faces += [corners[~mixed], parts]
            colors += [sheet.color_of[owners[~mixed, 0]], sheet.color_of[own]]
    return np.concatenate(faces), np.concatenate(colors)


def _cut(
    sheet: _Sheet,
    lower: WorkspaceSection,
    upper: WorkspaceSection,
    corners: Array,
    owners: NDArray[np.intp],
    rays: NDArray[np.intp],
) -> tuple[Array, NDArray[np.intp]]:
    """Cut cells in which one limit takes over from another along the edge of the body where it does so.

    Cells lie between two sections, corners going round, shape=(n, 4, 3), with the numbers of their limits and the first
    ray of each. Returns parts of the cells, shape=(m, 4, 3), and the number of the limit of each.
    """
    following = (rays + 1) % len(lower.azimuths)
    step = lower.azimuths[1] - lower.azimuths[0]
    radii = np.stack([lower.radii[rays], lower.radii[following], upper.radii[following], upper.radii[rays]], axis=-1)
    azimuths = lower.azimuths[rays][:, None] + step * np.array([0.0, 1.0, 1.0, 0.0])
    levels = np.broadcast_to([lower.level, lower.level, upper.level, upper.level], radii.shape)
    crossed = owners != np.roll(owners, -1, axis=1)
    first, last = (np.stack([x[crossed] for x in way]) for way in (
        (radii, azimuths, levels), (np.roll(x, -1, axis=1) for x in (radii, azimuths, levels))
    ))  # fmt: skip
    low, high, own = np.zeros(first.shape[1]), np.ones(first.shape[1]), owners[crossed]
    for _ in range(_HALVINGS):
        part = 0.5 * (low + high)
        _, limit = _boundary(sheet, *(first + part * (last - first)))
        low, high = np.where(limit == own, part, low), np.where(limit == own, high, part)
    chord, azimuth, level = first + low * (last - first)
    radius, _ = _boundary(sheet, chord, azimuth, level)
    # far from the chord another part of the set was met, which too few sections do not show
    radius = np.where(np.abs(radius - chord) < _NEAR * chord, radius, chord)
    edge = np.full(corners.shape, np.nan)
    edge[crossed] = sheet.placed(radius, azimuth, level)
    parts: list[Array] = []
    numbers: list[int] = []
    for cell, own, cut, places in zip(corners, owners, crossed, edge, strict=True):
        for start in np.flatnonzero(cut):  # from there to the next crossing, going round, one limit holds
            ring, k = [places[start]], (start + 1) % 4
            while not cut[k]:
                ring, k = [*ring, cell[k]], (k + 1) % 4
            ring += [cell[k], places[k]]
            if cut.sum() > 2:  # three limits or more meet within the cell
                ring.append(places[cut].mean(axis=0))
            parts += [np.stack([ring[0], *ring[i : i + 2], ring[i + 1]]) for i in range(1, len(ring) - 1)]
            numbers += [own[(start + 1) % 4]] * (len(ring) - 2)
    return np.array(parts).reshape(-1, 4, 3), np.array(numbers, dtype=np.intp)


def _boundary(sheet: _Sheet, radius: Array, azimuth: Array, level: Array) -> tuple[Array, NDArray[np.intp]]:
    """Return the radius of the reachable set near given ones, by bisection, and the limit that is broken beyond."""
    space = sheet.workspace.space
    # the sections are star-shaped, so that a ray leaves them once
    inner, outer = np.zeros(radius.shape), np.minimum(2.0 * radius + space.ray_step, space.reach)
    for _ in range(_HALVINGS + 8):
        middle = 0.5 * (inner + outer)
        keeps = space.within(space.points(middle, azimuth), level)
        inner, outer = np.where(keeps, middle, inner), np.where(keeps, outer, middle)
    return inner, sheet.first(space.flags(space.points(outer, azimuth), level))


def _cells(lower: Array, upper: Array) -> Array:
    """Corners of the cells between two rows (n + 1, k), going round, shape=(n, 4, k)."""
    return np.stack([lower[:-1], lower[1:], upper[1:], upper[:-1]], axis=1)


def _shaded(colors: Array, faces: Array) -> Array:
    """Darken colours (n, 4) by the angle between the faces (n, 4, 3) and the light."""
    lit = _normals(faces) @ (_LIGHT / np.linalg.norm(_LIGHT))
    return np.column_stack([colors[:, :3] * (0.68 + 0.32 * lit)[:, None], colors[:, 3]])


def _normals(faces: Array) -> Array:
    """Return unit vectors out of the body, across faces (n, 4, 3); of faces without area 0."""
    normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.asarray(normals / np.where(lengths > 0.0, lengths, 1.0))


def _dashed(ranges: Array) -> Array:
    """Edges of a box, every second piece of them, shape=(m, 4, 3)."""
    corners = np.array(list(itertools.product(*ranges)))
    edges = [(p, q) for p in range(8) for q in range(p) if np.sum(corners[p] != corners[q]) == 1]
    lines = np.stack([np.linspace(corners[p], corners[q], _DASHES) for p, q in edges])
    return flat_quadrilaterals(lines)[::2]


def _draw_outlines(axes: Any, sheet: _Sheet) -> None:
    for place, section in enumerate(sheet.shown):
        points, colors = sheet.points(section)[:, :2], sheet.colors(section.limits)
        if section.star_shaped:
            ring = np.concatenate([points, points[:1]])
            pieces = np.stack([ring[:-1], ring[1:]], axis=1)
            axes.add_collection(LineCollection(list(pieces), colors=colors, linewidths=1.2))
        else:
            axes.scatter(*points.T, color=colors, s=1.0)
        if sheet.workspace.space.stacked:
            # each level stands on its own line, in a direction of its own
            x, y = points[int((place + 0.25) * len(points) / len(sheet.shown))]
            box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}
            level = float(drawn(section.level, sheet.units[2]))
            text = f"{level:.3f}" if sheet.units[2] == "m" else f"{level:.1f}"
            text = text.replace("-", "\N{MINUS SIGN}")
            axes.text(x, y, text, fontsize=6.5, ha="center", va="center", bbox=box)
    if sheet.workspace.space.stacked:
        axes.text(0.02, 0.98, f"on the lines: {sheet.labels[2]}", fontsize=7.0, va="top", transform=axes.transAxes)
    if sheet.printed is not None:
        axes.add_patch(_rectangle(sheet.printed[0], sheet.printed[1]))
    axes.set(xlabel=sheet.labels[0], ylabel=sheet.labels[1], aspect="equal" if sheet.same_unit else "auto")
    axes.set(xlim=sheet.limits[0], ylim=sheet.limits[1])
    axes.xaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))
    axes.yaxis.set_major_locator(MaxNLocator(5, steps=[1, 2, 5, 10]))


def _draw_profile(axes: Any, sheet: _Sheet) -> None:
    """Draw the ranges of both coordinates over the third: in one unit if they have one, else as parts of the axes."""
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
        xlabel=f"range of {both} {unit if sheet.same_unit else '[part of the axes above]'}", ylabel=sheet.labels[2]
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
        handles.append(Line2D([], [], color=INK, linestyle=(0, (4, 3)), linewidth=0.9, label=sheet.printed_label))
    figure.legend(handles=handles, loc="lower left", ncols=min(3, max(1, len(handles))))
