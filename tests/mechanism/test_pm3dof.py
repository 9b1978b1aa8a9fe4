"""The chapter's machine from its URDF, against the equations of section 8.2 and the numbers of Table 8.1."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray

from pm3dof_pin.exceptions import UnreachablePoseError
from pm3dof_pin.kinematics.actuation import independent_motions, tool_motions
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.mobility import instantaneous_mobility
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularities
from pm3dof_pin.mechanism.configuration import Configuration

Vector = NDArray[np.float64]

ALPHA = np.radians([-30.0, 90.0, -150.0])
BASE_RADIUS, PLATFORM_RADIUS, LINK, HEIGHT = 0.37425, 0.075, 0.353, 0.013
SLOPE, SLIDER_HOME, STROKE = np.radians(50.0), 0.240272, 0.085

B = BASE_RADIUS * np.column_stack([np.cos(ALPHA), np.sin(ALPHA), np.zeros(3)])
GUIDES = np.column_stack([-np.cos(SLOPE) * np.cos(ALPHA), -np.cos(SLOPE) * np.sin(ALPHA), np.full(3, np.sin(SLOPE))])
HEADS = np.column_stack([PLATFORM_RADIUS * np.cos(ALPHA), PLATFORM_RADIUS * np.sin(ALPHA), np.full(3, HEIGHT)])


def rotation(theta_x: float, theta_y: float) -> NDArray[np.float64]:
    rx = [[1, 0, 0], [0, np.cos(theta_x), -np.sin(theta_x)], [0, np.sin(theta_x), np.cos(theta_x)]]
    ry = [[np.cos(theta_y), 0, np.sin(theta_y)], [0, 1, 0], [-np.sin(theta_y), 0, np.cos(theta_y)]]
    return np.array(rx) @ np.array(ry)


def sliders(theta_x: float, theta_y: float, z: float) -> Vector:
    """(8.6), (8.7): u, slider below the platform; NaN out of reach."""
    w = [0.0, 0.0, z] + HEADS @ rotation(theta_x, theta_y).T - B
    along = np.sum(w * GUIDES, axis=1)
    radicand = along**2 - (np.sum(w * w, axis=1) - LINK**2)
    return along - np.sqrt(np.where(radicand >= 0.0, radicand, np.nan))


def link_directions(theta_x: float, theta_y: float, z: float) -> NDArray[np.float64]:
    u = sliders(theta_x, theta_y, z)
    return ([0.0, 0.0, z] + HEADS @ rotation(theta_x, theta_y).T - B - u[:, None] * GUIDES) / LINK


def twist_map(theta_x: float) -> NDArray[np.float64]:
    """Corrected (8.10): twist [v; omega] of the tool over the rates of theta_x, theta_y and z."""
    twists = np.zeros((6, 3))
    twists[3:, 0] = 1.0, 0.0, 0.0
    twists[3:, 1] = 0.0, np.cos(theta_x), np.sin(theta_x)
    twists[2, 2] = 1.0
    return twists


def slider_jacobian(theta_x: float, theta_y: float, z: float) -> NDArray[np.float64]:
    """(8.9): J_t."""
    n = link_directions(theta_x, theta_y, z)
    wrenches = np.hstack([n, np.cross(HEADS @ rotation(theta_x, theta_y).T, n)])
    return wrenches @ twist_map(theta_x) / np.sum(n * GUIDES, axis=1)[:, None]


def reachable_pose(seed: int) -> Vector:
    rng = np.random.default_rng(seed)
    while True:
        pose = rng.uniform([-0.7, -0.7, 0.40], [0.7, 0.7, 0.58])
        if np.all(np.abs(sliders(*pose) - SLIDER_HOME) < STROKE):
            return pose


@pytest.fixture(scope="module")
def home_height() -> float:
    """z at theta = 0 and u = 0.240272 m: the link bridges the radial gap, and the rest of its length is height."""
    gap = BASE_RADIUS - SLIDER_HOME * np.cos(SLOPE) - PLATFORM_RADIUS
    return float(SLIDER_HOME * np.sin(SLOPE) + np.sqrt(LINK**2 - gap**2) - HEIGHT)


@pytest.fixture(params=range(20))
def pose(request: pytest.FixtureRequest) -> Vector:
    return reachable_pose(request.param)


@pytest.fixture
def configuration(mechanism: Robot, pose: Vector, home_height: float) -> Configuration:
    return mechanism.solve(pose).configuration()


def test_home_is_q_zero(mechanism: Robot, home_height: float) -> None:
    assert mechanism.configuration(np.zeros(mechanism.model.nq)).closure_residual < 1e-15
    np.testing.assert_allclose(mechanism.home.tool_placement.translation, [0.0, 0.0, home_height], atol=1e-15)
    assert mechanism.home.violated_limits() == ()


def test_sliders_and_tool_are_where_the_equations_say(configuration: Configuration, pose: Vector) -> None:
    assert configuration.closure_residual < 1e-14
    np.testing.assert_allclose(configuration.commands, sliders(*pose), atol=1e-14)
    expected = pin.SE3(rotation(*pose[:2]), np.array([0.0, 0.0, pose[2]]))
    np.testing.assert_allclose(configuration.tool_placement.homogeneous, expected.homogeneous, atol=1e-14)


def test_links_point_where_the_equations_say(configuration: Configuration, pose: Vector) -> None:
    for leg, direction in enumerate(link_directions(*pose), start=1):
        np.testing.assert_allclose(
            configuration.frame_placement(f"link{leg}_tip").rotation[:, 2], direction, atol=1e-13
        )


def test_actuation_jacobian_is_the_chapters(configuration: Configuration, pose: Vector) -> None:
    expected = slider_jacobian(*pose)
    np.testing.assert_allclose(
        independent_motions(configuration)[configuration.mechanism.actuated_indices],
        expected,
        rtol=0.0,
        atol=1e-12 * np.abs(expected).max(),
    )


def test_tool_motions_are_the_corrected_twist_map(configuration: Configuration, pose: Vector) -> None:
    np.testing.assert_allclose(tool_motions(configuration), twist_map(pose[0]), atol=1e-13)


def test_three_freedoms_none_idle_none_redundant(configuration: Configuration) -> None:
    mobility = instantaneous_mobility(configuration)
    assert (mobility.count, mobility.tool_mobility, mobility.redundant_constraints) == (3, 3, 0)
    assert mobility.idle_motions.shape == (12, 0)
    assert singularities(configuration) == ()


def test_forward_geometry_undoes_inverse_geometry(mechanism: Robot, configuration: Configuration) -> None:
    back = mechanism.forward(configuration.commands).configuration()
    assert back.tool_placement.isApprox(configuration.tool_placement, 1e-12)
    again = mechanism.reach(configuration.tool_placement).configuration()
    np.testing.assert_allclose(again.q, configuration.q, atol=1e-12)


def test_jacobians_against_finite_differences(mechanism: Robot, configuration: Configuration) -> None:
    def shifted(velocity: Vector) -> Configuration:
        return mechanism.configuration(pin.integrate(mechanism.model, configuration.q, velocity))

    here = configuration.tool_placement
    for index, direction in enumerate(np.eye(mechanism.model.nv)):
        ahead, behind = shifted(1e-6 * direction), shifted(-1e-6 * direction)
        closure = (ahead.closure_error - behind.closure_error) / 2e-6
        np.testing.assert_allclose(configuration.constraint_jacobian[:, index], closure, atol=1e-8)
        turn = [pin.log3(c.tool_placement.rotation @ here.rotation.T) for c in (ahead, behind)]
        shift = [c.tool_placement.translation for c in (ahead, behind)]
        twist = np.concatenate([shift[0] - shift[1], turn[0] - turn[1]]) / 2e-6
        np.testing.assert_allclose(configuration.tool_jacobian[:, index], twist, atol=1e-8)


@pytest.mark.parametrize("seed", range(20))
def test_loops_close_from_guesses_far_off(mechanism: Robot, seed: int, home_height: float) -> None:
    there = mechanism.solve(reachable_pose(seed)).configuration()
    rng = np.random.default_rng(seed)
    off = np.where(mechanism.velocity_scale == 1.0, rng.uniform(-0.3, 0.3, 12), rng.uniform(-0.05, 0.05, 12))
    result = assemble(mechanism, there.q + off)
    assert result.converged
    assert result.residual < 1e-14
    assert result.steps < 10


def test_the_published_cross_check_pose(mechanism: Robot, home_height: float) -> None:
    """Slider travels confirmed by MuJoCo, Drake and PyBullet."""
    pose = np.array([np.radians(10.0), np.radians(-15.0), 0.5])
    configuration = mechanism.solve(pose).configuration()
    expected = [0.257110951586, 0.260246563859, 0.224483570293]
    np.testing.assert_allclose(configuration.commands, expected, atol=5e-13)


def test_swing_is_counted_from_the_inclined_axis(configuration: Configuration, pose: Vector) -> None:
    tilt = np.radians(20.0)
    axes = np.column_stack([-np.sin(tilt) * np.cos(ALPHA), -np.sin(tilt) * np.sin(ALPHA), np.full(3, np.cos(tilt))])
    cosines = np.sum(link_directions(*pose) * (axes @ rotation(*pose[:2]).T), axis=1)
    swings = [configuration.swing(leg) for leg in range(3)]
    np.testing.assert_allclose(np.cos(swings), cosines, atol=1e-13)
    too_far = [violation for violation in configuration.violated_limits() if violation.kind == "swing"]
    assert len(too_far) == np.count_nonzero(cosines < np.cos(np.radians(45.0)))


def test_a_pose_out_of_reach(mechanism: Robot, home_height: float) -> None:
    assert np.isnan(sliders(0.0, 0.0, home_height + 0.5)).all()
    with pytest.raises(UnreachablePoseError, match=r"z_e = 1 m: residual"):
        mechanism.solve([0.0, 0.0, 1.0])
    with pytest.raises(UnreachablePoseError):
        mechanism.reach([0.1, 0.0, 0.5]).configuration()
