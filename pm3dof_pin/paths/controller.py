"""Limits of a controller, read from the INI file of a LinuxCNC machine."""

from __future__ import annotations

import configparser
import math
from dataclasses import replace
from pathlib import Path

import numpy as np

from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.machine_axes import AXIS_INDICES, Axes
from pm3dof_pin.files import read_text
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.paths.bounds import MotionLimits
from pm3dof_pin.typing import Vector

_LENGTHS = {"mm": 1e-3, "metric": 1e-3, "inch": 0.0254, "in": 0.0254, "imperial": 0.0254}


def controller_limits(robot: Robot, path: Path | str, usual: MotionLimits | None = None) -> MotionLimits:
    """Read the limits that a LinuxCNC machine gives its path and its joints.

    MAX_LINEAR_VELOCITY and MAX_LINEAR_ACCELERATION of [TRAJ] are those of rapids and of the path, and so is
    MAX_LINEAR_JERK if PLANNER_TYPE is 1; MAX_VELOCITY and MAX_ACCELERATION of [JOINT_0], [JOINT_1] ... are those of the
    drives, in the order of the commands, and of [AXIS_X], [AXIS_Y] ... those of the axes.

    Args:
        robot: the robot.
        path: the INI file.
        usual: limits for what the file does not say.

    Raises:
        DescriptionError: the file is unreadable, a section for a drive is missing, or a value is not a positive number.
    """
    file, limits = Path(path), usual or MotionLimits()
    parser = configparser.ConfigParser(interpolation=None, strict=False, inline_comment_prefixes=("#", ";"))
    try:
        parser.read_string(read_text(file))
    except configparser.Error as error:
        raise DescriptionError(file, "the file", f"expected an INI file ({str(error).splitlines()[0]})") from error

    def number(section: str, key: str, factor: float) -> float | None:
        text = parser.get(section, key, fallback=None)
        if text is None:
            return None
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not (math.isfinite(value) and value > 0.0):
            raise DescriptionError(file, f"[{section}] {key}", f"is '{text}', expected a positive number")
        return factor * value

    length = _LENGTHS.get(parser.get("TRAJ", "LINEAR_UNITS", fallback="mm").strip().lower(), 1e-3)
    drives: dict[str, Vector] = {}
    for name, key in (("drive_speed", "MAX_VELOCITY"), ("drive_acceleration", "MAX_ACCELERATION")):
        found = np.full(len(robot.commands), np.inf)
        for k, command in enumerate(robot.commands):
            section = f"JOINT_{k}"
            if not parser.has_section(section):
                raise DescriptionError(file, f"[{section}]", f"is missing, expected one for drive {command.name}")
            factor = length if command.unit == "m" else math.pi / 180.0
            found[k] = number(section, key, factor / abs(command.scale)) or np.inf
        order = [[c.joint for c in robot.commands].index(joint) for joint in robot.actuated_joints]
        drives[name] = found[order]
    axes: dict[str, dict[str, float]] = {"MAX_VELOCITY": {}, "MAX_ACCELERATION": {}}
    letters = Axes.of(robot).letters if any(parser.has_section(f"AXIS_{letter}") for letter in AXIS_INDICES) else ()
    names = dict(zip(letters, (coordinate.name for coordinate in robot.coordinates), strict=False))
    for letter in AXIS_INDICES:
        factor = math.pi / 180.0 if letter in "ABC" else length
        for key, limits_of in axes.items():
            if (value := number(f"AXIS_{letter}", key, factor)) is not None:
                limits_of |= {letter: value, names.get(letter, letter): value}
    jerk = (
        number("TRAJ", "MAX_LINEAR_JERK", length) if parser.get("TRAJ", "PLANNER_TYPE", fallback="0") == "1" else None
    )
    rapid = number("TRAJ", "MAX_LINEAR_VELOCITY", length)
    acceleration = number("TRAJ", "MAX_LINEAR_ACCELERATION", length)
    return replace(
        limits,
        rapid=limits.rapid if rapid is None else rapid,
        acceleration=limits.acceleration if acceleration is None else acceleration,
        jerk=limits.jerk if jerk is None else jerk,
        axis_speed=axes["MAX_VELOCITY"],
        axis_acceleration=axes["MAX_ACCELERATION"],
        drive_speed=drives["drive_speed"],
        drive_acceleration=drives["drive_acceleration"],
    )
