"""Sets of forces or rates that bounded drives can give: convex polytopes as inequalities, for many poses at once.

A polytope is {x : N x <= b} with unit normals N, shape=(..., m, d), and offsets b, shape=(..., m). With as many drives
as degrees of freedom the set of forces is a parallelepiped; with more it is a zonotope, the image of a box under a
linear map (T. Yoshikawa, Foundations of Robotics, 1990; R. Finotello et al., ICRA 1998). All lengths below are measured
from the origin, the state without load, which gravity may push out of the set: then they are negative or NaN. Those of
unsolved poses are NaN.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations, product

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Matrix

_PARALLEL = 1e-10  # relative length of a normal to generators that are linearly dependent
_UNFELT = 1e-9  # cosine of a direction and a normal at right angles, of descriptions with ten digits
_AT_ONCE = 1_000_000  # numbers of generators whose normals are found together

MOST_FACETS = 100_000
"""Most pairs of facets of the image of a box: 28 drives of a body in space have 98,280."""


def pairs_of_facets(drives: int, dimensions: int) -> int:
    """Return how many pairs of facets the image of a box of one dimension per drive may have."""
    return math.comb(drives, dimensions - 1)


@dataclass(frozen=True, eq=False)
class Polytopes:
    """Convex polytopes {x : N x <= b}, one for each pose of a batch.

    Example:
        Two drives of 3 and 2 N along axes at right angles push at most 2 N in every direction:

        >>> import numpy as np
        >>> from pm3dof_pin.capability.polytopes import Polytopes
        >>> forces = Polytopes.from_box(np.eye(2), [-3.0, -2.0], [3.0, 2.0])
        >>> float(forces.ball_radius), forces.extent([1.0, 0.0]).tolist()
        (2.0, 3.0)
    """

    normals: Array  #: outward unit normals, shape=(..., m, d)
    offsets: Array  #: distances of the facets from the origin, negative if it is outside, shape=(..., m)

    @classmethod
    def from_inequalities(cls, rows: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> Polytopes:
        """Return {x : lower <= R x <= upper}, as of speeds: R maps rates of the tool to those of the drives.

        Args:
            rows: R, shape=(..., u, d).
            lower: least values, shape=(..., u); may be infinite.
            upper: greatest values, shape=(..., u); may be infinite.
        """
        matrix = np.asarray(rows, dtype=float)
        ends = [np.broadcast_to(np.asarray(end, dtype=float), matrix.shape[:-1]) for end in (lower, upper)]
        lengths = np.linalg.norm(matrix, axis=-1)
        with np.errstate(divide="ignore", invalid="ignore"):
            units = np.where(lengths[..., None] > 0.0, matrix / lengths[..., None], 0.0)
            # a row of zeros bounds nothing, or excludes everything
            offsets = [
                np.where(lengths > 0.0, end / lengths, np.where(end >= 0.0, np.inf, -np.inf))
                for end in (-ends[0], ends[1])
            ]
            offsets = [np.where(np.isnan(lengths), np.nan, end) for end in offsets]
        return cls(frozen(np.concatenate([-units, units], axis=-2)), frozen(np.concatenate(offsets, axis=-1)))

    @classmethod
    def from_box(
        cls, generators: ArrayLike, lower: ArrayLike, upper: ArrayLike, *, centre: ArrayLike = 0.0
    ) -> Polytopes:
        """Return {M t + c : lower <= t <= upper}, as of forces: M maps forces of the drives to those of the tool.

        Every facet is parallel to d - 1 of the columns of M.

        Args:
            generators: M, shape=(..., d, u), with u >= d.
            lower: least force of each drive, shape=(..., u); finite.
            upper: greatest force of each drive, shape=(..., u); finite.
            centre: c, what all other forces add, shape=(..., d).

        Raises:
            InvalidValueError: there are fewer drives than dimensions, or so many that there may be more than
                :data:`MOST_FACETS` pairs of facets; or ends are not finite or exchanged.
        """
        matrix = np.asarray(generators, dtype=float)
        dimensions, count = matrix.shape[-2:]
        low, high = (np.asarray(end, dtype=float) for end in (lower, upper))
        if count < dimensions:
            raise InvalidValueError("generators", f"{count} drives", f"at least {dimensions}, one per dimension")
        if not (np.isfinite(low).all() and np.isfinite(high).all() and (low <= high).all()):
            raise InvalidValueError("limits of the drives", (lower, upper), "finite ends, the lower one first")
        if (pairs := pairs_of_facets(count, dimensions)) > MOST_FACETS:
            asked = f"{count} drives in {dimensions} dimensions"
            raise InvalidValueError("generators", asked, f"at most {MOST_FACETS:,} pairs of facets, not {pairs:,}")
        if count == dimensions:
            normals = _square_normals(matrix)
        else:
            chosen = np.array(list(combinations(range(count), dimensions - 1)), dtype=int).reshape(
                pairs, dimensions - 1
            )
            parts = np.array_split(chosen, min(pairs, 1 + pairs * dimensions * matrix[..., 0].size // _AT_ONCE))
            normals = np.concatenate([_normal(np.moveaxis(matrix[..., part], -2, -3)) for part in parts], axis=-2)
        along = normals @ matrix  # shape=(..., m, u)
        middle = np.einsum("...md,...d->...m", normals, np.asarray(centre) + _times(matrix, 0.5 * (low + high)))
        half = np.einsum("...mu,...u->...m", np.abs(along), 0.5 * (high - low))
        missing = ~np.any(normals, axis=-1) & np.isfinite(matrix).all(axis=(-2, -1))[..., None]  # dependent generators
        offsets = [np.where(missing, np.inf, half + sign * middle) for sign in (1.0, -1.0)]
        return cls(frozen(np.concatenate([normals, -normals], axis=-2)), frozen(np.concatenate(offsets, axis=-1)))

    @property
    def shape(self) -> tuple[int, ...]:
        """Shape of the batch."""
        return self.offsets.shape[:-1]

    @property
    def contains_origin(self) -> Array:
        """Whether the unloaded state is possible, shape=(...)."""
        return np.asarray((self.offsets >= 0.0).all(axis=-1))

    @property
    def ball_radius(self) -> Array:
        """Radius of the greatest ball about the origin inside, shape=(...); negative if the origin is outside."""
        return np.asarray(self.offsets.min(axis=-1))

    def box_share(self, half_widths: ArrayLike) -> Array:
        """Return how many times a box about the origin fits inside, shape=(...); negative if the origin is outside.

        Args:
            half_widths: of the box, shape=(..., d).
        """
        reach = np.einsum("...md,...d->...m", np.abs(self.normals), np.asarray(half_widths, dtype=float))
        return np.asarray(_ratio(self.offsets, reach).min(axis=-1))

    def extent(self, directions: ArrayLike) -> Array:
        """Return how far directions lead from the origin to the boundary, in multiples of each; NaN if it is outside.

        Args:
            directions: shape=(..., d), broadcast against the batch.

        Returns:
            Shape=(...); infinite where nothing bounds.
        """
        given = np.asarray(directions, dtype=float)
        along = np.einsum("...md,...d->...m", self.normals, given)
        along = np.where(along > _UNFELT * np.linalg.norm(given, axis=-1, keepdims=True), along, 0.0)
        far = _ratio(self.offsets, along).min(axis=-1)
        return np.asarray(np.where(self.contains_origin, far, np.nan))

    def pulled_back(self, matrix: ArrayLike) -> Polytopes:
        """Return {w : M w in the polytope}, unbounded where M w vanishes.

        Args:
            matrix: M, shape=(..., d, k).
        """
        rows = self.normals @ np.asarray(matrix, dtype=float)
        lengths = np.linalg.norm(rows, axis=-1)
        matters = lengths > _PARALLEL * lengths.max(axis=-1, keepdims=True, initial=0.0)
        with np.errstate(divide="ignore", invalid="ignore"):
            normals = np.where(matters[..., None], rows / lengths[..., None], 0.0)
            free = np.where(self.offsets >= 0.0, np.inf, -np.inf)
            offsets = np.where(matters, self.offsets / lengths, free)
            offsets = np.where(np.isnan(lengths) | np.isnan(self.offsets), np.nan, offsets)
        return Polytopes(frozen(normals), frozen(offsets))

    def share_left(self, point: ArrayLike) -> Array:
        """Return how much is left at a point, of the way from the middle between each pair of facets to a facet.

        1 in the middle, 0 on the boundary and negative outside: with as many drives as dimensions, the share of its
        effort that the most loaded drive has left. Facets are in opposite pairs, as the constructors make them.
        """
        along = np.einsum("...md,...d->...m", self.normals, np.asarray(point, dtype=float))
        half = self.normals.shape[-2] // 2
        widths = 0.5 * (self.offsets[..., :half] + self.offsets[..., half:])
        slack = np.minimum(*np.split(self.offsets - along, 2, axis=-1))
        with np.errstate(invalid="ignore"):
            shares = np.where(np.isinf(widths), 1.0, slack / widths)
        return np.asarray(shares.min(axis=-1))

    def margin(self, point: ArrayLike) -> Array:
        """Return the distance of a point from the nearest facet, shape=(...); negative outside."""
        along = np.einsum("...md,...d->...m", self.normals, np.asarray(point, dtype=float))
        return np.asarray((self.offsets - along).min(axis=-1))

    def corners(self) -> Array:
        """Return the vertices of parallelepipeds at all poses, shape=(..., 2^d, d); NaN where there are none.

        Those of the forces and rates of as many drives as dimensions, over a hundred times as fast as :meth:`vertices`.

        Raises:
            InvalidValueError: the polytopes have more facets, or fewer.
        """
        dimensions, facets = self.normals.shape[-1], self.normals.shape[-2]
        if facets != 2 * dimensions:
            raise InvalidValueError("polytopes", f"{facets} facets", f"parallelepipeds of {2 * dimensions}")
        normals, (upper, lower) = self.normals[..., :dimensions, :], np.split(self.offsets, 2, axis=-1)
        exist = np.asarray(np.isfinite(self.offsets).all(axis=-1) & (upper + lower >= 0.0).all(axis=-1))
        corners = np.full((*self.shape, 2**dimensions, dimensions), np.nan)
        with np.errstate(invalid="ignore"):
            exist &= np.abs(np.linalg.det(np.where(exist[..., None, None], normals, 0.0))) > 0.0
        chosen = np.array(list(product((False, True), repeat=dimensions)))
        ends = np.where(chosen, upper[exist][:, None, :], -lower[exist][:, None, :])
        corners[exist] = ends @ np.swapaxes(np.linalg.inv(normals[exist]), -1, -2)
        return frozen(corners)

    def vertices(self, index: int | tuple[int, ...] = ()) -> Matrix:
        """Return the vertices of one polytope of the batch, shape=(n, d); none if it is empty, or of an unsolved pose.

        Raises:
            InvalidValueError: the polytope is unbounded; or the index is that of several.
        """
        normals, offsets = self.normals[index], self.offsets[index]
        if offsets.ndim > 1:
            raise InvalidValueError("index", index, f"that of one polytope in a batch of shape {self.shape}")
        bounds = np.isfinite(offsets) & normals.any(axis=-1)
        if np.isneginf(offsets).any() or np.isnan(offsets).any():
            return np.zeros((0, normals.shape[-1]))
        return _vertices(normals[bounds], offsets[bounds])


def _vertices(normals: Matrix, offsets: Array) -> Matrix:
    """Intersect half-spaces by duality about their Chebyshev centre.

    Many of them meet at each vertex of a symmetric robot, where Qhull may find no facets. So it is given points that
    are joggled, and tells which half-spaces meet; where they do follows from themselves.
    """
    from scipy.optimize import linprog
    from scipy.spatial import HalfspaceIntersection, QhullError

    dimensions = normals.shape[1]
    if dimensions == 1:
        ends = offsets / normals[:, 0]
        low, high = ends[normals[:, 0] < 0.0].max(initial=-np.inf), ends[normals[:, 0] > 0.0].min(initial=np.inf)
        if not np.isfinite([low, high]).all():
            raise InvalidValueError("polytope", "unbounded", "finite limits of all drives that matter")
        return np.array([[low], [high]]) if low <= high else np.zeros((0, 1))
    size = float(np.abs(offsets).max(initial=0.0)) or 1.0
    system = np.hstack([normals, np.ones((len(normals), 1))])
    bounds = [(None, None)] * dimensions + [(0.0, None)]
    found = linprog([0.0] * dimensions + [-1.0], A_ub=system, b_ub=offsets / size, bounds=bounds)
    if found.status == 2:
        return np.zeros((0, dimensions))
    if found.status != 0 or np.linalg.matrix_rank(normals) < dimensions:
        raise InvalidValueError("polytope", "unbounded", "finite limits of all drives that matter")
    if found.x[-1] <= SAME:  # flat: gravity leaves no room
        return np.asarray(size * found.x[None, :-1])
    levels = offsets / size
    try:
        dual = HalfspaceIntersection(np.hstack([normals, -levels[:, None]]), found.x[:-1], qhull_options="QJ")
    except QhullError as error:
        raise InvalidValueError("polytope", problem="is degenerate", expected="one whose facets Qhull finds") from error
    if not (np.abs(dual.intersections) < 1.0 / SAME).all():
        raise InvalidValueError("polytope", "unbounded", "finite limits of all drives that matter")
    facets = np.array(dual.dual_facets)
    facets = facets[np.abs(np.linalg.det(normals[facets])) > _PARALLEL]
    corners = np.linalg.solve(normals[facets], levels[facets][..., None])[..., 0]
    corners = corners[(corners @ normals.T <= levels + SAME).all(axis=1)]
    _, first = np.unique(np.round(corners / SAME), axis=0, return_index=True)
    return np.asarray(size * corners[np.sort(first)])


def _square_normals(matrix: Array) -> Array:
    """Return unit vectors normal to all columns but one: rows of the inverse, or see :func:`_normal`."""
    flat = matrix.reshape(-1, *matrix.shape[-2:])
    lengths = np.linalg.norm(flat, axis=-2, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        units = flat / lengths
    normals = np.zeros_like(flat)
    regular = np.isfinite(units).all(axis=(-2, -1))
    regular[regular] = np.abs(np.linalg.det(units[regular])) > _PARALLEL
    rows = np.linalg.inv(units[regular])
    normals[regular] = rows / np.linalg.norm(rows, axis=-1, keepdims=True)
    chosen = list(combinations(range(flat.shape[-1]), flat.shape[-1] - 1))[::-1]
    normals[~regular] = np.stack([_normal(flat[~regular][..., list(columns)]) for columns in chosen], axis=-2)
    return normals.reshape(matrix.shape)


def _normal(columns: Array) -> Array:
    """Return unit vectors normal to d - 1 columns, shape=(..., d, d - 1): zero where the columns are dependent."""
    dimensions = columns.shape[-2]
    signs = (-1.0) ** np.arange(dimensions)
    rows = [np.delete(columns, row, axis=-2) for row in range(dimensions)]
    with np.errstate(invalid="ignore"):  # unsolved poses are NaN
        minors = [np.linalg.det(row) if dimensions > 1 else np.ones(columns.shape[:-2]) for row in rows]
    normal = signs * np.stack(minors, axis=-1)
    lengths = np.linalg.norm(normal, axis=-1, keepdims=True)
    usual = np.prod(np.linalg.norm(columns, axis=-2), axis=-1)[..., None]
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(lengths > _PARALLEL * usual, normal / lengths, 0.0))


def _times(matrix: Array, vector: Array) -> Array:
    return np.asarray(
        np.einsum("...du,...u->...d", matrix, np.broadcast_to(vector, (*matrix.shape[:-2], matrix.shape[-1])))
    )


def _ratio(offsets: Array, lengths: Array) -> Array:
    """Return offsets / lengths, infinite where a length is not positive."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.asarray(np.where(lengths > 0.0, offsets / lengths, np.where(offsets < 0.0, -np.inf, np.inf)))
