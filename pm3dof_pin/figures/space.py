"""Lines on bodies drawn in 3D: matplotlib sorts by depth only within one collection of polygons."""

from __future__ import annotations

import math

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


def divided_triangles(triangles: Array, least: int) -> Array:
    """Divide flat triangles, shape=(n, 3, k), equally until there are at least `least`, shape=(n m^2, 3, k)."""
    parts = max(1, math.ceil(math.sqrt(least / max(1, len(triangles)))))
    corners = [
        corner
        for i in range(parts)
        for j in range(parts - i)
        for corner in (
            [((i, j), (i + 1, j), (i, j + 1))]
            + ([((i + 1, j), (i + 1, j + 1), (i, j + 1))] if i + j < parts - 1 else [])
        )
    ]
    along = np.array(corners) / parts
    weights = np.concatenate([1.0 - along.sum(axis=-1, keepdims=True), along], axis=-1)
    return np.asarray(np.einsum("pcw,nwk->npck", weights, triangles).reshape(-1, 3, triangles.shape[2]))
