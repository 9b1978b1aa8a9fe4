"""The 6 x 6 stiffness of the tripod at O_e in closed form: springs in series in each leg, a cantilever in the middle.

    K = sum_i k_i w_i w_i^T + S^T (S C_b S^T)^-1 S,   1 / k_i = (n_i . e_i)^2 / k_a + 1 / k_t

w_i = [n_i; R p_i x n_i] is the unit wrench of link i, S the three directions constrained by the passive leg's universal
joint (x, y and rotation about x_base x y_platform), C_b the tip compliance of a cantilever of length L = z_e - z_b.
Derivation: docs/theory.md.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.chapter_stiffness import require_above_clamp
from pm3dof_pin.chapter.kinematics import Legs, placed_legs
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.typing import Array, OnFailure


def elastic_stiffness(tripod: Tripod, poses: ArrayLike, *, on_failure: OnFailure = "raise") -> Array:
    """Return the Cartesian stiffness K = dW/dX at O_e, axes of the base, symmetric, in the order x, y, z, rx, ry, rz.

    Poses are (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m]; K has shape=(..., 6, 6) [N/m, N, N m/rad].

    Raises:
        UnreachablePoseError: a link cannot meet its guideway, and `on_failure` is "raise".
        InvalidValueError: poses of a wrong shape, or at or below the clamp of the passive leg, where L is not positive.
    """
    pose_array = tripod.checked(poses)
    legs = placed_legs(tripod, pose_array, on_failure)
    if on_failure == "raise":
        require_above_clamp(tripod, pose_array)
    return _of_legs(legs) + _of_passive_leg(tripod, pose_array)


def _series_stiffness(legs: Legs) -> Array:
    """Return k_i of actuator and link in series, shape=(..., n) [N/m]."""
    p = legs.tripod.parameters
    series: Array = 1.0 / (legs.cosines**2 / p.actuator_stiffness + 1.0 / p.link_stiffness)
    return series


def _of_legs(legs: Legs) -> Array:
    """Return sum_i k_i w_i w_i^T, shape=(..., 6, 6)."""
    weighted = np.sqrt(_series_stiffness(legs))[..., None] * legs.wrenches
    return np.swapaxes(weighted, -1, -2) @ weighted


def _of_passive_leg(tripod: Tripod, poses: Array) -> Array:
    """Return S^T (S C_b S^T)^-1 S, NaN at or below the clamp, shape=(..., 6, 6).

    y is decoupled; x and the rotation about (0, -sin theta_x, cos theta_x) form a 2 x 2 block.
    """
    p = tripod.parameters
    length = poses[..., 2] - tripod.clamp_height
    length = np.where(length > 0.0, length, np.nan)
    sine, cosine = np.sin(poses[..., 0]), np.cos(poses[..., 0])
    lateral = length**3 / (3.0 * p.bending_stiffness)
    coupling = -sine * length**2 / (2.0 * p.bending_stiffness)
    turn = length * (sine**2 / p.bending_stiffness + cosine**2 / p.torsional_stiffness)
    determinant = lateral * turn - coupling**2
    projection = np.zeros((*poses.shape[:-1], 2, 6))
    projection[..., 0, 0], projection[..., 1, 4], projection[..., 1, 5] = 1.0, -sine, cosine
    block = np.stack([np.stack([turn, -coupling], -1), np.stack([-coupling, lateral], -1)], -2)
    stiffness = np.swapaxes(projection, -1, -2) @ (block / determinant[..., None, None]) @ projection
    stiffness[..., 1, 1] += 1.0 / lateral
    symmetric: Array = 0.5 * (stiffness + np.swapaxes(stiffness, -1, -2))
    return symmetric


def contribution_names(tripod: Tripod) -> tuple[str, ...]:
    """Return the names of the springs, in the order of :func:`spring_contributions`."""
    legs = range(1, tripod.leg_count + 1)
    actuators, links = [f"actuator{leg}" for leg in legs], [f"link{leg}" for leg in legs]
    return (*actuators, *links, "passive_leg")


def spring_contributions(tripod: Tripod, poses: ArrayLike) -> Array:
    """Return the contribution of each spring to the compliance C = K^-1; the contributions sum to C.

    A wrench W at the tool puts the force f_i = k_i w_i^T C W on leg i, of which f_i (n_i . e_i) acts on the actuator,
    and C_j is twice the energy then stored in spring j. The passive leg, whose bending and torsion act together, counts
    as one spring. The derivative of C by the stiffness k_j is -C_j / k_j. Positive semidefinite, shape=(..., 2 n + 1,
    6, 6) [m/N, 1/N, rad/(N m)], NaN out of reach.

    Raises:
        InvalidValueError: poses of a wrong shape.
    """
    pose_array = tripod.checked(poses)
    p, legs = tripod.parameters, Legs.at(tripod, pose_array)
    of_legs = _of_legs(legs)
    total = of_legs + _of_passive_leg(tripod, pose_array)
    tool = inverse_definite(total)
    forces = _series_stiffness(legs)[..., None] * legs.wrenches @ tool  # in each leg against the wrench at the tool
    energies = forces[..., :, None] * forces[..., None, :]
    actuators = energies * (legs.cosines**2 / p.actuator_stiffness)[..., None, None]
    links = energies / p.link_stiffness
    passive_leg = tool @ (total - of_legs) @ tool
    return np.concatenate([actuators, links, passive_leg[..., None, :, :]], axis=-3)
