"""Paths: ellipsoids rotate to their neighbours by the least rotation, and keep their shape."""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer
from pm3dof_pin.viewer.animation import _aligned_ellipsoids, clips


def turning_ellipsoids() -> list[np.ndarray]:
    """Values that change their order along the path, with rotating axes, as LAPACK returns them."""
    transforms = []
    for place in np.linspace(0.0, 1.0, 40):
        turn = pin.exp3(place * np.array([0.5, -1.0, 0.7]))
        values, axes = np.linalg.eigh(turn @ np.diag([1.0 + place, 2.0 - place, 1.2]) @ turn.T)
        axes[:, 2] *= np.linalg.det(axes)
        transform = np.eye(4)
        transform[:3, :3] = axes * values
        transforms.append(transform)
    return transforms


def test_aligned_ellipsoids_are_the_same_ellipsoids() -> None:
    transforms = turning_ellipsoids()
    for before, after in zip(transforms, _aligned_ellipsoids(transforms), strict=True):
        np.testing.assert_allclose(after[:3, :3] @ after[:3, :3].T, before[:3, :3] @ before[:3, :3].T, atol=1e-12)
        assert np.linalg.det(after[:3, :3]) > 0.0


def test_neighbours_are_near() -> None:
    """As the axes turn by 1.3 rad in 39 steps, no aligned frame turns by more than a few hundredths."""
    aligned = _aligned_ellipsoids(turning_ellipsoids())
    for before, after in itertools.pairwise(aligned):
        first, second = (m[:3, :3] / np.linalg.norm(m[:3, :3], axis=0) for m in (before, after))
        assert np.linalg.norm(pin.log3(first.T @ second)) < 0.06


def test_tracks() -> None:
    turn = pin.exp3(np.array([0.0, 0.0, 3.0]))
    frames = [np.eye(4), np.eye(4)]
    frames[1][:3, :3] = turn * np.array([1.0, 2.0, 3.0])
    frames[1][:3, 3] = [4.0, 5.0, 6.0]
    (entry,) = clips({"/a": frames}, 20.0)
    assert (entry["path"], entry["clip"]["fps"]) == ("/a", 20.0)
    tracks = {track["name"]: [key["value"] for key in track["keys"]] for track in entry["clip"]["tracks"]}
    np.testing.assert_allclose(tracks[".position"][1], [4.0, 5.0, 6.0])
    np.testing.assert_allclose(tracks[".scale"][1], [1.0, 2.0, 3.0])
    np.testing.assert_allclose(tracks[".quaternion"], [[0, 0, 0, 1], [0, 0, np.sin(1.5), np.cos(1.5)]], atol=1e-12)


def test_bad_paths(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    home = mechanism.home
    with pytest.raises(InvalidValueError, match="at least two"):
        viewer.play([home])
    with pytest.raises(InvalidValueError, match="one for each of 2 frames"):
        viewer.play([home, home], stiffness=[np.eye(6)])
    with pytest.raises(InvalidValueError, match="duration"):
        viewer.play([home, home], duration=0.0)


def test_a_path_says_how_far_singular_poses_are(load: Callable[[str], Robot]) -> None:
    """A hexapod is singular if turned by 90 degrees (E. Fichter, 1986); the distance is linear in the angle."""
    hexapod = load("hexapod")
    poses = [[0.0, 0.0, 0.135, 0.0, 0.0, np.radians(turn)] for turn in (0.0, 89.8, 89.9, 90.0)]
    with Viewer(hexapod) as viewer:
        viewer.play(list(hexapod.solve(poses)))
        page = viewer.html()
    (scene,) = re.findall(r'<script id="scene" type="application/json">(.*?)</script>', page, re.DOTALL)
    home, twice, once, none = json.loads(scene)["panel"]["path"]["singularity"]["parallel"]
    assert none < 1e-9 < once < home
    assert twice / once == pytest.approx(2.0, rel=1e-3)
