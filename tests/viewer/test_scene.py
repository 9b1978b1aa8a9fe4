"""The tree of commands: what a late page receives, and what is forwarded."""

from __future__ import annotations

import json
import re
from typing import Any

import numpy as np

from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.scene import Scene
from pm3dof_pin.viewer.showing import _page_html


def kinds(message: dict[str, Any]) -> list[tuple[str, str]]:
    return [(command["type"], command.get("path", command.get("name"))) for command in message["commands"]]


def ball() -> dict[str, Any]:
    return objects.mesh(objects.sphere(1.0), (1.0, 0.0, 0.0))


def test_a_snapshot_says_everything_once() -> None:
    scene = Scene()
    scene.set_object("/a/b", ball())
    for step in range(3):
        scene.set_transform("/a/b", objects.transform(translation=[step, 0.0, 0.0]))
        scene.set_visible("/a", step == 1)
    snapshot = scene.snapshot()
    assert kinds(snapshot) == [
        ("set_object", "/a/b"),
        ("set_transform", "/a/b"),
        ("set_property", "/a"),
    ]
    by_kind = {command["type"]: command for command in snapshot["commands"]}
    assert by_kind["set_transform"]["matrix"][12] == 2.0  # column by column: the translation comes last
    assert by_kind["set_property"]["value"] is False


def test_objects_come_before_their_properties() -> None:
    """Properties of a replaced object would be lost if they came first."""
    scene = Scene()
    scene.set_object("/a", ball(), casts_shadow=False)
    scene.set_object("/b", ball())
    types = [command["type"] for command in scene.snapshot()["commands"]]
    assert types == ["set_object", "set_object", "set_property", "set_property"]
    assert scene.snapshot()["commands"][2]["path"] == "/a/<object>"


def test_deleting_takes_all_below() -> None:
    scene = Scene()
    for path in ("/a", "/a/b", "/a/b/c", "/ab"):
        scene.set_object(path, ball())
    scene.delete("/a/b")
    assert scene.paths() == ("/a", "/ab")


def test_a_listener_hears_what_comes_after_its_snapshot() -> None:
    scene = Scene()
    scene.set_object("/before", ball())
    heard: list[dict[str, Any]] = []
    first = scene.listen(heard.append)
    scene.set_transforms({"/x": np.eye(4), "/y": np.eye(4)})
    scene.set_panel({"title": "new"})
    scene.unsubscribe(heard.append)
    scene.delete("/x")
    assert kinds(first) == [("set_object", "/before")]
    assert [kinds(message) for message in heard if "commands" in message] == [
        [("set_transform", "/x"), ("set_transform", "/y")]
    ]
    assert heard[-1] == {"panel": {"title": "new"}}


def test_numbers_go_through_json_unchanged() -> None:
    """Transforms arrive in the page bit for bit."""
    matrix = np.random.default_rng(0).normal(size=(4, 4))
    scene = Scene()
    scene.set_transform("/a", matrix)
    (command,) = json.loads(json.dumps(scene.snapshot()))["commands"]
    np.testing.assert_array_equal(np.reshape(command["matrix"], (4, 4)).T, matrix)


def test_a_page_needs_nothing_else() -> None:
    """It contains no URL except a namespace, and data cannot end its own element."""
    scene = Scene()
    scene.set_object("/</script><b>", ball())
    page = _page_html(scene.snapshot(), title="<a & b>", served=False)
    assert "<title>&lt;a &amp; b&gt;</title>" in page
    assert page.count("</script>") == page.count("<script")
    without_licences = re.sub(r'<script type="text/plain" id="licences">.*?</script>', "", page, flags=re.DOTALL)
    assert set(re.findall(r"https?://[\w./-]+", without_licences)) <= {
        "http://www.w3.org/1999/xhtml",
        "http://www.w3.org/2000/svg",
    }
    assert "Permission is hereby granted" in page
    assert 'src="' not in page


def test_turning_z_to_a_direction() -> None:
    generator = np.random.default_rng(1)
    for direction in [*np.eye(3), *-np.eye(3), *generator.normal(size=(20, 3))]:
        turn = objects.turn_z_to(direction)
        np.testing.assert_allclose(turn[:, 2], direction / np.linalg.norm(direction), atol=1e-15)
        np.testing.assert_allclose(turn @ turn.T, np.eye(3), atol=1e-15)
        assert np.linalg.det(turn) > 0.0
