"""The atlas: right numbers in the right places, identical bytes however it is computed, no partial files."""

from __future__ import annotations

import dataclasses
import hashlib
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.chapter.limits import Limit, limit_flags
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import InvalidValueError, OutputError, PM3DofError, UnreachablePoseError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps import atlas as atlas_module
from pm3dof_pin.maps.atlas import Atlas, compute_atlas, open_atlas
from pm3dof_pin.maps.quantities import QUANTITIES


def tilt_grid(robot: Robot, shape: tuple[int, int, int]) -> Grid:
    """Heights of the level platform, tilts of +-45 deg; shape: numbers of theta_x, theta_y and z_e."""
    heights, tilt = robot.range_of(robot.coordinate("z_e")), np.radians(45.0)
    nx, ny, nz = shape
    return robot.grid(z_e=(*heights, nz), theta_x=(-tilt, tilt, nx), theta_y=(-tilt, tilt, ny))


def make(robot: Robot, path: Path, shape: tuple[int, int, int] = (13, 11, 7), *quantities: str) -> Atlas:
    return Atlas(robot, tilt_grid(robot, shape), quantities or ("K", "condition_number"), path)


def digest(path: Path) -> dict[str, str]:
    """Hash of a file, or of every file of a folder by its name."""
    files = [path] if path.is_file() else sorted(entry for entry in path.rglob("*") if entry.is_file())
    return {str(file.relative_to(path.parent)): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}


@pytest.fixture
def small_blocks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atlas_module, "_BLOCK_POSES", 40)


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.usefixtures("small_blocks")
def test_values_limits_and_labels(slender: Robot, tripod: Tripod, tmp_path: Path, suffix: str) -> None:
    path = compute_atlas(make(slender, tmp_path / f"atlas{suffix}", (7, 7, 5)))
    with open_atlas(path) as dataset:
        dataset.load()
        assert dataset["K"].dims == ("z_e", "theta_x", "theta_y", "axis", "axis_2")
        assert list(dataset["axis"].values) == ["x", "y", "z", "rx", "ry", "rz"]
        assert dataset["K"].attrs["units"] == "N/m, N, N m/rad"
        seen = Limit.NONE
        for point in np.ndindex(5, 7, 7):
            z_e, theta_x, theta_y = (float(dataset[dim][i]) for dim, i in zip(dataset["K"].dims, point, strict=False))
            flags = Limit(int(dataset["broken_limits"].values[point]))
            matrix = dataset["K"].values[point]
            seen |= flags
            if flags:
                assert np.all(np.isnan(matrix))
            else:
                expected = elastic_stiffness(tripod, [theta_x, theta_y, z_e])
                scale = np.sqrt(np.diag(expected))
                np.testing.assert_allclose(
                    matrix / scale / scale[:, None], expected / scale / scale[:, None], atol=1e-10
                )
            if not flags & Limit.REACH:
                assert bool(flags) == bool(limit_flags(tripod, [theta_x, theta_y, z_e]))
        assert Limit.STROKE in seen
        assert Limit.SPHERICAL in seen


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
@pytest.mark.usefixtures("small_blocks")
def test_interrupted_and_resumed_is_the_same_to_the_byte(
    mechanism: Robot, tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = compute_atlas(make(mechanism, tmp_path / "whole" / f"atlas{suffix}", (7, 6, 5)))
    job = make(mechanism, tmp_path / "broken" / f"atlas{suffix}", (7, 6, 5))
    compute, calls = atlas_module._compute_block, []

    def fail_at_the_fourth(atlas: Atlas, block: tuple[int, int]) -> tuple[int, int]:
        calls.append(block)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return compute(atlas, block)

    monkeypatch.setattr(atlas_module, "_compute_block", fail_at_the_fourth)
    with pytest.raises(KeyboardInterrupt):
        compute_atlas(job, threads=1)
    assert not job.path.exists()
    monkeypatch.setattr(atlas_module, "_compute_block", compute)
    done: list[int] = []
    resumed = compute_atlas(job, threads=2, progress=lambda poses, total: done.append(poses))
    assert len(done) < len(list(job.blocks()))  # finished blocks were not recomputed
    assert done[-1] == 7 * 6 * 5
    assert digest(resumed) == digest(whole)
    assert not job.parts.exists()


def test_killed_process_leaves_nothing_torn(run: Callable[..., Any], tmp_path: Path) -> None:
    """SIGKILL in the middle of a real run; then the same command again."""
    arguments = ["--no-pictures", "--points", "45", "45", "41", "-q", "K", "--out"]
    command = [sys.executable, "-c", "from pm3dof_pin.cli.app import main; main()", "atlas", *arguments]
    environment = {**os.environ, "PYTHONDONTWRITEBYTECODE": "1"}
    assert run("atlas", *arguments, str(tmp_path / "whole.zarr")).returncode == 0
    target = tmp_path / "killed.zarr"
    process = subprocess.Popen([*command, str(target)], env=environment, stdout=subprocess.DEVNULL)
    parts = target.with_name("killed.zarr.parts") / "broken_limits"
    while process.poll() is None and not list(parts.glob("c.*")):
        time.sleep(0.001)
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert run("atlas", *arguments, str(target)).returncode == 0
    assert list(digest(target).values()) == list(digest(tmp_path / "whole.zarr").values())


def test_threads_change_no_byte(mechanism: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(atlas_module, "_BLOCK_POSES", 50)
    for threads in (1, 3):
        compute_atlas(make(mechanism, tmp_path / str(threads) / "atlas.nc", (9, 7, 5)), threads=threads)
    assert digest(tmp_path / "1" / "atlas.nc") == digest(tmp_path / "3" / "atlas.nc")


def test_blocks_of_another_size_give_the_same_numbers(
    mechanism: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    shapes, values = [], []
    for size in (7, 30, 100_000):
        monkeypatch.setattr(atlas_module, "_BLOCK_POSES", size)
        job = make(mechanism, tmp_path / str(size) / "atlas.nc", (5, 4, 5))
        shapes.append(job.block_shape)
        with open_atlas(compute_atlas(job)) as dataset:
            values.append(dataset.load())
    assert len(set(shapes)) == 3
    for other in values[1:]:
        np.testing.assert_array_equal(other.broken_limits, values[0].broken_limits)
        np.testing.assert_allclose(other.condition_number, values[0].condition_number, rtol=1e-6)


def test_a_dask_cluster_gives_the_same_bytes(mechanism: Robot, tmp_path: Path) -> None:
    distributed = pytest.importorskip("distributed")
    shape = (45, 45, 101)  # three blocks and a remainder
    alone = compute_atlas(make(mechanism, tmp_path / "alone" / "atlas.nc", shape, "felt_stiffness"))
    with distributed.LocalCluster(
        n_workers=1,
        threads_per_worker=2,
        dashboard_address="127.0.0.1:0",
        host="127.0.0.1",
        worker_dashboard_address=None,
    ) as cluster:
        job = make(mechanism, tmp_path / "together" / "atlas.nc", shape, "felt_stiffness")
        together = compute_atlas(job, scheduler=cluster.scheduler_address)
    assert digest(together) == digest(alone)


def test_no_scheduler_there(mechanism: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("distributed")
    monkeypatch.setattr(atlas_module, "_SCHEDULER_PATIENCE", "0.5s")
    with pytest.raises(PM3DofError, match=r"no dask scheduler answers at tcp://127\.0\.0\.1:9"):
        compute_atlas(make(mechanism, tmp_path / "atlas.nc"), scheduler="tcp://127.0.0.1:9")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.usefixtures("small_blocks")
def test_an_unfinished_atlas_of_other_settings_is_not_mixed_in(
    mechanism: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    compute, calls = atlas_module._compute_block, []

    def fail(atlas: Atlas, block: tuple[int, int]) -> tuple[int, int]:
        calls.append(block)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return compute(atlas, block)

    monkeypatch.setattr(atlas_module, "_compute_block", fail)
    with pytest.raises(KeyboardInterrupt):
        compute_atlas(make(mechanism, tmp_path / "atlas.nc"))
    monkeypatch.setattr(atlas_module, "_compute_block", compute)
    with pytest.raises(OutputError, match="unfinished atlas with other settings"):
        compute_atlas(make(mechanism, tmp_path / "atlas.nc", (13, 11, 8)))


def test_full_disk(mechanism: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(atlas: Atlas, block: tuple[int, int]) -> tuple[int, int]:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(atlas_module, "_compute_block", full)
    with pytest.raises(OutputError, match=r"No space left on device$"):
        compute_atlas(make(mechanism, tmp_path / "atlas.nc"))
    assert not [*tmp_path.iterdir()]


def test_an_older_atlas_gives_way_and_nothing_else_does(mechanism: Robot, tmp_path: Path) -> None:
    (tmp_path / "folder.nc").mkdir()
    (tmp_path / "file.zarr").write_text("kept")
    (tmp_path / "other.zarr").mkdir()
    (tmp_path / "other.zarr" / "data").write_text("kept")
    before = digest(tmp_path)
    for name in ("folder.nc", "file.zarr", "other.zarr"):
        with pytest.raises(OutputError, match=rf"{name}: the path is .*: expected nothing or"):
            compute_atlas(make(mechanism, tmp_path / name))
    assert digest(tmp_path) == before
    for name in ("atlas.nc", "atlas.zarr"):
        for shape in ((5, 5, 5), (3, 4, 5)):
            path = compute_atlas(make(mechanism, tmp_path / name, shape))
        with open_atlas(path) as dataset:
            assert dataset.sizes["theta_y"] == 4


@pytest.mark.parametrize(("suffix", "gigabytes"), [(".nc", "578"), (".zarr", "289")])
def test_no_room_on_the_disk(mechanism: Robot, tmp_path: Path, suffix: str, gigabytes: str) -> None:
    """10^9 poses of 36 numbers and one byte; refused before anything is written or any block listed."""
    job = make(mechanism, tmp_path / f"atlas{suffix}", (1000, 1000, 1000), "K")
    with pytest.raises(OutputError, match=rf"it needs up to {gigabytes} GB of disk space, .* GB are free"):
        compute_atlas(job)
    assert list(tmp_path.iterdir()) == []


def test_unwritable_folder(mechanism: Robot, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        compute_atlas(make(mechanism, tmp_path / "file" / "atlas.nc"))


@pytest.mark.parametrize("name", sorted(QUANTITIES))
def test_every_quantity_can_be_mapped(mechanism: Robot, tmp_path: Path, name: str) -> None:
    path = compute_atlas(make(mechanism, tmp_path / "atlas.nc", (5, 5, 3), name))
    with open_atlas(path) as dataset:
        assert dataset[name].dims[:3] == ("z_e", "theta_x", "theta_y")
        values = dataset[name].values
        inside = dataset["broken_limits"].values == 0
        assert not np.any(np.isnan(values[inside]))  # a direction without freedom bears any force
        assert np.all(np.isnan(values[~inside]))


def test_nonsense_is_refused(mechanism: Robot, tmp_path: Path) -> None:
    grid = tilt_grid(mechanism, (3, 3, 3))
    with pytest.raises(InvalidValueError, match="quantities = colour"):
        Atlas(mechanism, grid, ("K", "colour"), tmp_path / "atlas.nc")
    with pytest.raises(InvalidValueError, match=r"ending in \.nc or \.zarr"):
        Atlas(mechanism, grid, ("K",), tmp_path / "atlas.csv")
    with pytest.raises(InvalidValueError, match="grid is one pose"):
        Atlas(mechanism, mechanism.grid(), ("K",), tmp_path / "atlas.nc")
    hexapod = Robot.load("hexapod")
    with pytest.raises(InvalidValueError, match="hexapod has no chapter_global"):
        Atlas(hexapod, hexapod.grid(x=(0.0, 0.01, 2)), ("chapter_global",), tmp_path / "atlas.nc")


def test_an_atlas_without_a_pose_inside_is_not_written(mechanism: Robot, tmp_path: Path) -> None:
    grid = mechanism.grid(z_e=(0.8, 0.9, 3), theta_x=(0.0, 0.1, 2))
    with pytest.raises(UnreachablePoseError, match="no pose of the atlas over z_e, theta_x is within every limit"):
        compute_atlas(Atlas(mechanism, grid, ("K",), tmp_path / "atlas.nc"))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("name", ["hexapod", "three_rps"])
def test_any_robot_over_its_coordinates(name: str, tmp_path: Path) -> None:
    """Each number against the robot at that pose alone; more limits than eight bits hold."""
    robot = Robot.load(name)
    chosen = robot.coordinates[:4]
    grid = robot.grid(**{c.name: (*robot.range_of(c), count) for c, count in zip(chosen, (4, 3, 3, 3), strict=False)})
    job = Atlas(robot, grid, ("stiffness", "felt_stiffness", "commands"), tmp_path / "atlas.zarr")
    with open_atlas(compute_atlas(job)) as dataset:
        dataset.load()
    assert dataset["stiffness"].dims == (*grid.dims, "axis", "axis_2")
    assert dataset["stiffness"].dtype == np.float64
    assert dataset["felt_stiffness"].dtype == np.float32
    assert dataset["broken_limits"].dtype == np.uint16
    assert set(dataset["broken_limits"].attrs["flag_meanings"].split()) == {
        "reach",
        *(group.name for group in robot.limit_groups),
    }
    model = ElasticModel(robot)
    inside = dataset["broken_limits"].values == 0
    assert inside.any()
    assert not inside.all()
    assert np.isnan(dataset["commands"].values[~inside]).all()
    for index in np.argwhere(inside)[:5]:
        pose = robot.solve(grid.values[tuple(index)], engine="pinocchio")
        expected = cartesian_compliance(model, pose.configuration()).stiffness
        scale = np.sqrt(np.diag(expected))
        found = dataset["stiffness"].values[tuple(index)]
        assert np.abs((found - expected) / scale / scale[:, None]).max() < 1e-9
        np.testing.assert_allclose(dataset["commands"].values[tuple(index)], pose.commands, rtol=1e-6, atol=1e-7)


def test_precision(mechanism: Robot, tmp_path: Path) -> None:
    values = []
    for precision in ("single", "double"):
        job = Atlas(mechanism, tilt_grid(mechanism, (3, 3, 3)), ("felt_stiffness",), tmp_path / f"{precision}.nc")
        with open_atlas(compute_atlas(dataclasses.replace(job, precision=precision))) as dataset:
            values.append(dataset["felt_stiffness"].values)
    assert [entry.dtype for entry in values] == [np.float32, np.float64]
    np.testing.assert_array_equal(values[0], values[1].astype(np.float32))
