"""URDF and SRDF files read into a Pinocchio model: silent on the terminal, with errors that name the place."""

from __future__ import annotations

import logging
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from xml.etree import ElementTree

import pinocchio as pin

from pm3dof_pin.exceptions import DescriptionError, JointNotFoundError

_logger = logging.getLogger(__name__)
_redirection = threading.Lock()


def read_model(urdf: Path, srdf: Path | None = None) -> pin.Model:
    """Read a robot's tree and its named configurations.

    Args:
        urdf: the tree.
        srdf: its named configurations (`group_state`), which become `model.referenceConfigurations`.

    Raises:
        DescriptionError: a file is unreadable, is no XML (with the line), or is no URDF or SRDF.
        JointNotFoundError: the SRDF names a joint that the URDF does not have.
    """
    root = _xml_root(urdf)
    try:
        with _captured_output() as said:
            model = pin.buildModelFromUrdf(str(urdf))
    except (ValueError, RuntimeError) as error:
        reason = _first_error(said) or str(error)
        raise DescriptionError(urdf, "URDF", f"expected a robot that urdfdom accepts ({reason})") from error
    _log(urdf, said)
    if root.find("joint/mimic") is not None:
        _logger.warning("%s: <mimic> is ignored, these joints are taken as joints of their own", urdf)
    if srdf is not None:
        _read_named_configurations(model, srdf)
    return model


def _read_named_configurations(model: pin.Model, srdf: Path) -> None:
    for state in _xml_root(srdf).iter("group_state"):
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


def _xml_root(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except OSError as error:
        raise DescriptionError(path, "file", f"expected a readable file ({error.strerror})") from error
    except ElementTree.ParseError as error:
        line, column = error.position
        raise DescriptionError(path, f"line {line}, column {column}", f"expected XML ({error})") from error


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
