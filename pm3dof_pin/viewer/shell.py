"""The boundary of the workspace as a surface in space, coloured by a quantity of the maps.

If the coordinates are not positions, poses are not points in space: those of the tripod are two tilts and a height. But
the tip of a tool on the platform is a point, and for the tripod it determines the pose. So the surface drawn is the
boundary of the points that the tip of such a tool reaches, in metres, around the machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.limit_space import coordinates_over, robot_space
from pm3dof_pin.maps.quantity import MappedRobot
from pm3dof_pin.maps.workspace import Workspace, workspace
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import colours, objects
from pm3dof_pin.viewer.layers import Layer, ScalarQuantity
from pm3dof_pin.viewer.panel import Entry, numbers_with_unit
from pm3dof_pin.viewer.scene import Json, Scene

_TOOL_COLOUR = (0.13, 0.15, 0.18)
_RINGS = 12  # sections whose lines are drawn
_RING_POINTS = 120  # of each


@dataclass(frozen=True)
class Shell:
    """A closed triangle surface around the reachable set, and points inside, with quantities at all of them."""

    vertices: Array
    faces: NDArray[np.int64]
    lines: Array  #: pairs of end points of lines along some of the sections, shape=(k, 3) [m]
    points: Array
    layers: tuple[Layer, ...]  #: the quantities, at the vertices and then at the points

    def draw(self, scene: Scene, path: str, size: float) -> None:
        """Draw the shell at a path, with points of a size [m]."""
        tints = colours.blend(colours.INDEX_STOPS, self.layers[0].places)
        count = len(self.vertices)
        surface = objects.mesh(objects.triangles(self.vertices, self.faces, tints[:count]), None, opacity=0.55)
        scene.set_object(f"{path}/surface", surface, casts_shadow=False)
        if len(self.points):
            cloud = objects.points(self.points, tints[count:], size)
            scene.set_object(f"{path}/points", cloud, casts_shadow=False)
        lines = objects.line_segments(self.lines, (0.1, 0.1, 0.15), opacity=0.15)
        scene.set_object(f"{path}/lines", lines, casts_shadow=False)

    def entry(self, path: str, tool: str, tool_length: float) -> Entry:
        """Return the entry of the legend for the shell at a path, and the tool [m] at another."""
        layers: list[Json] = [
            {
                "name": layer.name,
                "title": layer.title + (" (logarithmic)" if layer.logarithmic else ""),
                "ends": [numbers_with_unit([end], layer.unit) for end in (layer.values.min(), layer.values.max())],
                "places": objects.bytes_of(layer.places),
            }
            for layer in self.layers
        ]
        of = f"of the tip of a tool {1000.0 * tool_length:g} mm long" if tool_length else "of the tool"
        return Entry(
            key="workspace",
            title="Workspace",
            lines=[of, layers[0]["title"]],
            bar={"colours": list(colours.INDEX_STOPS), "ends": layers[0]["ends"]},
            nodes=[path, tool],
            of_pose=False,
            cut={
                "corners": [self.vertices.min(axis=0).tolist(), self.vertices.max(axis=0).tolist()],
                "layers": layers,
                "stops": colours.stops(colours.INDEX_STOPS).tolist(),
                "colours": [f"{path}/surface", f"{path}/points"],
                "nodes": [f"{path}/surface", f"{path}/lines", f"{path}/points"],
            },
        )


def _tool_tips(poses: Poses, length: float) -> Array:
    """Return the tips of tools of a length along the z axis of the tool frame, shape=(..., 3) [m]."""
    return np.asarray(poses.positions + length * poses.rotations[..., 2])


def workspace_shell(robot: Robot, quantity: str, *, tool_length: float, cells: int = 29, inside: int = 17) -> Shell:
    """Return the boundary of the points that a tool's tip reaches, and points inside, with quantities at all of them.

    Three coordinates vary, see :func:`~pm3dof_pin.maps.limit_space.robot_space`, on a grid of so many cells along each;
    others stay at home. The quantity is a name of :data:`~pm3dof_pin.maps.quantities.QUANTITIES`, followed by a colon
    and one of its entries if it has several, as in "felt_stiffness:z". It is the first layer;
    :meth:`~pm3dof_pin.viewer.layers.ScalarQuantity.others` follow.

    Raises:
        InvalidValueError: there is no such quantity or entry, or it is not finite on the boundary; or there are fewer
            than three coordinates.
        UnreachablePoseError: no pose is within the limits.
    """
    mapped = MappedRobot(robot)
    chosen = ScalarQuantity.find(mapped, quantity)
    limits = robot_space(robot)
    if not limits.stacked:
        raise InvalidValueError("workspace", robot, "a robot with at least three coordinates")
    found = workspace(limits, _RINGS + 2, _RING_POINTS)
    surface = found.surface(cells)
    complete = coordinates_over(robot, limits.names)
    boundary = robot.solve(complete(surface.points))
    within = _inner_poses(robot, surface.points, limits.names, inside)
    poses = Poses(robot, np.concatenate([boundary.q, within.q]))
    layer = chosen.layer(mapped, poses)
    if not np.isfinite(layer.values).all():
        raise InvalidValueError("quantity", quantity, "one that is finite on the whole boundary")
    others = [other.layer(mapped, poses) for other in ScalarQuantity.others(mapped, quantity)]
    layers = (layer, *(other for other in others if np.isfinite(other.values).all()))
    tips, faces = _tool_tips(boundary, tool_length), surface.triangles
    a, b, c = (tips[faces[:, k]] - tips.mean(axis=0) for k in range(3))
    if np.einsum("ni,ni->", a, np.cross(b, c)) < 0.0:  # the tip's position mirrors the coordinates
        faces = faces[:, ::-1]
    rings = _tool_tips(robot.solve(complete(_rings(found))), tool_length)
    return Shell(tips, faces, rings, _tool_tips(within, tool_length), layers)


def _inner_poses(robot: Robot, boundary: Array, names: tuple[str, ...], count: int) -> Poses:
    """Return the poses within limits of a grid over some coordinates, as wide as their boundary."""
    ends = zip(names, boundary.min(axis=0), boundary.max(axis=0), strict=True)
    ranges = {name: (float(low), float(high), max(count, 1)) for name, low, high in ends}
    poses = robot.solve(robot.grid(**ranges), on_failure="nan").reshape(-1)
    return poses[np.flatnonzero(poses.within_limits)[: None if count else 0]]


def _rings(found: Workspace) -> Array:
    """Return the ends of the pieces of line around the sections, one after the other, shape=(2 n, 3)."""
    rings = [np.empty((0, 3))]
    for section in found.sections[1:-1]:
        for line in section.lines:
            points = np.column_stack([line, np.full(len(line), section.level)])
            rings.append(np.stack([points, np.roll(points, -1, axis=0)], axis=1).reshape(-1, 3))
    return np.concatenate(rings)


def draw_tool(scene: Scene, path: str, placement: ArrayLike, length: float, size: float) -> None:
    """Draw a tool of a length [m] with a ball of radius `size` at a path, at a placement in its parent."""
    scene.set_transform(path, placement)
    scene.set_object(f"{path}/rod", objects.mesh(objects.cylinder(0.25 * size, length), _TOOL_COLOUR))
    middle = objects.transform(translation=[0.0, 0.0, 0.5 * length])
    scene.set_transform(f"{path}/rod", middle @ objects.Y_TO_Z)
    scene.set_object(f"{path}/tip", objects.mesh(objects.sphere(size), _TOOL_COLOUR))
    scene.set_transform(f"{path}/tip", objects.transform(translation=[0.0, 0.0, length]))
