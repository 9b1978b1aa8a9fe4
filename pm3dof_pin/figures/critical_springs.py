"""The spring that governs the stiffness along each axis, over two coordinates of a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.path import Path

from pm3dof_pin.figures.labels import axis_label, drawn, entry_words, fixed_coordinates, in_words, part_words, plain
from pm3dof_pin.figures.outlined_mesh import Within, draw_edges, edge_handles, outlined_mesh
from pm3dof_pin.figures.style import TWO_COLUMNS, house_style, new_figure, spring_colors
from pm3dof_pin.maps.workspace_evaluation import CRITICAL, SHARES, TIE

if TYPE_CHECKING:
    import xarray as xr

_COLUMNS = 3
_FAINT, _FULL = 0.25, 1.0  # opacity of a spring with a negligible lead, and of one with a share of 1


def critical_springs(section: xr.Dataset, within: Within | None = None) -> Figure:
    """Draw over two coordinates, axis by axis, the spring with the largest share, in a more intense colour for more.

    The section is that of a :class:`~pm3dof_pin.maps.workspace_evaluation.WorkspaceEvaluation`, its outline that of
    `within`; between poses the shares are interpolated, so that regions have smooth edges.
    """
    critical, shares = section[CRITICAL], section[SHARES]
    first, second = (str(dim) for dim in critical.dims[:2])
    names = [str(name) for name in section["spring"].values]
    axes_names = [str(axis) for axis in section["axis"].values]
    seen = [axis for axis in axes_names if (critical.sel(axis=axis) > 0).any()]
    units = {name: section[name].attrs["units"] for name in (first, second)}
    extent = [drawn(section[name].values[[0, -1]], units[name]) for name in (first, second)]
    inside = np.isfinite(shares.values).all(axis=(-2, -1))
    mesh = outlined_mesh(section[first].values, section[second].values, inside, within)
    corners = np.stack([drawn(mesh.points[:, k], units[name]) for k, name in enumerate((first, second))], axis=-1)
    outline = Path.make_compound_path(*(Path(corners[[*triangle, triangle[0]]]) for triangle in mesh.triangles))
    rows = -(-len(seen) // _COLUMNS)
    leading = sorted({int(number) for number in np.unique(critical.values) if number > 0})
    colors = dict(zip(leading, spring_colors(len(leading)), strict=True))
    height = 2.2 * rows + 1.1
    with house_style():
        figure = new_figure(TWO_COLUMNS, height)
        panels = figure.subplots(rows, _COLUMNS, sharex=True, sharey=True, squeeze=False)
        for panel, axis in zip(panels.flat, seen, strict=False):
            fine = mesh.fine(shares.sel(axis=axis).values)
            leads = fine.max(axis=-1)
            numbers = (fine >= leads[..., None] - TIE).argmax(axis=-1) + 1  # the first of symmetric springs
            image = panel.imshow(
                numbers.T,
                origin="lower",
                extent=(*extent[0], *extent[1]),
                aspect="equal" if units[first] == units[second] else "auto",
                cmap=ListedColormap([colors.get(number, "white") for number in range(len(names) + 1)]),
                norm=BoundaryNorm(np.arange(len(names) + 2) - 0.5, len(names) + 1),
                alpha=np.clip(np.where(np.isfinite(leads), _FAINT + (_FULL - _FAINT) * leads, 0.0), 0.0, 1.0).T,
                interpolation="nearest",
            )
            image.set_clip_path(outline, panel.transData)
            draw_edges(panel, mesh, [units[first], units[second]])
            panel.set_title(entry_words(axis))
        for panel in panels.flat[len(seen) :]:
            panel.set_visible(False)
        for panel in panels[-1]:
            panel.set_xlabel(axis_label(first, units[first]))
        for panel in panels[:, 0]:
            panel.set_ylabel(axis_label(second, units[second]))
        handles = [Patch(color=colors[number], label=part_words(names[number - 1])) for number in leading]
        figure.legend(handles=[*handles, *edge_handles([mesh])], loc="lower center", ncols=6)
        stands = [in_words(name, *at) for name, at in fixed_coordinates(section).items()]
        words = f"Spring with the largest share of the deflection: {plain(section.attrs['machine'])}"
        below = ", ".join(["more intense for a larger share", *stands])
        figure.suptitle(f"{words}\n{below}", y=1.0 - 0.06 / height, va="top")
        figure.subplots_adjust(
            left=0.09, right=0.98, top=1.0 - 0.68 / height, bottom=0.85 / height, hspace=0.25, wspace=0.08
        )
    return figure
