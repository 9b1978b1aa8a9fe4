"""The schematic shows the machine's own points, and its labels are legible."""

from __future__ import annotations

import itertools
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.exceptions import UnreachablePoseError

sys.path.insert(0, str(Path(__file__).parents[2] / "scripts"))

from drawings.compensation_flow import compensation_flow_figure
from drawings.pseudo_error import pseudo_error_figure
from drawings.schematic import schematic_figure


def _boxes(figure: Figure) -> dict[str, Bbox]:
    figure.draw_without_rendering()
    renderer = figure.canvas.get_renderer()
    texts = [text for axes in figure.axes for text in axes.texts if text.get_text()]
    return {f"{number} {text.get_text()}": text.get_window_extent(renderer) for number, text in enumerate(texts)}


def _overlaps(figure: Figure) -> list[tuple[str, str]]:
    boxes = {name: box.padded(-2.0) for name, box in _boxes(figure).items()}
    return [(a, b) for a, b in itertools.combinations(boxes, 2) if boxes[a].overlaps(boxes[b])]


@pytest.fixture(scope="module")
def figure(tripod: Tripod) -> Figure:
    return schematic_figure(tripod)


def test_every_name_of_the_chapter_is_there(figure: Figure) -> None:
    words = " ".join(text.get_text() for axes in figure.axes for text in axes.texts)
    for point in "BMDEF":
        assert all(f"${point}_{leg}$" in words for leg in (1, 2, 3))
    for symbol in (
        r"\alpha_1",
        r"\beta_3",
        r"\gamma",
        r"\theta_x",
        r"\theta_y",
        "l_b",
        "l_e",
        "$l$",
        "z_0",
        "u_i",
        "z_e",
        "P",
    ):
        assert symbol in words


def test_labels_do_not_overlap_and_stay_on_the_page(figure: Figure) -> None:
    assert _overlaps(figure) == []
    page = figure.bbox
    assert all(box.x0 > 0 and box.x1 < page.x1 and box.y0 > 0 and box.y1 < page.y1 for box in _boxes(figure).values())


@pytest.mark.parametrize("draw", [pseudo_error_figure, compensation_flow_figure])
def test_words_of_diagrams_do_not_overlap(draw: type) -> None:
    assert _overlaps(draw()) == []


def test_lengths_are_the_machines(figure: Figure, tripod: Tripod) -> None:
    """In the plane of a leg: guideway, link and platform as long and as steep as Table 8.1 says."""
    p = tripod.parameters
    segments = [np.ptp(line.get_xydata(), axis=0) for line in figure.axes[3].get_lines() if len(line.get_xdata()) == 2]
    assert any(np.hypot(*segment) == pytest.approx(p.link_length) for segment in segments)
    assert any(segment == pytest.approx([2 * p.platform_radius, 0.0]) for segment in segments)
    assert any(np.arctan2(segment[1], segment[0]) == pytest.approx(p.guide_slope) for segment in segments)


def test_level_guideways_have_no_middle_platform(tripod: Tripod) -> None:
    flat = Tripod(replace(tripod.parameters, guide_slope=0.0))
    with pytest.raises(UnreachablePoseError, match="middle platform"):
        schematic_figure(flat)
