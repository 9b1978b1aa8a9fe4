"""Cost of a map of any robot: closing loops, limits and compliance over a grid, random poses, first and second use.

One thread unless stated otherwise. Ratios are taken in one run: relative to Pinocchio's Jacobians in C++ if a compiler
is available, and to the same work done pose by pose on Pinocchio. Maps are long runs: unlike those of the other
benchmarks, their ratios mean little on a busy machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from cpp_pinocchio import jacobians_microseconds
from timing import least_time

from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import COMPLIANCE
from pm3dof_pin.elastic.traced import elastic_program
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Matrix

MACHINES = Path(__file__).parents[2] / "tests" / "machines"
ROBOTS = {
    "pm3dof": "pm3dof",
    "hexapod": "hexapod",
    "three_rps": "three_rps",
    "delta": str(MACHINES / "delta" / "delta.urdf"),
    "five_bar": str(MACHINES / "five_bar" / "five_bar.urdf"),
}
SIDE = 500  # poses along each axis of a map
ROUNDS = 5
FEW = 50
IN_CACHE = 512  # poses whose numbers stay in a processor's cache

USE = """
import sys, time
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.robot import Robot
robot = Robot.load(sys.argv[1])
model = ElasticModel(robot)
robot.home
start = time.perf_counter()
compliance(model, robot.solve(robot.home_coordinates))
print(time.perf_counter() - start)
"""


def map_of(robot: Robot) -> Grid:
    """Return a grid over the first two coordinates, well within the limits."""
    values = reachable_poses(robot, 200, np.random.default_rng(0)).coordinates
    middle, reach = np.median(values, axis=0), 0.25 * np.ptp(values, axis=0)
    names = [coordinate.name for coordinate in robot.coordinates]
    ranges = {names[k]: (middle[k] - reach[k], middle[k] + reach[k], SIDE) for k in (0, 1)}
    return robot.grid(**ranges, **{name: float(middle[k]) for k, name in enumerate(names) if k > 1})


def gains_of_two_threads(model: ElasticModel, poses: Poses) -> dict[str, float]:
    """Return how many times faster two threads compute compliances than one: the program, and the machine's ceiling.

    The ceiling is the speed of two threads that share nothing, with numbers that stay in their caches. A map of full
    matrices goes to new memory at every call, which the kernel zeroes at memory speed.
    """
    tool = model.mechanism.model.frames[model.mechanism.tool_frame_id].name
    program = elastic_program(model, tool, "compliance", COMPLIANCE.traced, closed=True)
    q = np.ascontiguousarray(poses.q.reshape(-1, poses.q.shape[-1]))
    out = np.zeros((len(q), len(program.compiled.program.results)))

    def alone(room: Matrix) -> None:
        for _ in range(len(q) // len(room)):
            program.compiled(q[: len(room)], program.parameters, out=room, threads=1)

    def run(threads: int) -> float:
        return least_time(lambda: program.compiled(q, program.parameters, out=out, threads=threads), 4 * ROUNDS)

    with ThreadPoolExecutor(2) as pool:
        rooms = np.array_split(out[: 2 * IN_CACHE], 2)
        ceiling = least_time(lambda: alone(rooms[0])) / least_time(lambda: list(pool.map(alone, rooms)))
    new = [least_time(lambda n=n: compliance(model, poses, on_failure="nan", threads=n)) for n in (1, 2)]  # type: ignore[misc]
    return {"program": run(1) / run(2), "into new memory": new[0] / new[1], "ceiling of the machine": 2.0 * ceiling}


def uses(path: str) -> tuple[float, float]:
    """Return the time of first and second use of a robot's programs, each in a process of its own [s]."""
    with tempfile.TemporaryDirectory() as folder:
        environment = os.environ | {"PM3DOF_CACHE_DIR": folder}
        command = [sys.executable, "-c", USE, path]
        runs = [subprocess.run(command, env=environment, capture_output=True, text=True, check=True) for _ in range(2)]
    first, second = (float(run.stdout) for run in runs)
    return first, second


def main() -> dict[str, float]:
    ratios: dict[str, float] = {}
    for name, path in ROBOTS.items():
        robot = Robot.load(path)
        model = ElasticModel(robot)
        grid = map_of(robot)
        poses = robot.solve(grid, on_failure="nan")
        closing = least_time(
            lambda robot=robot, grid=grid: robot.solve(grid, on_failure="nan", threads=1).within_limits
        )
        elastic = least_time(lambda m=model, p=poses: compliance(m, p, on_failure="nan", threads=1))
        gains = gains_of_two_threads(model, poses)
        each = 1e6 / grid.size
        sample = reachable_poses(robot, FEW, np.random.default_rng(1))
        careful = least_time(lambda r=robot, s=sample: r.solve(s.coordinates, engine="pinocchio"), 2) * 1e6 / FEW
        draw = least_time(lambda r=robot: reachable_poses(r, 5000, np.random.default_rng(2)), 2) * 1e6 / 5000
        first, second = uses(path)
        cpp = jacobians_microseconds(sample)
        print(f"{name}: {robot.model.nv} joint velocities, first use {first:.2f} s, second use {second:.3f} s")
        print(
            f"  closing and limits over a map {closing * each:6.3f} us/pose, {careful / (closing * each):.0f} times "
            "faster than on Pinocchio, pose by pose from home"
        )
        print(f"  compliance                    {elastic * each:6.3f} us/pose")
        print(f"  two threads against one       {', '.join(f'{what} {gain:.2f}' for what, gain in gains.items())}")
        print(f"  both, one thread              {1.0 / ((closing + elastic) * each):6.2f} million poses a second")
        print(f"  random pose within limits     {draw:6.2f} us")
        ratios[f"{name}: closing against Pinocchio"] = careful / (closing * each)
        ratios |= {f"{name}: two threads against one, {what}": gain for what, gain in gains.items()}
        if isinstance(cpp, str):
            print(f"  C++ Pinocchio: {cpp}")
        else:
            ratios[f"{name}: compliance against Jacobians in C++"] = cpp / (elastic * each)
            print(
                f"  C++ Pinocchio, Jacobians only {cpp:6.3f} us, {cpp / (elastic * each):.0f} times the compliance here"
            )

    return ratios


if __name__ == "__main__":
    main()
