"""Draw Fig. 8.4: the chapter's global stiffness over its section."""

from __future__ import annotations

import math
from pathlib import Path

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.section import section_outline, stiffness_section
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure

RESULTS = Path(__file__).resolve().parents[1] / "results"
TILT = (-math.radians(45.0), math.radians(45.0))  # beyond the boundary of the section on all sides


def main() -> None:
    tripod, grid = Tripod.load(), RectangularGrid(TILT, TILT, (181, 181))
    figure = section_map(stiffness_section(tripod, grid), "stiffness_global", section_outline(tripod, grid))
    print(save_figure(figure, RESULTS / "figure_8_4.png"))


if __name__ == "__main__":
    main()
