"""Coverage of stated bounds with identified backlash and drift, on machines written without the package.

The machines are those of machines_apart.py, without further effects: errors of geometry of the size of the tolerances,
backlash of 10 to 30 µm in every drive, and drives that creep by 10 µm over the session. 40 poses are measured, with
directions of approach, and with times if the machine drifts; 2,000 others tell the truth, arrived at from either side,
with commands that know nothing of it and with commands that are given the sides.

    python scripts/studies/hysteresis_coverage.py [--machines 10] [--robots tripod delta hexapod arm]
"""

from __future__ import annotations

import argparse
import logging
from dataclasses import replace

import numpy as np
from calibration_coverage import described, drawn, tip
from machines_apart import Machine
from scipy.spatial.transform import Rotation

import pm3dof_pin as pm
from pm3dof_pin.exceptions import PM3DofError

POSES, TESTS = 40, 2000
NOISE, TURN = 7.5e-6, 7.07e-5


def sloppy(robot: str, seed: int, drift: float) -> tuple[Machine, np.random.Generator]:
    """Draw a machine with backlash, and with drift of its drives over the session [m]."""
    generator = np.random.default_rng([seed, len(robot)])
    machine = drawn(robot, generator, 1.0, 0.0)
    units = np.array([1.0 if command.unit == "m" else 5.0 for command in described(robot).robot.commands])
    sizes = generator.uniform(10e-6, 30e-6, len(units)) * generator.choice([-1.0, 1.0], len(units))
    creep = drift * generator.standard_normal(len(units))
    machine.effects = replace(machine.effects, backlash=sizes * units, drift=creep * units)
    return machine, generator


def one(robot: str, seed: int, drift: float) -> list[tuple[float, float, float, bool]]:
    """Return actual and predicted rms [m], part within the bounds, and if the interval holds: sides unknown, given."""
    machine, generator = sloppy(robot, seed, drift)
    errors = described(robot)
    commands = pm.reachable_poses(errors.robot, POSES, generator).commands
    sides, times = generator.choice([-1.0, 1.0], commands.shape), np.linspace(-0.5, 0.5, POSES)
    seen = machine.poses(commands, sides, times)
    seen[:, :3, 3] += NOISE * generator.standard_normal((POSES, 3))
    seen[:, :3, :3] = Rotation.from_rotvec(TURN * generator.standard_normal((POSES, 3))).as_matrix() @ seen[:, :3, :3]
    rows = replace(pm.Measurements.from_poses(commands, seen), approaches=sides)
    calibration = pm.calibrate(replace(rows, times=3600.0 * (times + 0.5)) if drift else rows, errors, "lm")
    wanted = pm.reachable_poses(errors.robot, TESTS, generator)
    arriving = generator.choice([-1.0, 1.0], wanted.commands.shape)
    when = generator.uniform(-0.5, 0.5, TESTS)
    given = {f"approach_u{k + 1}": side for k, side in enumerate(arriving.T)}
    if drift:
        given["time_s"] = 3600.0 * (when + 0.5)
    expected = calibration.expectation
    limit = expected.bound if "except for the worst poses" in expected.text else np.inf  # what is promised
    interval, answers = expected.interval or (np.nan, np.nan), []
    for conditions in (None, given):
        answer = calibration.compensate(wanted, conditions, on_failure="nan")
        told = answer.error_bound <= limit
        left = np.linalg.norm(
            tip(wanted.transforms[told], machine.poses(answer.commands[told], arriving[told], when[told])), axis=1
        )
        actual, predicted = (float(np.sqrt(np.mean(v**2))) for v in (left, answer.predicted_error[told]))
        holds = interval[0] <= actual <= interval[1]
        answers.append((actual, predicted, float(np.mean(left <= answer.error_bound[told])), holds))
    return answers


def main() -> None:
    """Print a line for each robot."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--machines", type=int, default=10)
    parser.add_argument("--robots", nargs="+", default=["tripod", "delta", "hexapod", "arm"])
    options = parser.parse_args()
    logging.disable(logging.CRITICAL)
    print("rms [µm]: actual and predicted; poses within their 95 % bounds; intervals of the rms that hold")
    for robot in options.robots:
        for drift in (0.0, 10e-6):
            found = []
            for seed in range(options.machines):
                try:
                    found.append(one(robot, seed, drift))
                except PM3DofError as error:
                    print(f"  {robot} {seed}: {error}")
            for k, words in enumerate(("sides unknown", "sides given")):
                rows = np.array([pair[k] for pair in found], dtype=float)
                actual, predicted = 1e6 * np.sqrt(np.mean(rows[:, :2] ** 2, axis=0))
                holds = f", {int(rows[:, 3].sum())} of {len(rows)} intervals" if k == 0 else ""
                what = "backlash and drift" if drift else "backlash"
                within = 100.0 * rows[:, 2].mean()
                print(f"{robot}, {what}, {words}: {actual:.1f}, {predicted:.1f}; {within:.1f} %{holds}", flush=True)


if __name__ == "__main__":
    main()
