"""Loops with fewer drives than freedoms: whatever the drive alone permits is found, by both engines."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

ANGLES = np.linspace(-3.0, 3.0, 41)  # of the drive
MARGIN = 0.005  # of the reach, near whose ends the chain is flat


def _chain(lengths: np.ndarray, home: np.ndarray) -> Robot:
    """A planar chain whose first joint alone is driven, and whose end is pinned to the base where it is at home."""
    model, parent, at = pin.Model(), 0, pin.SE3.Identity()
    for k, length in enumerate(lengths):
        parent = model.addJoint(parent, pin.JointModelRY(), at, f"joint{k}")
        at = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.addFrame(pin.Frame("end", parent, at, pin.FrameType.OP_FRAME))
    model.addFrame(pin.Frame("pin", 0, pin.SE3(np.eye(3), _end(lengths, home)), pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = home
    return Robot(model, [LoopClosure("end", "pin", "3d")], actuated_joints=["joint0"], tool_frame="end")


def _end(lengths: np.ndarray, angles: np.ndarray) -> np.ndarray:
    directions = np.cumsum(angles)
    return np.array([lengths @ np.cos(directions), 0.0, -lengths @ np.sin(directions)])


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
@pytest.mark.parametrize("seed", range(4))
def test_commands_are_reached_wherever_the_other_bars_can_close_the_loop(seed: int, engine: Engine) -> None:
    """They can if their end is no farther off than they are long, and no nearer than the longest leaves of the rest."""
    generator = np.random.default_rng(seed)
    size = int(generator.integers(4, 7))
    lengths, home = generator.uniform(0.1, 0.4, size), generator.uniform(-1.5, 1.5, size)
    robot = _chain(lengths, home)
    elbows = np.array([_end(lengths[:1], np.array([angle])) for angle in ANGLES])
    gaps = np.linalg.norm(elbows - _end(lengths, home), axis=1)
    bars = lengths[1:]
    nearest = max(2.0 * bars.max() - bars.sum(), 0.0)
    is_open = (gaps < (1.0 - MARGIN) * bars.sum()) & (gaps > (1.0 + MARGIN) * nearest)
    start = int(np.abs(ANGLES - home[0]).argmin())
    assert is_open[start]
    ends = np.flatnonzero(~is_open)
    connected = slice(max(ends[ends < start], default=-1) + 1, min(ends[ends > start], default=len(ANGLES)))
    poses = robot.forward(ANGLES[connected, None], engine=engine)
    for q, angle in zip(poses.q, ANGLES[connected], strict=True):
        np.testing.assert_allclose(_end(lengths, np.array(q)), _end(lengths, home), atol=1e-9)
        assert q[0] == pytest.approx(angle, abs=1e-12)


def _places(names: str) -> list[Coordinate]:
    return [Coordinate(name, "m", tool=name) for name in names]


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_a_five_bar_on_a_slide_with_a_flat_roof_moves(engine: Engine) -> None:
    """Three drives place the ridge in many ways, of which a near one is taken; rods that are nearly level turn fast."""
    bar, up, level = 0.2, 1.2, 0.08  # lengths [m], slopes of cranks and rods [rad]
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    half = bar * (np.cos(up) + np.cos(level))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        foot = pin.SE3(pin.utils.rotate("y", -up if sign > 0.0 else up - np.pi), np.array([-sign * half, 0.0, 0.0]))
        crank = model.addJoint(slide, pin.JointModelRY(), foot, f"{side}_crank")
        at = pin.SE3(pin.utils.rotate("y", sign * (up - level)), np.array([bar, 0.0, 0.0]))
        rod = model.addJoint(crank, pin.JointModelRY(), at, f"{side}_rod")
        end = pin.SE3(np.eye(3), np.array([bar, 0.0, 0.0]))
        model.addFrame(pin.Frame(f"{side}_end", rod, end, pin.FrameType.OP_FRAME))
    robot = Robot(
        model,
        [LoopClosure("left_end", "right_end", "3d")],
        actuated_joints=["slide", "left_crank", "right_crank"],
        tool_frame="left_end",
        coordinates=_places("xz"),
    )
    x, z = robot.home_coordinates
    steps = np.array([1e-6, 1e-4, 1e-3])
    targets = np.array([(x + step, z) for step in (*steps, *-steps)])
    poses = robot.solve(targets, engine=engine)
    np.testing.assert_allclose(poses.transforms[:, [0, 2], 3], targets, atol=1e-9)
    assert np.abs(poses.q - robot.home.q).max() < 0.1


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_all_joints_of_an_arm_share_a_small_motion(engine: Engine) -> None:
    """To first order they are those of least norm: the pseudo-inverse of the tool's Jacobian says how they move."""
    generator = np.random.default_rng(0)
    model, parent, at = pin.Model(), 0, pin.SE3.Identity()
    kinds = [pin.JointModelRZ, pin.JointModelRY, pin.JointModelRX]
    for k in range(9):
        parent = model.addJoint(parent, kinds[k % 3](), at, f"joint{k}")
        at = pin.SE3(np.eye(3), np.array([0.05, 0.0, 0.25]))
    model.addFrame(pin.Frame("flange", parent, at, pin.FrameType.OP_FRAME))
    model.referenceConfigurations["home"] = home = generator.uniform(-0.5, 0.5, 9)
    robot = Robot(model, actuated_joints=list(model.names)[1:], tool_frame="flange", coordinates=_places("xyz"))
    motion = 1e-4 * generator.normal(size=3)
    found = robot.solve(robot.home_coordinates + motion, engine=engine).q - home
    jacobian = pin.computeFrameJacobian(
        model, model.createData(), home, model.getFrameId("flange"), pin.LOCAL_WORLD_ALIGNED
    )[:3]
    expected = np.linalg.pinv(jacobian) @ motion
    np.testing.assert_allclose(found, expected, atol=0.02 * np.abs(expected).max())
