"""Closed-loop poses, sensitivities and the D-optimal choice of poses: seconds on this machine."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from pm3dof_pin.calibration.planning import PlanningProblem
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

CANDIDATES, CHOSEN = 2000, 20


def seconds(work: Callable[[], object]) -> float:
    start = time.perf_counter()
    work()
    return time.perf_counter() - start


def main() -> None:
    errors = GeometricErrors.load("pm3dof")
    generator = np.random.default_rng(0)
    start = time.perf_counter()
    candidates = reachable_poses(errors.robot, CANDIDATES, generator)
    print(f"{CANDIDATES} random poses within all limits: {time.perf_counter() - start:.2f} s")
    machine = errors.apply(errors.sample(generator))
    each = seconds(lambda: machine.forward(candidates.commands, guess=candidates.q)) / CANDIDATES
    print(f"one pose of a machine with errors, loops closed to rounding: {1e6 * each:.0f} us")
    each = seconds(lambda: sensitivities(errors, candidates)) / CANDIDATES
    print(f"sensitivity of one pose to {len(errors)} parameters: {1e6 * each:.0f} us")
    problem = PlanningProblem(errors, candidates)
    for strategy in ("d-optimal", "tip-optimal"):
        taken = seconds(lambda s=strategy: problem.plan(CHOSEN, s, np.random.default_rng(0)))  # type: ignore[misc]
        print(f"{strategy} choice of {CHOSEN} out of {CANDIDATES}, ten starts: {taken:.2f} s")


if __name__ == "__main__":
    main()
