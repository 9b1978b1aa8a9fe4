"""Grids of coordinates: which values they refuse."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.robot import Robot


@pytest.mark.parametrize(
    ("axes", "fixed", "said"),
    [
        ({"theta_x": [0.0, 0.1]}, {"theta_y": 0.0, "z": 0.5}, "coordinate = z: expected one of theta_x, theta_y, z_e"),
        ({"theta_x": [0.0, float("nan")]}, {"theta_y": 0.0, "z_e": 0.5}, "values of theta_x"),
        ({"theta_x": []}, {"theta_y": 0.0, "z_e": 0.5}, "values of theta_x"),
        ({"theta_x": [0.0, 0.1]}, {"theta_y": [0.0, 0.1], "z_e": 0.5}, "values of theta_y"),
        ({"theta_x": [0.0, 0.1]}, {}, "coordinates without a value = theta_y, z_e"),
    ],
)
def test_a_grid_that_is_none(mechanism: Robot, axes: Any, fixed: Any, said: str) -> None:
    with pytest.raises(InvalidValueError, match=said):
        Grid(mechanism.coordinates, axes, fixed)


def test_a_grid_of_too_many_poses_is_refused_before_memory_is_taken(mechanism: Robot) -> None:
    """900^3 poses of three coordinates, 2,187 million numbers; the axes alone of 10^12."""
    axes = {name: np.linspace(0.0, 0.1, 900) for name in ("theta_x", "theta_y", "z_e")}
    with pytest.raises(InvalidValueError, match=r"729,000,000 poses: expected at most 333,333,333 at once: .*--range"):
        mechanism.solve(Grid(mechanism.coordinates, axes, {}))
    with pytest.raises(InvalidValueError, match=r"1,000,000,000,000 poses"):
        mechanism.grid(theta_x=(0.0, 0.1, 10**12))
