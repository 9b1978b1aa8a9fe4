"""Coordinates and their ranges if a description declares none: a platform held by four legs, one drive too many."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import ArrayLike

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.exceptions import ConvergenceError, UnreachablePoseError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_range
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.limit_space import robot_space
from pm3dof_pin.maps.workspace import workspace

MACHINES = Path(__file__).parents[1] / "machines"
LINK = 0.35  # both links of a leg [m]
BASE = 0.5  # of a leg's motor from the axes of the base [m]
CORNER = 0.1  # of a corner of the platform from its own axes [m]


@pytest.fixture(scope="module")
def four_rrr() -> Robot:
    return Robot.load(MACHINES / "four_rrr")


def test_four_drives_of_three_degrees_of_freedom_are_no_coordinates(four_rrr: Robot) -> None:
    assert [coordinate.name for coordinate in four_rrr.coordinates] == ["x", "y", "rz"]
    assert len(four_rrr.commands) == 4


def test_motors_follow_the_platform(four_rrr: Robot) -> None:
    """A leg of two equal links: its upper arm deviates by half the bend from the line to the corner."""
    poses = four_rrr.solve(np.random.default_rng(3).uniform([-0.1, -0.1, -0.3], [0.1, 0.1, 0.3], (50, 3)))
    signs = np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]])

    def motors(pose: np.ndarray) -> np.ndarray:
        x, y, turn = pose
        rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
        lines = [x, y] + CORNER * signs @ rotation.T - BASE * signs
        return np.arctan2(lines[:, 1], lines[:, 0]) + np.arccos(np.linalg.norm(lines, axis=1) / (2.0 * LINK))

    expected = np.array([motors(pose) - motors(np.zeros(3)) for pose in poses.coordinates])
    np.testing.assert_allclose(poses.commands, (expected + np.pi) % (2.0 * np.pi) - np.pi, atol=1e-9)


def test_commands_of_redundant_drives_give_the_pose_back(four_rrr: Robot) -> None:
    values = np.random.default_rng(4).uniform([-0.1, -0.1, -0.3], [0.1, 0.1, 0.3], (40, 3))
    commands = four_rrr.solve(values).commands
    for engine in ("program", "pinocchio"):
        np.testing.assert_allclose(four_rrr.forward(commands, engine=engine).coordinates, values, atol=1e-9)


def test_commands_give_the_pose_back_where_three_of_the_drives_are_singular(four_rrr: Robot) -> None:
    """Three of the four drives do not determine some of these poses, and some have nearly the commands of another."""
    values = np.random.default_rng(4).uniform([-0.25, -0.25, -0.6], [0.25, 0.25, 0.6], (150, 3))
    poses = four_rrr.solve(values, on_failure="nan")
    found = four_rrr.forward(poses[poses.solved].commands)
    np.testing.assert_allclose(found.coordinates, values[poses.solved], atol=1e-7)


def test_far_from_home_hardly_any_commands_lead_to_another_pose(four_rrr: Robot) -> None:
    """Where two poses have nearly the same commands, the one that meets them is found all over the reach."""
    poses = reachable_poses(four_rrr, 300, np.random.default_rng(0))
    found = four_rrr.forward(poses.commands, on_failure="nan")
    assert (np.abs(found.coordinates - poses.coordinates).max(axis=1) < 1e-6).mean() > 0.97


def test_commands_that_differ_slightly_are_met_by_least_squares(four_rrr: Robot) -> None:
    """At the least squares, what is left is orthogonal to all motions: seven poses beside do not come nearer."""
    exact = four_rrr.solve([0.03, -0.02, 0.1])
    commands = exact.commands + 1e-3 * np.array([1.0, -1.0, 0.5, 1.0])
    found = four_rrr.forward(commands)
    beside = four_rrr.solve(found.coordinates + 1e-4 * np.vstack([np.eye(3), -np.eye(3)]), guess=found.q)
    apart = np.linalg.norm(beside.commands - commands, axis=1)
    assert np.linalg.norm(found.commands - commands) < apart.min()


def test_least_squares_are_the_same_from_other_starts_near_singular_poses_too(four_rrr: Robot) -> None:
    """What the commands of a machine with errors are off curves the sum of squares, where Gauss-Newton does not end."""
    errors, generator = closable(GeometricErrors.load(MACHINES / "four_rrr")), np.random.default_rng(5)
    machine = errors.apply(2.0 * errors.sample(generator))
    poses = reachable_poses(four_rrr, 200, generator)
    found = machine.forward(poses.commands, guess=poses.q)
    assert np.abs(found.commands - poses.commands).max() > 1e-4  # they contradict each other
    beside = machine.solve(found.coordinates + 1e-3, guess=found.q, on_failure="nan")
    assert beside.solved.mean() > 0.98
    again = machine.forward(poses.commands[beside.solved], guess=beside.q[beside.solved])
    np.testing.assert_allclose(again.coordinates, found.coordinates[beside.solved], atol=2e-8)


def test_of_two_poses_that_fit_alike_the_one_near_home_is_taken(tmp_path: Path) -> None:
    """A platform on four telescopic legs, alike by quarter turns: two poses are off from the commands by as much."""
    angles = 0.5 * np.pi * np.arange(4)
    pivots, corners = (
        r * np.stack([np.cos(angles + a), np.sin(angles + a)], axis=1) for r, a in ((0.3, 0), (0.08, 0.9))
    )
    lines = corners - pivots
    lengths, turns = np.linalg.norm(lines, axis=1), np.arctan2(lines[:, 1], lines[:, 0])
    parts = ['<link name="base"/>']

    def join(name: str, kind: str, parent: str, at: ArrayLike, axis: str = "0 0 1", turn: float = 0.0) -> None:
        x, y = np.asarray(at, dtype=float).tolist()
        parts.append(
            f'<link name="{name}"/><joint name="{name}_joint" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{name}"/><origin xyz="{x} {y} 0" rpy="0 0 {turn}"/><axis xyz="{axis}"/>'
            '<limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        )

    join("x", "prismatic", "base", [0, 0], "1 0 0")
    join("y", "prismatic", "x", [0, 0], "0 1 0")
    join("platform", "revolute", "y", [0, 0])
    for k in range(4):
        join(f"barrel{k}", "revolute", "base", pivots[k], turn=turns[k])
        join(f"rod{k}", "prismatic", f"barrel{k}", [0, 0], "1 0 0")
        join(f"end{k}", "fixed", f"rod{k}", [lengths[k], 0])
        join(f"corner{k}", "fixed", "platform", corners[k])
    (tmp_path / "legs.urdf").write_text(f'<robot name="legs">{"".join(parts)}</robot>')
    loops = ", ".join(f"[end{k}, corner{k}]" for k in range(4))
    drives = ", ".join(f"rod{k}_joint" for k in range(4))
    text = f"closed_loop: [{loops}]\ntype: [3d, 3d, 3d, 3d]\nname_mot: [{drives}]\ntool_frame: platform\n"
    (tmp_path / "legs.closures.yaml").write_text(text)
    generator = np.random.default_rng(0)
    values = generator.uniform([-0.06, -0.06, -0.25], [0.06, 0.06, 0.25], (100, 3))
    shifts = np.stack([np.cos(values[:, 2]), np.sin(values[:, 2])], axis=1)
    turned = np.stack(
        [shifts @ (corners * [1, -1]).T, np.stack([shifts[:, 1], shifts[:, 0]], axis=1) @ corners.T], axis=2
    )
    commands = np.linalg.norm(values[:, None, :2] + turned - pivots, axis=2) - lengths
    found = Robot.load(tmp_path / "legs.urdf").forward(commands + 1e-6 * generator.normal(size=commands.shape))
    np.testing.assert_allclose(found.coordinates, values, atol=1e-4)


def test_commands_that_contradict_each_other_are_refused(four_rrr: Robot) -> None:
    commands = four_rrr.at(four_rrr.home.q).commands + np.array([0.0, 0.0, 0.0, 0.01])
    for guess in (None, four_rrr.home.q):
        assert np.isnan(four_rrr.forward(commands, guess=guess, on_failure="nan").q).all()
    with pytest.raises(
        UnreachablePoseError, match=r"the commands contradict each other: (m\d, ){2}m\d alone determine the pose"
    ):
        four_rrr.forward(commands)


@pytest.mark.parametrize("name", ["x", "y"])
def test_a_coordinate_goes_until_a_leg_is_stretched(four_rrr: Robot, name: str) -> None:
    """The motor is 0.5 m off both axes, the corner 0.1 m: they separate to 2 x 0.35 m."""
    stretched = np.sqrt((2.0 * LINK) ** 2 - (BASE - CORNER) ** 2) - (BASE - CORNER)
    span = coordinate_range(four_rrr, four_rrr.coordinate(name))
    step = four_rrr.characteristic_length / 16.0
    for end in np.abs(span):
        assert end - step <= stretched <= end


def test_random_poses_are_drawn_over_coordinates(four_rrr: Robot) -> None:
    """Four random commands do not correspond to a pose."""
    poses = reachable_poses(four_rrr, 50, np.random.default_rng(0))
    assert poses.within_limits.all()
    assert np.ptp(poses.coordinates, axis=0).min() > 0.1


def test_a_workspace_of_angles_without_limits_is_one_turn(tmp_path: Path) -> None:
    joint = '<joint name="{0}" type="continuous"><parent link="{1}"/><child link="{0}"/><axis xyz="0 0 1"/></joint>'
    parts = [f'<link name="{name}"/>' for name in ("base", "a", "b")] + [
        joint.format("a", "base"),
        joint.format("b", "a"),
    ]
    (tmp_path / "arm.urdf").write_text(f'<robot name="arm">{"".join(parts)}</robot>')
    found = workspace(robot_space(Robot.load(tmp_path / "arm.urdf")), directions=60)
    np.testing.assert_allclose(found.ranges, [[-np.pi, np.pi]] * 2, atol=1e-6)
    assert found.sections[0].area == pytest.approx((2.0 * np.pi) ** 2, rel=1e-3)


def test_loops_that_do_not_close_are_what_random_poses_lack(tmp_path: Path) -> None:
    """Arms of 0.1 m from pivots 1 m apart."""
    joint = (
        '<link name="{0}"/><joint name="{0}" type="revolute"><parent link="base"/><child link="{0}"/>'
        '<origin xyz="{1} 0 0"/><axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>'
        '<link name="{0}_end"/><joint name="{0}_tip" type="fixed"><parent link="{0}"/>'
        '<child link="{0}_end"/><origin xyz="0 0.1 0"/></joint>'
    )
    (tmp_path / "far.urdf").write_text(
        f'<robot name="far"><link name="base"/>{joint.format("a", 0)}{joint.format("b", 1)}</robot>'
    )
    (tmp_path / "far.closures.yaml").write_text("closed_loop: [[a_end, b_end]]\ntype: [3d]\nname_mot: [a]\n")
    with pytest.raises(ConvergenceError, match="pm3dof info names the loops that are open"):
        reachable_poses(Robot.load(tmp_path), 5, np.random.default_rng(0))
