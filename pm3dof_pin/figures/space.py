"""Lines on bodies drawn in space: matplotlib hides things by depth only within one collection of polygons."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.typing import Array


def towards_viewer(elevation: float, azimuth: float) -> Array:
    """Return the unit vector from the middle of the drawing to the eye.

    Lines that lie in a surface are moved a little along it, so that they are sorted in front of the surface.

    Args:
        elevation: height of the eye over the horizon [deg].
        azimuth: its direction about the vertical [deg].
    """
    up, around = np.radians([elevation, azimuth])
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def flat_quadrilaterals(lines: Array) -> Array:
    """Return the pieces of lines as polygons without area (p, q, q, p), to stand among the polygons of a body.

    Args:
        lines: shape=(n, k, 3).

    Returns:
        shape=(n (k - 1), 4, 3).
    """
    start, end = lines[:, :-1], lines[:, 1:]
    return np.stack([start, end, end, start], axis=2).reshape(-1, 4, 3)
