"""Types shared by the whole package: arrays, and the two options of batch functions."""

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
"""Both, in the order of a twist."""

OnFailure: TypeAlias = Literal["raise", "nan"]
"""What a failing pose does: raise an error, or give NaN."""

Engine: TypeAlias = Literal["program", "pinocchio"]
"""What evaluates a batch: the robot's compiled program, or Pinocchio pose by pose."""

Branch: TypeAlias = Literal["home", "all"]
"""Which branches poses may be on: home's only, or any that the coordinates alone determine."""
