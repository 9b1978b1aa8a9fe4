"""Ellipsoids: their block, axes and lengths, and round scales."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError, RigidDirectionError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer import Viewer, objects
from pm3dof_pin.viewer.ellipsoids import (
    DrawnEllipsoid,
    block,
    draw_ellipsoid,
    motion_block,
    round_length,
    round_scale,
)
from pm3dof_pin.viewer.panel import numbers_with_unit, scale_text
from pm3dof_pin.viewer.scene import Scene


def random_stiffness(seed: int) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(6, 6))
    return root @ root.T + 0.1 * np.eye(6)


@pytest.mark.parametrize("kind", ["translation", "rotation"])
def test_blocks(kind: str) -> None:
    """By definition: displacements under unit forces with the other three free, or clamped."""
    k = random_stiffness(3)
    c = np.linalg.inv(k)
    own, other = (slice(0, 3), slice(3, 6)) if kind == "translation" else (slice(3, 6), slice(0, 3))
    # others free: no load in them, so x = C_ff f; others held: x_o = 0, so f = K_ff x
    free = k[own, own] - k[own, other] @ np.linalg.inv(k[other, other]) @ k[other, own]
    held = k[own, own]
    for given in ({"stiffness": k, "compliance": None}, {"stiffness": None, "compliance": c}):
        for of, others, expected in (
            ("stiffness", "free", free),
            ("stiffness", "held", held),
            ("compliance", "free", np.linalg.inv(free)),
            ("compliance", "held", np.linalg.inv(held)),
        ):
            found = block(given["stiffness"], given["compliance"], kind, of, others)
            np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_forces_on_the_ellipsoid_take_drives_of_unit_norm() -> None:
    """Rates M u of unit norm u, and forces f with |M^T f| = 1 by virtual work, both for unit vectors of the sphere."""
    generator = np.random.default_rng(2)
    motions = generator.normal(size=(6, 5))
    sphere = generator.normal(size=(3, 10))
    sphere /= np.linalg.norm(sphere, axis=0)
    for kind, rows in (("translation", slice(0, 3)), ("rotation", slice(3, 6))):
        forces = motion_block(motions, kind, "force") @ sphere
        np.testing.assert_allclose(np.linalg.norm(motions[rows].T @ forces, axis=0), 1.0, rtol=1e-9)
        rates = np.linalg.lstsq(motions[rows], motion_block(motions, kind, "velocity") @ sphere)[0]
        np.testing.assert_allclose(np.linalg.norm(rates, axis=0), 1.0, rtol=1e-9)


def test_rings_are_in_the_three_principal_planes(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of radius 1, each beside the ends of the axes."""
    drawn: list[np.ndarray] = []
    lines = objects.line_segments

    def kept(points: np.ndarray, *args: Any, **options: Any) -> Any:
        drawn.append(points)
        return lines(points, *args, **options)

    monkeypatch.setattr(objects, "line_segments", kept)
    draw_ellipsoid(Scene(), "/ellipsoid", "translation")
    points = drawn[0][6:]
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0, rtol=1e-12)
    flat = points.reshape(3, -1, 3) == 0.0
    assert sorted(int(np.flatnonzero(ring.all(axis=0))[0]) for ring in flat) == [0, 1, 2]


def test_exactly_one_matrix() -> None:
    for both in ((None, None), (np.eye(6), np.eye(6))):
        with pytest.raises(InvalidValueError, match="expected one of them"):
            block(*both, "translation", "stiffness", "held")


def test_rigid_directions_have_a_compliance_only() -> None:
    c = np.diag([1.0, 1.0, 0.0, 1.0, 1.0, 1.0])
    np.testing.assert_array_equal(block(None, c, "translation", "compliance", "free"), np.diag([1.0, 1.0, 0.0]))
    with pytest.raises(SingularConfigurationError, match="no stiffness ellipsoid of translation"):
        block(None, c, "translation", "stiffness", "free")


def test_a_direction_that_only_rounding_moves_is_rigid() -> None:
    """As of a wrist at a singular pose, whose compliance about one axis is 1e-27 instead of zero."""
    C = np.diag([1e-5, 1e-5, 1e-6, 2e-27, 1e-4, 2e-4])
    with pytest.raises(RigidDirectionError, match="rigid"):
        block(None, C, "rotation", "stiffness", "free")
    np.testing.assert_allclose(block(None, C, "translation", "stiffness", "free"), np.diag([1e5, 1e5, 1e6]))


def test_the_transform_is_the_eigen_decomposition() -> None:
    """A unit vector along a principal axis maps to the end of that semi-axis; all others onto the quadric."""
    b = random_stiffness(4)[:3, :3]
    position = np.array([0.1, 0.2, 0.3])
    drawn = DrawnEllipsoid.from_matrix(b, position, scale=0.01, unit="N/m")
    np.testing.assert_allclose(b @ drawn.axes, drawn.axes * drawn.values, atol=1e-12)
    linear = drawn.transform[:3, :3]
    np.testing.assert_allclose(linear, 0.01 * drawn.axes * drawn.values)
    np.testing.assert_array_equal(drawn.transform[:3, 3], position)
    assert np.linalg.det(linear) > 0.0
    for direction in np.random.default_rng(1).normal(size=(10, 3)):
        point = linear @ (direction / np.linalg.norm(direction)) / 0.01
        assert np.linalg.norm(np.linalg.solve(b, point)) == pytest.approx(1.0)


def test_flat_ellipsoids_keep_their_axes() -> None:
    """A zero semi-axis is drawn paper-thin, so that the page still finds the axes."""
    drawn = DrawnEllipsoid.from_matrix(np.diag([0.0, 1.0, 2.0]), np.zeros(3), scale=1.0, unit="")
    lengths = np.linalg.norm(drawn.transform[:3, :3], axis=0)
    np.testing.assert_allclose(lengths, [2e-6, 1.0, 2.0])


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_bad_scale(scale: float, mechanism: Robot) -> None:
    with pytest.raises(InvalidValueError, match="scale"):
        Viewer(mechanism).stiffness_ellipsoid(np.eye(6), scale=scale)


def test_round_scales() -> None:
    for greatest, step in ((2.6e8, 5e8), (2e8, 2e8), (1.0, 1.0), (9.9e-9, 1e-8), (5.1, 10.0)):
        assert round_scale(greatest, 0.2) == pytest.approx(0.2 / step)
    assert round_scale(0.0, 0.2) == 0.2
    for size, length in ((0.26, 0.2), (0.5, 0.5), (0.99, 0.5), (1.0, 1.0), (0.0019, 0.001)):
        assert round_length(size) == pytest.approx(length)


def test_numbers_in_words() -> None:
    for value, text in (
        (1.5292e6, "1.53 MN/m"),
        (0.0412345, "41.2 mN/m"),
        (88.66, "88.7 N/m"),
        (-2.0, "\u22122 N/m"),
        (0.0, "0 N/m"),
        (6.54e-7, "654 nN/m"),
        (999.6, "1 kN/m"),
        (3e13, "30000 GN/m"),
    ):
        assert numbers_with_unit([value], "N/m") == text
    assert numbers_with_unit([64660.0, 429300.0], "N/m") == "64.7 · 429 kN/m"
    assert numbers_with_unit([62600.0, 1e-9, 1.53e6], "N/m") == "0.0626 · 0 · 1.53 MN/m"
    assert numbers_with_unit([1e9, 2.0], "N/m") == "1 GN/m · 2 N/m"
    assert numbers_with_unit([1234.5], "1") == "1230"
    assert scale_text(0.2 / 5e8, 0.2, "N/m", "semi-axis") == "semi-axis of 200 mm = 500 MN/m"
    assert scale_text(0.2 / 1.5, 0.2, "N", "arrow") == "arrow of 200 mm = 1.5 N"


def test_ellipsoids_elsewhere_than_at_the_tool(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    frame = viewer.stiffness_ellipsoid(np.eye(6), at="E1")
    np.testing.assert_allclose(frame.position, mechanism.home.frame_placement("E1").translation)
    point = viewer.stiffness_ellipsoid(np.eye(6), at=[1.0, 2.0, 3.0])
    np.testing.assert_array_equal(point.position, [1.0, 2.0, 3.0])
    assert {"/ellipsoids/translation_at_E1/surface", "/ellipsoids/translation_at_point/surface"} <= set(
        viewer.scene.paths()
    )


def test_scales_stay_for_comparison(mechanism: Robot) -> None:
    viewer = Viewer(mechanism)
    first = viewer.stiffness_ellipsoid(3e6 * np.eye(6))
    viewer.display(mechanism.home)
    assert viewer.stiffness_ellipsoid(30e6 * np.eye(6)).scale == first.scale
    assert viewer.stiffness_ellipsoid(3e6 * np.eye(6), of="compliance").scale != first.scale


@pytest.mark.parametrize("wrong", [{"kind": "twist"}, {"of": "strength"}, {"others": "fixed"}])
def test_words_that_do_not_exist_are_named(mechanism: Robot, wrong: dict[str, Any]) -> None:
    ((name, word),) = wrong.items()
    with pytest.raises(InvalidValueError, match=f"{name} = {word}: expected one of"):
        Viewer(mechanism).stiffness_ellipsoid(np.eye(6), **wrong)
