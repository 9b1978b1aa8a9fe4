"""Millimetres and degrees in place of metres and radians are refused with that guess; valid values are not."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod, kinematics
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot, load
from pm3dof_pin.kinematics.units import slip_in_range


@pytest.mark.parametrize(
    ("values", "unit", "ends", "word"),
    [
        ([490.0, 510.0], "m", (0.4, 0.6), "millimetres"),
        ([0.49, 510.0], "m", (0.4, 0.6), ""),  # one of them is out of reach
        ([0.0, 0.1, 0.4, -0.3, 0.2, 0.1, 30.0], "rad", (-0.7, 0.7), ""),  # likewise
        (np.linspace(-10.0, 10.0, 21), "rad", (-0.7, 0.7), "degrees"),  # some of them are small
        (np.linspace(-4.0, 4.0, 1001), "rad", (-0.1, 0.1), ""),  # samples of a turn and a quarter
        ([40.0], "m", (0.4, 0.6), ""),  # also in millimetres
        ([0.0, 10.0, -15.0], "rad", (-0.7, 0.7), "degrees"),
        ([3.1], "rad", (-0.1, 0.1), ""),  # within half a turn
        ([90.0], "rad", (-0.7, 0.7), "degrees"),  # out of reach too, but never radians
        ([900.0], "rad", (-0.7, 0.7), ""),
        ([math.nan], "m", (0.4, 0.6), ""),
    ],
)
def test_what_is_taken_for_another_unit(values: list[float], unit: Any, ends: tuple[float, float], word: str) -> None:
    slip = slip_in_range(values, unit, *ends)
    assert (slip.unit if slip else "") == word


def test_batches_and_grids_without_declared_ranges() -> None:
    """Then rotations are judged by one turn, and lengths by the machine's size, 0.1 m."""
    declared, generator = load("hexapod"), np.random.default_rng(0)
    without = [replace(coordinate, lower=None, upper=None) for coordinate in declared.coordinates]
    hexapod = declared.replace(coordinates=without)
    with pytest.raises(InvalidValueError, match=r"ry = .* looks like degrees"):
        declared.grid(ry=(-5.0, 5.0, 11))
    for wrong in ({"ry": (-5.0, 5.0, 11)}, {"rz": (0.0, 30.0, 4)}, {"rx": 15.0}):
        with pytest.raises(InvalidValueError, match="looks like degrees"):
            hexapod.grid(**wrong)
    with pytest.raises(InvalidValueError, match="looks like millimetres"):
        hexapod.grid(x=(-20.0, 20.0, 5))
    tilts = np.tile(hexapod.home_coordinates, (50, 1))
    tilts[:, 4] = generator.uniform(-8.0, 8.0, 50)
    with pytest.raises(InvalidValueError, match=r"ry = .* looks like degrees"):
        hexapod.solve(tilts, on_failure="nan")
    tilts[:, 4] = generator.uniform(-3.1, 3.1, 50)
    hexapod.solve(tilts, on_failure="nan")
    assert hexapod.grid(rz=(-math.pi, math.pi, 5)).shape == (5,)
    planar = load(Path(__file__).parents[1] / "machines" / "four_rrr" / "four_rrr.urdf")
    with pytest.raises(InvalidValueError, match=r"rz = .* expected radians, over at most a turn of 6\.283"):
        planar.grid(rz=(-3.5, 3.5, 3))


@pytest.fixture(scope="module")
def robot() -> Robot:
    return load("pm3dof")


def test_poses_and_commands_in_another_unit_are_refused(robot: Robot) -> None:
    for values in ([10.0, -15.0, 0.5], [[10.0, -15.0, 0.5], [12.0, -8.0, 0.5]]):
        with pytest.raises(InvalidValueError, match=r"theta_x = 1[02] looks like degrees: expected radians"):
            robot.solve(values, on_failure="nan")
        with pytest.raises(InvalidValueError, match=r"theta_x = 1[02] looks like degrees"):
            kinematics.inverse_kinematics(Tripod.load(), values)
    with pytest.raises(InvalidValueError, match=r"z_e = 510 looks like millimetres: expected metres"):
        robot.grid(z_e=(490.0, 510.0, 3))
    with pytest.raises(InvalidValueError, match=r"u1 = 257 looks like millimetres"):
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
