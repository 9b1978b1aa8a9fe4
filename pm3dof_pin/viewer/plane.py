"""The plane of a planar machine: where the camera looks along its normal, and ellipsoids are ellipses in it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Array, Motion, Vector
from pm3dof_pin.viewer.objects import turn_z_to

_PLANAR = 1e-9  # largest component of a unit motion out of the plane
_FROM_ABOVE = 0.7  # vertical component of a normal from which the camera looks down
_TILT = 18.0  # of the camera to the normal, so that depth can be seen [deg]

SPATIAL = (-62.0, 17.0)
"""Azimuth and elevation of the camera for a machine that moves in space [deg]."""


@dataclass(frozen=True)
class MotionSpace:
    """The motions [v; omega] that a machine's tool can have: all six, or three of a plane.

    `basis` has them as columns, shape=(6, 6) or (6, 3), orthonormal; the first `translations` are translations.
    """

    basis: Array
    translations: int
    normal: Vector | None = None

    @classmethod
    def from_configuration(cls, configuration: Configuration) -> MotionSpace:
        """Return the space that all joints of a machine move in: spatial unless they share a plane."""
        normal = _normal(configuration)
        if normal is None:
            return cls(np.eye(6), 3)
        basis = np.zeros((6, 3))
        basis[:3, :2] = turn_z_to(normal)[:, :2]
        basis[3:, 2] = normal
        return cls(basis, 2, normal)

    def count(self, kind: Motion) -> int:
        """Return the number of translations or of rotations."""
        return self.translations if kind == "translation" else self.basis.shape[1] - self.translations

    @property
    def camera(self) -> tuple[float, float]:
        """Azimuth and elevation of the camera [deg]: nearly along the normal of a plane."""
        if self.normal is None:
            return SPATIAL
        x, y, z = self.normal
        elevation = math.degrees(math.asin(max(-1.0, min(1.0, z))))
        if elevation > math.degrees(math.asin(_FROM_ABOVE)):
            return -90.0, 90.0 - _TILT
        return math.degrees(math.atan2(y, x)) + _TILT, elevation + 0.5 * _TILT


def _normal(configuration: Configuration) -> Vector | None:
    """Return the unit normal, towards the usual camera, of the plane in which all joints move; None without one."""
    model = configuration.mechanism.model
    data = model.createData()
    columns = np.array(pin.computeJointJacobians(model, data, np.array(configuration.q))).reshape(6, -1)
    turns = columns[3:, np.linalg.norm(columns[3:], axis=0) > _PLANAR]
    if turns.size:
        normal = turns[:, 0]
    elif columns.shape[1] > 1:
        normal = np.linalg.svd(columns[:3])[0][:, 2]
    else:
        return None
    azimuth, elevation = np.radians(SPATIAL)
    camera = [math.cos(azimuth) * math.cos(elevation), math.sin(azimuth) * math.cos(elevation), math.sin(elevation)]
    normal = normal / np.linalg.norm(normal) * (1.0 if normal @ camera > 0.0 else -1.0)
    sizes = np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    leaving = np.abs(normal @ columns[:3]) + np.linalg.norm(np.cross(columns[3:].T, normal), axis=1)
    return np.asarray(normal) if np.all(leaving <= _PLANAR * np.maximum(sizes, 1.0)) else None
