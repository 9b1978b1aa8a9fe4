"""The closed form against an independent evaluation of the equations, finite differences and complex steps."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import (
    inverse_kinematics,
    joint_positions,
    link_jacobian,
    link_vectors,
    motion_twists,
    passive_joint_angles,
    placement,
    platform_joint_jacobians,
    rotation,
    slider_jacobian,
)
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError

# Table 8.1, deliberately repeated here: the tests do not use the numbers of the file under test.
ALPHA = np.radians([-30.0, 90.0, -150.0])
L_B, L_E, LINK, GAMMA, Z_0 = 0.37425, 0.075, 0.353, np.radians(50.0), 0.013
BASE = L_B * np.stack([np.cos(ALPHA), np.sin(ALPHA), 0 * ALPHA], axis=-1)
GUIDE = np.stack([-np.cos(GAMMA) * np.cos(ALPHA), -np.cos(GAMMA) * np.sin(ALPHA), np.sin(GAMMA) + 0 * ALPHA], axis=-1)
JOINT = np.stack([L_E * np.cos(ALPHA), L_E * np.sin(ALPHA), Z_0 + 0 * ALPHA], axis=-1)


def platform_joints(pose: np.ndarray) -> np.ndarray:
    """E_i by explicit rotation matrices, shape=(3, 3); works for complex numbers."""
    x, y, z = pose
    rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
    ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
    return JOINT @ (rx @ ry).T + np.array([0, 0, 1]) * z


def travels(pose: np.ndarray, mode: int = -1) -> np.ndarray:
    """u_i as the root of a quadratic, for real or complex poses."""
    w = platform_joints(pose) - BASE
    along = np.sum(w * GUIDE, axis=1)
    return along + mode * np.sqrt(along**2 - np.sum(w * w, axis=1) + LINK**2)


def complex_step(function, pose: np.ndarray) -> np.ndarray:
    step = 1e-30
    columns = [function(pose.astype(complex) + 1j * step * unit).imag / step for unit in np.eye(3)]
    return np.stack(columns, axis=-1)


@pytest.fixture(scope="module")
def poses(reachable_poses: np.ndarray) -> np.ndarray:
    return reachable_poses[:500]


def test_links_keep_their_length_for_both_modes(tripod: Tripod, poses: np.ndarray) -> None:
    for mode in (-1, 1):
        u = inverse_kinematics(tripod, poses, assembly_mode=mode)
        for pose, travel in zip(poses[:50], u, strict=False):
            k = platform_joints(pose) - BASE - travel[:, None] * GUIDE
            np.testing.assert_allclose(np.linalg.norm(k, axis=1), LINK, rtol=1e-14)


def test_inverse_kinematics_equals_the_quadratic(tripod: Tripod, poses: np.ndarray) -> None:
    expected = np.array([travels(pose) for pose in poses])
    np.testing.assert_allclose(inverse_kinematics(tripod, poses), expected, rtol=1e-13)


def test_known_travels(tripod: Tripod) -> None:
    """Values computed separately with three simulators."""
    np.testing.assert_allclose(inverse_kinematics(tripod, [0, 0, 0.493]), [0.24028054402] * 3, atol=5e-12)
    u = inverse_kinematics(tripod, [np.radians(10), np.radians(-15), 0.5])
    np.testing.assert_allclose(u, [0.257110951586, 0.260246563859, 0.224483570293], atol=5e-13)


def test_home_is_the_middle_of_the_stroke(tripod: Tripod) -> None:
    np.testing.assert_allclose(inverse_kinematics(tripod, tripod.home), 0.240272, rtol=1e-14)


def test_level_heights(tripod: Tripod) -> None:
    """z_e of the level platform: u sin(gamma) + sqrt(l^2 - h^2) - z_0, h the horizontal distance of a link's ends."""
    for u, height in ((0.155272, tripod.height_min), (0.240272, tripod.height_home), (0.325272, tripod.height_max)):
        h = L_B - u * np.cos(GAMMA) - L_E
        assert height == pytest.approx(u * np.sin(GAMMA) + np.sqrt(LINK**2 - h**2) - Z_0, abs=1e-15)
    assert tripod.clamp_height == pytest.approx(0.379178, abs=5e-7)


def test_rotation_is_the_product_of_both_turns(tripod: Tripod, poses: np.ndarray) -> None:
    for pose in poses[:50]:
        np.testing.assert_allclose(
            tripod.platform_joints @ rotation(pose[0], pose[1]).T + [0, 0, pose[2]], platform_joints(pose), atol=1e-15
        )
    transform = placement(poses)
    np.testing.assert_allclose(
        transform[:, :3, :3] @ np.swapaxes(transform[:, :3, :3], 1, 2),
        np.eye(3) + np.zeros((len(poses), 3, 3)),
        atol=1e-15,
    )


def test_every_mode_closes_the_loops(tripod: Tripod) -> None:
    pose = np.array([0.2, -0.1, 0.5])
    reach = platform_joints(pose) - BASE
    for mode in itertools.product((-1, 1), repeat=3):
        u = inverse_kinematics(tripod, pose, assembly_mode=mode)
        np.testing.assert_allclose(np.linalg.norm(reach - u[:, None] * GUIDE, axis=1), LINK)
        np.testing.assert_array_equal(np.sign(u - np.sum(reach * GUIDE, axis=1)), mode)


def test_platform_joint_jacobian_by_complex_step(tripod: Tripod, poses: np.ndarray) -> None:
    computed = platform_joint_jacobians(tripod, poses)
    for pose, jacobian in zip(poses[:100], computed, strict=False):
        np.testing.assert_allclose(jacobian, complex_step(platform_joints, pose), atol=1e-15)


def test_actuation_jacobian_by_complex_step(tripod: Tripod, poses: np.ndarray) -> None:
    computed = slider_jacobian(tripod, poses)
    for pose, jacobian in zip(poses[:100], computed, strict=False):
        np.testing.assert_allclose(jacobian, complex_step(travels, pose), rtol=1e-11, atol=1e-14)


def test_link_jacobian_by_complex_step(tripod: Tripod, poses: np.ndarray) -> None:
    """Elongation of the links with the sliders locked."""
    computed = link_jacobian(tripod, poses)
    for pose, jacobian in zip(poses[:100], computed, strict=False):
        locked = BASE + travels(pose)[:, None] * GUIDE

        def length(moved: np.ndarray, sliders: np.ndarray = locked) -> np.ndarray:
            return np.sqrt(np.sum((platform_joints(moved) - sliders) ** 2, axis=1))

        np.testing.assert_allclose(jacobian, complex_step(length, pose), rtol=1e-12, atol=1e-15)


def test_erratum_8_8(tripod: Tripod, poses: np.ndarray) -> None:
    """J_t = -(l / k_4) J_a with k_4 = -k . e, row by row."""
    k_4 = -np.sum(link_vectors(tripod, poses) * GUIDE, axis=-1)
    expected = -(LINK / k_4)[..., None] * link_jacobian(tripod, poses)
    np.testing.assert_allclose(slider_jacobian(tripod, poses), expected, rtol=1e-12, atol=1e-15)


def test_erratum_8_10(poses: np.ndarray) -> None:
    """The map to twists, by complex step of the rotation matrix: [omega] = dR R^T."""
    for pose in poses[:50]:
        twists = motion_twists(pose)
        step = 1e-30
        for column in range(3):
            moved = pose.astype(complex)
            moved[column] += 1j * step
            x, y = moved[:2]
            rx = np.array([[1, 0, 0], [0, np.cos(x), -np.sin(x)], [0, np.sin(x), np.cos(x)]])
            ry = np.array([[np.cos(y), 0, np.sin(y)], [0, 1, 0], [-np.sin(y), 0, np.cos(y)]])
            turn = (rx @ ry).imag / step @ (rx @ ry).real.T
            omega = np.array([turn[2, 1], turn[0, 2], turn[1, 0]])
            np.testing.assert_allclose(twists[3:, column], omega, atol=1e-14)
            np.testing.assert_allclose(twists[:3, column], [0, 0, float(column == 2)])


def test_passive_angles_put_the_link_where_it_is(tripod: Tripod, poses: np.ndarray) -> None:
    """Turning the home direction about y, then x of the link's home frame gives the link's direction."""
    home = link_vectors(tripod, tripod.home) / LINK
    angles = passive_joint_angles(tripod, poses)
    np.testing.assert_allclose(passive_joint_angles(tripod, tripod.home)[:, :2], 0.0, atol=1e-14)
    for pose, pose_angles in zip(poses[:100], angles, strict=False):
        k = platform_joints(pose) - BASE - travels(pose)[:, None] * GUIDE
        for leg in range(3):
            z = home[leg]
            y = np.array([-z[1], z[0], 0.0]) / np.hypot(z[0], z[1])
            frame = np.stack([np.cross(y, z), y, z], axis=1)
            first, second, swing = pose_angles[leg]
            about_y = np.array([[np.cos(first), 0, np.sin(first)], [0, 1, 0], [-np.sin(first), 0, np.cos(first)]])
            about_x = np.array([[1, 0, 0], [0, np.cos(second), -np.sin(second)], [0, np.sin(second), np.cos(second)]])
            np.testing.assert_allclose(frame @ about_y @ about_x @ [0, 0, 1], k[leg] / LINK, atol=1e-14)
            tilt = np.radians(20.0)
            socket = np.array([-np.sin(tilt) * np.cos(ALPHA[leg]), -np.sin(tilt) * np.sin(ALPHA[leg]), np.cos(tilt)])
            axis = rotation(pose[0], pose[1]) @ socket
            assert np.cos(swing) == pytest.approx(axis @ k[leg] / LINK, abs=1e-14)


def test_joint_positions_are_named_and_close(tripod: Tripod) -> None:
    positions = joint_positions(tripod, [0.1, -0.2, 0.5])
    assert len(positions) == 12
    assert positions["platform_x_joint"] == 0.1
    assert positions["slider2_joint"] == pytest.approx(travels(np.array([0.1, -0.2, 0.5]))[1] - 0.240272)


def test_functions_broadcast(tripod: Tripod) -> None:
    grid = np.stack(np.meshgrid([0.0, 0.1], [0.0, 0.2, 0.3], [0.5], indexing="ij"), axis=-1)
    assert inverse_kinematics(tripod, grid).shape == (2, 3, 1, 3)
    assert platform_joint_jacobians(tripod, grid).shape == (2, 3, 1, 3, 3, 3)
    np.testing.assert_array_equal(
        inverse_kinematics(tripod, grid)[1, 2, 0], inverse_kinematics(tripod, [0.1, 0.3, 0.5])
    )


def test_out_of_reach_raises_and_names_pose_and_leg(tripod: Tripod) -> None:
    with pytest.raises(UnreachablePoseError, match=r"z_e = 0\.9 m.*leg 1"):
        inverse_kinematics(tripod, [0.0, 0.0, 0.9])
    with pytest.raises(UnreachablePoseError, match=r"pose \(1,\) of the array"):
        inverse_kinematics(tripod, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.9]])


def test_out_of_reach_can_be_nan(tripod: Tripod) -> None:
    u = inverse_kinematics(tripod, [[0.0, 0.0, 0.5], [0.0, 0.0, 0.9]], on_failure="nan")
    assert np.all(np.isfinite(u[0]))
    assert np.all(np.isnan(u[1]))


@pytest.mark.parametrize("pose", [[0.0, 0.5], 0.5, [np.nan, 0.0, 0.5], [0.0, np.inf, 0.5]])
def test_nonsense_poses_are_refused(tripod: Tripod, pose: object) -> None:
    with pytest.raises(InvalidValueError, match="pose"):
        inverse_kinematics(tripod, pose)  # type: ignore[arg-type]


@pytest.mark.parametrize("mode", [0, 2, [1, -1], [1, 1, 0]])
def test_nonsense_modes_are_refused(tripod: Tripod, mode: object) -> None:
    with pytest.raises(InvalidValueError, match="assembly_mode"):
        inverse_kinematics(tripod, [0.0, 0.0, 0.5], assembly_mode=mode)  # type: ignore[arg-type]


def test_a_tripod_is_read_only(tripod: Tripod) -> None:
    with pytest.raises(ValueError, match="read-only"):
        tripod.base_joints[0, 0] = 1.0


@pytest.mark.parametrize("poses", [np.full((2, 3), 0.45), np.zeros((0, 3))])
def test_functions_of_one_pose_refuse_several(tripod: Tripod, poses: np.ndarray) -> None:
    with pytest.raises(InvalidValueError, match=r"pose of shape .*: expected \(3,\)"):
        joint_positions(tripod, poses)


def test_a_pose_of_two_numbers_has_no_placement() -> None:
    with pytest.raises(InvalidValueError, match=r"poses of shape \(2,\)"):
        placement([0.0, 0.5])


def test_of_many_poses_the_one_that_is_no_number_is_named(tripod: Tripod) -> None:
    poses = np.full((100, 50, 3), 0.45)
    poses[7, 3, 1] = np.nan
    with pytest.raises(InvalidValueError) as caught:
        inverse_kinematics(tripod, poses)
    assert str(caught.value).startswith("pose (7, 3) of the array = [0.45, nan, 0.45]: expected finite")
