"""Joint limits of the tripod (Table 8.1): which limit does a pose break, and by how much."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.chapter.kinematics import Legs, inverse_kinematics, passive_joint_angles
from pm3dof_pin.chapter.tripod import Tripod


class Limit(IntFlag):
    """What may exclude a pose; combinations are sums.

    Attributes:
        REACH: a link is too short, whatever its slider does.
        STROKE: a slider leaves its travel.
        UNIVERSAL: a universal joint at D_i turns too far.
        SPHERICAL: a link leaves the cone of its spherical joint at E_i.
        TILT: the universal joint of the passive leg turns too far.
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
"""Names of the limits, from the lowest bit on."""


@dataclass(frozen=True)
class LimitViolation:
    """One joint outside its range.

    Attributes:
        joint: name of the joint, as in the URDF, where the spherical joints `spherical1` .. are loop closures.
        limit: the kind of limit.
        value: the joint's coordinate [unit].
        lower: lower end of its range [unit].
        upper: upper end of its range [unit].
        unit: "m" or "rad".
    """

    joint: str
    limit: Limit
    value: float
    lower: float
    upper: float
    unit: str

    def __str__(self) -> str:
        """One line for a person, angles in degrees."""
        factor, unit, digits = (1.0, "m", 4) if self.unit == "m" else (180.0 / math.pi, "deg", 2)
        value, lower, upper = (f"{number * factor:.{digits}f}" for number in (self.value, self.lower, self.upper))
        return f"{self.joint} at {value} {unit}, outside {lower} .. {upper} {unit}"


def broken_limits(tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1) -> NDArray[np.uint8]:
    """Tell which kinds of limits each pose breaks.

    Args:
        tripod: the machine.
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        assembly_mode: -1 or +1 for every leg, broadcast to shape=(n,).

    Returns:
        Sums of :class:`Limit`, shape=(...); zero where the pose is within every limit.

    Raises:
        InvalidValueError: poses or modes of a wrong shape.
    """
    pose_array, modes = tripod.checked(poses, assembly_mode)
    u_min, u_max, universal, spherical, z_low, z_high = tripod.bounds
    legs = Legs.at(tripod, pose_array, modes)
    u, angles = legs.travels, legs.passive_angles
    tilts, height = np.abs(pose_array[..., :2]), pose_array[..., 2]
    # comparisons with NaN are false: a leg out of reach breaks REACH alone, a pose that is not a number its own limit
    broken = {
        Limit.REACH: np.isnan(u).any(axis=-1),
        Limit.STROKE: ((u < u_min) | (u > u_max)).any(axis=-1),
        Limit.UNIVERSAL: (np.abs(angles[..., :2]) > universal).any(axis=(-1, -2)),
        Limit.SPHERICAL: (angles[..., 2] > spherical).any(axis=-1),
        Limit.TILT: ~(tilts <= universal).all(axis=-1),
        Limit.HEIGHT: ~((z_low <= height) & (height <= z_high)),
    }
    flags = np.zeros(pose_array.shape[:-1], dtype=np.uint8)
    for limit, where_broken in broken.items():
        flags |= np.where(where_broken, np.uint8(limit), np.uint8(0))
    return flags


def limit_violations(tripod: Tripod, pose: ArrayLike, *, assembly_mode: ArrayLike = -1) -> list[LimitViolation]:
    """List every joint that a single pose takes outside its range.

    Args:
        tripod: the machine.
        pose: (theta_x, theta_y, z_e), shape=(3,) [rad, rad, m].
        assembly_mode: -1 or +1 for every leg.

    Raises:
        UnreachablePoseError: a link is too short for the pose.
        InvalidValueError: not one pose of finite numbers, or a mode that is not -1 or +1.
    """
    p = tripod.parameters
    theta_x, theta_y, z_e = tripod.checked_pose(pose)
    u = inverse_kinematics(tripod, pose, assembly_mode=assembly_mode)
    angles = passive_joint_angles(tripod, pose, assembly_mode=assembly_mode)
    u_min, u_max, universal, spherical, z_low, z_high = tripod.bounds
    candidates = [
        LimitViolation("platform_x_joint", Limit.TILT, theta_x, -p.universal_limit, p.universal_limit, "rad"),
        LimitViolation("platform_y_joint", Limit.TILT, theta_y, -p.universal_limit, p.universal_limit, "rad"),
        LimitViolation("passive_slider_joint", Limit.HEIGHT, z_e, z_low, z_high, "m"),
    ]
    for leg in range(p.leg_count):
        first, second, swing = angles[leg]
        candidates += [
            LimitViolation(f"slider{leg + 1}_joint", Limit.STROKE, u[leg], u_min, u_max, "m"),
            LimitViolation(f"universal{leg + 1}_first_joint", Limit.UNIVERSAL, first, -universal, universal, "rad"),
            LimitViolation(f"universal{leg + 1}_second_joint", Limit.UNIVERSAL, second, -universal, universal, "rad"),
            LimitViolation(f"spherical{leg + 1}", Limit.SPHERICAL, swing, 0.0, spherical, "rad"),
        ]
    return [entry for entry in candidates if not entry.lower <= entry.value <= entry.upper]
