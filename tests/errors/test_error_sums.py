"""Sums over errors reduced inside programs, against NumPy on Pinocchio's Jacobians pose by pose."""

from __future__ import annotations

from typing import get_args

import numpy as np
import pytest

from pm3dof_pin.description.schema import checked
from pm3dof_pin.description.source_numbers import SourceNumbers
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.error_sums import KinematicSum, kinematic_sum
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import elimination

WAVES = {"waviness": {"pitch_m": 3e-6, "straightness_m": 5e-6, "lengths_m": [0.01, 0.02]}}


def _sources(errors: GeometricErrors) -> ErrorSources:
    return ErrorSources(errors, checked(WAVES, SourceNumbers, "numbers"), distribution="uniform")


# all sums of one robot; of others what is left, which depends on their commands, and another one each
SUMS = {"pm3dof": get_args(KinematicSum), "hexapod": ("left_rms", "worst_tip"), "three_rps": ("left_rms", "energy")}


@pytest.mark.usefixtures("programs_for_few_poses")
@pytest.mark.parametrize("robot", SUMS)
def test_the_program_is_the_careful_engine(robot: str) -> None:
    described = Robot.load(robot)
    poses = reachable_poses(described, 50, np.random.default_rng(3))
    errors = closable(GeometricErrors(described), poses)
    sources = _sources(GeometricErrors(described, errors.parameters[::7]))
    few = poses[:6]
    tip = kinematic_sum(sources, few, "tip_rms", eta=0.3, engine="pinocchio").values
    for name in SUMS[robot]:
        found = kinematic_sum(sources, poses, name, eta=0.3, threads=1)
        careful = kinematic_sum(sources, few, name, eta=0.3, engine="pinocchio")
        assert careful.redone.all()
        assert not found.redone.any()
        assert np.all(np.abs(found.values[:6] - careful.values) <= 1e-10 * tip)


@pytest.mark.usefixtures("programs_for_few_poses")
def test_poses_in_doubt_are_done_with_care(tripod_nominal: Poses, monkeypatch: pytest.MonkeyPatch) -> None:
    robot = tripod_nominal.robot
    few = GeometricErrors(robot, GeometricErrors.load("pm3dof").parameters[:3])
    careful = kinematic_sum(_sources(few), tripod_nominal[:3], "tip_rms", engine="pinocchio").values
    monkeypatch.setenv("PM3DOF_CACHE_DIR", "")
    monkeypatch.setattr(elimination, "PIVOT", 2.0)  # no least pivot is greater than 1
    found = kinematic_sum(_sources(few), tripod_nominal[:50], "tip_rms")
    assert found.redone.all()
    np.testing.assert_array_equal(found.values[:3], careful)


def test_poses_out_of_reach_have_none(tripod_errors: GeometricErrors) -> None:
    robot = tripod_errors.robot
    poses = robot.solve(robot.grid(z_e=(0.3, 0.9, 60)), on_failure="nan")
    found = kinematic_sum(_sources(tripod_errors), poses, "worst_tip", on_failure="nan")
    assert np.array_equal(np.isnan(found.values), ~poses.solved)
    assert np.array_equal(found.failed, ~poses.solved)
    with pytest.raises(InvalidValueError):
        kinematic_sum(_sources(tripod_errors), poses, "worst_tip")
