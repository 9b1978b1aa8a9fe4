"""Arrays with named dimensions, units and coordinates, like an xarray dataset without loading xarray.

Loading xarray takes longer than a whole map of the chapter; with dask installed, twice as long.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple, TypeAlias

from numpy.typing import NDArray

if TYPE_CHECKING:
    import xarray as xr


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


if TYPE_CHECKING:
    Labelled: TypeAlias = NamedArray | xr.DataArray | xr.Variable
    Map: TypeAlias = NamedArrays | xr.Dataset
