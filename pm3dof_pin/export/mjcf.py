"""MJCF: a robot for MuJoCo, its loops closed by `connect` and `weld` constraints."""

from __future__ import annotations

from itertools import chain
from pathlib import PurePath
from typing import assert_never
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.couplings import MAX_DEGREE, Coupling
from pm3dof_pin.description.description import IDENTITY, WORLD, Body, Drive, Inertial, Joint, Placement, Shape
from pm3dof_pin.description.inertia_checks import inertia_matrix
from pm3dof_pin.description.readers.elements import free_name
from pm3dof_pin.export.equivalent_loops import with_closures_of
from pm3dof_pin.export.robot_document import RobotDocument, joint_numbers, unit_axis
from pm3dof_pin.export.xml_text import document_text, number_text, numbers_text
from pm3dof_pin.typing import Vector

MESH_KINDS = (".stl", ".obj", ".msh")
"""Suffixes of the mesh files that MuJoCo reads."""

# Loops as stiff as the solver permits: with the defaults, weight alone opens them by tenths of a millimetre. A time
# constant of less than two steps is treated as two steps, so the step is set too.
_STEP = 5e-4
_STIFF = {"solref": "0.001 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
_BANNER = "{name} for MuJoCo, generated from its description by `pm3dof export mjcf`. Edit that, not this file."
_SITE = "{}_site"
_GAINS: dict[str, tuple[str, ...]] = {"motor": (), "position": ("kp", "kv"), "velocity": ("kv",)}


def mjcf_text(robot: RobotDocument, banner: str = _BANNER) -> str:
    """Write a robot as MJCF, with a banner in which `{name}` stands for its name.

    Each link becomes a body of its name, one that floats in the root a free body of the world, and joints keep their
    names and coordinates, so q is as in the URDF. The frames of loop closures and the tool frame are also sites,
    `<frame>_site`: a `connect` (3d) or `weld` (6d) between two sites closes the right loop in whichever configuration
    the file is loaded, unlike one between two bodies. A hinge becomes two `connect` on its axis, a distance the length
    of a tendon, other closures joints of their own (:mod:`~pm3dof_pin.export.equivalent_loops`), a coupling an equality
    of joints or of a fixed tendon. Each actuated joint has an actuator: that of the description, or a motor of the
    joint's name. The named configurations are keyframes.

    Raises:
        DescriptionError: the end of a branch is movable and massless, which MuJoCo refuses; or a coupling is none of
            these.
        ConvergenceError: the loops do not close near the home configuration.
    """
    robot = with_closures_of(robot, ("3d", "6d", "hinge", "distance"))
    complete = robot.with_moving_mass("MuJoCo").with_meshes_of(MESH_KINDS)
    return document_text(_Writer(complete).document(), banner.replace("{name}", robot.name))


class _Writer:
    def __init__(self, robot: RobotDocument) -> None:
        self._robot = robot
        self._geoms: set[str] = set()
        self._joints: list[Joint] = []
        self._tendons: list[tuple[str, list[str]]] = []  # names, and sites at the ends
        self._sites: dict[str, list[tuple[str, str, Placement]]] = {}  # by body: name, frame and placement in it
        self._loops = [self._loop(index) for index in range(len(robot.closures))]
        if robot.mechanism.tool_frame is not None:
            self._site(robot.body_of_frame(robot.mechanism.tool_frame))

    def _site(self, frame: str, offset: Placement = IDENTITY, name: str | None = None) -> str:
        """Add a site at a frame, or at a placement in it; return its name."""
        site = (name or frame, frame, offset)
        sites = self._sites.setdefault(self._carrier(frame), [])
        if site not in sites:
            sites.append(site)
        return _SITE.format(site[0])

    def _loop(self, index: int) -> list[tuple[str, dict[str, str]]]:
        """Return the equality constraints of a closure, tags and attributes, and add their sites."""
        loop, pair = self._robot.closures[index], self._robot.closure_links[index]
        name = loop.joined("_")
        match loop.type:
            case "3d" | "6d":
                sites = {"site1": self._site(pair[0]), "site2": self._site(pair[1])}
                return [("connect" if loop.type == "3d" else "weld", {"name": name, **sites})]
            case "distance":
                self._tendons.append((name, [self._site(frame) for frame in pair]))
                home = self._robot.mechanism.configuration(self._neutral())
                a, b = (home.frame_placement(frame).translation for frame in (loop.frame_a, loop.frame_b))
                excess = (loop.length or 0.0) - float(np.linalg.norm(b - a))  # relative to the length at qpos0
                return [("tendon", {"name": name, "tendon1": name, "polycoef": f"{number_text(excess)} 0 0 0 0"})]
            case "hinge" | "universal" | "prismatic" | "cylindrical" | "planar":
                found = []
                for k, points in enumerate(self._robot.points_of(index, "MJCF")):
                    ends = zip(pair, points, strict=True)
                    names = [
                        self._site(frame, Placement(tuple(point)), f"{frame}_{index}" if k else None)
                        for frame, point in ends
                    ]
                    own = f"{name}_axis" if k else name
                    found.append(("connect", {"name": own, "site1": names[0], "site2": names[1]}))
                return found
            case _:
                assert_never(loop.type)

    def _neutral(self) -> Vector:
        """Return q where the file has the robot: free bodies at home, other joints at zero."""
        robot = self._robot
        q = np.array(pin.neutral(robot.mechanism.model))
        for joint in robot.description.joints:
            if joint.type == "floating":
                start = robot.mechanism.model.idx_qs[robot.mechanism.model.getJointId(joint.name)]
                q[start : start + 7] = joint_numbers(robot.home, joint)
        return q

    def _carrier(self, frame: str) -> str:
        """The body that a site is written in: the one that moves it.

        Pinocchio silently misplaces sites in a fixed body within a fixed body, or in the root. A body at a spring moves
        what it carries.
        """
        sprung = {spring["at"] for spring in self._robot.described.springs if "at" in spring}
        above = self._robot.description.joint_above.get(frame)
        while above is not None and above.is_fixed and above.parent != self._robot.description.root.name:
            if not sprung.isdisjoint((frame, above.name)):
                break
            frame = above.parent
            above = self._robot.description.joint_above.get(frame)
        return frame

    def _body(self, link: str) -> str:
        """Name of the body of a link: `world` is reserved by MuJoCo."""
        return free_name("world_link", self._robot.description.body_by_name) if link == WORLD else link

    def document(self) -> Element:
        robot = self._robot
        root = Element("mujoco", model=robot.name)
        # without discardvisual="false" only collision shapes are drawn
        compiler = {"angle": "radian", "autolimits": "true", "discardvisual": "false"}
        SubElement(root, "compiler", compiler)
        SubElement(root, "option", timestep=number_text(_STEP), integrator="implicitfast", tolerance="1e-12")
        self._defaults(SubElement(root, "default"))
        self._assets(root)
        world = SubElement(root, "worldbody")
        base = SubElement(world, "body", name=self._body(robot.description.root.name))
        self._fill(base, robot.description.root, None)
        if robot.description.root.name == WORLD and not len(base):
            world.remove(base)
        for joint in robot.description.joints:
            if joint.type == "floating":
                numbers = _positions(joint_numbers(robot.home, joint))
                place = _place(Placement(numbers[:3], numbers[3:]))
                child = SubElement(world, "body", {"name": joint.child, **place})
                self._fill(child, robot.description.body_by_name[joint.child], joint)
        self._exclusions(root)
        self._equalities(root)
        self._actuators(root)
        self._keyframes(root)
        return root

    def _defaults(self, default: Element) -> None:
        SubElement(default, "equality", _STIFF)
        # by density: Pinocchio ignores a default mass of 0, and computes mass from the shapes of bodies without inertia
        visual = SubElement(default, "default", {"class": "visual"})
        SubElement(visual, "geom", group="2", contype="0", conaffinity="0", density="0")
        collision = SubElement(default, "default", {"class": "collision"})
        SubElement(collision, "geom", group="3", density="0", rgba="0.5 0.5 0.5 0.3")

    def _assets(self, root: Element) -> None:
        shapes = {
            (shape.mesh, shape.sizes): shape
            for body in self._robot.description.bodies
            for shape in (*body.visuals, *body.collisions)
            if shape.kind == "mesh"
        }
        if shapes:
            asset = SubElement(root, "asset")
            for shape in shapes.values():
                file, scale = self._robot.meshes.exported(shape.mesh), numbers_text(shape.sizes)
                SubElement(asset, "mesh", name=self._mesh_name(shape), file=file, scale=scale)

    def _mesh_name(self, shape: Shape) -> str:
        # with suffix: there may be both arm.stl and arm.obj
        scales = map(number_text, shape.sizes) if set(shape.sizes) != {1.0} else ()
        return "_".join([PurePath(self._robot.meshes.exported(shape.mesh)).name, *scales])

    def _fill(self, body: Element, link: Body, joint: Joint | None) -> None:
        if link.inertial is not None and link.mass > 0.0:
            SubElement(body, "inertial", _inertial(link.inertial))
        if joint is not None and not joint.is_fixed:
            self._joints.append(joint)
        if joint is not None and joint.type == "floating":
            SubElement(body, "freejoint", name=joint.name)
        elif joint is not None and not joint.is_fixed:
            rotors = [d.rotor_inertia * d.gear**2 for d in self._robot.description.drives if d.joint == joint.name]
            SubElement(body, "joint", _joint(joint, sum(rotors)))
        for kind, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for shape in shapes:
                self._geom(body, kind, shape)
        for name, frame, offset in self._sites.get(link.name, []):
            place = self._place_in(link.name, frame) * offset
            SubElement(body, "site", {"name": _SITE.format(name), **_place(place)})
        for below in self._robot.description.joints_below[link.name]:
            if below.type == "floating":  # a body of the world
                continue
            child = SubElement(body, "body", {"name": below.child, **_place(below.placement)})
            self._fill(child, self._robot.description.body_by_name[below.child], below)

    def _place_in(self, carrier: str, frame: str) -> Placement:
        """Placement of a frame in the body that carries it by fixed joints."""
        place = IDENTITY
        while frame != carrier and (above := self._robot.description.joint_above.get(frame)) is not None:
            place, frame = above.placement * place, above.parent
        return place

    def _geom(self, body: Element, kind: str, shape: Shape) -> None:
        attributes = {"class": kind}
        if shape.name and shape.name not in self._geoms:
            self._geoms.add(shape.name)
            attributes["name"] = shape.name
        if shape.kind == "mesh":
            attributes |= {"type": "mesh", "mesh": self._mesh_name(shape)}
        else:
            attributes |= {"type": shape.kind, "size": numbers_text(_sizes(shape))}
        if shape.colour is not None:
            attributes["rgba"] = numbers_text(shape.colour)
        SubElement(body, "geom", attributes | _place(shape.placement))

    def _exclusions(self, root: Element) -> None:
        if self._robot.untouchable:
            contact = SubElement(root, "contact")
            for one, other in self._robot.untouchable:
                SubElement(contact, "exclude", body1=self._body(one), body2=self._body(other))

    def _equalities(self, root: Element) -> None:
        couplings = self._robot.mechanism.couplings
        if not (self._loops or couplings):
            return
        tendons = Element("tendon")
        for name, sites in self._tendons:
            spatial = SubElement(tendons, "spatial", name=name)
            for site in sites:
                SubElement(spatial, "site", site=site)
        equality = SubElement(root, "equality")
        for tag, attributes in (constraint for loop in self._loops for constraint in loop):
            SubElement(equality, tag, attributes)
        for coupling in couplings:
            self._coupling(equality, tendons, coupling)
        if len(tendons):
            root.append(tendons)

    def _coupling(self, equality: Element, tendons: Element, coupling: Coupling) -> None:
        """Write a coupling of two joints as such; of more, if it is linear, as the length of a fixed tendon."""
        if len(coupling.joints) == 1:
            powers = [*coupling.coefficients[0], *[0.0] * (MAX_DEGREE - len(coupling.coefficients[0]))]
            joints = {"joint1": coupling.joint, "joint2": coupling.joints[0]}
            SubElement(equality, "joint", {**joints, "polycoef": numbers_text([coupling.offset, *powers])})
            return
        if not coupling.is_linear:
            raise self._robot.refusal(coupling, "MJCF")
        name = f"{coupling.joint}_coupling"
        fixed = SubElement(tendons, "fixed", name=name)
        ratios = {coupling.joint: 1.0}
        ratios |= {other: -powers[0] for other, powers in zip(coupling.joints, coupling.coefficients, strict=True)}
        for joint, ratio in ratios.items():
            SubElement(fixed, "joint", joint=joint, coef=number_text(ratio))
        SubElement(equality, "tendon", tendon1=name, polycoef=f"{number_text(coupling.offset)} 0 0 0 0")

    def _actuators(self, root: Element) -> None:
        description = self._robot.description
        drives = {drive.joint: drive for drive in description.drives}
        if actuated := self._robot.mechanism.actuated_joints:
            actuator = SubElement(root, "actuator")
            for name in actuated:
                tag, attributes = _actuator(description.joint(name), drives.get(name) or Drive(name, name))
                SubElement(actuator, tag, attributes)

    def _keyframes(self, root: Element) -> None:
        if self._joints:
            keyframe = SubElement(root, "keyframe")
            for name, configuration in self._robot.named_configurations().items():
                numbers = [_positions(joint_numbers(configuration, joint)) for joint in self._joints]
                SubElement(keyframe, "key", name=name, qpos=numbers_text(chain.from_iterable(numbers)))


def _positions(numbers: tuple[float, ...]) -> tuple[float, ...]:
    """Return coordinates of a joint in MuJoCo's order: quaternions are w, x, y, z."""
    return numbers if len(numbers) == 1 else (*numbers[:3], numbers[6], *numbers[3:6])


def _inertial(inertial: Inertial) -> dict[str, str]:
    place = inertial.placement
    mass = {"mass": number_text(inertial.mass), "pos": numbers_text(place.position)}
    if not any(inertial.moments[3:]):
        turned = {"quat": numbers_text(place.quaternion)} if any(place.quaternion[1:]) else {}
        return mass | turned | {"diaginertia": numbers_text(inertial.moments[:3])}
    matrix = place.rotation @ inertia_matrix(inertial.moments) @ place.rotation.T
    moments = [matrix[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    return mass | {"fullinertia": numbers_text(moments)}


def _actuator(joint: Joint, drive: Drive) -> tuple[str, dict[str, str]]:
    """Return the actuator of a joint, tag and attributes; a motor, unless its drive is another kind."""
    attributes = {"name": drive.name, "joint": joint.name}
    if drive.gear != 1.0:
        attributes["gear"] = number_text(drive.gear)
    tag = drive.kind if drive.kind in _GAINS else "motor"
    gains = (("kp", drive.proportional_gain), ("kv", drive.derivative_gain))
    if drive.control_gain is None:
        attributes |= {key: number_text(gain) for key, gain in gains if gain is not None and key in _GAINS[tag]}
    else:
        tag, attributes["gainprm"] = "general", number_text(drive.control_gain)
        bias = [-(gain or 0.0) for _, gain in gains]
        if any(bias):
            attributes |= {"biastype": "affine", "biasprm": numbers_text([0.0, *bias])}
    if drive.control_range is not None:
        attributes["ctrlrange"] = numbers_text(drive.control_range)
    elif joint.effort and tag == "motor":
        attributes["ctrlrange"] = numbers_text([-joint.effort / drive.gear, joint.effort / drive.gear])
    if drive.force_range is not None:
        attributes["forcerange"] = numbers_text(drive.force_range)
    return tag, attributes


def _joint(joint: Joint, rotor: float) -> dict[str, str]:
    """Return the attributes of a joint; `rotor` is the inertia of its drive's rotor, reflected to it."""
    kind = "slide" if joint.type == "prismatic" else "hinge"
    attributes = {"name": joint.name, "type": kind, "axis": numbers_text(unit_axis(joint))}
    if joint.lower is not None and joint.upper is not None:
        attributes["range"] = numbers_text([joint.lower, joint.upper])
    if joint.effort:
        attributes["actuatorfrcrange"] = numbers_text([-joint.effort, joint.effort])
    if joint.damping:
        attributes["damping"] = number_text(joint.damping)
    if joint.friction:
        attributes["frictionloss"] = number_text(joint.friction)
    if armature := joint.armature + rotor:
        attributes["armature"] = number_text(armature)
    if joint.stiffness:
        attributes |= {"stiffness": number_text(joint.stiffness), "springref": number_text(joint.rest)}
    return attributes


def _place(placement: Placement) -> dict[str, str]:
    place = {"pos": numbers_text(placement.position)} if any(placement.position) else {}
    return place | ({"quat": numbers_text(placement.quaternion)} if any(placement.quaternion[1:]) else {})


def _sizes(shape: Shape) -> tuple[float, ...]:
    """MuJoCo's sizes: half edges of a box, radius and half length of a cylinder, radius of a sphere."""
    if shape.kind == "box":
        return tuple(0.5 * edge for edge in shape.sizes)
    return shape.sizes if shape.kind == "sphere" else (shape.sizes[0], 0.5 * shape.sizes[1])
