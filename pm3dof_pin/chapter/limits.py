"""Joint limits of the tripod (Table 8.1): which limit does a pose break, and by how much."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.chapter import kernels
from pm3dof_pin.chapter.kinematics import inverse_kinematics, passive_joint_angles
from pm3dof_pin.chapter.limit_kinds import Limit, LimitViolation
from pm3dof_pin.chapter.tripod import Tripod

__all__ = ["Limit", "LimitViolation", "broken_limits", "limit_violations"]


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
    flags: NDArray[np.uint8] = kernels.broken_limits(pose_array, tripod.legs, modes, tripod.bounds)
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
