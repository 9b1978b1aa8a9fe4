"""Inverse dynamics against Lagrange's equation, simulators' numbers, finite differences and single bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.dynamics.inverse_dynamics import _loop_motion, inverse_dynamics
from pm3dof_pin.dynamics.mass_matrix import drive_mass_matrix, mass_matrix
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.actuation import independent_motions
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

POSE = np.array([np.radians(10.0), np.radians(-15.0), 0.5])
RATES, ACCELERATIONS = np.array([0.5, -0.3, 0.1]), np.array([1.0, 2.0, -0.5])


@pytest.fixture
def tilted(mechanism: Robot, tripod: Tripod) -> Configuration:
    return mechanism.solve(POSE).configuration()


def test_a_moving_tripod_needs_the_forces_found_by_other_simulators(tilted: Configuration) -> None:
    joints = tilted.mechanism.motion_coordinates
    result = inverse_dynamics(tilted, RATES, ACCELERATIONS, joints=joints)
    expected = [5.406912927, 5.577558008, 6.068380455]
    np.testing.assert_allclose(result.forces.actuator_forces, expected, rtol=0.0, atol=1e-6)
    assert result.forces.residual < 1e-12
    driven = tilted.mechanism.actuated_indices
    again = inverse_dynamics(tilted, result.velocity[driven], result.acceleration[driven])
    np.testing.assert_allclose(again.forces.actuator_forces, result.forces.actuator_forces, rtol=1e-12)
    np.testing.assert_allclose(again.forces.closure_forces, result.forces.closure_forces, atol=1e-12)


@pytest.mark.parametrize("by", ["actuated", "motion"])
def test_velocity_and_acceleration_are_those_of_the_closed_loops(tilted: Configuration, by: str) -> None:
    mechanism = tilted.mechanism
    joints = mechanism.actuated_joints if by == "actuated" else mechanism.motion_coordinates
    motion = _loop_motion(tilted, RATES, ACCELERATIONS, joints=joints)
    start = np.array([tilted.joint_position(name) for name in joints])
    step = 1e-4

    def at(time: float) -> np.ndarray:
        values = start + time * RATES + 0.5 * time**2 * ACCELERATIONS
        return np.array(mechanism.assemble(tilted, joints=dict(zip(joints, values, strict=True))).q)

    far, near, middle, next_, last = (at(k * step) for k in (-2, -1, 0, 1, 2))
    velocity = (8.0 * (next_ - near) - (last - far)) / (12.0 * step)
    acceleration = (16.0 * (next_ + near) - (last + far) - 30.0 * middle) / (12.0 * step**2)
    np.testing.assert_allclose(motion.velocity, velocity, atol=1e-9)
    np.testing.assert_allclose(motion.acceleration, acceleration, atol=1e-5)
    np.testing.assert_allclose(tilted.constraint_jacobian @ motion.velocity, 0.0, atol=1e-14)


@pytest.mark.parametrize("closure", ["3d", "6d"])
@pytest.mark.parametrize("crank", [0.3, 1.7, 4.0, 5.5])
def test_a_four_bar_obeys_the_equation_of_lagrange(
    make_four_bar: Callable[..., Robot],
    place_four_bar: Callable[..., Configuration],
    four_bar: Any,
    crank: float,
    closure: str,
) -> None:
    configuration = place_four_bar(make_four_bar(closure=closure), crank)
    for rate, acceleration in ((0.0, 0.0), (7.0, 0.0), (0.0, -30.0), (-5.0, 40.0)):
        result = inverse_dynamics(configuration, [rate], [acceleration])
        expected = four_bar.torque(crank, rate, acceleration)
        assert result.forces.actuator_forces[0] == pytest.approx(expected, rel=1e-8, abs=1e-8)
    velocity = _loop_motion(configuration, [1.0], [0.0]).velocity
    assert velocity @ mass_matrix(configuration) @ velocity == pytest.approx(four_bar.inertia(crank), rel=1e-12)


def test_driven_at_the_rocker_it_takes_the_same_power(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration], four_bar: Any
) -> None:
    crank, rate, acceleration = 1.2, 6.0, -20.0
    configuration = place_four_bar(make_four_bar("rocker_joint"), crank)
    force = inverse_dynamics(configuration, [rate], [acceleration], joints=["crank_joint"]).forces.actuator_forces[0]
    assert force * four_bar.speeds(crank)[1][2] == pytest.approx(four_bar.torque(crank, rate, acceleration), rel=1e-8)


def test_the_mass_matrix_in_motion_coordinates_gives_the_kinetic_energy(tilted: Configuration) -> None:
    joints = tilted.mechanism.motion_coordinates
    velocity = _loop_motion(tilted, RATES, np.zeros(3), joints=joints).velocity
    model = tilted.mechanism.model
    energy = pin.computeKineticEnergy(model, model.createData(), np.array(tilted.q), velocity)
    whole, motions = mass_matrix(tilted), independent_motions(tilted)
    assert 0.5 * RATES @ (motions.T @ whole @ motions) @ RATES == pytest.approx(energy, rel=1e-12)
    assert 0.5 * velocity @ whole @ velocity == pytest.approx(energy, rel=1e-12)


def test_forces_are_affine_in_accelerations_and_payload_and_at_rest_hold(tilted: Configuration) -> None:
    joints = tilted.mechanism.motion_coordinates

    def forces(accelerations: np.ndarray, mass: float) -> np.ndarray:
        result = inverse_dynamics(tilted, RATES, accelerations, joints=joints, payloads={"E1": mass})
        return np.array(result.forces.actuator_forces)

    np.testing.assert_allclose(
        forces(3.0 * ACCELERATIONS, 1.0) - forces(np.zeros(3), 1.0),
        3.0 * (forces(ACCELERATIONS, 1.0) - forces(np.zeros(3), 1.0)),
        rtol=1e-11,
    )
    np.testing.assert_allclose(
        forces(ACCELERATIONS, 4.0) - forces(ACCELERATIONS, 0.0),
        4.0 * (forces(ACCELERATIONS, 1.0) - forces(ACCELERATIONS, 0.0)),
        rtol=1e-11,
    )
    still = inverse_dynamics(tilted, np.zeros(3), np.zeros(3), payloads={"E1": 2.0}, wrenches={"O_e": np.ones(6)})
    held = holding_forces(tilted, payloads={"E1": 2.0}, wrenches={"O_e": np.ones(6)})
    np.testing.assert_allclose(still.forces.actuator_forces, held.actuator_forces, rtol=1e-12)
    np.testing.assert_allclose(still.forces.closure_forces, held.closure_forces, atol=1e-13)


def test_the_power_of_the_actuators_is_the_rate_of_the_energy(mechanism: Robot, tilted: Configuration) -> None:
    joints, step = mechanism.motion_coordinates, 1e-4
    result = inverse_dynamics(tilted, RATES, ACCELERATIONS, joints=joints)

    def energy(time: float) -> float:
        values = POSE + time * RATES + 0.5 * time**2 * ACCELERATIONS
        there = mechanism.solve(values, guess=tilted.q).configuration()
        velocity = _loop_motion(there, RATES + time * ACCELERATIONS, ACCELERATIONS, joints=joints).velocity
        data = mechanism.model.createData()
        kinetic = pin.computeKineticEnergy(mechanism.model, data, np.array(there.q), velocity)
        return float(kinetic + pin.computePotentialEnergy(mechanism.model, data, np.array(there.q)))

    power = result.forces.actuator_forces @ result.velocity[mechanism.actuated_indices]
    assert power == pytest.approx((energy(step) - energy(-step)) / (2 * step), rel=1e-6)


def test_a_round_link_keeps_its_spin_about_its_own_axis(spatial_crank: Any) -> None:
    """No moment acts on a bar of revolution about its axis, so the acceleration about it vanishes (Euler)."""
    configuration, mechanism = spatial_crank.configuration, spatial_crank.mechanism
    result = inverse_dynamics(configuration, [9.0], [-25.0])
    shortest = _loop_motion(configuration, [9.0], [-25.0])

    def spin(acceleration: np.ndarray) -> float:
        model, data = mechanism.model, mechanism.model.createData()
        pin.forwardKinematics(model, data, np.array(configuration.q), result.velocity, acceleration)
        link = pin.getFrameClassicalAcceleration(model, data, mechanism.frame_id("tip"), pin.LOCAL)
        return float(link.angular[0])

    assert abs(spin(result.acceleration)) < 1e-12
    assert abs(spin(shortest.acceleration)) > 1.0
    assert result.forces.residual < 1e-12


def test_rates_that_the_loops_do_not_allow_are_refused(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration], four_bar: Any
) -> None:
    configuration = place_four_bar(make_four_bar("crank_joint", "rocker_joint"), 1.1)
    ratio = four_bar.speeds(1.1)[1][2]
    slope = (four_bar.speeds(1.1 + 1e-5)[1][2] - four_bar.speeds(1.1 - 1e-5)[1][2]) / 2e-5
    with pytest.raises(InvalidValueError, match="rates"):
        inverse_dynamics(configuration, [1.0, 0.0], [0.0, 0.0])
    with pytest.raises(InvalidValueError, match="accelerations"):
        inverse_dynamics(configuration, [1.0, ratio], [0.0, 0.0])
    result = _loop_motion(configuration, [1.0], [0.0], joints=["crank_joint"])
    driven = configuration.mechanism.actuated_indices
    assert result.acceleration[driven] == pytest.approx([0.0, slope], abs=1e-8)
    both = inverse_dynamics(configuration, result.velocity[driven], result.acceleration[driven])
    assert both.forces.actuator_forces @ [1.0, ratio] == pytest.approx(four_bar.torque(1.1, 1.0, 0.0), rel=1e-8)


def test_joints_that_do_not_tell_the_motion_are_refused(
    tilted: Configuration, make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration]
) -> None:
    with pytest.raises(SingularConfigurationError, match="can move while slider1_joint"):
        _loop_motion(tilted, [1.0], [0.0], joints=["slider1_joint"])
    dead_point = float(np.arccos((0.7**2 + 0.6**2 - 0.4**2) / (2.0 * 0.7 * 0.6)))
    with pytest.raises(SingularConfigurationError, match="can move while rocker_joint"):
        _loop_motion(place_four_bar(make_four_bar("rocker_joint"), dead_point), [0.0], [0.0])


def test_arguments_of_a_wrong_shape_are_refused(tilted: Configuration) -> None:
    with pytest.raises(InvalidValueError, match="rates"):
        inverse_dynamics(tilted, [1.0], [1.0, 2.0, 3.0])
    with pytest.raises(InvalidValueError, match="accelerations"):
        inverse_dynamics(tilted, [1.0, 2.0, 3.0], [np.nan, 0.0, 0.0])


def test_acceleration_of_two_wrists_that_hold_one_body() -> None:
    """Three rotations each about different axes, closed by a whole frame: second differences of the joints."""
    model = pin.Model()
    for wrist, turns in {"a": "XYZ", "b": "ZXY"}.items():
        parent = 0
        for axis in turns:
            parent = model.addJoint(parent, getattr(pin, f"JointModelR{axis}")(), pin.SE3.Identity(), f"{wrist}{axis}")
        placement = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.4])), np.array([0.1, 0.2, 0.3]))
        model.addFrame(pin.Frame(f"hand_{wrist}", parent, placement, pin.FrameType.OP_FRAME))
    robot = Robot(
        model, [LoopClosure("hand_a", "hand_b", "6d")], actuated_joints=["aX", "aY", "aZ"], tool_frame="hand_a"
    )
    start, rates, accelerations = np.array([0.4, -0.3, 0.6]), np.array([0.7, 0.5, -0.9]), np.array([0.2, -0.4, 0.3])
    step = 1e-4
    times = step * np.array([-1.0, 0.0, 1.0])[:, None]
    q = robot.forward(start + rates * times + 0.5 * accelerations * times**2, engine="pinocchio").q
    motion = _loop_motion(robot.configuration(q[1]), rates, accelerations)
    np.testing.assert_allclose(motion.velocity, (q[2] - q[0]) / (2.0 * step), atol=1e-6)
    np.testing.assert_allclose(motion.acceleration, (q[2] - 2.0 * q[1] + q[0]) / step**2, atol=1e-5)


@pytest.mark.parametrize("name", ["pm3dof", "hexapod", "linear_delta"])
def test_the_mass_that_drives_feel_by_differences_of_poses(name: str) -> None:
    """Kinetic energy of the whole tree at the joint rates due to the drives' travels."""
    robot = Robot.load(name)
    scales = np.array([command.scale for command in robot.command_coordinates])
    home, count, step = robot.home.commands, len(scales), 1e-5
    near = robot.forward(
        np.concatenate([home + sign * step * np.diag(scales) for sign in (1.0, -1.0)]),
        guess=robot.home,
        engine="pinocchio",
    ).q
    rates = (near[:count] - near[count:]).T / (2.0 * step)
    mass = pin.crba(robot.model, robot.model.createData(), np.array(robot.home.q))
    mass = np.triu(mass) + np.triu(mass, 1).T
    expected = rates.T @ mass @ rates
    np.testing.assert_allclose(drive_mass_matrix(robot.home), expected, atol=1e-6 * np.abs(expected).max())


def test_drives_that_leave_the_tool_free_feel_no_mass() -> None:
    robot = Robot.load("hexapod")
    lame = robot.replace(actuated_joints=robot.actuated_joints[:5], commands=(), coordinates=(), motion_coordinates=())
    with pytest.raises(SingularConfigurationError, match="the tool can move with the actuated joints at rest"):
        drive_mass_matrix(lame.home)
