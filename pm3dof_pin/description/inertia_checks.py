"""Whether a mass and its moments of inertia are those of a body that can exist."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from pm3dof_pin.typing import Matrix

TOLERANCE = 0.01
"""How far moments of inertia may be from possible ones, as a part of the greatest: drawing programs round."""

_GYRATION = 1e-6  # a radius of gyration below which moments are rounding [m]
_REVERSED = 0.5  # negative by this part of the greatest, a moment is no slip of rounding or of a sign in a product


def inertia_matrix(moments: Sequence[float]) -> Matrix:
    """Return ixx, iyy, izz, ixy, ixz, iyz as a matrix, shape=(3, 3)."""
    xx, yy, zz, xy, xz, yz = moments
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def inertia_problem(mass: float, inertia: Matrix) -> str:
    """Tell why no body has this mass [kg] and these moments of inertia, shape=(3, 3) [kg m^2], or nothing if one may.

    The principal moments about the centre of mass are none negative and none above the sum of the other two, each by
    :data:`TOLERANCE` of the greatest, or by mass times the square of a micrometre.
    """
    least, middle, greatest = (float(moment) for moment in np.linalg.eigvalsh(inertia))
    slack = max(TOLERANCE * abs(greatest), mass * _GYRATION**2)
    if least >= -slack and greatest <= least + middle + slack:
        return ""
    wrong = "one is negative" if least < -slack else "the greatest is above the sum of the others"
    return f"its principal moments are {least:.4g}, {middle:.4g} and {greatest:.4g} kg m^2: {wrong}, as in no body"


def is_reversed(mass: float, inertia: Matrix) -> bool:
    """Tell whether moments of inertia are so far from possible ones that some sign or number is simply wrong."""
    least, _, greatest = np.linalg.eigvalsh(inertia)
    slack = mass * _GYRATION**2
    return bool(least < -max(_REVERSED * abs(greatest), slack) or (inertia.diagonal() < -slack).any())
