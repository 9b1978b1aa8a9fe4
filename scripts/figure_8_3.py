"""Draw Figs. 8.3 (a), (b), (c): the chapter's stiffness about theta_x, about theta_y and along z over its section."""

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
PANELS = {"a": "stiffness_theta_x", "b": "stiffness_theta_y", "c": "stiffness_t_z"}


def main() -> None:
    tripod, grid = Tripod.load(), RectangularGrid(TILT, TILT, (181, 181))
    section, outline = stiffness_section(tripod, grid), section_outline(tripod, grid)
    for panel, variable in PANELS.items():
        print(save_figure(section_map(section, variable, outline), RESULTS / f"figure_8_3{panel}.png"))


if __name__ == "__main__":
    main()
