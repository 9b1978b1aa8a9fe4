"""Millimetres and degrees in place of metres and radians are refused with that guess; valid values are not."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod, kinematics
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot, load
from pm3dof_pin.kinematics.unit_sense import other_unit


@pytest.mark.parametrize(
    ("values", "unit", "ends", "word"),
    [
        ([490.0, 510.0], "m", (0.4, 0.6), "millimetres"),
        ([0.49, 510.0], "m", (0.4, 0.6), ""),  # one of them is out of reach
        ([40.0], "m", (0.4, 0.6), ""),  # also in millimetres
        ([0.0, 10.0, -15.0], "rad", (-0.7, 0.7), "degrees"),
        ([3.1], "rad", (-0.1, 0.1), ""),  # within half a turn
        ([90.0], "rad", (-0.7, 0.7), ""),
        ([90.0], "rad", (-math.inf, math.inf), ""),
        ([math.nan], "m", (0.4, 0.6), ""),
    ],
)
def test_what_is_taken_for_another_unit(values: list[float], unit: str, ends: tuple[float, float], word: str) -> None:
    assert other_unit(values, unit, *ends) == word


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load("pm3dof")


def test_poses_and_commands_in_another_unit_are_refused(robot: Robot) -> None:
    for values in ([10.0, -15.0, 0.5], [[10.0, -15.0, 0.5], [12.0, -8.0, 0.5]]):
        with pytest.raises(InvalidValueError, match=r"theta_x = 10 rad: expected radians .* looks like degrees"):
            robot.solve(values, on_failure="nan")
        with pytest.raises(InvalidValueError, match=r"theta_x = 10 rad: .* looks like degrees"):
            kinematics.inverse_kinematics(Tripod.load(), values)
    with pytest.raises(InvalidValueError, match=r"z_e = 490 m: expected metres .* looks like millimetres"):
        robot.grid(z_e=(490.0, 510.0, 3))
    with pytest.raises(InvalidValueError, match=r"u1 = 257 m: .* looks like millimetres"):
        robot.forward([257.0, 260.0, 224.0])


@pytest.mark.parametrize("values", [["0.1", "0.2", "0.5"], ["a", 0.2, 0.5], [0.1j, 0.2, 0.5], [None, 0.2, 0.5]])
def test_texts_and_complex_numbers_are_no_poses(robot: Robot, values: list[Any]) -> None:
    for solve in (robot.solve, lambda pose: kinematics.inverse_kinematics(Tripod.load(), pose)):
        with pytest.raises(InvalidValueError, match=r"expected (real|finite)"):
            solve(values)


@pytest.mark.parametrize(
    "function", [kinematics.link_jacobian, kinematics.slider_jacobian, kinematics.passive_joint_angles]
)
def test_poses_out_of_reach_raise_unless_told(function: Any) -> None:
    tripod = Tripod.load()
    with pytest.raises(UnreachablePoseError, match="out of reach"):
        function(tripod, [0.0, 0.0, 1.5])
    assert np.isnan(function(tripod, [0.0, 0.0, 1.5], on_failure="nan")).any()
