"""The controllers that a robot's kinematics are written for, and the functions that write them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from pm3dof_pin.arrays import require_choice
from pm3dof_pin.description.coordinates import tool_coordinates
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.export.c_kinematics import c_files
from pm3dof_pin.export.controller import Controller, Deviations
from pm3dof_pin.export.grblhal import MOST_AXES, grblhal_files
from pm3dof_pin.export.linuxcnc import linuxcnc_files
from pm3dof_pin.export.ros2_control import ros2_control_files
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.actuation import motion_components
from pm3dof_pin.kinematics.mobility import generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity_measures import least_singularity_measures
from pm3dof_pin.programs.c import Real

ControllerName: TypeAlias = Literal["c", "grblhal", "linuxcnc", "ros2_control"]
"""Name of a controller; "c" is C99 for any of them."""

_TRIALS = 200  # poses among which an arm finds a regular one
_NEARLY_SINGULAR = 0.01  # distance of home from singular poses, relative to the greatest

_WRITERS: Mapping[ControllerName, Callable[[Controller], dict[str, str]]] = {
    "c": c_files,
    "grblhal": grblhal_files,
    "linuxcnc": linuxcnc_files,
    "ros2_control": ros2_control_files,
}

_MOST_DRIVES: Mapping[ControllerName, tuple[int, str]] = {
    "grblhal": (MOST_AXES, "N_AXIS in grblHAL's nuts_bolts.h"),
    "linuxcnc": (16, "EMCMOT_MAX_JOINTS in the emcmotcfg.h of LinuxCNC 2.9"),
}


def placed_by_tool(robot: Robot) -> Robot:
    """Return a robot with coordinates that place the tool, where the commands would be its coordinates.

    They are as many components of the tool's placement as it has drives, such as x, y and rz of a planar platform. A
    robot with declared coordinates, without a tool, with one drive, or whose drives do not all move the tool stays. The
    new one has programs of its own, since coordinates decide what branches are.
    """
    if robot.declared_coordinates or robot.tool_frame is None or robot.coordinates != robot.command_coordinates:
        return robot
    components = motion_components(generic_configuration(robot.home))
    if not 1 < len(components) == len(robot.commands):
        return robot
    return robot.replace(coordinates=tool_coordinates(components)).with_home(robot.home.q)


def with_regular_home(robot: Robot) -> Robot:
    """Return an arm that is singular at home with the least singular of random poses within limits as its home.

    Near a singular pose it has no direction to go to where the tool shall be. Other robots are returned as they are.
    """
    if robot.has_loops or robot.tool_frame is None or robot.coordinates == robot.command_coordinates:
        return robot
    trials = reachable_poses(robot, _TRIALS, np.random.default_rng(0)).q
    usual = instantaneous_mobility(generic_configuration(robot.home))
    measures = least_singularity_measures(robot, np.vstack([robot.home.q, trials]), usual)
    best = int(np.argmax(measures))
    return robot.with_home(trials[best - 1]) if measures[0] < _NEARLY_SINGULAR * measures[best] else robot


def export_controller(
    robot: Robot,
    controller: ControllerName,
    folder: Path | str,
    *,
    calibrated: Robot | None = None,
    deviations: Deviations | None = None,
    real: Real = "double",
    header_only: bool = False,
) -> list[Path]:
    """Write a robot's kinematics for a controller, between its drives and :func:`coordinates <placed_by_tool>`.

    Args:
        robot: the robot as described.
        controller: see :data:`ControllerName`.
        folder: output folder, created if missing.
        calibrated: the robot with identified parameters, as
            :attr:`Compensation.model <pm3dof_pin.calibration.compensation.Compensation.model>`; a second set of
            numbers of the same functions.
        deviations: learned deviations of the commands, as
            :meth:`Compensation.learned_deviations
            <pm3dof_pin.calibration.compensation.Compensation.learned_deviations>`.
        real: type of the numbers of "c"; the header says what error single precision leaves.
        header_only: whether the header of "c" has the functions, as static inline ones.

    Returns:
        The files written.

    Raises:
        InvalidValueError: no such controller, an option that it does not take, a robot without drives or with more
            than the controller has joints for, or a learned correction of more than three drives.
        ProgramError: there is no program for the robot.
        ConvergenceError: the loops do not close at home.
        OutputError: a file cannot be written.
    """
    require_choice("controller", controller, ControllerName)
    require_choice("real", real, Real)
    if controller in _MOST_DRIVES and len(robot.commands) > _MOST_DRIVES[controller][0]:
        most, source = _MOST_DRIVES[controller]
        raise InvalidValueError(
            robot.name,
            problem=f"has {len(robot.commands)} drives",
            expected=f"at most {most} for {controller} ({source}); c and ros2_control take any number",
        )
    placed = with_regular_home(placed_by_tool(robot))
    if placed is not robot and calibrated is not None:
        calibrated = placed.replace(model=calibrated.model, closures=calibrated.closures)
    robot = placed
    described = Controller(robot, calibrated=calibrated, deviations=deviations)
    if controller == "c":
        files = c_files(described, real=real, header_only=header_only)
    elif header_only or real != "double":
        raise InvalidValueError("header_only" if header_only else "real", expected=f"none for {controller}")
    else:
        files = _WRITERS[controller](described)
    return [write_text_atomically(Path(folder) / name, text) for name, text in files.items()]
