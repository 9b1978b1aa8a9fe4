"""Elastic mechanisms for the tests: the tripod, and small ones built in code."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import joint_positions
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.robot import Robot

TripodPositions = Callable[[np.ndarray], np.ndarray]
RigidTree = Callable[..., Robot]


@pytest.fixture(scope="session")
def elastic(slender: Robot) -> ElasticModel:
    """The chapter's machine with its springs."""
    return ElasticModel(slender)


@pytest.fixture(scope="session")
def tripod_positions(tripod: Tripod, mechanism: Robot) -> TripodPositions:
    """Joint positions of the tripod at poses, from the closed form, shape=(n, nq)."""

    def positions(poses: np.ndarray) -> np.ndarray:
        q = np.zeros((len(poses), mechanism.model.nq))
        for row, pose in zip(q, poses, strict=True):
            for joint, value in joint_positions(tripod, pose).items():
                row[mechanism.single_joint(joint).q_index] = value
        return q

    return positions


@pytest.fixture(scope="session")
def rigid_tree() -> RigidTree:
    """Build a mechanism of bodies on frames: (name, parent frame, placement of the joint in it, joint model or None).

    Each entry becomes a frame of its name: the body after the joint or, without a joint, a place on its parent.
    """

    def build(entries: Sequence[tuple[str, str, pin.SE3, pin.JointModel | None]], **keywords: object) -> Robot:
        model = pin.Model()
        model.name = "tree"
        for name, parent, placement, joint in entries:
            base = model.frames[model.getFrameId(parent)]
            where = base.placement * placement
            if joint is None:
                frame = pin.Frame(name, base.parentJoint, model.getFrameId(parent), where, pin.FrameType.OP_FRAME)
                model.addFrame(frame)
            else:
                index = model.addJoint(base.parentJoint, joint, where, f"{name}_joint")
                above = pin.Frame(
                    f"{name}_joint", index, model.getFrameId(parent), pin.SE3.Identity(), pin.FrameType.JOINT
                )
                carrier = model.addFrame(above)
                model.addFrame(pin.Frame(name, index, carrier, pin.SE3.Identity(), pin.FrameType.BODY))
        return Robot(model, **keywords)

    return build
