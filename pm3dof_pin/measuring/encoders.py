"""Redundant encoders: readings of passive joints in addition to the tool, and their columns in a file."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from pm3dof_pin.csv_table import CsvTable
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.typing import Array

_PREFIX = "encoder_"
ENCODER_ZERO = {"m": 5e-3, "rad": 5e-2}
"""Prior standard deviation of an encoder's zero, by the unit of its joint [m, rad]."""

_FAR = 6.0  # times that, between readings and the described position of the joint


def encoder_column(robot: Robot, joint: str) -> str:
    """Return the column of a passive joint's readings, such as encoder_hinge1_left_joint_rad.

    Raises:
        InvalidValueError: the joint is driven or has several degrees of freedom.
        JointNotFoundError: there is no such joint.
    """
    unit = robot.single_joint(joint).unit
    if joint in robot.actuated_joints:
        raise InvalidValueError(
            "encoder", joint, f"a passive joint: {', '.join(robot.passive_joints) or 'there is none'}"
        )
    return f"{_PREFIX}{joint}_{unit}"


def encoder_joints(table: CsvTable, robot: Robot) -> dict[str, str]:
    """Return the joints with readings in a file, and their units, in the order of its columns.

    Raises:
        MeasurementError: a column named like an encoder's does not belong to a passive joint.
    """
    columns = {}
    for joint in robot.passive_joints:
        try:
            columns[encoder_column(robot, joint)] = joint
        except InvalidValueError:
            continue
    names = [name for name in table.header if name.removeprefix("sigma_").startswith(_PREFIX)]
    if wrong := [name for name in names if name.removeprefix("sigma_") not in columns]:
        expected = ", ".join(columns) or f"none: {robot.name} has no passive joint"
        raise MeasurementError(table.path, f"{', '.join(wrong)}: expected columns of passive joints, {expected}", [1])
    return {columns[name]: robot.single_joint(columns[name]).unit for name in names if name in columns}


def joint_coordinates(poses: Poses, joints: Sequence[str]) -> Array:
    """Return the coordinates of single-DoF joints, shape=(n, joints) [m, rad]."""
    found = np.zeros((len(poses), len(joints)))
    for k, name in enumerate(joints):
        joint = poses.robot.single_joint(name)
        q = poses.q[:, joint.q_index]
        found[:, k] = np.arctan2(poses.q[:, joint.q_index + 1], q) if joint.is_continuous else q
    return found


def readings_of(
    table: CsvTable, joints: Mapping[str, str], nominal: Poses, instrument: Instrument
) -> tuple[Array, Array]:
    """Return encoder readings and their noise, infinite for empty cells, shape=(n, joints) each [m, rad].

    Raises:
        MeasurementError: a sigma is not positive, or readings are far from the described position of the joint.
    """
    expected = joint_coordinates(nominal, tuple(joints))
    readings, sigmas = expected.copy(), np.full_like(expected, np.inf)
    for k, (joint, unit) in enumerate(joints.items()):
        column = encoder_column(nominal.robot, joint)
        seen = np.isfinite(table[column])
        usual = instrument.position_sigma if unit == "m" else instrument.angle_sigma
        given = table.get(f"sigma_{column}", usual)
        if (bad := seen & ~(given > 0.0)).any():
            raise MeasurementError(table.path, f"sigma_{column} is not positive", table.lines_where(bad))
        readings[seen, k], sigmas[seen, k] = table[column][seen], given[seen]
        far = np.abs(readings[:, k] - expected[:, k])
        if seen.any() and np.median(far[seen]) > _FAR * ENCODER_ZERO[unit]:
            problem = (
                f"{column} is {np.median(far[seen]):.3g} {unit} (median) from the described position of the joint: "
                "another unit, zero, direction or joint?"
            )
            raise MeasurementError(table.path, problem)
    return readings, sigmas
