"""The figures of the chapter as computed by the current package, drawn when the documentation is built."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from docutils import nodes
from drawings.compensation_flow import compensation_flow_figure
from drawings.pseudo_error import pseudo_error_figure
from drawings.schematic import schematic_figure
from matplotlib.figure import Figure
from sphinx.application import Sphinx
from sphinx.util.typing import ExtensionMetadata
from studies.passive_leg_radius import passive_leg_radius_figure
from studies.universal_joint import universal_joint_figure

from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.cli.stiffness_map import PICTURES
from pm3dof_pin.errors.error_map import section_grid
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.export.description import temporary_description
from pm3dof_pin.figures.atlas import atlas_pictures
from pm3dof_pin.figures.critical_springs import critical_springs
from pm3dof_pin.figures.error_ranking import error_ranking
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.figures.workspace import workspace_figure
from pm3dof_pin.kinematics.robot import Robot, load
from pm3dof_pin.maps.atlas import Atlas, compute_atlas, open_atlas
from pm3dof_pin.maps.chapter_section import section_values, stiffness_section
from pm3dof_pin.maps.chapter_workspace import printed_ranges, tripod_space
from pm3dof_pin.maps.grid_map import error_section, errors_over, quantities_over, quantity_map
from pm3dof_pin.maps.limit_space import limits_over, robot_space
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.maps.workspace import workspace
from pm3dof_pin.maps.workspace_evaluation import evaluate_workspace


def _save(figure: Figure, path: Path) -> None:
    """Write a picture for light pages, and one for dark ones."""
    save_figure(figure, path)
    save_figure(figure, path.with_suffix(".dark.png"))


def _offer_dark(app: Sphinx, doctree: nodes.document) -> None:
    """Show the dark variant of a computed picture on dark pages."""
    for image in list(doctree.findall(nodes.image)):
        path = Path(image["uri"])
        if path.parent.name == "computed" and not path.name.endswith(".dark.png"):
            dark = image.deepcopy()
            dark["uri"] = str(path.with_suffix(".dark.png"))
            image["classes"].append("only-light")
            dark["classes"].append("only-dark")
            image.parent.insert(image.parent.index(image) + 1, dark)


def _draw(app: Sphinx) -> None:
    folder = Path(app.srcdir) / "pictures" / "computed"
    tripod = Tripod.load()
    _save(schematic_figure(tripod), folder / "figure_8_1_schematic.png")
    _save(passive_leg_radius_figure(tripod), folder / "passive_leg_radius.png")
    robot = load("pm3dof")
    tilts = robot.grid(theta_x=(-0.7, 0.7, 81), theta_y=(-0.7, 0.7, 81))
    judged = evaluate_workspace(MappedRobot(robot), tilts, ("felt_stiffness",))
    broken = limits_over(robot, ("theta_x", "theta_y"))
    _save(critical_springs(judged.dataset, lambda points: broken(points) == 0), folder / "critical_springs.png")
    _draw_atlas(robot, folder)
    _draw_errors(folder)
    _draw_hexapod(folder)
    variant = load(temporary_description("pm3dof", "universal_joint_at_base"))
    both = {"universal joint on the platform": robot, "universal joint at the base": variant}
    _save(universal_joint_figure(both, tripod.middle_height), folder / "universal_joint.png")
    _save(pseudo_error_figure(), folder / "figure_8_5_pseudo_error.png")
    _save(compensation_flow_figure(), folder / "figure_8_6_compensation_flow.png")
    space = tripod_space(tripod)
    reachable, printed = workspace(space, 61, 180), printed_ranges(tripod)
    _save(workspace_figure(reachable, printed), folder / "figure_8_2_workspace.png")
    section, within = stiffness_section(tripod).dataset(), partial(space.within, level=tripod.middle_height)
    for name, quantity in PICTURES.items():
        exact = section_values(tripod, tripod.middle_height, quantity)
        _save(section_map(section, quantity, within=within, exact=exact), folder / name)


def _draw_atlas(robot: Robot, folder: Path) -> None:
    """Draw slices of a small atlas."""
    low, high = robot.range_of(robot.coordinate("z_e"))
    grid = robot.grid(z_e=(low, high, 21), theta_x=(-0.78, 0.78, 25), theta_y=(-0.78, 0.78, 25))
    with TemporaryDirectory() as scratch:
        job = Atlas(robot, grid, ("condition_number", "chapter_global"), Path(scratch) / "atlas.nc")
        with open_atlas(compute_atlas(job)) as dataset:
            for name, figure in atlas_pictures(dataset, robot).items():
                _save(figure, folder / f"atlas_{name}.png")


def _draw_errors(folder: Path) -> None:
    """Draw tool errors caused by part errors over the section of Table 8.3."""
    errors = GeometricErrors.load("pm3dof")
    grid = section_grid(errors.robot, points=61)
    section, mapped = error_section(errors, grid)
    broken = limits_over(errors.robot, grid.dims, grid.fixed)
    for name in ("tip_rms", "uncompensable_rms"):
        exact = errors_over(errors, grid, name)
        figure = section_map(section, name, within=lambda points: broken(points) == 0, exact=exact)
        _save(figure, folder / f"error_map_{name}.png")
    _save(error_ranking(mapped.ranking(), errors.robot.name), folder / "error_ranking.png")


def _draw_hexapod(folder: Path) -> None:
    """Draw maps of another robot, and its workspace."""
    robot = load("hexapod")
    grid = robot.grid(x=(-0.018, 0.018, 31), y=(-0.018, 0.018, 31))
    mapped = MappedRobot(robot)
    dataset = quantity_map(mapped, grid, ("first_frequency",))
    broken = limits_over(robot, grid.dims, grid.fixed)
    exact = quantities_over(mapped, grid, ("first_frequency",))
    figure = section_map(
        dataset,
        "first_frequency",
        within=lambda points: broken(points) == 0,
        exact=lambda points: exact(points)["first_frequency"],
    )
    _save(figure, folder / "hexapod_first_frequency.png")
    _save(workspace_figure(workspace(robot_space(robot), 41, 90)), folder / "hexapod_workspace.png")


def setup(app: Sphinx) -> ExtensionMetadata:
    """Draw before the pages are read."""
    app.connect("builder-inited", _draw)
    app.connect("doctree-read", _offer_dark, priority=400)  # before pictures are collected
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}
