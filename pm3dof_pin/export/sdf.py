"""SDFormat: a robot as a graph, with loops closed by ordinary joints."""

from __future__ import annotations

from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closure_types import ClosureTypeName
from pm3dof_pin.description.closures import LoopClosure
from pm3dof_pin.description.description import WORLD, Body, Inertial, Joint, Placement, Shape
from pm3dof_pin.description.readers.sdf import NAMESPACE
from pm3dof_pin.export.equivalent_loops import with_closures_of
from pm3dof_pin.export.robot_document import RobotDocument, joint_numbers, unit_axis
from pm3dof_pin.export.xml_text import document_text, number_text, numbers_text

_VERSION = "1.7"
"""The first version with frames, and joints between them."""

_VERSION_WITH_MIMIC = "1.11"
_CLOSURES: dict[ClosureTypeName, str] = {
    "3d": "ball",
    "6d": "fixed",
    "hinge": "revolute",
    "universal": "universal",
    "prismatic": "prismatic",
}

ElementTree.register_namespace("pm3dof", NAMESPACE)

_BANNER = "{name} in SDFormat, generated from its description by `pm3dof export sdf`. Edit that, not this file."


def sdf_text(robot: RobotDocument) -> str:
    """Write a robot as SDFormat.

    Links that move or have mass become links, on joints. Massless links at the end of a fixed joint become frames, and
    their shapes belong to the link that carries them. Each loop closure becomes a joint `<frame_a>_<frame_b>` of type
    `ball` (3d), `fixed` (6d), `revolute`, `universal` or `prismatic`, others several
    (:mod:`~pm3dof_pin.export.equivalent_loops`); a coupling a `mimic` (SDFormat 1.11). The root is fixed to the world,
    but not what floats in it, whose joint is named by a `<pm3dof:free_joint>`, which others pass over. The poses are
    those of the home configuration, with the loops closed, where every joint is at zero: if home is not at zero in the
    URDF, coordinates and limits are measured from home.

    Raises:
        DescriptionError: the end of a branch is movable and massless, which SDFormat cannot express; or a
            coupling is none of these.
        ConvergenceError: the loops do not close near the home configuration.
    """
    robot = with_closures_of(robot, tuple(_CLOSURES)).with_moving_mass("SDFormat")
    root = Element("sdf", version=_VERSION_WITH_MIMIC if robot.mechanism.couplings else _VERSION)
    _Writer(robot, SubElement(root, "model", name=robot.name)).write()
    return document_text(root, _BANNER.format(name=robot.name))


class _Writer:
    def __init__(self, robot: RobotDocument, model: Element) -> None:
        self._robot = robot
        self._model = model
        self._mimicked = robot.mimicked("SDFormat")
        self._links: dict[str, Element] = {}
        self._shape_names: dict[str, set[str]] = {}

    def write(self) -> None:
        root = self._robot.description.root
        if root.name != WORLD:
            self._joint(f"{WORLD}_{root.name}", "fixed", WORLD, root.name)
            self._link(root, None)
        self._below(root)
        for loop, links in zip(self._robot.closures, self._robot.closure_links, strict=True):
            self._closure(loop, *links)

    def _closure(self, loop: LoopClosure, one: str, other: str) -> None:
        kind = _CLOSURES[loop.type]
        # the world cannot be a child; a universal joint's first axis is that of its parent
        parent, child = (one, other) if one == WORLD or loop.type == "universal" else (other, one)
        element = self._joint(loop.joined("_"), kind, parent, child)
        if loop.kind.axis is None:
            return
        axes = loop.bases or (np.eye(3), np.eye(3))
        if loop.type == "universal":
            first, second = (
                SubElement(SubElement(element, tag), "xyz", expressed_in=frame)
                for tag, frame in (("axis", one), ("axis2", other))
            )
            first.text, second.text = numbers_text(axes[0][:, 0]), numbers_text(axes[1][:, 1])
        else:
            in_child = axes[0 if child == one else 1]
            SubElement(SubElement(element, "axis"), "xyz").text = numbers_text(in_child[:, 2])

    def _below(self, link: Body) -> None:
        for joint in self._robot.description.joints_below[link.name]:
            child = self._robot.description.body_by_name[joint.child]
            if self._is_frame(child, joint):
                self._frame(child, joint)
            else:
                self._link(child, joint)
                self._tree_joint(joint)
            self._below(child)

    def _is_frame(self, link: Body, joint: Joint) -> bool:
        return joint.is_fixed and link.mass == 0.0 and joint.parent != WORLD

    def _frame(self, link: Body, joint: Joint) -> None:
        frame = SubElement(self._model, "frame", name=link.name, attached_to=joint.parent)
        _pose(frame, joint.placement)
        carrier = link.name
        while carrier not in self._links:
            above = self._robot.description.joint_above.get(carrier)
            carrier = above.parent if above is not None else WORLD
        self._shapes(carrier, link, link.name)

    def _link(self, link: Body, joint: Joint | None) -> None:
        element = self._links[link.name] = SubElement(self._model, "link", name=link.name)
        if joint is not None:
            parent = {} if joint.parent == WORLD or joint.type == "floating" else {"relative_to": joint.parent}
            _pose(element, self._placed_at_home(joint), parent)
        if link.inertial is not None and link.mass > 0.0:
            _inertial(element, link.inertial)
        self._shape_names[link.name] = set()
        self._shapes(link.name, link, None)

    def _placed_at_home(self, joint: Joint) -> Placement:
        """Placement of the child in the parent in the home configuration."""
        if joint.type == "floating":
            return Placement.from_se3(pin.XYZQUATToSE3(np.array(joint_numbers(self._robot.home, joint))))
        position = self._robot.home_position(joint)
        if position == 0.0:
            return joint.placement
        way = position * unit_axis(joint)
        is_slide = joint.type == "prismatic"
        moved = pin.SE3(np.eye(3), way) if is_slide else pin.SE3(pin.exp3(way), np.zeros(3))
        return Placement.from_se3(joint.placement.se3 * moved)

    def _tree_joint(self, joint: Joint) -> None:
        if joint.type == "floating":  # no joint holds the link; its name is for the reader
            free = SubElement(self._model, f"{{{NAMESPACE}}}free_joint", name=joint.name)
            SubElement(free, "child").text = joint.child
            return
        kind = {"prismatic": "prismatic", "fixed": "fixed"}.get(joint.type, "revolute")
        element = self._joint(joint.name, kind, joint.parent, joint.child)
        if joint.is_fixed:
            return
        axis = SubElement(element, "axis")
        SubElement(axis, "xyz").text = numbers_text(unit_axis(joint))
        self._mimic(axis, joint)
        limit = SubElement(axis, "limit")
        for tag, bound in (("lower", joint.lower), ("upper", joint.upper)):
            if bound is not None:
                SubElement(limit, tag).text = number_text(bound - self._robot.home_position(joint))
        is_actuated = joint.name in self._robot.mechanism.actuated_joints
        effort = (joint.effort or None) if is_actuated else joint.effort  # Drake ignores drives with effort 0
        for tag, greatest in (("effort", effort), ("velocity", joint.velocity)):
            if greatest is not None:
                SubElement(limit, tag).text = number_text(greatest)
        if joint.damping or joint.friction or joint.stiffness:
            dynamics = SubElement(axis, "dynamics")
            SubElement(dynamics, "damping").text = number_text(joint.damping)
            SubElement(dynamics, "friction").text = number_text(joint.friction)
            if joint.stiffness:
                rest = joint.rest - self._robot.home_position(joint)
                SubElement(dynamics, "spring_reference").text = number_text(rest)
                SubElement(dynamics, "spring_stiffness").text = number_text(joint.stiffness)

    def _mimic(self, axis: Element, joint: Joint) -> None:
        """Write a coupling, between coordinates that are measured from home."""
        if joint.name not in self._mimicked:
            return
        other, ratio, offset = self._mimicked[joint.name]
        leader = self._robot.home_position(self._robot.description.joint(other))
        mimic = SubElement(axis, "mimic", joint=other)
        SubElement(mimic, "multiplier").text = number_text(ratio)
        SubElement(mimic, "offset").text = number_text(ratio * leader + offset - self._robot.home_position(joint))
        SubElement(mimic, "reference").text = "0"

    def _joint(self, name: str, kind: str, parent: str, child: str) -> Element:
        element = SubElement(self._model, "joint", name=name, type=kind)
        SubElement(element, "parent").text = parent
        SubElement(element, "child").text = child
        return element

    def _shapes(self, carrier: str, link: Body, frame: str | None) -> None:
        for tag, shapes in (("visual", link.visuals), ("collision", link.collisions)):
            for shape in shapes:
                element = SubElement(self._links[carrier], tag, name=self._shape_name(carrier, tag, shape))
                _pose(element, shape.placement, {} if frame is None else {"relative_to": frame})
                self._geometry(SubElement(element, "geometry"), shape)
                if tag == "visual" and shape.colour is not None:
                    material = SubElement(element, "material")
                    for part in ("ambient", "diffuse"):
                        SubElement(material, part).text = numbers_text(shape.colour)

    def _shape_name(self, carrier: str, tag: str, shape: Shape) -> str:
        """Return a unique name for a shape, which SDFormat requires."""
        used, base = self._shape_names[carrier], shape.name or tag
        name, number = base, 1
        while name in used:
            number += 1
            name = f"{base}_{number}"
        used.add(name)
        return name

    def _geometry(self, geometry: Element, shape: Shape) -> None:
        element = SubElement(geometry, shape.kind)
        if shape.kind == "mesh":
            SubElement(element, "uri").text = self._robot.meshes.exported(shape.mesh)
            SubElement(element, "scale").text = numbers_text(shape.sizes)
        elif shape.kind == "box":
            SubElement(element, "size").text = numbers_text(shape.sizes)
        else:
            for tag, size in zip(("radius", "length"), shape.sizes, strict=False):
                SubElement(element, tag).text = number_text(size)


def _pose(element: Element, placement: Placement, attributes: dict[str, str] | None = None) -> None:
    if attributes or not placement.is_identity:
        numbers = numbers_text([*placement.position, *placement.roll_pitch_yaw])
        SubElement(element, "pose", attributes or {}).text = numbers


def _inertial(link: Element, inertial: Inertial) -> None:
    element = SubElement(link, "inertial")
    _pose(element, inertial.placement)
    SubElement(element, "mass").text = number_text(inertial.mass)
    moments = SubElement(element, "inertia")
    for tag, moment in zip(("ixx", "iyy", "izz", "ixy", "ixz", "iyz"), inertial.moments, strict=True):
        SubElement(moments, tag).text = number_text(moment)
