"""The region least sensitive to errors, over two coordinates or, slice by slice, over three."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.labels import axis_label, drawn, in_words
from pm3dof_pin.figures.style import COLORMAP, INK, house_style, new_figure
from pm3dof_pin.maps.error_budget_map import LEAST_SENSITIVE
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr

_SLICES = 6
_COLUMNS = 3
_FEWEST = 4  # poses of a slice that are worth a picture
_SIDE = 2.9  # of a slice [inch]


def least_sensitive_region(dataset: xr.Dataset) -> Figure:
    """Draw the tip error of all sources, with the least sensitive region outlined.

    Args:
        dataset: result of :func:`~pm3dof_pin.maps.error_budget_map.budget_map` over two or three coordinates; of a
            third one up to six slices are drawn.

    Raises:
        InvalidValueError: the dataset is over another number of coordinates.
    """
    dims = [str(dim) for dim in dataset["tip_rms"].dims]
    if len(dims) not in (2, 3):
        raise InvalidValueError("dataset", dims, "a map over two or three coordinates")
    slices = _slices(dataset, dims)
    columns = min(_COLUMNS, len(slices))
    rows = -(-len(slices) // columns)
    levels = _levels(1e6 * dataset["tip_rms"].values)
    bound = 1e6 * float(dataset["tip_rms"].where(dataset[LEAST_SENSITIVE] == 1.0).max())
    with house_style():
        figure = new_figure(1.2 + _SIDE * columns, 0.7 + _SIDE * rows)
        figure.set_layout_engine("constrained")
        figure.suptitle(f"Least sensitive {dataset.attrs['least_sensitive_part']:.0%}: {dataset.attrs['machine']}")
        panels = figure.subplots(rows, columns, squeeze=False, sharex=True, sharey=True)
        filled: Any = None
        for place, (title, part) in zip(panels.flat, slices, strict=False):
            filled = _draw(place, part, dims[:2], levels, bound)
            place.set_title(title, fontsize="small")
        for place in panels.flat[len(slices) :]:
            place.set_axis_off()
        figure.colorbar(filled, ax=panels, label="tip error, all sources [µm]")
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


def _draw(place: Any, part: xr.Dataset, dims: list[str], levels: Array, bound: float) -> Any:
    units = [part[dim].attrs["units"] for dim in dims]
    first, second = (drawn(part[dim].values, unit) for dim, unit in zip(dims, units, strict=True))
    values = 1e6 * part["tip_rms"].transpose(dims[1], dims[0]).values
    filled = place.contourf(first, second, values, levels=levels, cmap=COLORMAP)
    if np.nanmin(values) <= bound:
        place.contourf(first, second, values, levels=[levels[0], bound], colors="none", hatches=["////"])
        place.contour(first, second, values, levels=[bound], colors=INK, linewidths=1.2)
    place.set(xlabel=axis_label(dims[0], units[0]), ylabel=axis_label(dims[1], units[1]))
    return filled


def _levels(values: Array) -> Array:
    low, high = float(np.nanmin(values)), float(np.nanmax(values))
    if high - low < 1e-9 * high:
        low, high = 0.99 * low, 1.01 * high
    return np.asarray(MaxNLocator(14).tick_values(low, high))
