"""Forces of the actuators along a motion, at many poses: inertia, gravity, payloads and a wrench on the tool."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.programs.processors import processors
from pm3dof_pin.typing import Array, Mask, Matrix, Vector


@dataclass(frozen=True, eq=False)
class DriveMotions:
    """Motions at unit rate of each actuated joint, at n poses; the least ones if idle joints leave a choice."""

    joints: Array  #: velocities of all joints, shape=(n, nv, u)
    tool: Array  #: twists of the tool [v; omega], world axes, shape=(n, 6, u)


def drive_motions(robot: Robot, poses: Poses) -> DriveMotions:
    """Compute the motions of joints and tool by each actuated joint at poses of shape (n,); NaN where there are none.

    Raises:
        DescriptionError: the robot has no tool frame.
    """
    require_kind("robot", robot, Robot, "pm.load")
    robot.frame_name()
    nv, drives = robot.model.nv, len(robot.actuated_joints)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        from pm3dof_pin.dynamics.traced import of_drives

        return of_drives("drive_motions", robot, robot.model, q, threads)

    def reference(q: Vector) -> Matrix:
        configuration = robot.configuration(q)
        dof = DegreesOfFreedom(configuration)
        motions = dof.scale[:, None] * dof.at_actuators.inverse / dof.scale[robot.actuated_indices]
        return np.vstack([motions, configuration.tool_jacobian @ motions])

    found = evaluate_at(
        robot,
        poses,
        "motions by the drives",
        (nv + 6, drives),
        program=program,
        reference=reference,
        program_from=PROGRAM_FROM,
        on_failure="nan",
    ).values
    return DriveMotions(frozen(found[:, :nv]), frozen(found[:, nv:]))


def motion_forces(
    robot: Robot,
    poses: Poses,
    motions: DriveMotions,
    velocities: Matrix,
    accelerations: Matrix,
    *,
    payloads: Payloads | None = None,
    wrenches: Matrix | None = None,
) -> Matrix:
    """Compute the forces of the actuators along a motion, by Newton and Euler and virtual work on the closed loops.

    Idle joints, such as the spin of a rod, move as given.

    Args:
        robot: the robot.
        poses: poses of shape (n,).
        motions: the motions by the actuated joints there.
        velocities: of all joints, shape=(n, nv) [m/s, rad/s].
        accelerations: of all joints, shape=(n, nv) [m/s^2, rad/s^2].
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia`.
        wrenches: on the tool, at its point, world axes, shape=(n, 6) [N, N m].

    Returns:
        Forces along the actuated joints, shape=(n, u) [N, N m]; NaN where something is.
    """
    robot.require_possible_inertias()
    model = model_with_payloads(robot, payloads)
    load = np.full((len(poses), model.nv), np.nan)
    known = np.isfinite(velocities).all(axis=1) & np.isfinite(accelerations).all(axis=1)
    rows = [np.ascontiguousarray(values[known]) for values in (poses.q, velocities, accelerations)]
    load[known] = _loads(model, rows, robot.threads or processors())
    forces = np.einsum("nvu,nv->nu", motions.joints, load)
    if wrenches is not None:
        forces -= np.einsum("niu,ni->nu", motions.tool, finite_array("wrenches", wrenches, (len(poses), 6)))
    return np.asarray(forces)


def _loads(model: pin.Model, rows: list[Matrix], threads: int) -> Matrix:
    """Compute the inverse dynamics of the tree of rows of q, v and a, shape=(n, nv)."""
    loads = np.empty((len(rows[0]), model.nv))
    if hasattr(pin, "rneaInParallel"):  # where Pinocchio has OpenMP
        pin.rneaInParallel(threads, pin.ModelPool(model, threads), *(values.T for values in rows), loads.T)
        return loads
    data = model.createData()
    for row, state in enumerate(zip(*rows, strict=True)):
        loads[row] = pin.rnea(model, data, *state)
    return loads
