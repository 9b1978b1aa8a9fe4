"""The closures file: what a URDF, being a tree, cannot describe of a closed-chain robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal

import msgspec

from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup, ToolComponent, Unit
from pm3dof_pin.description.physical_bounds import LENGTH
from pm3dof_pin.description.schema import Length, Name, Schema, checked
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError

ClosureType = Literal["3d", "6d"]

_LEAST_SCALE = 1e-9


@dataclass(frozen=True)
class LoopClosure:
    """One loop closure between two frames of the tree."""

    frame_a: str  #: frame at the end of one branch
    frame_b: str  #: frame at the end of the other
    type: ClosureType  # "3d", the origins coincide (a spherical joint), or "6d", the frames coincide (a weld)
    swing_limit: float | None = None  #: maximum angle between the z axes of the two frames [rad], or None


@dataclass(frozen=True)
class ClosuresFile:
    """A checked closures file; its names are not yet compared with the URDF.

    The keys `closed_loop`, `type`, `name_mot`, `joint_name` and `joint_type` are those of the `robot.yaml` files of
    example-parallel-robots; the others are this package's own.
    """

    path: Path  #: the file
    closures: tuple[LoopClosure, ...] = ()  #: the loop closures
    actuated_joints: tuple[str, ...] = ()  #: names of the actuated joints (`name_mot`), in order
    tool_frame: str | None = None  #: frame whose pose, twist and stiffness are those of "the tool", or None
    #: joints whose rates are the platform's independent motions; empty if there are none
    motion_coordinates: tuple[str, ...] = ()
    springs: tuple[Mapping[str, Any], ...] = ()  #: raw spring entries, not yet parsed
    #: joint types that replace those of the URDF (`joint_name`, `joint_type`): SPHERICAL, FIXED or UJOINT_XY (any
    #: two axes)
    joint_types: Mapping[str, str] = field(default_factory=dict)
    commands: tuple[Command, ...] = ()  #: counter readings of the drives; empty if none are declared
    coordinates: tuple[Coordinate, ...] = ()  #: coordinates that place the tool; empty if none are declared
    limit_groups: tuple[LimitGroup, ...] = ()  #: named groups of limits; empty if none are declared
    #: components of the tool's twist that make up its motion; empty for all
    tool_motions: tuple[ToolComponent, ...] = ()


class _SwingLimit(Schema):
    swing_rad: Annotated[float, msgspec.Meta(gt=0.0, le=math.pi)]


class _Coordinate(Schema):
    name: Name
    unit: Unit
    joint: Name | None = None
    tool: ToolComponent | None = None
    offset: float = 0.0
    scale: float = 1.0
    range: tuple[Length, Length] | None = None


class ClosuresSchema(Schema):
    """The keys and value types of a closures file."""

    closed_loop: list[tuple[Name, Name]] | None = None
    type: list[Literal["3d", "3D", "6d", "6D"]] | None = None
    name_mot: list[Name] | None = None
    joint_name: list[Name] | None = None
    joint_type: list[Name] | None = None
    tool_frame: Name | None = None
    motion_coordinates: list[Name] | None = None
    closure_limits: list[_SwingLimit | None] | None = None
    springs: list[dict[str, Any]] | None = None
    commands: list[Command] | None = None
    coordinates: list[_Coordinate] | None = None
    limit_groups: dict[Name, list[Name | int]] | None = None
    tool_motions: Annotated[list[ToolComponent], msgspec.Meta(min_length=1)] | None = None


def read_closures(path: Path | str) -> ClosuresFile:
    """Read and check a closures file: YAML with the keys of :class:`ClosuresFile`.

    Raises:
        DescriptionError: the file is unreadable, or has an unknown key or a malformed entry.
    """
    path = Path(path)
    file = checked(read_mapping(path), ClosuresSchema, path)
    closures, commands = _closures(path, file), _commands(path, file)
    for key in ("name_mot", "motion_coordinates", "joint_name", "tool_motions"):
        _require_unique(path, key, getattr(file, key) or ())
    for key in ("commands", "coordinates"):
        _require_unique(path, key, [entry.name for entry in getattr(file, key) or ()])
    return ClosuresFile(
        path=path,
        closures=closures,
        actuated_joints=tuple(file.name_mot or [command.joint for command in commands]),
        tool_frame=file.tool_frame,
        motion_coordinates=tuple(file.motion_coordinates or ()),
        springs=tuple(file.springs or ()),
        joint_types=dict(_pairs(path, "joint_name", file.joint_name, "joint_type", file.joint_type)),
        commands=commands,
        coordinates=tuple(_coordinate(path, k, entry) for k, entry in enumerate(file.coordinates or ())),
        limit_groups=tuple(
            _limit_group(path, name, members, closures) for name, members in (file.limit_groups or {}).items()
        ),
        tool_motions=tuple(file.tool_motions or ()),
    )


def _closures(path: Path, file: ClosuresSchema) -> tuple[LoopClosure, ...]:
    loops = list(_pairs(path, "closed_loop", file.closed_loop, "type", file.type))
    limits = [None] * len(loops) if file.closure_limits is None else file.closure_limits
    limited = _pairs(path, "closed_loop", loops, "closure_limits", limits)
    return tuple(
        LoopClosure(frame_a, frame_b, "3d" if kind in ("3d", "3D") else "6d", limit and limit.swing_rad)
        for ((frame_a, frame_b), kind), limit in limited
    )


def _commands(path: Path, file: ClosuresSchema) -> tuple[Command, ...]:
    for k, entry in enumerate(file.commands or ()):
        _require_scale(path, f"commands[{k}]", entry)
    commands = tuple(file.commands or ())
    if commands and file.name_mot and [command.joint for command in commands] != file.name_mot:
        raise DescriptionError(
            path, "commands", f"expected one for each joint of name_mot, in that order: {', '.join(file.name_mot)}"
        )
    return commands


def _coordinate(path: Path, index: int, entry: _Coordinate) -> Coordinate:
    place = f"coordinates[{index}]"
    lower, upper = entry.range or (None, None)
    if (entry.joint is None) == (entry.tool is None):
        raise DescriptionError(path, place, "expected either 'joint' or 'tool'")
    if entry.tool and ((entry.tool in ("x", "y", "z")) != (entry.unit == "m") or entry.offset or entry.scale != 1.0):
        raise DescriptionError(path, place, f"expected 'tool: {entry.tool}' with its unit, no offset and no scale")
    _require_scale(path, place, entry)
    if lower is not None and upper is not None and not lower < upper:
        raise DescriptionError(path, f"{place}.range", f"expected [lower, upper], not [{lower}, {upper}]")
    return Coordinate(
        entry.name, entry.unit, entry.joint, entry.tool, entry.offset, entry.scale, lower=lower, upper=upper
    )


def _require_scale(path: Path, place: str, entry: Command | _Coordinate) -> None:
    scale = entry.scale
    if not _LEAST_SCALE <= abs(scale) <= 1.0 / _LEAST_SCALE:
        expected = f"expected a magnitude from {_LEAST_SCALE:g} to {1.0 / _LEAST_SCALE:g}, not {scale:g}"
        raise DescriptionError(path, f"{place}.scale", expected)
    if problem := LENGTH.problem(entry.offset / scale):
        raise DescriptionError(path, f"{place}.offset", f"divided by the scale: {problem}")


def _limit_group(path: Path, name: str, members: Sequence[str | int], closures: Sequence[LoopClosure]) -> LimitGroup:
    """Sort the members into joints and closures; closures are given as "frame_a-frame_b" or by index."""
    positions = {f"{closure.frame_a}-{closure.frame_b}": k for k, closure in enumerate(closures)}
    positions |= {str(k): k for k in range(len(closures))}
    for member in members:
        if isinstance(member, int) and str(member) not in positions:
            raise DescriptionError(
                path, f"limit_groups.{name}", f"expected closures 0 .. {len(closures) - 1}, not {member}"
            )
    return LimitGroup(
        name,
        tuple(str(member) for member in members if str(member) not in positions),
        tuple(positions[str(member)] for member in members if str(member) in positions),
    )


def _pairs(path: Path, key: str, entries: Sequence[Any] | None, other: str, others: Sequence[Any] | None) -> Any:
    """Pair the entries of two lists of equal length."""
    entries, others = entries or (), others or ()
    if len(entries) != len(others):
        raise DescriptionError(
            path, other, f"expected one entry for each of the {len(entries)} entries of {key}, not {len(others)}"
        )
    return zip(entries, others, strict=True)


def _require_unique(path: Path, key: str, names: Sequence[str]) -> None:
    if twice := next((name for name in names if names.count(name) > 1), None):
        raise DescriptionError(path, key, f"duplicate '{twice}', expected every name once")
