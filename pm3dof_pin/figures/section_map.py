"""A map over two coordinates of a robot: surface and filled contours side by side (Figs. 8.3 and 8.4)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.path import Path
from matplotlib.ticker import MaxNLocator
from matplotlib.tri import Triangulation
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from numpy.typing import NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.labels import axis_label, drawn, in_words
from pm3dof_pin.figures.space import towards_viewer
from pm3dof_pin.figures.style import COLORMAP, INK, house_style, new_figure
from pm3dof_pin.maps.limit_flags import BROKEN_LIMITS
from pm3dof_pin.maps.units import unit_of_entry
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


_LEVELS = 20
_ELEVATION, _AZIMUTH = 28.0, -55.0  # where the surface is looked at from [deg]
_BOX = np.array([1.0, 1.0, 0.72])  # its sides
_LINE = 0.2  # height of one of the title [inch]
_PLAIN = range(-1, 4)  # powers of ten of numbers that are written out
_LONGEST_LABEL = 42  # letters beside the picture
_LONGEST_TITLE = 110  # letters in one line
_LINES = 9  # lines of the grid that are drawn on the surface, along each of its dimensions


def section_map(
    section: xr.Dataset, variable: str, outline: xr.Dataset | None = None, *, entry: str | None = None
) -> Figure:
    """Draw one variable of a section as a surface and as filled contours.

    Shown are the values at the poses of the section and along its outline, with flat triangles between them.

    Args:
        section: a dataset over two dimensions, as that of :func:`~pm3dof_pin.maps.grid_map.quantity_map`; its scalar
            coordinates stand in the title.
        variable: name of the variable, for example "stiffness_theta_x".
        outline: the same variables along a closed line, which gives the map its smooth edge; without it the map ends at
            the last poses within the limits.
        entry: label along the variable's own dimension, if it has one; of a matrix an entry of the diagonal.

    Raises:
        InvalidValueError: no such variable, other dimensions, or fewer than three values to draw.
    """
    sheet = _sheet(section, variable, outline, entry)
    with house_style():
        height = 4.0 + _LINE * sheet.title.count("\n")
        figure = new_figure(9.0, height)
        figure.suptitle(sheet.title)
        # placed by hand: no layout engine knows the size of labels in space
        part = 4.0 / height
        _draw_surface(figure.add_axes((-0.025, 0.0, 0.48, 0.95 * part), projection="3d"), sheet)
        filled = _draw_contours(figure.add_axes((0.545, 0.125 * part, 0.343, 0.77 * part)), sheet)
        figure.colorbar(filled, cax=figure.add_axes((0.905, 0.125 * part, 0.016, 0.77 * part)), label=sheet.label)
    return figure


@dataclass(frozen=True, eq=False)
class _Sheet:
    """What is drawn: (first, second coordinate, value scaled by a power of ten) at every point, and the words.

    Attributes:
        grid: points in the order of the grid, NaN where a limit excludes the pose, shape=(n, m, 3).
        edge: points along the outline, if there is one, shape=(k, 3).
        points: all points that are drawn, shape=(p, 3).
        triangles: triangles between them, indices, shape=(t, 3).
        axes: words on the axes of the coordinates.
        same_unit: whether both coordinates have one unit.
        title: words over the figure.
        label: words on the axis of the values.
    """

    grid: Array
    edge: Array | None
    points: Array
    triangles: NDArray[np.int32]
    axes: tuple[str, str]
    same_unit: bool
    title: str
    label: str

    @cached_property
    def extent(self) -> Array:
        """Ends of both coordinates: those of one unit on one scale, about zero if it is inside, shape=(2, 2)."""
        low, high = self.points[:, :2].min(axis=0), self.points[:, :2].max(axis=0)
        if not self.same_unit:
            return np.stack([low, high], axis=-1)
        if np.all((low < 0.0) & (high > 0.0)):
            reach = np.abs(self.points[:, :2]).max()
            return np.array([[-reach, reach], [-reach, reach]])
        middle, half = 0.5 * (low + high), 0.5 * (high - low).max()
        return np.stack([middle - half, middle + half], axis=-1)

    @property
    def levels(self) -> Array:
        """Round values between which the colours step."""
        low, high = float(self.points[:, 2].min()), float(self.points[:, 2].max())
        if high - low < 1e-9 * abs(high):  # constant over the section: one colour, not the noise of rounding
            low, high = low - 0.01 * abs(low), high + 0.01 * abs(high)
        return np.array(MaxNLocator(_LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))


def _sheet(section: xr.Dataset, name: str, outline: xr.Dataset | None, entry: str | None) -> _Sheet:
    if name not in section.data_vars:
        raise InvalidValueError("variable", name, f"one of {', '.join(map(str, section.data_vars))}")
    variable = section[name]
    own = [dim for dim in variable.dims if dim not in section[BROKEN_LIMITS].dims]
    if entry is not None:
        variable = variable.sel(dict.fromkeys(own, entry))
    if variable.ndim != 2:
        raise InvalidValueError("section", dict(section.sizes), "a map over two coordinates, one entry a pose")
    values, attributes = np.where(np.isfinite(variable.values), variable.values, np.nan), variable.attrs
    if np.isfinite(values).sum() < 3:
        raise InvalidValueError(name, f"{np.isfinite(values).sum()} values", "at least three poses to draw")
    exponent = math.floor(math.log10(np.nanmax(np.abs(values)) or 1.0))
    exponent = exponent if exponent not in _PLAIN else 0
    across = [str(c) for c in section.coords if section[c].dims == variable.dims] or [str(dim) for dim in variable.dims]
    units = [str(section[coordinate].attrs["units"]) for coordinate in across]
    grid = _points(section, variable, across, exponent)
    edge = None if outline is None else _points(outline, outline[name], across, exponent)
    what = _typeset(attributes["long_name"].split(",")[0])
    unit = unit_of_entry(attributes["units"], entry or "").replace("mixed", "mixed units")
    points, triangles = _triangulated(grid, edge, units[0] == units[1])
    stands = [
        in_words(str(c), float(section[c]), section[c].attrs["units"])
        for c in section.coords
        if section[c].ndim == 0 and "units" in section[c].attrs
    ]
    machine = f"{section.attrs['machine']}, {section.attrs['model']} model"
    title = f"{what[0].upper()}{what[1:]}{f', {entry}' if entry else ''}: {machine}"
    section_of = f"section {', '.join(stands)}"
    separator = ", " if len(title) + len(section_of) < _LONGEST_TITLE else "\n"
    return _Sheet(
        grid,
        edge,
        points,
        triangles,
        axes=(axis_label(across[0], units[0]), axis_label(across[1], units[1])),
        same_unit=units[0] == units[1],
        title=f"{title}{separator}{section_of}" if stands else title,
        label=_label(f"{what}{f', {entry}' if entry else ''}", exponent, unit),
    )


def _label(words: str, exponent: int, unit: str) -> str:
    """Return the words on the axis of the values; the title has them too, so long ones are left out here."""
    parts = [f"$10^{{{exponent}}}$"] if exponent else []
    parts += [unit] if unit != "1" else []
    bracket = f"[{' '.join(parts)}]" if parts else ""
    return " ".join(filter(None, [words if len(words) <= _LONGEST_LABEL or not bracket else "", bracket]))


def _points(dataset: xr.Dataset, values: xr.DataArray, across: Sequence[str], exponent: int) -> Array:
    """(first, second coordinate as drawn, value / 10^exponent) over the dimensions of the values."""
    coordinates = [
        drawn(dataset[name].broadcast_like(values).transpose(*values.dims).values, dataset[name].attrs["units"])
        for name in across
    ]
    finite = np.where(np.isfinite(values.values), values.values, np.nan)
    return np.stack([*coordinates, finite / 10.0**exponent], axis=-1)


def _typeset(text: str) -> str:
    """Set angles and axes in italics."""
    return re.sub(r"along ([xyz])", r"along $\1$", re.sub(r"theta_([xyz])", r"$\\theta_\1$", text))


def _triangulated(grid: Array, edge: Array | None, same_unit: bool) -> tuple[Array, NDArray[np.int32]]:
    """All points to draw and the triangles between them, without those outside the map."""
    inside = grid[np.isfinite(grid[..., 2])]
    points = inside if edge is None else np.concatenate([edge, inside])
    size = np.maximum(np.ptp(points[:, :2], axis=0), 1e-300)
    size = size.max() if same_unit else size
    # grids may have a point twice, as the polar one has its centre, and triangles need distinct corners
    _, first = np.unique(np.round(points[:, :2] / size, 8), axis=0, return_index=True)
    points = points[np.sort(first)]
    triangles = Triangulation(*(points[:, :2] / size).T).triangles
    corners = points[triangles][..., :2]
    if edge is not None:
        kept = Path(edge[:, :2]).contains_points(corners.mean(axis=1))
    else:
        sides = np.linalg.norm((corners - np.roll(corners, 1, axis=1)) / size, axis=-1)
        kept = sides.max(axis=1) < 1.01 * _longest_diagonal(grid[..., :2] / size)
    return points, triangles[kept]


def _longest_diagonal(places: Array) -> float:
    forward, backward = places[1:, 1:] - places[:-1, :-1], places[1:, :-1] - places[:-1, 1:]
    return float(np.linalg.norm([forward, backward], axis=-1).max())


def _draw_surface(axes: Any, sheet: _Sheet) -> None:
    levels = sheet.levels
    norm, colormap = Normalize(levels[0], levels[-1]), colormaps[COLORMAP]
    faces = sheet.points[sheet.triangles]
    face_colors = colormap(norm(faces[..., 2].mean(axis=1)))
    limits = np.vstack([sheet.extent, [levels[0], levels[-1]]])
    # Lines and triangles stand in one collection, so that they hide each other by their depth; the lines are drawn
    # a little nearer, out of the triangles they lie in.
    segments = _grid_segments(sheet.grid) + 0.01 * np.ptp(limits, axis=1) / _BOX * towards_viewer(_ELEVATION, _AZIMUTH)
    line_colors = np.tile([0.0, 0.0, 0.0, 0.6], (len(segments), 1))
    axes.add_collection3d(
        Poly3DCollection(
            np.concatenate([faces, segments]),
            facecolors=np.concatenate([face_colors, line_colors]),
            edgecolors=np.concatenate([face_colors, line_colors]),
            linewidths=0.35,
        )
    )
    if sheet.edge is not None:
        closed = np.concatenate([sheet.edge, sheet.edge[:1]])
        axes.plot(*closed.T, color=INK, linewidth=0.9)
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_xlabel(sheet.axes[0])
    axes.set_ylabel(sheet.axes[1])
    axes.set_zlabel(sheet.label, labelpad=7)
    axes.xaxis.set_major_locator(MaxNLocator(5))
    axes.yaxis.set_major_locator(MaxNLocator(5))
    axes.zaxis.set_major_locator(MaxNLocator(6))
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_box_aspect(_BOX, zoom=0.84)


def _grid_segments(grid: Array) -> Array:
    """Some lines of the grid as flat triangles (p, q, q), shape=(s, 3, 3)."""
    segments = []
    for lines in (grid, grid.swapaxes(0, 1)):
        drawn = lines[np.unique(np.linspace(0, len(lines) - 1, _LINES).round().astype(int))]
        pairs = np.stack([drawn[:, :-1], drawn[:, 1:], drawn[:, 1:]], axis=2).reshape(-1, 3, 3)
        segments.append(pairs[np.all(np.isfinite(pairs), axis=(1, 2))])
    # the last ray of a polar grid may lie on the first
    return np.unique(np.concatenate(segments).round(9), axis=0)


def _draw_contours(axes: Any, sheet: _Sheet) -> Any:
    first, second, values = sheet.points.T
    triangulation = Triangulation(first, second, sheet.triangles)
    filled = axes.tricontourf(triangulation, values, levels=sheet.levels, cmap=COLORMAP)
    axes.tricontour(triangulation, values, levels=sheet.levels, colors="white", linewidths=0.3, alpha=0.7)
    if sheet.edge is not None:
        closed = np.concatenate([sheet.edge, sheet.edge[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=INK, linewidth=1.0)
    axes.set(xlabel=sheet.axes[0], ylabel=sheet.axes[1], aspect="equal" if sheet.same_unit else "auto")
    margin = 0.025 * np.ptp(sheet.extent, axis=1)
    low, high = sheet.extent[:, 0] - margin, sheet.extent[:, 1] + margin
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]))
    return filled
