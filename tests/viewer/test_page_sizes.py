"""The page of every robot on desktop and phone, light and dark: nothing overlaps or overflows, no errors."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer

pytestmark = pytest.mark.browser

ROBOTS = ("pm3dof", "hexapod", "three_rps", "linear_delta")
SIZES = ((1400, 900), (420, 800))
PICTURES = ((1400, "dark"), (420, "light"))
BOX = "name => { const { left, top, right, bottom } = document.querySelector(name).getBoundingClientRect();"
BOX += " return [left, top, right, bottom]; }"


@pytest.fixture
def sized(page: Any) -> Iterator[Any]:
    yield page
    page.browser.resize(800, 600)


@pytest.mark.parametrize("name", ROBOTS)
def test_the_page_fits_and_is_readable(sized: Any, load: Callable[[str], Robot], name: str, tmp_path: Path) -> None:
    robot = load(name)
    viewer = Viewer(robot)
    compliance = cartesian_compliance(ElasticModel(robot), robot.home).compliance
    for kind in ("translation", "rotation"):
        viewer.stiffness_ellipsoid(compliance=compliance, kind=kind, of="compliance")
    file = viewer.save_html(tmp_path / "page.html")
    assert file.stat().st_size < 2.5e6
    sized.open(file.as_uri())
    for width, height in SIZES:
        sized.browser.resize(width, height)
        for theme in ("light", "dark"):
            sized.call("theme => pm3dof.setTheme(theme)", theme)
            sized.browser.settle()
            assert sized.ask("document.documentElement.scrollWidth") <= width
            panel, note, pane = (sized.call(BOX, box) for box in ("#panel", "#note", "#meshcat-pane"))
            assert panel[3] <= note[1] + 1.0
            assert all(box[0] >= 0.0 and box[2] <= width and box[3] <= height + 1.0 for box in (panel, note))
            assert (panel[1] >= pane[3] - 1.0) == (width == 420)  # below the machine on a phone, beside it else
            ink, card = (
                sized.ask(f"getComputedStyle(document.querySelector('#panel')).{of}")
                for of in ("color", "backgroundColor")
            )
            assert abs(luminance(ink) - luminance(card)) > 0.5, (theme, ink, card)
            if (width, theme) in PICTURES:
                assert sized.picture().std() > 0.03
    assert sized.browser.errors == []


def luminance(colour: str) -> float:
    """Approximate relative luminance of a colour in the browser's notation: rgb(…) or rgba(…)."""
    red, green, blue = (float(part) / 255.0 for part in colour[colour.index("(") + 1 : -1].split(",")[:3])
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
