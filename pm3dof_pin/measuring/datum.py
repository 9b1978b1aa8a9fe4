"""Datums: what a row is measured against, where its own placement is not known.

With X the point seen in the axes of the datum, a row measures some coordinates g(X) [m], as its :class:`DatumKind`
says; the kinds are with the instruments, in :mod:`pm3dof_pin.measuring.instruments`. A placement has no prior and is
estimated with the machine; moving a datum is equivalent to an apparent motion of the point. It starts from the fit to
the machine as described. A camera's image coordinates are multiplied by the described depth, so that all rows are
lengths across the line of sight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.errors.pose_error import rotation_matrix
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Indices, Mask

_MAX_ROUNDS = 50
_SETTLED = 1e-12  # [m, rad]
_IN_A_PLANE = 1e-6  # of the greatest extent
_STEEP = 0.95  # cosine from which an inclination changes it by less than a third of its own change
_MIRROR = np.array([-1.0, 1.0])
_CLEARLY = 0.1  # of the spread of image coordinates, medians
_DAMPING, _FASTER = 1e-12, 100.0

INCLINATION = (4,)
"""The ry of a plane upright on that of the points, by which it leans: those that touch it do not tell, or care."""


def _nothing(cells: Array) -> tuple[Array, Array | float]:
    return np.zeros((len(cells), 3)), 1.0


def _no_cells(numbers: Array) -> Array:
    return np.zeros((len(numbers), 0))


@dataclass(frozen=True)
class DatumKind:
    """One kind of datum: what it measures of a point in its axes, what of its placement matters, how a file says it."""

    name: str  #: of the column with the number of the datum, 1, 2 ...
    dimension: int  #: coordinates of a row
    moves: tuple[int, ...]  #: components of the twist of its placement that matter, of x, y, z, rx, ry, rz
    min_rows: int  #: least number of rows
    measured: Callable[[Array], Array]  #: g of points in its axes, shape=(n, 3) to (n, dimension)
    gradient: Callable[[Array], Array]  #: derivative of g, shape=(n, dimension, 3)
    start: Callable[[Array, Array], list[tuple[Array, Array]]]  #: placements from points and numbers measured
    columns: tuple[str, ...] = ()  #: columns of a row beside its number
    needed: bool = False  #: whether these columns must be there, and complete
    sigma_column: str = "sigma_touch_m"  #: column of its noise
    usual_sigma: float | None = None  #: noise without that column, in its unit; by default the instrument's [m]
    #: numbers measured, shape=(n, 3) of which `dimension` are used, and their change by a unit of the noise's column,
    #: from the cells of `columns`, shape=(n, columns)
    read: Callable[[Array], tuple[Array, Array | float]] = _nothing
    written: Callable[[Array], Array] = _no_cells  #: cells of `columns` that say these numbers with a change of 1
    round: bool = False  #: whether it is a sphere, which points in a plane see alike from both sides
    even: bool = False  #: whether it is a plane, from which points in another one tell the cosine of its inclination
    through_a_lens: bool = False  #: whether g is of directions, so that a row is a length only at its depth, Z


def constant(rows: Array) -> Callable[[Array], Array]:
    """Return the gradient of linear coordinates, given as rows, shape=(dimension, 3)."""
    return lambda points: np.tile(rows, (len(points), 1, 1))


def axes_of_extents(points: Array) -> Array:
    """Return axes of a cloud of points as rows, the last one being that of its least extent, shape=(3, 3)."""
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=len(points) < points.shape[1])[2]
    axes[2] = np.cross(axes[0], axes[1])
    return np.asarray(axes)


def narrowness(points: Array, axes: Array) -> float:
    """Return the second extent over the first of points in a plane, 0 for points on a line; infinity if in space.

    The axes are those of :func:`axes_of_extents`.
    """
    sizes = np.abs((points - points.mean(axis=0)) @ axes.T).max(axis=0)
    if sizes[2] > _IN_A_PLANE * sizes[0]:
        return np.inf
    return float(sizes[1] / sizes[0]) if sizes[1] > _IN_A_PLANE * sizes[0] else 0.0


@dataclass(frozen=True, eq=False)
class Datum:
    """A datum, and what rows of measurements measure against it. Immutable."""

    kind: DatumKind  #: what it is
    number: int  #: its number in the file
    axes: Array  #: its axes as rows, in those of the base, shape=(3, 3)
    origin: Array  #: its origin in the base, shape=(3,) [m]
    values: Array  #: numbers measured, NaN in rows that are not measured against it, shape=(n, dimension) [m]
    #: what the kind's coordinates are multiplied by: the depth for a camera, else 1, shape=(n,)
    scales: Array
    #: distance of a sphere's centre from the plane of all points seen, along z of its axes [m]; NaN if these are not
    #: in a plane. Near it, only the square matters: the placement's z is half its change over `reach`
    height: float = float("nan")
    reach: float = 1.0  #: see `height` [m]
    #: whether it is a plane upright on that of all points seen, where only the cosine of its inclination matters: the
    #: placement's ry stretches heights instead
    upright: bool = False
    idle: tuple[int, ...] = ()  #: components of its placement that change nothing, such as an :data:`INCLINATION`

    @classmethod
    def fitted(cls, kind: DatumKind, number: int, points: Array, values: Array) -> Datum:
        """Place a datum by least squares.

        Args:
            kind: what it is.
            number: its number.
            points: where the described machine has the point seen, shape=(n, 3) [m].
            values: numbers measured, NaN in other rows, shape=(n, dimension) [m]; X/Z and Y/Z for a camera.

        Raises:
            InvalidValueError: too few rows, numbers without any placement, or for a camera points in one plane, behind
                it or mirrored.
        """
        own = np.asarray(np.isfinite(values).all(axis=1))
        if own.sum() < kind.min_rows:
            problem = f"{number} has {own.sum()} rows"
            raise InvalidValueError(kind.name, problem=problem, expected=f"at least {kind.min_rows}")
        nowhere = InvalidValueError(kind.name, problem=f"{number} is nowhere", expected="numbers of its size")
        try:
            with np.errstate(over="ignore", invalid="ignore"):
                found = cls._nearest(kind, number, points, values)
        except np.linalg.LinAlgError as error:
            raise nowhere from error
        if not np.isfinite([*found.origin, *found.axes.ravel()]).all():
            raise nowhere
        if found._sees_behind(points):
            found._refuse(points)
        return found.above_a_plane(points, own).at_its_depth(points)

    def _refuse(self, points: Array) -> NoReturn:
        """Refuse a camera that sees points behind it, as a mirrored image shows them."""
        mirrored = self._nearest(self.kind, self.number, points, self.values * _MIRROR)
        left, spread = mirrored.residuals(points)[self.rows], self.values[self.rows]
        clearly = np.median(np.abs(left)) < _CLEARLY * np.median(np.abs(spread - np.median(spread, axis=0)))
        problem = f"{self.number} has points behind it wherever it is put"
        if clearly and not mirrored._sees_behind(points):
            problem = f"{self.number} sees a mirrored image: u or v counts the other way, or they are exchanged"
        raise InvalidValueError(self.kind.name, problem=problem, expected="u to the right, v down, of these points")

    def above_a_plane(self, points: Array, own: Mask) -> Datum:
        """Return a sphere with its height above the plane of its points, a plane upright on it, if they are in one.

        Points have shape=(n, 3) [m], the flags of the datum's own shape=(n,).
        """
        points, values = points[own], self.values[own]
        if not (self.kind.round or self.kind.even) or len(points) < len(self.axes):
            return self
        middle, axes = points.mean(axis=0), axes_of_extents(points)
        if narrowness(points, axes) in (0.0, np.inf):
            return self
        if self.kind.even:
            return self._upright_on(axes, points - middle, middle, values[:, 0])
        if abs(axes[2, 2]) > 1.0 - _IN_A_PLANE:
            axes = np.eye(3)
        reach = float(np.median(np.linalg.norm(points - self.origin, axis=1)))
        return replace(self, axes=axes, height=float(axes[2] @ (self.origin - middle)), reach=reach)

    def _upright_on(self, axes: Array, points: Array, middle: Array, values: Array) -> Datum:
        """Return a plane upright on that of points about their middle, with the normal of least squares, if it is."""
        along = axes[:2] @ self.axes[2]  # touched
        if np.ptp(values) > 0.0:
            along = np.linalg.lstsq(points @ axes[:2].T, values - values.mean(), rcond=None)[0]
        if (cosine := float(np.linalg.norm(along))) < _STEEP:
            return self
        normal = along @ axes[:2] / cosine
        turned = np.stack([axes[2], np.cross(normal, axes[2]), normal])
        idle = () if np.ptp(values) > 0.0 else INCLINATION
        return replace(self, axes=turned, origin=middle - values.mean() * normal, upright=True, idle=idle)

    @classmethod
    def _nearest(cls, kind: DatumKind, number: int, points: Array, values: Array) -> Datum:
        """Return the datum at the placement of least squares, of those that its kind starts from."""
        own, flat = np.asarray(np.isfinite(values).all(axis=1)), np.ones(len(points))
        fits: list[tuple[bool, float, int, Datum]] = []
        for axes, origin in kind.start(points[own], values[own]):
            datum, damping = cls(kind, number, axes, origin, values, flat), _DAMPING
            for _ in range(_MAX_ROUNDS):
                rows = datum.by_placement(points)[own].reshape(-1, len(kind.moves))
                off = datum.residuals(points)[own].ravel()
                # a placement may be undetermined in part: a plane touched along a line, a socket amid a circle
                normal = rows.T @ rows + damping * np.trace(rows.T @ rows) * np.eye(rows.shape[1])
                step = np.linalg.solve(normal, rows.T @ off)
                moved = datum.moved(step)
                if np.abs(step).max() < _SETTLED:
                    break
                if moved._misfit(points) > datum._misfit(points):
                    damping = _FASTER * damping
                else:
                    datum, damping = moved, max(_DAMPING, damping / _FASTER)
            fits.append((datum._sees_behind(points), datum._misfit(points), len(fits), datum))
        return min(fits)[-1]

    def at_its_depth(self, points: Array) -> Datum:
        """Return the datum with lengths as numbers: directions, if it is a lens, multiplied by the depth of points."""
        if not self.kind.through_a_lens:
            return self
        depths = np.where(self.rows, self._own(points)[:, 2], 1.0)
        return replace(self, scales=depths, values=self.values * depths[:, None])

    @property
    def numbers(self) -> Array:
        """The numbers as measured: without a camera's depths, NaN in other rows, shape=(n, dimension) [m, 1]."""
        return np.asarray(self.values / self.scales[:, None])

    @property
    def rows(self) -> Mask:
        """Mask of its rows, shape=(n,)."""
        return np.asarray(np.isfinite(self.values[:, 0]))

    @property
    def moves(self) -> tuple[int, ...]:
        """The components of the twist of its placement that matter."""
        return tuple(k for k in self.kind.moves if k not in self.idle)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters of its placement."""
        return tuple(f"{self.kind.name}{self.number}.{TOOL_COMPONENTS[k]}" for k in self.moves)

    def __getitem__(self, chosen: Indices) -> Datum:
        """Return the datum for some rows."""
        return replace(self, values=self.values[chosen], scales=self.scales[chosen])

    def residuals(self, points: Array) -> Array:
        """Return measured minus predicted numbers for points, one for each row, shape=(n, dimension) [m]."""
        with np.errstate(divide="ignore", invalid="ignore"):  # in rows of others
            found = self.values - self.scales[:, None] * self.kind.measured(self._own(points))
        return np.where(self.rows[:, None], found, 0.0)

    def directions(self, points: Array) -> Array:
        """Return the derivatives of the predicted numbers by the points, base axes, shape=(n, dimension, 3)."""
        return np.asarray(self._gradient(points) @ self.axes)

    def by_placement(self, points: Array) -> Array:
        """Return the derivatives of the predicted numbers by the datum's placement, shape=(n, dimension, k).

        The placement moves by a twist [v; omega] in the datum's own axes; see :attr:`moves`.
        """
        return np.asarray(self._gradient(points) @ self._away(points))

    def moved(self, values: Array) -> Datum:
        """Return the datum at another placement, shape=(k,) [m, rad]; see :meth:`by_placement`."""
        twist = np.zeros(6)
        twist[list(self.moves)] = values
        if np.isfinite(self.height):
            return self._lifted(twist)
        stretched = self.values
        if self.upright:
            stretched, twist[4] = self.values / (1.0 + twist[4]), 0.0
        turned = rotation_matrix(twist[3:]).T @ self.axes
        return replace(self, origin=self.origin + self.axes.T @ twist[:3], axes=turned, values=stretched)

    def _lifted(self, twist: Array) -> Datum:
        square = self.height**2 + 2.0 * self.reach * twist[2]
        height = np.copysign(np.sqrt(max(square, 0.0)), self.height)
        origin = self.origin + self.axes.T @ [*twist[:2], height - self.height]
        # distances shorter than from any place in the plane are lengthened instead
        values = np.sqrt(self.values**2 - min(square, 0.0))
        return replace(self, origin=origin, values=values, height=height)

    def without(self, points: Array, motions: Array) -> Datum:
        """Return what would be measured if the points had not made given motions, shape=(n, 3) [m]."""
        return replace(self, values=self.values - np.einsum("ndi,ni->nd", self.directions(points), motions))

    def apparent_motions(self, points: Array) -> Array:
        """Return the motions of the points that look like the datum's, shape=(n, 3, k)."""
        return np.asarray(self.axes.T @ self._away(points) * self.rows[:, None, None])

    def _away(self, points: Array) -> Array:
        """Return the motions of the points seen from a datum that moves, in its own axes, shape=(n, 3, k)."""
        x, y, z = self._own(points).T
        nothing = np.zeros_like(x)
        cross = np.stack([[nothing, -z, y], [z, nothing, -x], [-y, x, nothing]]).transpose(2, 0, 1)
        whole = np.concatenate([np.tile(-np.eye(3), (len(points), 1, 1)), cross], axis=2)
        if np.isfinite(self.height):
            own = np.stack([x, y, z], axis=1)
            whole[:, :, 2] = self.reach * own / np.maximum(np.sum(own**2, axis=1, keepdims=True), _SETTLED)
        if self.upright:
            whole[:, :, 4] = np.stack([nothing, nothing, np.nan_to_num(self.values[:, 0])], axis=1)
        return np.asarray(whole[:, :, self.moves])

    def _sees_behind(self, points: Array) -> bool:
        return self.kind.through_a_lens and bool((self._own(points)[self.rows, 2] <= 0.0).any())

    def _misfit(self, points: Array) -> float:
        return float(np.sum(self.residuals(points) ** 2))

    def _own(self, points: Array) -> Array:
        return np.asarray((points - self.origin) @ self.axes.T)

    def _gradient(self, points: Array) -> Array:
        own = np.where(self.rows[:, None], self._own(points), 1.0)
        return np.asarray(self.scales[:, None, None] * self.kind.gradient(own))
