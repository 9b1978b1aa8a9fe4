"""Atlases on disk: time and peak memory a pose, of every robot here, and for the tripod by number of poses."""

from __future__ import annotations

import argparse
import resource
import shutil
import tempfile
import time
from pathlib import Path

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


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--threads", type=int, help="threads; the number of processors by default")
    parser.add_argument("--most", type=int, default=COUNTS[-1], help="greatest number of values along an axis")
    parser.add_argument("--format", choices=("nc", "zarr"), default="nc")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=".") as name:
        path = Path(name) / f"atlas.{arguments.format}"
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
