"""Which poses a quantity is computed at."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.pose_values import evaluate_at
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Mask, Matrix


@pytest.mark.parametrize("solved", [0, 1, 3])
def test_nothing_is_computed_at_unsolved_poses(solved: int) -> None:
    robot = Robot.load("pm3dof")
    q = np.tile(robot.home.q, (3, 1))
    q[solved:] = np.nan
    asked: list[int] = []

    def program(rows: Matrix, threads: int | None) -> tuple[Array, Mask]:
        asked.append(len(rows))
        return np.ones((len(rows), 2)), np.ones(len(rows), dtype=bool)

    found = evaluate_at(robot, q, "one", (2,), program=program, reference=lambda q: (2.0, 2.0), on_failure="nan")
    assert asked == [solved] * (solved > 0)
    np.testing.assert_array_equal(found.failed, np.arange(3) >= solved)
    np.testing.assert_array_equal(found.values, np.where(found.failed[:, None], np.nan, np.ones((3, 2))))
    assert not found.redone.any()


def test_without_leave_an_unsolved_pose_is_refused() -> None:
    robot = Robot.load("pm3dof")
    q = np.full((1, robot.model.nq), np.nan)

    def reference(q: Array) -> Array:
        return robot.configuration(q).q

    with pytest.raises(PM3DofError):
        evaluate_at(robot, q, "q", (robot.model.nq,), program=lambda q, _: (q, ~np.isnan(q[:, 0])), reference=reference)
