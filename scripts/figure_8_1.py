"""Draw Fig. 8.1b: the machine in its home pose with the names of its points, frames, angles and lengths."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from drawings.schematic import schematic_figure

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.figures.style import FORMATS, save_pictures

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main(out: Path = RESULTS, formats: Sequence[str] = FORMATS) -> None:
    figure = schematic_figure(Tripod.load())
    print(*save_pictures(figure, out / "figure_8_1", formats), sep="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
