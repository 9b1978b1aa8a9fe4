"""The error file: which joints and frames of a robot may be misplaced, and their tolerances."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import msgspec

from pm3dof_pin.description.schema import AngleTolerance, LengthTolerance, Name, Schema, checked
from pm3dof_pin.description.source_numbers import SourceNumbers
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError

AXES = ("x", "y", "z")
Word = Literal["x", "y", "z", "along", "across"]


@dataclass(frozen=True)
class ErrorEntry:
    """One entry of the error file."""

    group: str  #: class of parts
    places: tuple[str, ...]  #: joints or frames
    #: directions in each place's own axes: x, y, z, along the joint's axis, or across it (two)
    translations: tuple[str, ...]
    rotations: tuple[str, ...]  #: axes, named the same way
    length_tolerance: float  #: tolerance of the translations [m]
    angle_tolerance: float  #: tolerance of the rotations [rad]


@dataclass(frozen=True)
class TiedEntry:
    """Displacements that are one parameter."""

    name: str  #: its name
    parts: Mapping[str, float]  #: factor of each displacement, named as parameters are: joint1.tx
    group: str  #: its class
    tolerance: float  #: standard deviation [m, rad]
    unit: str  #: of the tolerance, "m" or "rad"


@dataclass(frozen=True)
class ErrorFile:
    """A checked error file; its names are not yet compared with the URDF."""

    path: Path  #: the file
    entries: tuple[ErrorEntry, ...]  #: its entries
    #: by actuated joint, the frame from which its command is measured along the joint axis
    command_zeros: Mapping[str, str]
    sources: SourceNumbers  #: parameters of all other error sources
    ties: tuple[TiedEntry, ...] = ()  #: tied parameters


class LineSchema(Schema):
    """Errors of some places, by their directions."""

    at: Name | list[Name]
    translation: Word | list[Word] | None = None
    rotation: Word | list[Word] | None = None


class ClassSchema(Schema):
    """A class of errors with common tolerances."""

    length_tolerance_m: LengthTolerance
    angle_tolerance_rad: AngleTolerance
    errors: list[LineSchema]


class TieSchema(Schema):
    """Displacements that are one parameter: their factors, or a list of equal ones."""

    of: dict[str, float] | list[str]
    tolerance_m: LengthTolerance | None = None
    tolerance_rad: AngleTolerance | None = None
    group: Name = msgspec.field(name="class", default="tied")


class ErrorFileSchema(Schema):
    """The keys and value types of an error file."""

    classes: dict[str, ClassSchema] = msgspec.field(default_factory=dict)
    ties: dict[Name, TieSchema] = msgspec.field(default_factory=dict)
    command_zeros: dict[Name, Name] | None = None
    sources: SourceNumbers = SourceNumbers()


def read_error_file(path: Path | str) -> ErrorFile:
    """Read and check an error file: YAML like `robots/pm3dof_description/urdf/pm3dof.errors.yaml`.

    Raises:
        DescriptionError: the file is unreadable, or has an unknown key or a malformed entry.
    """
    path = Path(path)
    file = checked(read_mapping(path), ErrorFileSchema, path)
    if not (file.classes or file.ties):
        raise DescriptionError(path, "classes", "expected named classes of parts")
    entries = []
    for group, body in file.classes.items():
        if not body.errors:
            raise DescriptionError(path, f"classes.{group}.errors", "expected a list of {at, translation, rotation}")
        for index, line in enumerate(body.errors):
            places, translations, rotations = (_listed(part) for part in (line.at, line.translation, line.rotation))
            if not places or not (translations or rotations):
                element = f"classes.{group}.errors[{index}]"
                raise DescriptionError(path, element, "expected 'at', and 'translation' or 'rotation'")
            tolerances = (body.length_tolerance_m, body.angle_tolerance_rad)
            entries.append(ErrorEntry(group, places, translations, rotations, *tolerances))
    ties = tuple(_tie(path, name, body) for name, body in file.ties.items())
    return ErrorFile(path, tuple(entries), file.command_zeros or {}, file.sources, ties)


def _tie(path: Path, name: str, body: TieSchema) -> TiedEntry:
    parts = body.of if isinstance(body.of, dict) else dict.fromkeys(body.of, 1.0)
    for part, factor in parts.items():
        if not (math.isfinite(factor) and factor != 0.0):
            problem = f"expected a finite factor of {part} other than 0, not {factor:g}"
            raise DescriptionError(path, f"ties.{name}.of", problem)
    if len(parts) < len(body.of):
        twice = next(part for part in body.of if list(body.of).count(part) > 1)
        raise DescriptionError(path, f"ties.{name}.of", f"expected each displacement once, not {twice} twice")
    tolerances = [(body.tolerance_m, "m"), (body.tolerance_rad, "rad")]
    given = [(size, unit) for size, unit in tolerances if size is not None]
    if not parts or len(given) != 1:
        raise DescriptionError(
            path, f"ties.{name}", "expected 'of' with parts, and either tolerance_m or tolerance_rad"
        )
    return TiedEntry(name, parts, body.group, *given[0])


def error_file_text(
    entries: Sequence[ErrorEntry], *, comment: str, command_zeros: Mapping[str, str], ties: Sequence[TiedEntry] = ()
) -> str:
    """Return the text of an error file, headed by a comment; a class takes the tolerances of its first entry."""
    lines = [f"# {line}".rstrip() for line in comment.splitlines()]
    if command_zeros:
        zeros = ", ".join(f"{joint}: {frame}" for joint, frame in command_zeros.items())
        lines += ["", f"command_zeros: {{{zeros}}}"]
    if ties:
        lines += ["", "ties:"]
    for tie in ties:
        of = ", ".join(f"{name}: {_number(factor)}" for name, factor in tie.parts.items())
        tolerance = f"tolerance_{tie.unit}: {_number(tie.tolerance)}"
        lines += [f"  {tie.name}: {{of: {{{of}}}, {tolerance}, class: {tie.group}}}"]
    if entries:
        lines += ["", "classes:"]
    for group in dict.fromkeys(entry.group for entry in entries):
        own = [entry for entry in entries if entry.group == group]
        lines += [
            f"  {group}:",
            f"    length_tolerance_m: {_number(own[0].length_tolerance)}",
            f"    angle_tolerance_rad: {_number(own[0].angle_tolerance)}",
            "    errors:",
        ]
        for entry in own:
            parts = {"at": entry.places, "translation": entry.translations, "rotation": entry.rotations}
            words = [f"{key}: [{', '.join(names)}]" for key, names in parts.items() if names]
            lines += [f"      - {{{', '.join(words)}}}"]
    return "\n".join(lines) + "\n"


def _number(value: float) -> str:
    """Format a number so that YAML 1.1 reads it as a number."""
    text = repr(value)
    return text if "e" not in text or "." in text else text.replace("e", ".0e")


def _listed(words: str | Sequence[str] | None) -> tuple[str, ...]:
    return (words,) if isinstance(words, str) else tuple(words or ())
