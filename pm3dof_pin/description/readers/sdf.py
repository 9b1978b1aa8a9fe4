"""SDF 1.7 to 1.11 (and earlier, as far as they agree): models whose joints may close loops.

Joints that close a loop are cut, and become loop closures of their type: first balls, then universal joints, fixed
ones, and hinges and slides, of these the last in the file; joints with a controller are kept if possible. The report of
what was read over says which were cut. A model without a joint to the world is held at its first link, unless a
`<pm3dof:free_joint name=''>` says of its `<child>` that it floats. Several models of a world are one robot, with names
such as `model::link`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closure_types import ClosureTypeName
from pm3dof_pin.description.closures import Axis, LoopClosure
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import (
    IDENTITY,
    MAX_BODIES,
    WORLD,
    Body,
    Description,
    Drive,
    Frame,
    Inertial,
    Joint,
    JointType,
    Placement,
    Shape,
    ShapeKind,
    Unread,
    universal_hinges,
)
from pm3dof_pin.description.inertia_checks import MOMENTS, inertia_matrix, inertia_problem, is_reversed
from pm3dof_pin.description.origin import Origin
from pm3dof_pin.description.physical_bounds import ANY, LENGTH, MASS, NOT_NEGATIVE, PRODUCT, SIZE, Bounds
from pm3dof_pin.description.readers.drake_constraints import (
    POINT_CONSTRAINTS,
    TENDON_CONSTRAINT,
    point_constraint,
    tendon_coupling,
)
from pm3dof_pin.description.readers.elements import ElementReader, free_name, named
from pm3dof_pin.description.readers.gearbox import gearbox_coupling
from pm3dof_pin.description.readers.sdf_includes import included_model, is_merged, merged_parts
from pm3dof_pin.description.xml_file import Element, child, children

_JOINT_TYPES: dict[str, JointType] = {
    "fixed": "fixed", "revolute": "revolute", "continuous": "continuous", "prismatic": "prismatic",
    "ball": "spherical", "screw": "helical",
}  # fmt: skip
NAMESPACE = "urn:pm3dof-pin"
"""Of elements that SDFormat has no words for: the names of free joints."""

_FREE_JOINT = "pm3dof:free_joint"
_TWO_AXES = ("universal", "revolute2")
_WITHOUT_AXIS = ("fixed", "ball")
_ANY_AXES: tuple[tuple[float, ...], ...] = ((0.0, 0.0, 1.0),) * 2
_WATCHERS = ("statepublisher", "forcetorque", "ftsensor")  # plugins that name joints and move none
_CLOSURES: dict[str, ClosureTypeName] = {
    "fixed": "6d", "revolute": "hinge", "continuous": "hinge", "prismatic": "prismatic", "ball": "3d",
    "universal": "universal",
}  # fmt: skip
_KEPT_FIRST = {  # 1 if driven, 2 otherwise
    "floating": 0, "screw": 0, "revolute2": 0, "fixed": 3, "universal": 4, "ball": 5,
}  # fmt: skip
_UNLIMITED = 1e15  # limits at least this large are none
_LIMIT = Bounds("", math.inf, negative=True)
_SIZES: dict[str, tuple[ShapeKind, tuple[tuple[str, int], ...]]] = {
    "box": ("box", (("size", 3),)),
    "cylinder": ("cylinder", (("radius", 1), ("length", 1))),
    "capsule": ("capsule", (("radius", 1), ("length", 1))),
    "sphere": ("sphere", (("radius", 1),)),
    "ellipsoid": ("ellipsoid", (("radii", 3),)),
}
_MODEL_PARTS = (
    "link",
    "joint",
    "frame",
    "model",
    "pose",
    "include",
    "static",
    "self_collide",
    "allow_auto_disable",
    "plugin",
    *POINT_CONSTRAINTS,
    TENDON_CONSTRAINT,
    _FREE_JOINT,
)
_MODEL_PASSED = ("gripper", "enable_wind", "enable_stability", "placement_frame")
_JOINT_PARTS = ("parent", "child", "pose", "axis", "axis2", "screw_thread_pitch", "thread_pitch")
_GEARS = ("gearbox_ratio", "gearbox_reference_body")


def read_sdf(root: Element, folders: tuple[Path, ...] = (), *, lenient: bool = False) -> Description:
    """Read the models of an SDF, or those that are not static, from its root element.

    Models that it includes are read from its own folders and those next to them,
    see :func:`~pm3dof_pin.description.readers.sdf_includes.included_model`.

    Raises:
        DescriptionError: there is no model, a number is malformed or impossible, a name is unknown, or an
            element that could carry a loop, a coupling or a drive is not supported.
    """
    return _SdfReader(root, folders, lenient=lenient).read()


@dataclass(frozen=True)
class _Edge:
    """A joint of the file between two bodies, all placed in the model."""

    name: str
    kind: str
    parent: str
    child: str
    placement: pin.SE3  # of the joint's frame
    axes: tuple[tuple[float, ...], ...]  # in the joint's frame
    element: Element

    @property
    def origin(self) -> Origin:
        return self.element.origin


class _SdfReader(ElementReader):
    def __init__(self, root: Element, folders: tuple[Path, ...], *, lenient: bool) -> None:
        super().__init__(root.path, lenient=lenient)
        self.root = root
        self.folders = folders
        self.elements: dict[str, Element] = {}  # links, frames, joints and models with a pose, by scoped name
        self.scopes: dict[str, str] = {}
        self.placements: dict[str, pin.SE3] = {WORLD: pin.SE3.Identity()}
        self.bodies: dict[str, Body] = {}
        self.free: list[tuple[str, Element]] = []  # free joints, with their scopes
        self.constraints: list[tuple[str, Element]] = []  # those of Drake, with their scopes
        self.held: tuple[str, ...] = ()  # models of a world, each held at its first link if nothing else holds it

    def read(self) -> Description:
        """Read the model."""
        worlds = children(self.root, "world")
        model = self._model((self.root, *worlds))
        self._register(model, "")
        links = {name: element for name, element in self.elements.items() if element.tag == "link"}
        if len(links) > MAX_BODIES:
            raise model.origin.error("<model>", f"has {len(links)} links, expected at most {MAX_BODIES}")
        self.bodies = {name: self._body(element, name) for name, element in links.items()}
        joint_elements = {name: element for name, element in self.elements.items() if element.tag == "joint"}
        gears = {name: element for name, element in joint_elements.items() if element.get("type") == "gearbox"}
        edges = [self._edge(name, element) for name, element in joint_elements.items() if name not in gears]
        edges += [self._free_edge(scope, element) for scope, element in self.free]
        drives = tuple(self._drives(model, {edge.name for edge in edges}))
        if self.held or any(WORLD in (edge.parent, edge.child) for edge in edges):
            self.bodies = {WORLD: Body(WORLD, origin=model.origin), **self.bodies}
        if not self.bodies:
            raise model.origin.error(named(model), "has no links, expected some")
        tree, cut = self._spanning_tree(edges, {drive.joint for drive in drives})
        joints = [joint for edge, turned in tree for joint in self._on_frame(edge, self._joints(edge, reverse=turned))]
        closure_frames, closures = self._closures(cut, tree)
        couplings = [c for edge in edges for c in self._mimic(edge, {joint.name for joint in joints})]
        frames = [
            Frame(name, self._link_of(name), Placement.from_se3(self._in(self._link_of(name), name)), element.origin)
            for name, element in self.elements.items()
            if element.tag == "frame" and name not in self.bodies and self._link_of(name) in self.bodies
        ]
        gravity = next((g for world in worlds if (g := child(world, "gravity")) is not None), None)
        driven = tuple(dict.fromkeys(drive.joint for drive in drives if drive.joint in {j.name for j in joints}))
        tree_alone = Description(model.get("name", "model"), tuple(self.bodies.values()), tuple(joints))
        couplings += [c for name, element in gears.items() for c in self._gearbox(name, element, tree_alone)]
        for scope, element in self.constraints:
            if element.tag == TENDON_CONSTRAINT:
                followed = {coupling.joint for coupling in couplings}
                leading = [drive.joint for drive in drives]
                tendon = tendon_coupling(self, element, tree_alone.joint_by_name, leading, followed, scope)
                couplings += [] if tendon is None else [tendon]
            else:
                self._constrain(scope, element, closure_frames, closures)
        return replace(
            tree_alone,
            frames=(*frames, *closure_frames),
            closures=tuple(closures),
            couplings=tuple(couplings),
            drives=drives,
            actuated_joints=driven if closures or couplings else (),
            gravity=(0.0, 0.0, -9.81) if gravity is None else self._texts(gravity, 3, ANY, "<gravity>"),
            configurations=self._home(edges),
            unread=tuple(self.unread),
            dialect="sdf",
            origin=self.root.origin,
        )

    @staticmethod
    def _home(edges: list[_Edge]) -> dict[str, dict[str, tuple[float, ...]]]:
        """Return the configuration of the file, of what is not at zero there."""
        free = [edge for edge in edges if edge.kind == "floating"]
        return {"home": {e.name: tuple(pin.SE3ToXYZQUAT(e.placement).tolist()) for e in free}} if free else {}

    def _model(self, parts: tuple[Element, ...]) -> Element:
        """Return the model; included and static ones, such as the ground, are read over where there is another.

        Several become parts of one model, as its nested models.
        """
        models = [model for part in parts for model in children(part, "model")]
        missing: list[tuple[Element, str]] = []
        for include in (include for part in parts for include in children(part, "include")):
            found = included_model(include, self.folders)
            if isinstance(found, Element):
                models.append(found)
            else:
                missing.append((include, found))
        for include, problem in reversed(missing):  # robots come after the sun and the ground
            if models:
                self.read_over(include, problem)
            else:
                self.refuse(include, problem)
        moving = [model for model in models if self._text(model, "static") not in ("true", "1")]
        for model in models if moving else []:
            if model not in moving:
                self.read_over(model, "is static, beside the robot")
        if len(moving or models) == 1:
            return (moving or models)[0]
        if not moving:
            raise self.root.origin.error("<sdf>", f"has {len(models)} models that move, expected some")
        whole = Element("model", {"name": parts[-1].get("name", Path(self.root.path).stem)})
        whole.path, whole.line = parts[-1].path, parts[-1].line
        whole.extend(part for world in parts for part in children(world, "frame", "joint"))
        whole.extend(moving)
        self.held = tuple(model.get("name", "") for model in moving)
        return whole

    # Names and poses

    def _register(self, model: Element, scope: str, depth: int = 0) -> None:
        self.check_children(model, _MODEL_PARTS, _MODEL_PASSED)
        for element in self._with_included(model, depth):
            if element.tag == "plugin" and not _controlled(element):
                self.read_over(element)
            if element.tag == _FREE_JOINT:
                self.free.append((scope, element))
            if element.tag in (*POINT_CONSTRAINTS, TENDON_CONSTRAINT):
                self.constraints.append((scope, element))
            if element.tag not in ("link", "joint", "frame", "model"):
                continue
            name = f"{scope}{element.get('name', '')}"
            if not element.get("name"):
                raise element.origin.error(f"<{element.tag}>", "has no name, expected one")
            if name in self.elements:
                raise element.origin.error(f"{element.tag} '{name}'", "is defined twice, expected unique names")
            self.elements[name], self.scopes[name] = element, scope
            if element.tag == "model":
                if element.get("placement_frame"):
                    self.refuse(element, "is placed by its placement_frame, which is not supported")
                self._register(element, f"{name}::", depth + 1)

    def _with_included(self, model: Element, depth: int) -> Iterator[Element]:
        """Yield the elements of a model, with the models that it includes, or their parts if they are merged."""
        for element in children(model):
            if element.tag != "include":
                yield element
                continue
            found: Element | list[Element] | str = included_model(element, self.folders, depth)
            if isinstance(found, Element) and is_merged(element):
                self.check_children(found, _MODEL_PARTS, _MODEL_PASSED)
                found = merged_parts(found)
            if isinstance(found, str):
                self.refuse(element, found)
            elif isinstance(found, list):
                yield from found
            else:
                yield found

    def _resolved(self, name: str, scope: str, element: Element) -> str:
        """Return the scoped name of what a reference means; the model's own frame is that of its scope."""
        if name in ("", "__model__", "__root__"):
            return scope.removesuffix("::")
        if name.endswith("::__model__"):
            name = name.removesuffix("::__model__")
        if name == WORLD:
            return WORLD
        if f"{scope}{name}" not in self.elements:
            raise element.origin.error(named(element), f"expected an existing frame, not '{name}'")
        return f"{scope}{name}"

    def _placement(self, name: str, within: tuple[str, ...] = ()) -> pin.SE3:
        """Return the placement of a link, joint, frame or nested model in the model."""
        if not name:
            return pin.SE3.Identity()
        if name in within:
            raise self.elements[name].origin.error(named(self.elements[name]), "its pose refers to itself")
        if name not in self.placements:
            element, scope = self.elements[name], self.scopes[name]
            pose = child(element, "pose")
            reference = "" if pose is None else pose.get("relative_to", "")
            if not reference and element.tag == "joint":
                reference = self._text(element, "child")
            if not reference and element.tag == "frame":
                reference = element.get("attached_to", "")
            base = self._placement(self._resolved(reference, scope, element), (*within, name))
            self.placements[name] = base * self._pose(element, named(element)).se3
        return self.placements[name]

    def _link_of(self, name: str, within: tuple[str, ...] = ()) -> str:
        """Return the body that a link, frame or joint is attached to."""
        if name == WORLD or name in self.bodies or name in within:
            return name
        if not name:  # the model's own frame
            return next((link for link, part in self.elements.items() if part.tag == "link"), WORLD)
        element = self.elements[name]
        if element.tag == "link":
            return name
        if element.tag == "model":
            links = [
                link for link, part in self.elements.items() if part.tag == "link" and link.startswith(f"{name}::")
            ]
            return links[0] if links else WORLD
        other = self._text(element, "child") if element.tag == "joint" else element.get("attached_to", "")
        return self._link_of(self._resolved(other, self.scopes[name], element), (*within, name))

    def _in(self, body: str, name: str) -> pin.SE3:
        return self._placement(body).actInv(self._placement(name))

    def _pose(self, element: Element, place: str) -> Placement:
        """Return the `<pose>` of an element, relative to whatever it refers to."""
        if (pose := child(element, "pose")) is None or not (pose.text or "").strip():
            return IDENTITY
        place = f"{place}: pose"
        is_quaternion = pose.get("rotation_format") == "quat_xyzw"
        numbers = self._texts(pose, 7 if is_quaternion else 6, ANY, place)
        if problem := LENGTH.problem(max(numbers[:3], key=abs)):
            raise pose.origin.error(place, problem)
        if is_quaternion:
            *position, x, y, z, w = numbers
            if not math.hypot(x, y, z, w):
                raise pose.origin.error(place, "expected a quaternion, not zero")
            return Placement.from_quaternion(tuple(position), (w, x, y, z))
        unit = math.radians(1.0) if pose.get("degrees") in ("true", "1") else 1.0
        return Placement.from_angles(numbers[:3], tuple(unit * angle for angle in numbers[3:]))

    @staticmethod
    def _text(element: Element | None, tag: str) -> str:
        found = child(element, tag)
        return "" if found is None else (found.text or "").strip()

    def _texts(self, element: Element, count: int, bounds: Bounds, place: str) -> tuple[float, ...]:
        """Return the numbers that are the text of an element."""
        shown = Element(element.tag, {"text": (element.text or "").strip()})
        shown.path, shown.line = element.path, element.line
        return self.numbers(shown, "text", count, bounds, place)

    def _value(self, element: Element | None, tag: str, bounds: Bounds, place: str, default: float) -> float:
        found = child(element, tag)
        if found is None or not (found.text or "").strip():  # an empty element has the default value
            return default
        return self._texts(found, 1, bounds, f"{place}: {tag}")[0]

    # Links

    def _body(self, element: Element, name: str) -> Body:
        place = f"link '{name}'"
        inertial = child(element, "inertial")
        if inertial is not None and inertial.get("auto") == "true":
            self.unread.append(Unread(f"{named(element)} inertial", inertial.origin, "auto is not computed: 1 kg"))
        mass = self._value(inertial, "mass", MASS, place, 1.0)
        inertia = child(inertial, "inertia")
        defaults = (1.0, 1.0, 1.0, 0.0, 0.0, 0.0)
        moments = tuple(
            self._value(inertia, key, PRODUCT, f"{place}: inertia", default)
            for key, default in zip(MOMENTS, defaults, strict=True)
        )
        matrix = inertia_matrix(moments)
        if is_reversed(mass, matrix):
            assert inertial is not None
            raise inertial.origin.error(f"{place}: inertia", inertia_problem(mass, matrix))
        centre = IDENTITY if inertial is None else self._pose(inertial, place)
        return Body(
            name,
            Inertial(mass, centre, moments),
            tuple(self._shapes(element, "visual", place)),
            tuple(self._shapes(element, "collision", place)),
            element.origin,
        )

    def _shapes(self, link: Element, tag: str, place: str) -> Iterator[Shape]:
        for element in children(link, tag):
            geometry = child(element, "geometry")
            for shape in [] if geometry is None else children(geometry):
                pose = self._pose(element, f"{place}: {tag}")
                colour = next(
                    (c for material in children(element, "material") for c in children(material, "diffuse")), None
                )
                rgba = None if colour is None else (*self._texts_of_colour(colour), 1.0)[:4]
                if shape.tag == "mesh":
                    uri = self._text(shape, "uri").replace("model://", "package://")
                    scale = child(shape, "scale")
                    scales = (1.0, 1.0, 1.0) if scale is None else self._texts(scale, 3, ANY, f"{place}: scale")
                    yield Shape("mesh", scales, pose, element.get("name", ""), uri, rgba)
                elif shape.tag in _SIZES:
                    kind, entries = _SIZES[shape.tag]
                    sizes = [
                        size
                        for key, count in entries
                        if (part := child(shape, key)) is not None
                        for size in self._texts(part, count, SIZE, f"{place}: {tag}: {shape.tag}: {key}")
                    ]
                    if len(sizes) == sum(count for _, count in entries):
                        yield Shape(kind, tuple(sizes), pose, element.get("name", ""), colour=rgba)
                else:
                    self.read_over(shape, f"in {place}")

    def _texts_of_colour(self, colour: Element) -> tuple[float, ...]:
        count = len((colour.text or "").split())
        return self._texts(colour, 3 if count == 3 else 4, ANY, "<diffuse>")

    # Joints

    def _edge(self, name: str, element: Element) -> _Edge:
        scope, kind, place = self.scopes[name], element.get("type", ""), f"joint '{name}'"
        self.check_children(element, (*_JOINT_PARTS, *_GEARS), ("physics", "sensor"))
        if kind not in _JOINT_TYPES and kind not in _TWO_AXES:
            known = ", ".join((*_JOINT_TYPES, *_TWO_AXES))
            raise element.origin.error(place, f"expected one of {known}, not '{kind}'")
        ends = []
        for tag in ("parent", "child"):
            given = self._text(element, tag) or self._text(child(element, tag), "link")
            if not given:
                raise element.origin.error(f"{place}: {tag}", "expected a link")
            ends.append(self._link_of(self._resolved(given, scope, element)))
        placement = self._placement(name)
        axes = _ANY_AXES
        if kind not in _WITHOUT_AXIS:  # what editors write there is of no use
            axes = tuple(self._axis(element, tag, scope, placement, place) for tag in ("axis", "axis2"))
        return _Edge(name, kind, ends[0], ends[1], placement, axes, element)

    def _free_edge(self, scope: str, element: Element) -> _Edge:
        name, link = f"{scope}{element.get('name', '')}", self._text(element, "child")
        if not element.get("name") or name in self.elements or not link:
            raise element.origin.error(named(element), "expected a name of its own, and a child")
        body = self._link_of(self._resolved(link, scope, element))
        return _Edge(name, "floating", WORLD, body, self._placement(body), _ANY_AXES, element)

    def _axis(self, element: Element, tag: str, scope: str, placement: pin.SE3, place: str) -> tuple[float, ...]:
        xyz = child(child(element, tag), "xyz")
        axis = np.array([0.0, 0.0, 1.0] if xyz is None else self._texts(xyz, 3, ANY, f"{place}: {tag}"))
        if not axis.any():
            assert xyz is not None
            raise xyz.origin.error(f"{place}: {tag}", "expected a direction, not zero")
        reference = None if xyz is None else xyz.get("expressed_in")
        if self._text(child(element, tag), "use_parent_model_frame") in ("true", "1"):
            reference = "__model__"
        if reference is not None:
            turn = self._placement(self._resolved(reference, scope, element)).rotation
            axis = placement.rotation.T @ turn @ axis
        return tuple((axis / np.linalg.norm(axis)).tolist())

    def _joints(self, edge: _Edge, *, reverse: bool) -> list[Joint]:
        """Return a joint of the tree, or two hinges of a universal one; reversed if its child carries its parent."""
        if edge.kind == "floating":
            return [Joint(edge.name, "floating", WORLD, edge.child, origin=edge.origin)]
        element, place = edge.element, f"joint '{edge.name}'"
        parent, other = (edge.child, edge.parent) if reverse else (edge.parent, edge.child)
        axis = child(element, "axis")
        limit, dynamics = child(axis, "limit"), child(axis, "dynamics")
        bounds = [self._limit(limit, key, place, sign * math.inf) for key, sign in (("lower", -1), ("upper", 1))]
        if bounds[0] > bounds[1]:
            assert limit is not None
            raise limit.origin.error(f"{place}: limit", f"expected lower <= upper, not {bounds[0]:g} and {bounds[1]:g}")
        lower, upper = (None if abs(bound) >= _UNLIMITED else bound for bound in bounds)
        effort, velocity = (self._limit(limit, key, place, -1.0) for key in ("effort", "velocity"))
        is_limited = edge.kind in ("revolute", "prismatic", "screw")
        kind = _JOINT_TYPES.get(edge.kind, "revolute")
        sign = -1.0 if reverse else 1.0
        joint = Joint(
            edge.name,
            kind,
            parent,
            other,
            self._placed(self._placement(parent).actInv(edge.placement)),
            self._placed(edge.placement.actInv(self._placement(other))),
            axis=tuple(sign * x + 0.0 for x in edge.axes[0]),
            lower=lower if is_limited else None,
            upper=upper if is_limited else None,
            effort=effort if 0.0 <= effort < _UNLIMITED else None,
            velocity=velocity if 0.0 <= velocity < _UNLIMITED else None,
            damping=self._value(dynamics, "damping", NOT_NEGATIVE, place, 0.0),
            friction=self._value(dynamics, "friction", NOT_NEGATIVE, place, 0.0),
            stiffness=self._value(dynamics, "spring_stiffness", ANY, place, 0.0),
            rest=self._value(dynamics, "spring_reference", ANY, place, 0.0),
            pitch=self._pitch(element, place),
            origin=edge.origin,
        )
        if edge.kind not in _TWO_AXES:
            return [joint]
        cross = free_name(f"{edge.name}_cross", self.bodies)
        self.bodies[cross] = Body(cross, origin=edge.origin)
        hinges = universal_hinges(joint, cross, "xy")
        axes = edge.axes[::-1] if reverse else edge.axes
        return [
            replace(hinge, axis=tuple(sign * x + 0.0 for x in axis)) for hinge, axis in zip(hinges, axes, strict=True)
        ]

    def _on_frame(self, edge: _Edge, joints: list[Joint]) -> list[Joint]:
        """Return joints of which the first is on the frame that the file names as its parent, if it names one.

        The frame becomes a body, fixed to its link: a spring there moves what the joint carries.
        """
        first, given = joints[0], self._text(edge.element, "parent")
        name = (
            self._resolved(given, self.scopes[edge.name], edge.element) if given and first.parent == edge.parent else ""
        )
        element = self.elements.get(name)
        if element is None or element.tag != "frame":
            return joints
        on_frame = replace(first, parent=name, placement=self._placed(self._placement(name).actInv(edge.placement)))
        if name in self.bodies:
            return [on_frame, *joints[1:]]
        self.bodies[name] = Body(name, origin=element.origin)
        seat = self._placed(self._in(first.parent, name))
        fixed = free_name(f"{name}_fixed", self.elements)
        return [Joint(fixed, "fixed", first.parent, name, seat, origin=element.origin), on_frame, *joints[1:]]

    def _limit(self, limit: Element | None, key: str, place: str, default: float) -> float:
        """Return a limit, which may be infinite or the greatest number of C++ if there is none."""
        text = self._text(limit, key).lower().lstrip("+")
        if text in ("inf", "-inf", "infinity", "-infinity"):
            return float(text)
        return self._value(limit, key, _LIMIT, f"{place}: limit", default)

    @staticmethod
    def _placed(placement: pin.SE3) -> Placement:
        return IDENTITY if placement.isIdentity(0.0) else Placement.from_se3(placement)

    def _pitch(self, element: Element, place: str) -> float:
        """Return the pitch of a screw [m/rad]; `thread_pitch` is its inverse with the opposite sign."""
        travel = self._value(element, "screw_thread_pitch", LENGTH, place, 0.0)
        turns = self._value(element, "thread_pitch", ANY, place, 0.0)
        return travel / (2.0 * math.pi) if travel or not turns else -1.0 / turns

    def _spanning_tree(self, edges: list[_Edge], driven: set[str]) -> tuple[list[tuple[_Edge, bool]], list[_Edge]]:
        """Return the joints of a tree, from the root on, each with whether it is reversed, and those that are cut."""
        component = {name: name for name in self.bodies}

        def top(name: str) -> str:
            while component[name] != name:
                component[name] = component[component[name]]
                name = component[name]
            return name

        kept: list[_Edge] = []
        for edge in sorted(edges, key=lambda e: _KEPT_FIRST.get(e.kind, 1 if e.name in driven else 2)):
            ends = top(edge.parent), top(edge.child)
            if ends[0] != ends[1]:
                kept.append(edge)
                component[ends[0]] = ends[1]
        children_of = {edge.child for edge in kept}
        roots = [name for name in self.bodies if name == WORLD or name not in children_of]
        root = WORLD if WORLD in self.bodies else (roots or list(self.bodies))[0]
        first_links: dict[str, str] = {}
        for body in self.bodies:
            first_links.setdefault(body.partition("::")[0], body)
        for name in self.held:
            link = first_links.get(name, WORLD)
            if top(link) != top(WORLD):
                held = self._placement(link)
                element = self.elements[name]
                edges.append(_Edge(f"{name}::held", "fixed", WORLD, link, held, ((0.0, 0.0, 1.0),) * 2, element))
                kept.append(edges[-1])
                component[top(link)] = top(WORLD)
        reached, tree = {root}, []
        are_kept = {edge.name for edge in kept}
        pending = [edge for edge in edges if edge.name in are_kept]
        while pending:
            found = next((e for e in pending if (e.parent in reached) != (e.child in reached)), None)
            if found is None:
                names = [name for name in self.bodies if name not in reached]
                raise self.root.origin.error("<model>", f"joints do not connect {', '.join(names[:4])} to '{root}'")
            pending.remove(found)
            tree.append((found, found.child in reached))
            reached |= {found.parent, found.child}
        if lost := [name for name in self.bodies if name not in reached]:
            raise self.root.origin.error("<model>", f"no joint connects '{lost[0]}' to '{root}': expected one tree")
        return tree, [edge for edge in edges if edge.name not in are_kept]

    def _closures(self, cut: list[_Edge], tree: list[tuple[_Edge, bool]]) -> tuple[list[Frame], list[LoopClosure]]:
        frames, closures = [], []
        part = {name: name for name in self.bodies}  # the highest body that fixed joints connect to each
        for edge, is_turned in tree:
            if edge.kind == "fixed":
                upper, lower = (edge.child, edge.parent) if is_turned else (edge.parent, edge.child)
                part[lower] = part[upper]
        for edge in cut:
            if edge.kind not in _CLOSURES:
                self.refuse(edge.element, f"a loop cannot be closed by a {edge.kind} joint")
                continue
            if part[edge.parent] == part[edge.child]:
                self.read_over(edge.element, "joins links that do not move to each other")
                continue
            names = []
            for body, end in ((edge.parent, "parent"), (edge.child, "child")):
                name = free_name(f"{edge.name}_{end}", {*self.bodies, *self.elements})
                placement = self._placed(self._placement(body).actInv(edge.placement))
                frames.append(Frame(name, body, placement, edge.origin))
                names.append(name)
            kind = _CLOSURES[edge.kind]
            axis = None if kind in ("6d", "3d") else _triple(edge.axes[0])
            second = _triple(edge.axes[1]) if kind == "universal" else None
            closures.append(LoopClosure(names[0], names[1], kind, axis=axis, axis_b=second, origin=edge.origin))
            reason = f"closes a loop: cut, and read as a closure of type {kind}"
            self.unread.append(Unread(named(edge.element), edge.origin, reason))
        return frames, closures

    def _constrain(self, scope: str, element: Element, frames: list[Frame], closures: list[LoopClosure]) -> None:
        """Read two points that coincide, or keep a distance, as Drake has them."""
        found, names = point_constraint(self, element), []
        for body, point, end in zip(found.bodies, found.points, "AB", strict=True):
            link = self._link_of(self._resolved(body, scope, element))
            placement = Placement.from_se3(self._in(link, self._resolved(body, scope, element)) * point.se3)
            taken = {*self.bodies, *self.elements, *(frame.name for frame in frames)}
            names.append(free_name(f"{scope}constraint{len(closures) + 1}_{end}", taken))
            frames.append(Frame(names[-1], link, placement, element.origin))
        closures.append(LoopClosure(names[0], names[1], found.kind, length=found.length, origin=element.origin))

    # Couplings and drives

    def _mimic(self, edge: _Edge, known: set[str]) -> Iterator[Coupling]:
        mimic = child(child(edge.element, "axis"), "mimic")
        if mimic is None:
            return
        place, leader = f"joint '{edge.name}': mimic", mimic.get("joint", "")
        scoped = f"{self.scopes[edge.name]}{leader}"
        if scoped not in known or edge.name not in known:
            self.refuse(mimic, f"expected an existing joint of the tree, not '{leader}'")
            return
        multiplier = self._value(mimic, "multiplier", ANY, place, 1.0)
        offset = self._value(mimic, "offset", ANY, place, 0.0) - multiplier * self._value(
            mimic, "reference", ANY, place, 0.0
        )
        yield Coupling.from_powers(edge.name, scoped, (offset, multiplier), mimic.origin)

    def _gearbox(self, name: str, element: Element, tree: Description) -> Iterator[Coupling]:
        scope, place = self.scopes[name], f"joint '{name}'"
        self.check_children(element, (*_JOINT_PARTS, *_GEARS), ("physics", "sensor"))
        ends = [
            self._link_of(self._resolved(self._text(element, tag), scope, element))
            for tag in ("parent", "child", "gearbox_reference_body")
        ]
        placement, tags = self._placement(name), ("axis", "axis2" if child(element, "axis2") is not None else "axis")
        in_root = self._placement(tree.root.name).rotation.T @ placement.rotation
        axes = [in_root @ self._axis(element, tag, scope, placement, place) for tag in tags]
        ratio = self._value(element, "gearbox_ratio", ANY, place, 1.0)
        coupling = gearbox_coupling(tree, ends[:2], ends[2], axes, ratio, element.origin)
        if isinstance(coupling, str):
            self.refuse(element, coupling)
        else:
            yield coupling

    def _drives(self, model: Element, joints: set[str]) -> Iterator[Drive]:
        """Yield the joints that a plugin of the model, or of one in it, controls."""
        scopes = {"": model} | {f"{name}::": part for name, part in self.elements.items() if part.tag == "model"}
        for scope, part in scopes.items():
            for plugin in children(part, "plugin"):
                for name in (f"{scope}{joint}" for joint in _controlled(plugin)):
                    if name in joints:
                        yield Drive(name, name, origin=plugin.origin)


def _controlled(plugin: Element) -> list[str]:
    """Return the names of the joints that a plugin moves: not of those that it only watches."""
    kind = "".join(plugin.get(key, "") for key in ("name", "filename")).lower().replace("_", "").replace("-", "")
    if any(watcher in kind for watcher in _WATCHERS):
        return []
    return [(entry.text or "").strip() for entry in children(plugin, "joint_name")]


def _triple(axis: tuple[float, ...]) -> Axis:
    x, y, z = axis
    return x, y, z
