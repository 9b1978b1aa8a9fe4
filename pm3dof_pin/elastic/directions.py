"""Free and rigid directions of a frame: found by singular values, and described in words."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.kinematics.degrees_of_freedom import RankDecision
from pm3dof_pin.typing import Matrix, Vector

_NO_PART = 1e-6


def range_and_complement(columns: Matrix, threshold: float) -> tuple[Matrix, Matrix]:
    """Return orthonormal bases of the column space and of its complement."""
    left, values, _ = np.linalg.svd(columns) if columns.size else (np.eye(len(columns)), np.zeros(0), None)
    rank = RankDecision.of(values, threshold).rank
    return left[:, :rank], left[:, rank:]


def direction_names(twists: Matrix) -> str:
    """Describe twists [v; omega], shape=(6, k), world axes, in words."""
    return "; ".join(_named(twist) for twist in twists.T)


def _named(twist: Vector) -> str:
    translation, rotation = twist[:3], twist[3:]
    turn, shift = np.linalg.norm(rotation), np.linalg.norm(translation)
    if turn <= _NO_PART:
        return f"translation along {_numbers(translation / shift)}"
    if shift <= _NO_PART:
        return f"rotation about {_numbers(rotation / turn)}"
    return f"rotation about {_numbers(rotation / turn)} with translation {_numbers(translation / turn)} m/rad"


def _numbers(vector: Vector) -> str:
    # adding zero turns minus zero into zero
    return f"({', '.join(f'{number + 0.0:.6g}' for number in np.round(vector, 9))})"
