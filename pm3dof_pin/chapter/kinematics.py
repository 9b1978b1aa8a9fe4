"""Inverse kinematics and Jacobians of the tripod in closed form, equations (8.3)-(8.10) with the errata."""

from __future__ import annotations

import itertools
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter import kernels
from pm3dof_pin.chapter.reach import require_reach
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array

Unreachable = Literal["raise", "nan"]


def rotation(theta_x: ArrayLike, theta_y: ArrayLike) -> Array:
    """Return the platform's orientation R = Rx(theta_x) Ry(theta_y), (8.3), shape=(..., 3, 3)."""
    x, y = np.broadcast_arrays(np.asarray(theta_x, dtype=float), np.asarray(theta_y, dtype=float))
    cx, sx, cy, sy, zero = np.cos(x), np.sin(x), np.cos(y), np.sin(y), np.zeros(x.shape)
    rows = [[cy, zero, sy], [sx * sy, cx, -sx * cy], [-cx * sy, sx, cx * cy]]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def placement(poses: ArrayLike) -> Array:
    """Return the homogeneous transform of the platform in the base frame, (8.3).

    Args:
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].

    Returns:
        shape=(..., 4, 4).

    Raises:
        InvalidValueError: poses of a wrong shape.
    """
    array = np.asarray(poses, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise InvalidValueError("poses", f"an array of shape {array.shape}", "shape (..., 3): theta_x, theta_y, z_e")
    transform = np.zeros((*array.shape[:-1], 4, 4))
    transform[..., :3, :3] = rotation(array[..., 0], array[..., 1])
    transform[..., 2, 3] = array[..., 2]
    transform[..., 3, 3] = 1.0
    return transform


def motion_twists(poses: ArrayLike) -> Array:
    """Return the 6 x 3 map from (theta_x, theta_y, z_e) rates to the platform's twist [v; omega] at O_e.

    The correct form of (8.10), in the axes of the base: v = (0, 0, dz_e) and
    omega = (dtheta_x, cos(theta_x) dtheta_y, sin(theta_x) dtheta_y).

    Args:
        poses: shape=(..., 3) [rad, rad, m].

    Returns:
        shape=(..., 6, 3).
    """
    theta_x = np.asarray(poses, dtype=float)[..., 0]
    twists = np.zeros((*theta_x.shape, 6, 3))
    twists[..., 2, 2] = 1.0
    twists[..., 3, 0] = 1.0
    twists[..., 4, 1] = np.cos(theta_x)
    twists[..., 5, 1] = np.sin(theta_x)
    return twists


def inverse_kinematics(
    tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1, unreachable: Unreachable = "raise"
) -> Array:
    """Return the slider travels u_i that bring the platform to each pose, (8.6), (8.7).

    Args:
        tripod: the machine.
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        assembly_mode: which of a leg's two solutions: -1 slider below the platform (the chapter's), +1 above it; one
            number or one for each leg.
        unreachable: "raise", or "nan" to mark poses out of reach in the result.

    Returns:
        u, shape=(..., n) [m]. Joint limits are not looked at: see :func:`~pm3dof_pin.chapter.limits.limit_violations`.

    Raises:
        UnreachablePoseError: a link cannot meet its guideway, and `unreachable` is "raise".
        InvalidValueError: poses or modes of a wrong shape; or a pose is not finite, and `unreachable` is "raise".
    """
    pose_array, modes = tripod.checked(poses, assembly_mode)
    u: Array = kernels.slider_travel(pose_array, tripod.legs, modes)
    if unreachable == "raise":
        require_reach(tripod, pose_array, u)
    return u


def inverse_kinematics_modes(tripod: Tripod, pose: ArrayLike) -> dict[tuple[int, ...], Array]:
    """Return the slider travels of one pose for every assembly mode, 2^n of them.

    Args:
        tripod: the machine.
        pose: shape=(3,) [rad, rad, m].

    Raises:
        UnreachablePoseError: a link cannot meet its guideway.
    """
    modes = itertools.product((-1, 1), repeat=tripod.leg_count)
    return {mode: inverse_kinematics(tripod, pose, assembly_mode=mode) for mode in modes}


def assembly_mode_of(tripod: Tripod, poses: ArrayLike, u: ArrayLike) -> Array:
    """Tell in which assembly mode each leg stands.

    Args:
        tripod: the machine.
        poses: shape=(..., 3) [rad, rad, m].
        u: slider travels that belong to the poses, shape=(..., n) [m].

    Returns:
        -1 or +1 for every leg, shape=(..., n), as `assembly_mode` of the other functions takes it.
    """
    pose_array, _ = tripod.checked(poses, -1)
    transform = placement(pose_array)
    joints = tripod.platform_joints @ np.swapaxes(transform[..., :3, :3], -1, -2) + transform[..., None, :3, 3]
    along = np.sum((joints - tripod.base_joints) * tripod.guide_directions, axis=-1)
    return np.where(np.asarray(u, dtype=float) > along, 1.0, -1.0)


def link_vectors(tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1) -> Array:
    """Return k_i = D_i E_i in the base frame, (8.7), NaN out of reach, shape=(..., n, 3) [m]."""
    pose_array, modes = tripod.checked(poses, assembly_mode)
    vectors: Array = kernels.link_vectors(pose_array, tripod.legs, modes)
    return vectors


def platform_joint_jacobians(tripod: Tripod, poses: ArrayLike) -> Array:
    """Return J_i, the motion of E_i against (theta_x, theta_y, z_e), (8.5), shape=(..., n, 3, 3) [m/rad, m/rad, 1]."""
    pose_array, _ = tripod.checked(poses, -1)
    jacobians: Array = kernels.platform_joint_jacobians(pose_array, tripod.legs)
    return jacobians


def link_jacobian(tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1) -> Array:
    """Return J_a, the elongation of the links against (theta_x, theta_y, z_e) with the sliders locked, (8.10).

    Args:
        tripod: the machine.
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        assembly_mode: -1 or +1, once or for each leg.

    Returns:
        shape=(..., n, 3) [m/rad, m/rad, 1], NaN out of reach.

    Raises:
        InvalidValueError: poses or modes of a wrong shape.
    """
    pose_array, modes = tripod.checked(poses, assembly_mode)
    jacobian: Array = kernels.leg_jacobians(pose_array, tripod.legs, modes)[0]
    return jacobian


def actuation_jacobian(tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1) -> Array:
    """Return J_t, the travel of the sliders against (theta_x, theta_y, z_e) with rigid links, (8.9).

    Args:
        tripod: the machine.
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        assembly_mode: -1 or +1, once or for each leg.

    Returns:
        shape=(..., n, 3) [m/rad, m/rad, 1], NaN out of reach.

    Raises:
        InvalidValueError: poses or modes of a wrong shape.
    """
    pose_array, modes = tripod.checked(poses, assembly_mode)
    jacobian: Array = kernels.leg_jacobians(pose_array, tripod.legs, modes)[1]
    return jacobian


def passive_joint_angles(tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1) -> Array:
    """Return the angles of the passive joints of every leg.

    The universal joint at D_i first turns about the horizontal axis normal to the link's home direction, then about the
    axis normal to both; both angles count from home. The swing of the spherical joint is the angle between the link and
    the joint's axis in the platform.

    Args:
        tripod: the machine.
        poses: shape=(..., 3) [rad, rad, m].
        assembly_mode: -1 or +1, once or for each leg.

    Returns:
        (first, second, swing), shape=(..., n, 3) [rad], NaN out of reach.

    Raises:
        InvalidValueError: poses or modes of a wrong shape.
    """
    pose_array, modes = tripod.checked(poses, assembly_mode)
    angles: Array = kernels.passive_angles(pose_array, tripod.legs, modes)
    return angles


def joint_positions(tripod: Tripod, pose: ArrayLike, *, assembly_mode: ArrayLike = -1) -> dict[str, float]:
    """Return the coordinate of every joint of the URDF, by name, with all loops closed at one pose.

    Args:
        tripod: the machine.
        pose: shape=(3,) [rad, rad, m].
        assembly_mode: -1 or +1, once or for each leg.

    Returns:
        By name [m, rad]; all zero at home.

    Raises:
        UnreachablePoseError: a link cannot meet its guideway.
        InvalidValueError: not one pose of finite numbers, or a mode that is not -1 or +1.
    """
    theta_x, theta_y, z_e = tripod.checked_pose(pose)
    u = inverse_kinematics(tripod, pose, assembly_mode=assembly_mode)
    angles = passive_joint_angles(tripod, pose, assembly_mode=assembly_mode)
    positions = {
        "platform_x_joint": float(theta_x),
        "platform_y_joint": float(theta_y),
        "passive_slider_joint": float(z_e - tripod.height_home),
    }
    for leg in range(tripod.leg_count):
        positions[f"slider{leg + 1}_joint"] = float(u[leg] - tripod.parameters.slider_home)
        positions[f"universal{leg + 1}_first_joint"] = float(angles[leg, 0])
        positions[f"universal{leg + 1}_second_joint"] = float(angles[leg, 1])
    return positions
