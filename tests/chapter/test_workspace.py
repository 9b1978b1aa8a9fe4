"""The whole reachable set against closed forms, counting, and the corners where two limits meet."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy.optimize import fsolve

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, passive_joint_angles
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.exceptions import InvalidValueError, UnreachablePoseError
from pm3dof_pin.maps.chapter_workspace import tripod_space
from pm3dof_pin.maps.workspace import Workspace, workspace, workspace_section


def _level_height(u: float) -> float:
    """z_e of the level platform, by Pythagoras in the plane of one leg (Table 8.1)."""
    across = 0.37425 - 0.075 - u * np.cos(np.radians(50.0))
    return float(np.sqrt(0.353**2 - across**2) + u * np.sin(np.radians(50.0)) - 0.013)


def test_heights_end_at_the_stops_of_the_sliders(tripod_workspace: Workspace) -> None:
    expected = [_level_height(0.240272 - 0.085), _level_height(0.240272 + 0.085)]
    np.testing.assert_allclose(tripod_workspace.level_range, expected, atol=2e-9)
    np.testing.assert_allclose(tripod_workspace.levels[[0, -1]], tripod_workspace.level_range)


def test_nothing_is_reachable_beyond_the_heights(tripod: Tripod, tripod_workspace: Workspace) -> None:
    generator = np.random.default_rng(8)
    tilts = generator.uniform(-0.88, 0.88, (20_000, 2))
    low, high = tripod_workspace.level_range
    for z_e in (low - 1e-6, low - 1e-3, low - 0.01, high + 1e-6, high + 1e-3, high + 0.01):
        poses = np.column_stack([tilts * generator.uniform(0.0, 1.0, (len(tilts), 1)), np.full(len(tilts), z_e)])
        assert np.all(limit_flags(tripod, poses) != 0)


def test_volume_against_counting(tripod: Tripod, tripod_workspace: Workspace) -> None:
    count, reach = 60, np.radians(46.0)
    line = reach * ((np.arange(count) + 0.5) / count * 2.0 - 1.0)
    low, high = tripod_workspace.level_range
    heights = low + (high - low) * (np.arange(count) + 0.5) / count
    poses = np.stack(np.meshgrid(line, line, heights, indexing="ij"), axis=-1)
    counted = np.mean(limit_flags(tripod, poses) == 0) * (2.0 * reach) ** 2 * (high - low)
    assert tripod_workspace.volume == pytest.approx(counted, rel=2e-3)


def test_volume_converges_with_the_sections(tripod: Tripod, tripod_workspace: Workspace) -> None:
    assert workspace(tripod_space(tripod), 31, 90).volume == pytest.approx(tripod_workspace.volume, rel=1.6e-3)


def _greatest(tripod: Tripod, theta_x: float, theta_y: float, z_e: float) -> tuple[float, float]:
    """Greatest slider travel and greatest swing of a spherical joint."""
    pose = [theta_x, theta_y, z_e]
    return float(inverse_kinematics(tripod, pose).max()), float(passive_joint_angles(tripod, pose)[:, 2].max())


@pytest.mark.parametrize("side", [0, 1])
def test_greatest_theta_x_is_where_stroke_and_cone_meet(tripod: Tripod, tripod_workspace: Workspace, side: int) -> None:
    """On the machine's plane of symmetry, theta_y = 0, both limits bind at the extreme of theta_x."""

    def excess(unknowns: np.ndarray) -> list[float]:
        travel, swing = _greatest(tripod, unknowns[0], 0.0, unknowns[1])
        return [travel - 0.325272, swing - np.radians(45.0)]

    start = [[-0.7, 0.55], [0.78, 0.52]][side]
    theta_x, z_e = fsolve(excess, start, xtol=1e-12)
    assert tripod_workspace.ranges[0, side] == pytest.approx(theta_x, abs=2e-5)
    assert tripod_workspace.range_levels[0, side] == pytest.approx(z_e, abs=2e-6)


def test_greatest_theta_y_lies_on_the_line_where_stroke_and_cone_meet(
    tripod: Tripod, tripod_workspace: Workspace
) -> None:
    def theta_y(theta_x: float) -> float:
        def excess(unknowns: np.ndarray) -> list[float]:
            travel, swing = _greatest(tripod, theta_x, unknowns[0], unknowns[1])
            return [travel - 0.325272, swing - np.radians(45.0)]

        return float(fsolve(excess, [0.705, 0.531], xtol=1e-12)[0])

    greatest = max(theta_y(theta_x) for theta_x in np.linspace(-0.1, 0.15, 101))
    np.testing.assert_allclose(tripod_workspace.ranges[1], [-greatest, greatest], atol=2e-5)


def test_extremes_do_not_depend_on_the_stack(tripod: Tripod, tripod_workspace: Workspace) -> None:
    np.testing.assert_allclose(workspace(tripod_space(tripod), 25, 90).ranges, tripod_workspace.ranges, atol=2e-4)


def test_extremes_are_reached_in_their_sections(tripod: Tripod, tripod_workspace: Workspace) -> None:
    for axis in (0, 1):
        for side in (0, 1):
            section = workspace_section(tripod_space(tripod), tripod_workspace.range_levels[axis, side], 720)
            assert section.ranges[axis, side] == pytest.approx(tripod_workspace.ranges[axis, side], abs=1e-5)


def test_stroke_and_spherical_joints_end_the_set(tripod_workspace: Workspace) -> None:
    shares = tripod_workspace.limit_shares
    assert {limit for limit, share in shares.items() if share > 0.0} == {"stroke", "spherical"}
    assert sum(shares.values()) == pytest.approx(1.0)


def test_a_set_that_is_lowest_when_tilted(hollow_tripod: Tripod) -> None:
    whole = workspace(tripod_space(hollow_tripod), 15, 180)
    low, high = whole.level_range
    assert low < hollow_tripod.height_min - 5e-3
    assert high == pytest.approx(hollow_tripod.height_max, abs=2e-9)
    assert not all(len(section.lines) == 1 for section in whole.sections)
    assert len(whole.sections[7].lines) == 1


def test_given_heights(tripod: Tripod) -> None:
    heights = [0.45, 0.5, 0.51]
    stack = workspace(tripod_space(tripod), heights, 90)
    np.testing.assert_array_equal(stack.levels, heights)
    np.testing.assert_allclose(stack.areas, [workspace_section(stack.space, z_e, 90).area for z_e in heights])
    expected = 0.05 * (stack.areas[0] + stack.areas[1]) / 2 + 0.01 * (stack.areas[1] + stack.areas[2]) / 2
    assert stack.volume == pytest.approx(expected)


@pytest.mark.parametrize("heights", [1, [0.5], [0.5, 0.4], [0.5, 0.5], [0.4, np.nan], [[0.4, 0.5]]])
def test_bad_heights(tripod: Tripod, heights: object) -> None:
    with pytest.raises(InvalidValueError, match="levels"):
        workspace(tripod_space(tripod), heights)  # type: ignore[arg-type]


def test_heights_out_of_reach(tripod: Tripod) -> None:
    with pytest.raises(UnreachablePoseError, match=r"0\.65 m"):
        workspace(tripod_space(tripod), [0.65, 0.7])


def test_a_machine_that_reaches_nothing(tripod: Tripod) -> None:
    stiff = Tripod(dataclasses.replace(tripod.parameters, spherical_limit=0.1, spherical_axis_inclination=-1.0))
    with pytest.raises(UnreachablePoseError, match="empty"):
        workspace(tripod_space(stiff))
