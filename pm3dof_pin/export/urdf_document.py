"""A URDF as typed data, with numbers exactly as in the file: the source of exports to other formats."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeAlias
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pm3dof_pin.description.inertia_checks import MOMENTS, inertia_matrix
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.export.xml_text import document_text

WORLD = "world"
"""In MuJoCo, SDFormat and Drake, a root link of this name is the world itself."""

Quaternion: TypeAlias = tuple[float, float, float, float]

_SIZES = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",), "mesh": ()}


@dataclass(frozen=True)
class Origin:
    """A placement as in a URDF [m, rad]: roll, pitch, yaw rather than matrices, so that no digit changes."""

    position: tuple[float, ...] = (0.0, 0.0, 0.0)
    roll_pitch_yaw: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def is_rotated(self) -> bool:
        """Whether any angle is nonzero."""
        return any(self.roll_pitch_yaw)

    @property
    def turn(self) -> pin.Quaternion:
        """The rotation; continuous in the angles, hence the same on every computer except for rounding."""
        turns = (pin.Quaternion(pin.AngleAxis(a, axis)) for a, axis in zip(self.roll_pitch_yaw, np.eye(3), strict=True))
        roll, pitch, yaw = turns
        return yaw * pitch * roll

    @property
    def quaternion(self) -> Quaternion:
        """The rotation as w, x, y, z."""
        return wxyz(self.turn)

    @property
    def rotation(self) -> NDArray[np.float64]:
        """The rotation matrix, shape=(3, 3)."""
        return np.asarray(self.turn.toRotationMatrix())


@dataclass(frozen=True)
class Inertial:
    """Mass [kg] of a link, its centre, and ixx, iyy, izz, ixy, ixz, iyz about the centre, in its axes [kg m^2]."""

    mass: float
    origin: Origin
    moments: tuple[float, ...]

    @property
    def is_diagonal(self) -> bool:
        """Whether the products of inertia vanish."""
        return not any(self.moments[3:])

    @property
    def moments_in_link_axes(self) -> tuple[float, ...]:
        """The moments about the centre of mass, in the axes of the link."""
        rotation = self.origin.rotation
        turned = rotation @ inertia_matrix(self.moments) @ rotation.T
        return tuple(float(turned[i, j]) for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)))


@dataclass(frozen=True)
class Shape:
    """A visual or collision shape of a link; strings are empty and the colour None if the URDF has none."""

    name: str
    kind: str  #: box, cylinder, sphere or mesh
    #: edges of a box; radius and length of a cylinder; radius of a sphere; scales of a mesh [m, 1]
    sizes: tuple[float, ...]
    mesh: str
    origin: Origin
    colour: tuple[float, ...] | None


@dataclass(frozen=True)
class Link:
    """A link; its inertial is None if the URDF has none."""

    name: str
    inertial: Inertial | None
    visuals: tuple[Shape, ...]
    collisions: tuple[Shape, ...]

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return self.inertial.mass if self.inertial is not None else 0.0


@dataclass(frozen=True)
class Joint:
    """A joint, with the placement of its child in the parent at zero; SI units; None for what the URDF omits."""

    name: str
    kind: str  #: fixed, revolute, continuous or prismatic
    parent: str
    child: str
    origin: Origin
    axis: tuple[float, ...]  #: unit vector in the axes of the child
    lower: float | None
    upper: float | None
    effort: float | None
    velocity: float | None  #: None if unknown, which a URDF may give as 0
    damping: float
    friction: float

    @property
    def is_fixed(self) -> bool:
        """Whether it does not move."""
        return self.kind == "fixed"


@dataclass(frozen=True)
class UrdfDocument:
    """A parsed URDF: its XML (not to be modified), its text, and links and joints in the order of the file."""

    path: Path
    element: ElementTree.Element
    text: str
    name: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]

    @cached_property
    def root(self) -> Link:
        """The root link."""
        children = {joint.child for joint in self.joints}
        return next(link for link in self.links.values() if link.name not in children)

    def below(self, link: str) -> Iterator[Joint]:
        """Yield the child joints of a link, in the order of the file."""
        return (joint for joint in self.joints if joint.parent == link)

    def above(self, link: str) -> Joint | None:
        """Return the parent joint of a link, None for the root."""
        return next((joint for joint in self.joints if joint.child == link), None)

    def fixed_to(self, link: str) -> Iterator[Link]:
        """Yield a link and all links attached to it by fixed joints only."""
        yield self.links[link]
        for joint in self.below(link):
            if joint.is_fixed:
                yield from self.fixed_to(joint.child)

    def link_of_frame(self, frame: str) -> str:
        """Return the link of a frame, given by the name of the link or of its parent joint."""
        return frame if frame in self.links else next(joint.child for joint in self.joints if joint.name == frame)


def wxyz(turn: pin.Quaternion) -> Quaternion:
    """Return a quaternion as numbers w, x, y, z."""
    return float(turn.w), float(turn.x), float(turn.y), float(turn.z)


def read_urdf(path: Path, *, meshes: bool = True) -> UrdfDocument:
    """Read a URDF that Pinocchio has already read, so that its tree is known to be valid, with or without meshes.

    Raises:
        DescriptionError: a number is malformed, or a joint or shape type is not supported.
    """
    text = path.read_text(encoding="utf-8")
    root = ElementTree.fromstring(text)
    if not meshes and _drop_meshes(root):
        text = document_text(root, f"The URDF of {root.get('name')} without its meshes.")
    return _Reader(path, root).document(text)


def _drop_meshes(root: ElementTree.Element) -> int:
    """Remove mesh shapes, and count them."""
    dropped = [
        (link, shape)
        for link in root.findall("link")
        for shape in (*link.findall("visual"), *link.findall("collision"))
        if shape.find("geometry/mesh") is not None
    ]
    for link, shape in dropped:
        link.remove(shape)
    return len(dropped)


class _Reader:
    def __init__(self, path: Path, element: ElementTree.Element) -> None:
        self._path = path
        self._element = element
        self._colours = {m.get("name"): c for m in element.findall("material") if (c := self._colour_in(m))}

    def document(self, text: str) -> UrdfDocument:
        links = [self._link(link) for link in self._element.findall("link")]
        joints = tuple(self._joint(joint) for joint in self._element.findall("joint"))
        name = self._element.get("name", self._path.stem)
        return UrdfDocument(self._path, self._element, text, name, {link.name: link for link in links}, joints)

    def _link(self, element: ElementTree.Element) -> Link:
        inertial = element.find("inertial")
        return Link(
            element.get("name", ""),
            self._inertial(inertial) if inertial is not None else None,
            tuple(self._shape(visual) for visual in element.findall("visual")),
            tuple(self._shape(collision) for collision in element.findall("collision")),
        )

    def _inertial(self, element: ElementTree.Element) -> Inertial:
        moments = element.find("inertia")
        values = tuple(self._number(moments, name, 0.0) for name in MOMENTS)
        return Inertial(self._number(element.find("mass"), "value", 0.0), self._origin(element), values)

    def _shape(self, element: ElementTree.Element) -> Shape:
        shapes = element.find("geometry")
        shape = next((shape for shape in shapes if shape.tag in _SIZES), None) if shapes is not None else None
        if shape is None:
            raise DescriptionError(self._path, f"<{element.tag}>", f"expected a {', '.join(_SIZES)}")
        sizes = [size for name in _SIZES[shape.tag] for size in self._numbers(shape, name, ())]
        if shape.tag == "mesh":
            sizes = list(self._numbers(shape, "scale", (1.0, 1.0, 1.0)))
        name, mesh = element.get("name", ""), shape.get("filename", "")
        return Shape(name, shape.tag, tuple(sizes), mesh, self._origin(element), self._colour(element))

    def _colour(self, element: ElementTree.Element) -> tuple[float, ...] | None:
        material = element.find("material")
        if material is None:
            return None
        return self._colour_in(material) or self._colours.get(material.get("name"))

    def _colour_in(self, material: ElementTree.Element) -> tuple[float, ...] | None:
        colour = material.find("color")
        return None if colour is None else self._numbers(colour, "rgba", (1.0, 1.0, 1.0, 1.0))

    def _joint(self, element: ElementTree.Element) -> Joint:
        name, kind = element.get("name", ""), element.get("type", "")
        if kind not in ("fixed", "revolute", "continuous", "prismatic"):
            raise DescriptionError(
                self._path, f"joint '{name}'", f"expected a fixed, revolute, continuous or prismatic joint, not {kind}"
            )
        limit, dynamics = element.find("limit"), element.find("dynamics")
        is_limited = kind in ("revolute", "prismatic")
        return Joint(
            name=name,
            kind=kind,
            parent=self._named(element, "parent"),
            child=self._named(element, "child"),
            origin=self._origin(element),
            axis=self._axis(element, name, kind),
            lower=self._number(limit, "lower", 0.0) if is_limited else None,
            upper=self._number(limit, "upper", 0.0) if is_limited else None,
            effort=self._number(limit, "effort", 0.0) if limit is not None else None,
            velocity=self._number(limit, "velocity", 0.0) or None,
            damping=self._number(dynamics, "damping", 0.0),
            friction=self._number(dynamics, "friction", 0.0),
        )

    def _axis(self, element: ElementTree.Element, name: str, kind: str) -> tuple[float, ...]:
        axis = np.array(self._numbers(element.find("axis"), "xyz", (1.0, 0.0, 0.0)))
        if kind == "fixed":  # some programs write "0 0 0" here
            return 1.0, 0.0, 0.0
        length = float(np.linalg.norm(axis))
        if not length > 0.0:
            raise DescriptionError(self._path, f"joint '{name}'", "expected a nonzero axis")
        return tuple(float(x) for x in axis / length)

    def _named(self, element: ElementTree.Element, tag: str) -> str:
        found = element.find(tag)
        return found.get("link", "") if found is not None else ""

    def _origin(self, element: ElementTree.Element) -> Origin:
        origin = element.find("origin")
        zero = (0.0, 0.0, 0.0)
        return Origin(self._numbers(origin, "xyz", zero), self._numbers(origin, "rpy", zero))

    def _number(self, element: ElementTree.Element | None, name: str, default: float) -> float:
        return self._numbers(element, name, (default,))[0]

    def _numbers(self, element: ElementTree.Element | None, name: str, default: tuple[Any, ...]) -> tuple[float, ...]:
        if element is None or not (text := element.get(name)):
            return default
        try:
            return tuple(float(word) for word in text.split())
        except ValueError as error:
            raise DescriptionError(self._path, f"<{element.tag} {name}=>", f"expected numbers, not '{text}'") from error
