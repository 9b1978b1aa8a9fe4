"""Predicted accuracy of plans by strategy: a printed table, and the picture of the documentation.

Predicted tip error of the tripod after a calibration, with four targets of 15 µm noise: the mean over ten sets of
2,000 candidates, and over ten seeds for the random strategies. Some minutes on one processor; smaller with --sets.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from pm3dof_pin.calibration.planning import PlanningProblem, Strategy
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.figures.plan_accuracy import plan_accuracy
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.kinematics.reachable_poses import reachable_poses

RESULTS = Path(__file__).resolve().parents[2] / "results"
STRATEGIES: tuple[Strategy, ...] = ("d-optimal", "tip-optimal", "random", "least-sensitive")
PRIORS = (1.0, 3.0, 1e4)  # the last one makes no use of the tolerances
COUNTS = (9, 20)
DRAWN = (3, 6, 9, 12, 20, 40, 60)


def main(out: Path = RESULTS, sets: int = 10, candidates: int = 2000) -> None:
    errors = GeometricErrors.load("pm3dof")
    tests = reachable_poses(errors.robot, 300, np.random.default_rng(1000))
    pools = [reachable_poses(errors.robot, candidates, np.random.default_rng(seed)) for seed in range(sets)]
    print("| poses | prior $k$ | D-optimal | tip-optimal | random | least sensitive region | random / D-optimal |")
    print("|---|---|---|---|---|---|---|")
    for count in COUNTS:
        for prior in PRIORS:
            problems = [PlanningProblem(errors, pool, tests, prior=prior) for pool in pools]
            means = [np.mean([_curve(p, [count], s, seeds=10).mean() for p in problems]) for s in STRATEGIES]
            cells = [f"{count}", "none" if prior > 100 else f"{prior:g}", *(f"{1e6 * mean:.1f}" for mean in means)]
            print("| " + " | ".join([*cells, f"{means[2] / means[0]:.1f}"]) + " |")
    problem = PlanningProblem(errors, pools[0], tests)
    curves = {strategy: _curve(problem, DRAWN, strategy, seeds=10) for strategy in STRATEGIES}
    print(f"wrote {save_figure(plan_accuracy(DRAWN, curves), out / 'plan_accuracy.png')}")


def _curve(problem: PlanningProblem, counts: tuple[int, ...] | list[int], strategy: Strategy, seeds: int) -> np.ndarray:
    return problem.accuracy_curve(counts, strategy, [0] if "optimal" in strategy else range(seeds))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--sets", type=int, default=10, help="sets of candidates")
    parser.add_argument("--candidates", type=int, default=2000, help="poses in a set")
    main(**vars(parser.parse_args()))
