"""Whether a mass and moments of inertia are physically possible."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pm3dof_pin.typing import Matrix

MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")
"""Names of the entries of a matrix of inertia, in order."""

TOLERANCE = 0.01
"""Tolerance of moments of inertia, relative to the greatest: CAD programs round."""

_GYRATION = 1e-6  # moments of a smaller radius of gyration are rounding errors [m]
_REVERSED = 0.5  # a moment this negative, relative to the greatest, is neither rounding nor a wrong sign of a product


def inertia_matrix(moments: Sequence[float]) -> Matrix:
    """Return ixx, iyy, izz, ixy, ixz, iyz as an inertia matrix, shape=(3, 3)."""
    xx, yy, zz, xy, xz, yz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_problem(mass: float, inertia: Matrix) -> str:
    """Return why no body can have this mass [kg] and inertia, shape=(3, 3) [kg m^2], or "" if one can.

    No principal moment about the centre of mass may be negative, or greater than the sum of the other two, by more
    than :data:`TOLERANCE` times the greatest, or mass times the square of a micrometre.
    """
    least, middle, greatest = _principal(inertia)
    slack = max(TOLERANCE * abs(greatest), mass * _GYRATION**2)
    if least >= -slack and greatest <= least + middle + slack:
        return ""
    wrong = "one is negative" if least < -slack else "the greatest is above the sum of the others"
    return f"its principal moments are {least:.4g}, {middle:.4g} and {greatest:.4g} kg m^2: {wrong}, not possible"


def is_reversed(mass: float, inertia: Matrix) -> bool:
    """Return whether an inertia is so far from a possible one that a sign or number must be wrong."""
    least, _, greatest = _principal(inertia)
    slack = mass * _GYRATION**2
    return bool(least < -max(_REVERSED * abs(greatest), slack) or (inertia.diagonal() < -slack).any())


def _principal(inertia: Matrix) -> list[float]:
    """Return the principal moments of an inertia, from the least on."""
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = inertia.tolist()
    return np.linalg.eigvalsh(inertia).tolist() if xy or xz or yz else sorted((xx, yy, zz))
