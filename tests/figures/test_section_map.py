"""Maps over a section: what stands on the axes, what is drawn, and where the map ends."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.path import Path as Line

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.section import section_outline, stiffness_section
from pm3dof_pin.chapter.tilt_grids import PolarGrid, RectangularGrid
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure

GRIDS = {"rectangular": RectangularGrid(shape=(41, 41)), "polar": PolarGrid()}


@pytest.fixture(scope="module", params=GRIDS)
def maps(request: pytest.FixtureRequest, tripod: Tripod) -> tuple[xr.Dataset, xr.Dataset]:
    grid = GRIDS[request.param]
    outline = section_outline(tripod, grid)
    assert outline is not None
    return stiffness_section(tripod, grid), outline


def _labels(figure: Figure) -> list[str]:
    surface, contours, bar = figure.axes
    return [
        surface.get_xlabel(),
        surface.get_ylabel(),
        surface.get_zlabel(),
        contours.get_xlabel(),
        contours.get_ylabel(),
        bar.get_ylabel(),
    ]


@pytest.mark.parametrize(
    ("variable", "what", "unit"),
    [
        ("stiffness_theta_x", r"stiffness about $\theta_x$", "MN m/rad"),
        ("stiffness_theta_y", r"stiffness about $\theta_y$", "MN m/rad"),
        ("stiffness_t_z", "stiffness along $z$", "kN/µm"),
        ("stiffness_t_x", "stiffness along $x$", "N/µm"),
        ("stiffness_global", "global stiffness", "$10^{9}$ mixed units"),
    ],
)
def test_words_and_units(maps: tuple[xr.Dataset, xr.Dataset], variable: str, what: str, unit: str) -> None:
    figure = section_map(maps[0], variable, maps[1])
    tilts = [r"$\theta_x$ [deg]", r"$\theta_y$ [deg]"]
    assert _labels(figure) == [*tilts, f"{what} [{unit}]", *tilts, f"{what} [{unit}]"]
    title = figure.get_suptitle()
    assert title.lower().startswith(what.lower())
    assert "pm3dof, chapter model" in title
    assert "0.4873 m" in title


def test_picture_on_disk(maps: tuple[xr.Dataset, xr.Dataset], tmp_path: Path) -> None:
    path = save_figure(section_map(maps[0], "stiffness_theta_y", maps[1]), tmp_path / "map.png")
    image = matplotlib.image.imread(path)
    assert image.shape[:2] == (960, 2125)
    for half in (image[:, :950, :3], image[:, 1150:1850, :3]):
        assert len(np.unique((half * 255).astype(int).reshape(-1, 3), axis=0)) > 50
    # nothing is cut off at the rim of the picture
    rim = np.concatenate([image[:4].reshape(-1, 4), image[-4:].reshape(-1, 4), image[:, :4].reshape(-1, 4)])
    assert np.all(rim[:, :3] > 0.999)


def test_the_map_covers_the_section_and_no_more(tripod: Tripod, maps: tuple[xr.Dataset, xr.Dataset]) -> None:
    figure = section_map(maps[0], "stiffness_theta_x", maps[1])
    contours = figure.axes[1]
    outline = np.degrees(np.column_stack([maps[1].theta_x, maps[1].theta_y]))
    limits, ends = (_pieces(collection) for collection in contours.collections[-2:])
    at_end = maps[1].at_grid_end.values
    np.testing.assert_allclose(_distances(outline[~at_end], np.concatenate(limits)), 0.0, atol=1e-9)
    if at_end.any():  # of the rectangular grid at 40 degrees
        corners = np.concatenate(ends)
        np.testing.assert_allclose(_distances(outline[at_end], corners), 0.0, atol=1e-9)
        np.testing.assert_allclose(corners[1:-1, 0], 40.0, atol=1e-9)
    assert at_end.any() == (maps[0].broken_limits.dims == ("theta_x", "theta_y"))
    points = np.random.default_rng(3).uniform(-46.0, 46.0, (400, 2))
    inside = Line(outline).contains_points(points)
    clear = np.linalg.norm(points[:, None] - outline, axis=-1).min(axis=1) > 0.7
    filled = np.zeros(len(points), dtype=bool)
    for band in contours.collections[0].get_paths():
        filled |= band.contains_points(points)
    np.testing.assert_array_equal(filled[clear], inside[clear])


def _pieces(collection: LineCollection) -> list[np.ndarray]:
    return [np.asarray(piece) for piece in collection.get_segments()]


def _distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    return np.asarray(np.linalg.norm(points[:, None] - others, axis=-1).min(axis=1))


def test_colours_stand_for_the_values_of_the_section(maps: tuple[xr.Dataset, xr.Dataset]) -> None:
    figure = section_map(maps[0], "stiffness_theta_y", maps[1])
    low, high = figure.axes[2].get_ylim()
    drawn = [maps[0].stiffness_theta_y, maps[1].stiffness_theta_y]
    assert low <= min(float(values.min()) for values in drawn) / 1e6
    assert high >= max(float(values.max()) for values in drawn) / 1e6
    assert high - low < 120.0


def test_without_an_outline(tripod: Tripod) -> None:
    figure = section_map(stiffness_section(tripod, RectangularGrid(shape=(21, 21))), "stiffness_t_z")
    assert not any(_pieces(collection) for collection in figure.axes[1].collections[-2:])
    (_, reach) = figure.axes[1].get_xlim()
    assert 38.0 < reach < 45.0


@pytest.mark.parametrize("change", ["variable", "heights", "empty"])
def test_nothing_to_draw(tripod: Tripod, change: str) -> None:
    grid = RectangularGrid(shape=(5, 5))
    section = stiffness_section(tripod, grid, {"heights": [0.45, 0.5], "empty": 0.7}.get(change, 0.5))
    with pytest.raises(
        InvalidValueError, match={"variable": "colour", "heights": "section"}.get(change, "no|0 values")
    ):
        section_map(section, "colour" if change == "variable" else "stiffness_t_z")
