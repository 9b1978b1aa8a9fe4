"""A printer's scale error after a calibration from bed heights, with and without two distances.

Simulated deltas with errors of rods and towers touch the bed at nineteen points, and print marks that are measured with
a caliper: the figures at the end of the page on bed heights.

    python scripts/studies/bed_heights.py [--machines 60] [--probe 1e-5] [--caliper 2e-5]
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.joint_columns import command_columns, start_columns

TOWERS = [f"carriage{tower}_joint.t{axis}" for tower in (1, 2, 3) for axis in "xyz"]
RODS = [f"rod{tower}_{side}_tip.tz" for tower in (1, 2, 3) for side in ("left", "right")]
ROD_ERROR, TOWER_SIGMA = 1e-3, 3e-4  # at most, evenly; standard deviation [m]
PRIOR = 10.0  # tolerances: hardly any prior knowledge
RINGS = ((0.0, 1), (0.05, 6), (0.1, 12))
MARKS = np.array([[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, -0.1, 0.0], [0.0, 0.1, 0.0]])


def bed() -> np.ndarray:
    """Return the touched points, shape=(19, 3) [m]."""
    angles = [(radius, 2.0 * np.pi * k / count) for radius, count in RINGS for k in range(count)]
    return np.array([[radius * np.cos(angle), radius * np.sin(angle), 0.0] for radius, angle in angles])


def scale_error(machine: Robot, model: Robot) -> float:
    """Return the worse scale error along x and y of what a machine prints using a model of it."""
    printed = machine.forward(model.solve(MARKS).commands).positions
    lengths = np.linalg.norm(printed[1::2] - printed[::2], axis=1)
    return float(np.abs(lengths / np.linalg.norm(MARKS[1::2] - MARKS[::2], axis=1) - 1.0).max())


def measured(
    path: Path, robot: Robot, machine: Robot, rng: np.random.Generator, probe: float, caliper: float, distances: bool
) -> pm.Measurements:
    """Write what the owner measures, and read it."""
    touched = robot.solve(bed()).commands
    heights = machine.forward(touched).positions[:, 2] + rng.normal(0.0, probe, len(touched))
    rows: list[list[object]] = [[*u, z, probe, *[""] * 5] for u, z in zip(touched.tolist(), heights, strict=True)]
    if distances:
        marks = robot.solve(MARKS).commands
        printed = machine.forward(marks).positions
        for k in (0, 2):
            length = np.linalg.norm(printed[k + 1] - printed[k]) + rng.normal(0.0, caliper)
            rows.append([*marks[k + 1].tolist(), "", "", length, caliper, *marks[k].tolist()])
    header = [*command_columns(robot), "z_m", "sigma_z_m", "distance_m", "sigma_distance_m", *start_columns(robot)]
    write_text_atomically(path, csv_text([header, *rows]))
    return pm.read_measurements(path, robot)


def main(machines: int = 60, probe: float = 1e-5, caliper: float = 2e-5) -> dict[str, float]:
    """Calibrate machines and print the worst scale errors; return them."""
    errors = GeometricErrors.load("linear_delta").select([*TOWERS, *RODS])
    robot = errors.robot
    worst = dict.fromkeys(("uncalibrated", "heights", "heights and two distances"), 0.0)
    with tempfile.TemporaryDirectory() as folder:
        for seed in range(machines):
            rng = np.random.default_rng(seed)
            rods = np.repeat(rng.uniform(-ROD_ERROR, ROD_ERROR, 3), 2)
            true = errors.values(dict(zip(TOWERS, rng.normal(0.0, TOWER_SIGMA, 9), strict=True)))
            true = true + errors.values(dict(zip(RODS, rods, strict=True)))
            machine = errors.apply(true)
            worst["uncalibrated"] = max(worst["uncalibrated"], scale_error(machine, robot))
            for name in list(worst)[1:]:
                path = Path(folder) / "printer.csv"
                seen = measured(path, robot, machine, rng, probe, caliper, distances="distances" in name)
                found = identify(seen, errors, prior=PRIOR, loss="squares")
                worst[name] = max(worst[name], scale_error(machine, errors.apply(found.values)))
    print(f"worst error of scale over {machines} machines, probe {1e6 * probe:g} µm, caliper {1e6 * caliper:g} µm")
    for name, value in worst.items():
        print(f"  {name:27}{100.0 * value:8.3f} %")
    return worst


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--machines", type=int, default=60)
    parser.add_argument("--probe", type=float, default=1e-5, help="noise of a height [m]")
    parser.add_argument("--caliper", type=float, default=2e-5, help="noise of a distance [m]")
    main(**vars(parser.parse_args()))
