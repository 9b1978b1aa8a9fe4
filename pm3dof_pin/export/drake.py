"""Drake: a URDF with loop closures, by Drake's extensions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pm3dof_pin.description.description import WORLD
from pm3dof_pin.description.expand import DRAKE_NAMESPACE
from pm3dof_pin.description.readers.urdf_loops import LOOP_TAGS
from pm3dof_pin.export.equivalent_loops import with_closures_of
from pm3dof_pin.export.plain_urdf import urdf_element
from pm3dof_pin.export.robot_document import RobotDocument
from pm3dof_pin.export.xml_text import document_text, number_text, numbers_text
from pm3dof_pin.typing import Vector

MESH_KINDS = (".obj", ".gltf", ".vtk")
"""Suffixes of the mesh files that Drake accepts as collision shapes; it fails on others."""

ElementTree.register_namespace("drake", DRAKE_NAMESPACE)

_FOREIGN = tuple(tag.removeprefix("drake:") for tag in LOOP_TAGS)
_BANNER = "{name} for Drake, generated from its description by `pm3dof export drake`. Edit that, not this file."


def drake_text(robot: RobotDocument) -> str:
    """Write a robot as a URDF for Drake.

    It is the robot's URDF, fixed to the world, with `<drake:ball_constraint>` for the loop closures, a transmission for
    every actuated joint, `<mimic>` for couplings, and a filter group for each body that the SRDF or a closure keeps
    from colliding with another. Drake's URDF has neither weld nor hinge: a 6d closure becomes three ball constraints,
    at the origin of the two frames and on their x and y axes, a hinge two, on its axis; other closures get joints of
    their own (:mod:`~pm3dof_pin.export.equivalent_loops`). These are more equations than
    their rank; the forces are not unique, but their resultant is. A plant accepts ball constraints only if it is
    discrete and uses SAP.

    Raises:
        DescriptionError: a coupling is none of these.
        ConvergenceError: such a closure does not close near the home configuration.
    """
    robot = with_closures_of(robot, ("3d", "6d", "hinge"))
    root = urdf_element(robot.with_meshes_of(MESH_KINDS))
    _replace_foreign_elements(root, robot)
    _omit_unknown_limits(root, robot.mechanism.actuated_joints)
    _fix_to_world(root, robot.description.root.name)
    for name in robot.mechanism.actuated_joints:
        if not any(joint.get("name") == name for joint in root.findall("transmission/joint")):
            _transmission(root, name)
    for index, links in enumerate(robot.closure_links):
        for points in robot.points_of(index, "a URDF for Drake"):
            _ball(root, links, points)
    root.extend(_filter_groups(robot))
    return document_text(root, _BANNER.format(name=robot.name))


def _omit_unknown_limits(root: Element, drives: Sequence[str]) -> None:
    """Remove effort and velocity limits of 0, which stand for unknown ones: Drake ignores such drives."""
    driven = (joint for joint in root.findall("joint") if joint.get("name") in drives)
    for limit in (limit for joint in driven for limit in joint.findall("limit")):
        for key in ("effort", "velocity"):
            if float(limit.get(key, "0")) == 0.0:
                limit.attrib.pop(key, None)


def _fix_to_world(root: Element, base: str) -> None:
    if base == WORLD:
        return
    SubElement(root, "link", name=WORLD)
    joint = SubElement(root, "joint", name=f"{WORLD}_{base}", type="fixed")
    SubElement(joint, "parent", link=WORLD)
    SubElement(joint, "child", link=base)


def _transmission(root: Element, joint: str) -> None:
    element = SubElement(root, "transmission", name=f"{joint}_transmission")
    SubElement(element, "type").text = "transmission_interface/SimpleTransmission"
    SubElement(element, "joint", name=joint)
    SubElement(element, "actuator", name=joint)


def _replace_foreign_elements(root: Element, robot: RobotDocument) -> None:
    """Replace what others have added to URDF for loops and couplings, which Drake does not read, or refuses."""
    for element in [child for child in root if child.tag.removeprefix(f"{{{DRAKE_NAMESPACE}}}") in _FOREIGN]:
        root.remove(element)
    links = {element.get("name") for element in root.findall("link")}
    for body in robot.description.bodies:
        above = robot.description.joint_above.get(body.name)
        if body.name not in links and above is not None and above.is_fixed:
            SubElement(root, "link", name=body.name)
            joint = SubElement(root, "joint", name=above.name, type="fixed")
            place = {"xyz": numbers_text(above.placement.position)}
            SubElement(joint, "origin", place | {"rpy": numbers_text(above.placement.roll_pitch_yaw)})
            SubElement(joint, "parent", link=above.parent)
            SubElement(joint, "child", link=body.name)
    for name, (other, ratio, offset) in robot.mimicked("a URDF for Drake").items():
        for joint in root.iterfind(f"joint[@name='{name}']"):
            for mimic in joint.findall("mimic"):
                joint.remove(mimic)
            numbers = {"multiplier": number_text(ratio), "offset": number_text(offset)}
            SubElement(joint, "mimic", {"joint": other, **numbers})


def _ball(root: Element, links: tuple[str, str], points: tuple[Vector, Vector]) -> None:
    element = _drake(root, "ball_constraint")
    for side, link in zip("AB", links, strict=True):
        _drake(element, f"ball_constraint_body_{side}", name=link)
    for side, point in zip(("p_AP", "p_BQ"), points, strict=True):
        _drake(element, f"ball_constraint_{side}", value=numbers_text(point))


def _filter_groups(robot: RobotDocument) -> Iterator[Element]:
    group = "filter_group_of_{}"
    for link in dict.fromkeys(link for pair in robot.untouchable for link in pair):
        element = Element(f"{{{DRAKE_NAMESPACE}}}collision_filter_group", name=group.format(link))
        _drake(element, "member", link=link)
        for one, other in robot.untouchable:
            if one == link:
                _drake(element, "ignored_collision_filter_group", name=group.format(other))
        yield element


def _drake(parent: Element, tag: str, **attributes: str) -> Element:
    return SubElement(parent, f"{{{DRAKE_NAMESPACE}}}{tag}", attributes)
