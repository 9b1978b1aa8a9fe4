"""Closing the loops of many poses: programs on a grid and at random poses, and Pinocchio's Jacobians in Python.

Times are processor time of one thread, the least of several runs, taken in turn, limits and tool placements included.
Random poses are reached by continuation from home, one by one.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pm3dof_pin as pm

MACHINES = Path(__file__).parents[2] / "tests" / "machines"
ROBOTS = ("pm3dof", "hexapod", "three_rps", MACHINES / "delta" / "delta.urdf", MACHINES / "five_bar" / "five_bar.urdf")
POINTS = 41
RANDOM, CAREFUL = 10_000, 100
ROUNDS = 5


def timed(run: Callable[[], object]) -> float:
    """Return the processor time of a run [s]."""
    start = time.thread_time()
    run()
    return time.thread_time() - start


def main() -> None:
    print(f"{'robot':10} {'first solve s':>13} {'grid us':>8} {'random us':>9} {'pinocchio us':>12} {'ratio':>7}")
    for name in ROBOTS:
        robot = pm.load(name)
        home = robot.home_coordinates
        width = np.array([0.1 * robot.characteristic_length if c.unit == "m" else 0.2 for c in robot.coordinates])
        moved = list(zip(robot.coordinates, home, width, strict=True))[:3]
        grid = robot.grid(**{c.name: (middle - w, middle + w, POINTS) for c, middle, w in moved})
        random = np.random.default_rng(0).uniform(home - width, home + width, (RANDOM, len(home)))
        first = timed(lambda: robot.solve(home))  # noqa: B023
        runs = {
            "grid": (lambda: robot.solve(grid, threads=1).broken_limits, grid.size),  # noqa: B023
            "random": (lambda: robot.solve(random).broken_limits, RANDOM),  # noqa: B023
            "pinocchio": (lambda: robot.solve(random[:CAREFUL], engine="pinocchio").broken_limits, CAREFUL),  # noqa: B023
        }
        best = dict.fromkeys(runs, np.inf)
        for _ in range(ROUNDS):
            for key, (run, count) in runs.items():
                best[key] = min(best[key], 1e6 * timed(run) / count)
        print(
            f"{robot.name:10} {first:13.3f} {best['grid']:8.3f} {best['random']:9.2f} {best['pinocchio']:12.0f} "
            f"{best['pinocchio'] / best['grid']:7.0f}"
        )


if __name__ == "__main__":
    main()
