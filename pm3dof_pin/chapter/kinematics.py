"""Inverse kinematics and Jacobians of the tripod in closed form, equations (8.3)-(8.10) with the errata."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError, ShapeError, UnreachablePoseError
from pm3dof_pin.typing import Array, OnFailure


def rotation(theta_x: ArrayLike, theta_y: ArrayLike) -> Array:
    """Return the platform's orientation R = Rx(theta_x) Ry(theta_y), (8.3), shape=(..., 3, 3)."""
    x, y = np.broadcast_arrays(np.asarray(theta_x, dtype=float), np.asarray(theta_y, dtype=float))
    with np.errstate(invalid="ignore"):  # an infinite angle gives NaN
        cx, sx, cy, sy = np.cos(x), np.sin(x), np.cos(y), np.sin(y)
    entries = np.empty((3, 3, *x.shape))  # poses are contiguous in memory, as NumPy traverses them
    rows = ((cy, 0.0, sy), (sx * sy, cx, -sx * cy), (-cx * sy, sx, cx * cy))
    for row, column in np.ndindex(3, 3):
        entries[row, column] = rows[row][column]
    return np.moveaxis(entries, (0, 1), (-2, -1))


def placement(poses: ArrayLike) -> Array:
    """Return the homogeneous transform of the platform in the base frame, (8.3), shape=(..., 4, 4)."""
    array = np.asarray(poses, dtype=float)
    if array.ndim == 0 or array.shape[-1] != 3:
        raise ShapeError("poses", array.shape, "(..., 3): theta_x, theta_y, z_e")
    transform = np.zeros((*array.shape[:-1], 4, 4))
    transform[..., :3, :3] = rotation(array[..., 0], array[..., 1])
    transform[..., 2, 3] = array[..., 2]
    transform[..., 3, 3] = 1.0
    return transform


def motion_twists(poses: ArrayLike) -> Array:
    """Return the map from (theta_x, theta_y, z_e) rates to the platform's twist [v; omega] at O_e, shape=(..., 6, 3).

    The correct form of (8.10), in the axes of the base: v = (0, 0, dz_e) and omega = (dtheta_x, cos(theta_x) dtheta_y,
    sin(theta_x) dtheta_y).
    """
    theta_x = np.asarray(poses, dtype=float)[..., 0]
    twists = np.zeros((*theta_x.shape, 6, 3))
    twists[..., 2, 2] = 1.0
    twists[..., 3, 0] = 1.0
    twists[..., 4, 1] = np.cos(theta_x)
    twists[..., 5, 1] = np.sin(theta_x)
    return twists


@dataclass(frozen=True, eq=False)
class Legs:
    """The actuated legs at a batch of poses, NaN where a link does not meet its guideway."""

    tripod: Tripod  #: the machine
    orientation: Array  #: R of the platform, shape=(..., 3, 3)
    arms: Array  #: R p_i, platform joints E_i relative to O_e, base axes, shape=(..., n, 3) [m]
    travels: Array  #: u_i, shape=(..., n) [m]
    links: Array  #: k_i = D_i E_i, base axes, (8.7), shape=(..., n, 3) [m]

    @classmethod
    def at(cls, tripod: Tripod, poses: Array, modes: Array | float = -1.0) -> Legs:
        """Place the legs at poses, shape=(..., 3), in assembly modes, shape=(n,) or (); (8.4), (8.6), (8.7)."""
        orientation = rotation(poses[..., 0], poses[..., 1])
        arms = _dotted(orientation, tripod.platform_joints)
        reach = arms - tripod.base_joints  # w_i = E_i - B_i
        reach[..., 2] += poses[..., 2, None]
        along = _dot(reach, tripod.guide_directions)
        with np.errstate(invalid="ignore"):
            root = np.sqrt(along**2 - _dot(reach, reach) + tripod.parameters.link_length**2)
        travels = along + modes * root
        return cls(tripod, orientation, arms, travels, reach - travels[..., None] * tripod.guide_directions)

    @cached_property
    def directions(self) -> Array:
        """n_i, unit vectors along the links, shape=(..., n, 3)."""
        return self.links / self.tripod.parameters.link_length

    @cached_property
    def cosines(self) -> Array:
        """n_i . e_i, the cosines between links and guideways, shape=(..., n)."""
        return _dot(self.directions, self.tripod.guide_directions)

    @cached_property
    def wrenches(self) -> Array:
        """w_i = [n_i; R p_i x n_i], unit wrenches of the links at O_e, shape=(..., n, 6)."""
        return np.concatenate([self.directions, np.cross(self.arms, self.directions)], axis=-1)

    @cached_property
    def passive_angles(self) -> Array:
        """Angles of the passive joints, see :func:`passive_joint_angles`, shape=(..., n, 3) [rad]."""
        x, y, z, sockets = self._in_joints()
        (ax, ay, az), (bx, by, bz) = np.moveaxis(sockets, -1, 0), np.moveaxis(self.links, -1, 0)
        across = np.sqrt((ay * bz - az * by) ** 2 + (az * bx - ax * bz) ** 2 + (ax * by - ay * bx) ** 2)
        angles = np.empty_like(self.links)
        angles[..., 0] = np.arctan2(x, z)
        angles[..., 1] = -np.arctan2(y, np.sqrt(x * x + z * z))
        angles[..., 2] = np.arctan2(across, _dot(sockets, self.links))
        return angles

    @cached_property
    def passive_cosines(self) -> Array:
        """Cosines of :attr:`passive_angles`, in a third of the time, shape=(..., n, 3)."""
        x, _, z, sockets = self._in_joints()
        fold = np.sqrt(x * x + z * z)
        cosines = np.empty_like(self.links)
        with np.errstate(invalid="ignore"):
            cosines[..., 0] = z / fold
        cosines[..., 1] = fold / self.tripod.parameters.link_length
        cosines[..., 2] = _dot(sockets, self.links) / self.tripod.parameters.link_length
        return cosines

    def _in_joints(self) -> tuple[Array, Array, Array, Array]:
        """Return x, y, z of the links in their universal joints, and the sockets' axes in the base frame."""
        frames = np.moveaxis(self.tripod.link_frames, -1, 0)
        bx, by, bz = np.moveaxis(self.links, -1, 0)
        x, y, z = (bx * axis[:, 0] + by * axis[:, 1] + bz * axis[:, 2] for axis in frames)
        return x, y, z, _dotted(self.orientation, self.tripod.socket_axes)


def _dot(a: Array, b: Array) -> Array:
    """Return scalar products along the last axis."""
    product: Array = np.sum(a * b, axis=-1)
    return product


def _dotted(matrices: Array, vectors: Array) -> Array:
    """Rotate each of n vectors by each of many matrices, shapes=(..., 3, 3), (n, 3) to (..., n, 3)."""
    shape = matrices.shape[:-2]
    turned = vectors @ np.moveaxis(matrices, (-2, -1), (0, 1)).reshape(3, 3, math.prod(shape))
    return np.moveaxis(turned.reshape(3, len(vectors), *shape), (0, 1), (-1, -2))


def inverse_kinematics(
    tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1, on_failure: OnFailure = "raise"
) -> Array:
    """Return the slider travels u_i for each pose of the platform, (8.6), (8.7).

    Args:
        tripod: the machine.
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        assembly_mode: which of a leg's two solutions: -1 slider below the platform (the chapter's), +1 above it; one
            number or one for each leg.
        on_failure: "raise", or "nan" to mark poses out of reach in the result.

    Returns:
        u, shape=(..., n) [m]. Joint limits are not checked: see :func:`~pm3dof_pin.chapter.limits.limit_flags`.

    Raises:
        UnreachablePoseError: a link cannot meet its guideway, and `on_failure` is "raise".
        InvalidValueError: poses or modes of a wrong shape; or a pose is not finite, and `on_failure` is "raise".
    """
    return placed_legs(tripod, tripod.checked(poses), on_failure, tripod.checked_modes(assembly_mode)).travels


def placed_legs(tripod: Tripod, poses: Array, on_failure: OnFailure, modes: Array | float = -1.0) -> Legs:
    """Return the legs at checked poses; those out of reach or not finite raise, or are NaN."""
    legs = Legs.at(tripod, poses, modes)
    if on_failure == "raise":
        _require_reach(tripod, poses, legs.travels)
    return legs


def _require_reach(tripod: Tripod, poses: Array, u: Array) -> None:
    """Raise UnreachablePoseError naming pose and leg if travels u are NaN; InvalidValueError if the pose is."""
    infinite = np.argwhere(~np.all(np.isfinite(poses), axis=-1))
    if len(infinite):
        first = tuple(int(entry) for entry in infinite[0])
        place = f" {first} of the array" if first else ""
        raise InvalidValueError(f"pose{place}", poses[first].tolist(), "finite theta_x, theta_y [rad] and z_e [m]")
    unreachable = np.argwhere(np.isnan(u))
    if len(unreachable) == 0:
        return
    index = tuple(int(entry) for entry in unreachable[0])
    theta_x, theta_y, z_e = np.broadcast_to(poses, (*u.shape[:-1], 3))[index[:-1]]
    place = f" (pose {index[:-1]} of the array)" if len(index) > 1 else ""
    pose = f"theta_x = {np.degrees(theta_x):.4g} deg, theta_y = {np.degrees(theta_y):.4g} deg, z_e = {z_e:.4g} m"
    raise UnreachablePoseError(
        f"pose {pose}{place} is out of reach: the link of leg {index[-1] + 1}, "
        f"{tripod.parameters.link_length:g} m long, does not meet its guideway"
    )


def link_vectors(tripod: Tripod, poses: ArrayLike) -> Array:
    """Return k_i = D_i E_i in the base frame, (8.7), NaN out of reach, shape=(..., n, 3) [m]."""
    return Legs.at(tripod, tripod.checked(poses)).links


def platform_joint_jacobians(tripod: Tripod, poses: ArrayLike) -> Array:
    """Return J_i, the derivative of E_i by (theta_x, theta_y, z_e), (8.5), shape=(..., n, 3, 3) [m/rad, m/rad, 1]."""
    pose_array = tripod.checked(poses)
    arms = _dotted(rotation(pose_array[..., 0], pose_array[..., 1]), tripod.platform_joints)
    twists = motion_twists(pose_array)[..., None, :, :]
    # column k is v_k + omega_k x R p_i
    turned = np.cross(np.swapaxes(twists[..., 3:, :], -1, -2), arms[..., None, :])
    return twists[..., :3, :] + np.swapaxes(turned, -1, -2)


def link_jacobian(tripod: Tripod, poses: ArrayLike, *, on_failure: OnFailure = "raise") -> Array:
    """Return J_a, the derivative of the link lengths by (theta_x, theta_y, z_e) with the sliders locked, (8.10).

    Shape=(..., n, 3) [m/rad, m/rad, 1]; errors are those of :func:`inverse_kinematics`.
    """
    return placed_legs(tripod, tripod.checked(poses), on_failure).wrenches @ motion_twists(poses)


def slider_jacobian(tripod: Tripod, poses: ArrayLike, *, on_failure: OnFailure = "raise") -> Array:
    """Return J_t, the derivative of the slider travels by (theta_x, theta_y, z_e) with rigid links, (8.9), like J_a."""
    legs = placed_legs(tripod, tripod.checked(poses), on_failure)
    return legs.wrenches @ motion_twists(poses) / legs.cosines[..., None]


def passive_joint_angles(tripod: Tripod, poses: ArrayLike, *, on_failure: OnFailure = "raise") -> Array:
    """Return (first, second, swing), the angles of the passive joints of every leg, shape=(..., n, 3) [rad].

    The universal joint at D_i rotates first about the horizontal axis normal to the link's home direction, then about
    the axis normal to both; both angles are zero at home. The swing of the spherical joint is the angle between the
    link and the joint's axis in the platform. Errors are those of :func:`inverse_kinematics`.
    """
    return placed_legs(tripod, tripod.checked(poses), on_failure).passive_angles


def joint_positions(tripod: Tripod, pose: ArrayLike) -> dict[str, float]:
    """Return the coordinate of every joint of the URDF by name [m, rad], all loops closed at one pose; zero at home.

    Errors are those of :func:`inverse_kinematics`.
    """
    theta_x, theta_y, z_e = tripod.checked_pose(pose)
    u = inverse_kinematics(tripod, pose)
    angles = passive_joint_angles(tripod, pose)
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
