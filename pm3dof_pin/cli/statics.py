"""`pm3dof statics`."""

from __future__ import annotations

from typing import Any

import numpy as np

from pm3dof_pin.cli.options import Json, MachineOptions, Payload, PoseOptions, payloads_of
from pm3dof_pin.cli.output import fixed, table_lines
from pm3dof_pin.cli.poses import column_of, print_at_pose, solve_chosen
from pm3dof_pin.dynamics.batch import actuator_forces
from pm3dof_pin.dynamics.statics import ActuatorForces, holding_forces
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.closure_wrenches import closure_wrenches
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array


def statics(
    chosen: PoseOptions,
    which: MachineOptions,
    payload: Payload = 0.0,
    as_json: Json = False,
) -> None:
    """Compute the actuator forces that hold the robot against gravity at a pose: angles in degrees, lengths in metres.

    Signs follow the joints' coordinates. The force in a loop closure is the one on its second frame, in the axes of its
    first; for the legs of pm3dof, it is the force of a link on the platform, z along the link. A pose that breaks a
    joint limit is still computed, with a message and exit status 1.
    """
    machine = which.load()
    payloads = payloads_of(machine, payload)
    pose = solve_chosen(machine, chosen, lambda poses: _columns(machine, poses, payloads), as_json)
    if pose is None:
        return
    result = {"payload_kg": payload, "within_limits": bool(pose.within_limits)}
    configuration = pose.configuration()
    result |= _result(machine, configuration, holding_forces(configuration, payloads=payloads))
    print_at_pose(pose, result, _lines(result), as_json=as_json)


def _columns(robot: Robot, poses: Poses, payloads: dict[str, float]) -> dict[str, Array]:
    forces = np.full((len(poses), len(robot.actuated_joints)), np.nan)
    forces[poses.solved] = actuator_forces(robot, poses.q[poses.solved], payloads=payloads)
    units = ["N" if robot.single_joint(name).translates else "N m" for name in robot.actuated_joints]
    headings = map(column_of, robot.actuated_joints, units)
    return dict(zip(headings, forces.T, strict=True))


def _result(robot: Robot, configuration: Configuration, forces: ActuatorForces) -> dict[str, Any]:
    slides = [robot.single_joint(name).translates for name in robot.actuated_joints]
    numbers = list(zip(forces.actuator_forces, slides, strict=True))
    result: dict[str, Any] = {
        "actuated_joints": robot.actuated_joints,
        "force_N": [number if slide else None for number, slide in numbers],
    }
    if not all(slides):
        result["torque_N_m"] = [None if slide else number for number, slide in numbers]
    result["closures"] = [closure.name for closure in robot.closures]
    turns = [configuration.frame_placement(closure.frame_a).rotation.T for closure in robot.closures]
    pairs = closure_wrenches(configuration, forces.closure_forces)
    wrenches = [on_b.reshape(2, 3) @ turn.T for turn, (_, on_b) in zip(turns, pairs, strict=True)]
    result["closure_force_N"] = [wrench[0] for wrench in wrenches]
    if any(closure.kind.rotations for closure in robot.closures):
        result["closure_moment_N_m"] = [
            wrench[1] if closure.kind.rotations else None
            for closure, wrench in zip(robot.closures, wrenches, strict=True)
        ]
    if robot.couplings:
        coupled = forces.closure_forces[-len(robot.couplings) :]
        slides = [robot.single_joint(coupling.joint).translates for coupling in robot.couplings]
        result["couplings"] = [coupling.name for coupling in robot.couplings]
        for key, is_force in (("coupling_force_N", True), ("coupling_torque_N_m", False)):
            result[key] = [f if slide == is_force else None for f, slide in zip(coupled, slides, strict=True)]
    return result | {
        "residual_N": forces.residual,
        "actuator_forces_unique": forces.actuator_forces_unique,
        "closure_forces_unique": forces.closure_forces_unique,
        "unbalanced_idle": forces.unbalanced_idle,
    }


def _lines(result: dict[str, Any]) -> list[str]:
    torques = result.get("torque_N_m", result["force_N"])
    rows = [
        [name, fixed(torque if force is None else force, 9), "N m" if force is None else "N"]
        for name, force, torque in zip(result["actuated_joints"], result["force_N"], torques, strict=True)
    ]
    lines = table_lines(["actuated joint", "holding force", ""], rows)
    if not result["actuator_forces_unique"]:
        lines.append("other forces balance too, as of more actuators than degrees of freedom: these are the least ones")
    if result["unbalanced_idle"]:
        lines.append("gravity turns links that are free to spin; this affects neither actuators nor tool")
    if result["closures"]:
        lines += ["", *_closure_lines(result)]
    if result.get("couplings"):
        pairs = zip(result["coupling_force_N"], result["coupling_torque_N_m"], strict=True)
        shown = [
            [fixed(torque if force is None else force, 6), "N m" if force is None else "N"] for force, torque in pairs
        ]
        rows = [[name, *force] for name, force in zip(result["couplings"], shown, strict=True)]
        lines += ["", *table_lines(["coupling", "force on the joint that follows", ""], rows)]
    return [*lines, "", f"residual {result['residual_N']:.1e} N"]


def _closure_lines(result: dict[str, Any]) -> list[str]:
    header = ["loop closure", "f_x [N]", "f_y [N]", "f_z [N]"]
    rows = [
        [name, *(fixed(number, 6) for number in force)]
        for name, force in zip(result["closures"], result["closure_force_N"], strict=True)
    ]
    if "closure_moment_N_m" in result:
        header += ["m_x [N m]", "m_y [N m]", "m_z [N m]"]
        for row, moment in zip(rows, result["closure_moment_N_m"], strict=True):
            row += [""] * 3 if moment is None else [fixed(number, 6) for number in moment]
    lines = [line.rstrip() for line in table_lines(header, rows)]
    if not result["closure_forces_unique"]:
        lines.append("redundant closures: forces of rigid bodies are indeterminate; these are the least that balance")
    return lines
