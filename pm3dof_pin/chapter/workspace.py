"""The tripod's coordinates and limits in closed form, for searching its workspace (Fig. 8.2)."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.chapter.limits import LIMIT_NAMES, limit_flags
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.maps.limit_space import Flags, LimitSpace
from pm3dof_pin.typing import Array

_RAY_STEP = float(np.radians(1.0))
_HEIGHT_STEP = 2e-3


def tripod_space(tripod: Tripod) -> LimitSpace:
    """Return theta_x and theta_y about the level platform, stacked along z_e, with the limits of Table 8.1."""

    def broken(values: Array) -> Flags:
        return limit_flags(tripod, values).astype(np.uint32)

    lowest, highest = tripod.bounds[4:]
    return LimitSpace(
        machine=tripod.parameters.name,
        names=("theta_x", "theta_y", "z_e"),
        units=("rad", "rad", "m"),
        limits=LIMIT_NAMES,
        broken_limits=broken,
        centre=np.zeros(2),
        scale=np.ones(2),
        reach=1.001 * float(np.sqrt(2.0)) * tripod.parameters.universal_limit,  # beyond both angles of the passive leg
        ray_step=_RAY_STEP,
        level_range=(float(lowest), float(highest)),
        level_step=_HEIGHT_STEP,
    )
