"""Tolerances of parts by how they are made: the general tolerances of ISO 2768-1 (1989), which depend on the size.

The standard gives permissible deviations of lengths and angles. A part is within them with a probability of 95 %, so
the standard deviation, which is the tolerance of an error parameter, is half of them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, get_args

import numpy as np

from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter
from pm3dof_pin.errors.minimal_parameters import kind_of
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot

Process = Literal["fine", "medium", "coarse", "very-coarse"]
PROCESSES: tuple[Process, ...] = get_args(Process)

# permissible deviations up to each size [mm], and of angles up to each shorter leg [mm, arc minutes]
_LENGTHS: dict[float, tuple[float, float, float, float]] = {
    6.0: (0.05, 0.1, 0.3, 0.5),
    30.0: (0.1, 0.2, 0.5, 1.0),
    120.0: (0.15, 0.3, 0.8, 1.5),
    400.0: (0.2, 0.5, 1.2, 2.5),
    1000.0: (0.3, 0.8, 2.0, 4.0),
    2000.0: (0.5, 1.2, 3.0, 6.0),
    np.inf: (0.8, 2.0, 4.0, 8.0),
}
_ANGLES: dict[float, tuple[float, float, float, float]] = {
    10.0: (60.0, 60.0, 90.0, 180.0),
    50.0: (30.0, 30.0, 60.0, 120.0),
    120.0: (20.0, 20.0, 30.0, 60.0),
    400.0: (10.0, 10.0, 15.0, 30.0),
    np.inf: (5.0, 5.0, 10.0, 20.0),
}
_SIGMAS = 2.0  # standard deviations in a permissible deviation


def with_process(errors: GeometricErrors, process: Process) -> GeometricErrors:
    """Return the errors with tolerances of parts made to a class of ISO 2768-1, by the size of each part.

    A part is a body of the robot; its size is the distance from its joint to the farthest place on it. A rod that is a
    closure is a part as well, as long as it is. Zeros of drives
    and tied parameters are not of one part, and keep their tolerances.

    Raises:
        InvalidValueError: no such class.
    """
    if process not in PROCESSES:
        raise InvalidValueError("process", process, f"one of {', '.join(PROCESSES)}")
    column, parameters = PROCESSES.index(process), []
    for parameter in errors.parameters:
        if isinstance(parameter, GeometricParameter) and kind_of(errors.robot, parameter) != "zero of a drive":
            size = 1e3 * _part_size(errors.robot, parameter.place)
            angle = parameter.motion == "rotation"
            table = _ANGLES if angle else _LENGTHS
            deviation = next(row[column] for most, row in table.items() if size <= most)
            tolerance = (np.radians(deviation / 60.0) if angle else 1e-3 * deviation) / _SIGMAS
            most = min(most for most in (*_LENGTHS, *_ANGLES) if size <= most)
            group = f"{parameter.group}_to_{most:g}_mm" if np.isfinite(most) else f"{parameter.group}_over_2_m"
            parameter = replace(parameter, group=group, tolerance=float(tolerance))
        parameters.append(parameter)
    return GeometricErrors(errors.robot, parameters, fixed_bearings=errors.fixed_bearings, file=errors.file)


def _part_size(robot: Robot, place: str) -> float:
    """Return the distance from a body's joint to the farthest place on it, for the body that carries a place [m]."""
    model = robot.model
    if place in robot.rods:
        return robot.closures[robot.rods[place]].length or 0.0
    if model.existJointName(place):
        body = model.parents[model.getJointId(place)]
    else:
        body = model.frames[robot.frame_id(place)].parentJoint
    joints = [model.jointPlacements[k] for k in range(1, model.njoints) if model.parents[k] == body]
    frames = [frame.placement for frame in model.frames if frame.parentJoint == body]
    return max(float(np.linalg.norm(each.translation)) for each in [*joints, *frames])
