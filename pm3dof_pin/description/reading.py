"""The description of a robot from its files: the tree in any dialect, the closures file and the SRDF."""

from __future__ import annotations

import logging
import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from types import MappingProxyType

from pm3dof_pin.description.closures import ClosuresFile, read_closures
from pm3dof_pin.description.description import Body, Description, Drive, Frame, Joint, universal_hinges
from pm3dof_pin.description.origin import Origin
from pm3dof_pin.description.physical_bounds import ANY, parse_numbers
from pm3dof_pin.description.readers import loop_closures
from pm3dof_pin.description.readers.mjcf import read_mjcf
from pm3dof_pin.description.readers.sdf import read_sdf
from pm3dof_pin.description.readers.urdf import read_urdf
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.description.xml_file import children, read_xml
from pm3dof_pin.description.yaml_file import naming_lines

_logger = logging.getLogger(__name__)


def read_description(files: RobotFiles, *, lenient: bool = False) -> Description:
    """Read all files of a robot; entries of the closures file take precedence over those of the tree's file.

    Args:
        files: the files, see :func:`~pm3dof_pin.description.robots.find_robot`.
        lenient: whether elements that could carry a loop, a coupling or a drive, and are not understood, are only
            listed in :attr:`Description.unread` instead of being refused.

    Raises:
        DescriptionError: a file is unreadable or malformed.
        JointNotFoundError: the closures file names a joint that the tree does not have.
    """
    description = READERS[files.format](files, lenient)
    with naming_lines():
        if files.closures is not None and files.closures.name == loop_closures.FILE_NAME:
            description = loop_closures.with_loop_closures(description, files.closures)
        elif files.closures is not None:
            description = _completed(description, read_closures(files.closures))
    if description.closures and not description.actuated_joints and description.drives:
        driven = dict.fromkeys(drive.joint for drive in description.drives)
        description = replace(description, actuated_joints=tuple(driven))
    description = _without_limits_of_zero(_with_turns_counted(description))
    if files.srdf is not None:
        description = _with_srdf(description, files)
    return replace(description, files=files)


def _read_urdf(files: RobotFiles, lenient: bool) -> Description:
    return read_urdf(files.read_tree(), lenient=lenient)


def _read_mjcf(files: RobotFiles, lenient: bool) -> Description:
    return read_mjcf(files.path, files.own_folders, lenient=lenient, root=files.read_tree())


def _read_sdf(files: RobotFiles, lenient: bool) -> Description:
    return read_sdf(files.read_tree(), files.own_folders, lenient=lenient)


READERS: Mapping[str, Callable[[RobotFiles, bool], Description]] = MappingProxyType(
    {"urdf": _read_urdf, "mjcf": _read_mjcf, "sdf": _read_sdf}
)
"""Readers of the tree, by dialect."""


def _completed(description: Description, file: ClosuresFile) -> Description:
    """Return a description with the entries of a closures file."""
    description = _with_numbers(_with_joint_types(description, file), file)
    loops = description.closures
    if file.replaces_loops and loops:
        _logger.info("%s: its loops stand in place of those of %s", file.path, description.origin.path)
        loops = ()
    taken = (
        *("motion_coordinates", "coordinates", "limit_groups", "tool_motions", "tool_frame", "actuated_joints"),
        "closure_tolerance",
    )
    own = {spring.get("name") for spring in file.springs}  # in place of those of the same name
    given = {name: value for name in taken if (value := getattr(file, name))}
    return replace(
        description,
        closures=(*loops, *file.closures),
        couplings=(*description.couplings, *file.couplings),
        springs=(*(s for s in description.springs if s.get("name") not in own), *file.springs),
        commands=file.commands or (() if file.actuated_joints else description.commands),
        **given,
    )


def _with_numbers(description: Description, file: ClosuresFile) -> Description:
    """Return a description with the file's numbers of joints, and of the first drive of joints."""
    if not (file.joints or file.drives):
        return description
    joints = {}
    for name, numbers in file.joints.items():
        if not (joint := description.joint(name, f"{file.path}: joints")).is_single:
            raise Origin(file.path).error(f"joints.{name}", f"expected a single-DoF joint, not a {joint.type} one")
        joints[name] = replace(joint, **numbers)
    drives = list(description.drives)
    for name, numbers in file.drives.items():
        description.joint(name, f"{file.path}: drives")
        index = next((k for k, drive in enumerate(drives) if drive.joint == name), len(drives))
        if index == len(drives):
            drives.append(Drive(name, name))
        if numbers.get("gear") == 0.0:
            raise Origin(file.path).error(f"drives.{name}.gear", "expected a ratio that is not 0")
        drives[index] = replace(drives[index], **numbers)
    return replace(description.with_joints(joints), drives=tuple(drives))


def _with_joint_types(description: Description, file: ClosuresFile) -> Description:
    """Return a description with joints replaced as the loader of example-parallel-robots does it.

    The new joints have the frames of the old ones, no limits, and no place in named configurations. A universal joint
    becomes two joints, `name_X` and `name_Y` for UJOINT_XY (or any two of the axes); the frame `name` moves with the
    second.
    """
    if not file.joint_types:
        return description
    bodies, frames = list(description.bodies), list(description.frames)
    joints: list[Joint] = []
    for name, kind in file.joint_types.items():
        description.joint(name, f"{file.path}: joint_name")
        if kind.upper() not in ("SPHERICAL", "FIXED") and not _universal_axes(kind):
            expected = f"'{kind}' of '{name}' is unknown, expected SPHERICAL, FIXED or UJOINT_XY (two of X, Y, Z)"
            raise Origin(file.path).error("joint_type", expected)
    for joint in description.joints:
        kind = file.joint_types.get(joint.name, "")
        if axes := _universal_axes(kind):
            cross = Body(f"{joint.name}_{axes}", origin=joint.origin)
            bodies.append(cross)
            frames.append(Frame(joint.name, joint.child, joint.child_placement.inverse(), joint.origin))
            joints += universal_hinges(joint, cross.name, axes)
        elif kind.upper() == "SPHERICAL":
            joints.append(replace(joint, type="spherical", lower=None, upper=None, effort=None, velocity=None))
        else:
            joints.append(replace(joint, type="fixed") if kind else joint)
    configurations = {
        name: {joint: numbers for joint, numbers in values.items() if joint not in file.joint_types}
        for name, values in description.configurations.items()
    }
    return replace(
        description,
        bodies=tuple(bodies),
        joints=tuple(joints),
        frames=tuple(frames),
        configurations=configurations,
    )


def _universal_axes(kind: str) -> str:
    found = re.fullmatch(r"UJOINT_([XYZ])(?!\1)([XYZ])", kind.upper())
    return found[1] + found[2] if found else ""


def _with_turns_counted(description: Description) -> Description:
    """Return a description whose continuous joints count their turns where others follow them by a broken ratio."""
    counted = {
        name: replace(joint, type="revolute", lower=None, upper=None)
        for coupling in description.couplings
        for name, powers in zip(coupling.joints, coupling.coefficients, strict=True)
        if (joint := description.joint_by_name.get(name)) is not None
        and joint.type == "continuous"
        and (len(powers) > 1 or powers[0] % 1.0 or description.joint(coupling.joint).type == "prismatic")
    }
    return description.with_joints(counted) if counted else description


def _without_limits_of_zero(description: Description) -> Description:
    """Treat limits 0 .. 0 of all actuated joints as not given."""
    limited = [joint for joint in description.joints if joint.is_single and joint.type != "continuous"]
    blocked = {joint.name: joint for joint in limited if joint.lower == joint.upper == 0.0}
    names = {joint.name for joint in limited}
    if not blocked or not blocked.keys() >= (set(description.actuated_joints) & names or names):
        return description
    message = "%s: limits 0 .. 0 of %d joints, including all actuated ones, are treated as not given"
    _logger.warning(message, description.origin.path, len(blocked))
    return description.with_joints({n: replace(joint, lower=None, upper=None) for n, joint in blocked.items()})


def _with_srdf(description: Description, files: RobotFiles) -> Description:
    """Return a description with the named configurations (`group_state`) and collision pairs of the SRDF.

    Joints that the tree does not have, such as a floating base that is fixed here, are ignored with a warning.
    """
    assert files.srdf is not None
    root = read_xml(files.srdf)
    configurations = dict(description.configurations)
    for state in children(root, "group_state"):
        element, values = f"group_state '{state.get('name')}'", {}
        for entry in children(state, "joint"):
            joint = description.joint_by_name.get(entry.get("name", ""))
            if joint is None or joint.is_fixed:
                message = "%s: %s: no joint '%s' in the model: ignored"
                _logger.warning(message, files.srdf, element, entry.get("name", ""))
                continue
            numbers, problem = parse_numbers(entry.get("value", ""), ANY)
            sizes = (1, 2) if joint.type == "continuous" else (joint.nq,)
            if not problem and len(numbers) not in sizes:
                problem = f"expected a value of {joint.nq} number(s), not '{entry.get('value', '')}'"
            if not problem and len(numbers) > 1 and not math.hypot(*numbers[_turn(joint) :]):
                problem = "expected nonzero quaternions and cosine-sine pairs"
            if problem:
                raise entry.origin.error(f"{element}: joint '{joint.name}'", problem)
            values[joint.name] = numbers
        configurations[str(state.get("name"))] = values
    pairs = [(pair.get("link1", ""), pair.get("link2", "")) for pair in children(root, "disable_collisions")]
    untouchable = tuple(pair for pair in pairs if set(pair) <= description.body_by_name.keys())
    return replace(description, configurations=configurations, untouchable=(*description.untouchable, *untouchable))


def _turn(joint: Joint) -> int:
    """Return where the cosine and sine, or the quaternion, of a joint begin in its numbers."""
    return {"planar": 2, "floating": 3}.get(joint.type, 0)
