"""The atlas: right numbers in the right places, the same bytes however it was computed, nothing half-written."""

from __future__ import annotations

import hashlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.limits import Limit, limit_violations
from pm3dof_pin.exceptions import InvalidValueError, OutputError, PM3DofError
from pm3dof_pin.maps import atlas as atlas_module
from pm3dof_pin.maps.atlas import Atlas, AtlasGrid, compute_atlas, open_atlas
from pm3dof_pin.maps.grid import RectangularGrid
from pm3dof_pin.maps.quantities import QUANTITIES


def make(tripod: Tripod, path: Path, shape: tuple[int, int, int] = (13, 11, 7), *quantities: str) -> Atlas:
    return Atlas(tripod, AtlasGrid.over_workspace(tripod, shape), quantities or ("K", "condition_number"), path)


def digest(path: Path) -> dict[str, str]:
    """Hash of a file, or of every file of a folder by its name."""
    files = [path] if path.is_file() else sorted(entry for entry in path.rglob("*") if entry.is_file())
    return {str(file.relative_to(path.parent)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atlas_module, "_BLOCK_POSES", 40)


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.usefixtures("small_blocks")
def test_values_limits_and_labels(tripod: Tripod, tmp_path: Path, suffix: str) -> None:
    path = compute_atlas(make(tripod, tmp_path / f"atlas{suffix}"))
    with open_atlas(path) as dataset:
        dataset.load()
        assert dataset["K"].dims == ("z_e", "theta_x", "theta_y", "axis", "axis_2")
        assert list(dataset["axis"].values) == ["x", "y", "z", "rx", "ry", "rz"]
        assert dataset["K"].attrs["units"] == "N/m, N, N m/rad"
        seen = Limit.NONE
        for point in np.ndindex(7, 13, 11):
            z_e, theta_x, theta_y = (float(dataset[dim][i]) for dim, i in zip(dataset["K"].dims, point, strict=False))
            flags = Limit(int(dataset["broken_limits"].values[point]))
            matrix = dataset["K"].values[point]
            seen |= flags
            if flags:
                assert np.all(np.isnan(matrix))
            else:
                np.testing.assert_array_equal(matrix, elastic_stiffness(tripod, [theta_x, theta_y, z_e]))
            if not flags & Limit.REACH:
                assert bool(flags) == bool(limit_violations(tripod, [theta_x, theta_y, z_e]))
        assert Limit.STROKE in seen
        assert Limit.SPHERICAL in seen


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.usefixtures("small_blocks")
def test_interrupted_and_resumed_is_the_same_to_the_byte(
    tripod: Tripod, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = compute_atlas(make(tripod, tmp_path / "whole" / f"atlas{suffix}"))
    job = make(tripod, tmp_path / "broken" / f"atlas{suffix}")
    compute, calls = atlas_module.compute_block, []

    def fail_at_the_fourth(atlas: Atlas, block: tuple[int, int]) -> tuple[int, int]:
        calls.append(block)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return compute(atlas, block)

    monkeypatch.setattr(atlas_module, "compute_block", fail_at_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        compute_atlas(job, workers=1)
    assert not job.path.exists()
    monkeypatch.setattr(atlas_module, "compute_block", compute)
    done: list[int] = []
    resumed = compute_atlas(job, workers=2, progress=lambda poses, total: done.append(poses))
    assert len(done) < len(job.grid.blocks())  # finished blocks were not computed again
    assert done[-1] == 13 * 11 * 7
    assert digest(resumed) == digest(whole)
    assert not job.parts.exists()


def test_killed_process_leaves_nothing_torn(tripod: Tripod, tmp_path: Path) -> None:
    """SIGKILL in the middle of a real run, at several moments; then the same command again."""
    arguments = ["--no-pictures", "--points", "45", "45", "41", "-q", "K", "--out"]
    command = [sys.executable, "-c", "from pm3dof_pin.cli.app import main; main()", "atlas", *arguments]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    subprocess.run([*command, str(tmp_path / "whole.zarr")], check=True, env=environment, capture_output=True)
    target = tmp_path / "killed.zarr"
    for blocks in (0, 1):
        process = subprocess.Popen([*command, str(target)], env=environment, stdout=subprocess.DEVNULL)
        parts = target.with_name("killed.zarr.parts") / "broken_limits" / "c"
        while process.poll() is None and len(list(parts.rglob("*/0"))) <= blocks:
            time.sleep(0.001)
        process.send_signal(signal.SIGKILL)
        process.wait()
    subprocess.run([*command, str(target)], check=True, env=environment, capture_output=True)
    assert list(digest(target).values()) == list(digest(tmp_path / "whole.zarr").values())


def test_blocks_of_another_size_give_the_same_file(
    tripod: Tripod, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes = []
    for size in (7, 100, 100_000):
        monkeypatch.setattr(atlas_module, "_BLOCK_POSES", size)
        job = make(tripod, tmp_path / str(size) / "atlas.nc")
        shapes.append(job.grid.block_shape)
        compute_atlas(job)
    assert len(set(shapes)) == 3
    assert len({tuple(digest(tmp_path / str(size) / "atlas.nc").values()) for size in (7, 100, 100_000)}) == 1


def test_a_dask_cluster_gives_the_same_bytes(tripod: Tripod, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    shape = (45, 45, 101)  # three blocks and a rest
    alone = compute_atlas(make(tripod, tmp_path / "alone" / "atlas.nc", shape, "felt_stiffness"))
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1", worker_dashboard_address=None
    ) as cluster:
        job = make(tripod, tmp_path / "together" / "atlas.nc", shape, "felt_stiffness")
        together = compute_atlas(job, scheduler=cluster.scheduler_address)
    assert digest(together) == digest(alone)


def test_no_scheduler_there(tripod: Tripod, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(atlas_module, "_SCHEDULER_PATIENCE", "0.5s")
    with pytest.raises(PM3DofError, match=r"no dask scheduler answers at tcp://127\.0\.0\.1:9"):
        compute_atlas(make(tripod, tmp_path / "atlas.nc"), scheduler="tcp://127.0.0.1:9")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("small_blocks")
def test_an_unfinished_atlas_of_other_settings_is_not_mixed_in(
    tripod: Tripod, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(atlas: Atlas, block: tuple[int, int]) -> tuple[int, int]:
        raise KeyboardInterrupt

    compute = atlas_module.compute_block
    monkeypatch.setattr(atlas_module, "compute_block", fail)
    with pytest.raises(KeyboardInterrupt):
        compute_atlas(make(tripod, tmp_path / "atlas.nc"))
    monkeypatch.setattr(atlas_module, "compute_block", compute)
    with pytest.raises(OutputError, match="unfinished atlas of other settings"):
        compute_atlas(make(tripod, tmp_path / "atlas.nc", (13, 11, 8)))


def test_full_disk(tripod: Tripod, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(atlas: Atlas, block: tuple[int, int]) -> tuple[int, int]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atlas_module, "compute_block", full)
    with pytest.raises(OutputError, match=r"No space left on device; finished blocks are kept in .*\.parts"):
        compute_atlas(make(tripod, tmp_path / "atlas.nc"))
    assert not (tmp_path / "atlas.nc").exists()


def test_an_older_atlas_gives_way_and_nothing_else_does(tripod: Tripod, tmp_path: Path) -> None:
    (tmp_path / "folder.nc").mkdir()
    (tmp_path / "file.zarr").write_text("kept")
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr" / "data").write_text("kept")
    before = digest(tmp_path)
    for name in ("folder.nc", "file.zarr", "other.zarr"):
        with pytest.raises(OutputError, match=rf"{name}: .* is there, expected nothing or"):
            compute_atlas(make(tripod, tmp_path / name))
    assert digest(tmp_path) == before
    for name in ("atlas.nc", "atlas.zarr"):
        for shape in ((5, 5, 5), (3, 4, 5)):
            path = compute_atlas(make(tripod, tmp_path / name, shape))
        with open_atlas(path) as dataset:
            assert dataset.sizes["theta_y"] == 4


@pytest.mark.parametrize(("suffix", "gigabytes"), [(".nc", "578"), (".zarr", "289")])
def test_no_room_on_the_disk(tripod: Tripod, tmp_path: Path, suffix: str, gigabytes: str) -> None:
    """10^9 poses of 36 numbers and one byte; refused before anything is written, and not one block is listed."""
    job = make(tripod, tmp_path / f"atlas{suffix}", (1000, 1000, 1000), "K")
    with pytest.raises(OutputError, match=rf"it takes {gigabytes} GB of disk to make, .* GB are free"):
        compute_atlas(job)
    assert list(tmp_path.iterdir()) == []


def test_unwritable_folder(tripod: Tripod, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        compute_atlas(make(tripod, tmp_path / "file" / "atlas.nc"))


@pytest.mark.parametrize("name", sorted(QUANTITIES))
def test_every_quantity_can_be_mapped(tripod: Tripod, tmp_path: Path, name: str) -> None:
    path = compute_atlas(make(tripod, tmp_path / "atlas.nc", (5, 5, 3), name))
    with open_atlas(path) as dataset:
        values = dataset[name].transpose("z_e", "theta_x", "theta_y", ...).values
        inside = dataset["broken_limits"].values == 0
        assert np.all(np.isfinite(values[inside]))
        assert np.all(np.isnan(values[~inside]))


def test_nonsense_is_refused(tripod: Tripod, tmp_path: Path) -> None:
    grid = AtlasGrid.over_workspace(tripod, (3, 3, 3))
    with pytest.raises(InvalidValueError, match="quantities = colour"):
        Atlas(tripod, grid, ("K", "colour"), tmp_path / "atlas.nc")
    with pytest.raises(InvalidValueError, match=r"ending in \.nc or \.zarr"):
        Atlas(tripod, grid, ("K",), tmp_path / "atlas.csv")
    with pytest.raises(InvalidValueError, match="height_range"):
        AtlasGrid(RectangularGrid(), (0.5, 0.4), 3)
    with pytest.raises(InvalidValueError, match="height_count"):
        AtlasGrid(RectangularGrid(), (0.4, 0.5), 1)
