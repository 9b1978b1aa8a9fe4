"""Registration: the placement of a machine's base in the axes of the instrument that measures it.

The rotation R and translation t bring the measurements nearest to the machine's poses by its description,

    sum_i |R p_i + t - n_i|^2 + eta^2 |R R_i - N_i|^2 / 2,

in closed form by a singular value decomposition (W. Kabsch, Acta Cryst. A 32, 1976; |.|^2 / 2 of small differences of
rotation matrices is the squared angle), repeated without the rows that lie far from all others. Errors that move
everything alike thus no longer count as errors of the machine: they are equivalent to another place of the instrument.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.errors.pose_error import TIP_LENGTH, rotation_matrix
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array

_FAR = 5.0  # times the median distance
_MAX_ROUNDS = 20
_ON_A_LINE = 1e-6  # of the greatest extent
_NEARLY = 0.1  # of the greatest extent


@dataclass(frozen=True, eq=False)
class Registration:
    """Transformation from an instrument's axes to those of the base."""

    rotation: Array  #: R, shape=(3, 3)
    translation: Array  #: t, shape=(3,) [m]
    residual: float  #: residual of the positions, root mean square over the rows that agree [m]

    @property
    def base(self) -> Array:
        """Placement of the base in the axes of the instrument, as a homogeneous transform, shape=(4, 4)."""
        transform = np.eye(4)
        transform[:3, :3] = self.rotation.T
        transform[:3, 3] = -self.rotation.T @ self.translation
        return transform

    def moved(self, twist: Array) -> Registration:
        """Return the registration to a base at [translation; rotation vector] in this base [m, rad]."""
        turn = rotation_matrix(twist[3:]).T
        return Registration(turn @ self.rotation, turn @ (self.translation - twist[:3]), self.residual)

    def positions(self, seen: Array) -> Array:
        """Return positions in the axes of the base, shape=(n, 3) [m]."""
        return np.asarray(seen @ self.rotation.T + self.translation)

    def rotations(self, seen: Array) -> Array:
        """Return orientations in the axes of the base, shape=(n, 3, 3)."""
        return np.asarray(self.rotation @ seen)

    def sigmas(self, seen: Array) -> Array:
        """Return standard deviations along (and about) the axes of the base, shape=(n, 3) or (n, 6)."""
        triples = seen.reshape(len(seen), seen.shape[1] // 3, 3)
        return np.sqrt(triples**2 @ (self.rotation**2).T).reshape(seen.shape)


AT_THE_BASE = Registration(np.eye(3), np.zeros(3), 0.0)
"""Registration of an instrument whose frame is initially that of the base."""


def register(
    seen: Array,
    expected: Array,
    seen_rotations: Array | None = None,
    expected_rotations: Array | None = None,
    *,
    eta: float = TIP_LENGTH,
) -> Registration:
    """Locate the base from positions, and orientations if there are any.

    `seen` values are in instrument axes, `expected` ones follow from the machine's description, in base axes:
    shape=(n, 3) [m] and shape=(n, 3, 3). eta weighs the orientation [m/rad]; at 0 it does not count.

    Raises:
        InvalidValueError: positions only, all on one line: the rotation about that line is undetermined.
    """
    if eta == 0.0:
        seen_rotations = None
    agreeing = np.ones(len(seen), dtype=bool)
    for _ in range(_MAX_ROUNDS):
        turned = None
        if seen_rotations is not None and expected_rotations is not None:
            turned = np.einsum("nij,nkj->ik", expected_rotations[agreeing], seen_rotations[agreeing])
        found = _nearest(seen[agreeing], expected[agreeing], None if turned is None else 0.5 * eta**2 * turned)
        squares = np.sum((found.positions(seen) - expected) ** 2, axis=1)
        if seen_rotations is not None and expected_rotations is not None:
            differences = found.rotations(seen_rotations) - expected_rotations
            squares = squares + 0.5 * eta**2 * np.sum(differences**2, axis=(1, 2))
        closer = squares <= _FAR**2 * np.median(squares[agreeing]) + np.finfo(float).eps
        if (closer == agreeing).all():
            break
        agreeing = closer
    return found


def _nearest(seen: Array, expected: Array, turned: Array | None) -> Registration:
    centre, goal = seen.mean(axis=0), expected.mean(axis=0)
    products = (expected - goal).T @ (seen - centre)
    if turned is None:
        extents = np.linalg.svd(products, compute_uv=False)
        if extents[1] <= _ON_A_LINE * extents[0]:
            raise InvalidValueError(
                "positions",
                problem="lie on one line",
                expected="poses, or several targets, since the rotation about a line is undetermined",
            )
    else:
        products = products + turned
    left, _, right = np.linalg.svd(products)
    mirrored = np.diag([1.0, 1.0, np.sign(np.linalg.det(left @ right))])
    rotation = left @ mirrored @ right
    translation = goal - rotation @ centre
    left_over = seen @ rotation.T + translation - expected
    return Registration(rotation, translation, float(np.sqrt(np.mean(np.sum(left_over**2, axis=1)))))


def fitted_spheres(points: Array, radii: Array) -> list[Array]:
    """Return possible centres of a sphere, given distances of points from it, shape=(n, 3) and (n,) [m].

    Linear in the centre c along the k greatest extents of the points, and in the square of its distance from the
    points' middle, from which its height h above their plane or line follows:

        2 c x - (c^2 + h^2) = x^2 - r^2.

    All directions across a plane or line fit equally well: one of them is returned. Of points near a plane or line,
    all are.
    """
    middle = points.mean(axis=0)
    seen = points - middle
    _, sizes, axes = np.linalg.svd(seen, full_matrices=False)
    axes = axes * np.sign(axes[np.arange(3), np.abs(axes).argmax(axis=1)])[:, None]
    flat, thin = sizes <= _ON_A_LINE * sizes[0], sizes <= _NEARLY * sizes[0]
    centres = []
    for k in range(1, 4):
        if flat[k - 1] or not thin[k:].all():
            continue
        rows = np.column_stack([2.0 * seen @ axes[:k].T, -np.ones(len(seen))])
        found = np.linalg.lstsq(rows, np.sum(seen**2, axis=1) - radii**2, rcond=None)[0]
        within, height = found[:k] @ axes[:k], np.sqrt(max(found[k] - np.sum(found[:k] ** 2), 0.0))
        across = axes[k : k + 1] if flat[k:].all() else np.concatenate([axes[k:], -axes[k:]])
        centres += [middle + within + height * axis for axis in across] if k < 3 else [middle + within]
    return centres
