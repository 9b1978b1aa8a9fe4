"""Slices through an atlas: sections over two coordinates at several values of a third, and the two planes across."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, MaxNLocator

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.labels import axis_label, drawn, in_words
from pm3dof_pin.figures.style import COLORMAP, house_style, new_figure
from pm3dof_pin.maps.limit_flags import BROKEN_LIMITS
from pm3dof_pin.maps.units import unit_of_entry
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


SECTIONS = 4
_LEVELS = 16
_LOGARITHMIC_FROM = 30.0  # ratio of the largest to the least value from which the colours are logarithmic


def _atlas_slices(values: xr.DataArray, name: str, unit: str) -> Figure:
    """Draw one quantity of an atlas.

    Of more than three dimensions the last three are drawn, the others standing at the middle of their values.

    Args:
        values: over dimensions with coordinates that have a unit; NaN where a pose is excluded.
        name: of the quantity, for the title.
        unit: its unit, for the colour bar.

    Raises:
        InvalidValueError: no value to draw, or a dimension without a unit.
    """
    for dim in values.dims:
        if "units" not in values[dim].attrs:
            raise InvalidValueError("values", f"dimensions {values.dims}", "coordinates of a robot, one entry a pose")
    finite = values.values[np.isfinite(values.values)]
    if finite.size == 0:
        raise InvalidValueError("values", "no finite number", "at least one pose within the limits")
    field, stands = _last_three(values)
    title = f"{name[:1].upper()}{name[1:]}{f': {stands}' if stands else ''}"
    norm, levels = _scale(float(finite.min()), float(finite.max()))
    with house_style():
        figure = new_figure(*((9.6, 5.4) if field.ndim == 3 else (5.4, 4.2)))
        figure.set_layout_engine("constrained")
        figure.suptitle(title)
        if field.ndim == 1:
            _draw_line(figure.add_subplot(), field, f"[{unit}]")
            return figure
        filled, axes = (_draw_three if field.ndim == 3 else _draw_two)(figure, field, norm, levels)
        bar = figure.colorbar(filled, ax=axes, pad=0.015, aspect=32)
        bar.set_label(f"[{unit}]")  # the title says what it is
        if isinstance(norm, LogNorm):
            bar.set_ticks(list(levels[::2]))
            bar.ax.yaxis.set_major_formatter(FormatStrFormatter("%.3g"))
            bar.ax.minorticks_off()
        bar.outline.set_linewidth(0.7)
    return figure


def atlas_pictures(dataset: xr.Dataset) -> dict[str, Figure]:
    """Draw every quantity of an atlas that has one number, or one list of numbers, at a pose; matrices are left out.

    Args:
        dataset: result of :func:`~pm3dof_pin.maps.atlas.open_atlas`.

    Returns:
        Figures by `<quantity>` or `<quantity>_<entry>`; none for a quantity without a finite value.
    """
    figures = {}
    for name, variable in dataset.data_vars.items():
        own = [str(dim) for dim in variable.dims if dim not in dataset[BROKEN_LIMITS].dims]
        if "flag_masks" in variable.attrs or len(own) > 1:
            continue
        words, unit = str(variable.attrs["long_name"]), str(variable.attrs["units"])
        entries = (
            {f"_{label}": variable.sel({own[0]: label}) for label in variable[own[0]].values} if own else {"": variable}
        )
        for suffix, values in entries.items():
            if np.isfinite(values.values).any():
                entry = suffix.removeprefix("_")
                title = f"{words}: {entry}" if suffix else words
                figures[f"{name}{suffix}"] = _atlas_slices(values.load(), title, unit_of_entry(unit, entry))
    return figures


def _last_three(values: xr.DataArray) -> tuple[xr.DataArray, str]:
    """Return the values over the last three dimensions at most, and where the others stand."""
    leading = values.dims[:-3]
    field = values.isel({dim: values.sizes[dim] // 2 for dim in leading})
    words = [in_words(str(dim), float(field[dim]), field[dim].attrs["units"]) for dim in leading]
    return field, ", ".join(words)


def _scale(least: float, greatest: float) -> tuple[Normalize, Array]:
    """Return the colours' scale and round levels that cover the values."""
    if least > 0.0 and greatest > _LOGARITHMIC_FROM * least:
        levels = 10.0 ** _round_levels(float(np.log10(least)), float(np.log10(greatest)))
        return LogNorm(levels[0], levels[-1]), levels
    if greatest <= least:  # a constant: any interval round it
        least, greatest = least - 0.5 * abs(least) - 0.5, greatest + 0.5 * abs(greatest) + 0.5
    levels = _round_levels(least, greatest)
    return Normalize(levels[0], levels[-1]), levels


def _round_levels(least: float, greatest: float) -> Array:
    return np.asarray(MaxNLocator(_LEVELS, steps=[1, 2, 2.5, 5, 10]).tick_values(least, greatest), dtype=float)


def _draw_line(axes: Any, field: xr.DataArray, label: str) -> None:
    (dim,) = field.dims
    unit = field[dim].attrs["units"]
    axes.plot(drawn(field[dim].values, unit), field.values)
    axes.set(xlabel=axis_label(str(dim), unit), ylabel=label)


def _draw_two(figure: Figure, field: xr.DataArray, norm: Normalize, levels: Array) -> tuple[Any, list[Any]]:
    axes = figure.add_subplot()
    return _draw_plane(axes, field, norm, levels), [axes]


def _draw_three(figure: Figure, field: xr.DataArray, norm: Normalize, levels: Array) -> tuple[Any, list[Any]]:
    """Draw sections at several values of the first dimension, and planes through the middle of the others."""
    stacked, first, second = map(str, field.dims)
    axes: dict[str, Any] = figure.subplot_mosaic(
        [["0", "1", "2", "3"], ["x", "x", "y", "y"]], height_ratios=[1.0, 1.15]
    )
    for place, index in enumerate(_section_indices(field)):
        filled = _draw_plane(axes[str(place)], field.isel({stacked: index}), norm, levels)
    for panel, dim in (("x", second), ("y", first)):
        plane = field.isel({dim: _middle(field[dim].values)})
        _draw_plane(axes[panel], plane.transpose(..., stacked), norm, levels, equal=False)
    return filled, list(axes.values())


def _middle(values: Array) -> int:
    """Return the index of zero, if the values go to both sides of it, or else of their middle."""
    around_zero = values.min() < 0.0 < values.max()
    return int(np.abs(values - (0.0 if around_zero else 0.5 * (values[0] + values[-1]))).argmin())


def _section_indices(field: xr.DataArray) -> list[int]:
    """Places of the sections: equally spread over those that have any value."""
    filled = np.flatnonzero(np.isfinite(field.values).any(axis=(1, 2)))
    if not filled.size:  # more dimensions than are drawn, and nothing at the middle of the others
        filled = np.arange(len(field))
    places = filled[0] + (filled[-1] - filled[0]) * (np.arange(SECTIONS) + 0.5) / SECTIONS
    return [int(place) for place in places]


def _draw_plane(axes: Any, plane: xr.DataArray, norm: Normalize, levels: Array, *, equal: bool = True) -> Any:
    across, up = map(str, plane.dims)
    units = [str(plane[dim].attrs["units"]) for dim in (across, up)]
    numbers = [drawn(plane[dim].values, unit) for dim, unit in zip((across, up), units, strict=True)]
    values = np.where(np.isfinite(plane.values), plane.values, np.nan).T
    filled = None
    if min(values.shape) > 1:
        filled = axes.contourf(*numbers, values, levels=levels, norm=norm, cmap=COLORMAP)
    stands = [name for name in map(str, plane.coords) if plane[name].ndim == 0 and "units" in plane[name].attrs]
    words = [in_words(name, float(plane[name]), plane[name].attrs["units"], 3) for name in stands]
    axes.set_title(words[-1] if words else "")
    if equal and units[0] == units[1]:
        axes.set_aspect("equal")
    axes.set_xlabel(axis_label(across, units[0]))
    axes.set_ylabel(axis_label(up, units[1]))
    return filled
