"""Holding forces against published cross-check values, potential energy, and the equilibrium of single bodies."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import (
    inverse_kinematics,
    link_vectors,
    motion_twists,
    placement,
    slider_jacobian,
)
from pm3dof_pin.dynamics.statics import holding_forces
from pm3dof_pin.exceptions import FrameNotFoundError, InvalidValueError, SingularConfigurationError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

POSES = [(0.0, 0.0, 0.493), (np.radians(10.0), np.radians(-15.0), 0.5)]
FORCES = [(6.026970609,) * 3, (5.868999588679, 5.836388512736, 6.334937172705)]
GRAVITY = np.array([0.0, 0.0, -9.81])


@pytest.fixture(scope="module")
def at(mechanism: Robot, tripod: Tripod) -> Callable[..., Configuration]:
    def place(pose: np.ndarray) -> Configuration:
        return mechanism.solve(pose).configuration()

    return place


@pytest.mark.parametrize(("pose", "expected"), list(zip(POSES, FORCES, strict=True)))
def test_the_tripod_holds_itself_with_the_forces_found_by_other_simulators(
    at: Callable[..., Configuration], pose: tuple[float, ...], expected: tuple[float, ...]
) -> None:
    result = holding_forces(at(pose))
    np.testing.assert_allclose(result.actuator_forces, expected, rtol=0.0, atol=1e-9)
    assert result.actuator_forces_unique
    assert result.closure_forces_unique
    assert result.residual < 1e-12


def _potential_energy(tripod: Tripod, pose: np.ndarray, payload: float) -> float:
    p = tripod.parameters
    sliders = tripod.base_joints + inverse_kinematics(tripod, pose)[:, None] * tripod.guide_directions
    middles = sliders + 0.5 * link_vectors(tripod, pose)
    moment = p.slider_mass * sliders[:, 2].sum() + p.link_mass * middles[:, 2].sum()
    moment += (p.platform_mass + p.passive_leg_mass + payload) * pose[2]
    return 9.81 * float(moment)


@pytest.mark.parametrize("payload", [0.0, 3.7])
def test_forces_are_the_slope_of_the_potential_energy(
    at: Callable[..., Configuration], tripod: Tripod, reachable_poses: np.ndarray, payload: float
) -> None:
    step = np.array([1e-4, 1e-4, 1e-5])
    for pose in reachable_poses[:25]:
        slope = [
            (_potential_energy(tripod, pose + h, payload) - _potential_energy(tripod, pose - h, payload))
            / (2 * h.sum())
            for h in np.diag(step)
        ]
        expected = np.linalg.solve(slider_jacobian(tripod, pose).T, slope)
        forces = holding_forces(at(pose), payloads={"O_e": payload}).actuator_forces
        np.testing.assert_allclose(forces, expected, rtol=1e-6)


def test_a_wrench_at_the_tool_is_held_by_virtual_work(
    at: Callable[..., Configuration], tripod: Tripod, reachable_poses: np.ndarray
) -> None:
    generator = np.random.default_rng(3)
    for pose in reachable_poses[25:50]:
        wrench = generator.uniform(-50.0, 50.0, 6)
        configuration = at(pose)
        change = (
            holding_forces(configuration, wrenches={"O_e": wrench}).actuator_forces
            - holding_forces(configuration).actuator_forces
        )
        work = slider_jacobian(tripod, pose).T @ change + motion_twists(pose).T @ wrench
        np.testing.assert_allclose(work, 0.0, atol=1e-10)


def test_every_leg_and_the_platform_are_in_equilibrium_under_the_closure_forces(
    at: Callable[..., Configuration], tripod: Tripod, reachable_poses: np.ndarray
) -> None:
    p = tripod.parameters
    for pose in reachable_poses[50:60]:
        configuration = at(pose)
        result = holding_forces(configuration)
        on_platform = np.array(
            [
                configuration.frame_placement(f"link{leg + 1}_tip").rotation @ force
                for leg, force in enumerate(result.closure_forces.reshape(3, 3))
            ]
        )
        links = link_vectors(tripod, pose)
        # a link turns freely about its universal joint, which only holds the moment about the normal of its axes
        moments = np.cross(links, -on_platform) + np.cross(0.5 * links, p.link_mass * GRAVITY)
        normals = [
            np.cross(
                configuration.frame_placement(f"cross{leg + 1}").rotation[:, 1],
                configuration.frame_placement(f"link{leg + 1}").rotation[:, 0],
            )
            for leg in range(3)
        ]
        np.testing.assert_allclose(np.cross(moments, normals), 0.0, atol=1e-12)
        # the slider's screw carries link and slider along the guide
        weights = (p.slider_mass + p.link_mass) * GRAVITY
        along = np.sum((weights - on_platform) * tripod.guide_directions, axis=1)
        np.testing.assert_allclose(result.actuator_forces, -along, atol=1e-12)
        arms = tripod.platform_joints @ placement(pose)[:3, :3].T
        wrench = np.concatenate([on_platform.sum(axis=0), np.cross(arms, on_platform).sum(axis=0)])
        wrench[:3] += (p.platform_mass + p.passive_leg_mass) * GRAVITY
        np.testing.assert_allclose(motion_twists(pose).T @ wrench, 0.0, atol=1e-12)


def test_forces_are_linear_in_the_payload_and_a_body_is_a_mass_at_its_centre(at: Callable[..., Configuration]) -> None:
    configuration = at(POSES[1])
    none, one, four = (holding_forces(configuration, payloads={"E2": mass}).actuator_forces for mass in (0.0, 1.0, 4.0))
    np.testing.assert_allclose(four - none, 4.0 * (one - none), rtol=1e-12)
    arm = np.array([0.02, -0.03, 0.1])
    body = pin.Inertia(2.0, arm, np.diag([0.1, 0.2, 0.15]))
    lever = configuration.frame_placement("O_e").rotation @ arm
    weight = np.concatenate([2.0 * GRAVITY, np.cross(lever, 2.0 * GRAVITY)])
    np.testing.assert_allclose(
        holding_forces(configuration, payloads={"O_e": body}).actuator_forces,
        holding_forces(configuration, wrenches={"O_e": weight}).actuator_forces,
        rtol=1e-12,
    )


def test_without_gravity_nothing_is_to_be_held(mechanism: Robot) -> None:
    model = mechanism.model.copy()
    model.gravity.linear = np.zeros(3)
    weightless = Robot(
        model, mechanism.closures, actuated_joints=mechanism.actuated_joints, tool_frame=mechanism.tool_frame
    )
    result = holding_forces(weightless.home)
    np.testing.assert_array_equal(result.actuator_forces, 0.0)
    np.testing.assert_array_equal(result.closure_forces, 0.0)


@pytest.mark.parametrize("crank", [0.3, 1.7, 4.0])
@pytest.mark.parametrize("closure", ["3d", "6d"])
def test_a_planar_linkage_is_held_by_the_slope_of_its_potential_energy_and_its_redundant_closure_is_named(
    make_four_bar: Callable[..., Robot],
    place_four_bar: Callable[..., Configuration],
    four_bar: Any,
    crank: float,
    closure: str,
) -> None:
    configuration = place_four_bar(make_four_bar(closure=closure), crank)
    result = holding_forces(configuration)
    assert result.actuator_forces[0] == pytest.approx(four_bar.potential_slope(crank), abs=1e-12)
    assert result.actuator_forces_unique
    assert not result.closure_forces_unique
    # the least: without forces that do no work on any motion of the tree
    null = np.linalg.svd(configuration.constraint_jacobian.T)[2][-3 if closure == "6d" else -1 :]
    assert np.abs(null @ result.closure_forces).max() < 1e-12


def test_more_actuators_than_degrees_of_freedom_share_the_load_and_that_is_said(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration], four_bar: Any
) -> None:
    crank = 1.1
    result = holding_forces(place_four_bar(make_four_bar("crank_joint", "rocker_joint"), crank))
    assert not result.actuator_forces_unique
    ratio = four_bar.speeds(crank)[1][2]
    assert result.actuator_forces @ [1.0, ratio] == pytest.approx(four_bar.potential_slope(crank), abs=1e-12)
    assert result.actuator_forces[1] == pytest.approx(ratio * result.actuator_forces[0])


def _dead_point() -> float:
    """Crank angle at which crank and coupler are collinear: the rocker is at rest, whatever the crank does."""
    return float(np.arccos((0.7**2 + 0.6**2 - 0.4**2) / (2.0 * 0.7 * 0.6)))


def test_at_a_parallel_singularity_no_forces_exist(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration]
) -> None:
    with pytest.raises(SingularConfigurationError, match=r"parallel singularity.*residual [0-9.e+-]+ N"):
        holding_forces(place_four_bar(make_four_bar("rocker_joint"), _dead_point()))


def test_forces_grow_without_bound_towards_the_singularity(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration], four_bar: Any
) -> None:
    for distance in (1e-2, 1e-4):
        crank = _dead_point() + distance
        force = holding_forces(place_four_bar(make_four_bar("rocker_joint"), crank)).actuator_forces[0]
        assert force == pytest.approx(four_bar.potential_slope(crank) / four_bar.speeds(crank)[1][2], rel=1e-9)


def test_without_an_actuator_the_linkage_falls(
    make_four_bar: Callable[..., Robot], place_four_bar: Callable[..., Configuration]
) -> None:
    model = make_four_bar()
    undriven = Robot(model.model, model.closures, tool_frame=model.tool_frame)
    with pytest.raises(SingularConfigurationError, match="1 degree of freedom left"):
        holding_forces(place_four_bar(undriven, 0.3))


def test_a_link_that_may_spin_about_its_own_axis_is_held(spatial_crank: Any) -> None:
    configuration = spatial_crank.configuration
    result = holding_forces(configuration)
    mechanism, step = configuration.mechanism, 1e-4
    energies = [
        pin.computePotentialEnergy(
            mechanism.model,
            mechanism.model.createData(),
            np.array(mechanism.assemble(configuration, joints={"crank_joint": 0.4 + side * step}).q),
        )
        for side in (-1.0, 1.0)
    ]
    assert result.actuator_forces[0] == pytest.approx((energies[1] - energies[0]) / (2 * step), abs=1e-7)


def test_a_link_that_gravity_spins_does_not_withhold_the_forces(spatial_crank: Any) -> None:
    """With its centre of mass off its axis the link would turn, but crank and slider are held."""
    mechanism, model = spatial_crank.mechanism, spatial_crank.mechanism.model.copy()
    link = model.getJointId("ball_joint")
    bar = model.inertias[link]
    model.inertias[link] = pin.Inertia(bar.mass, np.add(bar.lever, [0.0, 0.02, 0.0]), bar.inertia)
    result = holding_forces(mechanism.replace(model=model).configuration(spatial_crank.configuration.q))
    assert result.unbalanced_idle
    assert result.residual < 1e-12
    straight = holding_forces(spatial_crank.configuration)
    assert not straight.unbalanced_idle
    # the weight of the link does not change, its lever at the crank by 0.02 m at most
    difference = abs(result.actuator_forces[0] - straight.actuator_forces[0])
    assert difference <= bar.mass * 9.81 * 0.02


def test_a_serial_arm_bears_its_gravity_torques(ur5: Robot) -> None:
    q = np.array([0.3, -1.0, 0.8, -0.4, 0.5, 0.1])
    result = holding_forces(ur5.configuration(q))
    expected = pin.computeGeneralizedGravity(ur5.model, ur5.model.createData(), q)
    np.testing.assert_allclose(result.actuator_forces, expected, atol=1e-12)
    assert result.closure_forces.shape == (0,)


@pytest.mark.parametrize("mass", [-1.0, np.nan, np.inf])
def test_payloads_that_are_no_mass_are_refused(mechanism: Robot, mass: float) -> None:
    with pytest.raises(InvalidValueError, match="payload on O_e"):
        holding_forces(mechanism.home, payloads={"O_e": mass})


def test_loads_on_frames_that_are_not_there_are_refused(mechanism: Robot) -> None:
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        holding_forces(mechanism.home, payloads={"nowhere": 1.0})
    with pytest.raises(FrameNotFoundError, match="nowhere"):
        holding_forces(mechanism.home, wrenches={"nowhere": np.zeros(6)})
    with pytest.raises(InvalidValueError, match="wrench on O_e"):
        holding_forces(mechanism.home, wrenches={"O_e": np.zeros(3)})


def test_loops_that_are_open_are_refused(mechanism: Robot) -> None:
    q = np.array(mechanism.home.q)
    q[0] += 0.01
    with pytest.raises(InvalidValueError, match="closed loops"):
        holding_forces(mechanism.configuration(q))


def test_a_machine_that_nothing_holds_is_named_in_one_line(mechanism: Robot) -> None:
    slack = Robot(mechanism.model, mechanism.closures, actuated_joints=["slider1_joint"], tool_frame="O_e")
    with pytest.raises(SingularConfigurationError) as caught:
        holding_forces(slack.assemble())
    assert "2 degrees of freedom left with the actuated joints at rest" in str(caught.value)
    assert "\n" not in str(caught.value)
