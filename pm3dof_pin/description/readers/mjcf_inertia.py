"""Masses and inertias of the geoms of an MJCF model, as MuJoCo computes them where a body has no `<inertial>`."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from pm3dof_pin.typing import Array, Matrix, Vector

_STEP = 1e-30  # of derivatives by complex numbers, which have no rounding error

_THOMSEN = 1.6075

Solid = Callable[[Any], tuple[Any, Any]]


def _solid_box(s: Any) -> tuple[Any, Any]:
    x, y, z = s
    return 8.0 * x * y * z, np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 3.0


def _solid_ellipsoid(s: Any) -> tuple[Any, Any]:
    x, y, z = s
    return 4.0 / 3.0 * math.pi * x * y * z, np.array([y * y + z * z, x * x + z * z, x * x + y * y]) / 5.0


def _solid_sphere(s: Any) -> tuple[Any, Any]:
    return _solid_ellipsoid([s[0]] * 3)


def _solid_cylinder(s: Any) -> tuple[Any, Any]:
    r, half = s[:2]
    across = (3.0 * r * r + 4.0 * half * half) / 12.0
    return 2.0 * math.pi * r * r * half, np.array([across, across, 0.5 * r * r])


def _solid_capsule(s: Any) -> tuple[Any, Any]:
    r, half = s[:2]
    ends, (middle, moments) = 4.0 / 3.0 * math.pi * r**3, _solid_cylinder(s)
    whole = middle + ends
    # half spheres: their centres are 3/8 of the radius beyond the cylinder's ends
    across = 0.4 * r * r + half * half + 0.75 * half * r
    return whole, (middle * moments + ends * np.array([across, across, 0.4 * r * r])) / whole


SOLIDS: dict[str, tuple[int, Solid]] = {
    "sphere": (1, _solid_sphere),
    "capsule": (2, _solid_capsule),
    "ellipsoid": (3, _solid_ellipsoid),
    "cylinder": (2, _solid_cylinder),
    "box": (3, _solid_box),
}
"""By type of geom, the number of its sizes (halves of its extent) [m], and a function of these that returns its volume
and the principal moments of inertia of unit mass."""


def geom_inertia(kind: str, sizes: Sequence[float], mass: float | None, density: float, *, shell: bool) -> pin.Inertia:
    """Return the inertia of a geom about its centre; a shell has its mass on its surface [kg, kg m^2].

    `mass` replaces the mass by volume (or surface) and density if given.
    """
    count, solid = SOLIDS[kind]
    s = np.array(sizes[:count], dtype=float)
    if shell:
        layer = s + 1j * _STEP * np.array([1.0, kind != "capsule", 1.0])[:count]  # a capsule's length stays
        volume, unit = solid(layer)  # a layer is the derivative of a solid by its thickness
        size = float(volume.imag / _STEP)
        moments = np.asarray((volume * unit).imag / _STEP / size) if size else np.zeros(3)
        if kind == "ellipsoid":
            size = _area_of_ellipsoid(s)
    else:
        size, moments = solid(s)
    whole = density * size if mass is None else mass
    return pin.Inertia(float(whole), np.zeros(3), np.diag(whole * np.asarray(moments, dtype=float)))


def _area_of_ellipsoid(s: Vector) -> float:
    """Return Thomsen's approximation, within 1 %, which MuJoCo uses [m^2]."""
    x, y, z = s**_THOMSEN
    return float(4.0 * math.pi * ((x * y + x * z + y * z) / 3.0) ** (1.0 / _THOMSEN))


def mesh_inertia(vertices: Matrix, faces: Array, mass: float | None, density: float, kind: str) -> pin.Inertia:
    """Return the inertia of a triangle mesh, in its own axes [kg, kg m^2].

    Args:
        vertices: shape=(n, 3) [m].
        faces: indices of vertices, shape=(m, 3).
        mass: replaces the mass by volume and density if given.
        density: of the solid [kg/m^3] or, for a shell, of its surface [kg/m^2].
        kind: MuJoCo's name of the method: "exact", by signed tetrahedra; "legacy", by tetrahedra that all count as
            positive; or "shell". ("convex" is "exact" for the convex hull.)
    """
    corners = vertices[faces]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    if not areas.sum():
        return pin.Inertia.Zero()
    if kind == "shell":
        return _sum_of_parts(corners, areas, mass, density)
    apex = (areas @ corners.mean(axis=1)) / areas.sum()
    volumes = np.linalg.det(corners - apex) / 6.0
    if kind != "legacy":
        return _sum_of_parts(corners, volumes, mass, density, apex)
    centre = _sum_of_parts(corners, np.abs(volumes), mass, density, apex).lever
    volumes = np.abs(np.linalg.det(corners - centre)) / 6.0
    return _sum_of_parts(corners, volumes, mass, density, centre, centre)


def _sum_of_parts(
    corners: Array,
    weights: Vector,
    mass: float | None,
    density: float,
    apex: Vector | None = None,
    centre: Vector | None = None,
) -> pin.Inertia:
    """Return the inertia of triangles, or of the tetrahedra on them with an apex, of uniform density.

    It is about the centre of mass, or about one that is given.
    """
    tips = corners if apex is None else np.concatenate([corners, np.broadcast_to(apex, (len(corners), 1, 3))], axis=1)
    count = tips.shape[1]
    centres = tips.mean(axis=1)
    whole = weights.sum()
    if not whole:
        return pin.Inertia.Zero()
    centre = weights @ centres / whole if centre is None else centre
    arms = tips - centre
    # integral of x x^T over a simplex: (sum over corners of c c^T + n^2 m m^T) / (n (n + 1)) of its size, m their mean
    own = np.einsum("kia,kib->kab", arms, arms)
    means = centres - centre
    second = (own + count**2 * means[:, :, None] * means[:, None, :]) / (count * (count + 1))
    spread = np.einsum("k,kab->ab", weights, second) / whole
    total = float(density * whole if mass is None else mass)
    return pin.Inertia(total, centre, total * (np.trace(spread) * np.eye(3) - spread))
