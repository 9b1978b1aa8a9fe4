"""Slices through an atlas: sections at several heights, and the two upright planes through the level platform."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import LogNorm, Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, MaxNLocator

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.style import COLORMAP, house_style, new_figure
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


SECTIONS = 4
_LEVELS = 16
_LOGARITHMIC_FROM = 30.0  # ratio of the largest to the least value from which the colours are logarithmic


def atlas_slices(values: xr.DataArray, name: str, unit: str) -> Figure:
    """Draw one quantity of an atlas.

    Args:
        values: over the dimensions z_e [m], theta_x and theta_y [rad]; NaN where a pose is excluded.
        name: of the quantity, for the title.
        unit: its unit, for the colour bar.

    Raises:
        InvalidValueError: other dimensions, or no value to draw.
    """
    if set(values.dims) != {"z_e", "theta_x", "theta_y"}:
        raise InvalidValueError("values", f"dimensions {values.dims}", "z_e, theta_x and theta_y, one entry a pose")
    field = values.transpose("z_e", "theta_x", "theta_y")
    finite = field.values[np.isfinite(field.values)]
    if finite.size == 0:
        raise InvalidValueError("values", "nothing but NaN", "at least one pose within the limits")
    norm, levels = _scale(float(finite.min()), float(finite.max()))
    with house_style():
        figure = new_figure(9.6, 5.4)
        figure.set_layout_engine("constrained")
        figure.suptitle(f"{name[:1].upper()}{name[1:]}")
        axes: dict[str, Any] = figure.subplot_mosaic(
            [["0", "1", "2", "3"], ["x", "x", "y", "y"]], height_ratios=[1.0, 1.15]
        )
        for panel, index in enumerate(_section_indices(field)):
            filled = _draw_section(axes[str(panel)], field.isel(z_e=index), norm, levels)
        _draw_upright(axes["x"], field.sel(theta_y=0.0, method="nearest"), "theta_x", norm, levels)
        _draw_upright(axes["y"], field.sel(theta_x=0.0, method="nearest"), "theta_y", norm, levels)
        bar = figure.colorbar(filled, ax=list(axes.values()), pad=0.015, aspect=32)
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
        Figures by `<quantity>` or `<quantity>_<entry>`; none for a quantity that is NaN everywhere.
    """
    figures = {}
    for name, variable in dataset.data_vars.items():
        own = [str(dim) for dim in variable.dims if dim not in ("z_e", "theta_x", "theta_y")]
        if "flag_masks" in variable.attrs or len(own) > 1:
            continue
        words, unit = str(variable.attrs["long_name"]), str(variable.attrs["units"])
        entries = (
            {f"_{label}": variable.sel({own[0]: label}) for label in variable[own[0]].values} if own else {"": variable}
        )
        for suffix, values in entries.items():
            if bool(values.notnull().any()):
                title = f"{words}: {suffix.removeprefix('_')}" if suffix else words
                figures[f"{name}{suffix}"] = atlas_slices(
                    values.load(), title, _unit_of(unit, suffix.removeprefix("_"))
                )
    return figures


def _unit_of(units: str, entry: str) -> str:
    """Return an entry's unit out of "N/m (x, y, z), N m/rad (rx, ry, rz)"; a unit of all entries stays as it is."""
    for unit, entries in re.findall(r"([^,()]+) \(([^()]+)\)", units):
        if entry in entries.split(", "):
            return str(unit).strip()
    return units


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


def _section_indices(field: xr.DataArray) -> list[int]:
    """Heights of the sections: equally spread over those that have any value."""
    filled = np.flatnonzero(np.isfinite(field.values).any(axis=(1, 2)))
    places = filled[0] + (filled[-1] - filled[0]) * (np.arange(SECTIONS) + 0.5) / SECTIONS
    return [int(place) for place in places]


def _draw_section(axes: Any, section: xr.DataArray, norm: Normalize, levels: Array) -> Any:
    degrees = [np.degrees(section[name].values) for name in ("theta_x", "theta_y")]
    filled = axes.contourf(*degrees, section.values.T, levels=levels, norm=norm, cmap=COLORMAP)
    axes.set_title(rf"$z_e$ = {float(section.z_e):.3f} m")
    axes.set_aspect("equal")
    axes.set_xlabel(r"$\theta_x$ [deg]")
    axes.set_ylabel(r"$\theta_y$ [deg]")
    return filled


def _draw_upright(axes: Any, plane: xr.DataArray, tilt: str, norm: Normalize, levels: Array) -> None:
    other = {"theta_x": "theta_y", "theta_y": "theta_x"}[tilt]
    degrees, heights = np.degrees(plane[tilt].values), plane["z_e"].values
    values = plane.transpose("z_e", tilt).values
    axes.contourf(degrees, heights, values, levels=levels, norm=norm, cmap=COLORMAP)
    axes.set_title(rf"$\{other}$ = {abs(np.degrees(float(plane[other]))):.1f} deg")
    axes.set_xlabel(rf"$\{tilt}$ [deg]")
    axes.set_ylabel(r"$z_e$ [m]")
