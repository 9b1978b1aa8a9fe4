"""Drake: a URDF with loop closures, by Drake's extensions."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from pm3dof_pin.export.plain_urdf import urdf_element
from pm3dof_pin.export.robot_document import RobotDocument
from pm3dof_pin.export.urdf_document import WORLD
from pm3dof_pin.export.xml_text import document_text, numbers_text

MESH_KINDS = (".obj", ".gltf", ".vtk")
"""Suffixes of the mesh files that Drake accepts as collision shapes; it fails on others."""

_NAMESPACE = "http://drake.mit.edu"
ElementTree.register_namespace("drake", _NAMESPACE)

_BANNER = "{name} for Drake, generated from its description by `pm3dof export drake`. Edit that, not this file."


def drake_text(robot: RobotDocument) -> str:
    """Write a robot as a URDF for Drake.

    It is the robot's URDF, fixed to the world, with `<drake:ball_constraint>` for the loop closures, a transmission for
    every actuated joint, and a filter group for each body that the SRDF or a closure keeps from colliding with another.
    Drake's URDF has no weld: a 6d closure becomes three ball constraints, at the origin of the two frames and on their
    x and y axes. These are nine equations of rank six; the three forces are not unique, but their resultant is. A plant
    accepts ball constraints only if it is discrete and uses SAP.
    """
    root = urdf_element(robot.with_meshes_of(MESH_KINDS))
    _omit_unknown_limits(root, robot.mechanism.actuated_joints)
    _fix_to_world(root, robot.urdf.root.name)
    for name in robot.mechanism.actuated_joints:
        if not any(joint.get("name") == name for joint in root.findall("transmission/joint")):
            _transmission(root, name)
    for loop, links in zip(robot.closures, robot.closure_links, strict=True):
        arm = float(f"{robot.mechanism.characteristic_length:.1g}")  # a round number of the size of the robot
        for point in [(0.0, 0.0, 0.0)] if loop.type == "3d" else [(0.0, 0.0, 0.0), (arm, 0.0, 0.0), (0.0, arm, 0.0)]:
            _ball(root, links, numbers_text(point))
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


def _ball(root: Element, links: tuple[str, str], point: str) -> None:
    element = _drake(root, "ball_constraint")
    for side, link in zip("AB", links, strict=True):
        _drake(element, f"ball_constraint_body_{side}", name=link)
    for side in ("p_AP", "p_BQ"):
        _drake(element, f"ball_constraint_{side}", value=point)


def _filter_groups(robot: RobotDocument) -> Iterator[Element]:
    group = "filter_group_of_{}"
    for link in dict.fromkeys(link for pair in robot.untouchable for link in pair):
        element = Element(f"{{{_NAMESPACE}}}collision_filter_group", name=group.format(link))
        _drake(element, "member", link=link)
        for one, other in robot.untouchable:
            if one == link:
                _drake(element, "ignored_collision_filter_group", name=group.format(other))
        yield element


def _drake(parent: Element, tag: str, **attributes: str) -> Element:
    return SubElement(parent, f"{{{_NAMESPACE}}}{tag}", attributes)
