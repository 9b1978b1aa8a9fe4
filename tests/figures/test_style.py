"""Pictures on disk: atomic, identical bytes for identical pictures, and the user's settings unchanged."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import pytest
from PIL import Image

import pm3dof_pin
from pm3dof_pin.chapter.limits import LIMIT_NAMES as NAMES
from pm3dof_pin.exceptions import OutputError
from pm3dof_pin.figures.style import LIMIT_STYLES, house_style, limit_styles, new_figure, save_figure, save_pictures


def _draw(path: Path) -> bytes:
    with house_style():
        figure = new_figure(3.0, 2.0)
        figure.add_subplot().plot([0.0, 1.0], [0.0, 1.0], label="line")
    return save_figure(figure, path).read_bytes()


def test_equal_pictures_give_equal_bytes(tmp_path: Path) -> None:
    first = _draw(tmp_path / "first.png")
    with matplotlib.rc_context({"font.size": 22.0, "lines.linewidth": 9.0, "savefig.facecolor": "black"}):
        second = _draw(tmp_path / "second.png")
    assert first.startswith(b"\x89PNG")
    assert first == second
    assert b"matplotlib" not in first.lower()


def test_a_picture_says_what_it_shows_and_where_it_is_from(tmp_path: Path) -> None:
    with house_style():
        figure = new_figure(3.0, 2.0)
        figure.suptitle("Stiffness along $z$: hexapod\nsection $r_x$ = 0.0 deg")
    expected = {
        "Title": "Stiffness along z: hexapod; section r_x = 0.0 deg",
        "Software": f"pm3dof-pin {pm3dof_pin.__version__}",
        "Comment": "pm3dof stiffness-map",
    }
    (path,) = save_pictures(figure, tmp_path / "picture.png", command="pm3dof stiffness-map")
    with Image.open(path) as picture:
        assert picture.info.items() >= expected.items()
    for text in expected.values():
        assert text in save_figure(figure, tmp_path / "picture.svg", "pm3dof stiffness-map").read_text()


@pytest.mark.parametrize("kind", ["pdf", "svg"])
def test_lines_and_letters_on_paper(kind: str, tmp_path: Path) -> None:
    pictures = {_draw(tmp_path / f"{name}.{kind}") for name in ("first", "second")}
    assert len(pictures) == 1
    assert pictures.pop().startswith(b"%PDF" if kind == "pdf" else b"<?xml")


def test_settings_of_the_user_are_left_alone(tmp_path: Path) -> None:
    before = dict(matplotlib.rcParams)
    _draw(tmp_path / "picture.png")
    assert dict(matplotlib.rcParams) == before


def test_a_folder_that_cannot_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(OutputError, match=r"picture\.png"):
        save_figure(new_figure(1.0, 1.0), tmp_path / "file" / "picture.png")
    assert [path.name for path in tmp_path.rglob("*")] == ["file"]


def test_every_limit_has_a_colour_and_a_name() -> None:
    assert set(LIMIT_STYLES) == set(NAMES)
    assert len({color for color, _ in LIMIT_STYLES.values()}) == len(NAMES)
    others = limit_styles(("reach", "knee_joint", "ankle_joint", "tip-B"))
    assert len({color for color, _ in others.values()}) == 4
    assert others["knee_joint"][1] == "knee joint"
