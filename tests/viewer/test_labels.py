"""Labels in the scene: which, where, and as self-contained pictures."""

from __future__ import annotations

import base64
from collections.abc import Callable
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer
from pm3dof_pin.viewer.labels import label, measures, point_names


def test_points_of_the_chapters_figure(mechanism: Robot) -> None:
    found = point_names(mechanism.home)
    assert found["O_e"] == "O_{e} = P"
    assert {f"{letter}{leg}" for letter in "BMDEF" for leg in (1, 2, 3)} < set(found)
    assert found["B2"] == "B_{2}"


def test_lengths_and_angles_stand_at_their_leg(mechanism: Robot, tripod: Tripod) -> None:
    found = measures(mechanism.home)
    assert set(found) == {"O_b", r"\alpha_i", r"\beta_i", r"\gamma", "l_b", "u_i", "l_i", "l_e", "z_0", "z_e"}
    home = tripod.height_home
    frame, place = found["z_0"]
    np.testing.assert_allclose(place, [0.0, 0.0, home + 0.5 * 0.013], atol=1e-9)
    assert frame == "E3"  # it moves with the platform
    np.testing.assert_allclose(found["l_b"][1], 0.6 * tripod.base_joints[2], atol=1e-9)
    assert measures(Robot.load("hexapod").home) == {}


def test_a_label_is_a_picture_with_its_data() -> None:
    sprite = label(r"\alpha_i", 0.1, measure=True)
    assert sprite["object"]["type"] == "Sprite"
    kind, _, data = sprite["images"][0]["url"].partition(",")
    assert kind == "data:image/png;base64"
    assert base64.b64decode(data).startswith(b"\x89PNG")
    assert sprite["object"]["matrix"][5] == pytest.approx(0.1)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod"])
def test_labels_are_drawn_on_bodies(load: Callable[[str], Robot], name: str) -> None:
    with Viewer(load(name)) as viewer:
        drawn: list[tuple[str, str]] = []
        original = viewer.scene.set_object
        viewer.scene.set_object = lambda path, scene_object, **options: (  # type: ignore[method-assign]
            drawn.append((path, scene_object["object"]["type"])),
            original(path, scene_object, **options),
        )[1]
        viewer.labels()
        assert len(drawn) >= 7
        assert {kind for _, kind in drawn} == {"Sprite"}
        assert all("/labels/" in path for path, _ in drawn)
        assert len({path.partition("/labels/")[0] for path, _ in drawn}) > 1  # several bodies


PLACES = """(() => {
    const entry = pm3dof.panel().legend.find(({ key }) => key === "labels"), at = new MeshCat.THREE.Vector3();
    return entry.nodes.map((path) => pm3dof.node(path).object).filter(({ visible }) => visible).map((object) =>
        pm3dof.project(pm3dof.viewer.scene.worldToLocal(object.getWorldPosition(at)).toArray()));
})()"""


@pytest.mark.browser
def test_a_name_behind_another_is_hidden(page: Any, load: Callable[[str], Robot], tmp_path: Path) -> None:
    """Seen from the front, two of the hexapod's base joints are behind two of its platform's."""
    with Viewer(load("hexapod")) as viewer:
        viewer.labels()
        page.open(viewer.save_html(tmp_path / "page.html").as_uri())
    shown = np.array(page.ask(PLACES))
    assert 8 <= len(shown) < 14  # six and six joints, and the frames of base and tool
    assert min(np.abs(a - b).max() for a, b in combinations(shown, 2)) > 6.0
    page.ask("pm3dof.turn(90), pm3dof.viewer.render()")
    assert not np.array_equal(page.ask(PLACES), shown)
    assert page.browser.errors == []
