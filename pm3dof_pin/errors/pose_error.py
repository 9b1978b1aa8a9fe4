"""The error of a pose: position, orientation and energy, (8.11)-(8.17) of the chapter with the errata.

Poses are homogeneous transforms, shape=(..., 4, 4), or split into positions and rotations. D. Zhang, Parallel Robotic
Machine Tools (Springer 2010), section 8.3.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent
from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.typing import Array

_SMALL_HALF_ANGLE = 1e-3

TIP_LENGTH = 0.1
"""Default of eta [m/rad]: the distance at which a rotation counts as much as the displacement it causes."""


def position_error(ideal: ArrayLike, real: ArrayLike) -> Array:
    """Return the position error between desired and reached poses, shape=(..., 4, 4), (8.16), shape=(...) [m]."""
    return np.asarray(np.linalg.norm(_position(real) - _position(ideal), axis=-1))


def orientation_error(ideal: ArrayLike, real: ArrayLike) -> Array:
    """Return the angle between orientations of desired and reached poses, in [0, pi], shape=(...) [rad].

    (8.17) prints an arc cosine of a sum of cosine products, which is acos(3) for zero error. This is the angle of
    the relative rotation. acos((tr - 1) / 2) would lose half its digits near zero, and 2 asin of the Frobenius norm of
    R - R' near pi; sine and cosine of the half angle together lose none.
    """
    return np.asarray(np.linalg.norm(pose_difference(ideal, real)[..., 3:], axis=-1))


def energy(ideal: ArrayLike, real: ArrayLike, eta: float = TIP_LENGTH) -> Array:
    """Return the energy function of the pose error, E = E_xyz + eta E_orientation, (8.15), shape=(...) [m].

    The chapter leaves out the unit of eta [m/rad].
    """
    return position_error(ideal, real) + _checked_eta(eta) * orientation_error(ideal, real)


def pose_difference(ideal: ArrayLike, real: ArrayLike) -> Array:
    """Return the motion from the desired to the reached pose, [translation; rotation vector], shape=(..., 6) [m, rad].

    In world axes. The rotations are composed, R' = exp(rotation vector) R; (8.13) adds increments to Euler angles.
    """
    wanted, reached = np.broadcast_arrays(_checked(ideal), _checked(real))
    turn = reached[..., :3, :3] @ np.swapaxes(wanted[..., :3, :3], -1, -2)
    return np.concatenate([reached[..., :3, 3] - wanted[..., :3, 3], rotation_vector(turn)], axis=-1)


def moved_pose(pose: ArrayLike, difference: ArrayLike) -> Array:
    """Return the pose displaced by a difference, shape=(..., 4, 4), the inverse of :func:`pose_difference`."""
    start, step = _checked(pose), np.asarray(difference, dtype=float)
    moved = np.array(np.broadcast_to(start, (*np.broadcast_shapes(start.shape[:-2], step.shape[:-1]), 4, 4)))
    moved[..., :3, :3] = rotation_matrix(step[..., 3:]) @ start[..., :3, :3]
    moved[..., :3, 3] += step[..., :3]
    return moved


def tip_error(
    difference: ArrayLike, eta: float = TIP_LENGTH, motions: Sequence[ToolComponent] = TOOL_COMPONENTS
) -> Array:
    """Return the size of pose differences, sqrt(|translation|^2 + eta^2 |rotation|^2), shape=(...) [m].

    A smooth variant of (8.15): as a quadratic form it can be projected, averaged and fitted. eta is in m/rad; of a
    robot with `tool_motions` only these count.
    """
    return np.asarray(np.linalg.norm(np.asarray(difference, dtype=float) * tip_weights(eta, motions), axis=-1))


def weighted_energy(errors: ArrayLike) -> Array:
    """Return E of (8.15) for [translation; eta times rotation vector], shape=(..., 6) [m]."""
    weighted = np.asarray(errors, dtype=float)
    return np.asarray(np.linalg.norm(weighted[..., :3], axis=-1) + np.linalg.norm(weighted[..., 3:], axis=-1))


def tip_weights(eta: float = TIP_LENGTH, motions: Sequence[ToolComponent] = TOOL_COMPONENTS) -> Array:
    """Return the weights (1, 1, 1, eta, eta, eta) of the tip-weighted size, 0 beside a tool's motions, shape=(6,)."""
    return np.repeat([1.0, _checked_eta(eta)], 3) * [name in motions for name in TOOL_COMPONENTS]


def rotation_vector(rotation: ArrayLike) -> Array:
    """Return the rotation vectors of rotation matrices, without loss near 0 and pi, shape=(..., 3) [rad]."""
    matrices = np.asarray(rotation, dtype=float).reshape(-1, 3, 3)
    # sine and cosine of the angle together lose no digits, except for the axis near pi
    sines = 0.5 * np.stack([matrices[:, i, j] - matrices[:, j, i] for i, j in ((2, 1), (0, 2), (1, 0))], axis=1)
    cosines = 0.5 * (matrices[:, 0, 0] + matrices[:, 1, 1] + matrices[:, 2, 2] - 1.0)
    sizes = np.sqrt(np.einsum("ni,ni->n", sines, sines))
    vectors = sines * (np.arctan2(sizes, cosines) / np.where(sizes > 0.0, sizes, 1.0))[:, None]
    far = np.flatnonzero(cosines <= 0.0)
    if far.size:
        from scipy.spatial.transform import Rotation  # loads slower than everything else that one pose needs

        vectors[far] = Rotation.from_matrix(matrices[far]).as_rotvec()
    return np.asarray(vectors.reshape(np.shape(rotation)[:-1]))


def rotation_matrix(vector: ArrayLike) -> Array:
    """Return the rotation matrices of rotation vectors, shape=(..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    turns = np.asarray(vector, dtype=float)
    return np.asarray(Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix()).reshape(*turns.shape, 3)


def quaternion(rotation: ArrayLike) -> Array:
    """Return unit quaternions (w, x, y, z) with w >= 0 of rotation matrices, shape=(..., 4)."""
    from scipy.spatial.transform import Rotation

    matrices = np.asarray(rotation, dtype=float)
    found = np.asarray(Rotation.from_matrix(matrices.reshape(-1, 3, 3)).as_quat(canonical=True))
    return np.roll(found, 1, axis=-1).reshape(*matrices.shape[:-2], 4)


def rotation_of_quaternion(quaternions: ArrayLike) -> Array:
    """Return the rotation matrices of quaternions (w, x, y, z) of any length but zero, shape=(..., 3, 3)."""
    from scipy.spatial.transform import Rotation

    numbers = np.asarray(quaternions, dtype=float)
    rows = np.roll(numbers.reshape(-1, 4), -1, axis=-1)
    return np.asarray(Rotation.from_quat(rows).as_matrix()).reshape(*numbers.shape[:-1], 3, 3)


def rotation_vector_rates(rotation: ArrayLike) -> Array:
    """Return the derivative of the rotation vector of R by a further rotation in the rotated axes, shape=(..., 3, 3).

    log(R exp(w)) = log(R) + J w + ..., J = 1 + [a]/2 + (1 - (|a|/2) cot(|a|/2)) / |a|^2 [a]^2 with a = log(R) (F. Bullo
    and R. Murray, 1995).
    """
    turn = rotation_vector(rotation)
    half = 0.5 * np.linalg.norm(turn, axis=-1)[..., None, None]
    small = half < _SMALL_HALF_ANGLE
    safe = np.where(small, 1.0, half)
    second = np.where(small, 1.0 / 12.0 + half**2 / 180.0, (1.0 - safe / np.tan(safe)) / (4.0 * safe**2))
    cross = np.zeros((*turn.shape[:-1], 3, 3))
    cross[..., 0, 1], cross[..., 0, 2], cross[..., 1, 2] = -turn[..., 2], turn[..., 1], -turn[..., 0]
    cross -= np.swapaxes(cross, -1, -2)
    return np.asarray(np.eye(3) + 0.5 * cross + second * cross @ cross)


def chapter_angles(rotation: ArrayLike) -> Array:
    """Return (psi, theta, phi) of a rotation, (8.11): R = Rz(psi) Ry(theta) Rx(phi), shape=(..., 3) [rad].

    theta is in [-pi/2, pi/2]. At its ends only psi + phi or psi - phi is determined.
    """
    r = np.asarray(rotation, dtype=float)
    theta = np.arctan2(-r[..., 2, 0], np.hypot(r[..., 2, 1], r[..., 2, 2]))
    phi = np.arctan2(r[..., 2, 1], r[..., 2, 2])
    # from the second column and row after removing phi, so that psi compensates for phi near theta = pi/2
    sine, cosine = np.sin(phi), np.cos(phi)
    psi = np.arctan2(sine * r[..., 0, 2] - cosine * r[..., 0, 1], cosine * r[..., 1, 1] - sine * r[..., 1, 2])
    return np.stack([psi, theta, phi], axis=-1)


def chapter_rotation(angles: ArrayLike) -> Array:
    """Return Rz(psi) Ry(theta) Rx(phi), shape=(..., 3, 3): (8.12) with entry (3, 1) = -sin(theta)."""
    from scipy.spatial.transform import Rotation

    numbers = np.asarray(angles, dtype=float)
    return np.asarray(Rotation.from_euler("ZYX", numbers.reshape(-1, 3)).as_matrix()).reshape(*numbers.shape, 3)


def _checked(pose: ArrayLike) -> Array:
    array = np.asarray(pose, dtype=float)
    if array.shape[-2:] != (4, 4):
        raise ShapeError("pose", array.shape, "(..., 4, 4)")
    x, y, z = np.moveaxis(array[..., :3, :3], -2, 0)
    # the triple product by entries; LAPACK's determinant takes twenty times as long
    sides = (
        x[..., i] * (y[..., j] * z[..., k] - y[..., k] * z[..., j]) for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1))
    )
    if (sum(sides, start=np.zeros(())) < 0.0).any():
        raise InvalidValueError("pose", problem="is a reflection", expected="rotations, of determinant 1")
    return array


def _position(pose: ArrayLike) -> Array:
    return _checked(pose)[..., :3, 3]


def _checked_eta(eta: float) -> float:
    if not (np.isfinite(eta) and eta >= 0.0):
        raise InvalidValueError("eta", eta, "a non-negative length in metres per radian")
    return float(eta)
