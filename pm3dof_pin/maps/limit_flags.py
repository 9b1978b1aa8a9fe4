"""The limits of a robot as flags of a labelled array (CF conventions)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

BROKEN_LIMITS = "broken_limits"


def limit_names(robot: Robot) -> tuple[str, ...]:
    """Return what the bits of :attr:`~pm3dof_pin.kinematics.poses.Poses.broken_limits` are called, in their order."""
    return ("reach", *(group.name for group in robot.limit_groups))


def flag_type(names: tuple[str, ...]) -> np.dtype[Any]:
    """Return the smallest type of unsigned integers with a bit for each name."""
    return np.min_scalar_type((1 << len(names)) - 1)


def flag_attributes(names: tuple[str, ...], long_name: str) -> dict[str, object]:
    """Return the attributes of a variable that holds sums of flags, named from the lowest bit on."""
    return {
        "long_name": long_name,
        "flag_masks": np.array([1 << bit for bit in range(len(names))], dtype=flag_type(names)),
        "flag_meanings": " ".join(names),
        "comment": "sum of the flags; zero within all limits",
    }
