"""Robustness of the store: damage, kills, full disks, concurrent runs: identical bytes, or a one-line message."""

from __future__ import annotations

import errno
import hashlib
import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from pm3dof_pin.exceptions import DescriptionError, OutputError, PM3DofError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps import atlas as atlas_module
from pm3dof_pin.maps.atlas import Atlas, compute_atlas, open_atlas
from pm3dof_pin.maps.atlas_store import AtlasStore, Record
from pm3dof_pin.programs import cache

QUANTITIES = ("felt_stiffness", "condition_number")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Robot]:
    """Its programs are recorded from itself, here and in other processes: those of a variant differ by rounding."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PM3DOF_CACHE_DIR", str(tmp_path_factory.mktemp("programs")))
        patch.setattr(cache, "_known", {})
        yield Robot.load("hexapod")


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atlas_module, "_BLOCK_POSES", 20)


def make(robot: Robot, path: Path) -> Atlas:
    return Atlas(robot, robot.grid(x=(-0.01, 0.01, 9), y=(-0.01, 0.01, 9)), QUANTITIES, path)


def digest(path: Path) -> dict[str, str]:
    files = [path] if path.is_file() else sorted(entry for entry in path.rglob("*") if entry.is_file())
    return {str(file.relative_to(path.parent)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


def interrupted(monkeypatch: pytest.MonkeyPatch, job: Atlas) -> None:
    """Compute all blocks, and stop before they become the result."""
    with monkeypatch.context() as patch:
        patch.setattr(AtlasStore, "finish", lambda *_: (_ for _ in ()).throw(KeyboardInterrupt()))
        with pytest.raises(KeyboardInterrupt):
            compute_atlas(job)


def flip(file: Path, where: int = -9) -> None:
    data = bytearray(file.read_bytes())
    data[where] ^= 0x10
    file.write_bytes(data)


def chunks(parts: Path) -> list[Path]:
    return sorted((parts / "felt_stiffness").glob("c.*"))


def a_chunk(parts: Path) -> Path:
    return chunks(parts)[1]


def swap(parts: Path) -> None:
    one, other = chunks(parts)[:2]
    first = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(first)


def folder_in_place(parts: Path) -> None:
    chunk = a_chunk(parts)
    chunk.unlink()
    (chunk / "inside").mkdir(parents=True)


def a_record(parts: Path) -> Path:
    return sorted((parts / "finished").iterdir())[1]


DAMAGES: dict[str, Callable[[Path], object]] = {
    "a flipped bit in a block": lambda parts: flip(a_chunk(parts)),
    "a block cut short": lambda parts: a_chunk(parts).write_bytes(a_chunk(parts).read_bytes()[:-7]),
    "an empty block": lambda parts: a_chunk(parts).write_bytes(b""),
    "a block that is gone": lambda parts: a_chunk(parts).unlink(),
    "two blocks exchanged": swap,
    "a folder where a block was": folder_in_place,
    "an array that is gone": lambda parts: shutil.rmtree(parts / "condition_number"),
    "a flipped bit in a record": lambda parts: flip(a_record(parts), -5),
    "a torn record": lambda parts: a_record(parts).write_bytes(a_record(parts).read_bytes()[:-20]),
    "an empty record": lambda parts: a_record(parts).write_bytes(b""),
    "a record of another atlas": lambda parts: flip(a_record(parts), 3),
    "another flag in a record": lambda parts: a_record(parts).write_bytes(
        a_record(parts).read_bytes().replace(b"true", b"false")
    ),
}


def leave_metadata(parts: Path) -> None:
    """As of a run that was killed while it made the result."""
    (parts / "zarr.json").write_text("{")
    (parts / "felt_stiffness" / "zarr.json").write_text('{"shape": [4')
    (parts / "x").mkdir()
    (parts / "x" / "c.0").write_bytes(b"coordinates")


LEFTOVERS: dict[str, Callable[[Path], object]] = {
    "metadata": leave_metadata,
    "a chunk without a record": lambda parts: (parts / "felt_stiffness" / "c.9.0.0").write_bytes(b"chunk"),
    "a folder": lambda parts: (parts / "felt_stiffness" / "c" / "0").mkdir(parents=True),
}


@pytest.mark.parametrize("suffix", [".zarr", ".nc"])
def test_damage_is_noticed_and_repaired_to_the_byte(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture, suffix: str
) -> None:
    whole = digest(compute_atlas(make(robot, tmp_path / "whole" / f"atlas{suffix}")))
    job = make(robot, tmp_path / "broken" / f"atlas{suffix}")
    interrupted(monkeypatch, job)
    shutil.copytree(job.parts, tmp_path / "sound")
    for name, damage in {**DAMAGES, **LEFTOVERS}.items() if suffix == ".zarr" else [*DAMAGES.items()][::4]:
        shutil.rmtree(tmp_path / "broken")
        shutil.copytree(tmp_path / "sound", job.parts)
        caplog.clear()
        damage(job.parts)
        path = compute_atlas(make(robot, job.path))
        assert digest(path) == whole, name
        assert bool(caplog.text) == (name in DAMAGES), name
        assert {entry.name for entry in path.parent.iterdir()} == {path.name}, name


@pytest.mark.parametrize("length", [0, 1, 63, 64, 80, -1])
def test_an_only_record_that_a_killed_run_had_not_written_whole(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, length: int
) -> None:
    """A file is made, then filled; a run may be killed at any moment between."""
    whole = digest(compute_atlas(make(robot, tmp_path / "whole" / "atlas.zarr")))
    job = make(robot, tmp_path / "broken" / "atlas.zarr")
    interrupted(monkeypatch, job)
    record, *others = sorted((job.parts / "finished").iterdir())
    for other in others:
        other.unlink()
    record.write_bytes(record.read_bytes()[:length])
    assert digest(compute_atlas(make(robot, job.path))) == whole


def test_blocks_of_another_size_are_another_atlas(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupted(monkeypatch, make(robot, tmp_path / "atlas.nc"))
    monkeypatch.setattr(atlas_module, "_BLOCK_POSES", 30)
    with pytest.raises(OutputError, match="unfinished atlas with other settings"):
        compute_atlas(make(robot, tmp_path / "atlas.nc"))


def test_the_chunks_of_a_netcdf_file_are_those_of_the_blocks(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = make(robot, tmp_path / "atlas.nc")
    interrupted(monkeypatch, job)
    written = [chunk.read_bytes() for chunk in chunks(job.parts)]
    with h5py.File(compute_atlas(job)) as file:
        array = file["felt_stiffness"].id
        places = sorted(array.get_chunk_info(k).chunk_offset for k in range(array.get_num_chunks()))
        assert [array.read_direct_chunk(place)[1] for place in places] == written


def test_sound_blocks_are_not_computed_again(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    job = make(robot, tmp_path / "atlas.zarr")
    interrupted(monkeypatch, job)
    flip(a_chunk(job.parts))
    computed = []
    compute = atlas_module._compute_block
    monkeypatch.setattr(atlas_module, "_compute_block", lambda a, block: computed.append(block) or compute(a, block))
    compute_atlas(make(robot, job.path))
    assert len(computed) == 1
    assert "1 finished blocks are damaged; computed again" in caplog.text


@pytest.mark.parametrize("suffix", [".zarr", ".nc"])
def test_a_block_damaged_before_the_result_is_made(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, suffix: str
) -> None:
    whole = digest(compute_atlas(make(robot, tmp_path / "whole" / f"atlas{suffix}")))
    job = make(robot, tmp_path / "broken" / f"atlas{suffix}")
    finish = AtlasStore.finish

    def late_damage(store: AtlasStore, *arguments: Any) -> Path:
        flip(a_chunk(store.parts))
        return finish(store, *arguments)

    with monkeypatch.context() as patch:
        patch.setattr(AtlasStore, "finish", late_damage)
        expected = r"the block at \(2, 0\) was damaged after it was written.*run the same command again"
        with pytest.raises(OutputError, match=expected):
            compute_atlas(job)
    assert digest(compute_atlas(make(robot, job.path))) == whole


@pytest.mark.parametrize("moment", ["block", "record", "netcdf"])
def test_a_full_disk_is_one_line_and_loses_nothing(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, moment: str
) -> None:
    whole = digest(compute_atlas(make(robot, tmp_path / "whole" / "atlas.nc")))
    job = make(robot, tmp_path / "broken" / "atlas.nc")
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    with monkeypatch.context() as patch:
        if moment == "block":
            count = []
            write = AtlasStore.write

            def write_until_full(store: AtlasStore, *arguments: Any) -> int:
                count.append(1)
                if len(count) > 7:
                    raise full
                return write(store, *arguments)

            patch.setattr(AtlasStore, "write", write_until_full)
        elif moment == "record":
            seal = AtlasStore.seal

            def seal_until_full(store: AtlasStore, block: tuple[int, ...], record: Record) -> None:
                if block[0]:
                    raise full
                seal(store, block, record)

            patch.setattr(AtlasStore, "seal", seal_until_full)
        else:
            import netCDF4

            def refuse(*_: object, **__: object) -> None:
                raise RuntimeError("NetCDF: HDF error")

            patch.setattr(netCDF4, "Dataset", refuse)
        with pytest.raises(
            OutputError, match=r"(No space|NetCDF: HDF error).*finished blocks are kept in .*same command"
        ):
            compute_atlas(job)
    assert not job.path.exists()
    assert digest(compute_atlas(make(robot, job.path))) == whole
    assert {entry.name for entry in job.path.parent.iterdir()} == {"atlas.nc"}


_RUN = """
import sys
from pathlib import Path
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps import atlas
atlas._BLOCK_POSES = 20
robot = Robot.load("hexapod")
grid = robot.grid(x=(-0.01, 0.01, 9), y=(-0.01, 0.01, 9))
job = atlas.Atlas(robot, grid, ("felt_stiffness", "condition_number"), Path(sys.argv[1]))
if "slow" in sys.argv:
    import time
    compute = atlas._compute_block
    atlas._compute_block = lambda *a: (time.sleep(0.1), compute(*a))[1]
try:
    atlas.compute_atlas(job, threads=1)
except atlas.OutputError as error:
    print(error, file=sys.stderr)
    sys.exit(1)
"""


def test_two_at_once_and_then_killed(robot: Robot, tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = tmp_path / "atlas.zarr"
    first = subprocess.Popen([sys.executable, "-c", _RUN, str(path), "slow"])
    records = path.with_name("atlas.zarr.parts") / "finished"
    while len([*records.glob("*")]) < 2:
        assert first.poll() is None
        time.sleep(0.01)
    with pytest.raises(OutputError, match=rf"another run, pid {first.pid} on .*, since 2.*, is computing it; wait"):
        compute_atlas(make(robot, path))
    first.send_signal(signal.SIGKILL)
    first.wait()
    compute_atlas(make(robot, path))
    assert f"left by a run that was killed, pid {first.pid}" in caplog.text
    assert digest(path) == digest(compute_atlas(make(robot, tmp_path / "whole" / "atlas.zarr")))
    assert {entry.name for entry in tmp_path.iterdir()} == {"atlas.zarr", "whole"}


@pytest.mark.filterwarnings("ignore:os.fork")  # of JAX, in a process that has imported it before
def test_a_real_limit_on_the_size_of_files(robot: Robot, tmp_path: Path) -> None:
    """A disk quota: the NetCDF library cannot continue, and the command ends with one line."""
    path = tmp_path / "atlas.nc"

    def limited() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000))

    done = subprocess.run(
        [sys.executable, "-B", "-c", _RUN, str(path)],  # neither compiled modules nor their coverage are to be written
        preexec_fn=limited,
        env={name: value for name, value in os.environ.items() if not name.startswith("COV")},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    (line,) = done.stderr.splitlines()
    assert "finished blocks are kept in" in line
    assert not path.exists()
    compute_atlas(make(robot, path))
    assert digest(path) == digest(compute_atlas(make(robot, tmp_path / "whole" / "atlas.nc")))


def test_a_cluster_that_dies_is_one_line(robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    distributed = pytest.importorskip("distributed")

    class Cluster:
        def __init__(self, *_: object, **__: object) -> None: ...
        def scatter(self, *_: object, **__: object) -> None: ...
        def submit(self, *_: object, **__: object) -> None: ...
        def scheduler_info(self) -> dict[str, object]:
            return {"workers": {}}

        def close(self, **_: object) -> None:
            raise TimeoutError

    def lost(_: object) -> None:
        raise distributed.client.FutureCancelledError("_compute_block-1", "scheduler-connection-lost")

    monkeypatch.setattr(distributed, "Client", Cluster)
    monkeypatch.setattr(distributed, "as_completed", lost)
    with pytest.raises(OutputError, match=r"dask cluster failed \(FutureCancelledError: "):
        compute_atlas(make(robot, tmp_path / "atlas.zarr"), scheduler="tcp://127.0.0.1:9")
    assert issubclass(OutputError, PM3DofError)


def damaged(folder: Path, generator: np.random.Generator) -> str:
    """Flip one bit of an atlas, or cut one of its files short; return what was done."""
    files = sorted(file for file in [folder, *folder.rglob("*")] if file.is_file() and file.stat().st_size)
    # every kind of file as often: axes and metadata are small
    file = files[generator.integers(len(files))]
    data = bytearray(file.read_bytes())
    where = int(generator.integers(len(data)))
    if generator.random() < 0.2:
        file.write_bytes(data[:where])
        return f"{file} cut to {where} of {len(data)} bytes"
    data[where] ^= 1 << int(generator.integers(8))
    file.write_bytes(data)
    return f"{file}: a bit of byte {where} of {len(data)}"


@pytest.mark.parametrize(("suffix", "seed"), [(".zarr", 1), (".nc", 2)])
def test_random_damage_to_a_finished_atlas_is_reported(robot: Robot, tmp_path: Path, suffix: str, seed: int) -> None:
    whole = compute_atlas(make(robot, tmp_path / f"atlas{suffix}"))
    with open_atlas(whole) as dataset:
        values = dataset.load()
    generator, copy = np.random.default_rng(seed), tmp_path / f"copy{suffix}"
    for _ in range(150):
        if suffix == ".zarr":
            shutil.rmtree(copy, ignore_errors=True)
            shutil.copytree(whole, copy)
        else:
            shutil.copy(whole, copy)
        print(damaged(copy, generator))
        with pytest.raises(DescriptionError, match="damage"):
            open_atlas(copy).close()
    with open_atlas(whole, verify=False) as dataset:
        assert dataset.load().identical(values)


def test_what_is_gone_or_not_ours_is_reported(robot: Robot, tmp_path: Path) -> None:
    path = compute_atlas(make(robot, tmp_path / "atlas.zarr"))
    a_chunk(path).unlink()  # without it, a reader of Zarr sees NaN
    with pytest.raises(DescriptionError, match="damaged"):
        open_atlas(path)
    (tmp_path / "empty.nc").write_bytes(b"")
    with pytest.raises(DescriptionError, match="verify=False"):
        open_atlas(tmp_path / "empty.nc")
    with pytest.raises(DescriptionError, match="expected an atlas"):
        open_atlas(tmp_path / "missing.zarr")


def test_a_failed_atlas_leaves_nothing_and_blocks_nothing(
    robot: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Neither a quantity that raises nor an interruption before the first block hinders another atlas."""
    for error, expected in (
        (PM3DofError("no such springs"), PM3DofError),
        (KeyboardInterrupt(), KeyboardInterrupt),
        (OSError(errno.EIO, "broken"), OutputError),
    ):
        with monkeypatch.context() as patch:
            patch.setattr(atlas_module, "_compute_block", lambda *_, error=error: (_ for _ in ()).throw(error))
            with pytest.raises(expected):
                compute_atlas(make(robot, tmp_path / "atlas.nc"))
        assert not [*tmp_path.iterdir()]
