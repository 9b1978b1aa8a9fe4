"""Does a calibration from few poses gain by fewer parameters? All of them within tolerances, against presets.

    python scripts/studies/few_poses.py [--machines 12] [--robots NAME ...]

Machines are off by the tolerances of their error files, and measured at a few random poses. Each is calibrated with all
parameters, held by their tolerances as `pm3dof calibrate` does, and with smaller sets by plain least squares, as
textbooks do. The error is that of the true machine at 100 other poses with the corrected commands, over that with the
uncorrected ones, both beyond what the best commands leave: the median over the machines, and how many got worse.
"""

from __future__ import annotations

import argparse
import logging
import tempfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.description.error_file import error_file_text
from pm3dof_pin.errors.command_correction import nearest_poses
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.presets import preset
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.measuring.instrument import Instrument

POSES = (3, 5, 7, 10, 20, 40)
SETS = ("zeros-only", "firmware-delta-6", "firmware-delta-7", "complete")


def errors_of(robot: pm.Robot, name: str) -> pm.GeometricErrors | None:
    """Return the errors of a preset, None if the robot is not of its kind."""
    try:
        entries, ties = preset(robot, name)
    except PM3DofError:
        return None
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "errors.yaml"
        file.write_text(error_file_text(entries, comment="", command_zeros={}, ties=ties), encoding="utf-8")
        return closable(pm.GeometricErrors.from_file(robot, file))


def left(crooked: pm.Robot, commands: np.ndarray, wanted: pm.Poses) -> float:
    """Return the tip error of a machine at commands for desired poses, root mean square [m]."""
    reached = crooked.forward(commands, guess=wanted.q)
    return float(np.sqrt(np.mean(tip_error(pose_difference(wanted.transforms, reached.transforms)) ** 2)))


def ratios(
    errors: pm.GeometricErrors, sets: dict[str, pm.GeometricErrors], measured: str, count: int, seed: int
) -> dict[str, float]:
    """Return the error after a calibration over that before it, of one machine, by set of parameters."""
    generator = np.random.default_rng(seed)
    crooked = errors.apply(errors.sample(generator))
    poses, others = (pm.reachable_poses(errors.robot, n, generator) for n in (count, 100))
    transforms = crooked.forward(poses.commands, guess=poses.q).transforms
    seen = pm.Measurements.from_poses(poses.commands, transforms, Instrument(measured)).with_noise(generator)
    best = nearest_poses(crooked.forward(others.commands, guess=others.q), others.transforms)
    floor, found = left(crooked, best.commands, others), {}

    def excess(commands: np.ndarray) -> float:
        return float(np.sqrt(max(left(crooked, commands, others) ** 2 - floor**2, 0.0)))

    before = excess(others.commands)
    compensation = fit(seen, errors, Options("lm"), quiet=True).compensation
    found["all, within tolerances"] = excess(compensation.corrected(others)) / before
    for name, own in sets.items():
        try:
            model = own.apply(identify(seen, own, prior=np.inf, loss="squares").values)
            nearest = nearest_poses(model.forward(others.commands, guess=others.q), others.transforms)
            found[name] = excess(nearest.commands) / before
        except (PM3DofError, np.linalg.LinAlgError):
            found[name] = np.inf
    return found


def table(robots: list[str], machines: int) -> Iterator[str]:
    """Yield the lines of the table."""
    for robot in robots:
        errors = pm.GeometricErrors.load(robot)
        sets = {name: own for name in SETS if (own := errors_of(errors.robot, name)) is not None}
        for measured in ("pose", "position"):
            for count in POSES:
                found = [ratios(errors, sets, measured, count, seed) for seed in range(machines)]
                cells = []
                for name in found[0]:
                    own = np.array([each[name] for each in found])
                    cells.append(f"{name} {np.median(own):.3g} ({np.sum(own > 1.0)})")
                yield f"{robot}, {count} {measured}s: {'; '.join(cells)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=12)
    parser.add_argument("--robots", nargs="+", default=["linear_delta", "hexapod", "three_rps"])
    arguments = parser.parse_args()
    logging.disable(logging.WARNING)
    for line in table(arguments.robots, arguments.machines):
        print(line, flush=True)


if __name__ == "__main__":
    main()
