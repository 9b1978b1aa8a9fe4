"""Distances from a point of unknown place: a ballbar's, of one length, and those of draw wires, of any.

The distance of a point from the centre of the sphere it lies on: g(X) = |X|, the placement X, Y, Z. A ballbar's trace
is read by :mod:`pm3dof_pin.measuring.ballbar`.
"""

from __future__ import annotations

import numpy as np

from pm3dof_pin.measuring.datum import DatumKind
from pm3dof_pin.measuring.instrument import Instrument, PlacedDatum, as_points
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.measuring.registration import fitted_spheres
from pm3dof_pin.typing import Array

BALLBAR_LENGTH = 0.15
"""Length of a ballbar [m]."""

_TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0]]) / np.sqrt(3.0)
_LEAST = 1e-9  # [m]


def _distances(points: Array) -> Array:
    return np.asarray(np.linalg.norm(points, axis=1, keepdims=True))


def _directions(points: Array) -> Array:
    return np.asarray((points / np.maximum(_distances(points), _LEAST))[:, None, :])


def _start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    return [(np.eye(3), centre) for centre in fitted_spheres(points, values[:, 0])]


SPHERE = DatumKind(
    "sphere",
    dimension=1,
    moves=(0, 1, 2),
    min_rows=4,
    measured=_distances,
    gradient=_directions,
    start=_start,
    columns=("distance_m",),
    needed=True,
    sigma_column="sigma_distance_m",
    read=lambda cells: (cells, 1.0),
    written=lambda numbers: numbers,
    round=True,
)
"""A sphere, its centre unknown."""


def _ballbar(setting: Setting) -> Instrument:
    length, points = setting.length or BALLBAR_LENGTH, setting.points(setting.targets)
    # a ball on a bar of one length must be able to go round its socket: beside the longest way
    longest = np.linalg.svd(points - setting.middle, full_matrices=False)[2][0]
    return setting.at(setting.one(SPHERE, np.eye(3), setting.middle - length * longest, (length,)))


def _wires(setting: Setting) -> Instrument:
    around = setting.middle + setting.extent(setting.points(setting.targets)) * _TETRAHEDRON
    return setting.at(*(PlacedDatum(SPHERE, centre) for centre in setting.centres or as_points(around)))


BALLBAR = InstrumentKind(
    "ballbar", "the distance of a ball from a socket, at one length", "the socket's centre", 1e-6, _ballbar, SPHERE
)
WIRES = InstrumentKind(
    "wires", "distances from several points, of any length", "each of these points", 50e-6, _wires, SPHERE, centres=99
)
