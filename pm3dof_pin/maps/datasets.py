"""Labelled maps: arrays with named dimensions and metadata (CF conventions), written as NetCDF and CSV.

They have the fields of an xarray dataset without loading xarray, which takes longer than a whole map of the chapter.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Hashable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

import pm3dof_pin
from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import csv_text, write_atomically, write_text_atomically
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr


BROKEN_LIMITS = "broken_limits"


class NamedArray(NamedTuple):
    """One variable or coordinate."""

    dims: tuple[str, ...]  #: names of the dimensions of `values`
    values: NDArray[Any]
    attrs: dict[str, Any]  #: units, long name and other attributes of the CF conventions


@dataclass(frozen=True, eq=False)
class NamedArrays:
    """A map, with the fields of an `xarray.Dataset`."""

    data_vars: Mapping[Any, NamedArray]
    coords: Mapping[Any, NamedArray]
    attrs: dict[str, Any]

    @property
    def variables(self) -> Mapping[Any, NamedArray]:
        """Coordinates and variables by name."""
        return {**self.coords, **self.data_vars}

    def dataset(self) -> xr.Dataset:
        """Return the map as a dataset."""
        import xarray as xr

        return xr.Dataset(self.data_vars, self.coords, self.attrs)


_Labelled: TypeAlias = "NamedArray | xr.DataArray | xr.Variable"
Map: TypeAlias = "NamedArrays | xr.Dataset"  #: values by name over coordinates, as written to files


def dataset_attributes(title: str, machine: str) -> dict[str, str]:
    """Return the attributes of a dataset of a machine."""
    source = f"pm3dof-pin {pm3dof_pin.__version__}"
    return {"Conventions": "CF-1.8", "title": title, "machine": machine, "source": source}


def coordinate_attributes(name: str, unit: str, machine: str) -> dict[str, str]:
    """Return the attributes of a coordinate of a machine."""
    return {"units": unit, "long_name": f"coordinate {name} of {machine}"}


def flag_variable(dims: tuple[str, ...], flags: NDArray[Any], names: tuple[str, ...], long_name: str) -> NamedArray:
    """Return sums of flags, named from the lowest bit, as a variable of the smallest type with a bit for each name."""
    kind = np.min_scalar_type((1 << len(names)) - 1)
    attributes = {
        "long_name": long_name,
        "flag_masks": np.array([1 << bit for bit in range(len(names))], dtype=kind),
        "flag_meanings": " ".join(names),
        "comment": "sum of the flags; zero within all limits",
    }
    return NamedArray(dims, np.asarray(flags).astype(kind), attributes)


def unit_of_entry(units: str, entry: str) -> str:
    """Return an entry's unit from "N/m (x, y, z), N m/rad (rx, ry, rz)"; a common unit stays as it is."""
    for part in units.split("), "):
        unit, _, entries = part.rstrip(")").partition(" (")
        if entry in entries.split(", "):
            return unit
    return units


def write_map(dataset: Map, path: Path) -> list[Path]:
    """Write a map as NetCDF-4 and CSV, adding the suffixes to the path; see the two functions below."""
    return [write_netcdf(dataset, path.with_suffix(".nc")), write_csv(dataset, path.with_suffix(".csv"))]


def write_netcdf(dataset: Map, path: Path | str) -> Path:
    """Write a map as compressed NetCDF-4, angles in radians, and return the path; equal maps give equal bytes.

    Raises:
        OutputError: the file cannot be written; no partial file is left.
    """
    import netCDF4

    sizes = {dim: n for v in dataset.variables.values() for dim, n in zip(v.dims, v.values.shape, strict=True)}
    with write_atomically(path) as temporary:
        try:
            with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
                file.setncatts(dataset.attrs)
                for dim, size in sizes.items():
                    file.createDimension(str(dim), size)
                for name in (*dataset.coords, *dataset.data_vars):
                    _write_variable(file, dataset, str(name))
        except RuntimeError as error:  # raised by the NetCDF library for a full disk
            raise OutputError(path, str(error)) from error
    return Path(path)


def _write_variable(file: Any, dataset: Map, name: str) -> None:
    variable = dataset.variables[name]
    values = variable.values
    kind: Any = values.dtype
    if kind.kind in "UO":
        kind, values = str, values.astype(object)
    options: dict[str, Any] = {"zlib": True, "complevel": 4} if name in dataset.data_vars else {}
    if values.dtype.kind == "f":
        options["fill_value"] = np.nan
    stored = file.createVariable(name, kind, variable.dims, **options)
    attributes = dict(variable.attrs)
    # coordinates that are not dimensions must be named, or they are read back as variables
    beside = [str(n) for n, c in dataset.coords.items() if c.dims != (n,) and set(c.dims) <= set(variable.dims)]
    if name in dataset.data_vars and beside:
        attributes["coordinates"] = " ".join(beside)
    stored.setncatts(attributes)
    stored[...] = values


def write_csv(dataset: Map, path: Path | str) -> Path:
    """Write a map as CSV: one row per pose, angles in degrees, units in the column headers; return the path.

    Limits are written as words; values excluded by one are empty cells. A variable with its own dimensions has a column
    for each entry. Coordinates without a unit, which are labels, have none.

    Raises:
        OutputError: the file cannot be written; no partial file is left.
    """
    columns = dict(_columns(dataset))
    return write_text_atomically(path, csv_text([columns, *zip(*columns.values(), strict=True)]))


def _columns(dataset: Map) -> Iterator[tuple[str, list[str]]]:
    """Header and cells of each column."""
    coordinates = [str(name) for name, coordinate in dataset.coords.items() if "units" in coordinate.attrs]
    variables: list[_Labelled] = list(dataset.data_vars.values())
    template = min(variables, key=lambda variable: len(variable.dims))
    for name in (*coordinates, *map(str, dataset.data_vars)):
        variable = dataset.variables[name]
        own = tuple(dim for dim in variable.dims if dim not in template.dims)
        values = _over(template, own, variable)
        if "flag_masks" in variable.attrs:
            if name == BROKEN_LIMITS:
                yield "within_limits", ["FALSE" if flags else "TRUE" for flags in values.flat]
            yield name, _words(values, variable.attrs)
            continue
        units = variable.attrs["units"]
        for entry in itertools.product(*(enumerate(dataset.variables[dim].values) for dim in own)):
            labels = [str(label) for _, label in entry]
            unit = unit_of_entry(units, labels[0]) if len(own) == 1 else units
            index: Any = (..., *(k for k, _ in entry))
            yield _column_of_numbers("_".join([name, *labels]), unit, values[index])


def _over(template: _Labelled, own: tuple[Hashable, ...], variable: _Labelled) -> Array:
    """Return the values of a variable over the dimensions of another, and then over its own."""
    dims = [*template.dims, *own]
    present = [dim for dim in dims if dim in variable.dims]
    values = np.transpose(variable.values, [variable.dims.index(dim) for dim in present])
    values = np.expand_dims(values, [k for k, dim in enumerate(dims) if dim not in present])
    return np.broadcast_to(values, template.values.shape + values.shape[len(template.dims) :])


def _column_of_numbers(name: str, unit: str, values: Array) -> tuple[str, list[str]]:
    if unit == "rad":
        unit, values = "deg", np.degrees(values)
    heading = name if unit == "1" else f"{name}_{unit.replace('/', '_per_').replace(' ', '_').replace(',', '')}"
    return heading, [f"{value:.12g}" if math.isfinite(value) else "" for value in values.ravel().tolist()]


def _words(values: Array, attributes: Mapping[str, Any]) -> list[str]:
    """Names of the flags in each value, separated by blanks."""
    masks, meanings = attributes["flag_masks"], attributes["flag_meanings"].split()
    words = {
        flags: " ".join(word for mask, word in zip(masks, meanings, strict=True) if flags & mask)
        for flags in np.unique(values)
    }
    return [words[flags] for flags in values.flat]
