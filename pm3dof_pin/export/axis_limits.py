"""Speeds and accelerations that coordinates may have at once, from the worst case of the drives over the workspace."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Vector

_POSES, _SEED = 4000, 0
_USUAL_SPEED = {"m": 0.1, "rad": 1.0}  # of drives whose speed is not described [m/s, rad/s]
_TIME_TO_SPEED = 0.1  # in which a drive reaches its greatest speed [s]
_STEEP = 5.0  # rates of a drive above this times the median: near a singular pose
_SHARE = 0.5  # of a drive's acceleration, for what speeds alone need


@dataclass(frozen=True, eq=False)
class AxisLimits:
    """Limits of each coordinate that keep all drives within theirs, whatever the others do within these."""

    speed: Vector  #: by coordinate [m/s, rad/s]
    acceleration: Vector  #: by coordinate [m/s^2, rad/s^2]
    drive_speed: Vector  #: by drive [counts of its unit/s]
    drive_acceleration: Vector  #: by drive [counts of its unit/s^2]
    assumed: bool  #: whether the speed of a drive is not described, and 0.1 m/s or 1 rad/s are assumed
    poses: int  #: number of random poses at which they hold
    left_out: int  #: number of others so near singular ones that drives run five times as fast as usual


def axis_limits(robot: Robot) -> AxisLimits:
    """Return limits of the coordinates at random poses within limits, but for the neighborhood of singular ones.

    Raises:
        InvalidValueError: a coordinate moves no drive.
        UnreachablePoseError: hardly any pose is within the limits.
    """
    described = np.array([robot.model.velocityLimit[robot.single_joint(c.joint).v_index] for c in robot.commands])
    is_known = np.isfinite(described) & (described > 0.0) & (described < 1e6)
    usual = np.array([_USUAL_SPEED[robot.single_joint(c.joint).unit] for c in robot.commands])
    scales = np.array([abs(c.scale) for c in robot.commands])
    drive_speed = np.where(is_known, described, usual) * scales
    drive_acceleration = drive_speed / _TIME_TO_SPEED
    poses = reachable_poses(robot, _POSES, np.random.default_rng(_SEED))
    rates = jacobian(robot, poses, of="commands", by="coordinates", with_derivatives=True, on_failure="nan")
    assert rates.derivatives is not None
    steepest = np.abs(rates.values).max(axis=1)
    usual_rates = np.nanmedian(steepest, axis=0)
    is_usual = (steepest <= _STEEP * usual_rates).all(axis=1)  # False for NaN
    J, H = np.abs(rates.values[is_usual]), rates.derivatives[is_usual]
    alone = np.nanmax(J / drive_speed[:, None], axis=(0, 1))
    if not (alone > 0.0).all():
        name = robot.coordinates[int(np.argmin(alone))].name
        raise InvalidValueError(
            f"coordinate {name} of {robot.name}", problem="moves no drive", expected="one that does"
        )
    speed = 1.0 / alone
    speed /= np.nanmax(J @ speed / drive_speed)
    bent = np.nanmax(np.einsum("nkab,a,b->nk", np.abs(H), speed, speed), axis=0)
    speed *= min(1.0, float(np.sqrt((_SHARE * drive_acceleration / np.maximum(bent, 1e-300)).min())))
    bent = np.einsum("nkab,a,b->nk", np.abs(H), speed, speed)
    left = drive_acceleration - np.nanmax(bent, axis=0)
    acceleration = 1.0 / np.nanmax(J / left[:, None], axis=(0, 1))
    acceleration /= np.nanmax(J @ acceleration / left)
    left_out = len(poses) - len(J)
    return AxisLimits(speed, acceleration, drive_speed, drive_acceleration, not is_known.all(), len(J), left_out)
