"""Grids of tilts: the chapter's counts, coordinates, edges, and invalid arguments."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.tilt_grids import PolarGrid, RectangularGrid
from pm3dof_pin.exceptions import InvalidValueError


def test_the_chapters_grid(tripod: Tripod) -> None:
    poses = PolarGrid().poses(tripod.middle_height)
    assert poses.shape == (26, 181, 3)
    assert poses[..., 0].size == 4706
    assert np.count_nonzero(limit_flags(tripod, poses) == 0) == 3870
    radius, azimuth = np.radians(1.8 * np.arange(26)), np.radians(2.0 * np.arange(181))
    np.testing.assert_allclose(poses[..., 0], np.outer(radius, np.cos(azimuth)), atol=1e-15)
    np.testing.assert_allclose(poses[..., 1], np.outer(radius, np.sin(azimuth)), atol=1e-15)
    assert np.all(poses[..., 2] == tripod.middle_height)
    np.testing.assert_allclose(poses[:, 0], poses[:, -1], atol=1e-15)


def test_the_default_grid() -> None:
    grid = RectangularGrid()
    poses = grid.poses(0.5)
    assert poses.shape == (81, 81, 3)
    np.testing.assert_allclose(np.degrees(poses[:, 7, 0]), np.arange(-40.0, 41.0), atol=1e-12)
    np.testing.assert_allclose(np.degrees(poses[7, :, 1]), np.arange(-40.0, 41.0), atol=1e-12)


@pytest.mark.parametrize(
    "arguments",
    [
        {"theta_x_range": (0.5, -0.5)},
        {"theta_y_range": (0.5, 0.5)},
        {"theta_x_range": (-0.5, math.nan)},
        {"theta_y_range": (-math.inf, 0.5)},
        {"shape": (1, 5)},
        {"shape": (5, 2.5)},
    ],
)
def test_no_rectangular_grid(arguments: dict[str, object]) -> None:
    with pytest.raises(InvalidValueError, match=next(iter(arguments))):
        RectangularGrid(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "arguments", [{"radius_max": 0.0}, {"radius_max": math.nan}, {"radius_count": 1}, {"azimuth_count": 3}]
)
def test_no_polar_grid(arguments: dict[str, object]) -> None:
    with pytest.raises(InvalidValueError):
        PolarGrid(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("z_e", [math.inf, [0.5, 0.6]])
def test_no_height(z_e: float) -> None:
    with pytest.raises(InvalidValueError, match="z_e"):
        RectangularGrid().poses(z_e)
