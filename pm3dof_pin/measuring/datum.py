"""Datums: what a row is measured against, where its own placement is not known.

With X the point seen in the axes of the datum, a row measures some coordinates g(X) [m]:

========  ============================  =====================================  ======================
kind      what                          g                                      unknown placement
========  ============================  =====================================  ======================
plane     touched, or a height above    Z                                      Z, turns about X and Y
line      wire, straight edge, bore     X, Y                                   X, Y, turns about them
socket    ball held in a seat           X, Y, Z                                X, Y, Z
camera    a target in its image         depth times X/Z, Y/Z                   all six
========  ============================  =====================================  ======================

A placement has no prior and is estimated with the machine; moving a datum is equivalent to an apparent motion of the
point. It starts from the fit to the machine as described. A camera's image coordinates are multiplied by the described
depth, so that all rows are lengths across the line of sight.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from pm3dof_pin.errors.pose_error import rotation_matrix
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Indices, Mask

_MAX_ROUNDS = 50
_SETTLED = 1e-12  # [m, rad]
_FLAT = 1e-3  # of the greatest extent: too flat for a camera's placement
_TWIST = ("x", "y", "z", "rx", "ry", "rz")
_DAMPING = 1e-12


@dataclass(frozen=True)
class DatumKind:
    """One kind of datum: what it measures of a point in its axes, and which part of its placement matters."""

    dimension: int  #: coordinates of a row
    moves: tuple[int, ...]  #: components of the twist of its placement that matter, of x, y, z, rx, ry, rz
    min_rows: int  #: least number of rows
    measured: Callable[[Array], Array]  #: g of points in its axes, shape=(n, 3) to (n, dimension)
    gradient: Callable[[Array], Array]  #: derivative of g, shape=(n, dimension, 3)
    start: Callable[[Array, Array], list[tuple[Array, Array]]]  #: placements from points and numbers measured


def _constant(rows: Array) -> Callable[[Array], Array]:
    return lambda points: np.tile(rows, (len(points), 1, 1))


def _image(points: Array) -> Array:
    return np.asarray(points[:, :2] / points[:, 2:])


def _image_gradient(points: Array) -> Array:
    x, y, z = points.T
    nothing = np.zeros_like(x)
    return np.stack([np.stack([1.0 / z, nothing, -x / z**2], 1), np.stack([nothing, 1.0 / z, -y / z**2], 1)], axis=1)


def _principal_axes(points: Array) -> Array:
    """Return axes of a cloud of points as rows, the last one being that of its least extent, shape=(3, 3)."""
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]
    axes[2] = np.cross(axes[0], axes[1])
    return np.asarray(axes)


def _plane_start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    axes, centre = _principal_axes(points), points.mean(axis=0)
    upward = axes if axes[2] @ np.ones(3) >= 0.0 else np.array([axes[0], -axes[1], -axes[2]])
    starts = [upward, np.eye(3)] if not np.ptp(values) else [upward, upward * [[1.0], [-1.0], [-1.0]], np.eye(3)]
    return [(each, centre - values.mean() * each[2]) for each in starts]


def _line_start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    axes = _principal_axes(points)
    return [(axes[[1, 2, 0]], points.mean(axis=0))]


def _socket_start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    return [(np.eye(3), points.mean(axis=0))]


def _camera_start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    """Resection by the direct linear transformation (I. Sutherland, 1974), about the middle of the points."""
    middle = points.mean(axis=0)
    size = np.linalg.norm(points - middle, axis=1).max()
    extents = np.linalg.svd((points - middle) / size, compute_uv=False)
    if extents[-1] < _FLAT * extents[0]:
        raise InvalidValueError("camera", problem="sees points in one plane", expected="points at different depths")
    whole = np.column_stack([(points - middle) / size, np.ones(len(points))])
    nothing = np.zeros_like(whole)
    u, v = values.T[:, :, None]
    matrix = np.concatenate([np.hstack([whole, nothing, -u * whole]), np.hstack([nothing, whole, -v * whole])])
    projection = np.linalg.svd(matrix)[2][-1].reshape(3, 4)
    left, scales, right = np.linalg.svd(projection[:, :3])
    turn = left @ right
    sign = np.sign(np.linalg.det(turn))
    axes, shift = sign * turn, sign * projection[:, 3] / scales.mean() * size
    return [(axes, middle - axes.T @ shift)]


_Z, _XY = np.eye(3)[2:], np.eye(3)[:2]

DATUM_KINDS = MappingProxyType(
    {
        "plane": DatumKind(1, (2, 3, 4), 4, lambda x: x[:, 2:], _constant(_Z), _plane_start),
        "line": DatumKind(2, (0, 1, 3, 4), 3, lambda x: x[:, :2], _constant(_XY), _line_start),
        "socket": DatumKind(3, (0, 1, 2), 2, lambda x: x, _constant(np.eye(3)), _socket_start),
        "camera": DatumKind(2, (0, 1, 2, 3, 4, 5), 6, _image, _image_gradient, _camera_start),
    }
)
"""The kinds, by the column that holds their numbers."""


@dataclass(frozen=True, eq=False)
class Datum:
    """A datum, and what rows of measurements measure against it. Immutable."""

    kind: str  #: of :data:`DATUM_KINDS`
    number: int  #: its number in the file
    axes: Array  #: its axes as rows, in those of the base, shape=(3, 3)
    origin: Array  #: its origin in the base, shape=(3,) [m]
    values: Array  #: numbers measured, NaN in rows that are not measured against it, shape=(n, dimension) [m]
    #: what the kind's coordinates are multiplied by: the depth for a camera, else 1, shape=(n,)
    scales: Array

    @classmethod
    def fitted(cls, kind: str, number: int, points: Array, values: Array) -> Datum:
        """Place a datum by least squares.

        Args:
            kind: of :data:`DATUM_KINDS`.
            number: its number.
            points: where the described machine has the point seen, shape=(n, 3) [m].
            values: numbers measured, NaN in other rows, shape=(n, dimension) [m]; X/Z and Y/Z for a camera.

        Raises:
            InvalidValueError: too few rows, or points in one plane for a camera.
        """
        own = np.isfinite(values).all(axis=1)
        entry = DATUM_KINDS[kind]
        if own.sum() < entry.min_rows:
            raise InvalidValueError(
                kind, problem=f"{number} has {own.sum()} rows", expected=f"at least {entry.min_rows}"
            )
        flat = np.ones(len(points))
        fits: list[tuple[float, int, Datum]] = []
        for axes, origin in entry.start(points[own], values[own]):
            datum = cls(kind, number, axes, origin, values, flat)
            for _ in range(_MAX_ROUNDS):
                rows = datum.by_placement(points)[own].reshape(-1, len(entry.moves))
                off = datum.residuals(points)[own].ravel()
                # a placement may be undetermined in part: a plane that is touched along a line
                normal = rows.T @ rows + _DAMPING * np.trace(rows.T @ rows) * np.eye(rows.shape[1])
                step = np.linalg.solve(normal, rows.T @ off)
                datum = datum.moved(step)
                if np.abs(step).max() < _SETTLED:
                    break
            fits.append((float(np.sum(datum.residuals(points)[own] ** 2)), len(fits), datum))
        best = min(fits)[2]
        if kind != "camera":
            return best
        depths = np.where(own, best._own(points)[:, 2], 1.0)
        return replace(best, scales=depths, values=values * depths[:, None])

    @property
    def numbers(self) -> Array:
        """The numbers as measured: without a camera's depths, NaN in other rows, shape=(n, dimension) [m, 1]."""
        return np.asarray(self.values / self.scales[:, None])

    @property
    def rows(self) -> Mask:
        """Mask of its rows, shape=(n,)."""
        return np.asarray(np.isfinite(self.values[:, 0]))

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters of its placement."""
        return tuple(f"{self.kind}{self.number}.{_TWIST[k]}" for k in DATUM_KINDS[self.kind].moves)

    def __getitem__(self, chosen: Indices) -> Datum:
        """Return the datum for some rows."""
        return replace(self, values=self.values[chosen], scales=self.scales[chosen])

    def residuals(self, points: Array) -> Array:
        """Return measured minus predicted numbers for points, one for each row, shape=(n, dimension) [m]."""
        with np.errstate(divide="ignore", invalid="ignore"):  # in rows of others
            found = self.values - self.scales[:, None] * DATUM_KINDS[self.kind].measured(self._own(points))
        return np.where(self.rows[:, None], found, 0.0)

    def directions(self, points: Array) -> Array:
        """Return the derivatives of the predicted numbers by the points, base axes, shape=(n, dimension, 3)."""
        return np.asarray(self._gradient(points) @ self.axes)

    def by_placement(self, points: Array) -> Array:
        """Return the derivatives of the predicted numbers by the datum's placement, shape=(n, dimension, k).

        The placement moves by a twist [v; omega] in the datum's own axes; see `moves` of :class:`DatumKind`.
        """
        x, y, z = self._own(points).T
        nothing = np.zeros_like(x)
        cross = np.stack([[nothing, -z, y], [z, nothing, -x], [-y, x, nothing]]).transpose(2, 0, 1)
        whole = np.concatenate([np.tile(-np.eye(3), (len(points), 1, 1)), cross], axis=2)
        return np.asarray((self._gradient(points) @ whole)[:, :, DATUM_KINDS[self.kind].moves])

    def moved(self, values: Array) -> Datum:
        """Return the datum at another placement, shape=(k,) [m, rad]; see :meth:`by_placement`."""
        twist = np.zeros(6)
        twist[list(DATUM_KINDS[self.kind].moves)] = values
        turned = rotation_matrix(twist[3:]).T @ self.axes
        return replace(self, origin=self.origin + self.axes.T @ twist[:3], axes=turned)

    def without(self, points: Array, motions: Array) -> Datum:
        """Return what would be measured if the points had not made given motions, shape=(n, 3) [m]."""
        return replace(self, values=self.values - np.einsum("ndi,ni->nd", self.directions(points), motions))

    def apparent_motions(self, points: Array) -> Array:
        """Return the motions of the points that look like the datum's, shape=(n, 3, k)."""
        found = np.linalg.pinv(self.directions(points)) @ self.by_placement(points)
        return np.asarray(found * self.rows[:, None, None])

    def _own(self, points: Array) -> Array:
        return np.asarray((points - self.origin) @ self.axes.T)

    def _gradient(self, points: Array) -> Array:
        own = np.where(self.rows[:, None], self._own(points), 1.0)
        return np.asarray(self.scales[:, None, None] * DATUM_KINDS[self.kind].gradient(own))
