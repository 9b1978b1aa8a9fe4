"""Draw Fig. 8.6: the flow of the error compensation."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from drawings.compensation_flow import compensation_flow_figure

from pm3dof_pin.figures.style import FORMATS, save_pictures

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main(out: Path = RESULTS, formats: Sequence[str] = FORMATS) -> None:
    figure = compensation_flow_figure()
    print(*save_pictures(figure, out / "figure_8_6", formats), sep="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
