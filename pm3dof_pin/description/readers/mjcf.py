"""MJCF, as MuJoCo reads it: bodies, joints, equalities, actuators and keyframes of a compiled model.

A coordinate is MuJoCo's `qpos`, quaternions in Pinocchio's order. A weld or connect by bodies holds them as they are in
the initial configuration, unless it says otherwise. MuJoCo itself is not needed to read a model; the tests hold this
reader against it.
"""

from __future__ import annotations

import logging
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.coordinates import Command
from pm3dof_pin.description.couplings import Coupling, polynomial_of_difference
from pm3dof_pin.description.description import (
    IDENTITY,
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
    Unread,
)
from pm3dof_pin.description.inertia_checks import inertia_matrix, inertia_problem, is_reversed
from pm3dof_pin.description.mesh_files import read_meshes
from pm3dof_pin.description.own_files import require_own
from pm3dof_pin.description.physical_bounds import ANY, LENGTH, MASS, MOMENT, NOT_NEGATIVE, SIZE, Bounds
from pm3dof_pin.description.readers.control_laws import BIASES, LAGS, with_control_law
from pm3dof_pin.description.readers.elements import ElementReader, free_name, named
from pm3dof_pin.description.readers.mjcf_document import TIMES, MjcfDocument
from pm3dof_pin.description.readers.mjcf_inertia import SOLIDS, geom_inertia, mesh_inertia
from pm3dof_pin.description.xml_file import Element, child, children
from pm3dof_pin.exceptions import FrameNotFoundError, InvalidValueError, JointNotFoundError

_logger = logging.getLogger(__name__)

_TOOL_SITES = ("tool", "tool_frame", "tool0", "tcp", "ee", "eef", "end_effector", "attachment_site")
_HOME, _INITIAL = "home", "qpos0"
_STIFFNESS = Bounds("N/m or N m/rad", 1e18)
_JOINT_TYPES: dict[str, JointType] = {
    "hinge": "revolute", "slide": "prismatic", "ball": "spherical", "free": "floating",
}  # fmt: skip
_HIDDEN_GROUP = 3  # geoms of this group and later ones are not shown by default
_SECTIONS = ("compiler", "default", "asset", "worldbody", "equality", "actuator", "keyframe", "tendon", "option")
_PASSED_SECTIONS = (
    *("contact", "sensor", "size", "visual", "statistic", "extension", "custom", "deformable", "mujoco"),
)
_BODY_PARTS = (
    *("inertial", "joint", "freejoint", "geom", "site", "body", "frame", "camera", "light", "plugin"),
    *("composite", "flexcomp", "attach", "replicate"),
)
_JOINT_ATTRIBUTES = frozenset({
    "name", "class", "type", "group", "pos", "axis", "springdamper", "solreflimit", "solimplimit", "solreffriction",
    "solimpfriction", "stiffness", "range", "limited", "actuatorfrcrange", "actuatorfrclimited", "actuatorgravcomp",
    "margin", "ref", "springref", "armature", "damping", "frictionloss", "user", "align",
})  # fmt: skip

_Pose: TypeAlias = pin.SE3


def read_mjcf(
    path: Path, folders: tuple[Path, ...] = (), *, lenient: bool = False, root: Element | None = None
) -> Description:
    """Read an MJCF model, with includes and attached models from `folders`, by default those of its own package.

    `root` is the root element if it is known already.

    Raises:
        DescriptionError: a file is unreadable or not XML, a number is malformed or impossible, or an element that could
            carry a loop, a coupling or a drive is not supported.
        FrameNotFoundError: an equality refers to an unknown body.
        JointNotFoundError: an actuator, tendon or equality refers to an unknown joint.
    """
    return _MjcfReader(MjcfDocument(path, folders, root=root), lenient=lenient).read()


@dataclass(frozen=True)
class _Context:
    """Where the parts of a body stand: the body, their frame in it, the class around them, and the initial pose."""

    body: str
    frame: _Pose
    default_class: str
    world: _Pose


class _MjcfReader(ElementReader):
    def __init__(self, document: MjcfDocument, *, lenient: bool) -> None:
        super().__init__(document.path, lenient=lenient)
        self.document = document
        self.bodies: dict[str, Body] = {WORLD: Body(WORLD, origin=document.root.origin)}
        self.joints: list[Joint] = []
        self.frames: dict[str, Frame] = {}
        self.sites: dict[str, str] = {}
        #: placements of bodies in the initial configuration
        self.initial: dict[str, _Pose] = {WORLD: pin.SE3.Identity()}
        self.taken = {WORLD}
        self.qpos: list[tuple[Joint, tuple[float, ...]]] = []  # joints in MuJoCo's order, with their initial numbers
        self.limited_balls: list[str] = []
        self.unknown_masses: list[str] = []
        self.compensated: list[str] = []
        self._meshes: dict[str, Element] = {}

    def read(self) -> Description:
        """Read the whole model."""
        document, root = self.document, self.document.root
        self.check_children(root, _SECTIONS, _PASSED_SECTIONS)
        for mesh in (entry for entry in document.sections("asset") if entry.tag == "mesh"):
            self._meshes[mesh.get("name") or Path(mesh.get("file", "")).stem] = mesh
        worlds = children(root, "worldbody")
        names = [element.get("name", "") for world in worlds for element in world.iter("body")]
        self.taken |= {name for name in names if name}
        context = _Context(WORLD, pin.SE3.Identity(), document.defaults.main, pin.SE3.Identity())
        for world in worlds:
            self._parts(world, context)
        self._warn()
        couplings, fixed = self._couplings()
        closures = self._closures()
        drives, tendon_parts = self._drives(couplings)
        for drive in (drive for drive in drives if drive.joint in fixed):
            said = f"drives joint '{drive.joint}', which an equality holds"
            self.unread.append(Unread(f"<actuator> '{drive.name}'", drive.origin, said))
        drives = tuple(drive for drive in drives if drive.joint not in fixed)
        springs = self._springs(couplings, tendon_parts)
        description = Description(
            root.get("model") or document.path.stem,
            (*self._scaled_bodies(), *tendon_parts[0]),
            (*(self._held(joint, fixed) for joint in self.joints), *tendon_parts[1]),
            tuple(self.frames.values()),
            closures,
            (*couplings, *tendon_parts[2]),
            drives,
            tuple(dict.fromkeys(drive.joint for drive in drives)),
            self._commands(drives),
            tool_frame=next((self.sites[name] for name in _TOOL_SITES if name in self.sites), None),
            springs=springs,
            configurations=self._configurations(fixed),
            untouchable=tuple(
                (entry.get("body1", WORLD), entry.get("body2", WORLD))
                for entry in document.sections("contact")
                if entry.tag == "exclude"
            ),
            gravity=self._gravity(),
            dialect="mjcf",
            origin=root.origin,
        )
        return replace(description, unread=tuple(self.unread))

    def _warn(self) -> None:
        for names, said in (
            (self.limited_balls, "the ranges of ball joints are ignored"),
            (self.compensated, "gravcomp is ignored, so that their weight is not compensated"),
            (self.unknown_masses, "masses of meshes are not computed, as their files are missing; give <inertial>"),
        ):
            if names:
                _logger.warning("%s: %s: %s", self.path, said, ", ".join(names))

    # Bodies

    def _parts(self, element: Element, context: _Context) -> None:
        """Read what stands in a body or frame, except the body's own joints and inertia."""
        for part in children(element):
            match part.tag:
                case "body":
                    self._body(part, context)
                case "frame":
                    pose = context.frame * self._pose(part)
                    inner = part.get("childclass") or context.default_class
                    self._parts(part, replace(context, frame=pose, default_class=inner))
                case "site":
                    self._site(part, context)
                case "geom":
                    self._geom(part, context)
                case "composite" | "flexcomp":
                    self.refuse(part, "is not supported: expected the bodies written out")
                case "joint" | "freejoint" if context.body == WORLD:
                    raise part.origin.error(named(part), "expected a joint in a body, not in the world")

    def _body(self, element: Element, outer: _Context) -> None:
        self.check_children(element, _BODY_PARTS)
        name = element.get("name") or free_name(f"body{len(self.bodies)}", self.taken)
        if name in self.bodies:
            raise element.origin.error(f"body '{name}'", "is defined twice, expected unique names")
        self.taken.add(name)
        default_class = element.get("childclass") or outer.default_class
        pose = outer.frame * self._pose(element)
        joints = [(joint, pin.SE3.Identity()) for joint in children(element, "joint", "freejoint")]
        pending = [(frame, self._pose(frame)) for frame in children(element, "frame")]
        while pending:  # joints may stand in frames
            frame, placed = pending.pop()
            joints += [(joint, placed) for joint in children(frame, "joint", "freejoint")]
            pending += [(inner, placed * self._pose(inner)) for inner in children(frame, "frame")]
        self.bodies[name] = Body(name, origin=element.origin)
        self.initial[name] = outer.world * pose
        self._add_joints(element, joints, name, outer.body, pose, default_class)
        if self.number(element, "gravcomp", ANY, named(element), 0.0):
            self.compensated.append(name)
        context = _Context(name, pin.SE3.Identity(), default_class, self.initial[name])
        self._parts(element, context)
        inertial = child(element, "inertial")
        source = self.document.compiler_of(element).get("inertiafromgeom", "auto")
        if inertial is not None and source != "true":
            given = self._inertial(inertial)
            self.bodies[name] = replace(self.bodies[name], inertial=given)
        else:
            self._add_geom_inertia(element, name, default_class)

    def _add_joints(
        self, body: Element, elements: list[tuple[Element, _Pose]], name: str, parent: str, pose: _Pose, cls: str
    ) -> None:
        """Add the joints of a body, one after the other, with massless bodies between them; or fix the body."""
        if not elements:
            fixed = free_name(f"{name}_fixed", [joint.name for joint in self.joints])
            self.joints.append(Joint(fixed, "fixed", parent, name, Placement.from_se3(pose), origin=body.origin))
        for index, (element, frame) in enumerate(elements):
            last = index == len(elements) - 1
            joint_name = element.get("name") or f"{name}_joint{index if len(elements) > 1 else ''}"
            carried = name
            if not last:
                carried = free_name(f"{joint_name}_body", self.taken)
                self.taken.add(carried)
                self.bodies[carried] = Body(carried, origin=element.origin)
                self.initial[carried] = self.initial[name]
            joint = self._joint(element, joint_name, cls, frame)
            if joint.type == "floating":
                if parent != WORLD or index:
                    raise element.origin.error(
                        named(element), "expected a free joint as the only one of a world's body"
                    )
                turn = pin.Quaternion(pose.rotation).coeffs()
                numbers = (*map(float, pose.translation), *map(float, turn))
                placement, inner = pin.SE3.Identity(), IDENTITY
            else:
                anchor = pin.SE3(np.eye(3), np.array(joint.placement.position))
                placement, inner = pose * anchor, Placement.from_se3(anchor.inverse())
                numbers = (0.0, 0.0, 0.0, 1.0) if joint.type == "spherical" else (joint.zero,)
            joint = replace(
                joint,
                parent=parent,
                child=carried,
                placement=Placement.from_se3(placement),
                child_placement=IDENTITY if inner.is_identity else inner,
            )
            self.joints.append(joint)
            self.qpos.append((joint, numbers))
            parent, pose = carried, pin.SE3.Identity()

    def _joint(self, given: Element, name: str, cls: str, frame: _Pose) -> Joint:
        """Return a joint with its anchor in the body as placement; its bodies are still to be named."""
        element = self._resolved(given, cls)
        place, kind = named(given), "free" if given.tag == "freejoint" else element.get("type", "hinge")
        self.check_children(given, ("plugin",), (), _JOINT_ATTRIBUTES)
        if kind not in _JOINT_TYPES:
            raise given.origin.error(place, f"expected a hinge, slide, ball or free joint, not '{kind}'")
        unit = self._angle_unit(given) if kind in ("hinge", "ball") else 1.0
        axis = self.numbers(element, "axis", 3, ANY, place, (0.0, 0.0, 1.0))
        if not any(axis):
            raise given.origin.error(f"{place}: axis", "expected a direction, not zero")
        axis = tuple((frame.rotation @ np.array(axis) / np.linalg.norm(axis)).tolist()) if kind != "free" else axis
        anchor = frame.act(np.array(self.numbers(element, "pos", 3, LENGTH, place, (0.0, 0.0, 0.0))))
        lower, upper = self._range(element, "range", place, unit)
        is_limited = self._is_limited(element, given, "limited")
        if kind == "ball" and is_limited and upper:
            self.limited_balls.append(name)
        stiffness = (*self.numbers(element, "stiffness", None, _STIFFNESS, place, (0.0,)), 0.0)[0]
        if stiffness and kind in ("ball", "free"):
            _logger.warning("%s: the spring of joint '%s' is ignored", self.path, name)
            stiffness = 0.0
        force = self._range(element, "actuatorfrcrange", place, 1.0)[1]
        has_range = kind in ("hinge", "slide") and is_limited
        zero = unit * self.number(element, "ref", ANY, place, 0.0) if kind in ("hinge", "slide") else 0.0
        damping = (*self.numbers(element, "damping", None, NOT_NEGATIVE, place, (0.0,)), 0.0)[0]
        return Joint(
            name,
            _JOINT_TYPES[kind],
            "",
            "",
            Placement(tuple(anchor.tolist())),
            axis=axis,
            lower=lower if has_range else None,
            upper=upper if has_range else None,
            effort=force,
            damping=damping,
            friction=self.number(element, "frictionloss", NOT_NEGATIVE, place, 0.0),
            armature=self.number(element, "armature", NOT_NEGATIVE, place, 0.0),
            stiffness=stiffness,
            rest=unit * self.number(element, "springref", ANY, place, 0.0),
            zero=zero,
            origin=given.origin,
        )

    def _range(self, element: Element, key: str, place: str, unit: float) -> tuple[float | None, float | None]:
        if key not in element.attrib:
            return None, None
        lower, upper = self.numbers(element, key, 2, ANY, place)
        if lower > upper:
            raise element.origin.error(f"{place}: {key}", f"expected lower <= upper, not {lower:g} and {upper:g}")
        return unit * lower, unit * upper

    def _is_limited(self, element: Element, given: Element, key: str) -> bool:
        value = element.get(key, "auto")
        if value == "auto":
            return self.document.compiler_of(given).get("autolimits", "true") != "false"
        return value == "true"

    def _site(self, element: Element, context: _Context) -> None:
        if "name" not in element.attrib:
            return
        resolved = self._resolved(element, context.default_class)
        name = free_name(element.attrib["name"], {*self.taken, *self.frames}, "_site")
        self.sites[element.attrib["name"]] = name
        pose = Placement.from_se3(context.frame * self._pose(resolved, element))
        self.frames[name] = Frame(name, context.body, pose, element.origin)

    # Inertia

    def _inertial(self, element: Element) -> Inertial:
        place = named(element)
        if "mass" not in element.attrib:
            raise element.origin.error(place, "has no mass, expected one")
        mass = self.numbers(element, "mass", 1, MASS, place)[0]
        if "fullinertia" in element.attrib:
            moments = self.numbers(element, "fullinertia", 6, ANY, place)
        else:
            moments = (*self.numbers(element, "diaginertia", 3, MOMENT, place, (0.0, 0.0, 0.0)), 0.0, 0.0, 0.0)
        matrix = inertia_matrix(moments)
        if is_reversed(mass, matrix):
            raise element.origin.error(f"{place}: inertia", inertia_problem(mass, matrix))
        return Inertial(mass, Placement.from_se3(self._pose(element)), moments)

    def _add_geom_inertia(self, body: Element, name: str, default_class: str) -> None:
        total = pin.Inertia.Zero()
        compiler = self.document.compiler_of(body)
        first, last = (int(float(word)) for word in compiler.get("inertiagrouprange", "0 5").split())
        for given, frame, cls in self._geoms(body, pin.SE3.Identity(), default_class):
            element = self._resolved(given, cls)
            if not first <= int(self.number(element, "group", ANY, named(given), 0.0)) <= last:
                continue
            if (inertia := self._geom_mass(element, given, name)) is not None:
                total += (frame * self._geom_pose(element, given)).act(inertia)
        if total.mass > 0.0:
            self.bodies[name] = replace(self.bodies[name], inertial=Inertial.from_inertia(total))

    def _geoms(self, element: Element, frame: _Pose, cls: str) -> list[tuple[Element, _Pose, str]]:
        """Return the geoms of a body, also in frames, each with the frame that it stands in and its class."""
        found = [(geom, frame, cls) for geom in children(element, "geom")]
        for inner in children(element, "frame"):
            found += self._geoms(inner, frame * self._pose(inner), inner.get("childclass") or cls)
        return found

    def _geom_mass(self, element: Element, given: Element, body: str) -> pin.Inertia | None:
        place, kind = named(given), element.get("type", "sphere")
        mass = self.number(element, "mass", MASS, place, None)
        density = self.number(element, "density", NOT_NEGATIVE, place, 1000.0)  # kg/m^3
        if mass == 0.0 or (mass is None and density == 0.0):
            return None
        shell = element.get("shellinertia") == "true"
        if "mesh" in element.attrib:
            mesh = self._triangles(element, given)
            if mesh is None or kind != "mesh":
                self.unknown_masses.append(body)
                return None
            method = "shell" if shell else mesh[2]
            return mesh_inertia(mesh[0], mesh[1], mass, density, method)
        if kind not in SOLIDS:
            return None
        sizes = self._sizes(element, place, kind)
        if 0.0 in sizes[: SOLIDS[kind][0]]:
            raise given.origin.error(place, f"a {kind} without size has no inertia: expected {SOLIDS[kind][0]} sizes")
        return geom_inertia(kind, sizes, mass, density, shell=shell)

    def _sizes(self, element: Element, place: str, kind: str) -> tuple[float, ...]:
        sizes = list(self.numbers(element, "size", None, SIZE, place, (0.0,)))[:3]
        sizes += [0.0] * (3 - len(sizes))
        if "fromto" in element.attrib:
            numbers = np.array(self.numbers(element, "fromto", 6, LENGTH, place))
            half = 0.5 * float(np.linalg.norm(numbers[3:] - numbers[:3]))
            sizes = [sizes[0], half, 0.0] if kind in ("capsule", "cylinder") else [sizes[0], sizes[0], half]
        return tuple(sizes)

    def _triangles(self, element: Element, given: Element) -> tuple[np.ndarray, np.ndarray, str] | None:
        """Return vertices [m] and faces of a geom's mesh, and the method of its inertia; None without its file."""
        name = element.get("mesh", "")
        if (asset := self._meshes.get(name)) is None:
            raise given.origin.error(named(given), f"expected an existing mesh, not '{name}'")
        mesh = self._resolved(asset, "")
        scale = np.array(self.numbers(mesh, "scale", 3, ANY, named(asset), (1.0, 1.0, 1.0)))
        if "vertex" in mesh.attrib:
            vertices = np.array(self.numbers(mesh, "vertex", None, ANY, named(asset))).reshape(-1, 3)
            faces = np.array(self.numbers(mesh, "face", None, ANY, named(asset), ()), dtype=int).reshape(-1, 3)
            if not len(faces):
                faces = _hull(vertices)
        else:
            path = self.document.asset_path(asset, "meshdir")
            require_own(path, self.document.folders, asset.origin, named(asset))
            if not path.is_file() or path.suffix.lower() == ".msh":
                return None
            if not (parts := read_meshes(path)):
                return None
            ends = np.cumsum([0, *(len(part.vertices) for part in parts)])
            vertices = np.concatenate([np.asarray(part.vertices) for part in parts])
            faces = np.concatenate([np.asarray(part.faces) + end for part, end in zip(parts, ends, strict=False)])
        method = mesh.get("inertia", "legacy")
        if method == "convex":
            faces = _hull(vertices)
        reference = self._reference(mesh, asset)
        moved = (vertices - reference.translation) @ reference.rotation * scale
        return moved, faces if scale.prod() > 0.0 else faces[:, ::-1], method

    def _reference(self, mesh: Element, asset: Element) -> _Pose:
        """Return the frame in a mesh's file that its `refpos` and `refquat` make its own."""
        place = named(asset)
        position = self.numbers(mesh, "refpos", 3, ANY, place, (0.0, 0.0, 0.0))
        turn = self.numbers(mesh, "refquat", 4, ANY, place, (1.0, 0.0, 0.0, 0.0))
        return Placement.from_quaternion(position, turn).se3

    def _scaled_bodies(self) -> list[Body]:
        """Return the bodies with the total mass, and least masses, that the compiler settings ask for."""
        compiler, root = self.document.compiler, self.document.root
        section = child(root, "compiler")
        section = root if section is None else section
        bodies = list(self.bodies.values())
        settings = Element("compiler", dict(compiler))
        settings.path, settings.line = section.path, section.line
        least_mass = self.number(settings, "boundmass", NOT_NEGATIVE, "<compiler>", 0.0)
        least_moment = self.number(settings, "boundinertia", NOT_NEGATIVE, "<compiler>", 0.0)
        balances = compiler.get("balanceinertia") == "true"
        if least_mass or least_moment or balances:
            moved = {joint.child for joint in self.joints} - {WORLD}
            bodies = [
                _bounded(body, least_mass, least_moment, balances) if body.name in moved else body for body in bodies
            ]
        total = self.number(settings, "settotalmass", ANY, "<compiler>", -1.0)
        present = sum(body.mass for body in bodies if body.name != WORLD)
        if total > 0.0 and present > 0.0:
            bodies = [_with_mass_times(body, total / present) for body in bodies]
        return bodies

    # Shapes

    def _geom(self, given: Element, context: _Context) -> None:
        element = self._resolved(given, context.default_class)
        place, kind = named(given), element.get("type", "sphere")
        pose = Placement.from_se3(context.frame * self._geom_pose(element, given))
        colour = self._colour(element, given)
        if "mesh" in element.attrib:
            asset = self._meshes.get(element.attrib["mesh"])
            if asset is None or "file" not in asset.attrib:
                return
            mesh = self._resolved(asset, "")
            scale = self.numbers(mesh, "scale", 3, ANY, named(asset), (1.0, 1.0, 1.0))
            pose = Placement.from_se3(pose.se3 * self._reference(mesh, asset).inverse())
            path = str(self.document.asset_path(asset, "meshdir"))
            shape = Shape("mesh", scale, pose, given.get("name", ""), path, colour)
        elif kind in SOLIDS:
            x, y, z = self._sizes(element, place, kind)
            name = given.get("name", "")
            match kind:
                case "sphere":
                    shape = Shape("sphere", (x,), pose, name, colour=colour)
                case "box":
                    shape = Shape("box", (2.0 * x, 2.0 * y, 2.0 * z), pose, name, colour=colour)
                case "ellipsoid":
                    shape = Shape("ellipsoid", (x, y, z), pose, name, colour=colour)
                case "capsule":
                    shape = Shape("capsule", (x, 2.0 * y), pose, name, colour=colour)
                case _:
                    shape = Shape("cylinder", (x, 2.0 * y), pose, name, colour=colour)
        else:  # planes and height fields are scenery
            return
        body = self.bodies[context.body]
        if self.number(element, "group", ANY, place, 0.0) < _HIDDEN_GROUP:
            body = replace(body, visuals=(*body.visuals, shape))
        if element.get("contype", "1") != "0" or element.get("conaffinity", "1") != "0":
            body = replace(body, collisions=(*body.collisions, shape))
        self.bodies[context.body] = body

    def _colour(self, element: Element, given: Element) -> tuple[float, ...] | None:
        if "rgba" in element.attrib:
            return self.numbers(element, "rgba", 4, ANY, named(given))
        for material in self.document.sections("asset"):
            if material.tag == "material" and material.get("name") == element.get("material", ""):
                return self.numbers(self._resolved(material, ""), "rgba", 4, ANY, named(material), (1.0,) * 4)
        return None

    def _geom_pose(self, element: Element, given: Element) -> _Pose:
        if "fromto" not in element.attrib:
            return self._pose(element, given)
        numbers = np.array(self.numbers(element, "fromto", 6, LENGTH, named(given)))
        return pin.SE3(_turn_z_to(numbers[:3] - numbers[3:]), 0.5 * (numbers[:3] + numbers[3:]))

    # Equalities

    def _closures(self) -> tuple[LoopClosure, ...]:
        closures = []
        for index, given in enumerate(self.document.sections("equality")):
            element = self._resolved(given, "", kind="equality")
            if given.tag == "joint" or not self._is_active(element, given):
                continue
            if given.tag == "tendon":
                tendon, excess = self._held_tendon(element, given)
                if tendon is not None and tendon.tag == "spatial":
                    closures += self._distance(tendon, given, excess)
                continue
            if given.tag not in ("connect", "weld"):
                self.refuse(given, "is not supported")
                continue
            name = given.get("name") or f"{given.tag}{index + 1}"
            place = f"<{given.tag} name='{name}'>"
            holds_turn = given.tag == "weld" and self.number(element, "torquescale", ANY, place, 1.0) != 0.0
            if "site1" in element.attrib:
                frames = tuple(self.sites.get(element.get(key, ""), "") for key in ("site1", "site2"))
                if not all(frames):
                    raise given.origin.error(place, "expected existing sites")
            else:
                frames = self._closure_frames(element, given, name, place)
            if self._carrier(frames[0]) == self._carrier(frames[1]):
                self.read_over(given, "joins bodies that do not move to each other")
                continue
            closures.append(LoopClosure(frames[0], frames[1], "6d" if holds_turn else "3d", origin=given.origin))
        return tuple(closures)

    def _carrier(self, frame: str) -> str:
        """Return the body that moves a frame: none of those above it moves to it."""
        above = {joint.child: joint for joint in self.joints}
        body = self.frames[frame].body
        while body in above and above[body].is_fixed:
            body = above[body].parent
        return body

    def _closure_frames(self, element: Element, given: Element, name: str, place: str) -> tuple[str, str]:
        """Add the frames at which an equality holds two bodies, by default as they are initially."""
        bodies = [element.get(key, WORLD) for key in ("body1", "body2")]
        for body in bodies:
            if body not in self.bodies:
                raise FrameNotFoundError(body, f"{given.origin}: {place}", list(self.bodies))
        first, second = (self.initial[body] for body in bodies)
        between = first.actInv(second)
        anchor = pin.SE3(np.eye(3), np.array(self.numbers(element, "anchor", 3, LENGTH, place, (0.0, 0.0, 0.0))))
        relative = self.numbers(element, "relpose", 7, ANY, place, (0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0))
        if given.tag == "connect":
            placements = anchor, between.actInv(anchor)
        elif any(relative[3:]):
            placements = Placement.from_quaternion(relative[:3], relative[3:]).se3, anchor
        else:
            placements = between * anchor, anchor
        names = []
        for body, placement in zip(bodies, placements, strict=True):
            frame = free_name(f"{name}_{body}", {*self.taken, *self.frames})
            self.frames[frame] = Frame(frame, body, Placement.from_se3(placement), given.origin)
            names.append(frame)
        return names[0], names[1]

    def _held_tendon(self, element: Element, given: Element) -> tuple[Element | None, float]:
        """Return the tendon that an equality holds, None if it is not read, and its length beyond the initial one."""
        place = named(given)
        tendons = {tendon.get("name", ""): tendon for tendon in self.document.sections("tendon")}
        tendon = tendons.get(element.get("tendon1", ""))
        if tendon is None:
            raise given.origin.error(place, f"expected an existing tendon, not '{element.get('tendon1', '')}'")
        if element.get("tendon2"):
            self.refuse(given, "is not supported: of two tendons")
            return None, 0.0
        return tendon, self.numbers(element, "polycoef", None, ANY, place, (0.0,))[0]

    def _distance(self, tendon: Element, given: Element, excess: float) -> list[LoopClosure]:
        """Return the closure by which a straight tendon between two sites keeps its length; none for others."""
        frames = [self.sites.get(entry.get("site", ""), "") for entry in children(tendon, "site")]
        if len(frames) != len(children(tendon)) or len(frames) != 2 or not all(frames):
            self.refuse(tendon, "is held by an equality, expected two existing sites and nothing else")
            return []
        ends = [self.initial[self.frames[name].body] * self.frames[name].placement.se3 for name in frames]
        length = float(np.linalg.norm(ends[1].translation - ends[0].translation)) + excess
        try:
            return [LoopClosure(frames[0], frames[1], "distance", length=length, origin=given.origin)]
        except InvalidValueError as error:
            raise given.origin.error(named(given), f"expected a positive length, not {length:g}") from error

    def _fixed_tendon(self, tendon: Element, excess: float, zeros: dict[str, float]) -> Coupling | tuple[str, float]:
        """Return the coupling by which a fixed tendon keeps its length; of one joint, its name and coordinate."""
        place = named(tendon)
        factors: dict[str, float] = {}
        for entry in children(tendon, "joint"):
            name = entry.get("joint", "")
            self._require_single(name, f"{entry.origin}: {place}")
            factors[name] = factors.get(name, 0.0) + self.numbers(entry, "coef", 1, ANY, place)[0]
        follower = next((name for name, factor in factors.items() if factor != 0.0), None)
        if follower is None:
            raise tendon.origin.error(place, "has no joints, expected some")
        share = factors.pop(follower)
        offset = excess / share + zeros[follower]
        others = {name: -factor / share for name, factor in factors.items() if factor != 0.0}
        if not others:
            return follower, offset
        offset -= sum(ratio * zeros[name] for name, ratio in others.items())
        ratios = tuple((ratio,) for ratio in others.values())
        return Coupling(follower, tuple(others), ratios, offset, tendon.origin)

    def _is_active(self, element: Element, given: Element) -> bool:
        if element.get("active") == "false":
            self.read_over(given, "is not active")
            return False
        return True

    def _couplings(self) -> tuple[list[Coupling], dict[str, float]]:
        """Return the couplings of joints, and the coordinates at which equalities hold joints."""
        couplings: list[Coupling] = []
        held: dict[str, float] = {}
        zeros = {joint.name: joint.zero for joint in self.joints}
        for given in self.document.sections("equality"):
            if given.tag not in ("joint", "tendon"):
                continue
            element = self._resolved(given, "", kind="equality")
            if not self._is_active(element, given):
                continue
            place = named(given)
            if given.tag == "tendon":
                tendon, excess = self._held_tendon(element, given)
                if tendon is not None and tendon.tag == "fixed":
                    found = self._fixed_tendon(tendon, excess, zeros)
                    if isinstance(found, Coupling):
                        couplings.append(found)
                    else:
                        held[found[0]] = found[1]
                continue
            powers = self.numbers(element, "polycoef", None, ANY, place, (0.0, 1.0, 0.0, 0.0, 0.0))
            powers = (*powers, *(0.0,) * (5 - len(powers)))[:5]
            names = [element.get(key, "") for key in ("joint1", "joint2")]
            for name in names if names[1] else names[:1]:
                self._require_single(name, f"{given.origin}: {place}")
            if names[1]:
                shifted = polynomial_of_difference(powers, zeros[names[1]])
                shifted[0] += zeros[names[0]]
                couplings.append(Coupling.from_powers(names[0], names[1], shifted, given.origin))
            else:
                held[names[0]] = zeros[names[0]] + powers[0]
        return self._without_held(couplings, held), held

    @staticmethod
    def _without_held(couplings: list[Coupling], held: dict[str, float]) -> list[Coupling]:
        """Return the couplings without joints that are held; joints that follow only such ones are held too."""
        pending, left = list(couplings), list[Coupling]()
        while pending:
            coupling = pending.pop(0)
            free = [name for name in coupling.joints if name not in held]
            if len(free) == len(coupling.joints):
                left.append(coupling)
                continue
            offset = coupling.value([held.get(name, 0.0) for name in coupling.joints])
            if free:
                powers = dict(zip(coupling.joints, coupling.coefficients, strict=True))
                coefficients = tuple(powers[name] for name in free)
                left.append(Coupling(coupling.joint, tuple(free), coefficients, offset, coupling.origin))
            elif coupling.joint not in held:
                held[coupling.joint] = offset
                pending, left = [*left, *pending], []
        return left

    @staticmethod
    def _held(joint: Joint, held: dict[str, float]) -> Joint:
        """Return a joint that an equality holds at a coordinate as a fixed one."""
        if joint.name not in held:
            return joint
        moved = joint.motion(held[joint.name] - joint.zero)
        return replace(joint, type="fixed", placement=Placement.from_se3(joint.placement.se3 * moved))

    def _require_single(self, name: str, where: str) -> Joint:
        for joint in self.joints:
            if joint.name == name and joint.is_single:
                return joint
        raise JointNotFoundError(name, where, [joint.name for joint in self.joints if joint.is_single])

    # Drives

    def _drives(
        self, couplings: list[Coupling]
    ) -> tuple[tuple[Drive, ...], tuple[list[Body], list[Joint], list[Coupling]]]:
        """Return the actuators, and the parts of tendons that drive several joints: a coordinate coupled to them."""
        tendons = {tendon.get("name", ""): tendon for tendon in self.document.sections("tendon")}
        drives: list[Drive] = []
        extra: tuple[list[Body], list[Joint], list[Coupling]] = ([], [], [])
        known = {joint.name: joint for joint in self.joints}
        for given in self.document.sections("actuator"):
            element = self._resolved(given, "", kind="actuator")
            joint_name = element.get("joint") or element.get("jointinparent")
            gear = (*self.numbers(element, "gear", None, ANY, named(given), (1.0,)), 1.0)[0]
            if "tendon" in element.attrib:
                tendon = tendons.get(element.attrib["tendon"])
                if tendon is None or tendon.tag != "fixed":
                    self.refuse(given, f"expected a fixed tendon, not '{element.attrib['tendon']}'")
                    continue
                joint_name, share = self._tendon_joint(tendon, couplings, extra)
                gear *= share
            elif "slidersite" in element.attrib or "cranksite" in element.attrib:
                self.refuse(given, "slider-crank transmissions are not supported")
                continue
            if joint_name is None:
                name = f" '{given.get('name')}'" if "name" in given.attrib else ""
                _logger.warning("%s: actuator%s drives no joint and is ignored", self.path, name)
                self.read_over(given, "drives no joint")
                continue
            names = [*known, *(joint.name for joint in extra[1])]
            if joint_name not in names:
                raise JointNotFoundError(joint_name, f"{given.origin}: <actuator>", names)
            if joint_name in known and not known[joint_name].is_single:
                message = "%s: actuator '%s' drives a ball or free joint and is ignored"
                _logger.warning(message, self.path, given.get("name", joint_name))
                self.read_over(given, "drives a ball or free joint")
                continue
            drives.append(self._drive(element, given, joint_name, gear))
        return tuple(drives), extra

    def _drive(self, element: Element, given: Element, joint: str, gear: float) -> Drive:
        place = named(given)
        ranges = {}
        for key in ("ctrl", "force"):
            lower, upper = self._range(element, f"{key}range", place, 1.0)
            given_range = lower is not None and upper is not None and self._is_limited(element, given, f"{key}limited")
            ranges[key] = (lower, upper) if given_range and lower is not None and upper is not None else None
        is_servo = given.tag in ("position", "intvelocity")
        default_gain = 1.0 if is_servo else None
        drive = Drive(
            given.get("name", joint),
            joint,
            gear,
            kind=given.tag,
            proportional_gain=self.number(element, "kp", ANY, place, default_gain) if is_servo else None,
            derivative_gain=self.number(element, "kv", ANY, place, 1.0 if given.tag == "velocity" else None),
            control_range=ranges["ctrl"],
            force_range=ranges["force"],
            origin=given.origin,
        )
        kinds = {"gaintype": ("fixed",), "biastype": BIASES, "dyntype": LAGS}  # the first is the default
        if given.tag != "general" or any(element.get(key, known[0]) not in known for key, known in kinds.items()):
            return drive
        gain = (*self.numbers(element, "gainprm", None, ANY, place, (1.0,)), 0.0)[0]
        bias = (*self.numbers(element, "biasprm", None, ANY, place, ()), 0.0, 0.0, 0.0)[:3]
        return with_control_law(drive, gain, bias if element.get("biastype") == "affine" else (0.0, 0.0, 0.0))

    def _tendon_joint(
        self, tendon: Element, couplings: list[Coupling], extra: tuple[list[Body], list[Joint], list[Coupling]]
    ) -> tuple[str, float]:
        """Return the joint that stands for a fixed tendon, and the tendon's length per unit of its coordinate."""
        place = named(tendon)
        factors: dict[str, float] = {}
        for entry in children(tendon, "joint"):
            name = entry.get("joint", "")
            self._require_single(name, f"{entry.origin}: {place}")
            factors[name] = factors.get(name, 0.0) + self.numbers(entry, "coef", 1, ANY, place)[0]
        followed = {c.joint: c for c in couplings if c.is_linear and len(c.joints) == 1}
        shares: dict[str, float] = {}
        for name, factor in factors.items():
            if name in followed:
                name, factor = followed[name].joints[0], factor * followed[name].coefficients[0][0]
            shares[name] = shares.get(name, 0.0) + factor
        if len(shares) == 1:
            return next(iter(shares.items()))
        if not shares:
            raise tendon.origin.error(place, "has no joints, expected some")
        name = free_name(tendon.get("name") or "tendon", [joint.name for joint in self.joints])
        if name not in [joint.name for joint in extra[1]]:
            body = free_name(f"{name}_length", self.taken)
            extra[0].append(Body(body, origin=tendon.origin))
            extra[1].append(Joint(name, "prismatic", WORLD, body, origin=tendon.origin))
            powers = tuple((factor,) for factor in factors.values())
            extra[2].append(Coupling(name, tuple(factors), powers, origin=tendon.origin))
        return name, 1.0

    def _commands(self, drives: tuple[Drive, ...]) -> tuple[Command, ...]:
        """Return a command for each driven joint, named after its first actuator: the joint's coordinate."""
        slides = {joint.name for joint in self.joints if joint.type != "prismatic"}
        first: dict[str, str] = {}
        for drive in drives:
            first.setdefault(drive.joint, drive.name)
        return tuple(Command(name, joint, "rad" if joint in slides else "m") for joint, name in first.items())

    def _springs(
        self, couplings: list[Coupling], extra: tuple[list[Body], list[Joint], list[Coupling]]
    ) -> tuple[dict[str, object], ...]:
        """Return the springs of joints and of fixed tendons; parts of tendons over several joints are added."""
        named_stiffness = {joint.name: (joint.name, joint.stiffness) for joint in self.joints if joint.stiffness > 0.0}
        for given in self.document.sections("tendon"):
            element = self._resolved(given, "", kind="tendon")
            stiffness = (*self.numbers(element, "stiffness", None, _STIFFNESS, named(given), (0.0,)), 0.0)[0]
            if stiffness > 0.0 and given.tag == "fixed":
                joint, share = self._tendon_joint(given, couplings, extra)
                name, own = named_stiffness.get(joint, (given.get("name") or joint, 0.0))
                named_stiffness[joint] = (name, own + stiffness * share**2)
            elif stiffness > 0.0:
                self.read_over(given, "the stiffness of a spatial tendon")
        turning = {joint.name for joint in self.joints if joint.type != "prismatic"}
        return tuple(
            {
                "name": name,
                "type": "joint",
                "joint": joint,
                "stiffness": stiffness,
                "unit": "N m/rad" if joint in turning else "N/m",
            }
            for joint, (name, stiffness) in named_stiffness.items()
        )

    # Configurations

    def _configurations(self, held: dict[str, float]) -> dict[str, dict[str, tuple[float, ...]]]:
        initial = {joint.name: numbers for joint, numbers in self.qpos if joint.name not in held}
        qpos0 = tuple(
            number
            for _, own in self.qpos
            for number in (own if len(own) == 1 else (*own[:-4], own[-1], *own[-4:-1]))  # quaternions begin with w
        )
        count = len(qpos0)
        named_configurations = {_INITIAL: initial}
        for index, key in enumerate(entry for entry in self.document.sections("keyframe") if entry.tag == "key"):
            name = key.get("name") or f"key{index}"
            if "qpos" not in key.attrib:
                named_configurations[name] = initial
                continue
            numbers = self.numbers(key, "qpos", None, ANY, named(key))
            if len(numbers) > count:
                raise key.origin.error(f"{named(key)}: qpos", f"expected {count} numbers, not {len(numbers)}")
            numbers += qpos0[len(numbers) :]  # a short one is completed by the initial configuration
            values, start = {}, 0
            for joint, own in self.qpos:
                part = numbers[start : start + len(own)]
                start += len(own)
                if len(own) > 1:  # MuJoCo's quaternions begin with w
                    w, x, y, z = part[-4:]
                    part = (*part[:-4], x, y, z, w if math.hypot(w, x, y, z) else 1.0)  # as MuJoCo completes it
                if joint.name not in held:
                    values[joint.name] = part
            named_configurations[name] = values
        named_configurations.setdefault(_HOME, initial)
        return named_configurations

    def _gravity(self) -> tuple[float, ...]:
        gravity: tuple[float, ...] = (0.0, 0.0, -9.81)
        for option in children(self.document.root, "option"):
            gravity = self.numbers(option, "gravity", 3, ANY, "<option>", gravity)
            if any(flag.get("gravity") == "disable" for flag in children(option, "flag")):
                return (0.0, 0.0, 0.0)
        return gravity

    # Poses

    def _resolved(self, element: Element, default_class: str, kind: str = "") -> Element:
        """Return an element with the attributes of its default class."""
        resolved = Element(element.tag, self.document.defaults.attributes(element, default_class, kind))
        resolved.path, resolved.line = element.path, element.line
        return resolved

    def _angle_unit(self, element: Element) -> float:
        return 1.0 if self.document.compiler_of(element).get("angle") == "radian" else math.radians(1.0)

    def _pose(self, element: Element, given: Element | None = None) -> _Pose:
        """Return the position and orientation of an element, in any of MJCF's forms."""
        given = element if given is None else given
        place = named(given)
        position = np.array(self.numbers(element, "pos", 3, LENGTH, place, (0.0, 0.0, 0.0)))
        pose = pin.SE3(self._rotation(element, given, place), position)
        if TIMES not in element.attrib:
            return pose
        repeated = pin.SE3.Identity()
        for _ in range(int(element.attrib[TIMES])):
            repeated = repeated * pose
        return repeated

    def _rotation(self, element: Element, given: Element, place: str) -> np.ndarray:
        attributes = element.attrib
        if "quat" in attributes:
            w, x, y, z = self._direction(element, "quat", 4, place)
            return np.asarray(pin.Quaternion(w, x, y, z).normalized().toRotationMatrix())
        if "axisangle" in attributes:
            *axis, angle = self.numbers(element, "axisangle", 4, ANY, place)
            length = np.linalg.norm(axis)
            if not length:
                raise given.origin.error(f"{place}: axisangle", "expected a direction, not zero")
            turn = pin.AngleAxis(self._angle_unit(given) * angle, np.array(axis) / length)
            return np.asarray(turn.toRotationMatrix())
        if "xyaxes" in attributes:
            numbers = np.array(self.numbers(element, "xyaxes", 6, ANY, place))
            first, second = numbers[:3], numbers[3:]
            normal = np.cross(first, second)
            if not normal.any():
                raise given.origin.error(f"{place}: xyaxes", "expected two directions")
            columns = [first, np.cross(normal, first), normal]
            return np.stack([column / np.linalg.norm(column) for column in columns], axis=1)
        if "zaxis" in attributes:
            return _turn_z_to(np.array(self._direction(element, "zaxis", 3, place)))
        if "euler" in attributes:
            angles = self._angle_unit(given) * np.array(self.numbers(element, "euler", 3, ANY, place))
            sequence = self.document.compiler_of(given).get("eulerseq", "xyz")
            if len(sequence) != 3 or set(sequence.lower()) - set("xyz"):
                raise given.origin.error(
                    "<compiler>: eulerseq", f"expected three of x, y, z, X, Y, Z, not '{sequence}'"
                )
            rotation = np.eye(3)
            for letter, angle in zip(sequence, angles, strict=True):
                turn = pin.AngleAxis(float(angle), np.eye(3)["xyz".index(letter.lower())]).toRotationMatrix()
                rotation = rotation @ turn if letter.islower() else turn @ rotation  # about turned, or fixed axes
            return np.asarray(rotation)
        return np.eye(3)

    def _direction(self, element: Element, key: str, count: int, place: str) -> tuple[float, ...]:
        numbers = self.numbers(element, key, count, ANY, place)
        if not any(numbers):
            raise element.origin.error(f"{place}: {key}", "expected a direction, not zero")
        return numbers


def _turn_z_to(direction: np.ndarray) -> np.ndarray:
    """Return the least rotation that takes z to a direction, shape=(3, 3)."""
    length = np.linalg.norm(direction)
    if not length:
        return np.eye(3)
    return np.asarray(pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), direction / length).toRotationMatrix())


def _hull(vertices: np.ndarray) -> np.ndarray:
    """Return the outward triangles of the convex hull, as indices of vertices, shape=(n, 3)."""
    from scipy.spatial import ConvexHull  # slow to import

    faces = ConvexHull(vertices).simplices
    outward = np.linalg.det(vertices[faces] - vertices.mean(axis=0)) > 0.0
    return np.asarray(np.where(outward[:, None], faces, faces[:, ::-1]))


def _with_mass_times(body: Body, factor: float) -> Body:
    if body.inertial is None:
        return body
    moments = tuple(factor * moment for moment in body.inertial.moments)
    return replace(body, inertial=replace(body.inertial, mass=factor * body.inertial.mass, moments=moments))


def _bounded(body: Body, least_mass: float, least_moment: float, balances: bool) -> Body:
    """Return a body with at least these mass and principal moments, made possible by equal ones if `balances`."""
    inertia = pin.Inertia.Zero() if body.inertial is None else body.inertial.inertia
    moments, axes = np.linalg.eigh(inertia.inertia)
    if balances and moments[2] > moments[0] + moments[1]:
        moments = np.full(3, moments.mean())
    moments = np.maximum(moments, least_moment)
    mass = max(inertia.mass, least_mass)
    bounded = pin.Inertia(mass, inertia.lever, axes @ np.diag(moments) @ axes.T)
    return replace(body, inertial=Inertial.from_inertia(bounded)) if mass else body
