"""The region least sensitive to errors, over two coordinates or, slice by slice, over three."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.tri import Triangulation

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.atlas import LimitsOver
from pm3dof_pin.figures.color_scale import ColorScale, color_scale
from pm3dof_pin.figures.labels import axis_label, drawn, in_words
from pm3dof_pin.figures.outlined_mesh import Within, outlined_mesh
from pm3dof_pin.figures.style import (
    COLORMAP,
    END_LINE,
    INK,
    LIMIT_LINE,
    ONE_COLUMN,
    TWO_COLUMNS,
    house_style,
    new_figure,
)
from pm3dof_pin.maps.error_budget_map import LEAST_SENSITIVE

if TYPE_CHECKING:
    import xarray as xr

_SLICES = 6
_COLUMNS = 3
_FEWEST = 4  # poses of a slice that are worth a picture


def least_sensitive_region(dataset: xr.Dataset, limits: LimitsOver | None = None) -> Figure:
    """Draw the tip error of a budget map, up to six slices of three coordinates, the least sensitive region outlined.

    `limits` make the limits over coordinates at values of others, which give the slices their exact edges.

    Raises:
        InvalidValueError: the dataset is not over two or three coordinates.
    """
    dims = [str(dim) for dim in dataset["tip_rms"].dims]
    if len(dims) not in (2, 3):
        raise InvalidValueError("dataset", dims, "a map over two or three coordinates")
    slices = _slices(dataset, dims)
    columns = min(_COLUMNS, len(slices))
    rows = -(-len(slices) // columns)
    scale = color_scale(1e6 * dataset["tip_rms"].values)
    bound = 1e6 * float(dataset["tip_rms"].where(dataset[LEAST_SENSITIVE] == 1.0).max())
    width = TWO_COLUMNS if columns > 1 else ONE_COLUMN
    with house_style():
        figure = new_figure(width, 0.8 + (width - 0.9) / columns * rows)
        figure.set_layout_engine("constrained")
        figure.suptitle(f"Least sensitive {dataset.attrs['least_sensitive_part']:.0%}: {dataset.attrs['machine']}")
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for place, (title, part) in zip(panels.flat, slices, strict=False):
            _draw(place, part, dims[:2], scale, bound, limits)
            place.label_outer()
            place.set_title(title, fontsize=7.5)
        for place in panels.flat[len(slices) :]:
            place.set_axis_off()
        filled = ScalarMappable(scale.norm(), COLORMAP)
        scale.label(figure.colorbar(filled, ax=panels, label="tip error, all sources [µm]", extend=scale.extend))
    return figure


def _slices(dataset: xr.Dataset, dims: list[str]) -> list[tuple[str, xr.Dataset]]:
    """Return slices across the third coordinate that have poses, with their titles."""
    if len(dims) == 2:
        return [("", dataset)]
    third = dataset[dims[2]]
    counts = np.isfinite(dataset["tip_rms"].transpose(*dims).values).sum(axis=(0, 1))
    full = [int(k) for k in np.flatnonzero(counts >= min(_FEWEST, counts.max()))]
    chosen = np.unique(np.linspace(0, len(full) - 1, min(_SLICES, len(full))).round().astype(int))
    return [
        (in_words(dims[2], float(third[full[k]]), third.attrs["units"]), dataset.isel({dims[2]: full[k]}))
        for k in chosen
    ]


def _draw(
    place: Any, part: xr.Dataset, dims: list[str], scale: ColorScale, bound: float, limits: LimitsOver | None
) -> None:
    units = [part[dim].attrs["units"] for dim in dims]
    place.set(xlabel=axis_label(dims[0], units[0]), ylabel=axis_label(dims[1], units[1]))
    field = 1e6 * part["tip_rms"].transpose(*dims).values
    within: Within | None = None
    if limits is not None:
        fixed = {str(c): float(part[c]) for c in part.coords if part[c].ndim == 0 and "units" in part[c].attrs}
        broken = limits(dims, fixed)
        within = lambda points: broken(points) == 0  # noqa: E731
    mesh = outlined_mesh(part[dims[0]].values, part[dims[1]].values, np.isfinite(field), within)
    if not len(mesh.triangles):
        return
    first, second = (drawn(column, unit) for column, unit in zip(mesh.points.T, units, strict=True))
    triangulation, values = Triangulation(first, second, mesh.triangles), mesh.values(field)
    place.tricontourf(triangulation, values, levels=scale.levels, norm=scale.norm(), cmap=COLORMAP, extend=scale.extend)
    if values.min() <= bound:
        lowest = min(values.min(), bound) - 1.0
        place.tricontourf(triangulation, values, levels=[lowest, bound], colors="none", hatches=["////"])
        place.tricontour(triangulation, values, levels=[bound], colors=INK, linewidths=1.2)
    for lines, style in ((mesh.limit_lines, LIMIT_LINE), (mesh.end_lines, END_LINE)):
        pieces = [np.column_stack([drawn(c, u) for c, u in zip(line.T, units, strict=True)]) for line in lines]
        place.add_collection(LineCollection(pieces, **{f"{name}s": value for name, value in style.items()}))
