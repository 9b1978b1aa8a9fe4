"""The reachable set of the machine: solid, sections and tilts over the height, beside the printed ranges (Fig. 8.2)."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Rectangle
from matplotlib.ticker import MultipleLocator
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from pm3dof_pin.chapter.limits import Limit
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.figures.space import flat_quadrilaterals, towards_viewer
from pm3dof_pin.figures.style import INK, LIMIT_COLORS, LIMIT_NAMES, house_style, new_figure
from pm3dof_pin.typing import Array
from pm3dof_pin.workspace import Workspace, WorkspaceSection

_OUTLINES = 6  # sections whose outline is drawn
_DASHES = 36  # pieces of an edge of the printed box
_ELEVATION, _AZIMUTH = 18.0, -60.0  # where the solid is looked at from [deg]
_BOX = np.array([1.0, 1.0, 1.1])  # sides of the drawing
_LIGHT = np.array([0.35, -0.75, 0.55])


def workspace_figure(tripod: Tripod, workspace: Workspace) -> Figure:
    """Draw the reachable set with the limit that ends it in colour, and the printed working ranges for comparison.

    Star-shaped sections are joined to a solid; of others, which may have holes or several parts, the boundary points
    are drawn. Where one limit takes over from another, the solid is as smooth as the stack is fine: about 200 sections
    look well.

    Args:
        tripod: the machine; the printed ranges are part of its parameters.
        workspace: its reachable set.
    """
    printed = np.degrees(tripod.parameters.tilt_range), tripod.parameters.height_range
    reach = 1.07 * float(np.degrees(np.abs([*workspace.tilt_ranges.flat, *tripod.parameters.tilt_range])).max())
    with house_style():
        figure = new_figure(9.4, 6.6)
        figure.suptitle(f"Reachable set under all joint limits: {tripod.parameters.name}")
        # placed by hand: no layout engine knows the size of labels in space
        _draw_solid(figure.add_axes((-0.03, 0.06, 0.6, 0.88), projection="3d"), workspace, printed, reach)
        _draw_outlines(figure.add_axes((0.645, 0.455, 0.335, 0.477)), workspace, printed[0], reach)
        _draw_profile(figure.add_axes((0.645, 0.08, 0.335, 0.285)), workspace, printed, reach)
        _add_legend(figure, workspace)
    return figure


def _draw_solid(axes: Any, workspace: Workspace, printed: tuple[Array, Array], reach: float) -> None:
    heights = np.concatenate([workspace.heights, printed[1]])
    limits = np.array([[-reach, reach], [-reach, reach], [heights.min(), heights.max()]])
    scale = _BOX / np.ptp(limits, axis=1)
    faces, colors = _faces(workspace.sections)
    outlines = [flat_quadrilaterals(_ring(section)[None]) for section in _shown(workspace) if section.star_shaped]
    lines = np.concatenate([*outlines, _dashed_box(*printed)])
    lines += 0.006 * towards_viewer(_ELEVATION, _AZIMUTH) / scale
    all_colors = np.concatenate([_shaded(colors, faces * scale), np.tile(to_rgba(INK), (len(lines), 1))])
    axes.add_collection3d(
        Poly3DCollection(np.concatenate([faces, lines]), facecolors=all_colors, edgecolors=all_colors, linewidths=0.5)
    )
    for section in workspace.sections:
        if not section.star_shaped:
            axes.scatter(*_points(section).T, color=_COLORS[section.limits], s=1.0, depthshade=False)
    axes.set(xlim=limits[0], ylim=limits[1], zlim=limits[2])
    axes.set_xlabel(r"$\theta_x$ [deg]")
    axes.set_ylabel(r"$\theta_y$ [deg]")
    axes.set_zlabel("$z_e$ [m]", labelpad=8)
    axes.xaxis.set_major_locator(MultipleLocator(20))
    axes.yaxis.set_major_locator(MultipleLocator(20))
    axes.tick_params(axis="z", pad=4)
    axes.view_init(elev=_ELEVATION, azim=_AZIMUTH)
    axes.set_box_aspect(_BOX, zoom=0.88)


def _faces(sections: Sequence[WorkspaceSection]) -> tuple[Array, Array]:
    """Quadrilaterals between neighbouring star-shaped sections, shape=(n, 4, 3), and their colours, shape=(n, 4)."""
    faces, colors = [np.empty((0, 4, 3))], [np.empty((0, 4))]
    for lower, upper in itertools.pairwise(sections):
        if lower.star_shaped and upper.star_shaped:
            corners = _cells(_ring(lower), _ring(upper))
            shades = _cells(*(_COLORS[np.append(section.limits, section.limits[0])] for section in (lower, upper)))
            faces.append(corners)
            # the mean of the corners softens the steps where one limit takes over from another between the rays
            colors.append(shades.mean(axis=1))
    return np.concatenate(faces), np.concatenate(colors)


def _cells(lower: Array, upper: Array) -> Array:
    """Corners of the cells between two rows (n + 1, k), going round, shape=(n, 4, k)."""
    return np.stack([lower[:-1], lower[1:], upper[1:], upper[:-1]], axis=1)


def _points(section: WorkspaceSection) -> Array:
    """Boundary points (theta_x [deg], theta_y [deg], z_e [m]), shape=(m, 3)."""
    return np.column_stack([np.degrees(section.tilts), np.full(len(section.rays), section.z_e)])


def _ring(section: WorkspaceSection) -> Array:
    """Closed outline of a star-shaped section, shape=(n + 1, 3)."""
    points = _points(section)
    return np.concatenate([points, points[:1]])


def _shaded(colors: Array, faces: Array) -> Array:
    """Darken colours (n, 4) by the angle between the faces (n, 4, 3) and the light."""
    normals = np.cross(faces[:, 2] - faces[:, 0], faces[:, 3] - faces[:, 1])
    lengths = np.linalg.norm(normals, axis=1)
    lit = normals @ (_LIGHT / np.linalg.norm(_LIGHT)) / np.where(lengths > 0.0, lengths, 1.0)
    return np.column_stack([colors[:, :3] * (0.68 + 0.32 * lit)[:, None], colors[:, 3]])


def _shown(workspace: Workspace) -> list[WorkspaceSection]:
    """Sections whose outline is drawn: equally spaced, without the ends."""
    indices = np.linspace(0, len(workspace.sections) - 1, _OUTLINES + 2).round().astype(int)[1:-1]
    return [workspace.sections[index] for index in np.unique(indices) if not workspace.sections[index].empty]


def _dashed_box(tilt: Array, height: Array) -> Array:
    """Edges of the printed ranges, every second piece of them, shape=(m, 4, 3)."""
    corners = np.array([[x, y, z] for x in tilt for y in tilt for z in height])
    edges = [(p, q) for p in range(8) for q in range(p) if np.sum(corners[p] != corners[q]) == 1]
    lines = np.stack([np.linspace(corners[p], corners[q], _DASHES) for p, q in edges])
    return flat_quadrilaterals(lines)[::2]


def _draw_outlines(axes: Any, workspace: Workspace, tilt: Array, reach: float) -> None:
    shown = _shown(workspace)
    for place, section in enumerate(shown):
        points, colors = _points(section)[:, :2], _COLORS[section.limits]
        if section.star_shaped:
            ring = np.concatenate([points, points[:1]])
            pieces = np.stack([ring[:-1], ring[1:]], axis=1)
            axes.add_collection(LineCollection(list(pieces), colors=colors, linewidths=1.2))
        else:
            axes.scatter(*points.T, color=colors, s=1.0)
        # each height stands on its own line, in a direction of its own
        x, y = points[int((place + 0.25) * len(points) / len(shown))]
        box = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none"}
        axes.text(x, y, f"{section.z_e:.3f}", fontsize=7.0, ha="center", va="center", bbox=box)
    axes.text(0.02, 0.98, "on the lines: $z_e$ [m]", fontsize=7.0, va="top", transform=axes.transAxes)
    axes.add_patch(_printed(tilt, tilt))
    axes.set(xlabel=r"$\theta_x$ [deg]", ylabel=r"$\theta_y$ [deg]", aspect="equal")
    axes.set(xlim=(-reach, reach), ylim=(-reach, reach))
    axes.xaxis.set_major_locator(MultipleLocator(20))
    axes.yaxis.set_major_locator(MultipleLocator(20))


def _draw_profile(axes: Any, workspace: Workspace, printed: tuple[Array, Array], reach: float) -> None:
    heights = workspace.heights
    ranges = np.degrees([section.tilt_ranges for section in workspace.sections])
    for axis, (name, color) in enumerate(((r"$\theta_x$", INK), (r"$\theta_y$", "#D55E00"))):
        axes.fill_betweenx(heights, ranges[:, axis, 0], ranges[:, axis, 1], color=color, alpha=0.12, linewidth=0)
        axes.plot(ranges[:, axis, 0], heights, color=color, label=name)
        axes.plot(ranges[:, axis, 1], heights, color=color)
    axes.add_patch(_printed(*printed))
    axes.set(xlabel="reached tilt [deg]", ylabel="$z_e$ [m]", xlim=(-reach, reach))
    axes.margins(y=0.05)
    axes.xaxis.set_major_locator(MultipleLocator(20))
    axes.legend(loc="center")


def _printed(across: Array, up: Array) -> Rectangle:
    return Rectangle(
        (across[0], up[0]), np.ptp(across), np.ptp(up), fill=False, linestyle=(0, (4, 3)), edgecolor=INK, linewidth=0.9
    )


def _add_legend(figure: Figure, workspace: Workspace) -> None:
    binding = [limit for limit, share in workspace.limit_shares.items() if share > 0.0]
    handles: list[Any] = [Patch(color=LIMIT_COLORS[limit], label=LIMIT_NAMES[limit]) for limit in binding]
    handles.append(Line2D([], [], color=INK, linestyle=(0, (4, 3)), linewidth=0.9, label="printed ranges"))
    figure.legend(handles=handles, loc="lower left", ncols=3)


def _first_limit(flags: int) -> Limit:
    return next((limit for limit in Limit if flags & limit), Limit.REACH)


# Colour for every sum of limits; where several bind, that of the first.
_COLORS = np.array([to_rgba(LIMIT_COLORS[_first_limit(flags)]) for flags in range(256)])
