"""Joint limits of the tripod (Table 8.1): which limits a pose breaks."""

from __future__ import annotations

import math
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.chapter.kinematics import Legs
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.typing import Array, Mask


class Limit(IntFlag):
    """Limits that may exclude a pose; combinations are sums.

    Attributes:
        REACH: a link is too short at any slider position.
        STROKE: a slider leaves its travel.
        UNIVERSAL: a universal joint at D_i rotates too far.
        SPHERICAL: a link leaves the cone of its spherical joint at E_i.
        TILT: the universal joint of the passive leg rotates too far.
        HEIGHT: the passive prismatic joint is at a stop.
    """

    NONE = 0
    REACH = 1
    STROKE = 2
    UNIVERSAL = 4
    SPHERICAL = 8
    TILT = 16
    HEIGHT = 32


LIMIT_NAMES = tuple(str(limit.name).lower() for limit in Limit)
"""Names of the limits, from the lowest bit."""

_BATCH = 16_384  # poses at a time: allocating large arrays takes longer than the computation


def limit_flags(tripod: Tripod, poses: ArrayLike) -> NDArray[np.uint8]:
    """Return sums of the :class:`Limit` that poses (theta_x, theta_y, z_e) break, shape=(...); zero within every limit.

    Raises:
        InvalidValueError: poses of a wrong shape.
    """
    pose_array = tripod.checked(poses)
    rows = pose_array.reshape(-1, 3)
    flags = np.zeros(len(rows), dtype=np.uint8)
    for start in range(0, len(rows), _BATCH):
        part = slice(start, start + _BATCH)
        for limit, where_broken in _broken(tripod, rows[part]).items():
            flags[part] |= np.where(where_broken, np.uint8(limit), np.uint8(0))
    return flags.reshape(pose_array.shape[:-1])


def _broken(tripod: Tripod, poses: Array) -> dict[Limit, Mask]:
    """Tell which of n poses break each limit."""
    u_min, u_max, universal, spherical, z_low, z_high = tripod.bounds
    legs = Legs.at(tripod, poses)
    u, cosines = legs.travels, legs.passive_cosines
    universal_cosine, spherical_cosine = (math.cos(min(angle, math.pi)) for angle in (universal, spherical))
    tilts, height = np.abs(poses[:, :2]), poses[:, 2]
    # comparisons with NaN are false: a leg out of reach breaks REACH alone, a pose that is not a number its own limit
    return {
        Limit.REACH: np.isnan(u).any(axis=-1),
        Limit.STROKE: ((u < u_min) | (u > u_max)).any(axis=-1),
        Limit.UNIVERSAL: (cosines[..., :2] < universal_cosine).any(axis=(-1, -2)),
        Limit.SPHERICAL: (cosines[..., 2] < spherical_cosine).any(axis=-1),
        Limit.TILT: ~(tilts <= universal).all(axis=-1),
        Limit.HEIGHT: ~((z_low <= height) & (height <= z_high)),
    }
