"""Table 8.4 with numbers: the tool error by each class of error over the whole workspace, printed and as CSV."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

import pm3dof_pin as pm
from pm3dof_pin.cli.output import table_lines
from pm3dof_pin.errors.error_budget import budget_as_data, error_budget
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.files import csv_text, write_text_atomically

RESULTS = Path(__file__).resolve().parents[1] / "results"
COLUMNS = ("tip_rms_m", "greatest_tip_rms_m", "left_m", "energy_m")


def main(out: Path = RESULTS, poses: int = 200) -> None:
    errors = pm.GeometricErrors.load("pm3dof")
    places = pm.reachable_poses(errors.robot, poses, np.random.default_rng(0))
    lines = budget_as_data(error_budget(ErrorSources(errors), places).lines())
    rows = [
        [line["error_class"], line["long_name"], *(f"{1e6 * line[name]:.2f}" for name in COLUMNS)] for line in lines
    ]
    header = ["class", "source [um]", "tip, rms", "worst pose", "left by commands", "E of (8.15)"]
    print("\n".join(table_lines(header, rows)))
    cells = [list(lines[0]), *(row.values() for row in lines)]
    print(f"wrote {write_text_atomically(out / 'table_8_4.csv', csv_text(cells))}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--poses", type=int, default=200, help="number of poses of the workspace")
    main(**vars(parser.parse_args()))
