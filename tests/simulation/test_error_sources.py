"""Error sources against closed-form numbers and the nonlinear models they represent."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.elastic_stiffness import elastic_stiffness
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded import loaded_equilibrium
from pm3dof_pin.elastic.loads import Loads
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.normal_vectors import correlated_normal
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.thermal_growth import ThermalGrowth
from pm3dof_pin.errors.vibration import Vibration
from pm3dof_pin.errors.waviness import GuideWaviness, Wave
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.simulation.simulated_machine import (
    Conditions,
    GeometricSource,
    MachineDrift,
    SimulatedMachine,
    _with_all_parameters,
)

MACHINES = Path(__file__).parents[1] / "machines"

HOME = [0.240272] * 3


def test_the_deflection_is_that_of_the_closed_form(tripod: Tripod, tripod_nominal: Poses, slender: Robot) -> None:
    poses, wrench = slender.solve(tripod_nominal.coordinates[:20]), np.array([100.0, -50.0, 200.0, 3.0, 4.0, -5.0])
    deflections = ElasticDeflection(own_weight=False).displacements(poses, np.tile(wrench, (20, 1)))
    expected = np.linalg.solve(elastic_stiffness(tripod, poses.coordinates), wrench)
    np.testing.assert_allclose(deflections, expected, rtol=1e-8, atol=1e-15)


def test_the_deflection_under_weight_is_that_of_the_loaded_equilibrium(tripod_nominal: Poses) -> None:
    poses = tripod_nominal[:3]
    deflections = ElasticDeflection(payload=5.0).displacements(poses)
    model = ElasticModel(poses.robot)
    for row, q in enumerate(poses.q):
        exact = loaded_equilibrium(model, q, Loads(payloads={"O_e": 5.0}, own_weight=True)).displacement()
        np.testing.assert_allclose(deflections[row], exact, rtol=1e-3, atol=1e-11)


def test_covariances() -> None:
    rng = np.random.default_rng(0)
    covariance = np.diag([4.0, 1.0, 0.0]) + 0.5 * np.eye(3)[[1, 0, 2]] * [[1], [1], [0]]
    draws = correlated_normal(covariance, 40_000, rng)
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=0.1)
    with pytest.raises(InvalidValueError, match="semidefinite"):
        correlated_normal([[1.0, 2.0], [2.0, 1.0]], 3, rng)


def _machine(errors: GeometricErrors, seed: int = 7) -> SimulatedMachine:
    rng = np.random.default_rng(seed)
    return replace(
        SimulatedMachine.random(errors, rng),
        waviness=GuideWaviness.random(3, rng),
        thermal=ThermalGrowth(errors.fixed_bearings, members={"link1_tip": 0.3, "link2_tip": 0.3, "link3_tip": 0.3}),
        elastic=ElasticDeflection(payload=2.0),
        vibration=Vibration(np.diag([1e-6] * 3 + [1e-5] * 3) ** 2, drive_sigma=1e-6),
    )


def test_the_truth_has_six_errors_at_every_joint(tripod_errors: GeometricErrors) -> None:
    truth = _with_all_parameters(tripod_errors)
    assert len(truth) == len(GeometricErrors(tripod_errors.robot))
    assert set(truth.tolerances) == {1e-4, 5e-4}


def test_sources_alone_and_together(tripod_errors: GeometricErrors) -> None:
    """Small errors add up; the remainder is their product."""
    machine, rng = _machine(tripod_errors), np.random.default_rng(1)
    commands = 0.240272 + rng.uniform(-0.04, 0.04, (12, 3))
    conditions = Conditions(rng.uniform(0.0, 10.0, (12, 3)), [50.0, 0.0, -30.0, 0.0, 1.0, 0.0])
    ideal = machine.nominal.forward(commands).transforms
    parts = {
        source: pose_difference(ideal, machine.only(source).poses(commands, conditions))
        for source in ("geometric", "waviness", "thermal", "elastic", "vibration")
    }
    together = pose_difference(ideal, machine.poses(commands, conditions))
    np.testing.assert_allclose(parts["vibration"], 0.0, atol=1e-14)
    for source in ("geometric", "waviness", "thermal", "elastic"):
        assert 1e-7 < tip_error(parts[source]).mean() < 2e-3, source
    assert tip_error(sum(parts.values()) - together).max() < 0.02 * tip_error(together).max()
    with pytest.raises(InvalidValueError, match="geometric, waviness"):
        machine.only("nonsense")


def test_straightness_moves_the_carriage_beside_its_line(mechanism: Robot) -> None:
    """A constant horizontal wave across the travel is a parallel guideway."""
    flat = Wave(2e-5, 1.0, np.pi / 2.0)
    waves = GuideWaviness(((), (), ()), (((flat,), ()), ((), ()), ((), ())))
    crooked = SimulatedMachine(mechanism, waviness=waves).poses([HOME])
    errors = GeometricErrors.load("pm3dof")
    heading = np.radians(-30.0 - 90.0)  # at right angles to the plan of the guideway of leg 1
    shift = {"slider1_joint.tx": 2e-5 * np.cos(heading), "slider1_joint.ty": 2e-5 * np.sin(heading)}
    expected = errors.apply(shift).forward([HOME]).transforms
    np.testing.assert_allclose(crooked, expected, atol=1e-12)


def test_measurements_scatter_by_their_covariance_and_repeat_with_their_seed(tripod_errors: GeometricErrors) -> None:
    machine = _machine(tripod_errors)
    commands = np.tile([[0.25, 0.24, 0.23]], (100, 1))
    measured, again = (machine.measure(commands, np.random.default_rng(3)) for _ in range(2))
    assert measured.tobytes() == again.tobytes()
    scatter = pose_difference(machine.poses(commands[:1])[0], measured)
    np.testing.assert_allclose(scatter[:, :3].std(axis=0), 7.5e-6, rtol=0.25)
    np.testing.assert_allclose(scatter[:, 3:].std(axis=0), 15e-6 / (0.15 * np.sqrt(2.0)), rtol=0.25)
    assert np.abs(scatter.mean(axis=0)[:3]).max() < 4e-6
    one = SimulatedMachine(tripod_errors.robot, GeometricSource(tripod_errors, tripod_errors.zeros))
    exact = one.measure(commands[:2], np.random.default_rng(0), instrument=Instrument("pose", 1e-15, 1e-15))
    np.testing.assert_allclose(exact, tripod_errors.robot.forward(commands[:2]).transforms, atol=1e-12)
    assert np.linalg.norm(pin.log3(exact[0, :3, :3].T @ exact[1, :3, :3])) < 1e-12


@pytest.mark.parametrize("name", ["pm3dof", str(MACHINES / "three_rpr")])
def test_zeros_drift_in_proportion_to_time(name: str) -> None:
    """Three hours, three times as far from the counter, in the joint's unit; some count micrometres backwards."""
    robot = Robot.load(name)
    rates = 1e-5 * np.arange(1.0, len(robot.commands) + 1.0)
    machine = SimulatedMachine(robot, drift=MachineDrift(rates))
    scales = np.array([command.scale for command in robot.commands])
    expected = robot.forward(robot.home.commands + 3.0 * scales * rates).transforms
    found = machine.poses(robot.home.commands[None], Conditions(hours=3.0))[0]
    np.testing.assert_allclose(found, expected, atol=1e-10)


def test_screws_warm_in_proportion_to_time(tripod_errors: GeometricErrors) -> None:
    """Half a kelvin an hour beyond what was measured."""
    robot = tripod_errors.robot
    growing = SimulatedMachine(robot, thermal=ThermalGrowth(np.full(3, 0.1)))
    warming = replace(growing, drift=MachineDrift(np.zeros(3), warming=0.5))
    commands = robot.home.commands[None]
    expected = growing.poses(commands, Conditions(temperature_rises=1.0 + 0.5 * 4.0))
    found = warming.poses(commands, Conditions(temperature_rises=1.0, hours=4.0))
    np.testing.assert_allclose(found, expected, atol=1e-12)
    assert not np.allclose(found, growing.poses(commands, Conditions(temperature_rises=1.0)), rtol=0.0, atol=1e-7)


def test_conditions_are_checked(tripod_errors: GeometricErrors) -> None:
    machine = _machine(tripod_errors)
    with pytest.raises(InvalidValueError, match="temperature_rises"):
        machine.poses([HOME, HOME], Conditions([1.0, 2.0]))
    with pytest.raises(InvalidValueError, match="finite"):
        machine.poses([HOME, HOME], Conditions(np.nan))
