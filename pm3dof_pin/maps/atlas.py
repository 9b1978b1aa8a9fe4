"""The atlas: quantities of any robot over a grid of its coordinates, in bounded memory, resumable.

An atlas is computed in blocks of whole rows of its last dimensions. The chunks of every block are written to a folder
`<name>.parts` next to the result, and then a record of their checksums. A killed job resumes with the blocks that have
no record or do not match it. When all blocks are there, they become the result, with a checksum of everything in it.
A block is computed from its own poses alone, so no byte of the result depends on the order or the process in which the
blocks were computed. Only one run at a time works on an atlas.
"""

from __future__ import annotations

import ctypes
import dataclasses
import errno
import hashlib
import itertools
import json
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

import numpy as np

from pm3dof_pin.arrays import require_choice, require_count, require_kind
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.exceptions import (
    DescriptionError,
    InvalidValueError,
    OutputError,
    PM3DofError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import limit_names
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.atlas_store import AtlasStore, Block, Record, Variable, exclusive_run, require_intact
from pm3dof_pin.maps.datasets import BROKEN_LIMITS, dataset_attributes, flag_variable
from pm3dof_pin.maps.quantities import select_quantities
from pm3dof_pin.maps.quantity import NO_WRENCH, Evaluation, MappedRobot, Quantity
from pm3dof_pin.programs.processors import processors
from pm3dof_pin.typing import Branch

if TYPE_CHECKING:
    import xarray as xr
    from distributed import Client

Precision: TypeAlias = Literal["single", "double"]

_BLOCK_POSES = 131_072
_SCHEDULER_PATIENCE = "10s"
_WORKER_PATIENCE = 10.0  # s
_POLL = 0.01  # s
_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3  # of the C library's mallopt
_KEPT_MEMORY = 2**25  # bytes of an array that is freed, the most that the C library takes
_BATCHES, _MAX_BATCH = 8, 16  # tasks for each worker of a cluster, and blocks in one, at most
_CLUSTER_LOGS = ("distributed", "distributed.client", "tornado", "tornado.application", "asyncio")
_SILENT = logging.CRITICAL + 1


@dataclass(frozen=True)
class Atlas:
    """The definition of an atlas: what to compute and where to write it.

    Example:
        >>> from pathlib import Path
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("hexapod")
        >>> grid = robot.grid(x=(-0.005, 0.005, 3), y=(-0.005, 0.005, 3))
        >>> atlas = pm.Atlas(robot, grid, ("compliance",), Path("hexapod.nc"))

    Attributes:
        robot: the robot, with the springs of its description; or an elastic model.
        grid: the poses; its dimensions are those of the result.
        quantities: names of :data:`~pm3dof_pin.maps.quantities.QUANTITIES`.
        path: result, `.nc` (NetCDF) or `.zarr`.
        keep_beyond_limits: whether to keep values at poses that break a limit but can be reached.
        branches: "home", poses of home's branch; or "all" that the coordinates alone determine (quantity `branch`).
        wrenches: of the tool on its environment, for `wrench_margin` and `wrench_feasible` [N, N m].
        precision: "single" or "double" on disk; computation is in double, and 6 x 6 matrices are always double.
    """

    robot: Robot | ElasticModel
    grid: Grid
    quantities: tuple[str, ...]
    path: Path
    keep_beyond_limits: bool = False
    precision: Precision = "single"
    branches: Branch = "home"
    wrenches: tuple[tuple[float, ...], ...] = NO_WRENCH

    def __post_init__(self) -> None:
        """Check names and path; InvalidValueError for an unknown quantity, no dimensions or another suffix."""
        require_kind("robot", self.robot, Robot, "pm.load")
        require_kind("grid", self.grid, Grid, "Robot.grid")
        require_choice("precision", self.precision, Precision)
        require_choice("branches", self.branches, Branch)
        object.__setattr__(self, "path", Path(self.path))
        if not self.grid.axes:
            raise InvalidValueError("grid", problem="is one pose", expected="at least one coordinate with a range")
        if self.path.suffix not in (".nc", ".zarr"):
            raise InvalidValueError("path", self.path, "a name ending in .nc or .zarr")
        self.selected  # noqa: B018  raises at once for an unknown name

    @cached_property
    def mapped(self) -> MappedRobot:
        """The robot whose quantities are mapped."""
        return MappedRobot(self.robot, self.wrenches)

    @cached_property
    def selected(self) -> tuple[Quantity, ...]:
        """The quantities."""
        return select_quantities(self.quantities, self.mapped)

    @property
    def parts(self) -> Path:
        """The folder of finished blocks until the atlas is complete."""
        return self.store.parts

    @cached_property
    def block_shape(self) -> tuple[int, ...]:
        """Shape of the blocks: whole rows of the last dimensions, about 131,072 poses."""
        shape: list[int] = []
        room = _BLOCK_POSES
        for size in reversed(self.grid.shape):
            shape.insert(0, max(1, min(size, room)))
            room //= size
        return tuple(shape)

    def blocks(self) -> Iterator[Block]:
        """Iterate over the first indices of every block."""
        starts = (range(0, size, step) for size, step in zip(self.grid.shape, self.block_shape, strict=True))
        return itertools.product(*starts)

    def slices(self, block: Block) -> tuple[slice, ...]:
        """Return the slices of a block in the atlas."""
        sizes = zip(block, self.block_shape, self.grid.shape, strict=True)
        return tuple(slice(first, min(first + step, size)) for first, step, size in sizes)

    @cached_property
    def store(self) -> AtlasStore:
        """The arrays of the atlas on disk."""
        coordinates = {
            c.name: (self.grid.axes[c.name], {"units": c.unit, "long_name": f"coordinate {c.name}"})
            for c in self.grid.coordinates
            if c.name in self.grid.axes
        }
        return AtlasStore(
            self.path,
            {name: coordinates[name] for name in self.grid.dims},
            self.block_shape,
            (*map(self._variable, self.selected), self._flags()),
            self.attributes,
        )

    @cached_property
    def attributes(self) -> dict[str, Any]:
        """Attributes of the result; two atlases with the same attributes have the same numbers."""
        robot = self.mapped.robot
        specification = {
            "description": hashlib.sha256(self._description().encode()).hexdigest(),
            "axes": {name: [float(v[0]), float(v[-1]), len(v)] for name, v in self.grid.axes.items()},
            "values": hashlib.sha256(b"".join(v.tobytes() for v in self.grid.axes.values())).hexdigest(),
            "fixed": dict(self.grid.fixed),
            "quantities": self.quantities,
            "keep_beyond_limits": self.keep_beyond_limits,
            "precision": self.precision,
            "branches": self.branches,
            "engine": robot.engine,
            **({"wrenches": self.wrenches} if self.wrenches != NO_WRENCH else {}),
        }
        return {
            **dataset_attributes(f"Atlas of {robot.name} over ({', '.join(self.grid.dims)})", robot.name),
            "specification": json.dumps(specification, sort_keys=True),
            **{f"fixed_{name}": value for name, value in self.grid.fixed.items()},
        }

    def _description(self) -> str:
        """Every number and name that the poses and quantities depend on."""
        robot = self.mapped.robot
        parts = [robot.closures, robot.couplings, robot.commands, robot.coordinates, robot.limit_groups, robot.springs]
        if isinstance(self.robot, ElasticModel):
            parts += [(block.name, block.coefficients.tolist(), block.length) for block in self.robot.blocks]
        errors = robot.files.errors if robot.files is not None else None
        tolerances = errors.read_text(encoding="utf-8") if errors is not None and errors.is_file() else ""
        return "\n".join([robot.model.saveToString(), *map(repr, parts), tolerances])

    def _variable(self, quantity: Quantity) -> Variable:
        labels = {dim.name: dim.labels(self.mapped) for dim in quantity.dims}
        attributes: dict[str, Any] = {"units": quantity.unit_for(self.mapped), "long_name": quantity.long_name}
        attributes |= {f"{name}_labels": " ".join(entries) for name, entries in labels.items()}
        double = self.precision == "double" or len(labels) > 1
        own = {name: len(entries) for name, entries in labels.items()}
        return Variable(quantity.name, own, np.dtype("float64" if double else "float32"), float("nan"), attributes)

    def _flags(self) -> Variable:
        names = limit_names(self.mapped.robot)
        none = flag_variable((), np.zeros(()), names, "limits that exclude the pose; 0: none")
        return Variable(BROKEN_LIMITS, {}, none.values.dtype, 0, none.attrs)


def compute_atlas(
    atlas: Atlas,
    *,
    threads: int | None = None,
    scheduler: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Path:
    """Compute an atlas, or resume an interrupted one.

    Example:
        >>> from pathlib import Path
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("hexapod")
        >>> grid = robot.grid(x=(-0.005, 0.005, 3), y=(-0.005, 0.005, 3))
        >>> pm.compute_atlas(pm.Atlas(robot, grid, ("compliance",), Path("hexapod.nc"))).name
        'hexapod.nc'

    Args:
        atlas: the definition of the atlas.
        threads: number of threads; the number of processors by default.
        scheduler: address of a dask scheduler whose workers see the same file system; instead of threads.
        progress: called with (poses done, total) after every block.

    Returns:
        The path of the result.

    Raises:
        OutputError: the folder cannot be written, the path is taken by something other than an older atlas, there is
            not enough space, the disk is full (finished blocks are kept), or the unfinished store next to the result
            belongs to another atlas.
        UnreachablePoseError: no pose of the grid is within the limits; nothing is written.
        PM3DofError: a scheduler is given, but dask is not installed or does not answer.
    """
    require_kind("atlas", atlas, Atlas, "pm.Atlas")
    if threads is not None:
        require_count("threads", threads)
    with exclusive_run(atlas.path), _cluster(scheduler) if scheduler else nullcontext() as cluster:
        return _compute(atlas, threads, cluster, progress)


def _compute(
    atlas: Atlas, threads: int | None, cluster: Client | None, progress: Callable[[int, int], None] | None
) -> Path:
    try:
        finished = atlas.store.open()
        todo = [block for block in atlas.blocks() if block not in finished]
        done = atlas.grid.size - sum(_poses_in(atlas, block) for block in todo)
        for block in _on_cluster(atlas, todo, cluster) if cluster else _on_threads(atlas, todo, threads):
            done += _poses_in(atlas, block)
            if progress:
                progress(done, atlas.grid.size)
        if not any(map(atlas.store.has_pose_within_limits, atlas.blocks())):
            raise UnreachablePoseError(f"no pose of the atlas over {', '.join(atlas.grid.dims)} is within every limit")
        return atlas.store.finish(atlas.blocks(), threads)
    except OSError as error:
        reason = error.strerror or str(error)
        if error.filename and error.errno == errno.ENOENT:
            reason += f": {error.filename} (removed by another program?)"
        atlas.store.remove(unless_resumable=True)
        if atlas.parts.exists():
            reason += f"; finished blocks are kept in {atlas.parts}; run the same command again to resume"
        raise OutputError(atlas.path, reason) from error
    except OutputError:  # the place is taken, or by an unfinished atlas with other settings
        raise
    except PM3DofError:  # the same for every run: nothing to resume
        atlas.store.remove()
        raise
    except BaseException as error:
        atlas.store.remove(unless_resumable=True)
        if isinstance(error, RuntimeError) and "un-acquired lock" in str(error):  # Ctrl-C while acquiring a lock
            raise KeyboardInterrupt from error
        raise


def open_atlas(path: Path | str, *, verify: bool = True) -> xr.Dataset:
    """Open an atlas lazily, with the names of axes, springs and the like as coordinates.

    First the whole atlas is compared with the checksum that it carries, which reads it once.

    Example:
        >>> from pathlib import Path
        >>> import pm3dof_pin as pm
        >>> robot = pm.load("hexapod")
        >>> grid = robot.grid(x=(-0.005, 0.005, 3), y=(-0.005, 0.005, 4))
        >>> path = pm.compute_atlas(pm.Atlas(robot, grid, ("compliance",), Path("hexapod.nc")))
        >>> with pm.open_atlas(path) as maps:
        ...     maps["compliance"].shape
        (3, 4, 6, 6)

    Args:
        path: an atlas, `.nc` or `.zarr`.
        verify: whether to compare it with its checksum.

    Raises:
        DescriptionError: there is no atlas, it cannot be read, or it is damaged.
    """
    import xarray as xr

    if verify:
        require_intact(Path(path))
    try:
        dataset = xr.open_zarr(path, consolidated=False) if Path(path).suffix == ".zarr" else xr.open_dataset(path)
    except (OSError, KeyError, ValueError) as error:
        raise DescriptionError(path, "file", f"expected an atlas ({error})") from error
    for variable in dataset.data_vars.values():
        for dim in variable.dims:
            if f"{dim}_labels" in variable.attrs:
                dataset = dataset.assign_coords({dim: variable.attrs[f"{dim}_labels"].split()})
    return dataset


def _compute_block(atlas: Atlas, block: Block) -> Block:
    """Compute one block, write it into the store, and then its record."""
    place = atlas.slices(block)
    poses = atlas.mapped.robot.solve(atlas.grid.part(place), on_failure="nan", threads=1, branches=atlas.branches)
    size = math.prod(poses.shape)
    kept = np.flatnonzero(poses.solved if atlas.keep_beyond_limits else poses.within_limits)
    rows = kept if kept.size < size else slice(None)
    chosen = poses.reshape(size)[rows]
    evaluation = Evaluation(atlas.mapped, chosen, threads=1)
    *variables, flags = atlas.store.variables
    checksums = {}
    for quantity, variable in zip(atlas.selected, variables, strict=True):
        own_shape = tuple(variable.own_dims.values())
        values = np.full((size, *own_shape), variable.fill_value, dtype=variable.dtype)
        if len(chosen):
            with np.errstate(over="ignore"):  # numbers beyond single precision become infinite
                values[rows] = quantity.compute(evaluation)
        checksums[variable.name] = atlas.store.write(variable, block, values.reshape(*poses.shape, *own_shape))
    checksums[flags.name] = atlas.store.write(flags, block, poses.broken_limits)
    atlas.store.seal(block, Record(checksums, bool(poses.within_limits.any())))
    return block


def _compute_blocks(atlas: Atlas, blocks: Sequence[Block]) -> list[Block]:
    """Compute several blocks on a worker of a cluster, where a task takes some milliseconds whatever it does.

    Dask's workers return memory to the system whenever some is freed, and clear it again for the next block.
    """
    if hasattr(library := ctypes.CDLL(None), "mallopt"):
        library.mallopt(_MMAP_THRESHOLD, _KEPT_MEMORY)
        library.mallopt(_TRIM_THRESHOLD, 4 * _KEPT_MEMORY)
    return [_compute_block(atlas, block) for block in blocks]


def _on_threads(atlas: Atlas, todo: Sequence[Block], threads: int | None) -> Iterator[Block]:
    """Run the blocks on threads (programs and writes release the interpreter lock), a few ahead at a time."""
    count = threads or processors()
    computing: deque[Future[Block]] = deque()
    with ThreadPoolExecutor(count) as pool:
        try:
            for block in todo:
                computing.append(pool.submit(_compute_block, atlas, block))
                if len(computing) > count:
                    yield computing.popleft().result()
            while computing:
                yield computing.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)


@contextmanager
def _cluster(scheduler: str) -> Iterator[Client]:
    try:
        from distributed import Client
    except ImportError as error:
        raise PM3DofError("a dask scheduler needs the extra 'cluster': pip install 'pm3dof-pin[cluster]'") from error
    # their messages about a lost scheduler are replaced by one line
    logs = [logging.getLogger(name) for name in _CLUSTER_LOGS]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(_SILENT)
    try:
        try:
            client = Client(scheduler, timeout=_SCHEDULER_PATIENCE)  # type: ignore[no-untyped-call]
        except (OSError, TimeoutError, ValueError) as error:
            raise PM3DofError(f"no dask scheduler answers at {scheduler}: {error}") from error
        try:
            yield client
        finally:
            with suppress(Exception):  # it may be lost
                client.close(timeout=1)  # type: ignore[no-untyped-call]
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def _on_cluster(atlas: Atlas, todo: Sequence[Block], cluster: Client) -> Iterator[Block]:
    from distributed import as_completed

    absolute = dataclasses.replace(atlas, path=atlas.path.resolve())
    try:
        # once to each worker, which keeps what the first block found out about the robot
        kept: Any = cluster.scatter(absolute, broadcast=True, hash=False)  # type: ignore[no-untyped-call]
        workers = len(cluster.scheduler_info()["workers"])
        size = min(_MAX_BATCH, max(1, len(todo) // (_BATCHES * max(workers, 1))))
        batches = [todo[first : first + size] for first in range(0, len(todo), size)]
        futures = [cluster.submit(_compute_blocks, kept, batch, pure=False) for batch in batches]
        ready = as_completed(futures)  # type: ignore[no-untyped-call]
        idle = time.monotonic()
        while not ready.is_empty():  # type: ignore[no-untyped-call]
            for future in ready.next_batch(block=False):  # type: ignore[no-untyped-call]
                yield from future.result()
                idle = time.monotonic()
            time.sleep(_POLL)
            if time.monotonic() - idle > _WORKER_PATIENCE:
                if not cluster.scheduler_info()["workers"]:
                    raise OSError("the dask cluster has no workers left; start some")
                idle = time.monotonic()
    except (PM3DofError, OSError):
        raise
    except Exception as error:  # raised by dask: a lost scheduler, workers that die
        reason = " ".join(f"{type(error).__name__}: {error}".split())
        raise OSError(f"the dask cluster failed ({reason})") from error


def _poses_in(atlas: Atlas, block: Block) -> int:
    return math.prod(part.stop - part.start for part in atlas.slices(block))
