"""Linkages that move although Gruebler's count forbids it, closed by a hinge, in closed form; and hinges as balls."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array


def _link(length: float, twist: float) -> pin.SE3:
    """Denavit and Hartenberg's link: along x, then about x."""
    return pin.SE3(pin.utils.rotate("x", twist), np.array([length, 0.0, 0.0]))


def _ring(links: list[tuple[float, float]], home: Array) -> Robot:
    """A ring of hinges, of which the last is the loop closure; home has the angles of the others."""
    model, joint, place = pin.Model(), 0, pin.SE3.Identity()
    model.name = "ring"
    for k, link in enumerate(links[:-1]):
        joint = model.addJoint(joint, pin.JointModelRZ(), place, f"joint{k}")
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.05), pin.SE3.Identity())
        place = _link(*link)
    model.addFrame(pin.Frame("tip", joint, 0, place, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("seat", 0, 0, _link(*links[-1]).inverse(), pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = home
    return Robot(model, [LoopClosure("tip", "seat", "hinge")], actuated_joints=["joint0"], tool_frame="tip")


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_bennetts_linkage(engine: str) -> None:
    """a / sin(alpha) = b / sin(beta); tan(t1 / 2) tan(t2 / 2) = sin((beta + alpha) / 2) / sin((beta - alpha) / 2)."""
    alpha, beta, a = 0.6, 1.3, 0.2
    b = a * np.sin(beta) / np.sin(alpha)
    ratio = np.sin(0.5 * (beta + alpha)) / np.sin(0.5 * (beta - alpha))
    first = np.linspace(0.7, 1.5, 40)
    second = 2.0 * np.arctan(ratio / np.tan(0.5 * first))
    robot = _ring([(a, alpha), (b, beta), (a, alpha), (b, beta)], np.array([first[20], second[20], -first[20]]))
    assert robot.home.closure_residual < 1e-14
    assert pm.instantaneous_mobility(robot.home).count == 1
    poses = robot.with_engine(engine).forward(first[:, None])  # type: ignore[arg-type]
    np.testing.assert_allclose(poses.q, np.stack([first, second, -first], axis=1), atol=1e-9)


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_bricards_symmetric_6r(engine: str) -> None:
    """Equal links with twists alpha, -alpha in turn (Chen, You and Tarnai 2005, threefold symmetric).

    cos^2 alpha + sin^2 alpha (cos t + cos p) + (1 + cos^2 alpha) cos t cos p - 2 cos alpha sin t sin p = 0
    """
    alpha, a = np.deg2rad(100.0), 0.2
    t = np.linspace(1.7, 2.1, 30)
    c, s2 = np.cos(alpha), np.sin(alpha) ** 2
    amplitude = np.hypot(s2 + (1.0 + c**2) * np.cos(t), 2.0 * c * np.sin(t))
    phase = np.arctan2(-2.0 * c * np.sin(t), s2 + (1.0 + c**2) * np.cos(t))
    p = phase + np.arccos(-(c**2 + s2 * np.cos(t)) / amplitude)
    links = [(a, alpha), (a, -alpha)] * 3
    expected = np.stack([t, p, t, p, t], axis=1)
    robot = _ring(links, expected[15])
    assert robot.home.closure_residual < 1e-14
    assert pm.instantaneous_mobility(robot.home).count == 1
    poses = robot.with_engine(engine).forward(t[:, None])  # type: ignore[arg-type]
    turns = np.round((poses.q - expected) / (2.0 * np.pi)) * 2.0 * np.pi
    np.testing.assert_allclose(poses.q - turns, expected, atol=1e-8)


def test_a_hinge_is_two_balls_on_its_axis() -> None:
    alpha, beta, a = 0.6, 1.3, 0.2
    b = a * np.sin(beta) / np.sin(alpha)
    home = np.array([1.1, 2.0 * np.arctan(np.sin(0.95) / np.sin(0.35) / np.tan(0.55)), -1.1])
    hinged = _ring([(a, alpha), (b, beta), (a, alpha), (b, beta)], home)
    model = hinged.model.copy()
    for name in ("tip", "seat"):
        frame = model.frames[model.getFrameId(name)]
        place = frame.placement * pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.3]))
        model.addFrame(pin.Frame(f"{name}_above", frame.parentJoint, 0, place, pin.FrameType.OP_FRAME))
    pairs = [LoopClosure("tip", "seat", "3d"), LoopClosure("tip_above", "seat_above", "3d")]
    balls = Robot(model, pairs, actuated_joints=["joint0"], tool_frame="tip")
    angles = np.linspace(0.8, 1.4, 40)[:, None]
    np.testing.assert_allclose(balls.forward(angles).q, hinged.forward(angles).q, atol=1e-9)
    forces = [pm.holding_forces(robot.home).actuator_forces for robot in (hinged, balls)]
    np.testing.assert_allclose(forces[0], forces[1], rtol=1e-9)
