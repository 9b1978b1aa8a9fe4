"""Grids of coordinates: which values they refuse."""

from __future__ import annotations

from typing import Any

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
