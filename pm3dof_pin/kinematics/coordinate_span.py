"""How far a coordinate goes within the limits of a robot, where its description does not say."""

from __future__ import annotations

import math

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.robot import Robot

_STEPS = 16  # a characteristic length, or half a turn in this many steps
_FARTHEST = 16.0  # lengths from home [characteristic lengths]


def coordinate_span(robot: Robot, coordinate: Coordinate) -> tuple[float, float] | None:
    """Return the ends between which a coordinate is within all limits, the others at home [m, rad].

    It is moved from home, either way, in steps of a sixteenth of the characteristic length or of half a turn, until a
    limit is broken or no pose is found; an end is this far out at most. None where it never ends, or moves not at all.
    """
    home = float(robot.home_coordinates[robot.coordinates.index(coordinate)])
    step, count = math.pi / _STEPS, _STEPS
    if coordinate.unit == "m":
        step, count = robot.characteristic_length / _STEPS, round(_STEPS * _FARTHEST)
    ends = []
    for sense in (-1.0, 1.0):
        values = home + sense * step * np.arange(count + 1)
        first, last = sorted((values[0], values[-1]))
        poses = robot.solve(robot.grid(**{coordinate.name: (first, last, count + 1)}), on_failure="nan")
        within = poses.within_limits if sense > 0.0 else poses.within_limits[::-1]
        reached = count if within.all() else int(within.argmin()) - 1
        if reached < 0 or (reached == count and coordinate.unit == "m"):
            return None
        ends.append(values[min(reached + 1, count)])
    return (ends[0], ends[1]) if ends[1] - ends[0] > 2.5 * step else None
