"""Simulated worlds: the conditions while a machine is measured, and each source of its errors alone."""

from __future__ import annotations

import numpy as np
import pytest

from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.wrenches import WEIGHT_COLUMN
from pm3dof_pin.simulation.worlds import TEMPERATURE, World


@pytest.fixture(scope="module")
def world(tripod_errors: GeometricErrors) -> World:
    return World.random("everything", tripod_errors, np.random.default_rng(0))


def test_a_weight_on_the_tool_moves_it_by_the_compliance(world: World, tripod_nominal: Poses) -> None:
    """C f with C of the general engine at the pose, on an otherwise perfect machine."""
    nominal = tripod_nominal[:5]
    elastic = world.loaded(60.0).only("elastic")
    weights = np.linspace(10.0, 50.0, 5)
    loaded = elastic.poses(nominal.commands, {WEIGHT_COLUMN: weights})
    bare = elastic.poses(nominal.commands, {WEIGHT_COLUMN: np.zeros(5)})
    model = ElasticModel(nominal.robot)
    for row, q in enumerate(nominal.q):
        compliance = cartesian_compliance(model, q).compliance
        given = loaded[row, :3, 3] - bare[row, :3, 3]
        np.testing.assert_allclose(given, -weights[row] * compliance[:3, 2], rtol=0.0, atol=1e-12)


def test_what_is_known_stands_in_columns(world: World, tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    measured = world.loaded(60.0).measure(tripod_nominal.commands[:40], np.random.default_rng(1))
    assert set(measured.conditions) == {TEMPERATURE, WEIGHT_COLUMN}
    assert 0.0 <= measured.conditions[WEIGHT_COLUMN].min() < 10.0
    assert 50.0 < measured.conditions[WEIGHT_COLUMN].max() <= 60.0
    calibration = fit(measured[:12], tripod_errors, Options("gp"))
    assert calibration.compensation.learned is not None
    assert set(calibration.compensation.learned.inputs.conditions) == {TEMPERATURE, WEIGHT_COLUMN}


def test_all_targets_of_a_pose_are_seen_under_its_load(world: World, tripod_nominal: Poses) -> None:
    instrument, generator = Instrument(targets=((0.1, 0.0, 0.0), (0.0, 0.1, 0.0))), np.random.default_rng(0)
    given = {WEIGHT_COLUMN: np.array([10.0, 20.0])}
    measured = world.loaded(60.0).measure(tripod_nominal.commands[:2], generator, instrument, given)
    assert measured.conditions[WEIGHT_COLUMN].tolist() == [10.0, 10.0, 20.0, 20.0]


def test_one_source_alone(world: World, tripod_nominal: Poses) -> None:
    assert set(world.only("thermal").conditions(3, np.random.default_rng(0))) == {TEMPERATURE}
    assert not world.only("waviness").conditions(3, np.random.default_rng(0))
    nominal = tripod_nominal[:10]
    moved = world.only("waviness").poses(nominal.commands, {}) - nominal.transforms
    assert 1e-7 < np.abs(moved[:, :3]).max() < 1e-4  # waves of 3 um, not tolerances of 0.1 mm


def test_what_is_not_there(tripod_errors: GeometricErrors, serial_arm: Robot, world: World) -> None:
    geometry = World.random("geometry", tripod_errors, np.random.default_rng(0))
    with pytest.raises(InvalidValueError, match="one that this machine has"):
        geometry.only("thermal")
    with pytest.raises(InvalidValueError, match="one of geometric"):
        world.only("magnetic")
    with pytest.raises(InvalidValueError, match="no springs"):
        World.random("everything", GeometricErrors(serial_arm), np.random.default_rng(0)).loaded(10.0)
    with pytest.raises(InvalidValueError, match="non-negative"):
        world.loaded(-1.0)


@pytest.mark.parametrize("robot", ["hexapod", "three_rps"])
def test_the_loops_of_every_robot_close(robot: str) -> None:
    """Also those of the overconstrained machine, with every possible error, at any pose and temperature."""
    errors = GeometricErrors.load(robot)
    poses = reachable_poses(errors.robot, 20, np.random.default_rng(0))
    world = World.random("everything", closable(errors, poses), np.random.default_rng(1))
    measured = world.measure(poses.commands, np.random.default_rng(2))
    offsets = np.linalg.norm(measured.positions - poses.positions, axis=1)
    assert np.all((offsets > 1e-5) & (offsets < 5e-3))
