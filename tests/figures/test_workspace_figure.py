"""The picture of the workspace: axes, colours of the limits, the printed ranges, machines of other shapes."""

from __future__ import annotations

from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from matplotlib.collections import Collection
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from numpy.typing import ArrayLike

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.printed_ranges import printed_ranges
from pm3dof_pin.chapter.workspace import tripod_space
from pm3dof_pin.figures import workspace as workspace_module
from pm3dof_pin.figures.style import LIMIT_STYLES, save_figure
from pm3dof_pin.figures.workspace import _Sheet, workspace_figure
from pm3dof_pin.maps.limit_space import LimitSpace
from pm3dof_pin.maps.workspace import Workspace, workspace
from pm3dof_pin.maps.workspace_section import workspace_sections


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
    heights = {f"{section.level:.3f}" for section in whole.sections}
    labels = [text.get_text() for text in outlines.texts]
    assert len(set(labels) & heights) == 6
    for collection, label in zip(outlines.collections, labels, strict=False):
        section = min(whole.sections, key=lambda section: abs(section.level - float(label)))
        assert _enclosed(collection) == pytest.approx(_areas(whole.space, [section.level])[0], rel=3e-3)


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


def test_colours_meet_along_the_edge_of_the_body(whole: Workspace) -> None:
    """No teeth: the corners of every face lie on the boundary, and its own limit is broken just beyond them."""
    sheet, space = _Sheet(whole, None), whole.space
    assert sheet.solid is not None
    corners = sheet.solid.corners.reshape(-1, 3)
    points, levels = np.radians(corners[:, :2]), corners[:, 2]
    assert np.all(space.centre == 0.0)  # rays leave from there, so that scaling a point moves it along its ray
    inner = np.abs(levels - 0.5 * np.sum(whole.level_range)) < 0.45 * np.ptp(whole.level_range)
    near = 0.02 * np.ptp(whole.ranges)  # less than half a cell of curved faces and grazing edges
    assert np.mean(space.within(points[inner] * (1.0 - near), levels[inner])) > 0.99
    assert np.mean(space.within(points[inner] * (1.0 + near), levels[inner])) < 0.01
    beyond = space.flags(points * 1.05, levels)
    for name in ("stroke", "spherical"):
        bit = np.uint32(1 << space.limits.index(name))
        of_it = np.repeat(sheet.solid.limits == bit, 4) & inner
        assert of_it.any()
        assert np.mean(beyond[of_it] & bit > 0) > 0.98  # where both meet at a grazing angle it is farther


def test_a_machine_with_holes_in_its_sections(hollow_tripod: Tripod, monkeypatch: pytest.MonkeyPatch) -> None:
    """Islands and holes are part of the solid, and of the outlines."""
    whole = workspace(tripod_space(hollow_tripod), 15, 60)
    assert not all(section.star_shaped for section in whole.sections)
    sheet = _Sheet(whole, None)
    assert sheet.solid is not None
    x, y, z = np.moveaxis(sheet.solid.corners, -1, 0)
    from_above = 0.5 * np.sum(x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1), axis=1)
    levels = np.linspace(*whole.level_range, 24)
    volume = np.trapezoid(_areas(whole.space, levels), levels)
    assert np.sum(from_above * z.mean(axis=1)) == pytest.approx(volume, rel=0.02)
    monkeypatch.setattr(workspace_module, "_Sheet", lambda *_: sheet)  # made once
    figure = workspace_figure(whole)
    figure.draw_without_rendering()
    areas = _areas(whole.space, [section.level for section in sheet.sections])
    for area, lines in zip(areas, figure.axes[1].collections, strict=False):
        assert _enclosed(lines) == pytest.approx(area, rel=1e-2)


def _areas(space: LimitSpace, levels: ArrayLike) -> list[float]:
    """Areas of sections by rays [deg^2]."""
    sections = workspace_sections(space, np.asarray(levels), 180, ranges=False)
    return [float(np.degrees(np.degrees(section.area))) for section in sections]


def _enclosed(lines: Collection) -> float:
    """Area within closed lines."""
    starts, ends = np.array([path.vertices for path in lines.get_paths()]).swapaxes(0, 1)
    return float(0.5 * np.sum(starts[:, 0] * ends[:, 1] - starts[:, 1] * ends[:, 0]))
