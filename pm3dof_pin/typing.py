"""Types that every room shares: arrays, and the two choices that batches offer."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

Array: TypeAlias = NDArray[np.float64]
Vector: TypeAlias = NDArray[np.float64]
Matrix: TypeAlias = NDArray[np.float64]
Mask: TypeAlias = NDArray[np.bool_]
Indices: TypeAlias = NDArray[np.intp]
Objects: TypeAlias = NDArray[np.object_]

Motion: TypeAlias = Literal["translation", "rotation"]
"""The two parts of a twist or of a displacement."""

MOTIONS: tuple[Motion, Motion] = ("translation", "rotation")
"""Both of them, in the order of a twist."""

OnFailure: TypeAlias = Literal["raise", "nan"]
"""What happens to a pose that fails: an error, or NaN in its place."""

Engine: TypeAlias = Literal["program", "pinocchio"]
"""What computes a batch: the robot's compiled program, or Pinocchio pose by pose."""
