"""The chunks of an atlas on disk: files filled block by block, and the Zarr store or NetCDF file made of them.

A block is one chunk of each array, encoded when it is computed as the result holds it. Nothing that is found on disk is
trusted: every finished block has a record of the checksums of its chunks, with which these are compared when a job
resumes and before they become the result. A finished atlas carries one SHA-256 of everything: of its blocks, axes and
attributes.
"""

from __future__ import annotations

import fcntl
import hashlib
import json
import logging
import math
import os
import re
import shutil
import socket
import time
import zlib
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.exceptions import DescriptionError, OutputError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.maps.datasets import BROKEN_LIMITS
from pm3dof_pin.programs.processors import processors
from pm3dof_pin.typing import Array

Block: TypeAlias = tuple[int, ...]
"""First index of a block along each dimension."""

_RECORDS = "finished"
_NO_CHECKSUM = "0" * 64  # in its place while the checksum is computed
_ATTRIBUTE = re.compile(rb'"checksum": "([0-9a-f]{64})"')
_TRAILER = b"\nsha256 "  # of a NetCDF file; its library ignores what follows the end of the data
_DEFLATION = 1  # level of the fast deflater: 2 and 3 take longer for as many bytes
_BLOSC: Any = {"cname": "lz4", "clevel": 9}  # best of those measured: 40 % of the time of zstd, 120 % of its bytes
_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Variable:
    """One array of an atlas; `own_dims` are the sizes of its dimensions after those of the grid."""

    name: str
    own_dims: Mapping[str, int]
    dtype: np.dtype[Any]
    fill_value: float
    attributes: Mapping[str, Any]


class Record(NamedTuple):
    """What is written down of a finished block."""

    checksums: Mapping[str, int]  #: CRC-32 of its chunk in each array
    within_limits: bool  #: whether it has a pose within every limit


@dataclass(frozen=True, eq=False)
class AtlasStore:
    """The chunks of an atlas: first in a folder `<name>.parts` next to the result, then in it, `.nc` or `.zarr`."""

    path: Path
    coordinates: Mapping[str, tuple[Array, Mapping[str, Any]]]  #: values and attributes of the grid's dimensions
    block_shape: tuple[int, ...]  #: shape of the blocks, which are the chunks
    variables: tuple[Variable, ...]  #: the arrays; the map of broken limits is the last one
    attributes: Mapping[str, Any]

    @property
    def parts(self) -> Path:
        """The folder of finished blocks until the atlas is complete."""
        return self.path.with_name(self.path.name + ".parts")

    @property
    def shape(self) -> tuple[int, ...]:
        """Number of values along each dimension of the grid."""
        return tuple(len(values) for values, _ in self.coordinates.values())

    @cached_property
    def _specification(self) -> str:
        """Hash of all that decides the bytes of the chunks."""
        text = json.dumps([self.attributes, self.path.suffix, self.block_shape], sort_keys=True, default=str)
        return hashlib.sha256(text.encode()).hexdigest()

    def open(self) -> set[Block]:
        """Make the folder, or continue with an existing one; return the finished blocks. All other files are removed.

        Raises:
            OutputError: the place of the result is taken, there is not enough space, or another atlas is unfinished.
        """
        self._require_place()
        recorded = self._recorded_blocks()
        owners = {self._owner(block) for block in recorded} - {None}
        if owners and self._specification not in owners:
            raise OutputError(self.path, f"{self.parts} is an unfinished atlas with other settings; remove it first")
        if not owners:  # no record, or one that a killed run had not written whole
            recorded = []
            self.remove()
            self._require_room()
        self.parts.mkdir(exist_ok=True)
        with ThreadPoolExecutor() as pool:
            sound = [
                block for block, intact in zip(recorded, pool.map(self._is_sound, recorded), strict=True) if intact
            ]
        if len(sound) < len(recorded):
            _log.warning("%s: %d finished blocks are damaged; computed again", self.parts, len(recorded) - len(sound))
        kept = {file for block in sound for file in (self._record_file(block), *self._chunk_files(block).values())}
        for file in sorted(self.parts.rglob("*"), reverse=True):  # what is in a folder before the folder
            if not file.is_dir():
                if file not in kept:
                    file.unlink()
            elif not any(file.iterdir()):
                file.rmdir()
        return set(sound)

    def _recorded_blocks(self) -> list[Block]:
        """Return the blocks that have a record."""
        names = [file.name for file in (self.parts / _RECORDS).glob("*")]
        return [tuple(map(int, name.split("."))) for name in sorted(names) if re.fullmatch(r"\d+(\.\d+)*", name)]

    def _record_file(self, block: Block) -> Path:
        return self.parts / _RECORDS / ".".join(map(str, block))

    def _owner(self, block: Block) -> str | None:
        """Return the specification of the atlas that a block is of, if its record is whole."""
        text, _, checksum = self._record_file(block).read_bytes().rpartition(b" ")
        return text[:64].decode(errors="replace") if checksum == b"%d" % zlib.crc32(text) else None

    def _is_sound(self, block: Block) -> bool:
        """Tell whether the chunks of a block are those of its record."""
        try:
            checksums = self._record(block).checksums
            return all(zlib.crc32(file.read_bytes()) == checksums[n] for n, file in self._chunk_files(block).items())
        except OSError:
            return False

    def _record(self, block: Block) -> Record:
        """Return the record of a block; OSError without a sound one of this atlas."""
        text, _, checksum = self._record_file(block).read_bytes().rpartition(b" ")
        if checksum != b"%d" % zlib.crc32(text) or text[:64] != self._specification.encode():
            raise OSError(f"the record of the block at {block} is damaged")
        return Record(*json.loads(text[64:]))

    def _chunk_files(self, block: Block) -> dict[str, Path]:
        """Return the file of a block in each array, by name: those of a Zarr store without folders of their own."""
        place = [first // size for first, size in zip(block, self.block_shape, strict=True)]
        keys = {v.name: ".".join(map(str, ("c", *place, *[0] * len(v.own_dims)))) for v in self.variables}
        return {name: self.parts / name / key for name, key in keys.items()}

    def write(self, variable: Variable, block: Block, values: NDArray[Any]) -> int:
        """Write the chunk of one array at one block, and return its CRC-32."""
        chunk = np.asarray(values, dtype=variable.dtype, order="C")
        shape = (*self.block_shape, *variable.own_dims.values())
        if chunk.shape != shape:  # at the end of the grid
            chunk = np.full(shape, variable.fill_value, dtype=variable.dtype)
            chunk[tuple(map(slice, values.shape))] = values
        data = _ENCODERS[self.path.suffix](chunk)
        file = self._chunk_files(block)[variable.name]
        file.parent.mkdir(exist_ok=True)
        file.write_bytes(data)
        return zlib.crc32(data)

    def seal(self, block: Block, record: Record) -> None:
        """Write the record of a block whose chunks have been written; from then on it counts as finished."""
        text = f"{self._specification} {json.dumps(record)}"
        self._record_file(block).parent.mkdir(exist_ok=True)
        self._record_file(block).write_text(f"{text} {zlib.crc32(text.encode())}")

    def has_pose_within_limits(self, block: Block) -> bool:
        """Tell whether a finished block has a pose within every limit; OSError if its record is damaged."""
        return self._record(block).within_limits

    def remove(self, *, unless_resumable: bool = False) -> None:
        """Remove the unfinished atlas, on request only if no block is finished."""
        if self.parts.is_dir() and not (unless_resumable and self._recorded_blocks()):
            shutil.rmtree(self.parts)

    def finish(self, blocks: Iterable[Block], threads: int | None = None) -> Path:
        """Make the result of the finished blocks and return its path; OSError for a full disk or a damaged block.

        The blocks are compared with their records on as many threads, by default on all processors.
        """
        places = list(blocks)
        with ThreadPoolExecutor(threads or processors()) as pool:
            for block, sound in zip(places, pool.map(self._is_sound, places), strict=True):
                if not sound:
                    raise OSError(f"the block at {block} was damaged after it was written")
        if self.path.suffix == ".nc":
            try:
                self._copy_to_netcdf(places)
            except OutputError as error:
                raise OSError(error.reason) from error
            self.remove()
            return self.path
        self._complete_zarr()
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

    def _complete_zarr(self) -> None:
        """Write metadata and coordinates around the chunks."""
        import zarr
        from zarr.codecs import BloscCodec, Crc32cCodec

        group = zarr.create_group(self.parts, attributes={**self.attributes, "checksum": _NO_CHECKSUM})
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
                compressors=[BloscCodec(**_BLOSC, shuffle="shuffle"), Crc32cCodec()],
                chunk_key_encoding={"name": "default", "separator": "."},  # making a folder takes as long as a file
                dimension_names=[*self.coordinates, *variable.own_dims],
                attributes={key: _plain(value) for key, value in variable.attributes.items()},
            )

    def _copy_to_netcdf(self, blocks: Iterable[Block]) -> None:
        """Copy the chunks in order; they are those of HDF5."""
        import h5py
        import netCDF4

        with write_atomically(self.path) as temporary:
            try:
                with netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
                    self._declare(file)
                with h5py.File(temporary, "r+") as file:
                    for block in blocks:
                        for variable, chunk in zip(self.variables, self._chunk_files(block).values(), strict=True):
                            first = (*block, *[0] * len(variable.own_dims))
                            file[variable.name].id.write_direct_chunk(first, chunk.read_bytes())
            except RuntimeError as error:  # raised by the libraries for a full disk
                raise OSError(f"{error} while writing the NetCDF file: is the disk full?") from error
            with temporary.open("r+b") as data:
                checksum = hashlib.file_digest(data, "sha256").hexdigest()
                data.write(_TRAILER + checksum.encode())

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


def _deflated(chunk: NDArray[Any]) -> bytes:
    """Return a chunk as HDF5 shuffles and deflates it."""
    from isal import isal_zlib

    shuffled = chunk.view(np.uint8).reshape(-1, chunk.itemsize).T  # by significance
    data: bytes = isal_zlib.compress(np.ascontiguousarray(shuffled), _DEFLATION)
    return data


def _packed(chunk: NDArray[Any]) -> bytes:
    """Return a chunk as Zarr encodes it by Blosc, with its CRC-32C."""
    import google_crc32c
    import numcodecs

    data: bytes = numcodecs.Blosc(**_BLOSC, shuffle=numcodecs.Blosc.SHUFFLE).encode(chunk)
    checksum: int = google_crc32c.value(data)
    return data + checksum.to_bytes(4, "little")


_ENCODERS: Mapping[str, Callable[[NDArray[Any]], bytes]] = {".nc": _deflated, ".zarr": _packed}


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
    kept = sorted(name for name in names if re.search(r"/(zarr\.json$|c[./])", name))
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
