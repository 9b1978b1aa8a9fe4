"""The SRDF as text, generated from its xacro, with every named configuration completed by closing the loops."""

from __future__ import annotations

import logging
import tempfile
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

from pm3dof_pin.description.robots import CLOSURES_SUFFIX
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.mechanism.configuration import Configuration

_logger = logging.getLogger(__name__)

_DIGITS = 14
"""Decimals of joint values: stops are then met exactly, and loops stay closed to 1e-13."""

_GENERATED = " Generated from the YAML in config/. Edit that, not this file. "
_SECTIONS = {
    "group": " Groups ",
    "group_state": " Configurations with every loop closed and every joint within its limits ",
    "passive_joint": " Joints without a motor ",
    "disable_collisions": " Bodies that touch because a joint or a loop closure joins them ",
}


def srdf_text(xacro: Path, expanded: str, urdf: str, closures: str) -> str:
    """Complete the expanded xacro of an SRDF from URDF and closures file.

    Its named configurations (`group_state`) give the joints that define them; the others follow from closing the loops.
    Those that cannot be reached within all joint limits are omitted, and logged. Passive joints are all joints that the
    closures file does not name as actuated.

    Raises:
        DescriptionError: a value in it is not a number.
        JointNotFoundError: it names a joint that the URDF does not have.
    """
    source = ElementTree.fromstring(expanded)
    mechanism = _mechanism(source.get("name", ""), urdf, closures)
    joints = _movable_joints(urdf)
    passive = [name for name in joints if name not in mechanism.actuated_joints]
    sections = {
        "group": source.findall("group"),
        "group_state": list(_complete(xacro, mechanism, source.findall("group_state"), joints)),
        "passive_joint": [ElementTree.Element("passive_joint", name=name) for name in passive],
        "disable_collisions": source.findall("disable_collisions"),
    }
    robot = ElementTree.Element("robot", source.attrib)
    robot.append(ElementTree.Comment(_GENERATED))
    for tag, elements in sections.items():
        if elements:
            robot.append(ElementTree.Comment(_SECTIONS[tag]))
            robot.extend(elements)
    ElementTree.indent(robot, "  ")
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(robot, encoding="unicode")}\n'


def write_configuration(path: Path, name: str, configuration: Configuration) -> None:
    """Write a named configuration into an SRDF, in place of one of this name; the file is made if there is none.

    Raises:
        DescriptionError: the file is no XML.
        OutputError: it cannot be written.
    """
    robot, root = configuration.mechanism, ElementTree.Element("robot", name=configuration.mechanism.name)
    if path.is_file():
        try:
            builder = ElementTree.TreeBuilder(insert_comments=True)
            root = ElementTree.parse(path, ElementTree.XMLParser(target=builder)).getroot()
        except ElementTree.ParseError as error:
            raise DescriptionError(path, "file", f"is no XML: {error}") from error
    for state in root.findall("group_state"):
        if state.get("name") == name:
            root.remove(state)
    state = ElementTree.SubElement(root, "group_state", name=name, group="all")
    for joint, kind in list(zip(robot.model.names, robot.model.joints, strict=True))[1:]:
        if kind.nv == 1:
            values = [round(configuration.joint_position(joint), _DIGITS) + 0.0]
        else:
            values = configuration.q[kind.idx_q : kind.idx_q + kind.nq].tolist()
        ElementTree.SubElement(state, "joint", name=joint, value=" ".join(map(repr, values)))
    ElementTree.indent(root, "  ")
    write_text_atomically(path, f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n')


def _mechanism(name: str, urdf: str, closures: str) -> Robot:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.urdf"
        path.write_text(urdf, encoding="utf-8")
        path.with_name(name + CLOSURES_SUFFIX).write_text(closures, encoding="utf-8")
        return Robot.load(path)


def _movable_joints(urdf: str) -> list[str]:
    """Names of the movable joints of a URDF, in the order of the file."""
    joints = ElementTree.fromstring(urdf).findall("joint")
    return [joint.get("name", "") for joint in joints if joint.get("type") != "fixed"]


def _complete(
    xacro: Path, mechanism: Robot, states: list[ElementTree.Element], joints: list[str]
) -> Iterator[ElementTree.Element]:
    for state in states:
        joint_positions = {joint.get("name", ""): _number(xacro, state, joint) for joint in state.findall("joint")}
        result = assemble(mechanism, mechanism.home, joints=joint_positions)
        if obstacle := _obstacle(result.configuration) if result.converged else "the loops do not close":
            _logger.warning("no named configuration '%s': %s", state.get("name"), obstacle)
            continue
        complete = ElementTree.Element("group_state", state.attrib)
        for joint in joints:
            # adding zero turns minus zero into zero
            value = round(result.configuration.joint_position(joint), _DIGITS) + 0.0
            ElementTree.SubElement(complete, "joint", name=joint, value=repr(value))
        yield complete


def _number(xacro: Path, state: ElementTree.Element, joint: ElementTree.Element) -> float:
    try:
        return float(joint.get("value", ""))
    except ValueError as error:
        element = f"group_state '{state.get('name')}': joint '{joint.get('name')}'"
        raise DescriptionError(xacro, element, f"expected one number, not '{joint.get('value')}'") from error


def _obstacle(configuration: Configuration) -> str:
    """What prevents this configuration; "" if nothing does."""
    for violation in configuration.violated_limits():
        return f"{violation.name} at {violation.value:.6g} is outside {violation.lower:.6g} .. {violation.upper:.6g}"
    return ""
