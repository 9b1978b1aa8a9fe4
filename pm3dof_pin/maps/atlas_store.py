"""The arrays of an atlas on disk: a Zarr store that is filled block by block, and the NetCDF file made from it.

Blocks are written by Zarr itself. xarray's writing of regions (`to_zarr(region=...)`) gives the same files for 20 ms of
CPU a block instead of 18 (16^3 poses, two 6 x 6 quantities), and knows no more of which blocks are finished.
"""

from __future__ import annotations

import math
import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.maps.limit_flags import BROKEN_LIMITS
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import zarr

Place = tuple[slice, ...]


@dataclass(frozen=True, eq=False)
class Variable:
    """One array of an atlas.

    Attributes:
        name: its name.
        own_dims: sizes of its own dimensions, after those of the grid.
        dtype: its type on disk.
        fill_value: what stands where nothing was written.
        attributes: what it says of itself.
    """

    name: str
    own_dims: Mapping[str, int]
    dtype: np.dtype[Any]
    fill_value: float
    attributes: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class AtlasStore:
    """The arrays of an atlas: first in a Zarr store `<name>.parts` beside the result, then the result.

    Attributes:
        path: the result, `.nc` or `.zarr`.
        coordinates: values and attributes of the grid's dimensions.
        block_shape: shape of the blocks, which are the chunks.
        variables: the arrays; the map of broken limits is the last one.
        attributes: what the atlas says of itself.
    """

    path: Path
    coordinates: Mapping[str, tuple[Array, Mapping[str, Any]]]
    block_shape: tuple[int, ...]
    variables: tuple[Variable, ...]
    attributes: Mapping[str, Any]

    @property
    def parts(self) -> Path:
        """The store that holds the finished blocks until all are there."""
        return self.path.with_name(self.path.name + ".parts")

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each dimension of the grid."""
        return tuple(len(values) for values, _ in self.coordinates.values())

    def open(self) -> None:
        """Make the store, or check that the one that is there is of the same atlas.

        Raises:
            OutputError: the result cannot take its place, there is no room for it, or another atlas is unfinished.
        """
        import zarr

        self._require_place()
        if (self.parts / "zarr.json").is_file():
            if dict(zarr.open_group(self.parts, mode="r").attrs) != self.attributes:
                raise OutputError(self.path, f"{self.parts} is an unfinished atlas of other settings; remove it first")
            for torn in self.parts.rglob("*.partial"):
                torn.unlink()
            return
        shutil.rmtree(self.parts, ignore_errors=True)
        self._require_room()
        self.parts.parent.mkdir(parents=True, exist_ok=True)
        fresh = self.parts.with_name(self.parts.name + ".new")
        shutil.rmtree(fresh, ignore_errors=True)
        self._make(fresh)
        fresh.rename(self.parts)

    def is_done(self, block: tuple[int, ...]) -> bool:
        """Tell whether a block, given by its first indices, is finished."""
        chunk = (str(first // size) for first, size in zip(block, self.block_shape, strict=True))
        return self.parts.joinpath(BROKEN_LIMITS, "c", *chunk).is_file()

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of an array."""
        return self._arrays[name].dtype

    def write(self, name: str, place: Place, values: Any) -> None:
        """Write the values of one array at one block."""
        array = self._arrays[name]
        with np.errstate(over="ignore"):  # beyond single precision a number is infinite
            array[place] = np.asarray(values).astype(array.dtype, copy=False)

    def read(self, name: str, place: Place) -> Any:
        """Read the values of one array at one block."""
        return self._arrays[name][place]

    @cached_property
    def _arrays(self) -> dict[str, zarr.Array[Any]]:
        import zarr

        group = zarr.open_group(self.parts, mode="r+")
        return {variable.name: _array(group, variable.name) for variable in self.variables}

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # arrays are opened in each process

    def remove(self) -> None:
        """Remove the unfinished store."""
        shutil.rmtree(self.parts)

    def finish(self, blocks: Iterable[Place]) -> Path:
        """Make the result of the finished blocks and return its path."""
        if self.path.suffix == ".nc":
            self._copy_to_netcdf(blocks)
            self.remove()
            return self.path
        if self.path.exists():
            shutil.rmtree(self.path)
        self.parts.rename(self.path)
        return self.path

    def _require_place(self) -> None:
        """Refuse a place that the result cannot take: only a file gives way to a file, and an atlas to an atlas."""
        path = self.path
        if path.suffix == ".nc" and path.is_dir():
            raise OutputError(path, "a folder is there, expected nothing or a file")
        if path.suffix == ".zarr" and path.exists() and not (path / BROKEN_LIMITS / "zarr.json").is_file():
            raise OutputError(path, "something else than an atlas is there, expected nothing or an older atlas")

    def _require_room(self) -> None:
        """Refuse what the disk cannot hold: the blocks and, beside them, the NetCDF file that is made from them."""
        numbers = sum(math.prod(entry.own_dims.values()) * entry.dtype.itemsize for entry in self.variables)
        copies = 2 if self.path.suffix == ".nc" else 1
        needed = copies * math.prod(self.shape) * numbers
        folder = next(parent for parent in self.parts.resolve().parents if parent.exists())
        free = shutil.disk_usage(folder).free
        if needed > free:
            reason = f"it takes up to {needed / 1e9:.4g} GB of disk to make, {free / 1e9:.4g} GB are free"
            raise OutputError(self.path, reason)

    def _make(self, path: Path) -> None:
        import zarr
        from zarr.codecs import BloscCodec

        group = zarr.create_group(path, attributes=dict(self.attributes))
        for name, (values, attributes) in self.coordinates.items():
            coordinate = group.create_array(
                name,
                shape=values.shape,
                dtype="float64",
                chunks=values.shape,
                compressors=None,
                dimension_names=[name],
                attributes=dict(attributes),
            )
            coordinate[:] = values
        for variable in self.variables:
            own_shape = tuple(variable.own_dims.values())
            group.create_array(
                variable.name,
                shape=self.shape + own_shape,
                dtype=variable.dtype,
                chunks=self.block_shape + own_shape,
                fill_value=variable.fill_value,
                # of those measured: 40 % of the time of zstd, 120 % of its bytes
                compressors=BloscCodec(cname="lz4", clevel=9, shuffle="shuffle"),
                dimension_names=[*self.coordinates, *variable.own_dims],
                attributes={key: _plain(value) for key, value in variable.attributes.items()},
                config={"write_empty_chunks": True},  # a block of zeros is a finished block too
            )

    def _copy_to_netcdf(self, blocks: Iterable[Place]) -> None:
        """Copy the store block by block, in order."""
        import netCDF4
        import zarr

        group = zarr.open_group(self.parts, mode="r")
        with write_atomically(self.path) as temporary, netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
            file.setncatts(dict(self.attributes))
            for name, (values, attributes) in self.coordinates.items():
                file.createDimension(name, len(values))
                coordinate = file.createVariable(name, "f8", (name,), contiguous=True, fill_value=False)
                coordinate.setncatts(dict(attributes))
                coordinate[:] = values
            for entry in self.variables:
                for dim, size in entry.own_dims.items():
                    if dim not in file.dimensions:
                        file.createDimension(dim, size)
                file.createVariable(
                    entry.name,
                    entry.dtype.str[1:],
                    (*self.coordinates, *entry.own_dims),
                    compression="zlib",
                    complevel=1,
                    shuffle=True,
                    chunksizes=self.block_shape + tuple(entry.own_dims.values()),
                    fill_value=False,
                ).setncatts(dict(entry.attributes))
            for place in blocks:
                for entry in self.variables:
                    file.variables[entry.name][place] = _array(group, entry.name)[place]


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    import zarr

    array = group[name]
    assert isinstance(array, zarr.Array)
    return array


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
