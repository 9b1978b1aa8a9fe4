"""A pendulum that hangs from a driven slide and moves neither drive nor tool: what it takes from the drive's force."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.dynamics.inverse_dynamics import inverse_dynamics
from pm3dof_pin.dynamics.motion_dynamics import motion_dynamics
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

SLIDE, MASS, ARM, INERTIA = 3.0, 0.8, 0.12, 2e-3
"""Mass of the slide, of the pendulum, its centre from its axis, and its inertia about that centre [kg, m, kg m^2]."""
GRAVITY = 9.81


@pytest.fixture(scope="module")
def slide() -> Robot:
    """The slide moves along z, and the pendulum turns about x with its centre level with it."""
    model = pin.Model()
    model.name = "slide"
    carrier = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide_joint")
    model.appendBodyToJoint(carrier, pin.Inertia(SLIDE, np.zeros(3), 1e-2 * np.eye(3)), pin.SE3.Identity())
    swings = model.addJoint(carrier, pin.JointModelRX(), pin.SE3.Identity(), "swing_joint")
    pendulum = pin.Inertia(MASS, np.array([0.0, ARM, 0.0]), INERTIA * np.eye(3))
    model.appendBodyToJoint(swings, pendulum, pin.SE3.Identity())
    model.addFrame(pin.Frame("tool", carrier, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return Robot(model, [], actuated_joints=["slide_joint"], tool_frame="tool")


def _share(angle: float) -> float:
    """What the drive feels of the pendulum's mass: its momentum about the axis stays zero, (J + m r^2) w = -m r c v."""
    lever = ARM * np.cos(angle)
    return MASS - (MASS * lever) ** 2 / (INERTIA + MASS * ARM**2)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_inertia_and_weight_without_what_follows_freely(slide: Robot, engine: Engine) -> None:
    angles = np.linspace(-1.2, 1.4, 210)[:: 1 if engine == "program" else 70]
    q = np.stack([0.1 * angles, angles], axis=1)
    found = motion_dynamics(slide, q, by=["slide_joint"], engine=engine)
    felt = SLIDE + np.array([_share(angle) for angle in angles.tolist()])
    np.testing.assert_allclose(found.inertia[:, 0, 0], felt, rtol=1e-12)
    np.testing.assert_allclose(found.weight[:, 0], GRAVITY * felt, rtol=1e-12)


def test_the_force_lets_the_pendulum_fall(slide: Robot) -> None:
    """From rest, the slide accelerates at a, and what it bears falls as in gravity g + a."""
    angle, acceleration = 0.4, 2.5
    result = inverse_dynamics(slide.configuration([0.0, angle]), [0.0], [acceleration])
    felt = SLIDE + _share(angle)
    assert result.forces.actuator_forces[0] == pytest.approx(felt * (GRAVITY + acceleration), rel=1e-12)
    turned = -MASS * ARM * np.cos(angle) * (GRAVITY + acceleration) / (INERTIA + MASS * ARM**2)
    np.testing.assert_allclose(result.acceleration, [acceleration, turned], rtol=1e-12)
