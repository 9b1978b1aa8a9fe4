"""Polytopes at the tool: the forces and the speeds that the drives' limits permit.

A force polytope has the forces, without a moment, that the drives can exert through the tool while they hold the
weight; a speed polytope the velocities for all rates of the drives, whatever the tool's rotation. Both are within the
space that the tool's point moves in; forces beside it are the structure's. Of rotations, likewise, they have moments
and angular velocities.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.capability.tool_capability import ToolCapability
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Motion
from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.ellipsoids import UNITS
from pm3dof_pin.viewer.scene import Scene

PolytopeQuantity: TypeAlias = Literal["force", "speed"]

TITLES: dict[tuple[PolytopeQuantity, Motion], str] = {
    ("force", "translation"): "Force polytope",
    ("force", "rotation"): "Moment polytope",
    ("speed", "translation"): "Speed polytope",
    ("speed", "rotation"): "Angular speed polytope",
}

COLOURS: dict[PolytopeQuantity, objects.Colour] = {"force": (0.85, 0.45, 0.0), "speed": (0.0, 0.45, 0.65)}

_OPACITY = 0.16
_OTHER_CORNERS = np.array([[1, 2], [0, 2], [0, 1]])  # of a triangle, by corner
_FLAT = 1e-6  # relative to the fastest direction: in slower ones the tool does not move


@dataclass(frozen=True, eq=False)
class DrawnPolytope:
    """A convex polytope about the tool's point: a body, a polygon, or two ends, in world axes."""

    vertices: Array  #: shape=(n, 3) [N, N m, m/s, rad/s]
    triangles: Array  #: of the surface, indices of vertices, shape=(t, 3)
    edges: Array  #: indices of vertices, shape=(e, 2)
    least: float  #: in the weakest direction that the tool moves in, 0 if there is none at the origin
    unit: str  #: of all numbers

    @property
    def greatest(self) -> float:
        """In the strongest direction."""
        return float(np.linalg.norm(self.vertices, axis=1).max())


def polytope_unit(of: PolytopeQuantity, kind: Motion) -> str:
    """Return the unit of a polytope's numbers."""
    return UNITS["force" if of == "force" else "velocity", kind]


def tool_polytope(at: ToolCapability, of: PolytopeQuantity, kind: Motion) -> DrawnPolytope:
    """Return the polytope of a single pose.

    Raises:
        SingularConfigurationError: the tool's point does not move in this way.
        InvalidValueError: a limit is not described, or the drives cannot hold the weight.
    """
    unit = polytope_unit(of, kind)
    rows = slice(0, 3) if kind == "translation" else slice(3, 6)
    left, values, _ = np.linalg.svd(at.tool_rates[rows])
    if not values[0] > _FLAT * np.linalg.norm(at.tool_rates):
        raise SingularConfigurationError(f"the tool has no {kind}: no {of} polytope")
    axes = left[:, : len(values)][:, values > _FLAT * values[0]]
    if of == "force":
        corners = at.wrenches.pulled_back(np.eye(6)[:, rows] @ axes).vertices()
        if len(corners) <= axes.shape[1]:
            raise InvalidValueError("effort", at.effort.tolist(), "enough to hold the weight")
    else:
        corners = at.velocities(rows) @ axes
    return _hull(corners, axes, unit)


def draw_polytope(scene: Scene, path: str, drawn: DrawnPolytope, of: PolytopeQuantity, scale: float) -> None:
    """Draw the surface and the edges of a polytope at a path, to a scale [m per unit]."""
    points, colour = scale * drawn.vertices, COLOURS[of]
    surface = objects.mesh(objects.triangles(points, drawn.triangles), colour, opacity=_OPACITY)
    scene.set_object(f"{path}/surface", surface, casts_shadow=False)
    edges = objects.line_segments(points[drawn.edges].reshape(-1, 3), colour, overlaid=True)
    scene.set_object(f"{path}/edges", edges, casts_shadow=False)


def _hull(corners: Array, axes: Array, unit: str) -> DrawnPolytope:
    """Return the convex hull of points in a space of given axes, shape=(n, r) and (3, r)."""
    from scipy.spatial import ConvexHull, QhullError

    dimensions = axes.shape[1]
    if dimensions == 1:
        low, high = float(corners.min()), float(corners.max())
        ends = np.array([[low], [high]]) @ axes.T
        return DrawnPolytope(ends, np.zeros((0, 3), int), np.array([[0, 1]]), max(0.0, min(-low, high)), unit)
    try:
        hull = ConvexHull(corners)
    except QhullError as error:
        raise InvalidValueError("polytope", problem="is too flat to draw", expected="another pose") from error
    count = len(hull.vertices)
    if dimensions == 2:  # its vertices are in order around the polygon
        triangles = np.array([[0, k, k + 1] for k in range(1, count - 1)])
        edges = np.array([[k, (k + 1) % count] for k in range(count)])
    else:
        number = np.zeros(len(corners), int)
        number[hull.vertices] = np.arange(count)
        triangles, normals = number[hull.simplices], hull.equations[:, :3]
        others = hull.neighbors  # across from each corner
        bends = np.einsum("fk,fnk->fn", normals, normals[others]) < 1.0 - SAME
        face, across = np.nonzero((np.arange(len(others))[:, None] < others) & bends)
        edges = triangles[face[:, None], _OTHER_CORNERS[across]]
    least = max(0.0, float(-hull.equations[:, -1].max()))
    return DrawnPolytope(frozen(corners[hull.vertices] @ axes.T), triangles, edges, least, unit)
