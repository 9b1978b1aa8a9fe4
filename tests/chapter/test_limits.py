"""Joint limits: flags and named violations agree with the angles, one limit at a time."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, passive_joint_angles
from pm3dof_pin.chapter.limits import Limit, limit_flags


def test_flags_follow_from_the_joint_values(tripod: Tripod) -> None:
    generator = np.random.default_rng(3)
    poses = generator.uniform([-1.2, -1.2, 0.3], [1.2, 1.2, 0.95], (20_000, 3))
    u = inverse_kinematics(tripod, poses, on_failure="nan")
    angles = passive_joint_angles(tripod, poses, on_failure="nan")
    lost = np.isnan(u)
    expected = Limit.REACH * np.any(lost, axis=1)
    expected |= Limit.STROKE * np.any(np.abs(u - 0.240272) > 0.085, axis=1)
    expected |= Limit.UNIVERSAL * np.any(np.abs(angles[..., :2]) > np.radians(50.0), axis=(1, 2))
    expected |= Limit.SPHERICAL * np.any(angles[..., 2] > np.radians(45.0), axis=1)
    expected |= Limit.TILT * np.any(np.abs(poses[:, :2]) > np.radians(50.0), axis=1)
    expected |= Limit.HEIGHT * ((poses[:, 2] < tripod.bounds[4]) | (poses[:, 2] > tripod.bounds[5]))
    flags = limit_flags(tripod, poses)
    np.testing.assert_array_equal(flags, expected)
    for limit in (Limit.REACH, Limit.STROKE, Limit.SPHERICAL, Limit.TILT, Limit.HEIGHT):
        assert np.any(flags & limit)


def test_home_keeps_every_limit(tripod: Tripod) -> None:
    assert limit_flags(tripod, tripod.home) == 0


def test_out_of_reach(tripod: Tripod) -> None:
    assert limit_flags(tripod, [0.0, 0.0, 0.9]) & Limit.REACH
    assert limit_flags(tripod, [np.nan, 0.0, 0.5]) != 0
