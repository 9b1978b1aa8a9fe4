"""URDF and SRDF files read into a Pinocchio model: silent on the terminal, with errors that name the place."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from pm3dof_pin.description.robots import read_xml
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.mechanism.joint_types import with_joint_types

UNLIMITED = sys.float_info.max
"""Pinocchio's limit of a coordinate that has none."""

_logger = logging.getLogger(__name__)
_redirection = threading.Lock()


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
        with captured_output() as said:
            if completed:
                model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
            else:
                model = pin.buildModelFromUrdf(str(urdf))
    except (ValueError, RuntimeError) as error:
        reason = first_error(said) or str(error)
        raise DescriptionError(urdf, "URDF", f"expected a robot that urdfdom accepts ({reason})") from error
    log_output(urdf, said)
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
                missing |= {"lower": repr(-UNLIMITED), "upper": repr(UNLIMITED)}
            complete = complete and missing.keys() <= limit.attrib.keys()
            for key, value in missing.items():
                limit.attrib.setdefault(key, value)
    return not complete


def read_named_configurations(model: pin.Model, srdf: Path) -> None:
    """Read the named configurations (`group_state`) of an SRDF into `model.referenceConfigurations`.

    Joints that the model does not have, such as a floating base that is fixed here, are passed over with a warning.

    Raises:
        DescriptionError: the file is unreadable, is no XML, or gives a joint no number.
    """
    for state in read_xml(srdf).iter("group_state"):
        for joint in state.iter("joint"):
            element, name = f"group_state '{state.get('name')}'", joint.get("name", "")
            if not model.existJointName(name):
                _logger.warning("%s: %s: no joint '%s' in the model: it is passed over", srdf, element, name)
            elif not _are_numbers(joint.get("value", "")):
                raise DescriptionError(srdf, f"{element}: joint '{name}'", "expected its value in numbers")
    with captured_output() as said:
        pin.loadReferenceConfigurations(model, str(srdf), False)
    log_output(srdf, said)


def _are_numbers(text: str) -> bool:
    try:
        return len([float(word) for word in text.split()]) > 0
    except ValueError:
        return False


@contextmanager
def captured_output() -> Iterator[list[str]]:
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


def first_error(lines: list[str]) -> str:
    """Return what a library said first, without the word Error."""
    return next((line.removeprefix("Error:").strip() for line in lines if line.strip()), "")


def log_output(path: Path, lines: list[str]) -> None:
    """Pass on what a library said about a file."""
    for line in lines:
        if line.strip():
            _logger.warning("%s: %s", path, line.strip())
