"""Table 8.3: published and computed numbers side by side, on the terminal and in results/table_8_3.csv."""

from __future__ import annotations

import argparse
from pathlib import Path

from pm3dof_pin.chapter.table_8_3 import table_8_3
from pm3dof_pin.cli.table import described
from pm3dof_pin.files import csv_text, write_text_atomically
from pm3dof_pin.kinematics.robot import load

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main(out: Path = RESULTS, engine: str = "program") -> None:
    rows = table_8_3(robot=load("pm3dof") if engine == "pinocchio" else None)
    data, lines = described(rows)
    print("\n".join(lines))
    cells = [list(data["rows"][0]), *(row.values() for row in data["rows"])]
    print(f"wrote {write_text_atomically(out / 'table_8_3.csv', csv_text(cells))}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--engine", choices=("program", "pinocchio"), default="program", help="computation engine")
    main(**vars(parser.parse_args()))
