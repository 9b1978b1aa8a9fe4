"""Poses to which no straight way leads from home: a map goes around what is in the way, and single poses must too."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.kinematics.robot import Robot


@pytest.fixture(scope="module")
def flat_three_rps() -> Robot:
    """Three hinged cylinders in the plane of their platform, 0.6 and 0.2 m from the middle; home is tilted out of it.

    The flat pose is singular, so that the poses on home's branch surround those beyond.
    """
    model, loops, first = pin.Model(), [], np.zeros(3)
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.086, 0.0, 0.0) @ pin.rpy.rpyToMatrix(0.0, 0.232, 0.0))
    home = {"swing0": [0.002], "leg0": [0.008], "swing1": [0.209], "leg1": [0.013], "swing2": [0.151], "leg2": [0.002]}
    for k, angle in enumerate(2.0 * np.pi / 3.0 * np.arange(3) + [0.006, 0.022, -0.093]):
        across, out = np.array([-np.sin(angle), np.cos(angle), 0.0]), np.array([np.cos(angle), np.sin(angle), 0.0])
        swing = model.addJoint(0, pin.JointModelRevoluteUnaligned(across), pin.SE3(np.eye(3), 0.6 * out), f"swing{k}")
        slide, at = pin.JointModelPrismaticUnaligned(-out), pin.SE3(np.eye(3), -0.4 * out)
        leg = model.addJoint(swing, slide, at, f"leg{k}", *np.array([[100.0], [1.0], [-0.15], [0.15]]))
        ball = 0.2 * out
        if k == 0:
            platform, first = model.addJoint(leg, pin.JointModelSpherical(), pin.SE3.Identity(), "ball"), ball
            model.addFrame(pin.Frame("tool", platform, pin.SE3(np.eye(3), -ball), pin.FrameType.OP_FRAME))
            continue
        for name, joint, place in ((f"tip{k}", leg, np.zeros(3)), (f"seat{k}", platform, ball - first)):
            model.addFrame(pin.Frame(name, joint, pin.SE3(np.eye(3), place), pin.FrameType.OP_FRAME))
        loops.append(LoopClosure(f"tip{k}", f"seat{k}", "3d"))
    q = pin.neutral(model)
    for name, values in {**home, "ball": turn.coeffs()}.items():
        joint = model.joints[model.getJointId(name)]
        q[joint.idx_q : joint.idx_q + joint.nq] = values
    model.referenceConfigurations["home"] = q
    return Robot(model, loops, actuated_joints=["leg0", "leg1", "leg2"], tool_frame="tool")


def test_single_poses_are_found_wherever_a_map_finds_them(flat_three_rps: Robot) -> None:
    robot = flat_three_rps
    ranges = {c.name: (x - 0.03, x + 0.03, 7) for c, x in zip(robot.coordinates, robot.home_coordinates, strict=True)}
    mapped = robot.solve(robot.grid(**ranges), on_failure="nan").reshape(-1)
    assert 50 < mapped.solved.sum() < 300
    reached = mapped[mapped.solved]
    found = robot.forward(reached.commands, on_failure="nan")
    assert found.solved.all()
    assert not found.branch.any()


def test_small_maps_far_from_home_have_the_poses_that_are_found_one_by_one(flat_three_rps: Robot) -> None:
    robot, generator = flat_three_rps, np.random.default_rng(1)
    found = robot.forward(robot.home_coordinates + generator.uniform(-0.12, 0.12, (300, 3)), on_failure="nan")
    far = found[found.solved].commands[:20]
    assert len(far) == 20
    for commands in far:
        axes = {c.name: (u - 1e-4, u + 1e-4, 3) for c, u in zip(robot.coordinates, commands, strict=True)}
        mapped = robot.solve(robot.grid(**axes), on_failure="nan")
        assert mapped.solved[1, 1, 1]
        assert not mapped.branch.any()
