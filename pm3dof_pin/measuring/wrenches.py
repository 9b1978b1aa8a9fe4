"""Known wrenches on the tool, when measured or at work: their columns."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array

WRENCH_COLUMNS = ("load_fx_N", "load_fy_N", "load_fz_N", "load_mx_Nm", "load_my_Nm", "load_mz_Nm")
"""Columns of a dead wrench on the tool, at the tool point, world axes; missing ones are zero."""
WEIGHT_COLUMN = "load_tool_N"
"""Column of a weight that hangs on the tool point."""


def is_wrench(column: str) -> bool:
    """Tell whether a column is part of a wrench; other loads are only inputs for learned corrections."""
    return column == WEIGHT_COLUMN or column in WRENCH_COLUMNS


def wrenches_of(conditions: Mapping[str, Array | float], robot: Robot, count: int) -> Array | None:
    """Return the wrenches in conditions given by column, shape=(count, 6) [N, N m]; None without any."""
    if not any(is_wrench(name) for name in conditions):
        return None
    wrenches = np.zeros((count, 6))
    for k, name in enumerate(WRENCH_COLUMNS):
        wrenches[:, k] = conditions.get(name, 0.0)
    gravity = robot.model.gravity.linear
    size = np.linalg.norm(gravity)
    down = gravity / size if size > 0.0 else np.array([0.0, 0.0, -1.0])
    wrenches[:, :3] += np.multiply.outer(np.broadcast_to(conditions.get(WEIGHT_COLUMN, 0.0), count), down)
    return wrenches
