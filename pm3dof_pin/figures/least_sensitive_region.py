"""The region least sensitive to errors, over two coordinates or, in slices, over three."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib import colormaps
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.atlas import LimitsOver
from pm3dof_pin.figures.color_scale import ColorScale, color_scale
from pm3dof_pin.figures.labels import axis_label, fixed_coordinates, in_words, plain
from pm3dof_pin.figures.outlined_mesh import OutlinedMesh, Within, draw_map, edge_handles, outlined_mesh
from pm3dof_pin.figures.style import (
    COLORMAP,
    ONE_COLUMN,
    TWO_COLUMNS,
    house_style,
    new_figure,
)
from pm3dof_pin.maps.grid_map import LEAST_SENSITIVE
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr

_SLICES = 6
_COLUMNS = 3
_HATCH = "////"
_FEWEST = 4  # least number of poses of a drawn slice


def least_sensitive_region(dataset: xr.Dataset, limits: LimitsOver | None = None) -> Figure:
    """Draw the tip error of a budget map, in up to six slices, with the least sensitive region outlined.

    `limits` returns the limits over coordinates at values of the others, for the exact edges of the slices.

    Raises:
        InvalidValueError: the dataset is not over two or three coordinates.
    """
    dims = [str(dim) for dim in dataset["tip_rms"].dims]
    if len(dims) not in (2, 3):
        raise InvalidValueError("dataset", dims, "a map over two or three coordinates")
    slices = _slices(dataset, dims)
    columns = min(_COLUMNS, len(slices)) if len(slices) != 4 else 2
    rows = -(-len(slices) // columns)
    fields = [1e6 * part["tip_rms"].transpose(*dims[:2]).values for _, part in slices]
    meshes = [_mesh(part, dims[:2], field, limits) for (_, part), field in zip(slices, fields, strict=True)]
    values = [mesh.values(field) for mesh, field in zip(meshes, fields, strict=True)]
    scale = color_scale(np.stack(fields), np.concatenate(values))
    bound = 1e6 * float(dataset["tip_rms"].where(dataset[LEAST_SENSITIVE] == 1.0).max())
    width = TWO_COLUMNS if columns > 1 else ONE_COLUMN
    with house_style():
        figure = new_figure(width, 0.8 + (width - 0.9) / columns * rows)
        figure.set_layout_engine("constrained")
        part_of_all = f"{100.0 * dataset.attrs['least_sensitive_part']:.0f} %"
        figure.suptitle(f"Least sensitive {part_of_all} of the poses: {plain(dataset.attrs['machine'])}")
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        for place, (title, part), mesh, heights in zip(panels.flat, slices, meshes, values, strict=False):
            units = [part[dim].attrs["units"] for dim in dims[:2]]
            place.set(xlabel=axis_label(dims[0], units[0]), ylabel=axis_label(dims[1], units[1]))
            _draw(place, mesh, units, heights, scale, bound)
            place.set_title(title, fontsize=7.5)
        spare = panels.flat[len(slices) :]
        for place in panels.flat[: len(slices)]:
            place.label_outer()
        for place in panels[-2, columns - len(spare) :] if len(spare) else []:
            place.tick_params(labelbottom=True)
            place.set_xlabel(axis_label(dims[0], dataset[dims[0]].attrs["units"]))
        filled = ScalarMappable(scale.norm(), COLORMAP)
        words: dict[str, Any] = {"label": "tip error, all sources [µm]", "extend": scale.extend}
        region = Patch(
            facecolor=colormaps[COLORMAP](0.0), edgecolor="white", hatch=_HATCH, label=f"least sensitive {part_of_all}"
        )
        handles = [region, *edge_handles(meshes)]
        for place in spare:
            place.set_axis_off()
        if len(spare):
            below = spare[0].inset_axes((0.1, 0.45, 0.85, 0.07))
            bar = figure.colorbar(filled, cax=below, orientation="horizontal", **words)
            scale.label(bar)
            bar.ax.tick_params(rotation=45)
            spare[0].legend(handles=handles, loc="upper left", bbox_to_anchor=(0.05, 1.0))
        else:
            scale.label(figure.colorbar(filled, ax=panels, **words))
            figure.legend(handles=handles, loc="outside lower center", ncols=3)
    return figure


def _slices(dataset: xr.Dataset, dims: list[str]) -> list[tuple[str, xr.Dataset]]:
    """Return slices at values of the third coordinate that have poses, with their titles."""
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


def _mesh(part: xr.Dataset, dims: list[str], field: Array, limits: LimitsOver | None) -> OutlinedMesh:
    within: Within | None = None
    if limits is not None:
        broken = limits(dims, {name: value for name, (value, _) in fixed_coordinates(part).items()})
        within = lambda points: broken(points) == 0  # noqa: E731
    return outlined_mesh(part[dims[0]].values, part[dims[1]].values, np.isfinite(field), within)


def _draw(place: Any, mesh: OutlinedMesh, units: list[str], values: Array, scale: ColorScale, bound: float) -> None:
    triangulation = draw_map(place, mesh, values, scale, units)
    if triangulation is not None and values.min() <= bound:
        lowest = min(values.min(), bound) - 1.0
        inside = place.tricontourf(triangulation, values, levels=[lowest, bound], colors="none", hatches=[_HATCH])
        inside.set(edgecolor="white", linewidth=0.0)  # hatches have the edge colour
        place.tricontour(triangulation, values, levels=[bound], colors="white", linewidths=1.2)
