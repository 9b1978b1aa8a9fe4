"""The error file: which joints and frames of a robot may sit wrong, and within which tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError

AXES = ("x", "y", "z")
_WORDS = (*AXES, "along", "across")
_CLASS_KEYS = {"length_tolerance_m", "angle_tolerance_rad", "errors"}
_ENTRY_KEYS = {"at", "translation", "rotation"}


@dataclass(frozen=True)
class ErrorEntry:
    """One line of the error file.

    Attributes:
        group: class of parts.
        places: joints or frames.
        translations: directions in each place's own axes: x, y, z, along the joint's axis, or across it (two).
        rotations: axes, in the same words.
        length_tolerance: tolerance of the translations [m].
        angle_tolerance: tolerance of the rotations [rad].
    """

    group: str
    places: tuple[str, ...]
    translations: tuple[str, ...]
    rotations: tuple[str, ...]
    length_tolerance: float
    angle_tolerance: float


@dataclass(frozen=True)
class ErrorFile:
    """An error file as read and checked, names not yet compared with the URDF.

    Attributes:
        path: the file.
        entries: its lines.
        command_zeros: for an actuated joint, the frame from which its command counts, along the joint's axis.
    """

    path: Path
    entries: tuple[ErrorEntry, ...]
    command_zeros: Mapping[str, str]


def read_error_file(path: Path | str) -> ErrorFile:
    """Read and check an error file.

    Args:
        path: YAML file with the keys `command_zeros` (optional) and `classes`; see
            `robots/pm3dof_description/urdf/pm3dof.errors.yaml`.

    Raises:
        DescriptionError: the file is unreadable, has an unknown key, or an entry is not of its form.
    """
    path = Path(path)
    data = read_mapping(path)
    _known(path, "file", data, {"command_zeros", "classes"})
    classes = data.get("classes")
    if not isinstance(classes, dict) or not classes:
        raise DescriptionError(path, "classes", "expected classes of parts by name")
    entries = [entry for group, body in classes.items() for entry in _entries(path, str(group), body)]
    return ErrorFile(path, tuple(entries), _command_zeros(path, data.get("command_zeros") or {}))


def _entries(path: Path, group: str, body: Any) -> list[ErrorEntry]:
    where = f"classes.{group}"
    if not isinstance(body, dict):
        raise DescriptionError(path, where, f"expected the keys {', '.join(sorted(_CLASS_KEYS))}")
    _known(path, where, body, _CLASS_KEYS)
    length, angle = (_positive(path, where, body, key) for key in ("length_tolerance_m", "angle_tolerance_rad"))
    lines = body.get("errors")
    if not isinstance(lines, list) or not lines:
        raise DescriptionError(path, f"{where}.errors", "expected a list of {at, translation, rotation}")
    return [_entry(path, f"{where}.errors[{k}]", group, line, length, angle) for k, line in enumerate(lines)]


def _entry(path: Path, where: str, group: str, line: Any, length: float, angle: float) -> ErrorEntry:
    if not isinstance(line, dict):
        raise DescriptionError(path, where, "expected {at, translation, rotation}")
    _known(path, where, line, _ENTRY_KEYS)
    places = _names(path, f"{where}.at", line.get("at"))
    translations, rotations = (_names(path, f"{where}.{key}", line.get(key, [])) for key in ("translation", "rotation"))
    for word in (*translations, *rotations):
        if word not in _WORDS:
            raise DescriptionError(path, where, f"expected some of {', '.join(_WORDS)}, not '{word}'")
    if not places or not (translations or rotations):
        raise DescriptionError(path, where, "expected a place, and a translation or a rotation of it")
    return ErrorEntry(group, places, translations, rotations, length, angle)


def _command_zeros(path: Path, data: Any) -> dict[str, str]:
    if not isinstance(data, dict) or not all(isinstance(name, str) for pair in data.items() for name in pair):
        raise DescriptionError(path, "command_zeros", "expected a frame's name for each joint's")
    return dict(data)


def _names(path: Path, where: str, value: Any) -> tuple[str, ...]:
    names = [value] if isinstance(value, str) else value
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise DescriptionError(path, where, "expected a name or a list of names")
    return tuple(names)


def _positive(path: Path, where: str, body: Mapping[str, Any], key: str) -> float:
    value = body.get(key)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not (math.isfinite(value) and value > 0.0):
        raise DescriptionError(path, f"{where}.{key}", "expected a positive number")
    return float(value)


def _known(path: Path, where: str, data: Mapping[str, Any], keys: set[str]) -> None:
    for key in data:
        if key not in keys:
            raise DescriptionError(path, f"{where}: {key}", f"unknown key, expected some of {', '.join(sorted(keys))}")
