"""Components of the tool's placement: x, y, z, and rx, ry, rz of R = Rx(rx) Ry(ry) Rz(rz), as in equation (8.3)."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.typing import Array, Matrix


def rotation_of_angles(angles: ArrayLike) -> Array:
    """Return R = Rx(rx) Ry(ry) Rz(rz), shape=(..., 3, 3), of angles, shape=(..., 3) [rad]."""
    rx, ry, rz = np.moveaxis(np.asarray(angles, dtype=float), -1, 0)
    cx, sx, cy, sy, cz, sz = np.cos(rx), np.sin(rx), np.cos(ry), np.sin(ry), np.cos(rz), np.sin(rz)
    rows = [
        [cy * cz, -cy * sz, sy],
        [cx * sz + sx * sy * cz, cx * cz - sx * sy * sz, -sx * cy],
        [sx * sz - cx * sy * cz, sx * cz + cx * sy * sz, cx * cy],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def tool_components(transforms: ArrayLike) -> Array:
    """Return x, y, z [m], rx, ry, rz [rad] of homogeneous transforms, shape=(..., 4, 4), as shape=(..., 6).

    ry is in [-pi/2, pi/2]; at its ends rx and rz are not unique.
    """
    r = np.asarray(transforms, dtype=float)
    ry = np.arctan2(r[..., 0, 2], np.hypot(r[..., 0, 0], r[..., 0, 1]))
    rx = np.arctan2(-r[..., 1, 2], r[..., 2, 2])
    rz = np.arctan2(-r[..., 0, 1], r[..., 0, 0])
    return np.concatenate([r[..., :3, 3], np.stack([rx, ry, rz], axis=-1)], axis=-1)


def angle_rates(angles: ArrayLike) -> Matrix:
    """Return the matrix that takes an angular velocity in the base to the rates of rx, ry, rz, shape=(3, 3)."""
    rx, ry, _ = np.asarray(angles, dtype=float)
    cx, sx, cy, ty = np.cos(rx), np.sin(rx), np.cos(ry), np.tan(ry)
    return np.array([[1.0, sx * ty, -cx * ty], [0.0, cx, sx], [0.0, -sx / cy, cx / cy]])
