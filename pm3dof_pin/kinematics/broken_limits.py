"""Which limits a pose breaks, in the names and units of the robot's commands and coordinates."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pm3dof_pin.description.coordinates import Unit
    from pm3dof_pin.kinematics.robot import Robot
    from pm3dof_pin.mechanism.configuration import Configuration


@dataclass(frozen=True)
class BrokenLimit:
    """A joint or closure outside its range."""

    name: str  #: the joint; or the closure, by limit group and index in it, or by its frames
    value: float  #: the value [unit]: of the command or coordinate of this joint, if any, or of the joint itself
    lower: float  #: least permitted value [unit]
    upper: float  #: greatest permitted value [unit]
    unit: Unit  #: "m" or "rad"

    def __str__(self) -> str:
        factor, unit, digits = (1.0, "m", 4) if self.unit == "m" else (180.0 / math.pi, "deg", 2)
        value, lower, upper = (f"{number * factor:z.{digits}f}" for number in (self.value, self.lower, self.upper))
        return f"{self.name} at {value} {unit}, outside {lower} .. {upper} {unit}"


def broken_limits(robot: Robot, configuration: Configuration) -> list[BrokenLimit]:
    """List the joints and closures that are outside their ranges in a configuration."""
    names, broken = closure_names(robot), []
    for violation in configuration.violated_limits():
        unit, scale, offset = limit_reading(robot, violation.name) if violation.kind == "joint" else ("rad", 1.0, 0.0)
        value, *ends = (scale * number + offset for number in (violation.value, violation.lower, violation.upper))
        name = names.get(violation.name, violation.name)
        broken.append(BrokenLimit(name, value, min(ends), max(ends), unit))
    return broken


def limit_reading(robot: Robot, name: str) -> tuple[Unit, float, float]:
    """Return unit, scale and offset of the limits of an entry of q, by name: value = scale * q + offset."""
    if not robot.model.existJointName(name):  # an entry of a multi-DoF joint
        return "rad", 1.0, 0.0
    for reading in (*robot.command_coordinates, *robot.coordinates):
        if reading.joint == name:
            return reading.unit, reading.scale, reading.offset
    return robot.single_joint(name).unit, 1.0, 0.0


def closure_names(robot: Robot) -> dict[str, str]:
    """Return the display name of each closure, by name: its declared limit group and index, or that name."""
    names = {}
    for index, loop in enumerate(robot.closures):
        frames = f"{loop.frame_a}-{loop.frame_b}"
        group = next((group for group in robot.limit_groups if index in group.closures), None)
        declared = group is not None and not group.joints and group.name != re.sub(r"\d+", "", frames)
        names[loop.name] = f"{group.name}{group.closures.index(index) + 1}" if group and declared else loop.name
    return names
