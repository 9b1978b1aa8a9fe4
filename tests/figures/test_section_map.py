"""Maps over a section: their axes, contents and ends."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
import xarray as xr
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.figures.section_map import section_map
from pm3dof_pin.figures.style import save_figure
from pm3dof_pin.maps.chapter_section import section_values, stiffness_section
from pm3dof_pin.maps.chapter_workspace import tripod_space

TILT = np.radians([-45.0, 45.0])  # beyond every limit of the section
GRIDS = {
    "to 40 degrees": RectangularGrid(shape=(41, 41)),
    "to 45 degrees": RectangularGrid((TILT[0], TILT[1]), (TILT[0], TILT[1]), (46, 46)),
}


@pytest.fixture(scope="module", params=GRIDS)
def section(request: pytest.FixtureRequest, tripod: Tripod) -> xr.Dataset:
    return stiffness_section(tripod, GRIDS[request.param]).dataset()


@pytest.fixture(scope="module")
def draw(tripod: Tripod, section: xr.Dataset) -> Callable[[str], Figure]:
    def draw(variable: str) -> Figure:
        height, space = tripod.middle_height, tripod_space(tripod)
        exact = section_values(tripod, height, variable)
        return section_map(section, variable, within=lambda tilts: space.within(tilts, height), exact=exact)

    return draw


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
def test_words_and_units(draw: Callable[[str], Figure], variable: str, what: str, unit: str) -> None:
    figure = draw(variable)
    tilts = [r"$\theta_x$ [deg]", r"$\theta_y$ [deg]"]
    assert _labels(figure) == [*tilts, f"{what} [{unit}]", *tilts, f"{what} [{unit}]"]
    title = figure.get_suptitle()
    assert title.lower().startswith(what.lower())
    assert "pm3dof, chapter model" in title
    assert "0.4873 m" in title


@pytest.mark.parametrize("section", ["to 45 degrees"], indirect=True)
def test_picture_on_disk(draw: Callable[[str], Figure], tmp_path: Path) -> None:
    path = save_figure(draw("stiffness_theta_y"), tmp_path / "map.png")
    image = matplotlib.image.imread(path)
    assert image.shape[:2] == (960, 2125)
    for half in (image[:, :950, :3], image[:, 1150:1850, :3]):
        assert len(np.unique((half * 255).astype(int) @ (1, 1 << 8, 1 << 16))) > 50
    # nothing is cut off at the edge of the picture
    rim = np.concatenate([image[:4].reshape(-1, 4), image[-4:].reshape(-1, 4), image[:, :4].reshape(-1, 4)])
    assert np.all(rim[:, :3] > 0.999)


def test_the_map_covers_the_section_and_no_more(
    tripod: Tripod, section: xr.Dataset, draw: Callable[[str], Figure]
) -> None:
    """Limits bind along the limit lines, the grid's last tilt along its end, and everything drawn is inside."""
    contours = draw("stiffness_theta_x").axes[1]
    limits, ends = (_pieces(collection) for collection in contours.collections[-2:])
    most = float(np.degrees(section.theta_x.max()))
    space = tripod_space(tripod)

    def within(degrees: np.ndarray) -> np.ndarray:
        inside = space.within(np.radians(degrees), tripod.middle_height)
        return np.asarray(inside & (np.abs(degrees) <= most).all(axis=-1))

    line = np.concatenate(limits)
    outward = 0.05 * line / np.linalg.norm(line, axis=1, keepdims=True)  # [deg], from the level platform
    inner = (np.abs(line) < most - 0.1).all(axis=1)
    assert within((line - outward)[inner]).all()
    assert not within((line + outward)[inner]).any()
    assert bool(ends) == (most < 45.0)
    for piece in ends:
        np.testing.assert_allclose(np.abs(piece).max(axis=1), most, atol=1e-9)
    points = np.random.default_rng(3).uniform(-46.0, 46.0, (400, 2))
    clear = np.linalg.norm(points[:, None] - line, axis=-1).min(axis=1) > 0.7
    clear &= (np.abs(np.abs(points) - most) > 0.7).all(axis=1)
    filled = np.zeros(len(points), dtype=bool)
    for band in contours.collections[0].get_paths():
        filled |= band.contains_points(points)
    np.testing.assert_array_equal(filled[clear], within(points)[clear])


def _pieces(collection: LineCollection) -> list[np.ndarray]:
    return [np.asarray(piece) for piece in collection.get_segments()]


def test_colours_stand_for_the_values_of_the_section(section: xr.Dataset, draw: Callable[[str], Figure]) -> None:
    low, high = draw("stiffness_theta_y").axes[2].get_ylim()
    assert low <= float(section.stiffness_theta_y.min()) / 1e6
    assert high >= float(section.stiffness_theta_y.max()) / 1e6
    assert high - low < 120.0


def test_without_an_outline(tripod: Tripod) -> None:
    figure = section_map(stiffness_section(tripod, RectangularGrid(shape=(21, 21))).dataset(), "stiffness_t_z")
    assert not _pieces(figure.axes[1].collections[-2])  # its limits are unknown
    (_, reach) = figure.axes[1].get_xlim()
    assert 38.0 < reach < 45.0


@pytest.mark.parametrize("change", ["variable", "heights", "empty"])
def test_nothing_to_draw(tripod: Tripod, change: str) -> None:
    heights = {"heights": [0.45, 0.5], "empty": [0.7]}.get(change, [0.5])
    sections = [stiffness_section(tripod, RectangularGrid(shape=(5, 5)), z_e).dataset() for z_e in heights]
    section = sections[0] if len(sections) == 1 else xr.concat(sections, "z_e", combine_attrs="override")
    with pytest.raises(
        InvalidValueError, match={"variable": "colour", "heights": "section"}.get(change, "no|0 values")
    ):
        section_map(section, "colour" if change == "variable" else "stiffness_t_z")
