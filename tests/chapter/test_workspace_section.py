"""Sections of the workspace against joint values at their boundary and against counts on dense grids."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from scipy import ndimage

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, passive_joint_angles
from pm3dof_pin.chapter.limits import Limit, limit_flags
from pm3dof_pin.chapter.workspace import tripod_space
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.maps.workspace_section import WorkspaceSection, workspace_section

HEIGHTS = (0.4, 0.4305, 0.487333, 0.53, 0.5535, 0.57)


@cache
def _section(tripod: Tripod, z_e: float, directions: int) -> WorkspaceSection:
    return workspace_section(tripod_space(tripod), z_e, directions)


def _poses(section: WorkspaceSection, farther: float = 0.0) -> np.ndarray:
    """Boundary poses, moved across the boundary by a length in radians."""
    radii = section.radii + np.where(section.leaving, farther, -farther)
    azimuths = section.azimuths[section.rays]
    heights = np.full(len(radii), section.level)
    return np.stack([radii * np.cos(azimuths), radii * np.sin(azimuths), heights], axis=-1)


@cache
def _dense(tripod: Tripod, z_e: float, reach: float, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Tilts on a square grid and whether they are reachable."""
    line = step * (np.arange(-round(reach / step), round(reach / step)) + 0.5)
    tilts = np.stack(np.meshgrid(line, line, indexing="ij"), axis=-1)
    poses = np.concatenate([tilts, np.full((*tilts.shape[:2], 1), z_e)], axis=-1)
    return tilts, limit_flags(tripod, poses) == 0


def _perimeter(section: WorkspaceSection) -> float:
    closed = np.concatenate([section.points, section.points[:1]])
    return float(np.linalg.norm(np.diff(closed, axis=0), axis=1).sum())


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_limits_change_at_the_boundary(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 120)
    assert np.all(limit_flags(tripod, _poses(section)) == 0)
    across = limit_flags(tripod, _poses(section, 1.01e-10))
    assert np.all(across != 0)
    np.testing.assert_array_equal(across & section.limits, section.limits)


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_the_joint_that_binds_is_at_its_limit(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 120)
    u = inverse_kinematics(tripod, _poses(section))
    swing = passive_joint_angles(tripod, _poses(section))[..., 2]
    at_stop = np.abs(np.abs(u - 0.240272).max(axis=1) - 0.085) < 1e-10
    at_cone = np.abs(swing.max(axis=1) - np.radians(45.0)) < 1e-9
    np.testing.assert_array_equal((section.limits & Limit.STROKE) != 0, at_stop)
    np.testing.assert_array_equal((section.limits & Limit.SPHERICAL) != 0, at_cone)
    for pose, flags in zip(_poses(section, 1e-7)[::10], section.limits[::10], strict=True):
        assert int(limit_flags(tripod, pose)) & int(flags) == int(flags)


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_sections_of_the_machine_are_star_shaped(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 720)
    assert section.star_shaped
    tilts, reachable = _dense(tripod, z_e, np.radians(51.0), np.radians(0.5))
    assert ndimage.label(reachable, np.ones((3, 3)))[1] == 1
    assert np.array_equal(ndimage.binary_fill_holes(reachable), reachable)
    # every pose of the grid is on the correct side of the outline by its radius
    azimuth = np.arctan2(tilts[..., 1], tilts[..., 0])
    edge = np.interp(azimuth, section.azimuths, section.radii, period=2.0 * np.pi)
    radius = np.linalg.norm(tilts, axis=-1)
    clear = np.abs(radius - edge) > 2e-3
    np.testing.assert_array_equal(reachable[clear], (radius < edge)[clear])


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
        for directions in (360, 1440, 2880)
    ]
    assert abs(areas[0] - areas[2]) < 1e-4 * areas[2]
    assert abs(areas[1] - areas[2]) < 1e-5 * areas[2]


@pytest.mark.parametrize("z_e", HEIGHTS)
def test_mirror_symmetry(tripod: Tripod, z_e: float) -> None:
    section = _section(tripod, z_e, 720)
    mirrored = np.roll(section.radii[::-1], 1)
    np.testing.assert_allclose(section.radii, mirrored, atol=2.5e-10)
    np.testing.assert_allclose(section.ranges[1], -section.ranges[1, ::-1], atol=1e-5)


def test_extremes_are_found_between_the_rays(tripod: Tripod) -> None:
    coarse, fine = (
        workspace_section(tripod_space(tripod), 0.55, 90),
        workspace_section(tripod_space(tripod), 0.55, 5_760),
    )
    on_rays = np.stack([fine.points.min(axis=0), fine.points.max(axis=0)], axis=-1)
    np.testing.assert_allclose(coarse.ranges, on_rays, atol=5e-4)
    assert np.all(coarse.ranges[:, 0] <= on_rays[:, 0] + 1e-6)
    assert np.all(coarse.ranges[:, 1] >= on_rays[:, 1] - 1e-6)


def test_shares_count_the_directions(tripod: Tripod) -> None:
    section = workspace_section(tripod_space(tripod), 0.53)
    shares = section.limit_shares
    assert sum(shares.values()) == pytest.approx(1.0)
    assert shares["stroke"] == pytest.approx(np.mean(section.limits == Limit.STROKE), abs=1e-12)
    assert shares["reach"] == shares["universal"] == shares["tilt"] == shares["height"] == 0.0


@pytest.mark.parametrize(
    ("z_e", "level", "parts", "holes"),
    [(0.6176, False, 2, 0), (0.62, False, 1, 1), (0.6246, True, 1, 3), (0.6356, True, 1, 0)],
)
def test_sections_with_parts_and_holes(hollow_tripod: Tripod, z_e: float, level: bool, parts: int, holes: int) -> None:
    section, step = _section(hollow_tripod, z_e, 720), np.radians(0.5)
    tilts, reachable = _dense(hollow_tripod, z_e, np.radians(77.0), step)
    assert ndimage.label(reachable, np.ones((3, 3)))[1] == parts
    assert ndimage.label(ndimage.binary_fill_holes(reachable) & ~reachable)[1] == holes
    assert section.leaving[0] == level
    assert section.star_shaped == (parts == 1 and holes == 0)
    assert section.area == pytest.approx(reachable.sum() * step**2, rel=2e-3)
    ranges = np.stack([tilts[reachable].min(axis=0), tilts[reachable].max(axis=0)], axis=-1)
    np.testing.assert_allclose(section.ranges, ranges, atol=4 * step)
    assert np.all(limit_flags(hollow_tripod, _poses(section)) == 0)
    assert np.all(limit_flags(hollow_tripod, _poses(section, 1.01e-10)) != 0)


def test_empty_section(tripod: Tripod) -> None:
    section = workspace_section(tripod_space(tripod), 0.7)
    assert section.empty
    assert not section.star_shaped
    assert section.area == 0.0
    assert np.all(np.isnan(section.ranges))
    assert set(section.limit_shares.values()) == {0.0}


@pytest.mark.parametrize(("z_e", "directions"), [(np.nan, 360), (np.inf, 360), (0.5, 7)])
def test_bad_arguments(tripod: Tripod, z_e: float, directions: int) -> None:
    with pytest.raises(InvalidValueError):
        workspace_section(tripod_space(tripod), z_e, directions)
