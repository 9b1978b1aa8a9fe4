"""Grids of platform tilts over a section z_e = constant of the workspace."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


@dataclass(frozen=True, eq=False)
class _TiltAxis:
    """One labelled coordinate of a grid with the dimensions it varies along."""

    dims: tuple[str, ...]
    values: Array
    unit: str
    long_name: str


class TiltGrid(ABC):
    """What a map needs of a grid: named dimensions, coordinates and the tilts at its points."""

    @property
    @abstractmethod
    def dims(self) -> tuple[str, ...]:
        """Names of the grid's dimensions."""

    @abstractmethod
    def _tilts(self) -> Array:
        """Return theta_x and theta_y at its points, shape=(*shape of the grid, 2) [rad]."""

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return the coordinates by name; theta_x and theta_y are among them."""
        tilts = self._tilts()
        return {
            f"theta_{axis}": _TiltAxis(self.dims, tilts[..., k], "rad", f"rotation of the platform about {axis}")
            for k, axis in enumerate("xy")
        }

    def poses(self, z_e: ArrayLike) -> Array:
        """Return the poses at one finite height or several, shape=(*shape of z_e, *shape of the grid, 3)."""
        heights, tilts = np.asarray(z_e, dtype=float), self._tilts()
        if not np.all(np.isfinite(heights)):
            raise InvalidValueError("z_e", z_e, "a finite height in metres")
        poses = np.empty((*heights.shape, *tilts.shape[:-1], 3))
        poses[..., :2] = tilts
        poses[..., 2] = heights.reshape(heights.shape + (1,) * (tilts.ndim - 1))
        return poses


@dataclass(frozen=True)
class RectangularGrid(TiltGrid):
    """Tilts at equal steps of theta_x and theta_y, ends included.

    The default covers the chapter's printed working range of +-40 deg in steps of 1 deg: 6,561 poses a section.
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
    def dims(self) -> tuple[str, ...]:
        """("theta_x", "theta_y")."""
        return ("theta_x", "theta_y")

    def _tilts(self) -> Array:
        """Return theta_x and theta_y at its points, shape=(*shape, 2) [rad]."""
        return np.stack(np.meshgrid(*(axis.values for axis in self.coordinates().values()), indexing="ij"), axis=-1)

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return theta_x and theta_y, each along its own dimension [rad]."""
        ends = {"x": (*self.theta_x_range, self.shape[0]), "y": (*self.theta_y_range, self.shape[1])}
        axes = {
            f"theta_{axis}": (np.linspace(*of), f"rotation of the platform about {axis}") for axis, of in ends.items()
        }
        return {name: _TiltAxis((name,), values, "rad", words) for name, (values, words) in axes.items()}

    def edge_radius(self, azimuths: Array) -> Array:
        """Return how far the grid reaches from the level platform in directions from theta_x [rad]; or less than 0."""
        radius = np.full(azimuths.shape, np.inf)
        for (low, high), component in ((self.theta_x_range, np.cos(azimuths)), (self.theta_y_range, np.sin(azimuths))):
            with np.errstate(divide="ignore"):
                ahead = np.where(component > 0.0, high, -low) / np.abs(component)
            radius = np.minimum(radius, ahead if low < 0.0 < high else -np.inf)
        return radius


@dataclass(frozen=True)
class PolarGrid(TiltGrid):
    """Tilts on rays from the level platform: theta_x = r cos(phi), theta_y = r sin(phi).

    The default is the grid of Table 8.3: r = 0:1.8:45 deg, phi = 0:2:360 deg, so that the last ray lies on the first
    and the centre counts once a ray. Averages over it weigh the centre.
    """

    radius_max: float = math.radians(45.0)  #: largest r [rad]
    radius_count: int = 26  #: number of values of r, from 0
    azimuth_count: int = 181  #: number of values of phi, from 0 to 2 pi, both included

    def __post_init__(self) -> None:
        """Check radius and counts."""
        _check_range("radius_max", (0.0, self.radius_max))
        _check_counts("radius_count", (self.radius_count,), 2)
        _check_counts("azimuth_count", (self.azimuth_count,), 4)

    @property
    def dims(self) -> tuple[str, ...]:
        """("radius", "azimuth")."""
        return ("radius", "azimuth")

    def _tilts(self) -> Array:
        """Return theta_x and theta_y at its points, shape=(radius_count, azimuth_count, 2) [rad]."""
        radius, azimuth = (axis.values for axis in self._polar().values())
        return np.asarray(radius[:, None, None] * np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1))

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return radius, azimuth and, along both, theta_x and theta_y [rad]."""
        return self._polar() | super().coordinates()

    def _polar(self) -> dict[str, _TiltAxis]:
        radius = np.linspace(0.0, self.radius_max, self.radius_count)
        azimuth = np.linspace(0.0, 2.0 * np.pi, self.azimuth_count)
        return {
            "radius": _TiltAxis(("radius",), radius, "rad", "distance from the level platform in the plane of tilts"),
            "azimuth": _TiltAxis(("azimuth",), azimuth, "rad", "direction of the tilt from the theta_x axis"),
        }

    def edge_radius(self, azimuths: Array) -> Array:
        """Return how far the grid reaches from the level platform: the largest radius, in every direction [rad]."""
        return np.full(azimuths.shape, self.radius_max)


@dataclass(frozen=True, eq=False)
class PointGrid(TiltGrid):
    """Any tilts (theta_x, theta_y), shape=(n, 2) [rad]: the boundary of a section, measured poses, and the like."""

    tilts: Array

    def __post_init__(self) -> None:
        """Check the tilts."""
        tilts = np.asarray(self.tilts)
        if tilts.ndim != 2 or tilts.shape[1] != 2 or not np.all(np.isfinite(tilts)):
            raise InvalidValueError("tilts", f"an array of shape {tilts.shape}", "finite angles of shape (n, 2)")

    @property
    def dims(self) -> tuple[str, ...]:
        """("point",)."""
        return ("point",)

    def _tilts(self) -> Array:
        return self.tilts


def _check_range(name: str, ends: tuple[float, float]) -> None:
    if not (all(map(math.isfinite, ends)) and ends[0] < ends[1]):
        raise InvalidValueError(name, ends, "finite angles in radians, the second greater than the first")


def _check_counts(name: str, counts: tuple[int, ...], least: int) -> None:
    if not all(isinstance(count, int) and count >= least for count in counts):
        raise InvalidValueError(name, counts, f"whole numbers of at least {least}")
