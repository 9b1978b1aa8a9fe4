"""Draw Fig. 8.2, the workspace of the chapter's machine, and print where it differs from the printed ranges."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.figures.style import FORMATS, save_pictures
from pm3dof_pin.figures.workspace import workspace_figure
from pm3dof_pin.maps.chapter_workspace import compare_printed_ranges, printed_ranges, tripod_space
from pm3dof_pin.maps.datasets import write_csv
from pm3dof_pin.maps.workspace import workspace

RESULTS = Path(__file__).resolve().parents[1] / "results"


def main(out: Path = RESULTS, sections: int = 241, formats: Sequence[str] = ("png",)) -> None:
    tripod = Tripod.load()
    reachable = workspace(tripod_space(tripod), levels=sections)
    figure = workspace_figure(reachable, printed_ranges(tripod))
    print(*save_pictures(figure, out / "figure_8_2", formats), sep="\n")
    print(write_csv(reachable.boundary(), out / "figure_8_2_boundary.csv"))
    for statement in compare_printed_ranges(tripod, reachable):
        print(f"- {statement.text}")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--sections", type=int, default=241, help="number of sections of the workspace")
    parser.add_argument("--format", dest="formats", nargs="+", choices=FORMATS, default=["png"], help="picture formats")
    main(**vars(parser.parse_args()))
