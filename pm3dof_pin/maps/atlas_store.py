"""The arrays of an atlas on disk: a Zarr store filled block by block, and the NetCDF file made from it.

Blocks are written by Zarr itself. xarray's writing of regions (`to_zarr(region=...)`) gives the same files for 20 ms of
CPU per block instead of 18 (16^3 poses, two 6 x 6 quantities), and does not track finished blocks either.

Nothing in the store is trusted: when a job resumes, its metadata are compared with the expected ones, and every
finished block with the checksums in the journal. Chunks also carry their own checksums (CRC-32C), even in a result that
is a Zarr store.
"""

from __future__ import annotations

import hashlib
import json
import logging
import math
import shutil
import zlib
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.maps.atlas_journal import Block, Checksums, Journal, sync
from pm3dof_pin.maps.labels import BROKEN_LIMITS
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import zarr

Place = tuple[slice, ...]

_JOURNAL = "finished.journal"
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Variable:
    """One array of an atlas; `own_dims` are the sizes of its dimensions after those of the grid."""

    name: str
    own_dims: Mapping[str, int]
    dtype: np.dtype[Any]
    fill_value: float
    attributes: Mapping[str, Any]


@dataclass(frozen=True, eq=False)
class AtlasStore:
    """The arrays of an atlas: first in a Zarr store `<name>.parts` next to the result, then in it, `.nc` or `.zarr`."""

    path: Path
    coordinates: Mapping[str, tuple[Array, Mapping[str, Any]]]  #: values and attributes of the grid's dimensions
    block_shape: tuple[int, ...]  #: shape of the blocks, which are the chunks
    variables: tuple[Variable, ...]  #: the arrays; the map of broken limits is the last one
    attributes: Mapping[str, Any]

    @property
    def parts(self) -> Path:
        """The store of finished blocks until the atlas is complete."""
        return self.path.with_name(self.path.name + ".parts")

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each dimension of the grid."""
        return tuple(len(values) for values, _ in self.coordinates.values())

    @cached_property
    def journal(self) -> Journal:
        """Journal of the finished blocks."""
        text = json.dumps(self.attributes, sort_keys=True, default=str)
        return Journal(self.parts / _JOURNAL, hashlib.sha256(text.encode()).hexdigest())

    def open(self) -> set[Block]:
        """Make the store, or repair and continue an existing one; return the finished blocks.

        Raises:
            OutputError: the place of the result is taken, there is not enough space, or another atlas is unfinished.
        """
        self._require_place()
        if not self.parts.is_dir():
            self.parts.unlink(missing_ok=True)
            self._require_room()
        elif not self._is_ours():
            raise OutputError(self.path, f"{self.parts} is an unfinished atlas with other settings; remove it first")
        skeleton = self.parts.with_name(self.parts.name + ".new")
        shutil.rmtree(skeleton, ignore_errors=True)
        self._make(skeleton)
        if not self.parts.is_dir():
            Journal(skeleton / _JOURNAL, self.journal.specification).write({})
            skeleton.rename(self.parts)
            sync(self.parts.parent)
            return set()
        self._repair(skeleton)
        return self._sound_blocks()

    def _is_ours(self) -> bool:
        """Tell whether the unfinished store belongs to this atlas, or is too damaged to tell."""
        belongs = self.journal.belongs()
        if belongs is not None:
            return belongs
        try:
            stored = json.loads((self.parts / "zarr.json").read_bytes())["attributes"]
        except (OSError, ValueError, KeyError, TypeError):
            return True
        return bool(stored == json.loads(json.dumps(self.attributes)))

    def _repair(self, skeleton: Path) -> None:
        """Restore everything except the blocks to the state of a new store, and remove what does not belong there."""
        expected = {file.relative_to(skeleton) for file in skeleton.rglob("*") if file.is_file()}
        arrays = tuple(f"{variable.name}/c/" for variable in self.variables)
        for file in [*self.parts.rglob("*")]:
            name = file.relative_to(self.parts)
            chunk = str(name).startswith(arrays) and all(part.isdigit() for part in name.parts[2:])
            if file.is_file() and name not in expected and not chunk and str(name) != _JOURNAL:
                file.unlink()
        repaired = []
        for name in sorted(expected):
            target = self.parts / name
            if not target.is_file() or target.read_bytes() != (skeleton / name).read_bytes():
                repaired.append(str(name))
                if target.is_dir():
                    shutil.rmtree(target)
                target.parent.mkdir(parents=True, exist_ok=True)
                (skeleton / name).replace(target)
        shutil.rmtree(skeleton)
        if repaired:
            _log.warning("%s: %s damaged or missing; rewritten", self.parts, ", ".join(repaired))

    def _sound_blocks(self) -> set[Block]:
        """Return the blocks in the journal whose files are unchanged, and remove the others from the journal."""
        listed = self.journal.read()
        if self.journal.damaged:
            _log.warning("%s is damaged or missing; blocks not listed in it are computed again", self.journal.path)
        with ThreadPoolExecutor() as pool:
            sound = list(pool.map(lambda entry: self._is_sound(*entry), listed.items()))
        kept = {block: sums for (block, sums), intact in zip(listed.items(), sound, strict=True) if intact}
        if len(kept) < len(listed):
            _log.warning("%s: %d finished blocks are damaged; computed again", self.parts, len(listed) - len(kept))
        self.journal.write(kept)
        return set(kept)

    def _is_sound(self, block: Block, checksums: Checksums) -> bool:
        try:
            return self._checksums(block) == checksums
        except OSError:
            for variable in self.variables:
                if self._chunk(variable, block).is_dir():
                    shutil.rmtree(self._chunk(variable, block))
            return False

    def _checksums(self, block: Block) -> Checksums:
        files = {variable.name: self._chunk(variable, block) for variable in self.variables}
        return {name: zlib.crc32(file.read_bytes()) if file.exists() else None for name, file in files.items()}

    def _chunk(self, variable: Variable, block: Block) -> Path:
        """Return the file of a block in an array."""
        numbers = [str(first // size) for first, size in zip(block, self.block_shape, strict=True)]
        return self.parts.joinpath(variable.name, "c", *numbers, *["0"] * len(variable.own_dims))

    def seal(self, block: Block) -> tuple[Block, Checksums]:
        """Sync the files of a written block to disk; return its entry for the journal."""
        for variable in self.variables:
            if self._chunk(variable, block).exists():  # not if everything is the fill value
                sync(self._chunk(variable, block))
        return block, self._checksums(block)

    def enter(self, sealed: Sequence[tuple[Block, Checksums]]) -> None:
        """Enter sealed blocks in the journal; from then on they count as finished."""
        if not sealed:
            return
        chunks = (self._chunk(variable, block) for block, _ in sealed for variable in self.variables)
        folders = {folder for chunk in chunks for folder in chunk.relative_to(self.parts).parents}
        for folder in folders:
            if (self.parts / folder).exists():
                sync(self.parts / folder)
        self.journal.append(sealed)

    def dtype(self, name: str) -> np.dtype[Any]:
        """Return the type of an array."""
        return self._arrays[name].dtype

    def write(self, name: str, place: Place, values: Any) -> None:
        """Write the values of one array at one block."""
        array = self._arrays[name]
        with np.errstate(over="ignore"):  # numbers beyond single precision become infinite
            array[place] = np.asarray(values).astype(array.dtype, copy=False)

    def read(self, name: str, place: Place) -> Any:
        """Read the values of one array at one block; OSError if they differ from what was written."""
        try:
            return self._arrays[name][place]
        except (ValueError, RuntimeError) as error:
            raise OSError(f"a block of {name} was damaged after it was written ({error})") from error

    @cached_property
    def _arrays(self) -> dict[str, zarr.Array[Any]]:
        import zarr

        group = zarr.open_group(self.parts, mode="r+")
        return {variable.name: cast("zarr.Array[Any]", group[variable.name]) for variable in self.variables}

    def __getstate__(self) -> dict[str, Any]:
        return {field.name: getattr(self, field.name) for field in fields(self)}  # arrays are opened in each process

    def remove(self) -> None:
        """Remove the unfinished store."""
        shutil.rmtree(self.parts)

    def finish(self, blocks: Iterable[Place]) -> Path:
        """Make the result from the finished blocks and return its path; OSError for a full disk or a damaged block."""
        if self.path.suffix == ".nc":
            try:
                self._copy_to_netcdf(blocks)
            except OutputError as error:
                raise OSError(error.reason) from error
            self.remove()
            return self.path
        if self.path.exists():
            shutil.rmtree(self.path)
        (self.parts / _JOURNAL).unlink()
        self.parts.rename(self.path)
        sync(self.path.parent)
        return self.path

    def _require_place(self) -> None:
        """Reject a place that the result cannot take: a file may only replace a file, and an atlas an atlas."""
        path = self.path
        if path.suffix == ".nc" and path.is_dir():
            raise OutputError(path, "the path is a folder: expected nothing or a file")
        if path.suffix == ".zarr" and path.exists() and not (path / BROKEN_LIMITS / "zarr.json").is_file():
            raise OutputError(path, "the path is not an atlas: expected nothing or an older atlas")

    def _require_room(self) -> None:
        """Reject an atlas that the disk cannot hold: the blocks and the NetCDF file made from them."""
        numbers = sum(math.prod(entry.own_dims.values()) * entry.dtype.itemsize for entry in self.variables)
        copies = 2 if self.path.suffix == ".nc" else 1
        needed = copies * math.prod(self.shape) * numbers
        folder = next(parent for parent in self.parts.resolve().parents if parent.exists())
        free = shutil.disk_usage(folder).free
        if needed > free:
            reason = f"it needs up to {needed / 1e9:.4g} GB of disk space, {free / 1e9:.4g} GB are free"
            raise OutputError(self.path, reason)

    def _make(self, path: Path) -> None:
        import zarr
        from zarr.codecs import BloscCodec, Crc32cCodec

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
                # best of those measured: 40 % of the time of zstd, 120 % of its bytes
                compressors=[BloscCodec(cname="lz4", clevel=9, shuffle="shuffle"), Crc32cCodec()],
                dimension_names=[*self.coordinates, *variable.own_dims],
                attributes={key: _plain(value) for key, value in variable.attributes.items()},
            )

    def _copy_to_netcdf(self, blocks: Iterable[Place]) -> None:
        """Copy the store block by block, in order."""
        import netCDF4

        with write_atomically(self.path) as temporary:
            try:
                with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
                    self._fill(file, blocks)
            except RuntimeError as error:  # raised by the NetCDF library for a full disk
                raise OSError(f"{error} while writing the NetCDF file: is the disk full?") from error
            sync(temporary)

    def _fill(self, file: Any, blocks: Iterable[Place]) -> None:
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
                file.variables[entry.name][place] = self.read(entry.name, place)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
