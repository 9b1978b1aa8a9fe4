"""Files of a calibrated machine: the URDF with joints and frames at the calibrated places, and its closures."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.description.robots import CLOSURES_SUFFIX
from pm3dof_pin.description.urdf_files import urdf_files
from pm3dof_pin.description.xml_file import comment_text, read_xml
from pm3dof_pin.description.yaml_file import read_mapping, yaml_text
from pm3dof_pin.elastic.tool_deflection import stiffened_entries
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import chapter_angles, chapter_rotation
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.files import write_text_atomically
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.robot import Robot

logger = logging.getLogger(__name__)

_BANNER = '<?xml version="1.0"?>\n<!-- {name} with {count} calibrated geometric parameters. -->\n'


def _calibrated_urdf(errors: GeometricErrors, values: ArrayLike | Mapping[str, float], urdf: Path | str) -> str:
    """Return a robot's URDF with geometric parameters p, all or by name, applied to its joints at full precision.

    Actuator offsets go into the origins too, so commands keep their meaning.

    Raises:
        DescriptionError: the file is unreadable, or a parameter's place is neither a joint nor a link at the end of a
            fixed joint, with an origin.
        InvalidValueError: an unknown parameter, a wrong shape, or a number that is not finite.
    """
    path = Path(urdf)
    robot = read_xml(path)
    for place, displacement in errors.displacements(values).items():
        if place not in errors.robot.rods:  # whose lengths are in the closures file
            _displace(path, robot, place, displacement)
    ElementTree.indent(robot, "  ")
    banner = _BANNER.format(name=comment_text(robot.get("name", path.stem)), count=len(errors))
    return banner + ElementTree.tostring(robot, encoding="unicode") + "\n"


def write_calibrated_robot(
    errors: GeometricErrors,
    values: ArrayLike | Mapping[str, float],
    directory: Path | str,
    stiffness: Mapping[str, float] | None = None,
) -> Path:
    """Write a calibrated robot with closures, SRDF and error file, loadable like any other; return its URDF.

    The SRDF's named configurations keep their commands, with the loops closed again. A robot in another format, or with
    joints that URDF lacks, becomes a plain URDF. `stiffness` gives, by spring, how many times stiffer it is than
    described.

    Raises:
        DescriptionError: a parameter's place is neither a joint nor a link at the end of a fixed joint, with an
            origin.
        OutputError: a file cannot be written.
    """
    robot, folder = errors.robot, Path(directory)
    own = {name: getattr(robot, name) for name in ("actuated_joints", "commands", "springs", "tool_frame")}
    own["closures"] = errors.apply(values).closures  # with rods of other lengths
    name = robot.name if robot.files is None else robot.files.name
    texts = urdf_files(replace(robot.description, **own))
    paths = {suffix: write_text_atomically(folder / f"{name}{suffix}", text) for suffix, text in texts.items()}
    target, closures, srdf = (paths.get(suffix) for suffix in (".urdf", CLOSURES_SUFFIX, ".srdf"))
    assert target is not None
    write_text_atomically(target, _calibrated_urdf(errors, values, target))
    if closures is not None and (stiffness or robot.rods):
        entries = read_mapping(closures)
        if stiffness:
            entries["springs"] = stiffened_entries(entries.get("springs", ()), stiffness, closures)
        if robot.rods and "closed_loop" in entries:
            entries["closure_lengths"] = [loop.length for loop in own["closures"]]
        write_text_atomically(closures, yaml_text(entries))
    if srdf is not None:
        write_text_atomically(srdf, _closed_again(srdf, Robot.load(target)))
    declared = errors.file or (None if robot.files is None else robot.files.errors)
    if declared is not None and declared.is_file():
        write_text_atomically(folder / f"{name}.errors.yaml", declared.read_text(encoding="utf-8"))
    return target


def _closed_again(srdf: Path, calibrated: Robot) -> str:
    """Return an SRDF with the named configurations of the calibrated machine at the same commands."""
    tree = ElementTree.parse(srdf, ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True)))
    for state in tree.getroot().findall("group_state"):
        name = state.get("name", "")
        described = calibrated.configuration(calibrated.named_configurations[name])
        commands = {name: described.joint_position(name) for name in calibrated.actuated_joints}
        result = assemble(calibrated, described, joints=commands)
        if not result.converged:
            logger.warning("named configuration '%s' is left out: its loops no longer close", name)
            tree.getroot().remove(state)
            continue
        for joint in state.findall("joint"):
            index = calibrated.model.joints[calibrated.model.getJointId(joint.get("name", ""))]
            joint.set("value", _text(result.configuration.q[index.idx_q : index.idx_q + index.nq]))
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(tree.getroot(), encoding="unicode") + "\n"


def _displace(path: Path, robot: ElementTree.Element, place: str, displacement: pin.SE3) -> None:
    joint = robot.find(f"joint[@name='{place}']")
    if joint is None:
        link = robot.find(f"joint/child[@link='{place}']/..")
        joint = link if link is not None and link.get("type") == "fixed" else None
    if joint is None:
        raise DescriptionError(path, place, "expected a joint, or a link at the end of a fixed joint, with an origin")
    origin = joint.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(joint, "origin")
    position, roll_pitch_yaw = (_numbers(path, place, origin, key) for key in ("xyz", "rpy"))
    moved = pin.SE3(chapter_rotation(roll_pitch_yaw[::-1]), position) * displacement
    origin.set("xyz", _text(moved.translation))
    if displacement.rotation.tolist() != np.eye(3).tolist():
        origin.set("rpy", _text(chapter_angles(moved.rotation)[::-1]))


def _numbers(
    path: Path, place: str, origin: ElementTree.Element, key: str
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    try:
        numbers = np.array([float(word) for word in origin.get(key, "0 0 0").split()])
    except ValueError as error:
        raise DescriptionError(path, f"{place}: {key}", f"expected numbers ({error})") from error
    if numbers.shape != (3,):
        raise DescriptionError(path, f"{place}: {key}", "expected three numbers")
    return numbers


def _text(numbers: ArrayLike) -> str:
    return " ".join(repr(float(number)) for number in np.asarray(numbers))
