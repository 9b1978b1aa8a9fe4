"""Grids of platform tilts over a section z_e = constant of the workspace."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


@dataclass(frozen=True)
class RectangularGrid:
    """Tilts at equal steps of theta_x and theta_y, ends included.

    The default covers the chapter's printed working range of +-40 deg in steps of 1 deg: 6,561 poses per section.
    """

    theta_x_range: tuple[float, float] = (math.radians(-40.0), math.radians(40.0))  #: first and last theta_x [rad]
    theta_y_range: tuple[float, float] = (math.radians(-40.0), math.radians(40.0))  #: first and last theta_y [rad]
    shape: tuple[int, int] = (81, 81)  #: number of values of theta_x and of theta_y

    def __post_init__(self) -> None:
        """Check the ranges and counts."""
        _check_range("theta_x_range", self.theta_x_range)
        _check_range("theta_y_range", self.theta_y_range)
        _check_counts("shape", self.shape, 2)

    @property
    def axes(self) -> tuple[Array, Array]:
        """Values of theta_x and of theta_y [rad]."""
        return np.linspace(*self.theta_x_range, self.shape[0]), np.linspace(*self.theta_y_range, self.shape[1])

    def poses(self, z_e: float) -> Array:
        """Return the poses at a height [m], shape=(*shape, 3) [rad, rad, m]; InvalidValueError unless it is finite."""
        return _poses(*np.meshgrid(*self.axes, indexing="ij"), z_e)


@dataclass(frozen=True)
class PolarGrid:
    """Tilts on rays from the level platform: theta_x = r cos(phi), theta_y = r sin(phi).

    The default is the grid of Table 8.3: r = 0:1.8:45 deg, phi = 0:2:360 deg, so the last ray coincides with the first
    and the centre counts once per ray. Averages over it overweight the centre.
    """

    radius_max: float = math.radians(45.0)  #: largest r [rad]
    radius_count: int = 26  #: number of values of r, from 0
    azimuth_count: int = 181  #: number of values of phi, from 0 to 2 pi, both included

    def __post_init__(self) -> None:
        """Check radius and counts."""
        _check_range("radius_max", (0.0, self.radius_max))
        _check_counts("radius_count", (self.radius_count,), 2)
        _check_counts("azimuth_count", (self.azimuth_count,), 4)

    def poses(self, z_e: float) -> Array:
        """Return the poses at a height as :meth:`RectangularGrid.poses`, shape=(radius_count, azimuth_count, 3)."""
        radius = np.linspace(0.0, self.radius_max, self.radius_count)[:, None]
        azimuth = np.linspace(0.0, 2.0 * np.pi, self.azimuth_count)
        return _poses(radius * np.cos(azimuth), radius * np.sin(azimuth), z_e)


def _poses(theta_x: Array, theta_y: Array, z_e: float) -> Array:
    if not np.ndim(z_e) == 0 or not math.isfinite(z_e):
        raise InvalidValueError("z_e", z_e, "a finite height in metres")
    return np.stack([theta_x, theta_y, np.full(theta_x.shape, float(z_e))], axis=-1)


def _check_range(name: str, ends: tuple[float, float]) -> None:
    if not (all(map(math.isfinite, ends)) and ends[0] < ends[1]):
        raise InvalidValueError(name, ends, "finite angles in radians, the second greater than the first")


def _check_counts(name: str, counts: tuple[int, ...], least: int) -> None:
    if not all(isinstance(count, int) and count >= least for count in counts):
        raise InvalidValueError(name, counts, f"whole numbers of at least {least}")
