"""The atlas: quantities over the whole workspace (z_e, theta_x, theta_y), in bounded memory, resumable.

An atlas is computed in blocks of whole rows of theta_y. Every block is written, whole, into a Zarr store
`<name>.parts` beside the result; its map of broken limits comes last, so a block with that map is done, and a job that
was killed goes on with the blocks that have none. When all are there the store becomes the result: it is renamed, or
copied in order into a NetCDF file. No byte of the result depends on the order or the process in which the blocks were
computed.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import shutil
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

import pm3dof_pin
from pm3dof_pin.chapter.limits import Limit, broken_limits
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError, OutputError, PM3DofError
from pm3dof_pin.files import write_atomically
from pm3dof_pin.maps.grid import RectangularGrid
from pm3dof_pin.maps.quantities import Evaluation, Quantity, labels, select_quantities
from pm3dof_pin.typing import Array

if TYPE_CHECKING:
    import xarray as xr
    import zarr
    from distributed import Client

Block = tuple[int, int]  # first index along z_e and along theta_x

DIMS = ("z_e", "theta_x", "theta_y")
LIMITS = "broken_limits"
DEFAULT_QUANTITIES = ("felt_stiffness", "condition_number", "chapter_global")
_BLOCK_POSES = 65_536
_SCHEDULER_PATIENCE = "10s"


@dataclass(frozen=True)
class AtlasGrid:
    """The poses of an atlas: a rectangular grid of tilts at equally spaced heights, ends included.

    Attributes:
        tilts: theta_x and theta_y.
        height_range: first and last z_e [m].
        height_count: number of heights.
    """

    tilts: RectangularGrid
    height_range: tuple[float, float]
    height_count: int

    def __post_init__(self) -> None:
        """Check the heights.

        Raises:
            InvalidValueError: the range is not two growing finite heights, or there are fewer than 2.
        """
        first, last = self.height_range
        if not (np.isfinite(first) and np.isfinite(last) and first < last):
            raise InvalidValueError("height_range", self.height_range, "two growing finite heights in metres")
        if self.height_count < 2:
            raise InvalidValueError("height_count", self.height_count, "at least 2")

    @classmethod
    def over_workspace(cls, tripod: Tripod, shape: tuple[int, int, int]) -> AtlasGrid:
        """Return a grid over +-45 deg of both tilts and all heights of the level platform.

        Args:
            tripod: the machine.
            shape: number of theta_x, theta_y and z_e.
        """
        tilt = (-np.radians(45.0), np.radians(45.0))
        tilts = RectangularGrid(theta_x_range=tilt, theta_y_range=tilt, shape=shape[:2])
        return cls(tilts, (tripod.height_min, tripod.height_max), shape[2])

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of z_e, theta_x, theta_y."""
        return (self.height_count, *self.tilts.shape)

    @property
    def block_shape(self) -> tuple[int, int, int]:
        """Shape of the blocks: whole rows of theta_y, about 65,536 poses."""
        heights, rows, columns = self.shape
        section = rows * columns
        if section <= _BLOCK_POSES:
            return min(heights, _BLOCK_POSES // section), rows, columns
        return 1, max(1, _BLOCK_POSES // columns), columns

    def coordinates(self) -> dict[str, Array]:
        """Return z_e [m], theta_x and theta_y [rad]."""
        tilts = {name: coordinate.values for name, coordinate in self.tilts.coordinates().items()}
        return {"z_e": np.linspace(*self.height_range, self.height_count), **tilts}

    def blocks(self) -> list[Block]:
        """Return the first indices of every block."""
        heights, rows, _ = self.block_shape
        return [(i, j) for i in range(0, self.shape[0], heights) for j in range(0, self.shape[1], rows)]

    def slices(self, block: Block) -> tuple[slice, slice, slice]:
        """Return where a block stands in the atlas."""
        ends = [min(first + size, all_) for first, size, all_ in zip(block, self.block_shape, self.shape, strict=False)]
        return slice(block[0], ends[0]), slice(block[1], ends[1]), slice(0, self.shape[2])

    def poses(self, block: Block) -> Array:
        """Return the poses of a block, shape=(heights, rows, columns, 3) [rad, rad, m]."""
        coordinates = self.coordinates()
        parts = [coordinates[name][part] for name, part in zip(DIMS, self.slices(block), strict=True)]
        z_e, theta_x, theta_y = np.meshgrid(*parts, indexing="ij")
        return np.stack([theta_x, theta_y, z_e], axis=-1)


@dataclass(frozen=True)
class Atlas:
    """What to compute and where to put it.

    Attributes:
        tripod: the machine.
        grid: the poses.
        quantities: names out of :data:`pm3dof_pin.maps.quantities.QUANTITIES`.
        path: result, `.nc` (NetCDF) or `.zarr`.
        keep_beyond_limits: keep the values of poses that break a joint limit but can be reached.
    """

    tripod: Tripod
    grid: AtlasGrid
    quantities: tuple[str, ...]
    path: Path
    keep_beyond_limits: bool = False

    def __post_init__(self) -> None:
        """Check names and path.

        Raises:
            InvalidValueError: an unknown quantity, or a path that ends neither in .nc nor in .zarr.
        """
        select_quantities(self.quantities)
        if self.path.suffix not in (".nc", ".zarr"):
            raise InvalidValueError("path", self.path, "a name ending in .nc or .zarr")

    @property
    def parts(self) -> Path:
        """The store that holds the finished blocks until all are there."""
        return self.path.with_name(self.path.name + ".parts")

    @property
    def attributes(self) -> dict[str, Any]:
        """What the result says of itself; two atlases with the same attributes have the same numbers."""
        parameters = {
            key: list(quantity.value) if isinstance(quantity.value, tuple) else quantity.value
            for key, quantity in self.tripod.parameters.quantities.items()
        }
        specification = {
            "grid": dataclasses.asdict(self.grid),
            "quantities": self.quantities,
            "keep_beyond_limits": self.keep_beyond_limits,
            "parameters": parameters,
        }
        return {
            "title": "Atlas of a 3-DOF parallel manipulator over (z_e, theta_x, theta_y)",
            "source": f"pm3dof-pin {pm3dof_pin.__version__}",
            "references": "D. Zhang, Parallel Robotic Machine Tools, Springer 2010, chapter 8",
            "specification": json.dumps(specification, sort_keys=True),
        }


def compute_atlas(
    atlas: Atlas,
    *,
    workers: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Compute an atlas, or go on with one that was interrupted.

    Args:
        atlas: what and where.
        workers: threads; the number of processors by default.
        scheduler: address of a dask scheduler whose workers see the same file system; instead of threads.
        progress: called with (poses done, poses in all) after every block.

    Returns:
        The path of the result.

    Raises:
        OutputError: the folder cannot be written, something else than an older atlas is in its place, there is no room
            for it, the disk is full (what is finished is kept), or the unfinished store beside the result belongs to
            another atlas.
        PM3DofError: a scheduler is named and dask is not installed or does not answer.
    """
    with _cluster(scheduler) if scheduler else nullcontext() as cluster:
        return _compute(atlas, workers, cluster, progress)


def _compute(
    atlas: Atlas, workers: int | None, cluster: Client | None, progress: Callable[[int, int], None] | None
) -> Path:
    try:
        _open_parts(atlas)
        todo = [block for block in atlas.grid.blocks() if not _is_done(atlas, block)]
        total = math.prod(atlas.grid.shape)
        done = total - sum(_poses_in(atlas, block) for block in todo)
        run = _on_cluster(atlas, todo, cluster) if cluster else _on_threads(atlas, todo, workers)
        for block in run:
            done += _poses_in(atlas, block)
            if progress:
                progress(done, total)
        return _finish(atlas)
    except OSError as error:
        reason = error.strerror or str(error)
        if atlas.parts.exists():
            reason += f"; finished blocks are kept in {atlas.parts} and the same command goes on there"
        raise OutputError(atlas.path, reason) from error


def open_atlas(path: Path | str) -> xr.Dataset:
    """Open an atlas lazily, with the names of axes, springs and legs as coordinates.

    Args:
        path: an atlas, `.nc` or `.zarr`.
    """
    import xarray as xr

    dataset = xr.open_zarr(path, consolidated=False) if Path(path).suffix == ".zarr" else xr.open_dataset(path)
    for variable in dataset.data_vars.values():
        for dim in variable.dims:
            if f"{dim}_labels" in variable.attrs:
                dataset = dataset.assign_coords({dim: variable.attrs[f"{dim}_labels"].split()})
    return dataset


def compute_block(atlas: Atlas, block: Block) -> Block:
    """Compute one block and write it into the store; the map of broken limits last, as the sign that it is done."""
    import zarr

    group = zarr.open_group(atlas.parts, mode="r+")
    where = atlas.grid.slices(block)
    poses = atlas.grid.poses(block)
    flags = broken_limits(atlas.tripod, poses)
    evaluation = Evaluation(atlas.tripod, poses)
    for quantity in select_quantities(atlas.quantities):
        values = np.array(quantity.compute(evaluation))
        if not atlas.keep_beyond_limits:
            values[flags != 0] = np.nan
        _array(group, quantity.name)[where] = values
    _array(group, LIMITS)[where] = flags
    return block


def _array(group: zarr.Group, name: str) -> zarr.Array[Any]:
    import zarr

    array = group[name]
    assert isinstance(array, zarr.Array)
    return array


def _on_threads(atlas: Atlas, todo: Sequence[Block], workers: int | None) -> Iterator[Block]:
    """Run the blocks on threads (the kernels and the writes leave the interpreter lock), a few ahead at a time."""
    count = workers or os.cpu_count() or 1
    waiting: deque[Future[Block]] = deque()
    with ThreadPoolExecutor(count) as pool:
        try:
            for block in todo:
                waiting.append(pool.submit(compute_block, atlas, block))
                if len(waiting) > count:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


def _cluster(scheduler: str) -> Client:
    try:
        from distributed import Client
    except ImportError as error:
        raise PM3DofError("a dask scheduler needs the extra 'cluster': pip install 'pm3dof-pin[cluster]'") from error
    try:
        return Client(scheduler, timeout=_SCHEDULER_PATIENCE)  # type: ignore[no-untyped-call]
    except (OSError, TimeoutError, ValueError) as error:
        raise PM3DofError(f"no dask scheduler answers at {scheduler}: {error}") from error


def _on_cluster(atlas: Atlas, todo: Sequence[Block], cluster: Client) -> Iterator[Block]:
    from distributed import as_completed

    absolute = dataclasses.replace(atlas, path=atlas.path.resolve())
    futures = [cluster.submit(compute_block, absolute, block, pure=False) for block in todo]
    for future in as_completed(futures):  # type: ignore[no-untyped-call]
        yield future.result()


def _poses_in(atlas: Atlas, block: Block) -> int:
    return int(np.prod([part.stop - part.start for part in atlas.grid.slices(block)]))


def _is_done(atlas: Atlas, block: Block) -> bool:
    heights, rows, _ = atlas.grid.block_shape
    return (atlas.parts / LIMITS / "c" / str(block[0] // heights) / str(block[1] // rows) / "0").is_file()


def _open_parts(atlas: Atlas) -> None:
    """Make the store, or check that the one that is there is of the same atlas."""
    import zarr

    _require_place(atlas.path)
    if (atlas.parts / "zarr.json").is_file():
        if dict(zarr.open_group(atlas.parts, mode="r").attrs) != atlas.attributes:
            raise OutputError(atlas.path, f"{atlas.parts} is an unfinished atlas of other settings; remove it first")
        for torn in atlas.parts.rglob("*.partial"):
            torn.unlink()
        return
    shutil.rmtree(atlas.parts, ignore_errors=True)
    _require_room(atlas)
    atlas.parts.parent.mkdir(parents=True, exist_ok=True)
    fresh = atlas.parts.with_name(atlas.parts.name + ".new")
    shutil.rmtree(fresh, ignore_errors=True)
    _make_store(atlas, fresh)
    fresh.rename(atlas.parts)


def _require_place(path: Path) -> None:
    """Refuse at once a place that the result cannot take: only a file gives way to a file, and an atlas to an atlas."""
    if path.suffix == ".nc" and path.is_dir():
        raise OutputError(path, "a folder is there, expected nothing or a file")
    if path.suffix == ".zarr" and path.exists() and not (path / LIMITS / "zarr.json").is_file():
        raise OutputError(path, "something else than an atlas is there, expected nothing or an older atlas")


def _require_room(atlas: Atlas) -> None:
    """Refuse at once what the disk cannot hold: the blocks and, beside them, the NetCDF file that is made from them."""
    names = labels(atlas.tripod)
    numbers = sum(math.prod(len(names[dim]) for dim in entry.dims) for entry in select_quantities(atlas.quantities))
    copies = 2 if atlas.path.suffix == ".nc" else 1
    needed = copies * math.prod(atlas.grid.shape) * (8 * numbers + 1)
    folder = next(parent for parent in atlas.parts.resolve().parents if parent.exists())
    free = shutil.disk_usage(folder).free
    if needed > free:
        raise OutputError(atlas.path, f"it takes {needed / 1e9:.4g} GB of disk to make, {free / 1e9:.4g} GB are free")


def _make_store(atlas: Atlas, path: Path) -> None:
    import zarr

    group = zarr.create_group(path, attributes=atlas.attributes)
    units = {"z_e": "m", "theta_x": "rad", "theta_y": "rad"}
    for name, values in atlas.grid.coordinates().items():
        coordinate = group.create_array(
            name,
            shape=values.shape,
            dtype="float64",
            chunks=values.shape,
            compressors=None,
            dimension_names=[name],
            attributes={"units": units[name]},
        )
        coordinate[:] = values
    names = labels(atlas.tripod)
    for quantity in select_quantities(atlas.quantities):
        own_shape = tuple(len(names[dim]) for dim in quantity.dims)
        attributes = {"units": quantity.unit, "long_name": quantity.long_name}
        attributes |= {f"{dim}_labels": " ".join(names[dim]) for dim in quantity.dims}
        _make_array(atlas, group, quantity.name, "float64", np.nan, (quantity.dims, own_shape), attributes)
    kinds = [limit for limit in Limit if limit]
    flags = {
        "long_name": "joint limits that exclude the pose; 0: none",
        "flag_masks": [int(limit) for limit in kinds],
        "flag_meanings": " ".join((limit.name or "").lower() for limit in kinds),
    }
    _make_array(atlas, group, LIMITS, "uint8", 0, ((), ()), flags)


def _make_array(
    atlas: Atlas,
    group: zarr.Group,
    name: str,
    dtype: str,
    fill_value: float,
    own: tuple[tuple[str, ...], tuple[int, ...]],
    attributes: dict[str, Any],
) -> None:
    own_dims, own_shape = own
    group.create_array(
        name,
        shape=atlas.grid.shape + own_shape,
        dtype=dtype,
        chunks=atlas.grid.block_shape + own_shape,
        fill_value=fill_value,
        compressors=None,
        dimension_names=[*DIMS, *own_dims],
        attributes=attributes,
        config={"write_empty_chunks": True},  # a block of zeros is a finished block too
    )


def _finish(atlas: Atlas) -> Path:
    if atlas.path.suffix == ".nc":
        _copy_to_netcdf(atlas)
        shutil.rmtree(atlas.parts)
        return atlas.path
    if atlas.path.exists():
        shutil.rmtree(atlas.path)
    atlas.parts.rename(atlas.path)
    return atlas.path


def _copy_to_netcdf(atlas: Atlas) -> None:
    """Copy the store block by block, in order, into uncompressed variables of fixed places."""
    import netCDF4
    import zarr

    group = zarr.open_group(atlas.parts, mode="r")
    names = labels(atlas.tripod)
    quantities = select_quantities(atlas.quantities)
    with write_atomically(atlas.path) as temporary, netCDF4.Dataset(temporary, "w", format="NETCDF4") as file:
        file.setncatts(atlas.attributes)
        for dim, size in zip(DIMS, atlas.grid.shape, strict=True):
            file.createDimension(dim, size)
        for dim in dict.fromkeys(dim for quantity in quantities for dim in quantity.dims):
            file.createDimension(dim, len(names[dim]))
        for name in (*DIMS, *(quantity.name for quantity in quantities), LIMITS):
            array = _array(group, name)
            dims = _dimension_names(name, quantities)
            variable = file.createVariable(name, array.dtype.str[1:], dims, contiguous=True, fill_value=False)
            variable.setncatts({key: _netcdf_attribute(value) for key, value in array.attrs.items()})
            if name in DIMS:
                variable[:] = array[:]
                continue
            for block in atlas.grid.blocks():
                where = atlas.grid.slices(block)
                variable[where] = array[where]


def _dimension_names(name: str, quantities: Sequence[Quantity]) -> tuple[str, ...]:
    if name in DIMS:
        return (name,)
    own = next((quantity.dims for quantity in quantities if quantity.name == name), ())
    return (*DIMS, *own)


def _netcdf_attribute(value: Any) -> Any:
    return np.array(value, dtype=np.uint8) if isinstance(value, list) else value
