"""The viewer's rules: items of a configuration, items that the page can update, files, and invalid input."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import BrowserError, FrameNotFoundError, InvalidValueError, OutputError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer
from pm3dof_pin.viewer.browser import VARIABLE, Browser, find_browser


def legend(viewer: Viewer) -> dict[str, dict[str, Any]]:
    return {entry["key"]: entry for entry in viewer.scene.panel["legend"]}


def test_another_configuration_takes_away_what_belonged_to_the_last(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    viewer.stiffness_ellipsoid(np.eye(6))
    viewer.actuator_forces([1.0, 2.0, 3.0])
    viewer.frames()
    assert set(legend(viewer)) == {"translation", "forces", "frames"}
    viewer.display(mechanism.solve([0.1, 0.1, 0.49]).configuration())
    assert set(legend(viewer)) == {"frames"}
    hidden = {
        command["path"]
        for command in viewer.scene.snapshot()["commands"]
        if command["type"] == "set_property" and command["property"] == "visible" and command["value"] is False
    }
    assert {"/ellipsoids/translation", "/forces/slider1_joint"} <= hidden


def test_only_the_machines_own_goes_on(mechanism: Robot) -> None:
    """The page updates elastic stiffness, holding forces and shares of the machine itself, and nothing else."""
    from pm3dof_pin.dynamics.statics import holding_forces

    viewer = Viewer(mechanism)
    model = ElasticModel(mechanism)
    stiffness = cartesian_compliance(model, mechanism.home).stiffness
    own = holding_forces(mechanism.home).actuator_forces
    for factor, goes_on in ((1.0, True), (1.001, False)):
        viewer.stiffness_ellipsoid(factor * stiffness, kind="translation")
        viewer.stiffness_ellipsoid(factor * stiffness, kind="rotation", others="free")
        viewer.actuator_forces(factor * own)
        entries = legend(viewer)
        assert [bool(entries[key]["live"]) for key in ("translation", "rotation", "forces")] == [goes_on] * 3
    viewer.colour_legs(model)
    assert legend(viewer)["legs"]["live"]
    viewer.stiffness_ellipsoid(stiffness, at="E1")
    assert not legend(viewer)["translation_at_E1"]["live"]


def test_nothing_goes_on_without_sliders(mechanism: Robot) -> None:
    viewer = Viewer(mechanism, sliders=False)
    viewer.stiffness_ellipsoid(cartesian_compliance(ElasticModel(mechanism), mechanism.home).stiffness)
    assert legend(viewer)["translation"]["live"] is None
    assert "machine" not in viewer.scene.panel


def test_shares(mechanism: Robot) -> None:
    model = ElasticModel(mechanism)
    shares = Viewer(mechanism).colour_legs(model, [1.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["passive_leg"] > 0.999  # at home nothing else is elastic sideways
    with pytest.raises(InvalidValueError, match="an elastic model of"):
        Viewer(Robot.load("hexapod")).colour_legs(model)


def test_bad_input(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    with pytest.raises(InvalidValueError, match="configuration"):
        viewer.display(Robot.load("hexapod").home)
    with pytest.raises(InvalidValueError, match="forces"):
        viewer.actuator_forces([1.0, 2.0])
    with pytest.raises(InvalidValueError, match="scale"):
        viewer.actuator_forces([1.0, 2.0, 3.0], scale=-1.0)
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        viewer.frames(["nowhere"])
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        viewer.stiffness_ellipsoid(np.eye(6), at="nowhere")


def test_files_go_into_folders_that_exist(mechanism: Robot, tmp_path: Path) -> None:
    viewer = Viewer(mechanism)
    for save in (viewer.save_html, viewer.save_picture):
        with pytest.raises(OutputError, match=r"folder .* does not exist"):
            save(tmp_path / "missing" / "file")
    assert list(tmp_path.iterdir()) == []
    assert viewer.save_html(tmp_path / "page.html").read_text(encoding="utf-8") == viewer.html()
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"]


def test_no_browser_to_take_pictures(mechanism: Robot, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path / "gone"))
    with pytest.raises(BrowserError, match=rf"{VARIABLE}=.*gone: expected the path of Chromium or Chrome"):
        Viewer(mechanism).save_picture(tmp_path / "picture.png")
    monkeypatch.delenv(VARIABLE)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(BrowserError, match="no browser found"):
        find_browser()
    assert list(tmp_path.iterdir()) == []


def test_a_program_that_is_no_browser(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "/bin/true")
    with pytest.raises(BrowserError, match="has ended"):
        Browser()


@pytest.mark.browser
def test_a_picture_is_written(browser: Any, mechanism: Robot, tmp_path: Path) -> None:
    from matplotlib.image import imread

    picture = imread(Viewer(mechanism).save_picture(tmp_path / "picture.png", width=400, height=300))
    assert picture.shape[:2] == (300, 400)
    assert picture[..., :3].std() > 0.05


@pytest.mark.browser
def test_errors_of_a_page_are_seen(browser: Any, tmp_path: Path) -> None:
    """The checks of these tests: errors and requests of a page are detected."""
    (tmp_path / "bad.html").write_text(
        "<script>console.error('one', 2); fetch('http://192.0.2.1/three').catch(() => 0); nothing.at.all</script>"
    )
    browser.errors.clear()
    browser.requests.clear()
    browser.open((tmp_path / "bad.html").as_uri())
    assert "console.error: one 2" in browser.errors
    assert any("nothing is not defined" in error for error in browser.errors)
    assert "http://192.0.2.1/three" in browser.requests
    with pytest.raises(BrowserError, match="boom"):
        browser.evaluate("(() => { throw new Error('boom') })()")
    with pytest.raises(BrowserError, match="ERR_FILE_NOT_FOUND"):
        browser.open((tmp_path / "missing.html").as_uri())


def test_loops_that_are_open_are_shown_as_they_are(mechanism: Robot) -> None:
    """Joint values set by hand: nothing is updated, and the page says how far the loops are open."""
    q = np.array(mechanism.home.q)
    q[mechanism.q_names.index("slider1_joint")] += 0.03
    viewer = Viewer(mechanism)
    viewer.display(q)
    assert viewer.scene.panel["note"][-1] == "loops open by 3e-02 m"
    viewer.actuator_forces([1.0, 2.0, 3.0])
    assert legend(viewer)["forces"]["live"] is None
    viewer.stiffness_ellipsoid(np.eye(6))
    assert legend(viewer)["translation"]["live"] is None


def test_a_path_ends_when_something_else_is_displayed(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    viewer.play([mechanism.home, mechanism.solve([0.1, 0.0, 0.49]).configuration()])

    def has_animation() -> bool:
        return any(command["type"] == "set_animation" for command in viewer.scene.snapshot()["commands"])

    assert has_animation()
    assert viewer.scene.panel["path"]["duration"] == 5.0
    viewer.display(mechanism.home)
    assert not has_animation()
    assert viewer.scene.panel["path"] is None


@pytest.mark.browser
def test_a_turntable_goes_around(browser: object, mechanism: Robot, tmp_path: Path) -> None:
    """The pictures differ, in the machine's own colours, without floor and panel."""
    from PIL import Image

    target = Viewer(mechanism, sliders=False).record(tmp_path / "turn.gif", width=200, height=160, count=3)
    with Image.open(target) as moving:
        assert (moving.n_frames, moving.size) == (3, (200, 160))
        frames = []
        for number in range(3):
            moving.seek(number)
            frames.append(np.asarray(moving.convert("RGB")).astype(float))
    for one, other in ((0, 1), (1, 2), (2, 0)):
        assert np.abs(frames[one] - frames[other]).max() > 50.0
    assert all(np.all(frame[:5, :5] > 245.0) for frame in frames)
    orange = [np.abs(frame - [213.0, 94.0, 0.0]).max(axis=-1).min() for frame in frames]  # of the sliders
    assert max(orange) < 60.0


@pytest.mark.browser
def test_a_path_is_filmed(browser: object, mechanism: Robot, tmp_path: Path) -> None:
    """As many frames as poses, in the path's own time; the machine moves between them."""
    from PIL import Image

    from pm3dof_pin.viewer import film

    viewer = Viewer(mechanism)
    viewer.play(mechanism.solve([[0.0, 0.0, z] for z in (0.46, 0.49, 0.52)]), duration=1.5)
    with Image.open(viewer.record(tmp_path / "path.gif", width=200, height=160)) as moving:
        assert moving.n_frames == 3
        assert moving.info["duration"] == 500
        first, last = (np.asarray([moving.seek(k), moving.convert("RGB")][1]).astype(float) for k in (0, 2))
    assert np.abs(first - last).max() > 50.0
    with pytest.raises(InvalidValueError, match=r"\.gif or \.mp4"):
        viewer.record(tmp_path / "path.avi")
    if film.encoder() is not None:
        data = viewer.record(tmp_path / "path.mp4", width=201, height=160).read_bytes()
        assert data[4:8] == b"ftyp"


@pytest.mark.browser
def test_a_captured_image_is_an_array(browser: object, mechanism: Robot) -> None:
    image = Viewer(mechanism, sliders=False).captureImage(200, 160)
    assert image.shape == (160, 200, 3)
    assert np.all(image[:3, :3] > 245)
    assert image.std() > 10.0


def test_a_solved_pose_is_displayed(mechanism: Robot) -> None:
    viewer = Viewer(mechanism, sliders=False)
    poses = mechanism.solve([[0.0, 0.0, 0.48], [0.1, 0.0, 0.5]])
    viewer.display(poses[1])
    np.testing.assert_allclose(mechanism.at([viewer.configuration.q])[0].coordinates, [0.1, 0.0, 0.5], atol=1e-12)
    with pytest.raises(InvalidValueError, match="2 poses"):
        viewer.display(poses)


def test_sliders_go_on_after_a_path_that_cannot_be_drawn(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    with pytest.raises(InvalidValueError):
        viewer.play([mechanism.home, mechanism.home], stiffness=[np.eye(6), np.full((6, 6), np.nan)])
    viewer.display(mechanism.home)
    viewer.motion_ellipsoid("velocity")
    assert legend(viewer)["translation"]["live"]


def test_what_is_missing_in_the_page_is_said_there(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    path = tmp_path / "crank.xml"
    body = '<body name="base">{}<geom size=".1"/><body pos="1 0 0"><joint name="crank" axis="0 0 1"/><geom size=".1"/>'
    body += '<site name="tool"/></body></body>'
    text = f"<mujoco model='crank'><worldbody>{body}</worldbody><actuator><motor joint='crank'/></actuator></mujoco>"
    path.write_text(text.format("<freejoint/>"), encoding="utf-8")
    floating = Viewer(Robot.load(path).with_drive_stiffness(1e3))
    assert floating.scene.panel["lacks"] == ["the base 'base' floats (--hold-base): stiffness ellipsoids are not drawn"]
    path.write_text(text.format(""), encoding="utf-8")
    monkeypatch.setattr("pm3dof_pin.viewer.viewer.programs_of", lambda *_: None)
    monkeypatch.setattr(Robot, "reason_without_programs", lambda _: "it is too large")
    assert Viewer(Robot.load(path)).scene.panel["lacks"] == [
        "Crank has no springs (--drive-stiffness) in its description: stiffness ellipsoids are not drawn",
        "no sliders: it is too large",
    ]


def test_frames_by_their_numbers_as_in_pinocchio(mechanism: Robot) -> None:
    viewer = Viewer(mechanism, sliders=False)
    tool = mechanism.tool_frame_id
    viewer.displayFrames(True, [tool])
    assert legend(viewer)["frames"]["lines"][0] == mechanism.tool_frame
    viewer.displayFrames(True)
    assert len(legend(viewer)["frames"]["nodes"]) > 1
    viewer.displayFrames(False)
    assert "frames" not in legend(viewer)
    with pytest.raises(InvalidValueError, match="9999"):
        viewer.displayFrames(True, [9999])


def test_a_script_for_pinocchios_visualizer_runs(mechanism: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = []
    monkeypatch.setattr(Viewer, "open", lambda viewer: opened.append(viewer))
    viewer = Viewer(mechanism, sliders=False)
    viewer.initViewer(open=False)
    viewer.initViewer(loadModel=True)
    assert not opened
    viewer.initViewer(open=True)
    assert opened == [viewer]
    viewer.display(mechanism.solve(np.array(mechanism.home_coordinates) + 1e-3))
    viewer.loadViewerModel()
    np.testing.assert_array_equal(viewer.configuration.q, mechanism.home.q)
