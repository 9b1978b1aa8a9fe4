"""A map over a section of the workspace: surface and filled contours side by side (Figs. 8.3 and 8.4)."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
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
from pm3dof_pin.figures.space import towards_viewer
from pm3dof_pin.figures.style import COLORMAP, INK, house_style, new_figure
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


_LEVELS = 20
_ELEVATION, _AZIMUTH = 28.0, -55.0  # where the surface is looked at from [deg]
_BOX = np.array([1.0, 1.0, 0.72])  # its sides
_LINES = 9  # lines of the grid that are drawn on the surface, along each of its dimensions


def section_map(section: xr.Dataset, variable: str, outline: xr.Dataset | None = None) -> Figure:
    """Draw one variable of a section as a surface and as filled contours.

    Shown are the values at the poses of the section and along its outline, with flat triangles between them.

    Args:
        section: result of :func:`~pm3dof_pin.maps.section.stiffness_section` at one height.
        variable: name of the variable, for example "stiffness_theta_x".
        outline: result of :func:`~pm3dof_pin.maps.section.section_outline` for the same section, which gives the map
            its smooth edge; without it the map ends at the last poses within the limits.

    Raises:
        InvalidValueError: no such variable, several heights, or fewer than three values to draw.
    """
    sheet = _sheet(section, variable, outline)
    with house_style():
        figure = new_figure(9.0, 4.0)
        figure.suptitle(sheet.title)
        # placed by hand: no layout engine knows the size of labels in space
        _draw_surface(figure.add_axes((-0.025, 0.0, 0.48, 0.95), projection="3d"), sheet)
        filled = _draw_contours(figure.add_axes((0.545, 0.125, 0.343, 0.77)), sheet)
        figure.colorbar(filled, cax=figure.add_axes((0.905, 0.125, 0.016, 0.77)), label=sheet.label)
    return figure


@dataclass(frozen=True, eq=False)
class _Sheet:
    """What is drawn: (theta_x [deg], theta_y [deg], value scaled by a power of ten) at every point, and the words.

    Attributes:
        grid: points in the order of the grid, NaN where a limit excludes the pose, shape=(n, m, 3).
        edge: points along the outline, if there is one, shape=(k, 3).
        points: all points that are drawn, shape=(p, 3).
        triangles: triangles between them, indices, shape=(t, 3).
        title: words over the figure.
        label: words on the axis of the values.
    """

    grid: Array
    edge: Array | None
    points: Array
    triangles: NDArray[np.int32]
    title: str
    label: str

    @property
    def levels(self) -> Array:
        """Round values between which the colours step."""
        low, high = float(self.points[:, 2].min()), float(self.points[:, 2].max())
        if high - low < 1e-9 * abs(high):  # constant over the section: one colour, not the noise of rounding
            low, high = low - 0.01 * abs(low), high + 0.01 * abs(high)
        return np.array(MaxNLocator(_LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(low, high))


def _sheet(section: xr.Dataset, variable: str, outline: xr.Dataset | None) -> _Sheet:
    if variable not in section.data_vars:
        raise InvalidValueError("variable", variable, f"one of {', '.join(map(str, section.data_vars))}")
    if section[variable].ndim != 2 or section["z_e"].ndim != 0:
        raise InvalidValueError("section", dict(section.sizes), "a map over a grid of tilts at one height")
    values, attributes = section[variable].values, section[variable].attrs
    if np.isfinite(values).sum() < 3:
        raise InvalidValueError(variable, f"{np.isfinite(values).sum()} values", "at least three poses to draw")
    exponent = math.floor(math.log10(np.nanmax(np.abs(values))))
    grid = _points(section, variable, exponent)
    edge = None if outline is None else _points(outline, variable, exponent)
    what = _typeset(attributes["long_name"].split(",")[0])
    units = attributes["units"].replace("mixed", "mixed units")
    points, triangles = _triangulated(grid, edge)
    return _Sheet(
        grid,
        edge,
        points,
        triangles,
        title=f"{what[0].upper()}{what[1:]}: {section.attrs['machine']}, {section.attrs['model']} model, "
        f"section $z_e$ = {float(section['z_e']):.4f} m",
        label=f"{what} [$10^{{{exponent}}}$ {units}]",
    )


def _points(dataset: xr.Dataset, variable: str, exponent: int) -> Array:
    """(theta_x [deg], theta_y [deg], value / 10^exponent) over the dimensions of the variable."""
    values = dataset[variable]
    theta_x, theta_y = (
        np.degrees(dataset[tilt].broadcast_like(values).transpose(*values.dims).values)
        for tilt in ("theta_x", "theta_y")
    )
    return np.stack([theta_x, theta_y, values.values / 10.0**exponent], axis=-1)


def _typeset(text: str) -> str:
    """Set angles and axes in italics."""
    return re.sub(r"along ([xyz])", r"along $\1$", re.sub(r"theta_([xyz])", r"$\\theta_\1$", text))


def _triangulated(grid: Array, edge: Array | None) -> tuple[Array, NDArray[np.int32]]:
    """All points to draw and the triangles between them, without those outside the map."""
    inside = grid[np.isfinite(grid[..., 2])]
    points = inside if edge is None else np.concatenate([edge, inside])
    # grids may have a point twice, as the polar one has its centre, and triangles need distinct corners
    _, first = np.unique(np.round(points[:, :2], 6), axis=0, return_index=True)
    points = points[np.sort(first)]
    triangles = Triangulation(points[:, 0], points[:, 1]).triangles
    corners = points[triangles][..., :2]
    if edge is not None:
        kept = Path(edge[:, :2]).contains_points(corners.mean(axis=1))
    else:
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
        kept = sides.max(axis=1) < 1.01 * _longest_diagonal(grid)
    return points, triangles[kept]


def _longest_diagonal(grid: Array) -> float:
    tilts = grid[..., :2]
    forward, backward = tilts[1:, 1:] - tilts[:-1, :-1], tilts[1:, :-1] - tilts[:-1, 1:]
    return float(np.linalg.norm([forward, backward], axis=-1).max())


def _draw_surface(axes: Any, sheet: _Sheet) -> None:
    levels = sheet.levels
    norm, colormap = Normalize(levels[0], levels[-1]), colormaps[COLORMAP]
    faces = sheet.points[sheet.triangles]
    face_colors = colormap(norm(faces[..., 2].mean(axis=1)))
    reach = np.abs(sheet.points[:, :2]).max()
    limits = np.array([[-reach, reach], [-reach, reach], [levels[0], levels[-1]]])
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
    axes.set_xlabel(r"$\theta_x$ [deg]")
    axes.set_ylabel(r"$\theta_y$ [deg]")
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
    theta_x, theta_y, values = sheet.points.T
    triangulation = Triangulation(theta_x, theta_y, sheet.triangles)
    filled = axes.tricontourf(triangulation, values, levels=sheet.levels, cmap=COLORMAP)
    axes.tricontour(triangulation, values, levels=sheet.levels, colors="white", linewidths=0.3, alpha=0.7)
    if sheet.edge is not None:
        closed = np.concatenate([sheet.edge, sheet.edge[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color=INK, linewidth=1.0)
    axes.set(xlabel=r"$\theta_x$ [deg]", ylabel=r"$\theta_y$ [deg]", aspect="equal")
    reach = 1.05 * np.abs(sheet.points[:, :2]).max()
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    return filled
