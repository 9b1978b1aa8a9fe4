"""Moves that only turn the tool, and curved ones of a polar robot, whose motion is known in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.paths.bounds import MotionLimits, PathBounds
from pm3dof_pin.paths.evaluation import PathOptions, evaluate_path
from pm3dof_pin.paths.follower import Follower
from pm3dof_pin.paths.tool_path import ToolPath, read_path

START, END = np.array([0.2, 0.3]), np.array([1.7, 0.5])
"""Angle and radius of the polar robot at both ends of its move [rad, m]."""


@pytest.mark.parametrize("feed", [None, 0.02])
def test_a_turn_takes_the_time_of_a_trapezoid(feed: float | None, tmp_path: Path) -> None:
    """F counts degrees per minute; another feed and the acceleration count at the characteristic length."""
    robot, file = pm.load("hexapod"), tmp_path / "turn.ngc"
    file.write_text("G21\nG1 Z134 F600\nG1 A9 F300\nM2\n")
    limits = MotionLimits(acceleration=0.4, feed=feed)
    found = evaluate_path(robot, read_path(robot, file), PathOptions(limits=limits))
    time, lines = found.columns["time_s"], found.columns["line"]
    size = robot.characteristic_length
    rate, most = np.radians(300.0) / 60.0 if feed is None else feed / size, 0.4 / size
    expected = np.radians(9.0) / rate + rate / most
    assert time[-1] - time[lines == 2][-1] == pytest.approx(expected, rel=1e-6)


@pytest.fixture(scope="module")
def spiral() -> Follower:
    """A slide on a turntable, along which the tool leaves the centre while it turns: r rises in proportion to angle."""
    model = pin.Model()
    model.name = "polar"
    table = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "table_joint")
    slide = model.addJoint(table, pin.JointModelPX(), pin.SE3.Identity(), "slide_joint")
    for joint in (table, slide):
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-2 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("tool", slide, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    robot = pm.Robot(model, [], actuated_joints=["table_joint", "slide_joint"], tool_frame="tool")
    names = tuple(c.name for c in robot.coordinates)
    return Follower(robot, ToolPath(lines=np.array([2]), start=START[None], end=END[None], names=names))


def test_the_tool_moves_and_turns_as_on_a_spiral(spiral: Follower) -> None:
    shares = np.linspace(0.1, 0.9, 5)
    moves = np.zeros(5, dtype=np.intp)
    motion = spiral.motion(moves, shares, spiral.sizes(np.array([0])))
    (turn, rise), (angle, radius) = END - START, (START + shares[:, None] * (END - START)).T
    out, around = np.stack([np.cos(angle), np.sin(angle)]), np.stack([-np.sin(angle), np.cos(angle)])
    np.testing.assert_allclose(motion.tool[:, :2].T, rise * out + radius * turn * around, atol=1e-6)
    np.testing.assert_allclose(motion.tool[:, 3:], np.tile([0.0, 0.0, turn], (5, 1)), atol=1e-6)
    expected = 2.0 * rise * turn * around - radius * turn**2 * out
    np.testing.assert_allclose(motion.tool_second[:, :2].T, expected, atol=1e-5)


def test_only_the_bend_of_the_path_limits_its_speed(spiral: Follower) -> None:
    """v^2 = a / curvature, (r^2 + 2 r'^2) / (r^2 + r'^2)^1.5 by the angle; its speed per share does not count."""
    limits = MotionLimits(acceleration=0.5, feed=1e3)
    shares = np.linspace(0.1, 0.9, 5)
    sizes = spiral.sizes(np.array([0]))
    found = PathBounds(spiral, limits, 0.0, None).at(np.zeros(5, dtype=np.intp), shares, sizes)
    radius, slope = START[1] + shares * (END - START)[1], (END - START)[1] / (END - START)[0]
    curvature = (radius**2 + 2.0 * slope**2) / (radius**2 + slope**2) ** 1.5
    np.testing.assert_allclose(found.bound, np.sqrt(0.5 / curvature), rtol=1e-5)
