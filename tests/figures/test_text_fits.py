"""Pictures of commands for several robots: no text leaves the picture or covers another; and their dark variants."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.text import Text
from typer.testing import CliRunner

from pm3dof_pin.cli.app import app
from pm3dof_pin.figures import style

MACHINES = Path(__file__).parents[1] / "machines"
JOBS = [
    ("evaluate", "--robot", robot, "--points", points, "--out")
    for robot, points in (("hexapod", "2"), ("linear_delta", "3"), ("three_rps", "3"), ("pm3dof", "3"))
] + [
    ("stiffness-map", "--robot", "hexapod", "--points", "9", "--out"),
    ("stiffness-map", "--robot", str(MACHINES / "three_rpr"), "--points", "9", "--out"),
    ("error-map", "--robot", "linear_delta", "--points", "5", "--out"),
    (
        *("transmission", "--robot", str(MACHINES / "ankle" / "ankle.xml"), "--joints", "pitch,roll"),
        *("--over", "pitch", "-20", "20", "5", "--over", "roll", "-10", "10", "5"),
        *("--effort", "40", "--speed", "10", "--out"),
    ),
    (
        *("receptance", "--robot", "pm3dof", "--from", "tool:x", "--from", "tool:y"),
        *("--cutting", "kc=6e8,kr=0.3,teeth=3,ae=0.5,ap=0.0002", "--folder"),
    ),
    ("stiffness-map", "--robot", "pm3dof", "--points", "9", "--out"),  # constant along x
    *(
        ("calibration-plan", "--robot", robot, "--candidates", "60", "--out", "{}/plan.csv", "--picture", "{}/plan.png")
        for robot in (str(MACHINES / "five_bar"), "hexapod")
    ),
    ("workspace", "--robot", "hexapod", "--out"),
    ("workspace", "--robot", str(MACHINES / "five_bar"), "--out"),
]


def texts_of(figure: Figure) -> list[Text]:
    """The visible texts of a figure that say something."""
    return [
        text
        for text in figure.findobj(Text)
        if text.get_visible() and text.get_text().strip() and (text.axes is None or text.axes.get_visible())
    ]


def problems_of(figure: Figure) -> list[str]:
    """Texts that leave the canvas, and those in horizontal lines that cover one another."""
    figure.canvas.draw()
    width, height = figure.bbox.size
    boxes = {text: text.get_window_extent() for text in texts_of(figure)}
    found = []
    lines = [axis for axes in figure.axes for axis in (axes.xaxis, axes.yaxis, getattr(axes, "zaxis", axes.xaxis))]
    ticks = {label for axis in lines for tick in axis.get_major_ticks() for label in (tick.label1, tick.label2)}
    seen = {label for axis in lines for label in _drawn_labels(axis)}
    for text, box in boxes.items():
        if text in ticks and text not in seen:
            continue
        if box.x0 < -1.0 or box.y0 < -1.0 or box.x1 > width + 1.0 or box.y1 > height + 1.0:
            found.append(f"outside: {text.get_text()!r}")
    for axis in lines:
        labels = [boxes[label] for label in _drawn_labels(axis) if label in boxes]
        for a, b in itertools.pairwise(labels):
            if min(a.x1, b.x1) - max(a.x0, b.x0) > -2.0 and min(a.y1, b.y1) - max(a.y0, b.y0) > 0.0:
                found.append(f"ticks of {axis.axes.get_title()!r} touch")
    titles = [text for text in boxes if text not in ticks]
    for number, one in enumerate(titles):
        for other in titles[number + 1 :]:
            a, b = boxes[one], boxes[other]
            across, up = min(a.x1, b.x1) - max(a.x0, b.x0), min(a.y1, b.y1) - max(a.y0, b.y0)
            if across > 2.0 and up > 2.0:
                found.append(f"{one.get_text()!r} covers {other.get_text()!r}")
    return found


def _drawn_labels(axis: Any) -> list[Text]:
    low, high = sorted(axis.get_view_interval())
    room = 1e-9 * (high - low)
    return [tick.label1 for tick in axis.get_major_ticks() if low - room <= tick.get_loc() <= high + room]


@pytest.mark.parametrize("job", JOBS, ids=lambda job: f"{job[0]}-{Path(job[2]).name}")
def test_no_text_leaves_a_picture(job: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[Figure] = []
    save = style.save_figure

    def remember(figure: Figure, *arguments: Any) -> Path:
        path = save(figure, *arguments)
        drawn.append(figure)
        return path

    monkeypatch.setattr(style, "save_figure", remember)
    folder = [] if "{}" in job[-1] else [str(tmp_path)]
    result = CliRunner().invoke(app, [*(word.replace("{}", str(tmp_path)) for word in job), *folder])
    assert result.exit_code == 0, result.output
    assert drawn
    for figure in drawn:
        with style.house_style():
            assert problems_of(figure) == [], figure.get_suptitle()


def test_a_long_title_is_written_smaller(tmp_path: Path) -> None:
    with style.house_style():
        figure = style.new_figure(3.3, 2.2)
        figure.suptitle("Spring with the largest share of the deflection, and more words than fit across a column")
        style.save_figure(figure, tmp_path / "wide.png")
        assert problems_of(figure) == []


def test_the_dark_variant(tmp_path: Path) -> None:
    """White becomes dark and black light, colours stay, and the figure is as before."""
    with style.house_style():
        figure = style.new_figure(2.0, 2.0)
        axes = figure.subplots()
        axes.axvspan(0.2, 0.4, color="#0072B2")
        axes.set_title("title")
        light, dark = style.save_pictures(figure, tmp_path / "picture", ("png", "dark.png"))
        assert dark.name == "picture.dark.png"
        again = style.save_figure(figure, tmp_path / "again.png")
    pictures = [imread(path)[..., :3] for path in (light, dark)]
    np.testing.assert_allclose(pictures[0][2, 2], 1.0)
    np.testing.assert_allclose(pictures[1][2, 2], 0.09, atol=0.01)
    blue = np.array([0.0, 0x72, 0xB2]) / 255.0
    for picture in pictures:
        assert (np.abs(picture - blue).max(axis=-1) < 0.01).mean() > 0.05
    assert again.read_bytes() == light.read_bytes()
