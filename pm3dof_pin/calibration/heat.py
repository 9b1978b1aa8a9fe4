"""Measurements of a warm machine as those of the cold one, by known temperature rises of its bodies."""

from __future__ import annotations

from dataclasses import replace

from pm3dof_pin.errors.body_temperatures import BodyTemperatures, rise_column, rises_of
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.measuring.measurements import Measurements


def as_if_cold(measurements: Measurements, errors: GeometricErrors) -> Measurements:
    """Return measurements without the motion of the tool by the temperature rises in their columns `rise_NAME_K`.

    The motion is that of the machine as described at the commands of each row; errors change it by less than a
    thousandth. Other columns of temperatures stay, for learned corrections.

    Raises:
        InvalidValueError: a column names no link, screw, rod or group of the robot.
        UnreachablePoseError: the loops do not close at a command.
    """
    rises = rises_of(measurements.conditions)
    if not rises:
        return measurements
    poses = errors.robot.forward(measurements.commands)
    motions = BodyTemperatures.from_errors(errors).motions(poses, rises)
    warm = set(map(rise_column, rises))
    kept = {name: values for name, values in measurements.conditions.items() if name not in warm}
    return replace(measurements.without_motions(poses, motions), conditions=kept)
