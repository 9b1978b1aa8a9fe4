"""MJCF: a robot for MuJoCo, its loops closed by `connect` and `weld` constraints."""

from __future__ import annotations

from pathlib import PurePath
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from pm3dof_pin.export.robot_document import RobotDocument
from pm3dof_pin.export.urdf_document import WORLD, Inertial, Joint, Link, Origin, Shape, wxyz
from pm3dof_pin.export.xml_text import document_text, number_text, numbers_text

MESH_KINDS = (".stl", ".obj", ".msh")
"""Suffixes of the mesh files that MuJoCo reads."""

# Loops as stiff as the solver permits: with the defaults, weight alone opens them by tenths of a millimetre. A time
# constant of less than two steps is treated as two steps, so the step is set too.
_STEP = 5e-4
_STIFF = {"solref": "0.001 1", "solimp": "0.9999 0.9999 0.001 0.5 2"}
_BANNER = "{name} for MuJoCo, generated from its description by `pm3dof export mjcf`. Edit that, not this file."
_SITE = "{}_site"


def mjcf_text(robot: RobotDocument) -> str:
    """Write a robot as MJCF.

    Each link becomes a body of its name, and joints keep their names and coordinates, so q is as in the URDF. The
    frames of loop closures and the tool frame are also sites, `<frame>_site`: a `connect` (3d) or `weld` (6d) between
    two sites closes the right loop in whichever configuration the file is loaded, unlike one between two bodies. Each
    actuated joint has a force actuator of its name. The named configurations are keyframes.

    Raises:
        DescriptionError: the end of a branch is movable and massless, which MuJoCo refuses.
        ConvergenceError: the loops do not close near the home configuration.
    """
    complete = robot.with_moving_mass("MuJoCo").with_meshes_of(MESH_KINDS)
    return document_text(_Writer(complete).document(), _BANNER.format(name=robot.name))


class _Writer:
    def __init__(self, robot: RobotDocument) -> None:
        self._robot = robot
        self._geoms: set[str] = set()
        self._joints: list[Joint] = []
        frames = [frame for pair in robot.closure_links for frame in pair]
        if robot.mechanism.tool_frame is not None:
            frames.append(robot.urdf.link_of_frame(robot.mechanism.tool_frame))
        self._sites: dict[str, list[str]] = {}
        for frame in dict.fromkeys(frames):
            self._sites.setdefault(self._carrier(frame), []).append(frame)

    def _carrier(self, frame: str) -> str:
        """The body that a site is written in: the one that moves it.

        Pinocchio silently misplaces sites in a fixed body within a fixed body, or in the root.
        """
        above = self._robot.urdf.above(frame)
        while above is not None and above.is_fixed and above.parent != self._robot.urdf.root.name:
            frame = above.parent
            above = self._robot.urdf.above(frame)
        return frame

    def document(self) -> Element:
        robot = self._robot
        root = Element("mujoco", model=robot.name)
        # without discardvisual="false" only collision shapes are drawn
        compiler = {"angle": "radian", "autolimits": "true", "discardvisual": "false"}
        SubElement(root, "compiler", compiler)
        SubElement(root, "option", timestep=number_text(_STEP), integrator="implicitfast", tolerance="1e-12")
        self._defaults(SubElement(root, "default"))
        self._assets(root)
        base = SubElement(SubElement(root, "worldbody"), "body", name=_body(robot.urdf.root.name))
        self._fill(base, robot.urdf.root, None)
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
            for link in self._robot.urdf.links.values()
            for shape in (*link.visuals, *link.collisions)
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

    def _fill(self, body: Element, link: Link, joint: Joint | None) -> None:
        if link.inertial is not None and link.mass > 0.0:
            SubElement(body, "inertial", _inertial(link.inertial))
        if joint is not None and not joint.is_fixed:
            self._joints.append(joint)
            SubElement(body, "joint", _joint(joint))
        for kind, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for shape in shapes:
                self._geom(body, kind, shape)
        for frame in self._sites.get(link.name, []):
            SubElement(body, "site", {"name": _SITE.format(frame), **self._place_in(link.name, frame)})
        for below in self._robot.urdf.below(link.name):
            child = SubElement(body, "body", {"name": below.child, **_place(below.origin)})
            self._fill(child, self._robot.urdf.links[below.child], below)

    def _place_in(self, carrier: str, frame: str) -> dict[str, str]:
        """Placement of a frame in the body that carries it by fixed joints."""
        position, turn = np.zeros(3), pin.Quaternion.Identity()
        while frame != carrier and (above := self._robot.urdf.above(frame)) is not None:
            position = above.origin.rotation @ position + above.origin.position
            turn, frame = above.origin.turn * turn, above.parent
        place = {"pos": numbers_text(position)} if position.any() else {}
        return place | ({} if turn == pin.Quaternion.Identity() else {"quat": numbers_text(wxyz(turn))})

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
        SubElement(body, "geom", attributes | _place(shape.origin))

    def _exclusions(self, root: Element) -> None:
        if self._robot.untouchable:
            contact = SubElement(root, "contact")
            for one, other in self._robot.untouchable:
                SubElement(contact, "exclude", body1=_body(one), body2=_body(other))

    def _equalities(self, root: Element) -> None:
        robot = self._robot
        if robot.closures:
            equality = SubElement(root, "equality")
            for loop, (one, other) in zip(robot.closures, robot.closure_links, strict=True):
                tag = "connect" if loop.type == "3d" else "weld"
                sites = {"site1": _SITE.format(one), "site2": _SITE.format(other)}
                SubElement(equality, tag, {"name": f"{loop.frame_a}_{loop.frame_b}", **sites})

    def _actuators(self, root: Element) -> None:
        joints = {joint.name: joint for joint in self._robot.urdf.joints}
        actuated = [joints[name] for name in self._robot.mechanism.actuated_joints]
        if actuated:
            actuator = SubElement(root, "actuator")
            for joint in actuated:
                limit = {"ctrlrange": numbers_text([-joint.effort, joint.effort])} if joint.effort else {}
                SubElement(actuator, "motor", {"name": joint.name, "joint": joint.name, **limit})

    def _keyframes(self, root: Element) -> None:
        if self._joints:
            keyframe = SubElement(root, "keyframe")
            for name, configuration in self._robot.named_configurations().items():
                positions = [configuration.joint_position(joint.name) for joint in self._joints]
                SubElement(keyframe, "key", name=name, qpos=numbers_text(positions))


def _body(link: str) -> str:
    """Name of the body of a link: `world` is reserved by MuJoCo."""
    return "world_link" if link == WORLD else link


def _inertial(inertial: Inertial) -> dict[str, str]:
    mass = {"mass": number_text(inertial.mass), "pos": numbers_text(inertial.origin.position)}
    if inertial.is_diagonal:
        turned = {"quat": numbers_text(inertial.origin.quaternion)} if inertial.origin.is_rotated else {}
        return mass | turned | {"diaginertia": numbers_text(inertial.moments[:3])}
    return mass | {"fullinertia": numbers_text(inertial.moments_in_link_axes)}


def _joint(joint: Joint) -> dict[str, str]:
    kind = "slide" if joint.kind == "prismatic" else "hinge"
    attributes = {"name": joint.name, "type": kind, "axis": numbers_text(joint.axis)}
    if joint.lower is not None and joint.upper is not None:
        attributes["range"] = numbers_text([joint.lower, joint.upper])
    if joint.damping:
        attributes["damping"] = number_text(joint.damping)
    if joint.friction:
        attributes["frictionloss"] = number_text(joint.friction)
    return attributes


def _place(origin: Origin) -> dict[str, str]:
    place = {"pos": numbers_text(origin.position)} if any(origin.position) else {}
    return place | ({"quat": numbers_text(origin.quaternion)} if origin.is_rotated else {})


def _sizes(shape: Shape) -> tuple[float, ...]:
    """MuJoCo's sizes: half edges of a box, radius and half length of a cylinder, radius of a sphere."""
    if shape.kind == "box":
        return tuple(0.5 * edge for edge in shape.sizes)
    return shape.sizes if shape.kind == "sphere" else (shape.sizes[0], 0.5 * shape.sizes[1])
