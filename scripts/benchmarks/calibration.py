"""One identification of all parameters, calibrations by each method, commands for many poses: processor seconds.

python scripts/benchmarks/calibration.py [--robot pm3dof] [--poses 60 500 5000] [--methods lm lm+gp]
"""

from __future__ import annotations

import argparse
import os
import resource
import time
from functools import partial

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np
from timing import least_time

from pm3dof_pin.calibration.fit import METHODS, Options, fit
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.simulation.worlds import World

BATCH, FEW = 20_000, 100


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--robot", default="pm3dof")
    parser.add_argument("--poses", type=int, nargs="+", default=[60, 500])
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS)
    arguments = parser.parse_args()
    errors, generator = GeometricErrors.load(arguments.robot), np.random.default_rng(0)
    world = World.random("everything", errors, generator)
    for count in arguments.poses:
        measurements = world.measure(reachable_poses(errors.robot, count, generator).commands, generator)
        tries = 4 if count <= FEW else 2
        taken = least_time(partial(identify, measurements, errors), tries, time.process_time)
        print(f"{len(errors)} parameters from {count} poses: {taken:.3f} s", flush=True)
        for method in arguments.methods:
            options = Options(method)
            taken = least_time(partial(fit, measurements, errors, options), tries, time.process_time)
            most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0
            print(f"  calibration by {method}: {taken:.2f} s, up to {most:.0f} MB", flush=True)
    wanted, compensation = reachable_poses(errors.robot, BATCH, generator), fit(measurements, errors).compensation
    middle = {} if compensation.learned is None else compensation.learned.inputs.middle()
    taken = least_time(partial(compensation.compensate, wanted, middle), 2, time.process_time)
    print(f"commands for {BATCH} poses: {taken:.2f} s")


if __name__ == "__main__":
    main()
