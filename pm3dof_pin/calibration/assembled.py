"""Poses at which machines out of tolerance are assembled: near singular ones some are not."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Mask

OUT_OF_TOLERANCE = 3.0
"""Errors of the machines that must be assembled, in tolerances."""
_BEYOND = 1.5  # their errors are made half as large again, so that many more machines can be assembled
_MACHINES = 10  # for measured poses
_MIN_ASSEMBLED = 0.9  # fraction of the measured poses: if less, it is not single poses that are at fault


def assembled(errors: GeometricErrors, poses: Poses, machines: int, seed: int) -> Mask:
    """Tell at which poses every one of some random machines can be assembled, shape=(n,)."""
    generator, found = np.random.default_rng([seed, 2]), np.ones(len(poses), dtype=bool)
    for _ in range(machines):
        crooked = errors.apply(_BEYOND * OUT_OF_TOLERANCE * errors.sample(generator))
        found &= crooked.forward(poses.commands, guess=poses.q, on_failure="nan").solved
    return found


def assembled_rows(measurements: Measurements, errors: GeometricErrors) -> Mask:
    """Tell which rows are of poses at which machines can be assembled, shape=(n,); all, if many would be lost."""
    numbers = measurements.pose_numbers
    first = np.unique(numbers, return_index=True)[1]
    poses = errors.robot.forward(measurements.commands[first], on_failure="nan")
    kept = np.array(poses.solved)
    kept[kept] = assembled(errors, poses[kept], _MACHINES, 0)
    return np.asarray(kept[numbers] if kept.mean() >= _MIN_ASSEMBLED else np.ones(len(numbers), dtype=bool))
