"""The tripod's coordinates and limits in closed form, for searching its workspace (Fig. 8.2)."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.chapter.limits import LIMIT_NAMES, limit_flags
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.maps.limit_space import Flags, LimitSpace
from pm3dof_pin.typing import Array


def tripod_space(tripod: Tripod) -> LimitSpace:
    """Return theta_x and theta_y, stacked along z_e, with the limits of Table 8.1."""

    def broken(values: Array) -> Flags:
        return limit_flags(tripod, values).astype(np.uint32)

    lowest, highest = tripod.bounds[4:]
    tilt = 1.001 * tripod.parameters.universal_limit  # beyond either angle of the passive leg
    return LimitSpace(
        machine=tripod.parameters.name,
        names=("theta_x", "theta_y", "z_e"),
        units=("rad", "rad", "m"),
        limits=LIMIT_NAMES,
        broken_limits=broken,
        box=np.array([(-tilt, tilt), (-tilt, tilt), (lowest, highest)]),
        start=np.array([0.0, 0.0, tripod.middle_height]),
    )
