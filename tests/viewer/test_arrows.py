"""Arrows of the drives' forces: along the guideways of the tripod, and back for forces that pull."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.viewer.arrows import ActuatorAxis


def test_axes_are_the_guideways(tripod: Tripod, mechanism: Robot) -> None:
    axes = ActuatorAxis.from_configuration(mechanism.home)
    directions = [axis.direction for axis in axes]
    np.testing.assert_allclose(directions, tripod.guide_directions, atol=1e-12)
    for axis, foot in zip(axes, tripod.base_joints, strict=True):  # the origin is on the guideway
        np.testing.assert_allclose(np.cross(axis.origin - foot, axis.direction), 0.0, atol=1e-9)


def test_axes_turn_with_their_struts() -> None:
    """Those of a tilted hexapod, from the joints on the base to those on the platform."""
    there = Robot.load("hexapod").solve([0.005, -0.01, 0.135, 0.1, -0.05, 0.08]).configuration()
    for k, axis in enumerate(ActuatorAxis.from_configuration(there), start=1):
        strut = there.frame_placement(f"B{k}").translation - there.frame_placement(f"A{k}").translation
        np.testing.assert_allclose(np.abs(axis.direction @ strut), np.linalg.norm(strut), rtol=1e-9)


@pytest.mark.parametrize("force", [250.0, -250.0])
def test_arrows_are_as_long_as_their_force(force: float, mechanism: Robot) -> None:
    axis = ActuatorAxis.from_configuration(mechanism.home)[1]
    transform = axis.arrow(force, scale=1e-3, width=0.01)
    np.testing.assert_allclose(transform[:3, 2], 1e-3 * force * axis.direction, atol=1e-12)
    np.testing.assert_allclose(transform[:3, 3], axis.origin, atol=1e-12)
