"""Draw Fig. 8.5 with the classes of Table 8.4: sources of error, the pseudo-error and the error of the pose."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from drawings.pseudo_error import pseudo_error_figure

from pm3dof_pin.figures.style import FORMATS, save_pictures

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main(out: Path = RESULTS, formats: Sequence[str] = FORMATS) -> None:
    figure = pseudo_error_figure()
    print(*save_pictures(figure, out / "figure_8_5", formats), sep="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    main(**vars(parser.parse_args()))
