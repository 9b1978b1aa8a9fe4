"""Slices through an atlas: sections over two coordinates at several values of a third, and two normal planes."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.figure import Figure

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.color_scale import TAILS, ColorScale, color_scale
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
from pm3dof_pin.figures.outlined_mesh import OutlinedMesh, Within, draw_map, edge_handles, outlined_mesh
from pm3dof_pin.figures.style import COLORMAP, ONE_COLUMN, TWO_COLUMNS, house_style, new_figure, round_ticks
from pm3dof_pin.maps.datasets import BROKEN_LIMITS, unit_of_entry
from pm3dof_pin.maps.limit_space import limits_over
from pm3dof_pin.typing import Array, Mask

if TYPE_CHECKING:
    import xarray as xr

    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.maps.limit_space import Flags

LimitsOver: TypeAlias = "Callable[[Sequence[str], Mapping[str, float]], Callable[[Array], Flags]]"
"""Maps coordinates and values of the others to limits, see :func:`~pm3dof_pin.maps.limit_space.limits_over`."""

SECTIONS = 4
_LINE = 28  # characters, as high as the planes
_LONGEST_LABEL = 48  # characters next to the colour bar


@dataclass(eq=False)
class _Outlines:
    """Outlines of the drawn planes, by all limits over two coordinates or by reach only, found once."""

    limits: LimitsOver | None
    beyond: bool
    found: dict[tuple[Any, ...], OutlinedMesh] = field(default_factory=dict)

    def mesh(self, plane: xr.DataArray, flags: xr.DataArray, inside: Mask) -> OutlinedMesh:
        """Return the triangles of a plane."""
        dims = tuple(map(str, plane.dims))
        fixed = {name: value for name, (value, _) in fixed_coordinates(plane).items()}
        key = (dims, *fixed.items(), inside.tobytes())
        if key not in self.found:
            within: Within | None = None
            if self.limits is not None:
                broken, mask = self.limits(dims, fixed), np.uint32(1 if self.beyond else 0xFFFFFFFF)
                within = lambda points: (broken(points) & mask) == 0  # noqa: E731
            excluded = (flags.transpose(*dims).values.astype(np.uint32) & (1 if self.beyond else 0xFFFFFFFF)) != 0
            self.found[key] = outlined_mesh(plane[dims[0]].values, plane[dims[1]].values, inside, within, excluded)
        return self.found[key]


def _atlas_slices(
    values: xr.DataArray, flags: xr.DataArray, name: str, machine: str, unit: str, outlines: _Outlines
) -> Figure:
    """Draw one quantity over at most its last three dimensions, with the others at their middle values."""
    for dim in values.dims:
        if "units" not in values[dim].attrs:
            raise InvalidValueError(
                "values",
                problem=f"have dimensions {values.dims}",
                expected="coordinates of a robot, one entry per pose",
            )
    if not np.isfinite(values.values).any():
        raise InvalidValueError("values", problem="are not finite", expected="at least one pose within the limits")
    shown, stands = _last_three(values)
    limits, _ = _last_three(flags)
    title = f"{name[:1].upper()}{name[1:]}: {machine}{f', {stands}' if stands else ''}"
    factor, written = display_unit(np.nanpercentile(np.abs(values.values), 100.0 - TAILS[0]), unit)
    words = name if len(name) <= _LONGEST_LABEL else "" if written else textwrap.fill(name.partition(";")[0], _LINE)
    label = in_brackets(words, written).strip()
    with house_style():
        width, height = (TWO_COLUMNS, 4.6) if shown.ndim == 3 else (ONE_COLUMN, 2.9)
        figure = new_figure(width, height)
        figure.set_layout_engine("constrained")
        if shown.ndim == 1:
            figure.suptitle(title, wrap=True)
            _draw_line(figure.add_subplot(), shown / factor, label)
            return figure
        planes = _planes(figure, shown, limits)
        meshes = [outlines.mesh(plane, flag, np.isfinite(plane.values)) for _, plane, flag, _ in planes]
        heights = [
            mesh.values(plane.values) / factor if len(mesh.triangles) else np.empty(0)
            for mesh, (_, plane, _, _) in zip(meshes, planes, strict=True)
        ]
        scale = color_scale(values.values / factor, np.concatenate(heights))
        shown_unit = f"× {written}" if written.startswith("$") else written
        note = f"{scale.note} {shown_unit if scale.extend != 'neither' else ''}".strip()
        figure.suptitle(f"{title}\n{note}" if note else title, wrap=True)
        for (axes, plane, _, equal), mesh, numbers in zip(planes, meshes, heights, strict=True):
            _draw_plane(axes, plane, mesh, numbers, scale, equal=equal)
        _share_labels([axes for axes, *_ in planes])
        filled = ScalarMappable(scale.norm(), COLORMAP)
        bar = figure.colorbar(
            filled,
            ax=[axes for axes, *_ in planes],
            pad=0.015,
            aspect=36 if shown.ndim == 3 else 24,
            extend=scale.extend,
        )
        bar.set_label(label)
        scale.label(bar)
        handles = edge_handles(meshes)
        if handles:
            figure.legend(handles=handles, loc="outside lower center", ncols=2)
    return figure


def atlas_pictures(dataset: xr.Dataset, robot: Robot | None = None) -> dict[str, Figure]:
    """Draw all quantities of an atlas that are scalars or vectors per pose, by `<quantity>[_<entry>]`.

    With the robot, the planes end at its limits, found to 1e-3 of a cell, and values beyond the last pose within them
    are extrapolated; without it, they end at the last poses within limits.
    """
    figures = {}
    flags, machine = dataset[BROKEN_LIMITS].load(), plain(str(dataset.attrs["machine"]))
    branches = json.loads(dataset.attrs.get("specification", "{}")).get("branches", "home")
    outlines = _Outlines(
        None if robot is None else partial(limits_over, robot, branches=branches), _keeps_values_beyond(dataset, flags)
    )
    for name, variable in dataset.data_vars.items():
        own = [str(dim) for dim in variable.dims if dim not in flags.dims]
        if "flag_masks" in variable.attrs or len(own) > 1:
            continue
        words, unit = typeset(str(variable.attrs["long_name"])), str(variable.attrs["units"])
        entries = (
            {f"_{label}": variable.sel({own[0]: label}) for label in variable[own[0]].values} if own else {"": variable}
        )
        for suffix, values in entries.items():
            if np.isfinite(values.values).any():
                entry = suffix.removeprefix("_")
                title = f"{words}, {entry_words(entry)}" if suffix else words
                figures[f"{name}{suffix}"] = _atlas_slices(
                    values.load(), flags, title, machine, unit_of_entry(unit, entry), outlines
                )
    return figures


def _keeps_values_beyond(dataset: xr.Dataset, flags: xr.DataArray) -> bool:
    """Return whether there are values at poses that break a limit."""
    for variable in dataset.data_vars.values():
        if "flag_masks" not in variable.attrs and variable.dims[: flags.ndim] == flags.dims:
            finite = np.isfinite(variable.values).reshape(*flags.shape, -1).any(axis=-1)
            return bool(np.any(finite & (flags.values != 0)))
    return False


def _last_three(values: xr.DataArray) -> tuple[xr.DataArray, str]:
    """Return the values over at most the last three dimensions, and the values of the others."""
    leading = values.dims[:-3]
    field = values.isel({dim: values.sizes[dim] // 2 for dim in leading})
    words = [in_words(str(dim), float(field[dim]), field[dim].attrs["units"]) for dim in leading]
    return field, ", ".join(words)


def _draw_line(axes: Any, field: xr.DataArray, label: str) -> None:
    (dim,) = field.dims
    unit = field[dim].attrs["units"]
    axes.plot(drawn(field[dim].values, unit), field.values)
    axes.set(xlabel=axis_label(str(dim), unit), ylabel=label)


def _planes(
    figure: Figure, shown: xr.DataArray, flags: xr.DataArray
) -> list[tuple[Any, xr.DataArray, xr.DataArray, bool]]:
    """Return axes, values and limits of every plane, and whether its axes may have equal scales.

    For three dimensions these are sections at several values of the first, and planes through the middle of the others.
    """
    if shown.ndim == 2:
        return [(figure.add_subplot(), shown, flags, True)]
    stacked, first, second = map(str, shown.dims)
    axes: dict[str, Any] = figure.subplot_mosaic(
        [["0", "1", "2", "3"], ["x", "x", "y", "y"]], height_ratios=[1.0, 1.15]
    )
    planes = []
    for place, index in enumerate(_section_indices(shown)):
        at = {stacked: index}
        planes.append((axes[str(place)], shown.isel(at), flags.isel(at), True))
    for panel, dim in (("x", second), ("y", first)):
        across = {dim: _middle(shown[dim].values)}
        plane = shown.isel(across).transpose(..., stacked)
        planes.append((axes[panel], plane, flags.isel(across), False))
    return planes


def _share_labels(panels: list[Any]) -> None:
    """Omit labels that the panel to the left has."""
    labels = [axes.get_ylabel() for axes in panels]
    for place, axes in enumerate(panels[1:], start=1):
        if labels[place] == labels[place - 1]:
            axes.set_ylabel("")


def _middle(values: Array) -> int:
    """Return the index of zero, if the values have both signs, or else of the middle."""
    around_zero = values.min() < 0.0 < values.max()
    return int(np.abs(values - (0.0 if around_zero else 0.5 * (values[0] + values[-1]))).argmin())


def _section_indices(field: xr.DataArray) -> list[int]:
    """Indices of the sections: equally spaced over those with any values, and symmetric."""
    filled = np.flatnonzero(np.isfinite(field.values).any(axis=(1, 2)))
    if not filled.size:  # nothing at the middle of the dimensions that are not drawn
        filled = np.arange(len(field))
    offsets = (filled[-1] - filled[0]) * (np.arange(SECTIONS // 2) + 0.5) / SECTIONS
    lower = [round(offset) for offset in offsets]
    return [*(filled[0] + offset for offset in lower), *(filled[-1] - offset for offset in reversed(lower))]


def _draw_plane(
    axes: Any, plane: xr.DataArray, mesh: OutlinedMesh, values: Array, scale: ColorScale, *, equal: bool
) -> None:
    across, up = map(str, plane.dims)
    units = [str(plane[dim].attrs["units"]) for dim in (across, up)]
    draw_map(axes, mesh, values, scale, units, linewidth=0.8)
    words = [in_words(name, *at) for name, at in fixed_coordinates(plane).items()]
    axes.set_title(words[-1] if words else "")
    if equal and units[0] == units[1]:
        axes.set_aspect("equal")
    round_ticks(axes, across=5 if units[0] == "rad" or not equal else 3)
    axes.set_xlabel(axis_label(across, units[0]))
    axes.set_ylabel(axis_label(up, units[1]))
