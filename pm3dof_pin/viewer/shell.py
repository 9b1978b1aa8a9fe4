"""The boundary of the workspace as a surface in space, coloured by a quantity of the maps.

If the coordinates are not positions, poses are not points in space: those of the tripod are two tilts and a height. But
the tip of a tool on the platform is a point, and for the tripod it determines the pose. So the surface drawn is the
boundary of the points that the tip of such a tool reaches, in metres, around the machine.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.limit_space import coordinates_over, robot_space
from pm3dof_pin.maps.quantities import MappedRobot
from pm3dof_pin.maps.workspace import level_range
from pm3dof_pin.maps.workspace_section import WorkspaceSection, workspace_sections
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import colours, objects
from pm3dof_pin.viewer.layers import Layer, ScalarQuantity
from pm3dof_pin.viewer.panel import Entry, numbers_with_unit
from pm3dof_pin.viewer.scene import Json, Scene

_TOOL_COLOUR = (0.13, 0.15, 0.18)
_LEAST_SECTIONS = 3
_RINGS = 12  # lines drawn along sections
_END = 1e-4  # inset of the first and the last section, relative to the range of heights


@dataclass(frozen=True)
class _Shell:
    """A closed triangle surface around the reachable set, and points inside, with quantities at all of them."""

    vertices: Array
    faces: NDArray[np.int64]
    lines: Array  #: pairs of end points of lines along some of the sections, shape=(k, 3) [m]
    points: Array
    layers: tuple[Layer, ...]  #: the quantities, at the vertices and then at the points
    part: str = ""  #: description of the part of the reachable set, or "" for all of it

    def draw(self, scene: Scene, path: str, size: float) -> None:
        """Draw the shell at a path, with points of a size [m]."""
        tints = colours.blend(colours.INDEX_STOPS, self.layers[0].places)
        count = len(self.vertices)
        surface = objects.coloured_mesh(objects.triangles(self.vertices, self.faces, tints[:count]), opacity=0.5)
        scene.set_object(f"{path}/surface", surface, casts_shadow=False)
        if len(self.points):
            cloud = objects.points(self.points, tints[count:], size)
            scene.set_object(f"{path}/points", cloud, casts_shadow=False)
        lines = objects.line_segments(self.lines, (0.1, 0.1, 0.15), opacity=0.35)
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
            lines=[of, layers[0]["title"], *([self.part] if self.part else [])],
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


def workspace_shell(
    robot: Robot, quantity: str, *, tool_length: float, heights: int = 41, directions: int = 120, inside: int = 17
) -> _Shell:
    """Return the boundary of the points that a tool's tip reaches, and points inside, with quantities at all of them.

    Three coordinates vary, see :func:`~pm3dof_pin.maps.limit_space.robot_space`; others stay at home. The quantity is a
    name of :data:`~pm3dof_pin.maps.quantities.QUANTITIES`, followed by a colon and one of its entries if it has
    several, as in "felt_stiffness:z". It is the first layer; :meth:`~pm3dof_pin.viewer.layers.ScalarQuantity.others`
    follow.

    Raises:
        InvalidValueError: there is no such quantity or entry, or it is not finite on the boundary; there are fewer than
            three coordinates; or no successive sections are single closed lines around their centres.
        UnreachablePoseError: no pose is within the limits.
    """
    mapped = MappedRobot(robot)
    chosen = ScalarQuantity.find(mapped, quantity)
    limits = robot_space(robot)
    if not limits.stacked:
        raise InvalidValueError("workspace", robot, "a robot with at least three coordinates")
    low, high = level_range(limits)
    inset = _END * (high - low)
    # closer together near the ends, where the sections shrink quickly
    places = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, heights))
    levels = low + inset + (high - low - 2.0 * inset) * places
    sections = _closed_sections(workspace_sections(limits, levels, directions, ranges=False))
    boundary = _boundary_poses(robot, sections)
    within = _inner_poses(robot, boundary, sections[0].space.names, inside)
    poses = Poses(robot, np.concatenate([boundary.q, within.q]))
    layer = chosen.layer(mapped, poses)
    if not np.isfinite(layer.values).all():
        raise InvalidValueError("quantity", quantity, "one that is finite on the whole boundary")
    others = [other.layer(mapped, poses) for other in ScalarQuantity.others(mapped, quantity)]
    layers = (layer, *(other for other in others if np.isfinite(other.values).all()))
    tips = _tool_tips(boundary, tool_length)
    count, part = len(sections), ""
    if count < heights:
        ends, scale, unit = [sections[0].level, sections[-1].level], 1.0, "m"
        if limits.units[2] == "rad":
            scale, unit = 180.0 / np.pi, "°"
        part = f"{limits.names[2]} {scale * ends[0]:.4g} .. {scale * ends[1]:.4g} {unit} only"
    lines, faces = _rings(tips, count, directions), _faces(count, directions)
    return _Shell(tips, faces, lines, _tool_tips(within, tool_length), layers, part)


def _inner_poses(robot: Robot, boundary: Poses, names: tuple[str, ...], count: int) -> Poses:
    """Return the poses within limits of a grid over some coordinates."""
    ranges = {}
    for name in names:
        values = boundary.coordinates[:, robot.coordinates.index(robot.coordinate(name))]
        ranges[name] = (float(values.min()), float(values.max()), max(count, 1))
    poses = robot.solve(robot.grid(**ranges), on_failure="nan").reshape(-1)
    return poses[np.flatnonzero(poses.within_limits)[: None if count else 0]]


def _closed_sections(stack: Sequence[WorkspaceSection]) -> tuple[WorkspaceSection, ...]:
    """Return the longest run of at least three sections that are single closed lines around their centres."""
    longest: list[WorkspaceSection] = []
    row: list[WorkspaceSection] = []
    for section in stack:
        row = [*row, section] if section.star_shaped else []
        longest = max(longest, row, key=len)
    if len(longest) < _LEAST_SECTIONS:
        raise InvalidValueError(
            "workspace", stack[0].space.machine, "sections that are single closed lines around a centre"
        )
    return tuple(longest)


def _boundary_poses(robot: Robot, sections: Sequence[WorkspaceSection]) -> Poses:
    """Return the boundary poses, section by section, then the centres of both ends."""
    space = sections[0].space
    lines = [np.column_stack([section.points, np.full(len(section.points), section.level)]) for section in sections]
    ends = [[*space.centre, section.level] for section in (sections[0], sections[-1])]
    changed = np.concatenate([*lines, ends])
    return robot.solve(coordinates_over(robot, space.names)(changed))


def draw_tool(scene: Scene, path: str, placement: ArrayLike, length: float, size: float) -> None:
    """Draw a tool of a length [m] with a ball of radius `size` at a path, at a placement in its parent."""
    scene.set_transform(path, placement)
    scene.set_object(f"{path}/rod", objects.mesh(objects.cylinder(0.25 * size, length), _TOOL_COLOUR))
    middle = objects.transform(translation=[0.0, 0.0, 0.5 * length])
    scene.set_transform(f"{path}/rod", middle @ objects.Y_TO_Z)
    scene.set_object(f"{path}/tip", objects.mesh(objects.sphere(size), _TOOL_COLOUR))
    scene.set_transform(f"{path}/tip", objects.transform(translation=[0.0, 0.0, length]))


def _faces(sections: int, directions: int) -> NDArray[np.int64]:
    """Return the triangles between neighbouring sections, and two fans that close the ends, with outward normals."""
    ring = np.arange(directions)
    following = (ring + 1) % directions
    walls = []
    for section in range(sections - 1):
        low, high = section * directions, (section + 1) * directions
        walls.append(np.column_stack([low + ring, low + following, high + following]))
        walls.append(np.column_stack([low + ring, high + following, high + ring]))
    bottom, top, last = sections * directions, sections * directions + 1, (sections - 1) * directions
    walls.append(np.column_stack([np.full(directions, bottom), following, ring]))
    walls.append(np.column_stack([np.full(directions, top), last + ring, last + following]))
    return np.concatenate(walls)


def _rings(vertices: Array, sections: int, directions: int) -> Array:
    """Return lines along every few sections, which show the surface's shape."""
    step = max(1, (sections - 1) // _RINGS)
    rings = vertices[: sections * directions].reshape(sections, directions, 3)[step // 2 :: step]
    ends = np.stack([rings, np.roll(rings, -1, axis=1)], axis=2)
    return ends.reshape(-1, 3)
