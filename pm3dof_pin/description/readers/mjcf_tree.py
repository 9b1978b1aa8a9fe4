"""The tree of an MJCF model: bodies, joints and sites."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.description import IDENTITY, WORLD, Body, Frame, Inertial, Joint, JointType, Placement
from pm3dof_pin.description.inertia_checks import inertia_matrix, inertia_problem, is_reversed
from pm3dof_pin.description.physical_bounds import ANY, LENGTH, MASS, MOMENT, NOT_NEGATIVE
from pm3dof_pin.description.readers.elements import free_name, named
from pm3dof_pin.description.readers.mjcf_document import MjcfDocument
from pm3dof_pin.description.readers.mjcf_elements import STIFFNESS, MjcfElements
from pm3dof_pin.description.readers.mjcf_geoms import MjcfGeoms
from pm3dof_pin.description.xml_file import Element, child, children
from pm3dof_pin.exceptions import JointNotFoundError

_logger = logging.getLogger(__name__)

_SECTIONS = ("compiler", "default", "asset", "worldbody", "equality", "actuator", "keyframe", "tendon", "option")
_PASSED_SECTIONS = (
    *("contact", "sensor", "size", "visual", "statistic", "extension", "custom", "deformable", "mujoco"),
)
_JOINT_TYPES: dict[str, JointType] = {
    "hinge": "revolute", "slide": "prismatic", "ball": "spherical", "free": "floating",
}  # fmt: skip
_BODY_PARTS = (
    *("inertial", "joint", "freejoint", "geom", "site", "body", "frame", "camera", "light", "plugin"),
    *("composite", "flexcomp", "attach", "replicate"),
)
_JOINT_ATTRIBUTES = frozenset({
    "name", "class", "type", "group", "pos", "axis", "springdamper", "solreflimit", "solimplimit", "solreffriction",
    "solimpfriction", "stiffness", "range", "limited", "actuatorfrcrange", "actuatorfrclimited", "actuatorgravcomp",
    "margin", "ref", "springref", "armature", "damping", "frictionloss", "user", "align",
})  # fmt: skip


@dataclass(frozen=True)
class _Context:
    """Where the parts of a body stand: the body, their frame in it, the class around them, and the initial pose."""

    body: str
    frame: pin.SE3
    default_class: str
    world: pin.SE3


class MjcfTree(MjcfElements):
    """The bodies, joints and sites of a document.

    Raises:
        DescriptionError: an element is malformed, impossible or not supported.
    """

    def __init__(self, document: MjcfDocument, *, lenient: bool) -> None:
        super().__init__(document, lenient=lenient)
        self.bodies: dict[str, Body] = {WORLD: Body(WORLD, origin=document.root.origin)}
        self.joints: list[Joint] = []
        self.frames: dict[str, Frame] = {}
        self.sites: dict[str, str] = {}
        #: placements of bodies in the initial configuration
        self.initial: dict[str, pin.SE3] = {WORLD: pin.SE3.Identity()}
        self.taken = {WORLD}
        self.qpos: list[tuple[Joint, tuple[float, ...]]] = []  # joints in MuJoCo's order, with their initial numbers
        self._limited_balls: list[str] = []
        self._compensated: list[str] = []
        self._geoms = MjcfGeoms(self)
        self.check_children(document.root, _SECTIONS, _PASSED_SECTIONS)
        worlds = children(document.root, "worldbody")
        names = [element.get("name", "") for world in worlds for element in world.iter("body")]
        self.taken |= {name for name in names if name}
        context = _Context(WORLD, pin.SE3.Identity(), document.defaults.main, pin.SE3.Identity())
        for world in worlds:
            self._parts(world, context)
        self._warn()

    def _warn(self) -> None:
        for names, said in (
            (self._limited_balls, "the ranges of ball joints are ignored"),
            (self._compensated, "gravcomp is ignored, so that their weight is not compensated"),
            (
                self._geoms.unknown_masses,
                "masses of meshes are not computed, as their files are missing; give <inertial>",
            ),
        ):
            if names:
                _logger.warning("%s: %s: %s", self.path, said, ", ".join(names))

    def _parts(self, element: Element, context: _Context) -> None:
        """Read what stands in a body or frame, except the body's own joints and inertia."""
        for part in children(element):
            match part.tag:
                case "body":
                    self._body(part, context)
                case "frame":
                    pose = context.frame * self.pose(part)
                    inner = part.get("childclass") or context.default_class
                    self._parts(part, replace(context, frame=pose, default_class=inner))
                case "site":
                    self._site(part, context)
                case "geom":
                    self._add_shape(part, context)
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
        pose = outer.frame * self.pose(element)
        joints = [(joint, pin.SE3.Identity()) for joint in children(element, "joint", "freejoint")]
        pending = [(frame, self.pose(frame)) for frame in children(element, "frame")]
        while pending:  # joints may stand in frames
            frame, placed = pending.pop()
            joints += [(joint, placed) for joint in children(frame, "joint", "freejoint")]
            pending += [(inner, placed * self.pose(inner)) for inner in children(frame, "frame")]
        self.bodies[name] = Body(name, origin=element.origin)
        self.initial[name] = outer.world * pose
        self._add_joints(element, joints, name, outer.body, pose, default_class)
        if self.number(element, "gravcomp", ANY, named(element), 0.0):
            self._compensated.append(name)
        context = _Context(name, pin.SE3.Identity(), default_class, self.initial[name])
        self._parts(element, context)
        inertial = child(element, "inertial")
        source = self.document.compiler_of(element).get("inertiafromgeom", "auto")
        if inertial is not None and source != "true":
            given = self._inertial(inertial)
            self.bodies[name] = replace(self.bodies[name], inertial=given)
        elif (inertial_of_geoms := self._geoms.inertia(element, name, default_class)) is not None:
            self.bodies[name] = replace(self.bodies[name], inertial=inertial_of_geoms)

    def _add_joints(
        self, body: Element, elements: list[tuple[Element, pin.SE3]], name: str, parent: str, pose: pin.SE3, cls: str
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

    def _joint(self, given: Element, name: str, cls: str, frame: pin.SE3) -> Joint:
        """Return a joint with its anchor in the body as placement; its bodies are still to be named."""
        element = self.resolved(given, cls)
        place, kind = named(given), "free" if given.tag == "freejoint" else element.get("type", "hinge")
        self.check_children(given, ("plugin",), (), _JOINT_ATTRIBUTES)
        if kind not in _JOINT_TYPES:
            raise given.origin.error(place, f"expected a hinge, slide, ball or free joint, not '{kind}'")
        unit = self.angle_unit(given) if kind in ("hinge", "ball") else 1.0
        axis = self.numbers(element, "axis", 3, ANY, place, (0.0, 0.0, 1.0))
        if not any(axis):
            raise given.origin.error(f"{place}: axis", "expected a direction, not zero")
        axis = tuple((frame.rotation @ np.array(axis) / np.linalg.norm(axis)).tolist()) if kind != "free" else axis
        anchor = frame.act(np.array(self.numbers(element, "pos", 3, LENGTH, place, (0.0, 0.0, 0.0))))
        lower, upper = self.limits(element, "range", place, unit)
        is_limited = self.is_limited(element, given, "limited")
        if kind == "ball" and is_limited and upper:
            self._limited_balls.append(name)
        stiffness = (*self.numbers(element, "stiffness", None, STIFFNESS, place, (0.0,)), 0.0)[0]
        if stiffness and kind in ("ball", "free"):
            _logger.warning("%s: the spring of joint '%s' is ignored", self.path, name)
            stiffness = 0.0
        force = self.limits(element, "actuatorfrcrange", place, 1.0)[1]
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

    def _site(self, element: Element, context: _Context) -> None:
        if "name" not in element.attrib:
            return
        resolved = self.resolved(element, context.default_class)
        name = free_name(element.attrib["name"], {*self.taken, *self.frames}, "_site")
        self.sites[element.attrib["name"]] = name
        pose = Placement.from_se3(context.frame * self.pose(resolved, element))
        self.frames[name] = Frame(name, context.body, pose, element.origin)

    def _add_shape(self, given: Element, context: _Context) -> None:
        if (found := self._geoms.shape(given, context.default_class, context.frame)) is None:
            return
        body = self.bodies[context.body]
        if found.is_shown:
            body = replace(body, visuals=(*body.visuals, found.shape))
        if found.collides:
            body = replace(body, collisions=(*body.collisions, found.shape))
        self.bodies[context.body] = body

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
        return Inertial(mass, Placement.from_se3(self.pose(element)), moments)

    def scaled_bodies(self) -> list[Body]:
        """Return the bodies with the total mass, and least masses, that the compiler settings ask for."""
        compiler, root = self.document.compiler, self.document.root
        section = next(iter(children(root, "compiler")), root)  # there may be several
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

    def tendon_factors(self, tendon: Element) -> dict[str, float]:
        """Return the factors of joints in the length of a fixed tendon, by name; JointNotFoundError for others."""
        place, factors = named(tendon), dict[str, float]()
        for entry in children(tendon, "joint"):
            name = entry.get("joint", "")
            self.require_single(name, f"{entry.origin}: {place}")
            factors[name] = factors.get(name, 0.0) + self.numbers(entry, "coef", 1, ANY, place)[0]
        return factors

    def require_single(self, name: str, where: str) -> Joint:
        """Return a joint with one degree of freedom; JointNotFoundError if it is none."""
        for joint in self.joints:
            if joint.name == name and joint.is_single:
                return joint
        raise JointNotFoundError(name, where, [joint.name for joint in self.joints if joint.is_single])


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
