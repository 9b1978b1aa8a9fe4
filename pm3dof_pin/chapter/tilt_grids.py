"""Grids of platform tilts over a section z_e = constant of the workspace."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

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


class TiltGrid(Protocol):
    """What a map needs of a grid: named dimensions, coordinates and the tilts at its points."""

    @property
    def dims(self) -> tuple[str, ...]:
        """Names of the grid's dimensions."""

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return the coordinates by name; theta_x and theta_y are among them."""

    def poses(self, z_e: ArrayLike) -> Array:
        """Return the poses of the grid at one height or several, shape=(*shape of z_e, *shape of the grid, 3)."""


class FilledTiltGrid(TiltGrid, Protocol):
    """A grid that fills a piece of the plane of tilts."""

    def edge_radius(self, azimuths: Array) -> Array:
        """Return how far the grid reaches from the level platform in given directions, negative if it is outside."""


@dataclass(frozen=True)
class RectangularGrid:
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

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return theta_x and theta_y, each along its own dimension [rad]."""
        theta_x = np.linspace(*self.theta_x_range, self.shape[0])
        theta_y = np.linspace(*self.theta_y_range, self.shape[1])
        return {
            "theta_x": _TiltAxis(("theta_x",), theta_x, "rad", "rotation of the platform about x"),
            "theta_y": _TiltAxis(("theta_y",), theta_y, "rad", "rotation of the platform about y"),
        }

    def poses(self, z_e: ArrayLike) -> Array:
        """Return the poses at heights z_e [m], shape=(*shape of z_e, *shape, 3) [rad, rad, m]; these must be finite."""
        coordinates = self.coordinates()
        tilts = np.meshgrid(coordinates["theta_x"].values, coordinates["theta_y"].values, indexing="ij")
        return _poses(np.stack(tilts, axis=-1), z_e)

    def edge_radius(self, azimuths: Array) -> Array:
        """Return how far the grid reaches from the level platform, negative if it does not contain it.

        Args:
            azimuths: directions from the theta_x axis, shape=(n,) [rad].

        Returns:
            shape=(n,) [rad].
        """
        radius = np.full(azimuths.shape, np.inf)
        for (low, high), component in ((self.theta_x_range, np.cos(azimuths)), (self.theta_y_range, np.sin(azimuths))):
            with np.errstate(divide="ignore"):
                ahead = np.where(component > 0.0, high, -low) / np.abs(component)
            radius = np.minimum(radius, ahead if low < 0.0 < high else -np.inf)
        return radius


@dataclass(frozen=True)
class PolarGrid:
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

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return radius, azimuth and, along both, theta_x and theta_y [rad]."""
        radius = np.linspace(0.0, self.radius_max, self.radius_count)
        azimuth = np.linspace(0.0, 2.0 * np.pi, self.azimuth_count)
        theta_x, theta_y = np.outer(radius, np.cos(azimuth)), np.outer(radius, np.sin(azimuth))
        return {
            "radius": _TiltAxis(("radius",), radius, "rad", "distance from the level platform in the plane of tilts"),
            "azimuth": _TiltAxis(("azimuth",), azimuth, "rad", "direction of the tilt from the theta_x axis"),
            "theta_x": _TiltAxis(self.dims, theta_x, "rad", "rotation of the platform about x"),
            "theta_y": _TiltAxis(self.dims, theta_y, "rad", "rotation of the platform about y"),
        }

    def poses(self, z_e: ArrayLike) -> Array:
        """Return the poses as :meth:`RectangularGrid.poses`, shape=(*shape of z_e, radius_count, azimuth_count, 3)."""
        coordinates = self.coordinates()
        return _poses(np.stack([coordinates["theta_x"].values, coordinates["theta_y"].values], axis=-1), z_e)

    def edge_radius(self, azimuths: Array) -> Array:
        """Return how far the grid reaches from the level platform: the largest radius, in every direction [rad]."""
        return np.full(azimuths.shape, self.radius_max)


@dataclass(frozen=True, eq=False)
class PointGrid:
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

    def coordinates(self) -> dict[str, _TiltAxis]:
        """Return theta_x and theta_y along the points [rad]."""
        return {
            "theta_x": _TiltAxis(self.dims, self.tilts[:, 0], "rad", "rotation of the platform about x"),
            "theta_y": _TiltAxis(self.dims, self.tilts[:, 1], "rad", "rotation of the platform about y"),
        }

    def poses(self, z_e: ArrayLike) -> Array:
        """Return the poses as :meth:`RectangularGrid.poses`, shape=(*shape of z_e, n, 3)."""
        return _poses(self.tilts, z_e)


def _poses(tilts: Array, z_e: ArrayLike) -> Array:
    heights = np.asarray(z_e, dtype=float)
    if not np.all(np.isfinite(heights)):
        raise InvalidValueError("z_e", z_e, "a finite height in metres")
    poses = np.empty((*heights.shape, *tilts.shape[:-1], 3))
    poses[..., :2] = tilts
    poses[..., 2] = heights.reshape(heights.shape + (1,) * (tilts.ndim - 1))
    return poses


def _check_range(name: str, ends: tuple[float, float]) -> None:
    if not (all(map(math.isfinite, ends)) and ends[0] < ends[1]):
        raise InvalidValueError(name, ends, "finite angles in radians, the second greater than the first")


def _check_counts(name: str, counts: tuple[int, ...], least: int) -> None:
    if not all(isinstance(count, int) and count >= least for count in counts):
        raise InvalidValueError(name, counts, f"whole numbers of at least {least}")
