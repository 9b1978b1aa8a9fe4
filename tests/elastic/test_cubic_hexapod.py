"""A hexapod whose struts lie along edges of a cube: its published stiffness, at the cube's centre and off it.

T. Dehaeze, stewart-simscape, cubic configuration. The cube stands on a corner; H_c is the height of the six edges that
touch neither the lowest corner nor the highest, and an edge is sqrt(3) H_c long. Struts of 1 N/m.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Engine

# H_c, height of the tool above the cube's centre [m]: K(x, x), K(x, theta_y), K(theta_x, theta_x), K(theta_z, theta_z)
PUBLISHED = {
    (0.100, 0.0): ("2", "0", "0.015", "0.06"),
    (0.100, 0.070): ("2", "-0.14", "0.025", "0.06"),
    (0.150, -0.010): ("2", "0.02", "0.034", "0.14"),
}


def cubic_hexapod(height: float, tool: float) -> ElasticModel:
    """Six springs of 1 N/m between a platform and the ground; the origin is the cube's centre."""
    radius, turn = height * np.sqrt(2.0), np.radians(60.0)
    model = pin.Model()
    model.name = "cubic_hexapod"
    above = pin.SE3(np.eye(3), np.array([0.0, 0.0, tool]))
    platform = model.addJoint(0, pin.JointModelFreeFlyer(), above, "platform_joint")
    model.addFrame(pin.Frame("tool", platform, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    for leg in range(6):  # around the cube, alternately up and down
        ends = [leg, leg + 1] if leg % 2 == 0 else [leg + 1, leg]
        foot, head = (
            np.array([radius * np.cos(k * turn), radius * np.sin(k * turn), z])
            for k, z in zip(ends, (-height / 2, height / 2), strict=True)
        )
        along = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), head - foot).matrix()
        joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3(along, foot), f"foot{leg}")
        length = pin.SE3(np.eye(3), np.array([0.0, 0.0, np.linalg.norm(head - foot)]))
        strut = model.addJoint(joint, pin.JointModelPZ(), length, f"strut{leg}")
        model.addFrame(pin.Frame(f"tip{leg}", strut, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
        on_platform = pin.SE3(np.eye(3), head - above.translation)
        model.addFrame(pin.Frame(f"head{leg}", platform, 0, on_platform, pin.FrameType.OP_FRAME))
    struts = [f"strut{leg}" for leg in range(6)]
    closures = [LoopClosure(f"tip{leg}", f"head{leg}", "3d") for leg in range(6)]
    robot = Robot(model, closures, actuated_joints=struts, tool_frame="tool")
    return ElasticModel(robot, [JointSpring(f"{name}_spring", name, 1.0, "N/m") for name in struts])


def closed_form(height: float, tool: float) -> NDArray[np.float64]:
    """2 for each translation, 3/2, 3/2 and 6 H_c^2 for the rotations at the centre, moved to the tool above it."""
    turning = 1.5 * height**2 + 2.0 * tool**2
    K = np.diag([2.0, 2.0, 2.0, turning, turning, 6.0 * height**2])
    K[0, 4] = K[4, 0] = -2.0 * tool
    K[1, 3] = K[3, 1] = 2.0 * tool
    return K


@pytest.mark.parametrize("engine", ["program", "pinocchio"])
@pytest.mark.parametrize(("height", "tool"), PUBLISHED)
def test_published_stiffness(height: float, tool: float, engine: Engine) -> None:
    model = cubic_hexapod(height, tool)
    K = np.linalg.inv(compliance(model, model.rigid.home.q, engine=engine))
    np.testing.assert_allclose(K, closed_form(height, tool), rtol=0.0, atol=1e-13)
    printed = tuple(f"{value:.2g}" for value in np.round(K[[0, 0, 3, 5], [0, 4, 3, 5]], 12) + 0.0)
    expected = PUBLISHED[height, tool]
    np.testing.assert_allclose([float(text) for text in printed], [float(text) for text in expected])
