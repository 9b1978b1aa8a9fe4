"""The walk as C99, for a controller: inverse kinematics, and forward kinematics from the pose before.

Wall-clock time of one call, the least of several runs; compiled by gcc -O2. Targets lie on a circle, a hundred of them,
with a radius of a fifth of the characteristic length, or 0.1 rad; every walk starts where the last one ended.
"""

from __future__ import annotations

import ctypes
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.kinematics.closing_programs import program_source
from pm3dof_pin.programs.c import c99
from pm3dof_pin.programs.closing import Task

ROUNDS, POSES = 30, 100
MANY = """
int many(const double *targets, int n, int m, const double *p, double *q)
{
  int k, failed = 0;
  for (k = 0; k < n; k++)
    failed += walk(q, targets + k * m, p, 1000, q) != 0;
  return failed;
}
"""


def main() -> None:
    print(f"{'robot':14} {'inverse us':>10} {'forward us':>10} {'C lines':>8} {'code kB':>8}")
    for name in ("pm3dof", "hexapod", "three_rps", "linear_delta"):
        robot = pm.load(name)
        angle = np.linspace(0.0, 2.0 * np.pi, POSES, endpoint=False)
        width = [0.2 * robot.characteristic_length if c.unit == "m" else 0.1 for c in robot.coordinates[:2]]
        circle = np.tile(robot.home_coordinates, (POSES, 1))
        circle[:, :2] += np.column_stack([width[0] * np.cos(angle), width[1] * np.sin(angle)])
        poses = robot.solve(circle)
        row: list[float] = []
        for coordinates, values in ((robot.coordinates, circle), (robot.command_coordinates, poses.commands)):
            walk, parameters = program_source(robot).printable_walk(robot, Task.from_coordinates(coordinates))
            numbers = (values - [c.offset for c in coordinates]) / [c.scale for c in coordinates]
            order = sorted(range(len(coordinates)), key=lambda k: coordinates[k].joint is None)
            source = c99(walk.renamed("walk"), summary=f"Closes the loops of {name}.")
            microseconds, size = timed(source, poses.q, numbers[:, order], parameters)
            row += [microseconds, source.count("\n"), size / 1000.0]
        print(f"{name:14} {row[0]:10.2f} {row[3]:10.2f} {row[1] + row[4]:8.0f} {row[2] + row[5]:8.0f}")


def timed(source: str, q: np.ndarray, targets: np.ndarray, parameters: np.ndarray) -> tuple[float, int]:
    """Return the time of a call [us], and the size of the library [bytes]."""
    with tempfile.TemporaryDirectory() as folder:
        path, library = Path(folder) / "walk.c", Path(folder) / "walk.so"
        path.write_text(source + MANY, encoding="utf-8")
        subprocess.run(["gcc", "-std=c99", "-O2", "-shared", "-fPIC", path, "-o", library, "-lm"], check=True)
        many = ctypes.CDLL(str(library)).many
        size = library.stat().st_size
    current, targets = q[-1].copy(), np.ascontiguousarray(targets)
    pointers = [ctypes.c_void_p(array.ctypes.data) for array in (targets, parameters, current)]
    best = np.inf
    for _ in range(ROUNDS):
        start = time.perf_counter()
        failed = many(pointers[0], len(targets), targets.shape[1], *pointers[1:])
        best = min(best, time.perf_counter() - start)
        if failed:
            raise RuntimeError(f"{failed} poses not reached")
    return 1e6 * best / len(targets), size


if __name__ == "__main__":
    main()
