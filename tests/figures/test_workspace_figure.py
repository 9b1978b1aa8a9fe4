"""The picture of the workspace: axes, colours of the limits, the printed ranges, machines of other shapes."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.figures import workspace as workspace_module
from pm3dof_pin.figures.style import LIMIT_STYLES, save_figure
from pm3dof_pin.figures.workspace import _mean_of_neighbours, _Sheet, workspace_figure
from pm3dof_pin.maps.chapter_workspace import printed_ranges, tripod_space
from pm3dof_pin.maps.workspace import Workspace, workspace


@pytest.fixture(scope="module")
def whole(tripod: Tripod) -> Workspace:
    return workspace(tripod_space(tripod), 31, 90)


@pytest.fixture(scope="module")
def figure(tripod: Tripod, whole: Workspace) -> Figure:
    return workspace_figure(whole, printed_ranges(tripod))


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
    assert drawn == {to_rgba(LIMIT_STYLES["stroke"][0]), to_rgba(LIMIT_STYLES["spherical"][0])}
    labels = [text.get_text() for text in outlines.texts]
    assert len(labels) in range(4, 9)
    step = np.diff([float(label) for label in labels])
    assert step == pytest.approx(0.025)
    for label in labels:
        assert min(abs(section.level - float(label)) for section in whole.outlines) < 1e-12
    for collection, label in zip(outlines.collections, labels, strict=False):
        section = min(whole.outlines, key=lambda section: abs(section.level - float(label)))
        assert _enclosed(collection) == pytest.approx(np.degrees(np.degrees(section.area)), rel=3e-3)


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
        hue = np.array(to_rgba(LIMIT_STYLES[limit][0])[:3])
        shade = solid @ hue / (np.linalg.norm(solid, axis=-1) * np.linalg.norm(hue) + 1e-9)
        assert np.mean(shade > 0.999) > 0.05
    rim = np.concatenate([image[:4].reshape(-1, 3), image[-4:].reshape(-1, 3), image[:, :4].reshape(-1, 3)])
    assert np.all(rim > 0.999)


def test_faces_have_the_colour_of_their_limit(whole: Workspace) -> None:
    """Faces lie on the boundary, and their own limit is broken a little beyond."""
    sheet, space = _Sheet(whole, None), whole.space
    faces, limits = sheet.solid()
    centres = faces.mean(axis=1)
    points = np.column_stack([np.radians(centres[:, :2]), centres[:, 2]])
    middle = np.array([0.0, 0.0, 0.49])
    assert np.mean(space.within(middle + 0.97 * (points - middle))) > 0.99
    beyond = space.broken_limits(middle + 1.04 * (points - middle))
    assert np.mean(beyond > 0) > 0.99
    for name in ("stroke", "spherical"):
        number = space.limits.index(name)
        assert (limits == number).any()
        assert np.mean(beyond[limits == number] & (1 << number) > 0) > 0.96


def test_a_machine_with_holes_in_its_sections(hollow_tripod: Tripod, monkeypatch: pytest.MonkeyPatch) -> None:
    """Islands and holes are part of the solid, and of the outlines."""
    whole = workspace(tripod_space(hollow_tripod), 15, 240)
    assert not all(len(section.lines) == 1 for section in whole.sections)
    sheet = _Sheet(whole, None)
    x, y, z = np.moveaxis(sheet.solid()[0], -1, 0)
    from_above = 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    fine = workspace(whole.space, np.linspace(*whole.level_range, 41), 240)
    volume = np.degrees(np.degrees(fine.volume))
    assert np.sum(from_above * z.mean(axis=1)) == pytest.approx(volume, rel=0.03)
    monkeypatch.setattr(workspace_module, "_Sheet", lambda *_: sheet)  # made once
    figure = workspace_figure(whole)
    figure.draw_without_rendering()
    for section, lines in zip(sheet.sections, figure.axes[1].collections, strict=False):
        assert _enclosed(lines) == pytest.approx(np.degrees(np.degrees(section.area)), rel=1e-2)


def _enclosed(lines: Collection) -> float:
    """Area within closed lines."""
    starts, ends = np.array([path.vertices for path in lines.get_paths()]).swapaxes(0, 1)
    return float(0.5 * np.sum(starts[:, 0] * ends[:, 1] - starts[:, 1] * ends[:, 0]))


def test_means_of_neighbours() -> None:
    two_triangles = np.array([[0, 1, 4], [4, 1, 2]])  # vertex 3 belongs to none; the edge from 1 to 4 counts twice
    values = np.array([[1.0, -1.0], [2.0, 5.0], [4.0, 0.5], [8.0, 8.0], [16.0, 3.0]])
    expected = [(values[1] + values[4]) / 2, (values[0] + values[2] + 2 * values[4]) / 4, (values[4] + values[1]) / 2]
    expected += [np.zeros(2), (values[0] + values[2] + 2 * values[1]) / 4]
    np.testing.assert_allclose(_mean_of_neighbours(5, two_triangles)(values), expected, rtol=1e-15)
