"""Indices of a 6 x 6 stiffness: directional values, blocks, ellipsoids, eigenvalues, conditioning.

All functions broadcast: K and C have shape (..., 6, 6), order x, y, z, rx, ry, rz. Comparing translations with
rotations requires a length, which is then an argument: the characteristic length [m].
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import MOTIONS, Array, Motion

OtherMotions = Literal["free", "held"]

_BLOCKS = {"translation": slice(0, 3), "rotation": slice(3, 6)}


@dataclass(frozen=True)
class Ellipsoid:
    """Principal values and directions of a symmetric 3 x 3 matrix, ascending."""

    values: Array  #: principal stiffnesses or compliances, shape=(..., 3)
    axes: Array  #: their directions as columns, a right-handed frame, shape=(..., 3, 3)


def condensed_stiffness(compliance: ArrayLike, motion: Motion = "translation", others: OtherMotions = "free") -> Array:
    """Return the 3 x 3 stiffness of the translations or the rotations alone [N/m or N m/rad].

    The other three are "free", with no moment (force): inv(C_ff); or "held", fixed: K_ff.
    """
    if others == "held":
        return _block(inverse_definite(compliance), motion)
    inverse: Array = inverse_definite(_block(compliance, motion))
    return inverse


def axis_stiffness(compliances: ArrayLike, length: float = 1.0) -> Array:
    """Return the stiffness along and about each axis with all other motions free, shape=(..., 6) [N/m, N m/rad].

    Axes whose compliance is :func:`rounding` are rigid: infinitely stiff.

    Args:
        compliances: the diagonal of C, shape=(..., 6).
        length: the size of the machine [m].
    """
    diagonal = np.asarray(compliances, dtype=float)
    kinds = diagonal.reshape(*diagonal.shape[:-1], 2, 3)
    with np.errstate(divide="ignore"):
        stiffness: Array = np.where(kinds <= rounding(diagonal, length)[..., None], np.inf, 1.0 / kinds)
    return stiffness.reshape(diagonal.shape)


def rounding(compliances: ArrayLike, length: float = 1.0) -> Array:
    """Return up to what translational, and rotational, compliances are zero but for rounding, shape=(..., 2).

    That is relative to the greatest of the same kind; or, where all of a kind are zero, as at the centre of a spherical
    mechanism, to the square of what roots of the compliance lose of the other kind. Arguments as
    :func:`axis_stiffness`.
    """
    diagonal = np.asarray(compliances, dtype=float)
    kinds = diagonal.reshape(*diagonal.shape[:-1], 2, 3)
    # column by column: a reduction over an axis of three takes three times as long
    softest = np.maximum(np.maximum(kinds[..., 0], kinds[..., 1]), kinds[..., 2])
    other = softest[..., ::-1] * (ROUNDING**2 * np.array([length**2, length**-2]))
    return np.asarray(np.maximum(ROUNDING * softest, other))


def principal_axes(matrix: ArrayLike) -> Ellipsoid:
    """Return principal values and axes of a symmetric 3 x 3 block, shape=(..., 3, 3).

    The first axis of a stiffness block is the softest direction; that of a compliance block the stiffest.
    """
    block = np.asarray(matrix, dtype=float)
    finite = np.all(np.isfinite(block), axis=(-1, -2))
    values, axes = np.linalg.eigh(np.where(finite[..., None, None], block, np.eye(3)))
    axes[..., 2] *= np.sign(np.linalg.det(axes))[..., None]
    values[~finite], axes[~finite] = np.nan, np.nan
    return Ellipsoid(values, axes)


def characteristic_length(stiffness: ArrayLike) -> Array:
    """Return sqrt(tr K_rr / tr K_tt) [m], at which rotations and translations are equally stiff on average."""
    translation, rotation = (np.trace(_block(stiffness, motion), axis1=-2, axis2=-1) for motion in MOTIONS)
    length: Array = np.sqrt(rotation / translation)
    return length


def eigenvalues(stiffness: ArrayLike, length: ArrayLike) -> Array:
    """Return the ascending eigenvalues of K with rotations as displacements at a length h, shape=(..., 6) [N/m].

    With D = diag(1, 1, 1, 1/h, 1/h, 1/h) these are the eigenvalues of D K D.

    Raises:
        InvalidValueError: a length is not positive.
    """
    h = np.asarray(length, dtype=float)
    if np.any(h <= 0.0):
        raise InvalidValueError("length", h.tolist(), "positive lengths")
    scale = np.ones((*h.shape, 6))
    scale[..., 3:] = 1.0 / h[..., None]
    scaled = np.asarray(stiffness, dtype=float) * scale[..., :, None] * scale[..., None, :]
    finite = np.all(np.isfinite(scaled), axis=(-1, -2))
    values = np.linalg.eigvalsh(np.where(finite[..., None, None], scaled, np.eye(6)))
    return np.where(finite[..., None], values, np.nan)


def condition_number(stiffness: ArrayLike, length: ArrayLike) -> Array:
    """Return the ratio of the largest to the least eigenvalue of K at a characteristic length, shape=(...)."""
    values = eigenvalues(stiffness, length)
    ratio: Array = values[..., -1] / values[..., 0]
    return ratio


def _block(matrix: ArrayLike, motion: Motion) -> Array:
    rows = _BLOCKS[motion]
    return np.asarray(matrix, dtype=float)[..., rows, rows]
