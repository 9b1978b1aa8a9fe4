"""Walks end at poses from which another assembly with the same signs begins: the flat poses of a parallelogram.

Beyond them a crossed linkage begins whose determinant has the parallelogram's sign, so that signs alone let walks pass.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine


@pytest.fixture(scope="module")
def parallelogram() -> Robot:
    """Cranks of 0.2 m and a coupler of 0.1 m, which turns backwards as the cranks turn forwards; home at 1 rad."""
    model = pin.Model()
    turned = pin.rpy.rpyToMatrix(0.0, 0.0, 1.0)
    crank = model.addJoint(0, pin.JointModelRZ(), pin.SE3(turned, np.zeros(3)), "crank")
    coupler = model.addJoint(crank, pin.JointModelRZ(), pin.SE3(turned.T, np.array([0.2, 0.0, 0.0])), "coupler")
    rocker = model.addJoint(0, pin.JointModelRZ(), pin.SE3(turned, np.array([0.1, 0.0, 0.0])), "rocker")
    for name, joint, x in (("end", coupler, 0.1), ("tip", rocker, 0.2)):
        at = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
        model.addFrame(pin.Frame(name, joint, at, pin.FrameType.OP_FRAME))
    return Robot(model, [LoopClosure("end", "tip", "3d")], actuated_joints=["crank"], tool_frame="end")


@pytest.mark.parametrize(("engine", "count"), [("program", 300), ("pinocchio", 40)])
def test_random_commands(parallelogram: Robot, engine: Engine, count: int) -> None:
    commands = np.random.default_rng(1).uniform(-np.pi, np.pi, (count, 1))
    check(parallelogram.forward(commands, on_failure="nan", engine=engine), commands[:, 0])


@pytest.mark.parametrize("count", [50, 333, 2001])
def test_grids(parallelogram: Robot, count: int) -> None:
    poses = parallelogram.solve(parallelogram.grid(crank=(-3.0, 4.0, count)), on_failure="nan")
    check(poses, np.linspace(-3.0, 4.0, count))


def test_where_walks_end_is_said(parallelogram: Robot) -> None:
    """The first flat pose is at a command of -1 rad, which is -57.3 degrees."""
    with pytest.raises(UnreachablePoseError, match=r"parallel singularity, met near crank = -57\.3 deg"):
        parallelogram.forward([-1.5])


def check(poses: Poses, commands: np.ndarray) -> None:
    """All poses between the flat ones are found, none beyond; a few hundredths of a radian next to them may be."""
    angle, found = commands + 1.0, poses.solved.ravel()
    assert not found[(angle < -1e-3) | (angle > np.pi + 1e-3)].any()
    assert found[(angle > 0.02) & (angle < np.pi - 0.02)].all()
    q = poses.q.reshape(len(commands), -1)[found]
    np.testing.assert_allclose(q[:, 1:], np.column_stack([-q[:, 0], q[:, 0]]), atol=1e-9)
