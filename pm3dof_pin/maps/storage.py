"""Writing maps: NetCDF for programs, CSV for a spreadsheet."""

from __future__ import annotations

import csv
import io
import itertools
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import write_atomically, write_text_atomically
from pm3dof_pin.maps.limit_flags import BROKEN_LIMITS
from pm3dof_pin.maps.units import unit_of_entry
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


def write_netcdf(dataset: xr.Dataset, path: Path | str) -> Path:
    """Write a map as NetCDF-4, compressed, angles in radians, and return the path; equal maps give equal bytes.

    Raises:
        OutputError: the file cannot be written; nothing is left of it.
    """
    import netCDF4

    # not by xarray, which asks first whether there is a dask scheduler and imports all of dask where it is installed
    with write_atomically(path) as temporary:
        try:
            with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
                file.setncatts(dataset.attrs)
                for dim, size in dataset.sizes.items():
                    file.createDimension(str(dim), size)
                for name in (*dataset.coords, *dataset.data_vars):
                    _write_variable(file, dataset, str(name))
        except RuntimeError as error:  # what the NetCDF library makes of a full disk
            raise OutputError(path, str(error)) from error
    return Path(path)


def _write_variable(file: Any, dataset: xr.Dataset, name: str) -> None:
    variable = dataset[name].variable
    values = variable.values
    kind: Any = values.dtype
    if kind.kind in "UO":
        kind, values = str, values.astype(object)
    options: dict[str, Any] = {"zlib": True, "complevel": 4} if name in dataset.data_vars else {}
    if values.dtype.kind == "f":
        options["fill_value"] = np.nan
    stored = file.createVariable(name, kind, variable.dims, **options)
    attributes = dict(variable.attrs)
    # coordinates that are no dimensions have to be named, or they come back as variables
    others = [str(c) for c in dataset.coords if c not in dataset.dims and set(dataset[c].dims) <= set(variable.dims)]
    if name in dataset.data_vars and others:
        attributes["coordinates"] = " ".join(others)
    stored.setncatts(attributes)
    stored[...] = values


def write_csv(dataset: xr.Dataset, path: Path | str, *, coordinates: Sequence[str] | None = None) -> Path:
    """Write a map as CSV: one row a pose, angles in degrees, the unit at the end of each heading; return the path.

    Limits are written as words; what is excluded by one is an empty cell. A variable with dimensions of its own has a
    column for each entry. The coordinates are by default all that have a unit.

    Raises:
        OutputError: the file cannot be written; nothing is left of it.
    """
    names = [str(name) for name in dataset.coords if "units" in dataset[name].attrs]
    columns = dict(_columns(dataset, names if coordinates is None else coordinates))
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(zip(*columns.values(), strict=True))
    return write_text_atomically(path, text.getvalue())


def _columns(dataset: xr.Dataset, coordinates: Sequence[str]) -> Iterator[tuple[str, list[str]]]:
    """Heading and cells of each column."""
    template = min(dataset.data_vars.values(), key=lambda variable: variable.ndim)
    for name in (*coordinates, *map(str, dataset.data_vars)):
        variable = dataset[name].broadcast_like(template).transpose(*template.dims, ...)
        if "flag_masks" in variable.attrs:
            if name == BROKEN_LIMITS:
                yield "within_limits", ["FALSE" if flags else "TRUE" for flags in variable.values.flat]
            yield name, _words(variable)
            continue
        own = variable.dims[template.ndim :]
        units = variable.attrs["units"]
        for entry in itertools.product(*(variable[dim].values for dim in own)):
            unit = unit_of_entry(units, str(entry[0])) if len(own) == 1 else units
            values = variable.sel(dict(zip(own, entry, strict=True))).values
            yield _column_of_numbers("_".join([name, *map(str, entry)]), unit, values)


def _column_of_numbers(name: str, unit: str, values: Array) -> tuple[str, list[str]]:
    if unit == "rad":
        unit, values = "deg", np.degrees(values)
    heading = name if unit == "1" else f"{name}_{unit.replace('/', '_per_').replace(' ', '_').replace(',', '')}"
    return heading, ["" if not np.isfinite(value) else f"{value:.12g}" for value in values.flat]


def _words(variable: xr.DataArray) -> list[str]:
    """Names of the flags in each value, with blanks between them."""
    masks, meanings = variable.attrs["flag_masks"], variable.attrs["flag_meanings"].split()
    words = {
        flags: " ".join(word for mask, word in zip(masks, meanings, strict=True) if flags & mask)
        for flags in np.unique(variable.values)
    }
    return [words[flags] for flags in variable.values.flat]
