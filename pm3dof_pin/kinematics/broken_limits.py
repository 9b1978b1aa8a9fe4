"""Which limits a pose breaks, in the words and units of the robot's commands and coordinates."""

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

    name: str  #: the joint; or the closure, by its limit group and its place in it, or by its frames
    value: float  #: the reading [unit]: of the command or coordinate that shows this joint, else the joint's own
    lower: float  #: least reading allowed [unit]
    upper: float  #: greatest reading allowed [unit]
    unit: Unit  #: "m" or "rad"

    def __str__(self) -> str:
        factor, unit, digits = (1.0, "m", 4) if self.unit == "m" else (180.0 / math.pi, "deg", 2)
        value, lower, upper = (f"{number * factor:.{digits}f}" for number in (self.value, self.lower, self.upper))
        return f"{self.name} at {value} {unit}, outside {lower} .. {upper} {unit}"


def broken_limits(robot: Robot, configuration: Configuration) -> list[BrokenLimit]:
    """List the joints and closures that a configuration takes outside their ranges."""
    names, broken = closure_names(robot), []
    for violation in configuration.violated_limits():
        unit, scale, offset = limit_reading(robot, violation.name) if violation.kind == "joint" else ("rad", 1.0, 0.0)
        value, *ends = (scale * number + offset for number in (violation.value, violation.lower, violation.upper))
        name = names.get(violation.name, violation.name)
        broken.append(BrokenLimit(name, value, min(ends), max(ends), unit))
    return broken


def limit_reading(robot: Robot, name: str) -> tuple[Unit, float, float]:
    """Return unit, scale and offset of the limits of an entry of q, by name: reading = scale * q + offset."""
    if not robot.model.existJointName(name):  # one entry of a joint with several
        return "rad", 1.0, 0.0
    for reading in (*robot.command_coordinates, *robot.coordinates):
        if reading.joint == name:
            return reading.unit, reading.scale, reading.offset
    return robot.single_joint(name).unit, 1.0, 0.0


def closure_names(robot: Robot) -> dict[str, str]:
    """Return what each closure is called, by its frames: its declared limit group with its place in it, or the same."""
    names = {}
    for index, loop in enumerate(robot.closures):
        frames = f"{loop.frame_a}-{loop.frame_b}"
        group = next((group for group in robot.limit_groups if index in group.closures), None)
        declared = group is not None and not group.joints and group.name != re.sub(r"\d+", "", frames)
        names[frames] = f"{group.name}{group.closures.index(index) + 1}" if group and declared else frames
    return names
