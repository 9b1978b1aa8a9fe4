"""The figures of the chapter as the package computes them today, drawn when the documentation is built."""

from __future__ import annotations

from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata

from pm3dof_pin.chapter.printed_ranges import printed_ranges
from pm3dof_pin.chapter.section import section_outline, stiffness_section
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.chapter.workspace import tripod_space
from pm3dof_pin.cli.stiffness_map import PICTURES
from pm3dof_pin.export.description import temporary_description
from pm3dof_pin.figures.compensation_flow import compensation_flow_figure
from pm3dof_pin.figures.critical_springs import critical_springs
from pm3dof_pin.figures.passive_leg_radius import passive_leg_radius_figure
from pm3dof_pin.figures.pseudo_error import pseudo_error_figure
from pm3dof_pin.figures.schematic import schematic_figure
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.figures.universal_joint import universal_joint_figure
from pm3dof_pin.figures.workspace import PrintedRanges, workspace_figure
from pm3dof_pin.kinematics.robot import load
from pm3dof_pin.maps.quantities import MappedRobot
from pm3dof_pin.maps.workspace import workspace
from pm3dof_pin.maps.workspace_evaluation import evaluate_workspace


def _draw(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "pictures" / "computed"
    tripod, grid = Tripod.load(), RectangularGrid()
    save_figure(schematic_figure(tripod), folder / "figure_8_1_schematic.png")
    save_figure(passive_leg_radius_figure(tripod), folder / "passive_leg_radius.png")
    robot = load("pm3dof")
    tilts = robot.grid(theta_x=(-0.7, 0.7, 81), theta_y=(-0.7, 0.7, 81))
    judged = evaluate_workspace(MappedRobot(robot), tilts, ("felt_stiffness",))
    save_figure(critical_springs(judged.dataset), folder / "critical_springs.png")
    variant = load(temporary_description("pm3dof", "universal_joint_at_base"))
    both = {"universal joint on the platform": robot, "universal joint at the base": variant}
    save_figure(universal_joint_figure(both, tripod.middle_height), folder / "universal_joint.png")
    save_figure(pseudo_error_figure(), folder / "figure_8_5_pseudo_error.png")
    save_figure(compensation_flow_figure(), folder / "figure_8_6_compensation_flow.png")
    reachable, printed = workspace(tripod_space(tripod)), PrintedRanges(printed_ranges(tripod))
    save_figure(workspace_figure(reachable, printed), folder / "figure_8_2_workspace.png")
    section, outline = stiffness_section(tripod, grid), section_outline(tripod, grid)
    for name, quantity in PICTURES.items():
        save_figure(section_map(section, quantity, outline), folder / name)


def setup(app: Sphinx) -> ExtensionMetadata:
    """Draw before the pages are read."""
    app.connect("builder-inited", _draw)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
