"""Working memory of Pinocchio's models."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin

from pm3dof_pin.mechanism.scratch_data import scratch_data


def test_data_are_kept_for_each_thread_and_model() -> None:
    models = [_arm(joints) for joints in range(1, 6)]
    first = scratch_data(models[0])
    assert scratch_data(models[0]) is first
    with ThreadPoolExecutor(1) as other:
        assert other.submit(scratch_data, models[0]).result() is not first
    others = [scratch_data(model) for model in models[1:]]
    assert all(data is not first for data in others)
    assert scratch_data(models[0]) is not first  # those of four models are kept
    assert scratch_data(models[-1]) is others[-1]


def test_displaced_copies_share_data_and_other_joints_do_not() -> None:
    model = _arm(3)
    moved = model.copy()
    moved.jointPlacements[2] = pin.SE3.Random()
    data = scratch_data(model)
    assert scratch_data(moved) is data
    assert scratch_data(model) is data
    for axis in ((0.0, 0.6, 0.8), (0.0, 0.8, 0.6)):
        turned = pin.Model()
        turned.addJoint(0, pin.JointModelRevoluteUnaligned(np.array(axis)), pin.SE3.Identity(), "turn")
        found = scratch_data(turned)
        assert found is not data
        data = found  # it holds the axis


def _arm(joints: int) -> pin.Model:
    model = pin.Model()
    for k in range(joints):
        model.addJoint(k, pin.JointModelRZ(), pin.SE3.Random(), f"joint{k}")
    return model
