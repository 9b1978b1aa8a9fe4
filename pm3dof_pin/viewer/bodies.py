"""The drawn bodies of a mechanism: the visuals of its URDF, or a stick figure if it has none."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import assert_never

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.description.description import Description, Placement, Shape, ShapeKind
from pm3dof_pin.description.mesh_files import find_mesh, read_meshes
from pm3dof_pin.description.reading import read_description
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.scratch_data import scratch_data
from pm3dof_pin.typing import Array
from pm3dof_pin.viewer import colours, objects
from pm3dof_pin.viewer.objects import Colour
from pm3dof_pin.viewer.scene import Json

_logger = logging.getLogger(__name__)


ROOT = "/robot"

_DIRECTIONS = 400  # searched for outermost points
_SURROUNDINGS = 2.5  # fixed parts farther from all that moves are no machine [diagonals of what moves]
_ROUND = 48  # points that stand for a round or meshed part

_JOINT_COLOUR: Colour = (0.55, 0.57, 0.60)
_FINE = 2000  # number of triangles from which vertices of a mesh are merged
_CELLS = (200, 100, 50)  # cells per size of the mesh within which they are merged: the first that leaves few enough
_MAX_VERTICES = 10_000


@dataclass(frozen=True)
class BodyPart:
    """One drawn object of a body; its placement and outermost points, shape=(n, 3) [m], are in the body frame."""

    name: str
    scene_object: Json
    placement: Array
    colour: tuple[float, float, float, float]
    corners: Array


@dataclass(frozen=True)
class DrawnBody:
    """Drawn parts of one link (stick figure: joint), in the frame of the joint that moves it."""

    name: str
    joint: int
    placement: Array
    parts: list[BodyPart] = field(default_factory=list)

    @property
    def path(self) -> str:
        """Path in the scene."""
        return f"{ROOT}/{self.name.replace('/', '_')}"

    @property
    def parts_path(self) -> str:
        """Path of its drawn parts; frames are siblings."""
        return f"{self.path}/visual"


class Bodies(tuple[DrawnBody, ...]):
    """All drawn bodies of a mechanism."""

    @classmethod
    def from_mechanism(
        cls, mechanism: PlacedMechanism, visuals: pin.GeometryModel | Path | str | None = None
    ) -> Bodies:
        """Return the drawn bodies of a mechanism.

        By default the visuals of the file it was read from; a stick figure if these are missing or lack a mesh.

        Raises:
            DescriptionError: a file given as `visuals` is unreadable, or one of its meshes is missing.
        """
        if isinstance(visuals, pin.GeometryModel):
            shapes = list(_visuals_of_geometry(mechanism.model, visuals))
        else:
            shapes = _visuals(mechanism, visuals)
        if shapes:
            return cls(_drawn_bodies(mechanism, shapes))
        return cls(_stick_figure(mechanism))

    def placements(self, configuration: Configuration) -> dict[str, Array]:
        """Return the placement of every body in the world by path in the scene, shape=(4, 4) each."""
        joints = joint_placements(configuration)
        return {body.path: joints[body.joint] @ body.placement for body in self}

    def box(self, configuration: Configuration) -> Array:
        """Return the least and greatest coordinates of the machine, shape=(2, 3) [m].

        What stands still and is far from all that moves, such as a ground or an obstacle, is no part of it.
        """
        points = self._corner_points(configuration)
        return np.stack([points.min(axis=0), points.max(axis=0)])

    def outermost_points(self, configuration: Configuration) -> Array:
        """Return a few points whose convex hull contains nearly all of the machine, shape=(n, 3) [m]."""
        points = self._corner_points(configuration)
        return np.asarray(points[np.unique((_on_sphere(_DIRECTIONS) @ points.T).argmax(axis=1))])

    def _corner_points(self, configuration: Configuration) -> Array:
        placements = self.placements(configuration)
        clouds = [(body.joint, _moved(part.corners, placements[body.path])) for body in self for part in body.parts]
        moving = [points for joint, points in clouds if joint] or [points for _, points in clouds]
        if not moving:
            return np.zeros((1, 3))
        around = np.concatenate(moving)
        low, high = around.min(axis=0), around.max(axis=0)
        far = _SURROUNDINGS * float(np.linalg.norm(high - low))
        fixed = [points for joint, points in clouds if not joint]
        near = [points for points in fixed if np.all((points >= low - far) & (points <= high + far))]
        return np.concatenate([around, *near])


def joint_placements(configuration: Configuration) -> list[Array]:
    """Return the placement of every joint in the world, in Pinocchio's order, shape=(4, 4) each."""
    model = configuration.mechanism.model
    data = scratch_data(model)
    pin.forwardKinematics(model, data, np.array(configuration.q))
    return [np.array(placement.homogeneous) for placement in data.oMi]


def _visuals(mechanism: Mechanism, urdf: Path | str | None) -> list[_Visual]:
    if urdf is not None:
        return _read_visuals(read_description(find_robot(urdf)))
    try:
        return _read_visuals(mechanism.description)
    except DescriptionError as error:
        _logger.warning("%s: drawn as a stick figure; give the folders of packages with --package-path", error)
        return []


def _drawn_bodies(mechanism: Mechanism, visuals: list[_Visual]) -> tuple[DrawnBody, ...]:
    bodies: dict[str, DrawnBody] = {}
    for visual in visuals:
        if visual.body not in bodies:
            frame = mechanism.model.frames[mechanism.frame_id(visual.body)]
            bodies[visual.body] = DrawnBody(frame.name, frame.parentJoint, np.array(frame.placement.homogeneous))
        placement = np.array(visual.shape.placement.se3.homogeneous)
        own = colours.ROLES[role_of(mechanism, bodies[visual.body].joint)]
        parts = _part(visual.shape, placement, own) if visual.path is None else _mesh_parts(visual, placement, own)
        bodies[visual.body].parts.extend(parts)
    return tuple(bodies.values())


def role_of(mechanism: Mechanism, joint: int) -> str:
    """Return what a joint's body is to the machine: base, tool, drive (moved by an actuator) or passive."""
    if joint == 0:
        return "base"
    tool = mechanism.tool_frame
    if tool is not None and joint == mechanism.model.frames[mechanism.frame_id(tool)].parentJoint:
        return "tool"
    return "drive" if mechanism.model.names[joint] in mechanism.actuated_joints else "passive"


def _part(shape: Shape, placement: Array, own: Colour) -> list[BodyPart]:
    """Return a box, cylinder, sphere, ellipsoid or capsule, in a colour of its own if its file gives none."""
    turn, sizes = np.eye(4), shape.sizes
    match shape.kind:
        case "box":
            half = 0.5 * np.array(sizes)
            drawn, corners = [(objects.box(np.array(sizes)), turn)], _box_corners(np.array([-half, half]))
        case "sphere":
            drawn, corners = [(objects.sphere(sizes[0]), turn)], sizes[0] * _on_sphere(_ROUND)
        case "ellipsoid":
            drawn = [(objects.sphere(1.0), np.diag([*sizes, 1.0]))]
            corners = _on_sphere(_ROUND) * np.array(sizes)
        case "cylinder":
            drawn, corners = [(objects.cylinder(*sizes), objects.Y_TO_Z)], _rims(sizes[0], sizes[1])
        case "capsule":
            ends = [objects.transform(translation=[0.0, 0.0, side * sizes[1]]) for side in (-0.5, 0.5)]
            drawn = [(objects.cylinder(*sizes), objects.Y_TO_Z)]
            drawn += [(objects.sphere(sizes[0]), end) for end in ends]
            corners = sizes[0] * np.concatenate([_on_sphere(_ROUND)] * 2)
            corners[:, 2] += np.repeat([-0.5, 0.5], _ROUND) * sizes[1]
        case "mesh":
            return []
        case _:
            assert_never(shape.kind)
    colour = _colour(shape.colour or (*own, 1.0))
    return [
        BodyPart(
            f"{_name(shape)}_{number}" if number else _name(shape),
            objects.mesh(scene_object, colour[:3], opacity=colour[3]),
            placement @ turn,
            colour,
            _moved(corners, placement),
        )
        for number, (scene_object, turn) in enumerate(drawn)
    ]


def _mesh_parts(visual: _Visual, placement: Array, own: Colour) -> list[BodyPart]:
    """Return the meshes of a file, in its colours unless the description gives one; else in a colour of their own."""
    shape, parts = visual.shape, []
    assert visual.path is not None
    for number, mesh in enumerate(read_meshes(visual.path)):
        vertices = mesh.vertices * np.array(shape.sizes)
        colour = _colour(shape.colour or mesh.colour or (*own, 1.0))
        vertices, faces = _coarsened(vertices, mesh.faces)
        body = objects.mesh(objects.triangles(vertices, faces), colour[:3], opacity=colour[3])
        corners = vertices[np.unique((vertices @ _on_sphere(_ROUND).T).argmax(axis=0))]
        parts.append(BodyPart(f"{_name(shape)}_{number}", body, placement, colour, _moved(corners, placement)))
    return parts


def _coarsened(vertices: Array, faces: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64]]:
    """Merge vertices of a fine mesh within a cell, which are indistinguishable in the page."""
    if len(faces) < _FINE:
        return vertices, faces
    for parts in _CELLS:
        cells = np.round((vertices - vertices.min(axis=0)) * (parts / np.ptp(vertices, axis=0).max()))
        _, first, cell_of = np.unique(cells, axis=0, return_index=True, return_inverse=True)
        if len(first) <= _MAX_VERTICES:
            break
    joined = cell_of.reshape(-1)[faces]
    flat = (joined == np.roll(joined, 1, axis=1)).any(axis=1)
    return vertices[first], joined[~flat]


def _colour(numbers: ArrayLike) -> tuple[float, float, float, float]:
    red, green, blue, opacity = (round(float(number), 6) for number in np.asarray(numbers, dtype=float))
    return red, green, blue, opacity


def _name(shape: Shape) -> str:
    return shape.name.replace("/", "_")


def _box_corners(box: Array) -> Array:
    """Return the corners of a box given by least and greatest coordinates, shape=(8, 3)."""
    return np.stack(np.meshgrid(*box.T, indexing="ij"), axis=-1).reshape(-1, 3)


def _rims(radius: float, length: float) -> Array:
    """Return points on the rims of a cylinder along z, shape=(n, 3)."""
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND // 2, endpoint=False)
    rim = np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    return np.concatenate([np.column_stack([rim, np.full(len(rim), end * length)]) for end in (-0.5, 0.5)])


def _on_sphere(count: int) -> Array:
    """Return directions evenly on the unit sphere, and those of the axes, shape=(count, 3)."""
    index = np.arange(count - 6) + 0.5
    height, azimuth = 1.0 - 2.0 * index / (count - 6), (3.0 - math.sqrt(5.0)) * math.pi * index
    width = np.sqrt(1.0 - height**2)
    evenly = np.column_stack([width * np.cos(azimuth), width * np.sin(azimuth), height])
    return np.concatenate([evenly, np.eye(3), -np.eye(3)])


def _moved(points: Array, placement: Array) -> Array:
    moved: Array = points @ placement[:3, :3].T + placement[:3, 3]
    return moved


def _stick_figure(mechanism: PlacedMechanism) -> tuple[DrawnBody, ...]:
    """Balls at the joints, and rods between them and to the frames of closures and tool, in the colours of roles.

    The base is an outline around the points where it carries something. Slides are struts of a barrel and a rod.
    """
    model = mechanism.model
    size = mechanism.characteristic_length
    bodies = [DrawnBody(name, joint, np.eye(4)) for joint, name in enumerate(model.names)]
    ends: list[list[tuple[str, Array]]] = [[] for _ in bodies]
    for joint in range(1, model.njoints):
        if model.parents[joint] or not _floats(model, joint):
            ends[model.parents[joint]].append((model.names[joint], np.array(model.jointPlacements[joint].translation)))
        driven = model.names[joint] in mechanism.actuated_joints
        colour, radius = (colours.ROLES["drive"], 0.055) if driven else (_JOINT_COLOUR, 0.045)
        bodies[joint].parts.append(_ball("joint", np.zeros(3), radius * size, colour))
    frames = [name for loop in mechanism.closures for name in (loop.frame_a, loop.frame_b)]
    frames += [mechanism.tool_frame] if mechanism.tool_frame else []
    hidden = {loop.frame_b for loop in mechanism.closures}
    for name in dict.fromkeys(frames):
        frame = model.frames[mechanism.frame_id(name)]
        point = np.array(frame.placement.translation)
        ends[frame.parentJoint].append((name, point))
        own = colours.ROLES["tool" if name == mechanism.tool_frame else role_of(mechanism, frame.parentJoint)]
        radius = 0.036 if name in hidden else 0.04  # of two at one place only one is seen
        bodies[frame.parentJoint].parts.append(_ball(name, point, radius * size, own))
    for body, points in zip(bodies, ends, strict=True):
        own = colours.ROLES[role_of(mechanism, body.joint)]
        starts = np.zeros((len(points), 3))
        if not body.joint:
            starts, points = _outline(points)
        for start, (name, end) in zip(starts, points, strict=True):
            body.parts.extend(_rod(f"to_{name}", start, end, size, own))
    for joint in range(1, model.njoints):
        if (travel := _travel(mechanism, joint)) is not None:
            place, (direction, length) = model.jointPlacements[joint], travel
            parent, start = bodies[model.parents[joint]], np.array(place.translation)
            along, name = np.array(place.rotation) @ direction * length, model.names[joint]
            outer, inner = (colours.ROLES[role_of(mechanism, body.joint)] for body in (parent, bodies[joint]))
            parent.parts.extend(_rod(f"barrel_of_{name}", start, start + along, 1.6 * size, outer))
            bodies[joint].parts.extend(_rod("rod", np.zeros(3), -direction * length, size, inner))
    return tuple(body for body in bodies if body.parts)


def _travel(mechanism: PlacedMechanism, joint: int) -> tuple[Array, float] | None:
    """Return the direction of a slide that is extended at home, and the length of its barrel and of its rod [m].

    They overlap over its whole range where one is given that permits this, and otherwise up to 1.2 times its length at
    home. None for other joints, and where a link of the base slides passively: such slides only say that it may move.
    """
    model, name = mechanism.model, mechanism.model.names[joint]
    q = model.joints[joint].idx_q
    if not model.joints[joint].shortname().startswith("JointModelP") or model.joints[joint].nv != 1:
        return None
    if not model.parents[joint] and name not in mechanism.actuated_joints:
        return None
    at_home = float(mechanism.home.q[q])
    if abs(at_home) < 0.1 * mechanism.characteristic_length:
        return None
    direction = np.sign(at_home) * mechanism.joint_axis(name)
    farthest = abs(float((mechanism.upper_limits if at_home > 0.0 else mechanism.lower_limits)[q]))
    return direction, 0.5 * farthest if abs(at_home) <= farthest <= 2.0 * abs(at_home) else 0.6 * abs(at_home)


def _floats(model: pin.Model, joint: int) -> bool:
    """Return whether a joint, or several at one place that follow it, leave their body six degrees of freedom."""
    count = int(model.joints[joint].nv)
    while count < 6 and len(model.children[joint]) == 1:
        joint = model.children[joint][0]
        if np.any(np.abs(model.jointPlacements[joint].translation) > 0.0):
            return False
        count += int(model.joints[joint].nv)
    return count == 6


def _outline(points: list[tuple[str, Array]]) -> tuple[Array, list[tuple[str, Array]]]:
    """Return starts and ends of rods around points, in the order of their azimuth in the plane nearest to them.

    A single point is joined to the origin.
    """
    if len(points) < 2:
        return np.zeros((len(points), 3)), points
    places = np.array([place for _, place in points])
    inward = places - places.mean(axis=0)
    across = np.linalg.svd(inward)[2][:2]
    order = np.argsort(np.arctan2(inward @ across[1], inward @ across[0]))
    around = order if len(points) > 2 else order[1:]
    return places[np.roll(order, 1)][-len(around) :], [points[k] for k in around]


def _rod(name: str, start: Array, end: Array, size: float, colour: Colour) -> list[BodyPart]:
    length = float(np.linalg.norm(end - start))
    if length < 1e-6 * size:
        return []
    turn = objects.transform(objects.turn_z_to(end - start), 0.5 * (start + end))
    scene_object = objects.mesh(objects.cylinder(0.02 * size, length), colour)
    return [
        BodyPart(name, scene_object, turn @ objects.Y_TO_Z, (*colour, 1.0), _moved(_rims(0.02 * size, length), turn))
    ]


def _ball(name: str, middle: Array, radius: float, colour: Colour) -> BodyPart:
    scene_object = objects.mesh(objects.sphere(radius), colour)
    corners = middle + radius * _on_sphere(_ROUND)
    return BodyPart(name, scene_object, objects.transform(translation=middle), (*colour, 1.0), corners)


@dataclass(frozen=True)
class _Visual:
    """A shape on a body; `path` is the file of a mesh."""

    body: str
    shape: Shape
    path: Path | None = None


def _read_visuals(description: Description) -> list[_Visual]:
    """Return the visual shapes of a robot, with the files of its meshes.

    Shapes without a name get that of their body with a number.

    Raises:
        DescriptionError: a mesh is missing, or lies outside the folders of the robot, see
            :func:`~pm3dof_pin.description.mesh_files.find_mesh`.
    """
    visuals = []
    for body in description.bodies:
        for number, shape in enumerate(body.visuals):
            path = None
            if shape.kind == "mesh":
                if description.files is None:
                    raise DescriptionError(description.name, f"mesh '{shape.mesh}'", "expected the robot's files")
                path = find_mesh(description.files, shape.mesh)
            visuals.append(_Visual(body.name, replace(shape, name=f"{body.name}_{number}"), path))
    return visuals


def _visuals_of_geometry(model: pin.Model, geometry: pin.GeometryModel) -> Iterator[_Visual]:
    """Yield the shapes of a geometry model of Pinocchio that can be described."""
    for shape in geometry.geometryObjects:
        frame = model.frames[shape.parentFrame]
        placement = Placement.from_se3(frame.placement.actInv(shape.placement))
        solid, kind = shape.geometry, type(shape.geometry).__name__
        colour = tuple(float(part) for part in shape.meshColor)
        described: Shape | None = None
        if hasattr(solid, "num_tris"):
            scale = tuple(float(part) for part in shape.meshScale)
            colours = colour if shape.overrideMaterial else None
            described = Shape("mesh", scale, placement, shape.name, str(shape.meshPath), colours)
        elif kind == "Box":
            sizes = tuple(float(2.0 * half) for half in solid.halfSide)
            described = Shape("box", sizes, placement, shape.name, colour=colour)
        elif kind == "Sphere":
            described = Shape("sphere", (float(solid.radius),), placement, shape.name, colour=colour)
        elif kind == "Ellipsoid":
            radii = tuple(float(radius) for radius in np.asarray(solid.radii))
            described = Shape("ellipsoid", radii, placement, shape.name, colour=colour)
        elif kind in ("Cylinder", "Capsule"):
            sizes = float(solid.radius), float(2.0 * solid.halfLength)
            form: ShapeKind = "cylinder" if kind == "Cylinder" else "capsule"
            described = Shape(form, sizes, placement, shape.name, colour=colour)
        if described is not None:
            yield _Visual(frame.name, described, Path(described.mesh) if described.mesh else None)
