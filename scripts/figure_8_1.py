"""Draw Fig. 8.1b: the machine in its home pose with the names of its points, frames, angles and lengths."""

from __future__ import annotations

import argparse
from pathlib import Path

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.figures.schematic import schematic_figure
from pm3dof_pin.figures.style import save_figure

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main(out: Path = RESULTS) -> None:
    figure = schematic_figure(Tripod.load())
    for kind in ("pdf", "png", "svg"):
        print(save_figure(figure, out / f"figure_8_1.{kind}"))


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
