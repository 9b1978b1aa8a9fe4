"""Lines on bodies drawn in 3D: matplotlib sorts by depth only within one collection of polygons."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.typing import Array


def towards_viewer(elevation: float, azimuth: float) -> Array:
    """Return the unit vector towards the viewer at an elevation and azimuth [deg].

    Lines in a surface are shifted slightly along it, so that they are sorted in front of the surface.
    """
    up, around = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def flat_quadrilaterals(lines: Array) -> Array:
    """Return the segments of lines, shape=(n, k, 3), as flat polygons (p, q, q, p), to be sorted with a body's."""
    start, end = lines[:, :-1], lines[:, 1:]
    return np.stack([start, end, end, start], axis=2).reshape(-1, 4, 3)
