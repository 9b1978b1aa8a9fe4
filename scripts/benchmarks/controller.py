"""Exported C: time of a call that follows a motion, compiled by gcc -O2; and a million round trips at random poses.

python scripts/benchmarks/controller.py [--robots pm3dof hexapod] [--poses 1000000]

Processor time. The motion is a circle about home, with a radius of a fifth of the characteristic length or 0.1 rad, at
100 mm/s or 0.5 rad/s and 1 kHz: every call starts where the last one ended. Random poses are within limits; each is
reached from the one before, far away, commands from the pose and the pose from them. The longest calls, inverse and
forward, are those of 20,000 from home to numbers up to twice as far as the ranges reach, most of them out of reach.
"""

from __future__ import annotations

import argparse
import ctypes
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.export.controllers import export_controller
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges

SPEED = {"m": 1e-4, "rad": 5e-4}  # a call
DRIVER = """
#include <math.h>
#include <time.h>
#include "NAME.h"
static NAME_state state;
static double seconds(void)
{
  struct timespec t;
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
  return t.tv_sec + 1e-9 * t.tv_nsec;
}
/* Return the time of one call. */
double follow(int forward, const double *given, int n, double *answers)
{
  const int m = forward ? UPPER_COMMANDS : UPPER_COORDINATES, k = UPPER_COMMANDS + UPPER_COORDINATES - m;
  double start = 0.0;
  int i, failed = 0;
  for (i = -n; i < n; i++) { /* the first round warms up */
    const int j = i < 0 ? i + n : i;
    if (i == 0)
      start = seconds();
    failed += forward ? NAME_forward(&NAME_nominal, &state, given + j * m, answers + j * k)
                      : NAME_inverse(&NAME_nominal, &state, given + j * m, answers + j * k);
  }
  return failed ? -1.0 : (seconds() - start) / n;
}
/* The longest call of n from home, in or out of reach: of each the shortest of three runs. */
double longest(int forward, const double *given, int n, double *answers)
{
  const int m = forward ? UPPER_COMMANDS : UPPER_COORDINATES;
  double worst = 0.0;
  int i, run;
  for (i = 0; i < n; i++) {
    double least = 1.0;
    for (run = 0; run < 3; run++) {
      double start;
      NAME_start(&NAME_nominal, &state);
      start = seconds();
      if (forward)
        NAME_forward(&NAME_nominal, &state, given + i * m, answers);
      else
        NAME_inverse(&NAME_nominal, &state, given + i * m, answers);
      start = seconds() - start;
      least = start < least ? start : least;
    }
    worst = least > worst ? least : worst;
  }
  return worst;
}
/* The worst difference of coordinates after a round trip; poses that failed are counted. */
double round_trips(const double *poses, int n, int *failed)
{
  double commands[UPPER_COMMANDS], back[UPPER_COORDINATES], worst = 0.0;
  int i, k;
  *failed = 0;
  for (i = 0; i < n; i++) {
    const double *const pose = poses + i * UPPER_COORDINATES;
    NAME_state other = state;
    if (NAME_inverse(&NAME_nominal, &state, pose, commands) || NAME_forward(&NAME_nominal, &other, commands, back)) {
      ++*failed;
      continue;
    }
    for (k = 0; k < UPPER_COORDINATES; k++)
      if (!(fabs(back[k] - pose[k]) <= worst)) worst = fabs(back[k] - pose[k]);
  }
  return worst;
}
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", nargs="*", default=["pm3dof", "hexapod", "three_rps", "linear_delta"])
    parser.add_argument("--poses", type=int, default=1_000_000, help="random poses for round trips")
    arguments = parser.parse_args()
    print(f"{'robot':14} {'inverse us':>10} {'forward us':>10} {'longest us':>12} {'round trips':>12} {'m, rad':>9}")
    for name in arguments.robots:
        robot = pm.load(name)
        library = compiled(robot)
        circle = motion(robot)
        inverse, commands = followed(library, False, circle, len(robot.commands))
        forward, back = followed(library, True, commands, circle.shape[1])
        assert np.abs(back - circle).max() < 1e-9
        generator = np.random.default_rng(0)
        longest = [
            longest_call(library, k == 1, far(robot, each, generator))
            for k, each in enumerate((robot.coordinates, robot.command_coordinates))
        ]
        poses = pm.reachable_poses(robot, arguments.poses, np.random.default_rng(0)).coordinates
        failed = ctypes.c_int()
        library.round_trips.restype = ctypes.c_double
        worst = library.round_trips(pointer(poses), len(poses), ctypes.byref(failed))
        done = f"{len(poses) - failed.value}"
        print(f"{name:14} {inverse:10.2f} {forward:10.2f} {longest[0]:5.0f}, {longest[1]:5.0f} {done:>12} {worst:9.1e}")


def far(robot: pm.Robot, coordinates: Sequence[Coordinate], generator: np.random.Generator) -> np.ndarray:
    """Return numbers up to twice as far from home as their ranges reach."""
    lower, upper = coordinate_ranges(robot, coordinates)
    middle, half = 0.5 * (lower + upper), upper - lower
    return generator.uniform(middle - half, middle + half, (20_000, len(coordinates)))


def longest_call(library: ctypes.CDLL, forward: bool, given: np.ndarray) -> float:
    """Return the time of the longest call [us]."""
    library.longest.restype = ctypes.c_double
    answers = np.empty(given.shape[1] + 64)
    return 1e6 * library.longest(forward, pointer(given), len(given), pointer(answers))


def motion(robot: pm.Robot) -> np.ndarray:
    """Return poses along a circle."""
    kinds = [c.unit for c in robot.coordinates[:2]]
    width = [0.2 * robot.characteristic_length if unit == "m" else 0.1 for unit in kinds]
    count = int(2.0 * np.pi * max(radius / SPEED[unit] for radius, unit in zip(width, kinds, strict=True)))
    angle = np.linspace(0.0, 2.0 * np.pi, count, endpoint=False)
    circle = np.tile(robot.home_coordinates, (count, 1))
    circle[:, :2] += np.column_stack([width[0] * np.cos(angle), width[1] * np.sin(angle)])
    return circle


def compiled(robot: pm.Robot) -> ctypes.CDLL:
    """Return the exported C with the loops of this benchmark."""
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "controller.so"
        source = export_controller(robot, "c", folder)[1]
        driver = Path(folder) / "driver.c"
        driver.write_text(DRIVER.replace("NAME", source.stem).replace("UPPER", source.stem.upper()), encoding="utf-8")
        subprocess.run(["gcc", "-O2", "-shared", "-fPIC", source, driver, "-o", library, "-lm"], check=True)
        return ctypes.CDLL(str(library))


def pointer(array: np.ndarray) -> ctypes.c_void_p:
    return ctypes.c_void_p(array.ctypes.data)


def followed(library: ctypes.CDLL, forward: bool, given: np.ndarray, width: int) -> tuple[float, np.ndarray]:
    """Return the time of a call [us], the least of ten runs, and the answers."""
    library.follow.restype = ctypes.c_double
    answers = np.empty((len(given), width))
    times = [library.follow(forward, pointer(given), len(given), pointer(answers)) for _ in range(10)]
    if min(times) < 0.0:
        raise RuntimeError("a pose was not reached")
    return 1e6 * min(times), answers


if __name__ == "__main__":
    main()
