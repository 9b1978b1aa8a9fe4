"""A map over two coordinates of a robot: surface and filled contours side by side (Figs. 8.3 and 8.4)."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import FixedLocator, FuncFormatter, MaxNLocator
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Line3DCollection
from numpy.typing import NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.color_scale import ColorScale, axis_number, color_scale
from pm3dof_pin.figures.labels import (
    axis_label,
    display_unit,
    drawn,
    entry_words,
    fixed_coordinates,
    in_brackets,
    in_words,
    plain,
    typeset,
)
from pm3dof_pin.figures.outlined_mesh import OutlinedMesh, Within, outlined_mesh
from pm3dof_pin.figures.raster_surface import RasterSurface
from pm3dof_pin.figures.style import (
    COLORMAP,
    END_LINE,
    LIMIT_LINE,
    TWO_COLUMNS,
    collected,
    house_style,
    new_figure,
    round_ticks,
    towards_viewer,
)
from pm3dof_pin.maps.datasets import BROKEN_LIMITS, unit_of_entry
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    from pm3dof_pin.maps.datasets import Map


_ELEVATION, _AZIMUTH = 28.0, -55.0  # of the view of the surface [deg]
_BOX = np.array([1.0, 1.0, 0.72])  # sides of the drawing
_HEIGHT, _LINE = 3.2, 0.17  # of the picture and of a line of its title [inch]
_LONGEST_LABEL = 36  # characters next to the picture
_LONGEST_TITLE = 100  # characters in one line
_PIECES = 160  # of a line of the grid
_LINES = 9  # grid lines drawn on the surface along each dimension


def section_map(
    section: Map,
    variable: str,
    *,
    entry: str | None = None,
    within: Within | None = None,
    exact: Callable[[Array], Array] | None = None,
    meshes: dict[bytes, OutlinedMesh] | None = None,
) -> Figure:
    """Draw one variable of a section as a surface and as filled contours, two journal columns wide.

    It shows the values at the poses of the section and along its outline, with flat triangles in between. The outline
    is found by the limits `within`; without them, the map ends at the last poses. `exact` evaluates the variable at any
    points within the limits, shape=(n, 2) to (n,); without it, values are interpolated between poses and extrapolated
    to the outline. `entry` is the label along the variable's own dimension, or of a diagonal entry of a matrix.
    `meshes` keeps the triangles from one picture of a section and its limits for the next ones.

    Raises:
        InvalidValueError: no such variable, other dimensions, fewer than three values to draw, or no area of them.
    """
    sheet = _sheet(section, variable, entry, within, exact, {} if meshes is None else meshes)
    with house_style():
        height = _HEIGHT + _LINE * sheet.title.count("\n")
        figure = new_figure(TWO_COLUMNS, height)
        figure.suptitle(sheet.title, y=1.0 - 0.09 / height, va="top")
        # placed manually: layout engines do not know the size of labels in 3D
        part = _HEIGHT / height
        _draw_surface(figure.add_axes((-0.03, 0.02, 0.48, 0.93 * part), projection="3d"), sheet)
        contours = figure.add_axes((0.555, 0.19 * part, 0.325, 0.67 * part))
        filled = _draw_contours(contours, sheet)
        bar = figure.colorbar(filled, cax=figure.add_axes((0.9, 0.19 * part, 0.016, 0.67 * part)), label=sheet.label)
        sheet.scale.label(bar)
        _add_legend(figure, sheet)
    return figure


@dataclass(frozen=True, eq=False)
class _Sheet:
    """The drawn data, (first, second coordinate, value in display units) at every point, and the texts."""

    grid: Array  #: points in grid order, NaN where a limit excludes the pose, shape=(n, m, 3)
    points: Array  #: all drawn points, shape=(p, 3)
    triangles: NDArray[np.int32]  #: triangles by point indices, shape=(t, 3)
    limit_lines: list[Array]  #: lines where a limit ends the map, each shape=(k, 3)
    end_lines: list[Array]  #: lines where the grid ends it
    axes: tuple[str, str]  #: labels of the coordinate axes
    same_unit: bool  #: whether both coordinates have the same unit
    title: str  #: title of the figure
    label: str  #: label of the value axis

    @cached_property
    def extent(self) -> Array:
        """Ends of both axes, shape=(2, 2): equal scales for the same unit, symmetric about zero if it is inside."""
        low, high = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        if not self.same_unit:
            return np.stack([low, high], axis=-1)
        if np.all((low < 0.0) & (high > 0.0)):
            reach = np.abs(self.points[:, :2]).max()
            return np.array([[-reach, reach], [-reach, reach]])
        middle, half = 0.5 * (low + high), 0.5 * (high - low).max()
        return np.stack([middle - half, middle + half], axis=-1)

    @cached_property
    def scale(self) -> ColorScale:
        """Values between which the colours step."""
        return color_scale(self.grid[..., 2], self.points[:, 2])


def _sheet(
    section: Map,
    name: str,
    entry: str | None,
    within: Within | None,
    exact: Callable[[Array], Array] | None,
    meshes: dict[bytes, OutlinedMesh],
) -> _Sheet:
    if name not in section.data_vars:
        raise InvalidValueError("variable", name, f"one of {', '.join(map(str, section.data_vars))}")
    variable, broken = section.variables[name], section.variables[BROKEN_LIMITS]
    across, attributes = [str(dim) for dim in variable.dims if dim in broken.dims], variable.attrs
    index = [
        slice(None) if dim in across or entry is None else list(section.variables[dim].values).index(entry)
        for dim in map(str, variable.dims)
    ]
    values = variable.values[tuple(index)]
    if values.ndim != 2:
        sizes = dict(zip(variable.dims, variable.values.shape, strict=True))
        raise InvalidValueError("section", sizes, "a map over two coordinates, one entry per pose")
    values = np.where(np.isfinite(values), values, np.nan)
    if np.isfinite(values).sum() < 3:
        raise InvalidValueError(
            name, problem=f"has {np.isfinite(values).sum()} values", expected="at least three poses to draw"
        )
    factor, unit = display_unit(values, unit_of_entry(attributes["units"], entry or ""))
    units = [str(section.variables[coordinate].attrs["units"]) for coordinate in across]
    axes = [section.variables[coordinate].values for coordinate in across]
    excluded = np.transpose(broken.values, [broken.dims.index(dim) for dim in across]) != 0
    known = np.isfinite(values)
    if (key := known.tobytes()) not in meshes:
        meshes[key] = outlined_mesh(axes[0], axes[1], known, within, excluded)
    mesh = meshes[key]
    if not len(mesh.triangles):
        raise InvalidValueError(
            name,
            problem=f"has {known.sum()} values within the limits, which span no area",
            expected="poses beside each other along both coordinates: a finer grid, or one nearer to home",
        )
    heights = mesh.values(values)
    if exact is not None:
        found = exact(mesh.points)
        heights = np.where(np.isfinite(found), found, heights)

    def shown(points: Array, heights: Array) -> Array:
        return np.stack([*(drawn(points[..., k], unit) for k, unit in enumerate(units)), heights], axis=-1)

    points = shown(mesh.points, heights / factor)
    what = typeset(attributes["long_name"].split(",")[0])
    stands = [in_words(name, *at) for name, at in fixed_coordinates(section).items()]
    machine = f"{plain(section.attrs['machine'])}, {section.attrs['model']} model"
    words = f"{what}{f', {entry_words(entry)}' if entry else ''}"
    title = f"{words[0].upper()}{words[1:]}: {machine}"
    section_of = f"section {', '.join(stands)}"
    separator = ", " if len(title) + len(section_of) < _LONGEST_TITLE else "\n"
    return _Sheet(
        shown(np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1), values / factor),
        points,
        mesh.triangles.astype(np.int32),
        [points[line] for line in mesh.limit_lines],
        [points[line] for line in mesh.end_lines],
        axes=(axis_label(across[0], units[0]), axis_label(across[1], units[1])),
        same_unit=units[0] == units[1],
        title=f"{title}{separator}{section_of}" if stands else title,
        # long names are omitted, since the title has them
        label=in_brackets(words if len(words) <= _LONGEST_LABEL else "", unit).strip(),
    )


def _draw_surface(axes: Any, sheet: _Sheet) -> None:
    scale = sheet.scale
    levels = np.array([scale.levels[0], scale.levels[-1]])

    def heights(values: Array) -> Array:  # clip values beyond the colour scale
        within: Array = np.clip(values, *levels)
        return np.log10(within) if scale.logarithmic else within

    points = np.column_stack([sheet.points[:, :2], heights(sheet.points[:, 2])])
    faces = points[sheet.triangles]
    norm = scale.smooth_norm()
    colors = colormaps[COLORMAP](norm(10.0 ** faces[:, :, 2] if scale.logarithmic else faces[:, :, 2]))
    limits = np.vstack([sheet.extent, heights(levels)])
    lifted = np.concatenate([sheet.grid[..., :2], heights(sheet.grid[..., 2:])], axis=-1)
    segments = _grid_segments(lifted) + 0.02 * np.ptp(limits, axis=1) / _BOX * towards_viewer(_ELEVATION, _AZIMUTH)
    axes.add_collection(RasterSurface(faces, colors, segments, (0.0, 0.0, 0.0, 0.6), 0.35), autolim=False)
    for lines, style in ((sheet.limit_lines, LIMIT_LINE), (sheet.end_lines, END_LINE)):
        raised = [np.column_stack([line[:, :2], heights(line[:, 2])]) for line in lines]
        if raised:
            axes.add_collection3d(Line3DCollection(raised, **collected(style)))
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_xlabel(sheet.axes[0], labelpad=-1)
    axes.set_ylabel(sheet.axes[1], labelpad=-1)
    axes.set_zlabel(sheet.label, labelpad=4)
    round_ticks(axes, 4, 4)
    axes.zaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
    if scale.logarithmic:
        axes.zaxis.set_major_locator(FixedLocator([math.log10(tick) for tick in scale.ticks]))
        axes.zaxis.set_major_formatter(FuncFormatter(lambda value, _: axis_number(10.0**value)))
    axes.tick_params(pad=-1)
    axes.tick_params(axis="z", pad=3)
    for axis, label in ((axes.xaxis, "x"), (axes.yaxis, "y")):  # the nearest corner is shared
        low, high = getattr(axes, f"get_{label}lim")()
        near = high if label == "x" else low
        ticks = [tick for tick in axis.get_majorticklocs() if low <= tick <= high]
        axis.set_major_locator(FixedLocator([t for t in ticks if abs(t - near) > 0.06 * (high - low)]))
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_box_aspect(_BOX, zoom=0.84)


def _grid_segments(grid: Array) -> Array:
    """Return pieces of some grid lines, shape=(s, 2, 3)."""
    segments = []
    for lines in (grid, grid.swapaxes(0, 1)):
        drawn = lines[np.unique(np.linspace(0, len(lines) - 1, _LINES).round().astype(int))]
        pairs = np.stack([drawn[:, :-1], drawn[:, 1:]], axis=2).reshape(-1, 2, 3)
        segments.append(pairs[np.all(np.isfinite(pairs), axis=(1, 2))])
    # the last ray of a polar grid may coincide with the first
    lines_drawn = np.unique(np.concatenate(segments).round(9), axis=0)
    # pieces as short as the faces, for consistent depth sorting
    parts = np.linspace(0.0, 1.0, max(1, -(-_PIECES // max(grid.shape[:2]))) + 1)[:, None, None, None]
    first, last = lines_drawn[:, :1], lines_drawn[:, 1:2]
    starts, ends = (first + part * (last - first) for part in (parts[:-1], parts[1:]))
    return np.concatenate([starts, ends], axis=2).reshape(-1, 2, 3)


def _draw_contours(axes: Any, sheet: _Sheet) -> Any:
    first, second, values = sheet.points.T
    scale = sheet.scale
    triangulation = Triangulation(first, second, sheet.triangles)
    filled = axes.tricontourf(
        triangulation, values, levels=scale.levels, cmap=COLORMAP, norm=scale.norm(), extend=scale.extend
    )
    axes.tricontour(triangulation, values, levels=scale.levels, colors="white", linewidths=0.3, alpha=0.7)
    for lines, style in ((sheet.limit_lines, LIMIT_LINE), (sheet.end_lines, END_LINE)):
        axes.add_collection(LineCollection([line[:, :2] for line in lines], **collected(style)), autolim=False)
    if scale.note:
        axes.set_title(scale.note, fontsize=7.0, style="italic", pad=3.0)
    axes.set(xlabel=sheet.axes[0], ylabel=sheet.axes[1], aspect="equal" if sheet.same_unit else "auto")
    margin = 0.025 * np.ptp(sheet.extent, axis=1)
    low, high = sheet.extent[:, 0] - margin, sheet.extent[:, 1] + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    round_ticks(axes)
    return filled


def _add_legend(figure: Figure, sheet: _Sheet) -> None:
    kinds = (("limit", sheet.limit_lines, LIMIT_LINE), ("end of the grid", sheet.end_lines, END_LINE))
    handles = [Line2D([], [], label=text, **style) for text, lines, style in kinds if lines]
    if handles:
        figure.legend(handles=handles, loc="lower right", ncols=2, bbox_to_anchor=(0.9, 0.0), borderaxespad=0.2)
