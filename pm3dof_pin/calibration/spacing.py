"""Distances between the poses of a plan: poses next to each other see the same."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Indices, Mask

MIN_DISTANCE = 0.05
"""Least distance between two poses of a plan: rms of their command differences divided by the ranges."""

_SHUFFLES = 20


def require_room(robot: Robot, count: int, distance: float) -> None:
    """Refuse more poses than any choice within the limits of the commands can hold apart, before poses are sought.

    Cells with edges of the distance times the ranges over the root of their number have a diagonal of the distance, and
    room for one pose each. Where some command has no limits nothing is refused.

    Raises:
        InvalidValueError: there are too many.
    """
    commands = robot.command_coordinates
    limits = np.ptp(np.array([robot.range_of(command) for command in commands]).reshape(-1, 2), axis=1)
    if commands and distance > SAME and (np.isfinite(limits) & (limits > 0.0)).all():
        lower, upper = coordinate_ranges(robot, commands)
        most = math.prod(math.floor(part / distance) + 1 for part in limits / (upper - lower))
        if count > most:
            raise _too_many(count, most, distance)


def _too_many(count: int, most: int, distance: float) -> InvalidValueError:
    expected = f"at most about {most} poses at least {distance:g} of the ranges from each other"
    return InvalidValueError("poses", count, f"{expected}; a smaller distance allows more")


class Spacing:
    """Poses to choose from, and how far from each other those chosen must be.

    Ranges are those of the commands, or, if an instrument confines the poses, those that these poses have of it.

    Raises:
        InvalidValueError: the distance is negative.
    """

    def __init__(self, poses: Poses, distance: float = MIN_DISTANCE, *, confined: bool = False) -> None:
        if not distance >= 0.0:
            raise InvalidValueError("min_distance", distance, "a non-negative distance")
        lower, upper = coordinate_ranges(poses.robot, poses.robot.command_coordinates)
        ranges = upper - lower
        if confined and len(poses):
            taken = np.ptp(poses.commands, axis=0)
            ranges = np.where(taken > 0.0, np.minimum(ranges, taken), ranges)
        self._places = poses.commands / ranges / np.sqrt(len(lower))
        self._distance = distance

    def from_pose(self, index: int) -> Array:
        """Return the distances of all poses from one of them, shape=(n,)."""
        return np.asarray(np.linalg.norm(self._places - self._places[index], axis=1))

    def near(self, index: int) -> Mask:
        """Tell which poses are too near to the given one, including itself, shape=(n,)."""
        near = self.from_pose(index) < self._distance
        near[index] = True
        return np.asarray(near)

    def draw(self, allowed: Indices, count: int, generator: np.random.Generator) -> Indices:
        """Draw some of the allowed poses that keep their distance.

        Raises:
            InvalidValueError: too few are found.
        """
        most = 0
        for _ in range(_SHUFFLES):
            chosen: list[int] = []
            free = np.zeros(len(self._places), dtype=bool)
            free[allowed] = True
            for index in generator.permutation(allowed):
                if len(chosen) < count and free[index]:
                    chosen.append(int(index))
                    free &= ~self.near(int(index))
            if len(chosen) == count:
                return np.array(chosen, dtype=np.intp)
            most = max(most, len(chosen))
        raise _too_many(count, most, self._distance)

    def require(self, chosen: Sequence[int]) -> None:
        """Check that poses keep their distance.

        Raises:
            InvalidValueError: two do not.
        """
        for position, index in enumerate(chosen):
            if self.near(index)[list(chosen[position + 1 :])].any():
                expected = f"fewer, or a distance of less than {self._distance:g} of the ranges from each other"
                raise InvalidValueError("count", len(chosen), expected)
