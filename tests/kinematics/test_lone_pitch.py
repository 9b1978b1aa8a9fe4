"""ry alone has a sine, but no sign of its cosine: beyond 90 degrees it is refused, not answered by a mirrored angle."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

HOME = (0.4, -0.9, 0.6)  # with all joints at zero


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
def test_an_arm_in_the_xz_plane(engine: Engine) -> None:
    model, joint = pin.Model(), 0
    for k, x in enumerate([0.0, 0.3, 0.3]):
        at = pin.SE3(pin.rpy.rpyToMatrix(0.0, HOME[k], 0.0), np.array([x, 0.0, 0.0]))
        joint = model.addJoint(joint, pin.JointModelRY(), at, f"joint{k}")
    at = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    model.addFrame(pin.Frame("tip", joint, at, pin.FrameType.OP_FRAME))
    coordinates = [Coordinate("x", "m", tool="x"), Coordinate("z", "m", tool="z"), Coordinate("ry", "rad", tool="ry")]
    drives = [f"joint{k}" for k in range(3)]
    robot = Robot(model, actuated_joints=drives, tool_frame="tip", coordinates=coordinates)
    pitch = np.radians([-80.0, -30.0, 60.0, 85.0, 95.0, 120.0, 150.0, -100.0])
    poses = robot.solve(np.column_stack([np.full(8, 0.3), np.full(8, 0.1), pitch]), on_failure="nan", engine=engine)
    np.testing.assert_array_equal(poses.solved, np.abs(pitch) < np.pi / 2.0)
    turned = poses.transforms[poses.solved]
    np.testing.assert_allclose(np.arctan2(turned[:, 0, 2], turned[:, 0, 0]), pitch[poses.solved], atol=1e-9)
    with pytest.raises(UnreachablePoseError, match="ry alone is told within -90"):
        robot.solve([0.3, 0.1, 2.0], engine=engine)
