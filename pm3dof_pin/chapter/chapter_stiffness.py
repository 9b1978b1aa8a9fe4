"""The stiffness of the chapter's section 8.2.3: a diagonal, recovered from Table 8.3.

The chapter prints coefficients and results, not the computation between them. Its numbers are reproduced by, per axis,

    motion axes       diag(k_t J_a^T J_a + k_a J_t^T J_t + diag(k_b, k_b, 0)),  k_b = E I / L^3,  L = z_e - z_b
    constrained axes  T_x = T_y = k_b / L^2,  theta_z = G J / L^2
    global            mean of the six

It adds the stiffnesses of actuator and link as if they were in parallel, and its coefficients of the passive leg have
other dimensions than the axes they are applied to: it is the published index, not the felt stiffness at the tool.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.kinematics import motion_twists, placed_legs
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, OnFailure

AXES = ("theta_x", "theta_y", "t_z", "t_x", "t_y", "theta_z")
UNITS = {"theta_x": "N m/rad", "theta_y": "N m/rad", "t_z": "N/m", "t_x": "N/m", "t_y": "N/m", "theta_z": "N m/rad"}


def chapter_stiffness(tripod: Tripod, poses: ArrayLike, *, on_failure: OnFailure = "raise") -> Array:
    """Return the chapter's diagonal stiffness, shape=(..., 6), in the order of :data:`AXES`, units of :data:`UNITS`.

    Poses are (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].

    Raises:
        UnreachablePoseError: a link cannot meet its guideway, and `on_failure` is "raise".
        InvalidValueError: poses of a wrong shape, or at or below the clamp of the passive leg, where L is not positive.
    """
    pose_array = tripod.checked(poses)
    legs = placed_legs(tripod, pose_array, on_failure)
    if on_failure == "raise":
        require_above_clamp(tripod, pose_array)
    link_jacobian = legs.wrenches @ motion_twists(pose_array)
    travel_jacobian = link_jacobian / legs.cosines[..., None]  # (8.9)
    return chapter_diagonal(tripod, pose_array[..., 2], link_jacobian, travel_jacobian, on_failure="nan")


def chapter_diagonal(
    tripod: Tripod, heights: Array, link_jacobian: Array, travel_jacobian: Array, *, on_failure: OnFailure = "raise"
) -> Array:
    """Return the chapter's diagonal, given J_a (8.10) and J_t (8.9), shape=(..., legs, 3); NaN where out of reach.

    Raises:
        InvalidValueError: a height is at or below the clamp of the passive leg, and `on_failure` is "raise".
    """
    if on_failure == "raise":
        require_above_clamp(tripod, heights[..., None])
    p = tripod.parameters
    # k_t J_a^T J_a + k_a J_t^T J_t
    motion_axes = np.sum(p.link_stiffness * link_jacobian**2 + p.actuator_stiffness * travel_jacobian**2, axis=-2)
    length = heights - tripod.clamp_height
    reached = (length > 0.0) & np.isfinite(motion_axes).all(axis=-1)
    length = np.where(reached, length, np.nan)
    bending = p.bending_stiffness / length**3
    motion_axes[..., :2] += bending[..., None]
    diagonal = np.empty((*heights.shape, 6))
    diagonal[..., :3] = np.where(reached[..., None], motion_axes, np.nan)
    diagonal[..., 3] = diagonal[..., 4] = bending / length**2
    diagonal[..., 5] = p.torsional_stiffness / length**2
    return diagonal


def require_above_clamp(tripod: Tripod, poses: Array) -> None:
    """Raise InvalidValueError unless the passive leg protrudes from the middle platform at every pose (... z_e)."""
    if np.any(poses[..., -1] <= tripod.clamp_height):
        expected = f"more than {tripod.clamp_height:.6g} m, where the middle platform clamps the passive leg"
        raise InvalidValueError("z_e", float(poses[..., -1].min()), expected)


def global_index(diagonal: ArrayLike) -> Array:
    """Return the chapter's global stiffness, the mean of the six diagonal entries, shape=(...).

    It adds N/m and N m/rad and so depends on the unit of length; it is reported because the chapter reports it.
    """
    mean: Array = np.asarray(diagonal, dtype=float).mean(axis=-1)
    return mean
