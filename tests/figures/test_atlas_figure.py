"""Slices through an atlas: one picture per number, with its unit."""

from __future__ import annotations

from pathlib import Path

import pytest

from pm3dof_pin.figures.atlas import atlas_pictures
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.atlas import Atlas, compute_atlas, open_atlas

UNITS = {
    "felt_stiffness_x": ("N/m", "N/mm", "N/µm", "kN/µm"),
    "felt_stiffness_rx": ("N m/rad", "kN m/rad", "MN m/rad"),
    "chapter_diagonal_theta_x": ("kN m/rad", "MN m/rad", "GN m/rad"),
    "chapter_diagonal_t_z": ("N/µm", "kN/µm"),
    **{f"slider_travel_{leg}": ("m",) for leg in (1, 2, 3)},
    "condition_number": ("",),
}


@pytest.fixture(scope="module")
def pictures(mechanism: Robot, tmp_path_factory: pytest.TempPathFactory) -> dict:
    grid = mechanism.grid(z_e=(0.40, 0.57, 9), theta_x=(-0.7, 0.7, 9), theta_y=(-0.7, 0.7, 9))
    names = ("felt_stiffness", "chapter_diagonal", "slider_travel", "condition_number", "K")
    path: Path = tmp_path_factory.mktemp("atlas") / "atlas.nc"
    with open_atlas(compute_atlas(Atlas(mechanism, grid, names, path))) as dataset:
        return atlas_pictures(dataset.sel(axis=["x", "rx"], chapter_axis=["theta_x", "t_z"]), mechanism)


def test_one_picture_for_each_number_and_none_for_matrices(pictures: dict) -> None:
    assert set(pictures) == set(UNITS)


@pytest.mark.parametrize("name", UNITS)
def test_colour_bar_has_the_unit_of_its_number_and_stays_within_the_picture(pictures: dict, name: str) -> None:
    figure = pictures[name]
    bar = figure.axes[-1]
    words, _, unit = bar.get_ylabel().partition("[")
    assert unit.removesuffix("]") in UNITS[name]
    assert "[1]" not in bar.get_ylabel()
    assert words or unit
    if name[-1] in "23":  # as long as the words of its neighbour
        return
    figure.draw_without_rendering()
    box = bar.yaxis.label.get_window_extent()
    assert 0 <= box.x0 < box.x1 <= figure.bbox.width
    assert 0 <= box.y0 < box.y1 <= figure.bbox.height


@pytest.mark.parametrize("dimensions", [1, 2, 4])
def test_other_numbers_of_dimensions(dimensions: int, tmp_path: Path) -> None:
    robot = Robot.load("hexapod")
    axes = {"x": (-0.01, 0.01, 5), "y": (-0.01, 0.01, 4), "z": (0.13, 0.14, 3), "rx": (-0.05, 0.05, 3)}
    grid = robot.grid(**dict(list(axes.items())[:dimensions]))
    with open_atlas(compute_atlas(Atlas(robot, grid, ("felt_stiffness",), tmp_path / "atlas.nc"))) as dataset:
        figure = atlas_pictures(dataset)["felt_stiffness_rz"]
    figure.draw_without_rendering()
    title = figure.texts[0].get_window_extent()
    assert 0 <= title.x0 < title.x1 <= figure.bbox.width
    labels = {axes.get_xlabel() for axes in figure.axes}
    assert {1: "$x$ [m]", 2: "$x$ [m]", 4: "$r_{x}$ [deg]"}[dimensions] in labels | {
        axes.get_ylabel() for axes in figure.axes
    }
    if dimensions == 4:
        assert "$x$ = 0.0000 m" in figure.get_suptitle()
