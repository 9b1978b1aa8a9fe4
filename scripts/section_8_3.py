"""Section 8.3 in numbers: the error map, and the flow of Fig. 8.6 run on a simulated machine.

Error map over the section of Table 8.3, picture and CSV; then: plan, measure, calibrate, compensate, and the remaining
errors at poses that were not measured. --method nn is the chapter's proposal.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.calibration.fit import METHODS, Options
from pm3dof_pin.calibration.planning import STRATEGY_OF_METHOD
from pm3dof_pin.errors.error_map import section_grid
from pm3dof_pin.errors.pose_error import energy, pose_difference, tip_error
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import FORMATS, save_pictures
from pm3dof_pin.maps.datasets import write_csv
from pm3dof_pin.maps.grid_map import error_section, errors_over
from pm3dof_pin.maps.limit_space import limits_over
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.simulation.worlds import World

RESULTS = Path(__file__).resolve().parents[1] / "results"
TESTS = 60


def main(
    out: Path = RESULTS,
    method: str = "lm+gp",
    poses: int = 20,
    points: int = 41,
    seed: int = 1,
    formats: Sequence[str] = ("png",),
) -> None:
    errors = pm.GeometricErrors.load("pm3dof")
    grid = section_grid(errors.robot, points=points)
    assert grid is not None
    section, _ = error_section(errors, grid)
    broken = limits_over(errors.robot, grid.dims, grid.fixed)
    exact = errors_over(errors, grid, "tip_rms")
    figure = section_map(section, "tip_rms", within=lambda points: broken(points) == 0, exact=exact)
    print(*save_pictures(figure, out / "section_8_3_error_map", formats), sep="\n")
    print(write_csv(section, out / "section_8_3_error_map.csv"))

    generator = np.random.default_rng(seed)
    truth, instrument = World.random("everything", errors, generator), Instrument.with_targets()
    candidates, wanted = (pm.reachable_poses(errors.robot, count, generator) for count in (500, TESTS))
    problem = pm.PlanningProblem(errors, candidates, wanted, instrument=instrument)
    plan = problem.plan(poses, STRATEGY_OF_METHOD[method], generator, restarts=1)
    measurements = truth.measure(plan.poses.commands, generator, instrument)
    calibration = pm.calibrate(measurements, errors, Options(method, seed))
    conditions = truth.conditions(TESTS, generator)
    commands = {
        "as described": wanted.commands,
        "corrected": calibration.compensation.corrected(wanted, conditions),
    }
    print(f"\n{poses} poses measured, {plan.strategy}; {method}; {TESTS} others")
    print(f"{'':16}{'tip, mean [um]':>16}{'greatest [um]':>16}{'E, mean [um]':>16}")
    for words, given in commands.items():
        reached = truth.poses(given, conditions)
        left = pose_difference(wanted.transforms, reached)
        tip, cost = tip_error(left), energy(wanted.transforms, reached)
        print(f"{words:16}{1e6 * tip.mean():16.1f}{1e6 * tip.max():16.1f}{1e6 * cost.mean():16.1f}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--method", choices=METHODS, default="lm+gp", help="calibration method")
    parser.add_argument("--poses", type=int, default=20, help="number of poses measured")
    parser.add_argument("--points", type=int, default=41, help="points of the error map along each tilt")
    parser.add_argument("--seed", type=int, default=1, help="seed of the machine")
    parser.add_argument("--format", dest="formats", nargs="+", choices=FORMATS, default=["png"], help="picture formats")
    main(**vars(parser.parse_args()))
