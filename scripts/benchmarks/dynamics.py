"""Holding forces, inertia and natural frequencies of many poses, compared with Pinocchio and LAPACK pose by pose.

Processor time of one thread, the least of several runs, taken in turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial

import numpy as np
from timing import least_time

from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices, natural_frequencies
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.typing import Array

ROBOTS = ("pm3dof", "hexapod", "three_rps")
POSES, FEW = 20000, 20


def main() -> dict[str, float]:
    ratios: dict[str, float] = {}
    for name in ROBOTS:
        model = ElasticModel.load(name)
        few = reachable_poses(model.rigid, FEW, np.random.default_rng(0)).q
        many = np.tile(few, (POSES // FEW, 1))
        quantities: dict[str, Callable[..., Array]] = {
            "holding forces": partial(actuator_forces, model.rigid),
            "mass matrix of the drives": partial(drive_mass_matrices, model.rigid),
            "six natural frequencies": partial(natural_frequencies, model, count=6),
        }
        for what, compute in quantities.items():
            start = time.thread_time()
            compute(many, threads=1)
            first = time.thread_time() - start
            each = least_time(partial(compute, many, threads=1), clock=time.thread_time) / POSES
            careful = least_time(partial(compute, few, engine="pinocchio"), clock=time.thread_time) / FEW
            ratios[f"{name}: {what} against Pinocchio"] = careful / each
            print(
                f"{name}: {what:26} {1e6 * each:7.2f} us/pose, pose by pose {1e6 * careful:6.0f} us, "
                f"{careful / each:5.0f} times; first use {first:.2f} s"
            )
    return ratios


if __name__ == "__main__":
    main()
