"""The mass matrix times motions, by all of its entries and body by body, against Pinocchio's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs.elimination import samples
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.joints import objects
from pm3dof_pin.programs.masses import Masses
from pm3dof_pin.programs.tree import Tree


@pytest.mark.parametrize("count", [3, 24])
def test_rotors_and_bodies_of_a_chain_feel_a_motion(count: int) -> None:
    """A short chain takes fewer operations by the matrix, a long one body by body."""
    rng = np.random.default_rng(count)
    model, parent = pin.Model(), 0
    model.name = "chain"
    for k in range(count):
        joint = pin.JointModelRX() if k % 2 else pin.JointModelRZ()
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), rng.uniform(0.05, 0.2, 3)), f"joint{k}")
        root = rng.normal(size=(3, 3))
        inertia = pin.Inertia(rng.uniform(0.5, 2.0), rng.uniform(-0.1, 0.1, 3), 1e-2 * (root @ root.T + np.eye(3)))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    model.addFrame(pin.Frame("tool", parent, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.armature = rng.uniform(0.1, 0.3, count)
    robot = Robot(model, [], actuated_joints=list(model.names)[1:], tool_frame="tool")
    poses, rates = rng.uniform(-1.0, 1.0, (4, count)), rng.normal(size=(count, 1))
    found = Masses(Tree(Graph(), robot, poses), model).times(objects(rates.tolist()))
    for k, entry in enumerate(found[:, 0]):
        values = np.broadcast_to(samples(entry), 4)
        for q, value in zip(poses, values, strict=True):
            matrix = np.triu(pin.crba(model, model.createData(), q))
            expected = (matrix + np.triu(matrix, 1).T) @ rates[:, 0]
            assert value == pytest.approx(expected[k], rel=1e-9, abs=1e-9)
