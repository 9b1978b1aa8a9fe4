"""Loops with fewer drives than freedoms: whatever the drive alone permits is found, by both engines."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
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
