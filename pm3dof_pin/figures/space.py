"""Lines on bodies drawn in space: matplotlib hides things by depth only within one collection of polygons."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.typing import Array


def towards_viewer(elevation: float, azimuth: float) -> Array:
    """Return the unit vector to the eye of an elevation and azimuth [deg].

    Lines that lie in a surface are moved a little along it, so that they are sorted in front of the surface.
    """
    up, around = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def flat_quadrilaterals(lines: Array) -> Array:
    """Return the pieces of lines, shape=(n, k, 3), as flat polygons (p, q, q, p), to be sorted among a body's."""
    start, end = lines[:, :-1], lines[:, 1:]
    return np.stack([start, end, end, start], axis=2).reshape(-1, 4, 3)
