"""The chapter's stiffness from Pinocchio's Jacobians: loops are checked and derivatives taken on the URDF.

The platform is carried by the passive leg, so (8.5) is Pinocchio's Jacobian of the frame E_i in the columns of that
leg's joints; a slider's direction is the Jacobian of D_i in the column of its joint. With k_i = E_i - D_i,

    J_a,i = k_i^T J_i / |k_i|,    J_t,i = k_i^T J_i / (k_i . e_i).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.chapter.chapter_stiffness import chapter_diagonal
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, OnFailure

_MOTIONS = ("platform_x_joint", "platform_y_joint", "passive_slider_joint")


def pinocchio_stiffness(robot: Robot, tripod: Tripod, poses: ArrayLike, *, on_failure: OnFailure = "raise") -> Array:
    """Return the chapter's diagonal stiffness like :func:`chapter_stiffness`, from Jacobians of the machine's URDF.

    The tripod provides the stiffness coefficients and the clamp of the passive leg.

    Raises:
        InvalidValueError: the robot is not of the chapter's family, or a pose is at or below the clamp.
        UnreachablePoseError: a pose is out of reach, and `on_failure` is "raise".
        ConvergenceError: a pose of the robot's program does not close the loops according to Pinocchio.
    """
    if not all(robot.model.existJointName(name) for name in _MOTIONS):
        raise InvalidValueError("robot", robot.name, f"a tripod with the joints {', '.join(_MOTIONS)}")
    solved = robot.solve(poses, on_failure=on_failure)
    link, travel = (np.full((*solved.shape, tripod.leg_count, 3), np.nan) for _ in range(2))
    for index in zip(*np.nonzero(solved.solved), strict=True):
        configuration = Configuration(robot, solved.q[index])
        if configuration.closure_residual > robot.closure_tolerance:
            raise ConvergenceError(f"{robot.name}: closing the loops", configuration.closure_residual, "m or rad", 0)
        link[index], travel[index] = _jacobians(configuration, tripod.leg_count)
    return chapter_diagonal(tripod, np.asarray(poses, dtype=float)[..., 2], link, travel, on_failure=on_failure)


def _jacobians(configuration: Configuration, legs: int) -> tuple[Array, Array]:
    """Return J_a and J_t of one configuration, shape=(legs, 3) each."""
    mechanism = configuration.mechanism
    columns = [mechanism.single_joint(name).v_index for name in _MOTIONS]
    link, travel = np.empty((legs, 3)), np.empty((legs, 3))
    for i in range(legs):
        tip, foot = (configuration.frame_placement(f"{point}{i + 1}").translation for point in "ED")
        k = tip - foot
        slider = mechanism.single_joint(f"slider{i + 1}_joint").v_index
        direction = configuration.frame_jacobian(f"D{i + 1}")[:3, slider]
        moved = k @ configuration.frame_jacobian(f"E{i + 1}")[:3, columns]
        link[i], travel[i] = moved / np.linalg.norm(k), moved / (k @ direction)
    return link, travel
