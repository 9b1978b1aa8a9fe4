"""Plan, measure and calibrate the robots of small_robots.py.

None has an error file. Each is planned with the defaults. 200 random machines with errors of three tolerances are
assembled at the poses of the plan, and one within its tolerances is measured there and calibrated.

    python scripts/studies/plan_small_robots.py [names] [--machines 200] [--candidates 2000]
"""

from __future__ import annotations

import argparse
import logging
import tempfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation
from small_robots import robots

import pm3dof_pin as pm
from pm3dof_pin.calibration.measurement_plan import plan_measurements
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import PM3DofError

NOISE, TURN = 7.5e-6, 7.07e-5


def one(path: Path, machines: int, candidates: int) -> str:
    """Plan, measure and calibrate one robot, and return what came of it."""
    everything, generator = pm.GeometricErrors.load(path), np.random.default_rng(5)
    errors = closable(everything)
    poses = plan_measurements(errors, candidates=candidates).poses
    assembled = 0
    for _ in range(machines):
        crooked = errors.apply(3.0 * errors.sample(generator))
        assembled += bool(crooked.forward(poses.commands, guess=poses.q, on_failure="nan").solved.all())
    machine = errors.apply(errors.sample(generator))
    seen = np.array(machine.forward(poses.commands, guess=poses.q).transforms)
    seen[:, :3, 3] += NOISE * generator.standard_normal((len(seen), 3))
    turns = Rotation.from_rotvec(TURN * generator.standard_normal((len(seen), 3))).as_matrix()
    seen[:, :3, :3] = turns @ seen[:, :3, :3]
    found = pm.calibrate(pm.Measurements.from_poses(poses.commands, seen), everything, "lm")
    wanted = pm.reachable_poses(errors.robot, 60, generator)
    answer, left = found.compensate(wanted, on_failure="nan"), []
    reached = np.isfinite(answer.error_bound)
    for commands in (wanted.commands, answer.commands):
        there = machine.forward(commands[reached], guess=wanted.q[reached], on_failure="nan")
        left.append(tip_error(pose_difference(wanted.transforms[reached], there.transforms)))
    sizes = [1e6 * float(np.sqrt(np.nanmean(each**2))) for each in left]
    within = 100.0 * float(np.mean(left[1] <= answer.error_bound[reached]))
    return (
        f"{len(errors)} parameters, {len(poses)} poses, {assembled} of {machines} machines assembled, "
        f"{sizes[0]:.0f} to {sizes[1]:.0f} µm, {within:.0f} % within"
    )


def main() -> None:
    """Print a line for each robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*")
    parser.add_argument("--machines", type=int, default=200)
    parser.add_argument("--candidates", type=int, default=2000)
    given = parser.parse_args()
    logging.disable(logging.CRITICAL)
    with tempfile.TemporaryDirectory() as folder:
        paths = robots(Path(folder))
        for name in given.names or paths:
            try:
                print(f"{name}: {one(paths[name], given.machines, given.candidates)}", flush=True)
            except PM3DofError as error:
                print(f"{name}: refused: {error}", flush=True)


if __name__ == "__main__":
    main()
