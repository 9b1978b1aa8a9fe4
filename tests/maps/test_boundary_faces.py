"""Boundaries of sets of known shape: sharp edges, corners, tips, holes and parts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from pm3dof_pin.maps.boundary_faces import BoundaryFaces, boundary_faces
from pm3dof_pin.maps.limit_space import Flags
from pm3dof_pin.typing import Array

TURN = np.linalg.qr([[3.0, 1.0, 0.5], [-1.0, 2.0, 0.3], [0.2, -0.7, 1.9]])[0]


def polytope(normals: Array, distances: Array) -> Callable[[Array], Flags]:
    """Return bit masks of the planes n p <= d that points are beyond."""

    def broken(points: Array) -> Flags:
        return ((points @ normals.T > distances) @ (1 << np.arange(len(normals)))).astype(np.uint32)

    return broken


def box(size: float, dimensions: int) -> Array:
    return np.array([[-size, size]] * dimensions)


def closed(faces: BoundaryFaces) -> bool:
    """Whether each side of a face, or each end of a line, is met once in each direction."""
    corners = np.round(faces.corners, 9)
    following = np.roll(corners, -1, axis=1)
    if corners.shape[1] == 2:
        starts, ends = (np.unique(corners[:, k], axis=0) for k in (0, 1))
        return bool(np.array_equal(starts, ends))
    ways = np.stack([corners, following], axis=2).reshape(-1, 6)
    back = np.stack([following, corners], axis=2).reshape(-1, 6)
    return bool(np.array_equal(*(w[np.lexsort(w.T)] for w in (ways, back))))


def areas(faces: BoundaryFaces) -> Array:
    """Normals of quadrilaterals with the length of their area."""
    p = faces.corners
    return 0.5 * np.cross(p[:, 2] - p[:, 0], p[:, 3] - p[:, 1])


def test_a_turned_cube_has_its_edges_and_corners() -> None:
    normals, distances = np.vstack([TURN, -TURN]), np.full(6, 0.5)
    faces = boundary_faces(polytope(normals, distances), box(0.9, 3), 21)
    assert closed(faces)
    # corners are on the planes that are broken behind their face: on edges on two, at corners on three
    side = np.log2(faces.limits).astype(int)
    off = np.einsum("nkd,nd->nk", faces.corners, normals[side]) - 0.5
    assert np.abs(off).max() < 0.01 * 1.8 / 19  # a hundredth of a cell
    lengths = np.linalg.norm(faces.normals, axis=1, keepdims=True)
    np.testing.assert_allclose(faces.normals / lengths, normals[side], atol=5e-3)
    for k in range(6):
        np.testing.assert_allclose(areas(faces)[side == k].sum(axis=0), normals[k], atol=1e-3)


@pytest.mark.parametrize("cells", [16, 31])
def test_a_ball_is_round(cells: int) -> None:
    def broken(points: Array) -> Flags:
        return (np.sum(points**2, axis=-1) > 1.0).astype(np.uint32)

    faces = boundary_faces(broken, box(1.0, 3), cells)
    assert closed(faces)
    step = 2.0 / (cells - 2)
    np.testing.assert_allclose(np.linalg.norm(faces.corners, axis=-1), 1.0, atol=step**2)
    assert np.linalg.norm(areas(faces), axis=1).sum() == pytest.approx(4.0 * np.pi, rel=step**2)


def test_a_plane_set_with_a_hole_and_a_tip() -> None:
    """A slender triangle of base 0.3 and height 1.5, with a round hole, next to a rotated square of side 0.2."""
    across, along = np.array([np.cos(0.4), np.sin(0.4)]), np.array([-np.sin(0.4), np.cos(0.4)])
    square = polytope(np.array([across, along, -across, -along]), np.full(4, 0.1))
    triangle = polytope(np.array([[-1.0, 0.1], [1.0, 0.1], [0.0, -1.0]]), np.array([0.1, 0.1, 0.5]))

    def broken(points: Array) -> Flags:
        hole = np.sum((points - [0.0, -0.4]) ** 2, axis=-1) < 0.05**2
        return (((triangle(points) > 0) | hole) & (square(points - [0.6, 0.2]) > 0)).astype(np.uint32)

    faces = boundary_faces(broken, box(1.0, 2), 80)
    assert closed(faces)
    lengths = np.linalg.norm(faces.corners[:, 1] - faces.corners[:, 0], axis=-1)
    of_square = faces.corners[:, 0, 0] > 0.3
    of_hole = np.linalg.norm(faces.corners[:, 0] - [0.0, -0.4], axis=-1) < 0.06
    assert lengths[of_square].sum() == pytest.approx(0.8, rel=1e-3)
    assert lengths[of_hole].sum() == pytest.approx(2.0 * np.pi * 0.05, rel=0.05)  # of two cells
    assert lengths[~of_square & ~of_hole].sum() == pytest.approx(0.3 + 2.0 * np.hypot(0.15, 1.5), rel=1e-3)
    assert faces.corners[..., 1].max() == pytest.approx(1.0, abs=5e-3)  # the tip


def test_a_set_beyond_the_box_is_closed_there() -> None:
    faces = boundary_faces(lambda points: np.zeros(points.shape[:-1], dtype=np.uint32), box(1.0, 3), 8)
    assert closed(faces)
    assert np.abs(faces.corners).max() < 1.0 + 2.0 / 6.0 + 1e-9
