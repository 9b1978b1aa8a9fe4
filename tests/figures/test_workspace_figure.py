"""The picture of the workspace: axes, colours of the limits, the printed ranges, machines of other shapes."""

from __future__ import annotations

import itertools
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.printed_ranges import printed_ranges
from pm3dof_pin.chapter.workspace import tripod_space
from pm3dof_pin.figures.style import INK, LIMIT_COLORS, save_figure
from pm3dof_pin.figures.workspace import PrintedRanges, _faces, _Sheet, workspace_figure
from pm3dof_pin.maps.workspace import Workspace, workspace


@pytest.fixture(scope="module")
def whole(tripod: Tripod) -> Workspace:
    return workspace(tripod_space(tripod), 31, 90)


@pytest.fixture(scope="module")
def figure(tripod: Tripod, whole: Workspace) -> Figure:
    return workspace_figure(whole, PrintedRanges(printed_ranges(tripod)))


def test_words_and_units(figure: Figure) -> None:
    solid, outlines, profile = figure.axes
    tilts = (r"$\theta_x$ [deg]", r"$\theta_y$ [deg]")
    assert (solid.get_xlabel(), solid.get_ylabel(), solid.get_zlabel()) == (*tilts, "$z_{e}$ [m]")
    assert (outlines.get_xlabel(), outlines.get_ylabel()) == tilts
    assert (profile.get_xlabel(), profile.get_ylabel()) == (r"range of $\theta_x$, $\theta_y$ [deg]", "$z_{e}$ [m]")
    assert figure.get_suptitle().endswith("pm3dof")
    words = [text.get_text() for text in figure.legends[0].get_texts()]
    assert words == ["stroke of a slider", "spherical joint", "printed ranges"]


def test_outlines_have_the_colour_of_their_limit(figure: Figure, whole: Workspace) -> None:
    outlines = figure.axes[1]
    drawn = {tuple(color) for collection in outlines.collections for color in collection.get_colors()}
    assert drawn == {to_rgba(LIMIT_COLORS["stroke"]), to_rgba(LIMIT_COLORS["spherical"])}
    heights = {f"{section.level:.3f}" for section in whole.sections}
    labels = [text.get_text() for text in outlines.texts]
    assert len(set(labels) & heights) == 6
    for collection, label in zip(outlines.collections, labels, strict=False):
        section = min(whole.sections, key=lambda section: abs(section.level - float(label)))
        np.testing.assert_allclose(
            [segment[0] for segment in collection.get_segments()], np.degrees(section.points), atol=1e-12
        )


def test_printed_ranges_are_drawn(figure: Figure) -> None:
    _, outlines, profile = figure.axes
    box, side = outlines.patches[0], profile.patches[0]
    assert (*box.get_xy(), box.get_width(), box.get_height()) == pytest.approx((-40.0, -40.0, 80.0, 80.0))
    assert (*side.get_xy(), side.get_width(), side.get_height()) == pytest.approx((-40.0, 0.440, 80.0, 0.168))


def test_profile_shows_the_ranges_of_the_sections(figure: Figure, whole: Workspace) -> None:
    lines = figure.axes[2].get_lines()
    ranges = np.degrees([section.ranges for section in whole.sections]).reshape(-1, 4)
    for line, expected in zip(lines, ranges.T, strict=True):
        np.testing.assert_allclose(line.get_xdata(), expected)
        np.testing.assert_allclose(line.get_ydata(), whole.levels)


def test_picture_on_disk(figure: Figure, tmp_path: Path) -> None:
    image = matplotlib.image.imread(save_figure(figure, tmp_path / "workspace.png"))[..., :3]
    assert image.shape[:2] == (1410, 2125)
    solid = image[200:1200, 100:1100]
    for limit in ("stroke", "spherical"):
        hue = np.array(to_rgba(LIMIT_COLORS[limit])[:3])
        shade = solid @ hue / (np.linalg.norm(solid, axis=-1) * np.linalg.norm(hue) + 1e-9)
        assert np.mean(shade > 0.999) > 0.05
    rim = np.concatenate([image[:4].reshape(-1, 3), image[-4:].reshape(-1, 3), image[:, :4].reshape(-1, 3)])
    assert np.all(rim > 0.999)


def test_colours_meet_along_the_edge_of_the_body(whole: Workspace) -> None:
    """No teeth: the corners of every face lie on the boundary, and its own limit is broken just beyond them."""
    sheet = _Sheet(whole, None)
    faces, colors = _faces(sheet)
    space, names = whole.space, whole.space.limits
    corners = faces.reshape(-1, 3)
    points, levels = np.radians(corners[:, :2]), corners[:, 2]
    middle = 0.5 * (space.points(np.zeros(1), np.zeros(1))[0])
    assert np.all(middle == 0.0)  # rays leave from there, so that scaling a point moves it along its ray
    inner = (levels > whole.levels[0]) & (levels < whole.levels[-1])
    assert np.all(space.within(points[inner] * (1.0 - 1e-5), levels[inner]))
    assert not np.any(space.within(points[inner] * (1.0 + 1e-5), levels[inner]))
    beyond = space.flags(points * 1.05, levels)
    for name in ("stroke", "spherical"):
        of_it = np.repeat(np.all(colors == to_rgba(LIMIT_COLORS[name]), axis=1), 4) & inner
        assert of_it.any()
        assert (
            np.mean((beyond[of_it] >> names.index(name)) & 1) > 0.98
        )  # where both meet at a grazing angle it is farther


def test_a_machine_with_holes_in_its_sections(hollow_tripod: Tripod) -> None:
    """Islands and holes are drawn as points, and no surface is drawn across them."""
    whole = workspace(tripod_space(hollow_tripod), 15, 90)
    figure = workspace_figure(whole)
    figure.canvas.draw()
    solid = figure.axes[0]
    scattered = sum(not section.star_shaped for section in whole.sections)
    assert 0 < scattered < 14
    assert len(solid.collections) == 1 + scattered
    cells = 90 * sum(lower.star_shaped and upper.star_shaped for lower, upper in itertools.pairwise(whole.sections))
    surface = np.any(solid.collections[0].get_facecolor() != to_rgba(INK), axis=1)
    # cells in which one limit takes over from another are divided
    assert np.count_nonzero(surface) >= cells
