"""Error sources against closed-form numbers and the nonlinear models they represent."""

from __future__ import annotations

from dataclasses import replace

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
from pm3dof_pin.errors.thermal_growth import Bending, ThermalGrowth
from pm3dof_pin.errors.vibration import Vibration
from pm3dof_pin.errors.waviness import GuideWaviness, Wave
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.simulation.simulated_machine import Conditions, GeometricSource, SimulatedMachine, with_all_parameters

HOME = [0.240272] * 3


def test_ten_kelvin_lengthen_a_screw_of_240_mm_by_28_um(tripod_errors: GeometricErrors) -> None:
    growth = ThermalGrowth(tripod_errors.fixed_bearings)
    np.testing.assert_allclose(growth.travel_errors(np.zeros((1, 3)), np.full((1, 3), 10.0)), 11.5e-5 * 0.240272)


@pytest.mark.parametrize("bearing", [0.0, 0.15, 0.5, -0.1])
def test_the_growth_is_the_integral_of_the_temperature(bearing: float) -> None:
    """Against a fine sum over the piecewise linear profile."""
    profile = ((0.05, 1.0), (0.1, 2.0), (0.3, 0.5))
    growth = ThermalGrowth(np.array([bearing]), profile, expansion=1.0)
    for travel in (-0.2, 0.0, 0.07, 0.2, 0.6):
        distances = np.linspace(0.0, travel - bearing, 200_001)
        shares = np.interp(distances, *np.transpose(profile))
        expected = np.sum(0.5 * (shares[1:] + shares[:-1]) * np.diff(distances))
        computed = growth.travel_errors(np.array([[travel]]), np.array([[1.0]]))
        assert computed[0, 0] == pytest.approx(expected, abs=1e-8)


def _grown(growth: ThermalGrowth, robot: Robot, rise: float) -> Robot:
    parameters, per_kelvin = growth.growth(robot)
    return GeometricErrors(robot, parameters).apply(rise * per_kelvin)


def test_members_grow_with_their_length(mechanism: Robot) -> None:
    growth = ThermalGrowth(np.zeros(3), members={"link1_tip": 0.5, "E2": 1.0})
    grown = _grown(growth, mechanism, 20.0)
    link = grown.home.frame_placement("universal1_second_joint").actInv(grown.home.frame_placement("link1_tip"))
    assert np.linalg.norm(link.translation) == pytest.approx(0.353 * (1.0 + 0.5 * 20.0 * 11.5e-6), rel=1e-15)
    joint = grown.home.frame_placement("platform").actInv(grown.home.frame_placement("E2"))
    assert np.linalg.norm(joint.translation) == pytest.approx(np.hypot(0.075, 0.013) * (1.0 + 20.0 * 11.5e-6))


def test_a_bent_member_ends_on_its_arc(mechanism: Robot) -> None:
    """Two fibres 30 mm apart, one 5 K warmer: concentric arcs over the length of the link, towards the colder one."""
    expansion, depth, across = 11.5e-6, 0.03, 5.0
    growth = ThermalGrowth(np.zeros(3), bending={"link1_tip": Bending((across / depth, 0.0))})
    before, after = (
        robot.home.frame_placement("universal1_second_joint").actInv(robot.home.frame_placement("link1_tip"))
        for robot in (mechanism, _grown(growth, mechanism, 1.0))
    )
    along = before.translation / 0.353
    radius = depth / (expansion * across)
    angle = 0.353 / radius
    aside = after.translation - before.translation
    assert np.linalg.norm(aside) == pytest.approx(radius * (1.0 - np.cos(angle)), rel=1e-6)
    assert aside @ along == pytest.approx(0.0, abs=1e-12)
    turn = pin.log3(before.rotation.T @ after.rotation)
    assert np.linalg.norm(turn) == pytest.approx(angle, rel=1e-9)
    # the end points the way it has moved
    np.testing.assert_allclose(np.cross(before.rotation @ turn, along), 2.0 * aside / 0.353, atol=1e-12)
    straight = ThermalGrowth(np.zeros(3), bending={"passive_cross": Bending((1.0, 0.0))})
    with pytest.raises(InvalidValueError, match="along_m"):
        straight.growth(mechanism)


def test_the_deflection_is_that_of_the_closed_form(tripod: Tripod, tripod_nominal: Poses) -> None:
    poses, wrench = tripod_nominal[:20], np.array([100.0, -50.0, 200.0, 3.0, 4.0, -5.0])
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
    truth = with_all_parameters(tripod_errors)
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


def test_conditions_are_checked(tripod_errors: GeometricErrors) -> None:
    machine = _machine(tripod_errors)
    with pytest.raises(InvalidValueError, match="temperature_rises"):
        machine.poses([HOME, HOME], Conditions([1.0, 2.0]))
    with pytest.raises(InvalidValueError, match="finite"):
        machine.poses([HOME, HOME], Conditions(np.nan))
