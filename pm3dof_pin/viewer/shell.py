"""The boundary of the reachable set as a surface in space, coloured by a quantity of the maps.

A pose of the tripod is two tilts and a height, which are no point in space. The tip of a tool that stands on the middle
of the platform is one, and the only one for its pose: at the length h above O_e it is at

    (h sin theta_y, -h sin theta_x cos theta_y, z_e + h cos theta_x cos theta_y).

So the surface drawn is the boundary of what the tip of such a tool reaches, in metres, around the machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.chapter.kinematics import joint_positions
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.maps.quantities import QUANTITIES, Evaluation, MappedRobot, select_quantities
from pm3dof_pin.maps.units import unit_of_entry
from pm3dof_pin.maps.workspace import Workspace
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import colours, objects
from pm3dof_pin.viewer.scene import Scene

_WIDE = 20.0  # ratio of greatest to least value from which on a scale is logarithmic
_TOOL_COLOUR = (0.13, 0.15, 0.18)
_RINGS = 12  # lines drawn along sections
_CLOSED = 1e-9  # [m]
_END = 1e-4  # how far inside the range of heights the first and the last section lie, as a part of it


@dataclass(frozen=True)
class Shell:
    """A closed surface of triangles with one value at each corner.

    Attributes:
        vertices: shape=(n, 3) [m].
        faces: indices of the corners, shape=(m, 3).
        lines: pairs of ends of lines along some of the sections, shape=(k, 3) [m].
        values: the quantity at each vertex, shape=(n,).
        title: what the quantity is.
        unit: its unit.
    """

    vertices: Array
    faces: NDArray[np.int64]
    lines: Array
    values: Array
    title: str
    unit: str

    @property
    def logarithmic(self) -> bool:
        """Whether the values are better told apart on a logarithmic scale: positive, and far from each other."""
        low, high = float(self.values.min()), float(self.values.max())
        return 0.0 < low * _WIDE < high

    @property
    def places(self) -> Array:
        """Place of each value on the scale of colours from the least, 0, to the greatest, 1, shape=(n,)."""
        values = np.log(self.values) if self.logarithmic else self.values
        low, high = float(values.min()), float(values.max())
        places: Array = (values - low) / (high - low) if high > low else np.zeros_like(values)
        return places


def tool_tips(poses: ArrayLike, length: float) -> Array:
    """Return where the tip of a tool on the middle of the platform is.

    Args:
        poses: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m].
        length: from O_e along the platform's normal [m].

    Returns:
        shape=(..., 3) [m].
    """
    theta_x, theta_y, z_e = np.moveaxis(np.asarray(poses, dtype=float), -1, 0)
    x, y = np.sin(theta_y), -np.sin(theta_x) * np.cos(theta_y)
    z = np.cos(theta_x) * np.cos(theta_y)
    return np.stack([length * x, length * y, z_e + length * z], axis=-1)


def workspace_shell(
    robot: Robot, tripod: Tripod, quantity: str, *, tool_length: float, heights: int = 61, directions: int = 240
) -> Shell:
    """Return the boundary of what a tool's tip reaches, with a quantity at each of its points.

    Args:
        robot: the machine.
        tripod: the same in closed form.
        quantity: a name of :data:`~pm3dof_pin.maps.quantities.QUANTITIES`, and after a colon which of its entries:
            "condition_number", "translational_stiffness:least" or "felt_stiffness:z".
        tool_length: see :func:`tool_tips` [m].
        heights: number of sections.
        directions: number of points in each.

    Raises:
        InvalidValueError: no such quantity or entry, or a section of the reachable set is not one closed line around
            the level platform.
        UnreachablePoseError: no pose is within the limits.
    """
    from pm3dof_pin.chapter.workspace import tripod_space
    from pm3dof_pin.maps.workspace import level_range, workspace

    mapped = MappedRobot(robot)
    entry = scalar_quantity(mapped, quantity)
    limits = tripod_space(tripod)
    low, high = level_range(limits)
    inset = _END * (high - low)
    # closer to each other near the ends, where the sections shrink fast
    places = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0.0, 1.0, heights))
    space = workspace(limits, low + inset + (high - low - 2.0 * inset) * places, directions)
    poses = boundary_poses(space)
    values = entry.values(mapped, poses)
    tips = tool_tips(poses, tool_length)
    lines = _rings(tips, heights, directions)
    return Shell(tips, _faces(heights, directions), lines, values, entry.title, entry.unit)


@dataclass(frozen=True)
class ScalarQuantity:
    """One number at each pose.

    Attributes:
        name: name of the quantity.
        index: which of its entries, or None if it has one.
        title: what it is.
        unit: its unit.
    """

    name: str
    index: int | None
    title: str
    unit: str

    def values(self, mapped: MappedRobot, coordinates: Array) -> Array:
        """Return the number at coordinates, shape=(..., number of coordinates), shape=(...)."""
        poses = mapped.robot.solve(coordinates, on_failure="nan")
        values = QUANTITIES[self.name].compute(Evaluation(mapped, poses))
        return values if self.index is None else values[..., self.index]


def scalar_quantity(mapped: MappedRobot, text: str) -> ScalarQuantity:
    """Find one number among the quantities of the maps: "name" or "name:entry".

    Raises:
        InvalidValueError: no such quantity or entry, or the quantity is no list of numbers.
    """
    name, _, label = text.partition(":")
    (quantity,) = select_quantities([name], mapped)
    if not quantity.dims:
        if label:
            raise InvalidValueError("quantity", text, f"'{name}' alone, which is one number")
        return ScalarQuantity(name, None, quantity.long_name, quantity.unit_for(mapped))
    entries = quantity.dims[0].labels(mapped) if len(quantity.dims) == 1 else ()
    if label not in entries:
        expected = f"'{name}:' and one of {', '.join(entries)}" if entries else "a quantity that is a number or a list"
        raise InvalidValueError("quantity", text, expected)
    unit = unit_of_entry(quantity.unit_for(mapped), label)
    return ScalarQuantity(name, entries.index(label), f"{quantity.long_name}: {label}", unit)


def scalar_quantities(mapped: MappedRobot) -> list[str]:
    """Return every text that :func:`scalar_quantity` takes."""
    names = []
    for quantity in QUANTITIES.values():
        if not quantity.exists(mapped):
            continue
        if not quantity.dims:
            names.append(quantity.name)
        elif len(quantity.dims) == 1:
            names += [f"{quantity.name}:{label}" for label in quantity.dims[0].labels(mapped)]
    return names


def boundary_poses(space: Workspace) -> Array:
    """Return the boundary of a stack of sections, each one closed line, and the middle of both ends.

    Returns:
        Poses, section after section, then the middles of the first and the last, shape=(sections * directions + 2, 3).

    Raises:
        InvalidValueError: a section is not one closed line around the level platform.
    """
    for section in space.sections:
        if not section.star_shaped:
            raise InvalidValueError(
                "workspace", f"section at z_e = {section.level:g} m", "one closed line around theta = 0"
            )
    lines = [
        np.column_stack([section.points, np.full(len(section.points), section.level)]) for section in space.sections
    ]
    ends = [[0.0, 0.0, space.levels[0]], [0.0, 0.0, space.levels[-1]]]
    return np.concatenate([*lines, ends])


def require_same_machine(tripod: Tripod, mechanism: Robot) -> None:
    """Check that a closed form and a mechanism are one machine.

    Raises:
        InvalidValueError: their joints differ, or the closed form leaves loops of the mechanism open.
    """
    tilt = 0.3 * tripod.parameters.universal_limit
    for pose in (tripod.home, np.array([tilt, -tilt, tripod.height_home])):
        positions = joint_positions(tripod, pose)
        if set(positions) != set(mechanism.q_names):
            raise InvalidValueError("tripod", tripod.parameters.name, f"the tripod that {mechanism} is: joints differ")
        q = np.array([positions[name] for name in mechanism.q_names])
        residual = mechanism.configuration(q).closure_residual
        if residual > _CLOSED:
            expected = f"the tripod that {mechanism} is: its loops stay open by {residual:.1e} m"
            raise InvalidValueError("tripod", tripod.parameters.name, expected)


def draw_shell(scene: Scene, path: str, shell: Shell) -> None:
    """Put a shell at a path."""
    tints = colours.blend(colours.INDEX_STOPS, shell.places)
    surface = objects.coloured_mesh(objects.triangles(shell.vertices, shell.faces, tints), opacity=0.5)
    scene.set_object(f"{path}/surface", surface, casts_shadow=False)
    lines = objects.line_segments(shell.lines, (0.1, 0.1, 0.15), opacity=0.35)
    scene.set_object(f"{path}/lines", lines, casts_shadow=False)


def draw_tool(scene: Scene, path: str, placement: ArrayLike, length: float, size: float) -> None:
    """Put the tool whose tip the shell is of at a path.

    Args:
        scene: where.
        path: its path.
        placement: of the tool frame in what stands above it in the tree, shape=(4, 4).
        length: of the tool along z [m].
        size: radius of the ball at its tip [m].
    """
    scene.set_transform(path, placement)
    scene.set_object(f"{path}/rod", objects.mesh(objects.cylinder(0.25 * size, length), _TOOL_COLOUR))
    middle = objects.transform(translation=[0.0, 0.0, 0.5 * length])
    scene.set_transform(f"{path}/rod", middle @ objects.Y_TO_Z)
    scene.set_object(f"{path}/tip", objects.mesh(objects.sphere(size), _TOOL_COLOUR))
    scene.set_transform(f"{path}/tip", objects.transform(translation=[0.0, 0.0, length]))


def _faces(sections: int, directions: int) -> NDArray[np.int64]:
    """Return the triangles between neighbouring sections, and two fans that close the ends; normals outwards."""
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
