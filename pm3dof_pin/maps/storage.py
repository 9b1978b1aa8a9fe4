"""Writing maps: NetCDF for programs, CSV for a spreadsheet."""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import write_atomically, write_text_atomically
from pm3dof_pin.maps.section import BROKEN_LIMITS

if TYPE_CHECKING:
    import xarray as xr

POSE = ("theta_x", "theta_y", "z_e")


def write_netcdf(dataset: xr.Dataset, path: Path | str) -> Path:
    """Write a map as NetCDF-4, compressed, angles in radians; equal maps give equal bytes.

    Args:
        dataset: result of :func:`~pm3dof_pin.maps.section.stiffness_section` or the like.
        path: file to write.

    Returns:
        The path written.

    Raises:
        OutputError: the file cannot be written; nothing is left of it.
    """
    encoding = {str(name): {"zlib": True, "complevel": 4} for name in dataset.data_vars}
    with write_atomically(path) as temporary:
        try:
            dataset.to_netcdf(temporary, engine="netcdf4", format="NETCDF4", encoding=encoding)
        except RuntimeError as error:  # what the NetCDF library makes of a full disk
            raise OutputError(path, str(error)) from error
    return Path(path)


def write_csv(dataset: xr.Dataset, path: Path | str) -> Path:
    """Write a map as CSV for a spreadsheet: one row a pose, angles in degrees, the unit at the end of each heading.

    Limits are written as words; what is excluded by one is an empty cell.

    Args:
        dataset: a map whose variables stand over the same dimensions, with the coordinates theta_x, theta_y and z_e.
        path: file to write.

    Returns:
        The path written.

    Raises:
        OutputError: the file cannot be written; nothing is left of it.
    """
    columns = dict(_columns(dataset))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return write_text_atomically(path, text.getvalue())


def _columns(dataset: xr.Dataset) -> Iterator[tuple[str, list[str]]]:
    """Heading and cells of each column."""
    template = next(iter(dataset.data_vars.values()))
    for name in (*POSE, *map(str, dataset.data_vars)):
        variable = dataset[name].broadcast_like(template).transpose(*template.dims)
        if "flag_masks" in variable.attrs:
            if name == BROKEN_LIMITS:
                yield "within_limits", ["FALSE" if flags else "TRUE" for flags in variable.values.flat]
            yield name, _words(variable)
        else:
            yield _column_of_numbers(name, variable)


def _column_of_numbers(name: str, variable: xr.DataArray) -> tuple[str, list[str]]:
    unit, values = variable.attrs["units"], variable.values
    if unit == "rad":
        unit, values = "deg", np.degrees(values)
    heading = f"{name}_{unit.replace('/', '_per_').replace(' ', '_')}"
    return heading, ["" if np.isnan(value) else f"{value:.12g}" for value in values.flat]


def _words(variable: xr.DataArray) -> list[str]:
    """Names of the flags in each value, with blanks between them."""
    masks, meanings = variable.attrs["flag_masks"], variable.attrs["flag_meanings"].split()
    words = {
        flags: " ".join(word for mask, word in zip(masks, meanings, strict=True) if flags & mask)
        for flags in np.unique(variable.values)
    }
    return [words[flags] for flags in variable.values.flat]
