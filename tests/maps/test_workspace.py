"""Reachable sets of known shape: extremes, areas, volumes, surfaces, holes, parts, and the limits that end them."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.figures.workspace import branches_figure
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.limit_space import DECLARED_RANGE, Flags, LimitSpace, nodes, robot_space
from pm3dof_pin.maps.workspace import (
    BRANCH,
    Surface,
    reachable_intervals,
    spaces_by_branch,
    workspace,
    workspace_section,
)
from pm3dof_pin.typing import Array

MACHINES = Path(__file__).parents[1] / "machines"
TURN = np.linalg.qr([[3.0, 1.0, 0.5], [-1.0, 2.0, 0.3], [0.2, -0.7, 1.9]])[0]


def space(broken: Callable[[Array], Array], dimensions: int, size: float = 1.0, limits: int = 6) -> LimitSpace:
    """Return a space in which a set around the origin is searched in a box of a size."""

    def flags(points: Array) -> Flags:
        return np.asarray(broken(points), dtype=np.uint32)

    return LimitSpace(
        machine="shape",
        names=("x", "y", "z")[:dimensions],
        units=("m",) * dimensions,
        limits=tuple(f"limit{k}" for k in range(limits)),
        broken_limits=flags,
        box=np.array([[-size, size]] * dimensions),
        start=np.zeros(dimensions),
    )


def polytope(normals: Array, distances: Array) -> Callable[[Array], Array]:
    """Return bit masks of the planes n p <= d that points are beyond."""
    return lambda points: (points @ normals.T > distances) @ (1 << np.arange(len(normals)))


def ball(points: Array) -> Array:
    return np.sum(points**2, axis=-1) > 1.0


def enclosed(surface: Surface) -> float:
    """Volume by the divergence theorem."""
    a, b, c = (surface.points[surface.triangles[:, k]] for k in range(3))
    return float(np.einsum("ni,ni->", a, np.cross(b, c)) / 6.0)


@pytest.mark.parametrize("size", [0.3, 1.0, 40.0])
def test_a_ball(size: float) -> None:
    """Searched from boxes too small and far too large."""
    found = workspace(space(ball, 3, size), 41, 240)
    np.testing.assert_allclose(found.ranges, [[-1.0, 1.0]] * 2, atol=1e-7)
    np.testing.assert_allclose(found.level_range, [-1.0, 1.0], atol=1e-7)
    exact = np.pi * np.maximum(1.0 - found.levels**2, 0.0)
    np.testing.assert_allclose(found.areas, exact, atol=1e-3 * np.pi)
    np.testing.assert_allclose([s.ranges[0, 1] for s in found.sections[1:-1]], np.sqrt(exact[1:-1] / np.pi), atol=1e-4)
    assert found.volume == pytest.approx(np.trapezoid(exact, found.levels), rel=1e-4)
    surface = found.surface(30)
    np.testing.assert_allclose(np.linalg.norm(surface.points, axis=1), 1.0, atol=1e-4)
    assert enclosed(surface) == pytest.approx(4.0 / 3.0 * np.pi, rel=1e-2)
    edges = Counter((int(face[k]), int(face[(k + 1) % 3])) for face in surface.triangles for k in range(3))
    assert set(edges.values()) == {1}
    assert all((end, start) in edges for start, end in edges)


def test_a_turned_cube_ends_in_its_corners() -> None:
    """Extremes are corners where three limits meet; each face has the limit that ends it."""
    normals, distances = np.vstack([TURN, -TURN]), np.full(6, 0.5)
    found = workspace(space(polytope(normals, distances), 3), 21, 160)
    corners = np.array(np.meshgrid(*[[-0.5, 0.5]] * 3)).reshape(3, -1).T @ TURN
    np.testing.assert_allclose(
        found.ranges, np.stack([corners.min(axis=0), corners.max(axis=0)], axis=-1)[:2], atol=1e-6
    )
    np.testing.assert_allclose(found.level_range, [corners[:, 2].min(), corners[:, 2].max()], atol=1e-6)
    np.testing.assert_allclose(
        found.range_levels[0], corners[[corners[:, 0].argmin(), corners[:, 0].argmax()], 2], atol=1e-5
    )
    assert found.volume == pytest.approx(1.0, rel=2e-3)
    surface = found.surface(40)
    off = surface.points @ normals.T - 0.5
    assert np.abs(off.max(axis=1)).max() < 1e-4
    for k in range(6):
        assert np.abs(off[surface.limits == 1 << k, k]).max() < 1e-4


def test_a_frustum_ends_in_sections_of_different_size() -> None:
    """Radius 1 - z from z = -0.5 to 0.5: pi / 3 (R^2 + R r + r^2)."""

    def broken(points: Array) -> Array:
        x, y, z = np.moveaxis(points, -1, 0)
        return (np.hypot(x, y) > 1.0 - z) + 2 * (np.abs(z) > 0.5)

    found = workspace(space(broken, 3, 1.6), 21, 160)
    assert found.volume == pytest.approx(np.pi / 3.0 * (1.5**2 + 1.5 * 0.5 + 0.5**2), rel=3e-3)


def test_a_slender_ridge_is_followed_to_its_tip() -> None:
    """A wedge of 3 degrees, askew, whose tip no grid point is near."""
    along, across = np.array([np.cos(0.7), np.sin(0.7)]), np.array([-np.sin(0.7), np.cos(0.7)])
    slope = np.tan(np.radians(1.5))

    def broken(points: Array) -> Array:
        u, v = points @ along, points @ across
        return (np.abs(v) > slope * (1.0 - u)) | (u < -0.2)

    found = workspace(space(broken, 2, 1.5), 1, 360)
    assert found.ranges[:, 1] == pytest.approx(along, abs=1e-3)


@pytest.mark.parametrize("power", [1.5, 2.0])
def test_a_curved_cusp_is_followed_without_creeping(power: float) -> None:
    """Where sides meet tangentially, no patch is fine enough: the tip is that of v = 0.3 u^2 at u = 1, askew."""
    along, across = np.array([np.cos(0.7), np.sin(0.7)]), np.array([-np.sin(0.7), np.cos(0.7)])
    calls = 0

    def broken(points: Array) -> Array:
        nonlocal calls
        calls += 1
        u, v = points @ along, points @ across
        return (np.abs(v - 0.3 * u**2) > 0.1 * np.maximum(1.0 - u, 0.0) ** power) | (u > 1.0) | (u < -0.2)

    found = workspace(space(broken, 2), 1, 360)
    assert found.ranges[:, 1] == pytest.approx(along + 0.3 * across, abs=1e-4)
    assert calls < 2_000


def test_smooth_extremes_between_points_of_the_grid() -> None:
    middle = np.array([0.0371, -0.0613, 0.0177])
    found = workspace(space(lambda points: ball((points - middle) / 0.83), 3), 3, 40)
    assert found.ranges == pytest.approx(middle[:2, None] + [-0.83, 0.83], abs=1e-6)
    assert found.level_range == pytest.approx(middle[2] + np.array([-0.83, 0.83]), abs=1e-6)


def test_a_plane_set_with_a_hole_and_two_parts() -> None:
    """A slender triangle of base 0.3 and height 1.5, with a round hole, next to a turned square of side 0.2."""
    across, along = np.array([np.cos(0.4), np.sin(0.4)]), np.array([-np.sin(0.4), np.cos(0.4)])
    square = polytope(np.array([across, along, -across, -along]), np.full(4, 0.1))
    triangle = polytope(np.array([[-1.0, 0.1], [1.0, 0.1], [0.0, -1.0]]), np.array([0.1, 0.1, 0.5]))

    def broken(points: Array) -> Array:
        hole = np.sum((points - [0.0, -0.4]) ** 2, axis=-1) < 0.05**2
        return ((triangle(points) > 0) | hole) & (square(points - [0.6, 0.2]) > 0)

    (section,) = workspace(space(broken, 2), directions=1200).sections
    assert len(section.lines) == 3
    assert section.area == pytest.approx(0.5 * 0.3 * 1.5 - np.pi * 0.05**2 + 0.04, rel=2e-3)
    assert section.ranges[1, 1] == pytest.approx(1.0, abs=1e-3)


def test_shares_are_lengths() -> None:
    """A rectangle of 1.6 by 0.8, whose sides count alike relative to its ranges; corners in part."""
    sides = polytope(np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]]), np.array([0.8, 0.8, 0.4, 0.4]))
    shares = workspace_section(space(sides, 2, limits=4), 0.0, 400).limit_shares
    assert list(shares.values()) == pytest.approx([0.25] * 4, abs=5e-3)


def test_sets_without_poses_and_without_ends() -> None:
    with pytest.raises(UnreachablePoseError, match="the workspace is empty"):
        workspace(space(lambda points: np.ones(points.shape[:-1]), 3))
    with pytest.raises(InvalidValueError, match="expected coordinates of shape that joint limits or its reach bound"):
        workspace(space(lambda points: points[..., 0] > 1.0, 2))


def test_a_tiny_set_around_home_is_found() -> None:
    found = workspace(space(lambda points: ball(points / 1e-3), 3, 10.0), 5, 60)
    np.testing.assert_allclose(found.ranges, [[-1e-3, 1e-3]] * 2, rtol=1e-6)


def test_declared_ranges_are_limits() -> None:
    """The hexapod declares x and y of +-15 mm, z from 118 to 152 mm; its struts reach farther."""
    robot = Robot.load("hexapod")
    within, beyond = (workspace(robot_space(robot, declared_ranges=declared), 5, 60) for declared in (True, False))
    np.testing.assert_allclose(within.ranges, [[-0.015, 0.015]] * 2, atol=1e-8)
    np.testing.assert_allclose(within.level_range, [0.118, 0.152], atol=1e-8)
    assert within.limit_shares[DECLARED_RANGE] > 0.0
    assert beyond.limit_shares[DECLARED_RANGE] == 0.0
    assert np.all(np.abs(beyond.ranges) > 0.0155)
    poses = robot.solve(np.pad(beyond.surface(12).points, ((0, 0), (0, 3))), on_failure="nan")
    assert poses.within_limits.all()


@pytest.mark.parametrize("name", ["linear_delta", "three_rps", "hexapod"])
def test_a_grid_is_judged_as_its_points_are(name: str) -> None:
    """Beyond the ends too, where nothing is solved."""
    space = robot_space(Robot.load(name))
    axes = [np.linspace(low - 0.1 * (high - low), high + 0.1 * (high - low), 14) for low, high in space.box]
    together, apart = space.within_grid(axes), space.within(nodes(axes))
    assert 0 < apart.sum() < apart.size
    np.testing.assert_array_equal(together, apart)


@pytest.mark.parametrize("name", ["hexapod", "linear_delta", "three_rps"])
def test_limits_are_the_same_from_home_and_from_poses_nearby(name: str) -> None:
    """Where a pose nearby is unknown, and beyond the ends, too."""
    space, random = robot_space(Robot.load(name), declared_ranges=False), np.random.default_rng(2)
    points = random.uniform(space.box[:, 0], space.box[:, 1], (400, 3))
    flags, q = space.limits_from(points, np.full((400, space.nq), np.nan))
    np.testing.assert_array_equal(flags, space.broken_limits(points))
    assert np.isfinite(q[:, 0]).any()
    assert 0 < (flags == 0).sum() < len(flags)
    moved = points + 0.02 * np.ptp(space.box, axis=1) * random.uniform(-1.0, 1.0, points.shape)
    again, _ = space.limits_from(moved, q)
    np.testing.assert_array_equal(again, space.broken_limits(moved))
    np.testing.assert_array_equal(space.within_from(moved, q)[0], space.within(moved))


def test_the_reference_engine_finds_the_same_on_its_coarser_grid() -> None:
    robot = Robot.load("hexapod")
    spaces = [robot_space(r, declared_ranges=False) for r in (robot, robot.with_engine("pinocchio"))]
    assert spaces[1].density < spaces[0].density
    points = np.random.default_rng(3).uniform(spaces[0].box[:, 0], spaces[0].box[:, 1], (40, 3))
    np.testing.assert_array_equal(spaces[0].broken_limits(points), spaces[1].broken_limits(points))


def test_branches_end_where_the_machine_is_singular() -> None:
    """A 3-RPR with similar base and platform, 40 deg apart at home, is singular where they are 90 deg apart."""
    robot = Robot.load(MACHINES / "three_rpr")
    space = robot_space(robot, declared_ranges=False, all_branches=True)
    first, second = (workspace(own, 9, 60) for own in spaces_by_branch(space).values())
    assert first.level_range[0] == pytest.approx(np.radians(-50.0), abs=1e-5)
    assert second.level_range[1] == pytest.approx(np.radians(-50.0), abs=1e-5)
    for found in (first, second):
        assert found.limit_shares[BRANCH] > 0.0
    home = workspace(robot_space(robot, declared_ranges=False), 9, 60)
    np.testing.assert_allclose(home.level_range, first.level_range, atol=1e-5)
    np.testing.assert_allclose(home.ranges, first.ranges, atol=1e-4)
    figure = branches_figure({0: first, 8: second})
    assert [text.get_text() for text in figure.legends[0].get_texts()] == ["branch 0 (of home)", "branch 8"]
    with pytest.raises(InvalidValueError, match="all_branches"):
        spaces_by_branch(robot_space(robot))


def test_loops_bound_drives_without_limits(tmp_path: Path) -> None:
    """A five-bar whose motors turn freely: both arms, 0.25 + 0.35 m long, on pivots at x = -0.1 and 0.1 m."""
    urdf = (MACHINES / "five_bar" / "five_bar.urdf").read_text().replace('type="revolute"', 'type="continuous"')
    (tmp_path / "five_bar.urdf").write_text(re.sub(r"<limit[^>]*>", '<limit effort="10" velocity="1"/>', urdf))
    closures = (MACHINES / "five_bar" / "five_bar.closures.yaml").read_text()
    (tmp_path / "five_bar.closures.yaml").write_text(re.sub(r", range: [^}]*", "", closures))
    found = workspace(robot_space(Robot.load(tmp_path)), directions=240)
    np.testing.assert_allclose(found.ranges[0], [-0.5, 0.5], atol=1e-6)
    assert found.ranges[1, 1] == pytest.approx(np.sqrt(0.6**2 - 0.1**2), abs=1e-6)
    assert found.limit_shares["reach"] == pytest.approx(1.0)


def test_a_robot_of_too_many_operations_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("pm3dof_pin.maps.limit_space._MOST_OPERATIONS", 100)
    with pytest.raises(InvalidValueError, match="operations a Newton step"):
        robot_space(Robot.load("hexapod"))


def test_a_single_coordinate_has_intervals(tmp_path: Path, answer: Callable[..., dict[str, Any]]) -> None:
    """A line with a hole; and a crank that swings until coupler and rocker are stretched, by the law of cosines."""
    line = space(lambda x: (np.abs(x[..., 0]) > 1.0) + 2 * (np.abs(x[..., 0] - 0.3) < 0.1), 1)
    found = reachable_intervals(line)
    np.testing.assert_allclose([part.ends for part in found], [(-1.0, 0.2), (0.4, 1.0)], atol=1e-9)
    assert [part.limits for part in found] == [(("limit0",), ("limit1",)), (("limit1",), ("limit0",))]
    crank, coupler, rocker, ground = 0.2, 0.1, 0.12, 0.24
    joint = (
        '<link name="{0}"/><joint name="{0}_joint" type="continuous"><parent link="{1}"/><child link="{0}"/>'
        '<origin xyz="{2} 0 0" rpy="0 0 {3}"/><axis xyz="0 0 1"/></joint>'
    )
    text = '<robot name="bars"><link name="base"/>' + joint.format("crank", "base", 0.0, 0.0)
    text += joint.format("coupler", "crank", crank, 1.0) + joint.format("rocker", "base", ground, 2.0)
    text += f'<loop name="tip" type="revolute"><predecessor link="coupler"><origin xyz="{coupler} 0 0"/></predecessor>'
    text += f'<successor link="rocker"><origin xyz="{rocker} 0 0"/></successor><axis xyz="0 0 1"/></loop></robot>'
    path = tmp_path / "bars.urdf"
    path.write_text(text)
    (tmp_path / "bars.closures.yaml").write_text("name_mot: [crank_joint]\n")
    (part,) = answer("workspace", "--robot", str(path))["intervals"]
    end = np.arccos((crank**2 + ground**2 - (coupler + rocker) ** 2) / (2.0 * crank * ground))
    np.testing.assert_allclose(part["crank_joint_range_rad"], [-end, end], atol=1e-5)
    assert part["limits"] == [["reach"], ["reach"]]
