"""Poses within all limits of any mechanism: the candidates for measurements, and the poses at which to judge."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.calibration.tool_poses import ToolPoses, poses_at
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.mechanism.mechanism import Mechanism

Array = NDArray[np.float64]

_ROUNDS = 40
_TRIAL = 200
_LEAST_RATE = 0.02
_MOST_DRAWS = 4  # a round, times the poses wanted


def reachable_poses(
    mechanism: Mechanism, count: int, generator: np.random.Generator, *, margin: float = 0.0
) -> ToolPoses:
    """Draw poses within all limits, evenly over the motion coordinates.

    A mechanism without motion coordinates, or one whose limits exclude nearly all of their ranges (six freedoms with
    short struts), gets poses evenly over its commands instead.

    Args:
        mechanism: the mechanism.
        count: number of poses.
        generator: source of the random numbers.
        margin: part of each coordinate's range that is kept free at either end.

    Raises:
        UnreachablePoseError: hardly any pose was found within the limits.
        InvalidValueError: the margin is not between 0 and 0.5.
    """
    if not 0.0 <= margin < 0.5:
        raise InvalidValueError("margin", margin, "a part of the range, at least 0 and less than 0.5")
    for joints in filter(None, (mechanism.motion_coordinates, mechanism.actuated_joints)):
        found = _draw(mechanism, joints, _TRIAL, generator, margin)
        drawn = _TRIAL
        if len(found) < _LEAST_RATE * drawn:
            continue
        for _ in range(_ROUNDS):
            if len(found) >= count:
                return ToolPoses(mechanism, np.array(found[:count]))
            batch = min(_MOST_DRAWS * count, int((count - len(found)) * drawn / len(found)) + _TRIAL)
            found = np.concatenate([found, _draw(mechanism, joints, batch, generator, margin)])
            drawn += batch
    raise UnreachablePoseError(f"{mechanism.name}: hardly any random pose is within all joint limits")


def _draw(
    mechanism: Mechanism, joints: tuple[str, ...], count: int, generator: np.random.Generator, margin: float
) -> Array:
    lower, upper = coordinate_ranges(mechanism, joints)
    shares = generator.uniform(margin, 1.0 - margin, (count, len(joints)))
    poses = poses_at(mechanism, joints, lower + shares * (upper - lower), unreachable="drop")
    return np.asarray(poses.q[poses.within_limits()])


def coordinate_ranges(mechanism: Mechanism, joints: tuple[str, ...]) -> tuple[Array, Array]:
    """Return the least and greatest coordinates of joints; a joint without limits turns once around [m, rad]."""
    indices = [mechanism.single_joint(name).q_index for name in joints]
    lower, upper = mechanism.lower_limits[indices], mechanism.upper_limits[indices]
    unlimited = np.isinf(lower) | np.isinf(upper)
    return np.where(unlimited, -np.pi, lower), np.where(unlimited, np.pi, upper)
