"""Draw Fig. 8.4: the chapter's global stiffness over its section."""

from __future__ import annotations

import argparse
import math
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import FORMATS, save_pictures
from pm3dof_pin.kinematics.robot import load
from pm3dof_pin.maps.chapter_section import section_values, stiffness_section
from pm3dof_pin.maps.chapter_workspace import tripod_space

RESULTS = Path(__file__).resolve().parents[1] / "results"
TILT = (-math.radians(45.0), math.radians(45.0))  # beyond the boundary of the section on all sides


def main(out: Path = RESULTS, engine: str = "program", points: int = 181, formats: Sequence[str] = ("png",)) -> None:
    tripod, grid = Tripod.load(), RectangularGrid(TILT, TILT, (points, points))
    robot = load("pm3dof") if engine == "pinocchio" else None
    section, variable = stiffness_section(tripod, grid, robot=robot).dataset(), "stiffness_global"
    within = partial(tripod_space(tripod).within, level=tripod.middle_height)
    exact = None if robot else section_values(tripod, tripod.middle_height, variable)
    figure = section_map(section, variable, within=within, exact=exact)
    print(*save_pictures(figure, out / "figure_8_4", formats), sep="\n")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=RESULTS, help="folder to write to")
    parser.add_argument("--engine", choices=("program", "pinocchio"), default="program", help="computation engine")
    parser.add_argument("--points", type=int, default=181, help="number of values of each tilt")
    parser.add_argument("--format", dest="formats", nargs="+", choices=FORMATS, default=["png"], help="picture formats")
    main(**vars(parser.parse_args()))
