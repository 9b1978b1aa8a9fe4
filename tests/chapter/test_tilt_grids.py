"""Grids of tilts: the chapter's counts, coordinates, edges, and arguments that make no grid."""

from __future__ import annotations

import math

import numpy as np
import pytest

from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.limits import limit_flags
from pm3dof_pin.chapter.tilt_grids import PointGrid, PolarGrid, RectangularGrid, TiltGrid
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
    "grid", [RectangularGrid(shape=(5, 4)), PolarGrid(0.5, 3, 9), PointGrid(np.array([[0.1, 0.2], [0.3, 0.4]]))]
)
@pytest.mark.parametrize("z_e", [0.45, [0.45, 0.5, 0.55]])
def test_poses_stand_at_their_coordinates(grid: TiltGrid, z_e: float | list[float]) -> None:
    poses = grid.poses(z_e)
    coordinates = grid.coordinates()
    sizes = dict(zip(grid.dims, poses.shape[np.ndim(z_e) : -1], strict=True))
    for name, place in (("theta_x", 0), ("theta_y", 1)):
        coordinate = coordinates[name]
        assert coordinate.unit == "rad"
        shape = [sizes[dim] if dim in coordinate.dims else 1 for dim in grid.dims]
        np.testing.assert_array_equal(
            poses[..., place], np.broadcast_to(coordinate.values.reshape(shape), poses.shape[:-1])
        )
    np.testing.assert_array_equal(np.moveaxis(poses[..., 2], 0, -1)[..., -1], np.atleast_1d(z_e)[-1])


def test_edges() -> None:
    azimuths = np.linspace(0.0, 2.0 * np.pi, 97)
    grid = RectangularGrid((-0.3, 0.5), (-0.2, 0.4))
    radius = grid.edge_radius(azimuths)
    x, y = radius * np.cos(azimuths), radius * np.sin(azimuths)
    assert np.all((x > -0.3 - 1e-12) & (x < 0.5 + 1e-12) & (y > -0.2 - 1e-12) & (y < 0.4 + 1e-12))
    on_a_side = np.minimum.reduce([np.abs(x + 0.3), np.abs(x - 0.5), np.abs(y + 0.2), np.abs(y - 0.4)])
    np.testing.assert_allclose(on_a_side, 0.0, atol=1e-12)
    np.testing.assert_array_equal(PolarGrid().edge_radius(azimuths), math.radians(45.0))
    assert np.all(RectangularGrid((0.1, 0.5), (-0.2, 0.4)).edge_radius(azimuths) < 0.0)


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


@pytest.mark.parametrize("tilts", [np.zeros(2), np.zeros((3, 3)), np.array([[0.0, np.nan]])])
def test_no_points(tilts: np.ndarray) -> None:
    with pytest.raises(InvalidValueError, match="tilts"):
        PointGrid(tilts)


def test_no_height() -> None:
    with pytest.raises(InvalidValueError, match="z_e"):
        RectangularGrid().poses([0.5, math.inf])
