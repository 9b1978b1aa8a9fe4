"""The arrays of an atlas on disk: a Zarr store filled block by block, and the NetCDF file made from it.

Nothing in the store is trusted. Next to the arrays, every finished block has a record of the checksums of its files;
when a job resumes, metadata and coordinates are compared with the expected ones, and blocks with their records. A
finished atlas carries one SHA-256 of everything: of its blocks, axes and attributes.
"""

from __future__ import annotations

import fcntl
import hashlib
import itertools
import json
import logging
import math
import os
import re
import shutil
import socket
import time
import zlib
from collections import deque
from collections.abc import Iterable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np

from pm3dof_pin.exceptions import DescriptionError, OutputError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.maps.datasets import BROKEN_LIMITS
from pm3dof_pin.programs.processors import processors
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import zarr

Block: TypeAlias = tuple[int, ...]
"""First index of a block along each dimension."""

Place: TypeAlias = tuple[slice, ...]

_RECORDS = "finished"
_NO_CHECKSUM = "0" * 64  # in its place while the checksum is computed
_ATTRIBUTE = re.compile(rb'"checksum": "([0-9a-f]{64})"')
_TRAILER = b"\nsha256 "  # of a NetCDF file; its library ignores what follows the end of the data
_DEFLATION = 1  # level of the fast deflater: 2 and 3 take longer for as many bytes
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
    def _specification(self) -> str:
        text = json.dumps(self.attributes, sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    def open(self) -> set[Block]:
        """Make the store, or repair and continue an existing one; return the finished blocks.

        Raises:
            OutputError: the place of the result is taken, there is not enough space, or another atlas is unfinished.
        """
        self._require_place()
        records = self._records()
        if self.parts.is_dir() and not self._is_ours(records):
            raise OutputError(self.path, f"{self.parts} is an unfinished atlas with other settings; remove it first")
        if not records:
            self.remove()
            self._require_room()
        fresh = self.parts.with_name(self.parts.name + ".new")
        shutil.rmtree(fresh, ignore_errors=True)
        self._make(fresh)
        if not self.parts.is_dir():
            fresh.rename(self.parts)
            return set()
        self._repair(fresh)
        with ThreadPoolExecutor() as pool:
            sound = [block for block, intact in zip(records, pool.map(self._is_sound, records), strict=True) if intact]
        if len(sound) < len(records):
            _log.warning("%s: %d finished blocks are damaged; computed again", self.parts, len(records) - len(sound))
        return set(sound)

    def _records(self) -> list[Block]:
        """Return the blocks that have a record."""
        names = [file.name for file in (self.parts / _RECORDS).glob("*")]
        return [tuple(map(int, name.split("."))) for name in sorted(names) if re.fullmatch(r"\d+(\.\d+)*", name)]

    def _record(self, block: Block) -> Path:
        return self.parts / _RECORDS / ".".join(map(str, block))

    def _is_ours(self, records: list[Block]) -> bool:
        """Tell whether the unfinished store belongs to this atlas; one without finished blocks may be replaced."""
        stored = [self._record(block).read_bytes()[:64] for block in records]
        return not stored or self._specification.encode() in stored

    def _repair(self, fresh: Path) -> None:
        """Restore everything except the blocks to the state of a new store, and remove what does not belong there."""
        expected = {file.relative_to(fresh) for file in fresh.rglob("*") if file.is_file()}
        arrays = tuple(f"{variable.name}/c/" for variable in self.variables)
        for file in [*self.parts.rglob("*")]:
            name = file.relative_to(self.parts)
            chunk = str(name).startswith(arrays) and all(part.isdigit() for part in name.parts[2:])
            if file.is_file() and name not in expected and not chunk and name.parts[0] != _RECORDS:
                file.unlink()
        repaired = []
        for name in sorted(expected):
            target = self.parts / name
            if not target.is_file() or target.read_bytes() != (fresh / name).read_bytes():
                repaired.append(str(name))
                if target.is_dir():
                    shutil.rmtree(target)
                target.parent.mkdir(parents=True, exist_ok=True)
                (fresh / name).replace(target)
        shutil.rmtree(fresh)
        if repaired:
            _log.warning("%s: %s damaged or missing; rewritten", self.parts, ", ".join(repaired))

    def _is_sound(self, block: Block) -> bool:
        """Tell whether the files of a block are those of its record."""
        try:
            return self._record(block).read_text() == self._checksums(block)
        except (OSError, UnicodeDecodeError):
            for variable in self.variables:
                if self._chunk(variable, block).is_dir():
                    shutil.rmtree(self._chunk(variable, block))
            return False

    def _checksums(self, block: Block) -> str:
        """Return the record of a block: the specification, and CRC-32 of its file in each array; None without one."""
        files = {variable.name: self._chunk(variable, block) for variable in self.variables}
        sums = {name: zlib.crc32(file.read_bytes()) if file.exists() else None for name, file in files.items()}
        return f"{self._specification} {json.dumps(sums)}"

    def _chunk(self, variable: Variable, block: Block) -> Path:
        """Return the file of a block in an array."""
        numbers = [str(first // size) for first, size in zip(block, self.block_shape, strict=True)]
        return self.parts.joinpath(variable.name, "c", *numbers, *["0"] * len(variable.own_dims))

    def seal(self, block: Block) -> None:
        """Write the record of a block whose arrays have been written; from then on it counts as finished."""
        self._record(block).parent.mkdir(exist_ok=True)
        self._record(block).write_text(self._checksums(block))

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

    def remove(self, *, unless_resumable: bool = False) -> None:
        """Remove the unfinished store, on request only if no block is finished."""
        if self.parts.is_dir() and not (unless_resumable and self._records()):
            shutil.rmtree(self.parts)

    def finish(self, blocks: Iterable[Place], threads: int | None = None) -> Path:
        """Make the result from the finished blocks and return its path; OSError for a full disk or a damaged block.

        A NetCDF file is made on as many threads, by default on all processors.
        """
        if self.path.suffix == ".nc":
            try:
                self._copy_to_netcdf(blocks, threads)
            except OutputError as error:
                raise OSError(error.reason) from error
            self.remove()
            return self.path
        shutil.rmtree(self.parts / _RECORDS)
        metadata = self.parts / "zarr.json"
        text = metadata.read_text()
        metadata.write_text(text.replace(_NO_CHECKSUM, _checksum_of_zarr(self.parts, text.encode())))
        if self.path.exists():
            shutil.rmtree(self.path)
        self.parts.rename(self.path)
        return self.path

    def _require_place(self) -> None:
        """Reject a place that the result cannot take: a file may only replace a file, and an atlas an atlas."""
        path = self.path
        if path.suffix == ".nc" and path.is_dir():
            raise OutputError(path, "the path is a folder: expected nothing or a file")
        if path.suffix == ".zarr" and path.exists() and not (path / BROKEN_LIMITS / "zarr.json").is_file():
            raise OutputError(path, "the path is not an atlas: expected nothing or an older atlas")
        if self.parts.is_file():
            self.parts.unlink()

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

        group = zarr.create_group(path, attributes={**self.attributes, "checksum": _NO_CHECKSUM})
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

    def _copy_to_netcdf(self, blocks: Iterable[Place], threads: int | None) -> None:
        """Copy the store block by block, in order: each is a chunk, deflated on one of the threads."""
        import h5py
        import netCDF4

        with write_atomically(self.path) as temporary:
            try:
                with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
                    self._declare(file)
                with h5py.File(temporary, "r+") as file:
                    for name, first, chunk in self._deflated(blocks, threads or processors()):
                        file[name].id.write_direct_chunk(first, chunk)
            except RuntimeError as error:  # raised by the libraries for a full disk
                raise OSError(f"{error} while writing the NetCDF file: is the disk full?") from error
            with temporary.open("r+b") as data:
                checksum = hashlib.file_digest(data, "sha256").hexdigest()
                data.write(_TRAILER + checksum.encode())

    def _deflated(self, blocks: Iterable[Place], threads: int) -> Iterator[tuple[str, Block, bytes]]:
        """Yield the chunks of the NetCDF file in order, a few ahead at a time: array, first index and contents."""

        def deflated(entry: Variable, place: Place) -> tuple[str, Block, bytes]:
            from isal import isal_zlib

            own_shape = tuple(entry.own_dims.values())
            values = np.zeros(self.block_shape + own_shape, dtype=entry.dtype)  # whole, also at the end of the grid
            values[tuple(slice(part.stop - part.start) for part in place)] = self.read(entry.name, place)
            first = (*(part.start for part in place), *(0 for _ in own_shape))
            shuffled = values.view(np.uint8).reshape(-1, entry.dtype.itemsize).T  # by significance, as HDF5 does
            return entry.name, first, isal_zlib.compress(np.ascontiguousarray(shuffled), _DEFLATION)

        ahead: deque[Future[tuple[str, Block, bytes]]] = deque()
        with ThreadPoolExecutor(threads) as pool:
            for place, entry in itertools.product(blocks, self.variables):
                ahead.append(pool.submit(deflated, entry, place))
                if len(ahead) > 2 * threads:
                    yield ahead.popleft().result()
            while ahead:
                yield ahead.popleft().result()

    def _declare(self, file: Any) -> None:
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


def require_intact(path: Path) -> None:
    """Compare a finished atlas, `.nc` or `.zarr`, with the checksum that it carries; DescriptionError if it differs."""
    try:
        if path.suffix == ".zarr":
            metadata = (path / "zarr.json").read_bytes()
            found = _ATTRIBUTE.search(metadata)
            written = found[1] if found else b""
            computed = _checksum_of_zarr(path, metadata.replace(written, _NO_CHECKSUM.encode())) if found else ""
        else:
            with path.open("rb") as file:
                digest, rest = hashlib.sha256(), b""
                keep = len(_TRAILER) + 64
                while block := file.read(2**20):
                    rest += block
                    digest.update(rest[:-keep])
                    rest = rest[-keep:]
            written = rest.removeprefix(_TRAILER) if rest.startswith(_TRAILER) else b""
            computed = digest.hexdigest()
    except OSError as error:
        raise DescriptionError(path, "file", f"expected an atlas ({error.strerror or error})") from error
    if not written:
        expected = "expected an atlas with its checksum; it is damaged, from an earlier version, or was changed"
        raise DescriptionError(path, "file", f"{expected} (open_atlas(..., verify=False) reads it all the same)")
    if written.decode(errors="replace") != computed:
        raise DescriptionError(path, "file", "the atlas is damaged: its contents differ from its checksum")


def _checksum_of_zarr(folder: Path, metadata: bytes) -> str:
    """Return the SHA-256 of the names and contents of all files of a store, with the given metadata of the group."""
    files = [file for file in folder.rglob("*") if file.is_file() and file.parent != folder]
    names = {"/".join(file.relative_to(folder).parts): file for file in files}
    kept = sorted(name for name in names if name.endswith("/zarr.json") or "/c/" in name)
    with ThreadPoolExecutor() as pool:
        digests = pool.map(lambda name: hashlib.sha256(names[name].read_bytes()).hexdigest(), kept)
        listed = "\n".join(f"{name} {digest}" for name, digest in zip(kept, digests, strict=True))
    return hashlib.sha256(metadata + listed.encode()).hexdigest()


@contextmanager
def exclusive_run(path: Path) -> Iterator[None]:
    """Hold the lock of an atlas; it ends with the process, in whatever way.

    The lock is the operating system's, on the file `.<name>.lock` next to the atlas, which says who holds it. A file
    without a holder was left by a killed run, and is taken over.

    Raises:
        OutputError: another run holds the lock, or the folder cannot be written.
    """
    place = path.with_name(f".{path.name}.lock")
    made = [folder for folder in place.absolute().parents if not folder.exists()]
    try:
        place.parent.mkdir(parents=True, exist_ok=True)
        descriptor = _acquire(place)
    except BlockingIOError as error:
        raise OutputError(path, f"another run, {_holder(place)}, is computing it; wait until it has ended") from error
    except OSError as error:
        raise OutputError(path, error.strerror or str(error)) from error
    try:
        yield
    finally:
        place.unlink(missing_ok=True)
        os.close(descriptor)
        with suppress(OSError):  # leave no empty folder
            for folder in made:
                folder.rmdir()


def _acquire(place: Path) -> int:
    """Lock the file, write its holder into it and return its descriptor; BlockingIOError if another process has it."""
    while True:
        descriptor = os.open(place, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            if place.exists() and os.fstat(descriptor).st_ino == place.stat().st_ino:
                break
        except OSError:
            os.close(descriptor)
            raise
        os.close(descriptor)  # the previous holder has just removed the file
    if os.fstat(descriptor).st_size:
        _log.warning("%s was left by a run that was killed, %s", place.name, _holder(place))
    os.ftruncate(descriptor, 0)
    holder = {"pid": os.getpid(), "host": socket.gethostname(), "since": time.strftime("%Y-%m-%d %H:%M:%S")}
    os.write(descriptor, json.dumps(holder).encode())
    return descriptor


def _holder(place: Path) -> str:
    try:
        holder = json.loads(place.read_bytes())
        return f"pid {holder['pid']} on {holder['host']}, since {holder['since']}"
    except (OSError, ValueError, KeyError, TypeError):
        return "of an unknown process"


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray) else value
