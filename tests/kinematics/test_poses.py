"""Batches of poses: commands, coordinates and tool placements agree, on every robot."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, placement, slider_jacobian
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.elastic.batch import compliance
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.exceptions import InvalidValueError, ShapeError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import REACH, Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses as draw
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.tool_components import rotation_of_angles
from pm3dof_pin.typing import Array, Engine

ROBOTS = ("pm3dof", "hexapod", "three_rps")


@pytest.fixture(scope="module", params=ROBOTS)
def poses(request: pytest.FixtureRequest) -> Poses:
    """60 random poses within the limits of a robot."""
    return draw(Robot.load(request.param), 60, np.random.default_rng(4))


@pytest.fixture(params=["program", "pinocchio"])
def engine(request: pytest.FixtureRequest) -> Engine:
    chosen: Engine = request.param
    return chosen


def test_commands_of_a_pose_give_the_pose_back(poses: Poses, engine: Engine) -> None:
    again = poses.robot.forward(poses.commands, engine=engine)
    np.testing.assert_allclose(again.commands, poses.commands, atol=1e-15)
    np.testing.assert_allclose(again.transforms, poses.transforms, atol=1e-10)
    assert again.residual.max() < 1e-12


def test_coordinates_of_a_pose_give_the_pose_back(poses: Poses, engine: Engine) -> None:
    again = poses.robot.solve(poses.coordinates, engine=engine)
    np.testing.assert_allclose(again.coordinates, poses.coordinates, atol=1e-14)
    np.testing.assert_allclose(again.commands, poses.commands, atol=1e-11)


def test_the_tool_is_brought_to_placements(poses: Poses) -> None:
    again = poses.robot.reach(poses.transforms, guess=poses.q)
    np.testing.assert_allclose(again.commands, poses.commands, atol=1e-10)


def test_the_hexapods_coordinates_are_the_placement_of_its_tool() -> None:
    robot = Robot.load("hexapod")
    values = robot.home_coordinates + np.array([0.003, -0.002, 0.004, 0.05, -0.03, 0.02])
    pose = robot.solve(values)
    np.testing.assert_allclose(pose.positions, values[:3], atol=1e-13)
    np.testing.assert_allclose(pose.rotations, rotation_of_angles(values[3:]), atol=1e-13)


def test_the_tripod_agrees_with_its_closed_form(
    tripod: Tripod, mechanism: Robot, reachable_poses: Array, engine: Engine
) -> None:
    values = reachable_poses[: 400 if engine == "program" else 100]
    solved = mechanism.solve(values, engine=engine)
    np.testing.assert_allclose(solved.commands, inverse_kinematics(tripod, values), atol=1e-12)
    np.testing.assert_allclose(solved.transforms, placement(values), atol=1e-12)
    assert solved.within_limits.all()
    assert not mechanism.forward(inverse_kinematics(tripod, values), engine=engine).broken_limits.any()


def test_the_same_limits_are_broken_as_in_closed_form(tripod: Tripod, mechanism: Robot, engine: Engine) -> None:
    count = 400 if engine == "program" else 150
    values = np.random.default_rng(3).uniform([-0.9, -0.9, 0.36], [0.9, 0.9, 0.62], (count, 3))
    solved = mechanism.solve(values, on_failure="nan", engine=engine)
    expected = limit_flags(tripod, values)
    assert [group.name for group in mechanism.limit_groups] == ["stroke", "universal", "spherical", "tilt", "height"]
    reached = solved.solved
    np.testing.assert_array_equal(solved.broken_limits[reached], expected[reached])
    # where the closed form has a pose that is not reached, its own J_t, (8.9), has the other sign: a parallel
    # singularity lies between
    beyond = values[~reached & (expected & REACH == 0)]
    assert (
        np.linalg.det(slider_jacobian(tripod, beyond)) * np.linalg.det(slider_jacobian(tripod, [0, 0, 0.5])) < 0
    ).all()
    np.testing.assert_array_equal(solved.broken_limits[~reached], REACH)
    assert (np.linalg.det(slider_jacobian(tripod, values[reached])) > 0).all()


def test_a_batch_keeps_its_shape_and_marks_what_it_cannot_reach(mechanism: Robot) -> None:
    grid = mechanism.grid(theta_x=(-0.2, 0.2, 3), z_e=(0.45, 1.05, 4))
    solved = mechanism.solve(grid, on_failure="nan")
    assert solved.shape == grid.shape == (3, 4)
    np.testing.assert_array_equal(solved.solved[:, 0], True)
    np.testing.assert_array_equal(solved.solved[:, -1], False)
    assert np.isnan(solved.commands[:, -1]).all()
    np.testing.assert_array_equal(solved[1:, :2].q, solved.q[1:, :2])
    np.testing.assert_array_equal(solved.reshape(12).q[4], solved.q[1, 0])


def test_a_pose_out_of_reach_is_named(mechanism: Robot) -> None:
    with pytest.raises(UnreachablePoseError, match=r"u1 = 0\.5 m, u2 = -0\.5 m.*1 of 2 poses.*residual"):
        mechanism.forward([[0.24, 0.24, 0.24], [0.5, -0.5, 0.24]])


def test_arguments_are_checked(mechanism: Robot) -> None:
    with pytest.raises(InvalidValueError, match=r"expected \(..., 3\): u1, u2, u3"):
        mechanism.forward([0.0, 0.0])
    with pytest.raises(InvalidValueError, match="finite"):
        mechanism.solve([[0.0, 0.0, 0.5], [np.nan, 0.0, 0.5]])
    with pytest.raises(InvalidValueError, match="guess"):
        mechanism.forward([[0.24, 0.24, 0.24]], guess=np.zeros(3))
    with pytest.raises(InvalidValueError, match="theta_x, theta_y, z_e"):
        mechanism.grid(height=0.5)
    assert len(mechanism.forward(np.empty((0, 3)))) == 0


def test_home_is_within_the_limits_of_an_arm(tmp_path: Path) -> None:
    """Zero is excluded by the limits of two joints, which stand in the middle of their range."""
    limits = {"a": (-1.0, 2.0), "b": (-3.0, -0.2), "c": (0.5, 1.5)}
    joint = (
        '<link name="{0}"/><joint name="{0}" type="revolute"><parent link="{1}"/><child link="{0}"/><axis xyz="0 0 1"/>'
        '<limit lower="{2}" upper="{3}" effort="1" velocity="1"/></joint>'
    )
    parts = [joint.format(name, "0abc"[k], *ends) for k, (name, ends) in enumerate(limits.items())]
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="0"/>{"".join(parts)}</robot>')
    np.testing.assert_allclose(Robot.load(tmp_path / "arm.urdf").home.q, [0.0, -1.6, 1.0])


def test_an_arm_reaches_as_far_as_it_is_long_and_no_farther(tmp_path: Path) -> None:
    joint = (
        '<link name="{0}"/><joint name="{0}" type="{1}"><parent link="{2}"/><child link="{0}"/><origin xyz="{3}"/>'
        '<axis xyz="0 0 1"/></joint>'
    )
    parts = [
        joint.format("upper", "continuous", "base", "0.1 0.2 0.3"),
        joint.format("lower", "continuous", "upper", "0.5 0 0"),
        joint.format("tip", "fixed", "lower", "0.25 0 0"),
    ]
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm"><link name="base"/>{"".join(parts)}</robot>')
    robot = Robot.load(tmp_path / "arm.urdf", tool_frame="tip")
    reach = np.array([[0.75], [0.6], [0.75 + 1e-6], [2.0]]) * [[1.0, 0.0, 0.0]] + [0.1, 0.2, 0.3]
    for engine in ("program", "pinocchio"):
        np.testing.assert_array_equal(
            robot.reach(reach, on_failure="nan", engine=engine).solved, [True, True, False, False]
        )


def test_a_single_pose_is_like_a_batch_of_one(mechanism: Robot) -> None:
    pose = mechanism.solve([0.1, -0.2, 0.5])
    assert (pose.shape, len(pose), pose[:1].shape) == ((), 1, (1,))
    assert pose[0].shape == pose[-1].shape == pose[...].shape == ()
    np.testing.assert_array_equal(pose[0].q, pose.q)
    np.testing.assert_array_equal([configuration.q for configuration in pose], [pose.q])
    with pytest.raises(IndexError):
        pose[1]
    batch = mechanism.solve([[0.1, -0.2, 0.5], [0.0, 0.0, 0.5]])
    assert (len(batch), batch[1].shape, len(batch[1]), len(batch[:0])) == (2, (), 1, 0)
    with pytest.raises(ShapeError, match=r"poses of shape \(2,\): expected as many as in the shape \(3, 5\)"):
        batch.reshape(3, 5)
    with pytest.raises(ShapeError, match=r"poses 0 of shape \(2,\): expected the index of one pose"):
        list(batch.reshape(1, 2))


def test_two_loads_of_a_robot_are_one_robot(mechanism: Robot) -> None:
    again, other = Robot.load("pm3dof"), Robot.load("hexapod")
    assert mechanism.matches(again)
    assert not mechanism.matches(other)
    model = ElasticModel(mechanism)
    found, expected = (cartesian_compliance(model, robot.home).compliance for robot in (again, mechanism))
    np.testing.assert_array_equal(found, expected)
    with pytest.raises(InvalidValueError, match=r"is one of Robot\(hexapod: .* expected one of Robot\(pm3dof: "):
        cartesian_compliance(model, other.home)
    longer = again.model.copy()
    longer.jointPlacements[1].translation[0] += 1e-3
    assert not mechanism.matches(again.replace(model=longer))


def test_coordinates_given_where_positions_belong_are_named(mechanism: Robot) -> None:
    with pytest.raises(
        InvalidValueError, match=r"12\), joint positions q; solve values of theta_x, theta_y, z_e first"
    ):
        compliance(mechanism, [0.1, -0.2, 0.5])


def test_rows_are_taken_by_their_numbers(mechanism: Robot) -> None:
    poses = mechanism.solve(mechanism.grid(theta_x=(-0.2, 1.0, 5), theta_y=(-0.1, 0.1, 3), z_e=0.5))
    some = poses[np.array([3, 0, -1])]
    np.testing.assert_array_equal(some.q, poses.q[[3, 0, -1]])
    np.testing.assert_array_equal(some.broken_limits, poses.broken_limits[[3, 0, -1]])
    assert some.shape == (3, 3)
    with pytest.raises(IndexError):
        poses[np.array([5])]
