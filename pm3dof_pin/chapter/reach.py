"""Poses out of reach: which leg fails, said in words."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError

if TYPE_CHECKING:
    from pm3dof_pin.chapter.tripod import Tripod


def require_reach(tripod: Tripod, poses: NDArray[np.float64], u: NDArray[np.float64]) -> None:
    """Raise for the first pose that a leg cannot reach.

    Args:
        tripod: the machine.
        poses: shape=(..., 3) [rad, rad, m].
        u: slider travels with NaN out of reach, shape=(..., n) [m].

    Raises:
        UnreachablePoseError: naming pose and leg.
        InvalidValueError: a pose is not a number.
    """
    infinite = np.argwhere(~np.all(np.isfinite(poses), axis=-1))
    if len(infinite):
        first = tuple(int(entry) for entry in infinite[0])
        where = f" {first} of the array" if first else ""
        raise InvalidValueError(f"pose{where}", poses[first].tolist(), "finite theta_x, theta_y [rad] and z_e [m]")
    bad = np.argwhere(np.isnan(u))
    if len(bad) == 0:
        return
    index = tuple(int(entry) for entry in bad[0])
    theta_x, theta_y, z_e = np.broadcast_to(poses, (*u.shape[:-1], 3))[index[:-1]]
    where = f" (pose {index[:-1]} of the array)" if len(index) > 1 else ""
    pose = f"theta_x = {np.degrees(theta_x):.4g} deg, theta_y = {np.degrees(theta_y):.4g} deg, z_e = {z_e:.4g} m"
    raise UnreachablePoseError(
        f"pose {pose}{where} is out of reach: the link of leg {index[-1] + 1}, "
        f"{tripod.parameters.link_length:g} m long, does not meet its guideway"
    )
