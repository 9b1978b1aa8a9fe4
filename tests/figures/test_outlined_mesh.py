"""Triangles up to an exact outline: a disc, a ring and a half plane, whose areas and outlines are known."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.figures.outlined_mesh import OutlinedMesh, outlined_mesh
from pm3dof_pin.typing import Array, Mask

X, Y = np.linspace(-1.2, 1.1, 47), np.linspace(-1.3, 1.2, 45)
SHAPES = {"disc": np.pi, "ring": np.pi * (1.0 - 0.36), "half plane": 1.1 * 2.5}


def _within(shape: str, points: Array) -> Mask:
    radius = np.linalg.norm(points, axis=-1)
    found: Mask = {"disc": radius < 1.0, "ring": (radius < 1.0) & (radius > 0.6), "half plane": points[..., 0] > 0.0}[
        shape
    ]
    return found


def _mesh(shape: str, x: Array = X, y: Array = Y) -> tuple[OutlinedMesh, Array]:
    places = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
    inside = _within(shape, places)
    field = np.where(inside, 3.0 + places[..., 0] - 2.0 * places[..., 1], np.nan)
    return outlined_mesh(x, y, inside, lambda points: _within(shape, points)), field


@pytest.mark.parametrize("shape", SHAPES)
def test_triangles_fill_the_shape_once(shape: str) -> None:
    mesh, _ = _mesh(shape)
    a, b, c = (mesh.points[mesh.triangles[:, k]] for k in range(3))
    areas = np.abs(0.5 * np.linalg.det(np.stack([b - a, c - a], axis=-1)))
    assert areas.sum() == pytest.approx(SHAPES[shape], rel=3e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_limit_lines_lie_on_the_outline_and_end_lines_on_the_rim(shape: str) -> None:
    mesh, _ = _mesh(shape)
    points = mesh.points[np.concatenate(mesh.limit_lines)]
    radii = np.linalg.norm(points, axis=1)
    off = {"disc": radii - 1.0, "ring": np.minimum(abs(radii - 1.0), abs(radii - 0.6)), "half plane": points[:, 0]}
    np.testing.assert_allclose(off[shape], 0.0, atol=1e-4)
    if shape == "half plane":
        (line,) = mesh.end_lines  # one, for continuous dashes
        length = np.linalg.norm(np.diff(mesh.points[line], axis=0), axis=-1).sum()
        assert length == pytest.approx(2.5 + 2 * 1.1, rel=1e-3)
    else:
        assert not len(mesh.end_lines)


@pytest.mark.parametrize("coarse", [False, True])
def test_a_linear_field_stays_linear_up_to_the_outline(coarse: bool) -> None:
    mesh, field = _mesh("disc", *((X[::6], Y[::6]) if coarse else (X, Y)))
    exact = 10.0 + mesh.points[:, 0] - 2.0 * mesh.points[:, 1]
    # positive values are extrapolated by their logarithm
    np.testing.assert_allclose(mesh.values(field + 7.0), exact, atol=0.15 if coarse else 2e-3)
    radii = np.linalg.norm(mesh.points[np.concatenate(mesh.limit_lines)], axis=1)
    np.testing.assert_allclose(radii, 1.0, atol=1e-4)


def test_a_hole_without_a_limit_stays_open() -> None:
    places = np.stack(np.meshgrid(X, Y, indexing="ij"), axis=-1)
    hole = np.linalg.norm(places, axis=-1) < 0.3
    mesh = outlined_mesh(X, Y, ~hole, lambda points: np.ones(len(points), dtype=bool), np.zeros(hole.shape, dtype=bool))
    centres = mesh.points[mesh.triangles].mean(axis=1)
    assert np.linalg.norm(centres, axis=1).min() > 0.2
