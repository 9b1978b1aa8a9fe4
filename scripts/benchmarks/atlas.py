"""Atlases on disk: time and peak memory a pose, of every robot here, and for the tripod by number of poses.

    python scripts/benchmarks/atlas.py [--most 272] [--format nc]
    python scripts/benchmarks/atlas.py --workers 1 2 4 [--most 200]

With `--workers`: one atlas of the tripod by so many threads, and by as many workers of a dask cluster on this machine,
each a process with one thread. Blocks are what workers share; what remains is done once, by whoever asks: their checks
and the assembly of the finished file.
"""

from __future__ import annotations

import argparse
import resource
import shutil
import tempfile
import time
from pathlib import Path

import dask
from distributed import LocalCluster

from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.atlas import Atlas, compute_atlas

ROBOTS = ("pm3dof", "hexapod", "three_rps")
COUNTS = (60, 100, 200, 272)


def grid_of(robot: Robot, count: int) -> Grid:
    """Return a grid over the ranges of the first three coordinates; of the tripod height first."""
    chosen = robot.coordinates[:3]
    chosen = (chosen[2], *chosen[:2]) if chosen[0].unit == "rad" else chosen
    return robot.grid(**{coordinate.name: (*robot.range_of(coordinate), count) for coordinate in chosen})


def measure(robot: Robot, count: int, path: Path, threads: int | None) -> None:
    """Compute one atlas of the felt stiffness and print its cost."""
    shutil.rmtree(path, ignore_errors=True)
    start, cpu = time.perf_counter(), time.process_time()
    compute_atlas(Atlas(robot, grid_of(robot, count), ("felt_stiffness",), path), threads=threads)
    wall, used = time.perf_counter() - start, time.process_time() - cpu
    size = sum(file.stat().st_size for file in (path, *path.rglob("*")) if file.is_file())
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
    poses = count**3
    print(
        f"{robot.name:10s} {poses / 1e6:6.2f} million poses: {wall:6.1f} s, {1e6 * wall / poses:5.2f} us/pose "
        f"({1e6 * used / poses:5.2f} of processors), {size / poses:5.1f} bytes a pose, peak memory {peak:.0f} MiB"
    )


def compare_workers(robot: Robot, counts: list[int], count: int, path: Path) -> None:
    """Print the times of one atlas by threads and by workers, and of the part of it that is done once."""
    grid = grid_of(robot, count)
    job = Atlas(robot, grid, ("felt_stiffness",), path)

    def seconds(threads: int | None, scheduler: str | None) -> tuple[float, float]:
        shutil.rmtree(path, ignore_errors=True)
        path.unlink(missing_ok=True)
        moments = [time.perf_counter()]
        compute_atlas(
            job, threads=threads, scheduler=scheduler, progress=lambda done, of: moments.append(time.perf_counter())
        )
        return time.perf_counter() - moments[0], time.perf_counter() - moments[-1]

    seconds(None, None)  # compiles
    print(f"{robot.name}, {grid.size / 1e6:.1f} million poses, {sum(1 for _ in job.blocks())} blocks, {path.suffix}")
    # statistical profiles of workers take time, and Python 3.11 can hang in them (gh-106883)
    dask.config.set({"distributed.worker.profile.enabled": False})
    for workers in counts:
        by_threads, _ = min(seconds(workers, None) for _ in range(3))
        with LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster:
            seconds(None, cluster.scheduler_address)  # each worker imports and loads
            by_workers, once = min(seconds(None, cluster.scheduler_address) for _ in range(3))
        print(
            f"{workers} threads {by_threads:5.2f} s, {workers} workers {by_workers:5.2f} s, "
            f"{by_workers / by_threads:4.2f} times as long; of these {once:4.2f} s after the last block"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--workers", type=int, nargs="+", help="compare threads and workers of a cluster")
    parser.add_argument("--threads", type=int, help="threads; the number of processors by default")
    parser.add_argument("--most", type=int, default=COUNTS[-1], help="greatest number of values along an axis")
    parser.add_argument("--format", choices=("nc", "zarr"), default="nc")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=".") as name:
        path = Path(name) / f"atlas.{arguments.format}"
        if arguments.workers:
            compare_workers(Robot.load(ROBOTS[0]), arguments.workers, arguments.most, path)
            return
        for robot_name in ROBOTS:
            robot = Robot.load(robot_name)
            measure(robot, 20, path, arguments.threads)  # compiles
            measure(robot, 60, path, arguments.threads)
        robot = Robot.load(ROBOTS[0])
        for count in COUNTS:
            if count <= arguments.most:
                measure(robot, count, path, arguments.threads)


if __name__ == "__main__":
    main()
