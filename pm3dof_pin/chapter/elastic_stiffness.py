"""The 6 x 6 stiffness of the tripod at O_e in closed form: springs in series in each leg, a cantilever in the middle.

    K = sum_i k_i w_i w_i^T + S^T (S C_b S^T)^-1 S,   1 / k_i = (n_i . e_i)^2 / k_a + 1 / k_t

w_i = [n_i; R p_i x n_i] is the unit wrench of link i, S the three directions that the passive leg's universal joint
holds (x, y and the turn about x_base x y_platform), C_b the tip compliance of a cantilever of length L = z_e - z_b.
Derivation: docs/theory.md.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter import kernels
from pm3dof_pin.chapter.chapter_stiffness import require_above_clamp, spring_table
from pm3dof_pin.chapter.kinematics import link_vectors, placement
from pm3dof_pin.chapter.reach import require_reach
from pm3dof_pin.chapter.threads import over_poses
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.elastic.indices import compliance
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


def elastic_stiffness(
    tripod: Tripod,
    poses: ArrayLike,
    *,
    assembly_mode: ArrayLike = -1,
    unreachable: Literal["raise", "nan"] = "raise",
    workers: int | None = None,
    out: Array | None = None,
) -> Array:
    """Return the Cartesian stiffness K = dW/dX at O_e, axes of the base.

    Args:
        tripod: the machine.
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        assembly_mode: -1 or +1, once or for each leg; one setting for all poses.
        unreachable: "raise", or "nan" to mark poses out of reach in the result.
        workers: threads for many poses; the number of processors by default.
        out: contiguous array to fill and return, shape=(..., 6, 6); reusing one saves the cost of new memory.

    Returns:
        Symmetric matrices in the order x, y, z, rx, ry, rz, shape=(..., 6, 6) [N/m, N, N m/rad].

    Raises:
        UnreachablePoseError: a link cannot meet its guideway, and `unreachable` is "raise".
        InvalidValueError: poses of a wrong shape, at or below the clamp of the passive leg, where L is not positive,
            or `out` of another shape.
    """
    pose_array, modes = tripod.checked(poses, assembly_mode)
    if unreachable == "raise":
        require_reach(tripod, pose_array, kernels.slider_travel(pose_array, tripod.legs, modes))
        require_above_clamp(tripod, pose_array)
    springs = spring_table(tripod)
    shape = (*pose_array.shape[:-1], 6, 6)
    stiffness = np.empty(shape) if out is None else out
    if stiffness.shape != shape or not stiffness.flags.c_contiguous:
        raise InvalidValueError("out", f"an array of shape {stiffness.shape}", f"a contiguous one of shape {shape}")

    def kernel(part: Array, out: Array) -> None:
        kernels.elastic_stiffness(part, tripod.legs, modes, springs, out=out)

    over_poses(kernel, pose_array, stiffness, workers)
    return stiffness


def spring_names(tripod: Tripod) -> tuple[str, ...]:
    """Return the names of the springs, in the order of :func:`spring_contributions`."""
    legs = range(1, tripod.leg_count + 1)
    actuators, links = [f"actuator{leg}" for leg in legs], [f"link{leg}" for leg in legs]
    return (*actuators, *links, "passive_leg")


def spring_contributions(tripod: Tripod, poses: ArrayLike, *, assembly_mode: ArrayLike = -1) -> Array:
    """Return what each spring contributes to the compliance C = K^-1; the contributions add up to C.

    A wrench W at the tool puts the force f_i = k_i w_i^T C W on leg i, the part f_i (n_i . e_i) of it on the actuator,
    and C_j is twice the energy that spring j then stores. The passive leg, whose bending and torsion act together, is
    one.

    Args:
        tripod: the machine.
        poses: shape=(..., 3) [rad, rad, m].
        assembly_mode: -1 or +1, once or for each leg.

    Returns:
        Positive semidefinite matrices, shape=(..., 2 n + 1, 6, 6) [m/N, 1/N, rad/(N m)], NaN out of reach. The
        derivative of C with respect to the stiffness k_j of a spring is -C_j / k_j.

    Raises:
        InvalidValueError: poses or modes of a wrong shape.
    """
    p = tripod.parameters
    total = elastic_stiffness(tripod, poses, assembly_mode=assembly_mode, unreachable="nan")
    directions = link_vectors(tripod, poses, assembly_mode=assembly_mode) / p.link_length
    arms = tripod.platform_joints @ np.swapaxes(placement(poses)[..., :3, :3], -1, -2)
    wrenches = np.concatenate([directions, np.cross(arms, directions)], axis=-1)
    cosines = np.sum(directions * tripod.guide_directions, axis=-1)
    series = 1.0 / (cosines**2 / p.actuator_stiffness + 1.0 / p.link_stiffness)
    tool = compliance(total)
    forces = series[..., None] * wrenches @ tool  # force of each leg against the wrench at the tool
    energies = forces[..., :, None] * forces[..., None, :]
    actuators = energies * (cosines**2 / p.actuator_stiffness)[..., None, None]
    links = energies / p.link_stiffness
    legs = np.swapaxes(wrenches, -1, -2) @ (series[..., None] * wrenches)
    passive_leg = tool @ (total - legs) @ tool
    return np.concatenate([actuators, links, passive_leg[..., None, :, :]], axis=-3)
