"""The boundary of a set as faces with sharp edges and corners, given only which points are inside.

Dual contouring: T. Ju, F. Losasso, S. Schaefer and J. Warren, Dual contouring of Hermite data, SIGGRAPH 2002. Every
edge of a grid that leaves the set has a face across it; the corners of the face lie in the cells around the edge,
at the intersection of the nearby tangent planes of the boundary. So a set may have any shape, and faces end where one
limit takes over from another. In a plane, the faces are line segments.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.maps.limit_space import Flags
from pm3dof_pin.typing import Array

_HALVINGS = 16  # bisections of an edge to find the boundary
_ASIDE = 0.004  # cells from a crossing to where the boundary is found again, to measure its slope
_STEEPEST = 30.0  # greatest measured slope relative to an edge
_SMOOTH = 0.03  # curvature of the sum of squares, relative to the greatest, below which planes do not intersect
_BEYOND = 0.5  # cells that a corner may lie outside its own, as for tips


@dataclass(frozen=True, eq=False)
class BoundaryFaces:
    """Faces of the boundary: line segments in a plane, quadrilaterals in space."""

    corners: Array  #: in order around the face, shape=(n, 2, 2) or (n, 4, 3) [m, rad]
    normals: Array  #: covectors across the boundary, outward, shape=(n, 2) or (n, 3) [1/m, 1/rad]
    limits: Flags  #: sums of the limits broken behind each face, shape=(n,)


def boundary_faces(broken_limits: Callable[[Array], Flags], ranges: Array, cells: int) -> BoundaryFaces:
    """Find the boundary of the points that break no limit.

    Args:
        broken_limits: function from points, shape=(..., d), to the sums of the limits that they break, shape=(...).
        ranges: a box around the set, which is closed at its sides, shape=(d, 2) with d = 2 or 3 [m, rad].
        cells: cells of the grid along each side of the box, and of the layer around it.
    """
    d = len(ranges)
    step = np.ptp(ranges, axis=1) / (cells - 2)

    def flags(places: Array) -> Flags:
        return broken_limits(ranges[:, 0] + step * (places - 1.0))

    unit = np.eye(d)
    nodes = np.stack(np.meshgrid(*[np.arange(1.0, cells)] * d, indexing="ij"), axis=-1)
    inside = np.pad(flags(nodes) == 0, 1)
    crossed = [np.argwhere(np.diff(inside, axis=k)) for k in range(d)]
    start, axis = np.concatenate(crossed), np.repeat(np.arange(d), [len(found) for found in crossed])
    leaves = inside[tuple(start.T)]
    outward = np.where(leaves, 1.0, -1.0)[:, None] * unit[axis]
    inner = np.where(leaves[:, None], start, start + unit[axis])

    def crossing(inner: Array, outer: Array) -> tuple[Array, Array]:
        for _ in range(_HALVINGS):
            middle = 0.5 * (inner + outer)
            keeps = (flags(middle) == 0)[:, None]
            inner, outer = np.where(keeps, middle, inner), np.where(keeps, outer, middle)
        return inner, outer

    points, beyond = crossing(inner, inner + outward)
    normals, reach = outward.copy(), _STEEPEST * _ASIDE * outward
    for turn in range(1, d):
        across = unit[(axis + turn) % d]
        aside = points + _ASIDE * across
        slope = np.sum((crossing(aside - reach, aside + reach)[0] - points) * outward, axis=1) / _ASIDE
        normals -= slope[:, None] * across
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)

    ring = np.array([[0, 0], [-1, 0], [-1, -1], [0, -1]] if d > 2 else [[0], [-1]])  # of the cells around an edge
    around = np.zeros((len(start), len(ring), d), dtype=np.intp)
    for turn in range(1, d):
        around[np.arange(len(start)), :, (axis + turn) % d] = ring[:, turn - 1]
    around += start[:, None]
    found, corner = np.unique(np.ravel_multi_index(np.moveaxis(around, -1, 0), (cells,) * d), return_inverse=True)
    corner = corner.reshape(around.shape[:2])
    places = _meeting_points(corner, points, normals, np.stack(np.unravel_index(found, (cells,) * d), axis=-1))
    turned = leaves == ((d == 2) & (axis == 0))  # for these cells the ring is reversed
    corner[turned] = corner[turned][:, ::-1]
    return BoundaryFaces(ranges[:, 0] + step * (places[corner] - 1.0), normals / step, flags(beyond))


def _meeting_points(corner: NDArray[np.intp], points: Array, normals: Array, cells: NDArray[np.intp]) -> Array:
    """Return the point of each cell nearest to the planes through the points on its edges, shape=(cells, d)."""
    of_cell = corner.ravel()
    point, normal = (np.repeat(array, corner.shape[1], axis=0) for array in (points, normals))

    def summed(terms: Array) -> Array:
        total = np.zeros((len(cells), *terms.shape[1:]))
        np.add.at(total, of_cell, terms)
        return total

    middle = summed(point) / np.bincount(of_cell)[:, None]
    distance = np.sum((point - middle[of_cell]) * normal, axis=1)
    curvatures, directions = np.linalg.eigh(summed(normal[:, :, None] * normal[:, None, :]))
    share = np.einsum("nji,nj->ni", directions, summed(normal * distance[:, None]))
    meets = curvatures > _SMOOTH * curvatures[:, -1:]
    moves = np.where(meets, share / np.where(meets, curvatures, 1.0), 0.0)
    found = middle + np.einsum("nij,nj->ni", directions, moves)
    return np.asarray(np.clip(found, cells - _BEYOND, cells + 1.0 + _BEYOND))
