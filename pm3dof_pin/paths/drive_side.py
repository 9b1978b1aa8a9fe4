"""On which side of the singular poses of redundant drives the points of a path are.

More drives than coordinates have no determinant whose sign would tell branches apart. But their rates A by those of the
coordinates span almost the same space at neighbouring points of a path, and A^T A' has a positive determinant, unless
there is a singular pose between them.
"""

from __future__ import annotations

import numpy as np

from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import coordinate_scales
from pm3dof_pin.tolerances import RANK_CEILING
from pm3dof_pin.typing import Array, Mask


def rates_of_redundant_drives(robot: Robot, poses: Poses) -> Array:
    """Return the scaled rates of the drives by those of the coordinates at poses of shape (n,), shape=(n, u, c).

    NaN where there are none. Without coordinates, c = 0, unless there are more drives than these, which place the tool.
    """
    count = len(robot.coordinates)
    if not (robot.has_branches and len(robot.placing_drives) == count < len(robot.actuated_joints)):
        return np.zeros((len(poses), 0, 0))
    found = jacobian(robot, poses, of=robot.actuated_joints, by="coordinates", on_failure="nan").values
    sizes = coordinate_scales(robot, robot.coordinates)
    return np.asarray(found * sizes / robot.velocity_scale[robot.actuated_indices, None])


class DriveSide:
    """The side on which a path is, followed block by block; unsolved points between others leave it as it was."""

    def __init__(self) -> None:
        self._sign = 1.0
        self._last: Array | None = None  # rates at the last regular point, if no point after it is unsolved

    def is_other(self, rates: Array) -> Mask:
        """Return at which points of the next block the tool is on another side than at first, shape=(n,).

        Args:
            rates: see :func:`rates_of_redundant_drives`, shape=(n, u, c).
        """
        other = np.zeros(len(rates), dtype=bool)
        if not rates.size:
            return other
        solved = np.isfinite(rates).all(axis=(1, 2))
        gaps = np.cumsum(~solved)
        turned = np.swapaxes(rates, 1, 2)
        squares = np.linalg.eigvalsh(turned[solved] @ rates[solved])
        rows = np.flatnonzero(solved)[squares[:, 0] > RANK_CEILING**2 * squares[:, -1]]
        if len(rows):
            first = rates[rows[0]] if self._last is None or gaps[rows[0]] else self._last
            before = np.concatenate([first[None], rates[rows[:-1]]])
            flips = np.linalg.det(turned[rows] @ before) < 0.0
            flips[1:] &= np.diff(gaps[rows]) == 0
            signs = self._sign * np.cumprod(np.where(flips, -1.0, 1.0))
            other[rows] = signs < 0.0
            self._sign, self._last = float(signs[-1]), rates[rows[-1]]
        if gaps[-1] > (gaps[rows[-1]] if len(rows) else 0):
            self._last = None
        return other
