"""One identification of all parameters from 60 poses, calibrations by each method, commands for many poses: seconds."""

from __future__ import annotations

import os
import time

os.environ["OPENBLAS_NUM_THREADS"] = "1"

import numpy as np

from pm3dof_pin.calibration.calibrate import METHODS, Options, calibrate
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.simulation.worlds import WORLDS, World

POSES, BATCH = 60, 20_000


def main() -> None:
    errors = GeometricErrors.load("pm3dof")
    generator = np.random.default_rng(0)
    commands = reachable_poses(errors.robot, POSES, generator).commands
    for name in WORLDS:
        measurements = World.random(name, errors, generator).measure(commands, generator)
        start = time.perf_counter()
        found = identify(measurements, errors)
        taken = time.perf_counter() - start
        print(f"world '{name}': {len(errors)} parameters from {POSES} poses in {taken:.2f} s, {found.steps} steps")
        for method in METHODS:
            start = time.perf_counter()
            calibrate(measurements, errors, Options(method))
            print(f"  calibration by {method}: {time.perf_counter() - start:.2f} s")
    wanted = reachable_poses(errors.robot, BATCH, generator)
    start = time.perf_counter()
    calibrate(measurements, errors, Options("lm+gp")).compensation.compensate(wanted)
    print(f"commands for {BATCH} poses, the calibration included: {time.perf_counter() - start:.2f} s")


if __name__ == "__main__":
    main()
