"""URDF and SRDF files read into a Pinocchio model: silent on the terminal, with errors that name the place."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pinocchio as pin

from pm3dof_pin.description.closures import ClosuresFile, LoopClosure, read_closures
from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup
from pm3dof_pin.description.robots import RobotFiles, read_xml
from pm3dof_pin.exceptions import DescriptionError, JointNotFoundError
from pm3dof_pin.mechanism.joint_types import with_joint_types

_UNLIMITED = sys.float_info.max
_logger = logging.getLogger(__name__)
_redirection = threading.Lock()


@dataclass(frozen=True, eq=False)
class Description:
    """What the files of a robot say, as the arguments of :class:`~pm3dof_pin.mechanism.mechanism.Mechanism`."""

    model: pin.Model
    closures: tuple[LoopClosure, ...]
    actuated_joints: tuple[str, ...]
    tool_frame: str | None
    motion_coordinates: tuple[str, ...]
    springs: tuple[Mapping[str, Any], ...]
    commands: tuple[Command, ...]
    coordinates: tuple[Coordinate, ...]
    limit_groups: tuple[LimitGroup, ...]
    source: Path


def read_description(files: RobotFiles, tool_frame: str | None = None) -> Description:
    """Read all files of a robot.

    Args:
        files: the files.
        tool_frame: frame of the tool, instead of the one described.

    Raises:
        DescriptionError: a file is unreadable or not of its form.
        JointNotFoundError: the closures file or the SRDF names a joint that the URDF does not have.
    """
    said = read_closures(files.closures) if files.closures is not None else ClosuresFile(files.path)
    model = read_model(files.urdf, joint_types=said.joint_types, source=files.source)
    _free_joints_without_limits(model, said.actuated_joints, files.path)
    if files.srdf is not None:
        _read_named_configurations(model, files.srdf)
    return Description(
        model=model,
        closures=said.closures,
        actuated_joints=said.actuated_joints,
        tool_frame=tool_frame or said.tool_frame,
        motion_coordinates=said.motion_coordinates,
        springs=said.springs,
        commands=said.commands,
        coordinates=said.coordinates,
        limit_groups=said.limit_groups,
        source=files.source,
    )


def read_model(urdf: Path, *, joint_types: Mapping[str, str] | None = None, source: Path | str = "") -> pin.Model:
    """Read the tree of a URDF. Revolute and prismatic joints without limits are unlimited.

    Args:
        urdf: the tree.
        joint_types: joints to replace, see :func:`~pm3dof_pin.mechanism.joint_types.with_joint_types`.
        source: file that says so, for messages.

    Raises:
        DescriptionError: the file is unreadable, is no XML (with the line), or is no URDF; or there is no such type.
        JointNotFoundError: a joint to be replaced is not there.
    """
    root = read_xml(urdf)
    completed = _complete_limits(root)
    try:
        with _captured_output() as said:
            if completed:
                model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
            else:
                model = pin.buildModelFromUrdf(str(urdf))
    except (ValueError, RuntimeError) as error:
        reason = _first_error(said) or str(error)
        raise DescriptionError(urdf, "URDF", f"expected a robot that urdfdom accepts ({reason})") from error
    _log(urdf, said)
    if root.find("joint/mimic") is not None:
        _logger.warning("%s: <mimic> is ignored, these joints are taken as joints of their own", urdf)
    return with_joint_types(model, joint_types, source) if joint_types else model


def _complete_limits(root: ElementTree.Element) -> bool:
    """Make joints without limits unlimited, which urdfdom has no other word for, and tell whether there are such."""
    complete = True
    for joint in root.iter("joint"):
        if joint.get("type") in ("revolute", "prismatic"):
            limit = joint.find("limit")
            if limit is None:
                limit = ElementTree.SubElement(joint, "limit")
            missing = {"effort": "0", "velocity": "0"}
            if "lower" not in limit.attrib and "upper" not in limit.attrib:
                missing |= {"lower": repr(-_UNLIMITED), "upper": repr(_UNLIMITED)}
            complete = complete and missing.keys() <= limit.attrib.keys()
            for key, value in missing.items():
                limit.attrib.setdefault(key, value)
    return not complete


def _free_joints_without_limits(model: pin.Model, actuated_joints: Sequence[str], path: Path) -> None:
    """Take limits 0 .. 0 for what they mean where every actuated joint has them: that none were given."""
    lower, upper = model.lowerPositionLimit, model.upperPositionLimit
    joints = list(zip(model.names, model.joints, strict=True))[1:]
    single = {name: joint.idx_q for name, joint in joints if joint.nq == joint.nv == 1}
    blocked = {name for name, index in single.items() if lower[index] == upper[index] == 0.0}
    if blocked and blocked >= (set(actuated_joints) & single.keys() or single.keys()):
        _logger.warning(
            "%s: limits 0 .. 0 at %d joints, all actuated ones among them, are taken as none given", path, len(blocked)
        )
        for name in blocked:
            lower[single[name]], upper[single[name]] = -_UNLIMITED, _UNLIMITED


def _read_named_configurations(model: pin.Model, srdf: Path) -> None:
    for state in read_xml(srdf).iter("group_state"):
        for joint in state.iter("joint"):
            element, name = f"group_state '{state.get('name')}'", joint.get("name", "")
            if not model.existJointName(name):
                raise JointNotFoundError(name, f"{srdf}: {element}", list(model.names)[1:])
            if not _are_numbers(joint.get("value", "")):
                raise DescriptionError(srdf, f"{element}: joint '{name}'", "expected its value in numbers")
    with _captured_output() as said:
        pin.loadReferenceConfigurations(model, str(srdf), False)
    _log(srdf, said)


def _are_numbers(text: str) -> bool:
    try:
        return len([float(word) for word in text.split()]) > 0
    except ValueError:
        return False


@contextmanager
def _captured_output() -> Iterator[list[str]]:
    """Catch what C++ libraries write to the terminal, as lines that stand in the list once the block is left.

    urdfdom has no other way of saying what is wrong with a file than to write on file descriptor 2.
    """
    lines: list[str] = []
    with _redirection, tempfile.TemporaryFile() as sink:
        for stream in (sys.stdout, sys.stderr):
            if stream is not None:
                stream.flush()
        kept = [(descriptor, os.dup(descriptor)) for descriptor in (1, 2) if _is_open(descriptor)]
        try:
            for descriptor, _ in kept:
                os.dup2(sink.fileno(), descriptor)
            yield lines
        finally:
            for descriptor, copy in kept:
                os.dup2(copy, descriptor)
                os.close(copy)
            sink.seek(0)
            lines.extend(sink.read().decode(errors="replace").splitlines())


def _is_open(descriptor: int) -> bool:
    try:
        os.fstat(descriptor)
    except OSError:
        return False
    return True


def _first_error(lines: list[str]) -> str:
    return next((line.removeprefix("Error:").strip() for line in lines if line.strip()), "")


def _log(path: Path, lines: list[str]) -> None:
    for line in lines:
        if line.strip():
            _logger.warning("%s: %s", path, line.strip())
