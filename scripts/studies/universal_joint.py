"""The passive leg's universal joint on the platform or at the base: a table on the terminal and a picture."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.export.description import temporary_description
from pm3dof_pin.figures.style import FORMATS, save_pictures
from pm3dof_pin.figures.universal_joint import universal_joint_figure
from pm3dof_pin.maps.quantities import MappedRobot
from pm3dof_pin.maps.workspace_evaluation import evaluate_workspace

RESULTS = Path(__file__).resolve().parents[2] / "results"
POINTS = 31


def main(out: Path = RESULTS, points: int = POINTS) -> None:
    robots = {
        "universal joint on the platform": pm.load("pm3dof"),
        "universal joint at the base": pm.load(temporary_description("pm3dof", "universal_joint_at_base")),
    }
    print(*save_pictures(universal_joint_figure(robots, 0.487333), out / "universal_joint", FORMATS), sep="\n")
    print(f"\n{'mean over the workspace':32}" + "".join(f"{axis:>12}" for axis in ("x", "y", "z", "rx", "ry", "rz")))
    for words, robot in robots.items():
        grid = robot.grid(**{c.name: (*robot.range_of(c), points) for c in robot.coordinates})
        found = evaluate_workspace(MappedRobot(robot), grid, ("felt_stiffness",))
        print(f"{words:32}" + "".join(f"{entry.mean:12.3e}" for entry in found.distributions))
        poses = robot.solve(grid, on_failure="nan")
        away = np.linalg.norm(poses.positions[poses.within_limits, :2], axis=-1).max()
        print(f"  {found.reachable:.1%} of the ranges reachable; tool point up to {1e3 * away:.1f} mm off the vertical")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--points", type=int, default=POINTS, help="number of values of each coordinate")
    main(**vars(parser.parse_args()))
