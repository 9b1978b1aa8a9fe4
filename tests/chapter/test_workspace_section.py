"""Sections of the workspace against joint values at their boundary and against counts on dense grids."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from matplotlib.path import Path
from scipy import ndimage
from scipy.spatial import cKDTree

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, passive_joint_angles
from pm3dof_pin.chapter.limits import Limit, limit_flags
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.chapter_workspace import tripod_space
from pm3dof_pin.maps.workspace import WorkspaceSection, workspace_section

HEIGHTS = (0.4, 0.4305, 0.487333, 0.53, 0.5535, 0.57)


@cache
def _section(tripod: Tripod, z_e: float, directions: int) -> WorkspaceSection:
    return workspace_section(tripod_space(tripod), z_e, directions)


def _poses(section: WorkspaceSection, farther: float = 0.0) -> np.ndarray:
    """Boundary poses, moved across the boundary by a length in radians."""
    moved = []
    for line in section.lines:
        along = np.roll(line, -1, axis=0) - np.roll(line, 1, axis=0)
        across = np.stack([along[:, 1], -along[:, 0]], axis=-1)
        moved.append(line + farther * across / np.linalg.norm(across, axis=1, keepdims=True))
    return np.column_stack([np.concatenate(moved), np.full(len(section.points), section.level)])


@cache
def _dense(tripod: Tripod, z_e: float, reach: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Tilts on a square grid and whether they are reachable."""
    line = step * (np.arange(-round(reach / step), round(reach / step)) + 0.5)
    tilts = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
    poses = np.concatenate([tilts, np.full((*tilts.shape[:2], 1), z_e)], axis=-1)
    return tilts, limit_flags(tripod, poses) == 0


def _perimeter(section: WorkspaceSection) -> float:
    return float(sum(np.linalg.norm(np.roll(line, -1, axis=0) - line, axis=1).sum() for line in section.lines))


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_limits_change_at_the_boundary(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 120)
    assert np.all(limit_flags(tripod, _poses(section)) == 0)
    across = limit_flags(tripod, _poses(section, 2e-4))
    assert np.mean(across != 0) > 0.95  # but for slender corners
    limits = np.concatenate(section.limits)
    assert np.mean((across & limits) == limits) > 0.95


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_the_joint_that_binds_is_at_its_limit(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 120)
    u = inverse_kinematics(tripod, _poses(section))
    swing, limits = passive_joint_angles(tripod, _poses(section))[..., 2].max(axis=1), np.concatenate(section.limits)
    to_stop, to_cone = 0.085 - np.abs(u - 0.240272).max(axis=1), np.radians(45.0) - swing
    of_stroke, of_cone = (limits & Limit.STROKE) != 0, (limits & Limit.SPHERICAL) != 0
    assert np.all(of_stroke | of_cone)
    assert np.all(to_stop[of_stroke] < 1e-5)
    assert np.all(to_cone[of_cone] < 1e-4)


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_sections_of_the_machine_are_one_closed_line(tripod: Tripod, z_e: float) -> None:
    (line,) = _section(tripod, z_e, 720).lines
    tilts, reachable = _dense(tripod, z_e, np.radians(51.0), np.radians(0.5))
    inside = Path(line).contains_points(tilts.reshape(-1, 2)).reshape(reachable.shape)
    near = cKDTree(line).query(tilts.reshape(-1, 2))[0].reshape(reachable.shape) < np.radians(0.3)
    np.testing.assert_array_equal(inside[~near], reachable[~near])


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_area_and_ranges_against_counting(tripod: Tripod, z_e: float) -> None:
    section, step = _section(tripod, z_e, 720), np.radians(0.5)
    tilts, reachable = _dense(tripod, z_e, np.radians(51.0), step)
    # a cell is counted wrongly by less than its half, and the boundary runs through fewer than 2 * perimeter / step
    assert abs(section.area - reachable.sum() * step**2) < _perimeter(section) * step
    lowest, highest = tilts[reachable].min(axis=0), tilts[reachable].max(axis=0)
    least, greatest = section.ranges.T
    assert np.all(least <= lowest)
    assert np.all(greatest >= highest)
    # a corner of the outline may be sharper than the cells
    np.testing.assert_allclose(least, lowest, atol=4 * step)
    np.testing.assert_allclose(greatest, highest, atol=4 * step)


def test_area_converges_with_the_directions(tripod: Tripod) -> None:
    areas = [
        workspace_section(tripod_space(tripod), tripod.middle_height, directions).area
        for directions in (180, 720, 2880)
    ]
    assert abs(areas[0] - areas[2]) < 1e-4 * areas[2]
    assert abs(areas[1] - areas[2]) < 1e-5 * areas[2]


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_mirror_symmetry(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 720)
    mirrored = section.points * [1.0, -1.0]
    assert cKDTree(section.points).query(mirrored)[0].max() < 2e-5
    np.testing.assert_allclose(section.ranges[1], -section.ranges[1, ::-1], atol=1e-5)


def test_extremes_are_found_between_the_points(tripod: Tripod) -> None:
    coarse, fine = (
        workspace_section(tripod_space(tripod), 0.55, 90),
        workspace_section(tripod_space(tripod), 0.55, 2_880),
    )
    on_line = np.stack([fine.points.min(axis=0), fine.points.max(axis=0)], axis=-1)
    np.testing.assert_allclose(coarse.ranges, on_line, atol=1e-3)
    assert np.all(coarse.ranges[:, 0] <= on_line[:, 0] + 2e-6)
    assert np.all(coarse.ranges[:, 1] >= on_line[:, 1] - 2e-6)


def test_shares_of_the_limits(tripod: Tripod) -> None:
    section = workspace_section(tripod_space(tripod), 0.53)
    shares = section.limit_shares
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["stroke"] == pytest.approx(0.444, abs=2e-3)  # 0.447 of the directions from the level platform
    assert shares["reach"] == shares["universal"] == shares["tilt"] == shares["height"] == 0.0


@pytest.mark.parametrize(("z_e", "parts", "holes"), [(0.6176, 2, 0), (0.62, 1, 1), (0.6246, 1, 3), (0.6356, 1, 0)])
def test_sections_with_parts_and_holes(hollow_tripod: Tripod, z_e: float, parts: int, holes: int) -> None:
    section, step = _section(hollow_tripod, z_e, 1440), np.radians(0.5)
    tilts, reachable = _dense(hollow_tripod, z_e, np.radians(77.0), step)
    assert ndimage.label(reachable, np.ones((3, 3)))[1] == parts
    assert ndimage.label(ndimage.binary_fill_holes(reachable) & ~reachable)[1] == holes
    assert sum(len(line) > 8 for line in section.lines) == parts + holes  # others are single points of the grid
    assert section.area == pytest.approx(reachable.sum() * step**2, rel=2e-3)
    ranges = np.stack([tilts[reachable].min(axis=0), tilts[reachable].max(axis=0)], axis=-1)
    np.testing.assert_allclose(section.ranges, ranges, atol=4 * step)
    assert np.all(limit_flags(hollow_tripod, _poses(section)) == 0)


def test_empty_section(tripod: Tripod) -> None:
    section = workspace_section(tripod_space(tripod), 0.7)
    assert section.empty
    assert section.area == 0.0
    assert np.all(np.isnan(section.ranges))
    assert set(section.limit_shares.values()) == {0.0}


@pytest.mark.parametrize(("z_e", "directions"), [(np.nan, 360), (np.inf, 360), (0.5, 7)])
def test_bad_arguments(tripod: Tripod, z_e: float, directions: int) -> None:
    with pytest.raises(InvalidValueError):
        workspace_section(tripod_space(tripod), z_e, directions)
