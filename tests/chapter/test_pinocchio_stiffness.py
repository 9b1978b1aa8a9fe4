"""The chapter's numbers from Pinocchio's Jacobians: the closed form to 1e-10, with Pinocchio actually called."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.chapter_stiffness import chapter_stiffness
from pm3dof_pin.chapter.pinocchio_stiffness import pinocchio_stiffness
from pm3dof_pin.chapter.tilt_grids import RectangularGrid
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.chapter_section import stiffness_section
from pm3dof_pin.typing import Array

JACOBIANS = ("computeJointJacobians", "computeFrameJacobian", "getFrameJacobian")


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch) -> dict[str, int]:
    """Count the calls of Pinocchio's Jacobians."""
    counts = dict.fromkeys(JACOBIANS, 0)

    def counted(name: str) -> Callable[..., Any]:
        original = getattr(pin, name)

        def call(*arguments: Any, **options: Any) -> Any:
            counts[name] += 1
            return original(*arguments, **options)

        return call

    for name in JACOBIANS:
        monkeypatch.setattr(pin, name, counted(name))
    return counts


def test_the_diagonal_at_poses_at_random(
    tripod: Tripod, mechanism: Robot, reachable_poses: Array, calls: dict[str, int]
) -> None:
    poses = reachable_poses[:200]
    found = pinocchio_stiffness(mechanism, tripod, poses)
    np.testing.assert_allclose(found, chapter_stiffness(tripod, poses), rtol=1e-10)
    assert calls["getFrameJacobian"] + calls["computeFrameJacobian"] >= 6 * len(poses)  # E_i and D_i of three legs


def test_the_maps_of_figures_8_3_and_8_4(tripod: Tripod, mechanism: Robot, calls: dict[str, int]) -> None:
    grid = RectangularGrid(shape=(9, 9))
    closed, asked = (stiffness_section(tripod, grid, robot=robot).dataset() for robot in (None, mechanism))
    for name in closed.data_vars:
        np.testing.assert_allclose(asked[name].values, closed[name].values, rtol=1e-10)
    assert sum(calls.values()) > 0
    assert np.isfinite(asked["stiffness_global"].values).sum() > 20


def test_another_machine_and_a_pose_out_of_reach(tripod: Tripod, mechanism: Robot) -> None:
    with pytest.raises(InvalidValueError, match="tripod with the joints"):
        pinocchio_stiffness(Robot.load("hexapod"), tripod, np.zeros((1, 3)))
    with pytest.raises(UnreachablePoseError):
        pinocchio_stiffness(mechanism, tripod, [0.0, 0.0, 0.9])
    assert np.isnan(pinocchio_stiffness(mechanism, tripod, [[0.0, 0.0, 0.9]], on_failure="nan")).all()


def test_the_commands(run: Callable[..., Any], calls: dict[str, int], tmp_path: Path) -> None:
    closed, asked = (
        [row["computed"] for row in json.loads(run("table-8-3", "--json", *engine, cwd=tmp_path).stdout)["rows"]]
        for engine in ((), ("--engine", "pinocchio"))
    )
    np.testing.assert_allclose(asked, closed, rtol=1e-10)
    counted = sum(calls.values())
    assert calls["getFrameJacobian"] + calls["computeFrameJacobian"] >= 6 * 3870
    words = ("stiffness-map", "--points", "7", "--no-pictures", "--out", "map")
    assert run(*words, "--engine", "pinocchio", cwd=tmp_path).stdout == run(*words, cwd=tmp_path).stdout
    assert sum(calls.values()) > counted
