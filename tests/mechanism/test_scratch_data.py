"""Working memory of Pinocchio's models."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pinocchio as pin

from pm3dof_pin.mechanism.scratch_data import scratch_data


def test_data_are_kept_for_each_thread_and_model() -> None:
    models = [pin.buildSampleModelManipulator() for _ in range(5)]
    first = scratch_data(models[0])
    assert scratch_data(models[0]) is first
    with ThreadPoolExecutor(1) as other:
        assert other.submit(scratch_data, models[0]).result() is not first
    others = [scratch_data(model) for model in models[1:]]
    assert all(data is not first for data in others)
    assert scratch_data(models[0]) is not first  # those of four models are kept
    assert scratch_data(models[-1]) is others[-1]
