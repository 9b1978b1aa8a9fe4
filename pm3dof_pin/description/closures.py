"""The closures file: what a URDF, being a tree, cannot describe of a closed-chain robot."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import msgspec
import numpy as np

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.closure_types import CLOSURE_TYPE_NAMES, CLOSURE_TYPES, ClosureType, ClosureTypeName
from pm3dof_pin.description.coordinates import Command, Coordinate, LimitGroup, ToolComponent, Unit
from pm3dof_pin.description.couplings import MAX_DEGREE, Coupling
from pm3dof_pin.description.origin import NOWHERE, Origin
from pm3dof_pin.description.physical_bounds import LENGTH
from pm3dof_pin.description.schema import Length, Name, NotNegative, Positive, PositiveLength, Schema, checked
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError
from pm3dof_pin.typing import Matrix

_MIN_SCALE = 1e-9
_MIN_LENGTH = 1e-6  # m
_UNIT = 1e-12  # relative rounding of a unit vector

Axis: TypeAlias = tuple[float, float, float]


@dataclass(frozen=True)
class LoopClosure:
    """One loop closure between two frames of the tree.

    Raises:
        InvalidValueError: the type is unknown, or has no use for an axis or length given, or lacks its length.
    """

    frame_a: str  #: frame at the end of one branch
    frame_b: str  #: frame at the end of the other
    #: a name of :data:`CLOSURE_TYPES` or one of its aliases, such as "3d", the origins coincide (a spherical joint),
    #: or "6d", the frames coincide (a weld)
    type: ClosureTypeName
    swing_limit: float | None = None  #: maximum angle between the z axes of the two frames [rad], or None
    #: the closure's axis in frame a, a unit vector: z by default, for a universal joint x. Also that of frame b,
    #: unless this has its own
    axis: Axis | None = None
    #: its axis in frame b, a unit vector; for a universal joint the second axis, y by default
    axis_b: Axis | None = None
    length: float | None = None  #: the distance of the origins [m] that a closure of type "distance" holds
    #: 2 for the second closure whose frames have these names: see :func:`uniquely_named`
    repetition: int = field(default=1, repr=False)
    origin: Origin = field(default=NOWHERE, compare=False, repr=False)  #: where it is described

    def __post_init__(self) -> None:
        """Replace an alias by the type's name, make the axes unit vectors, and check what the type needs."""
        if (name := CLOSURE_TYPE_NAMES.get(self.type)) is None:
            raise InvalidValueError("type", self.type, f"one of {', '.join(CLOSURE_TYPES)}")
        object.__setattr__(self, "type", name)
        kind = self.kind
        for key, is_allowed in (("axis", kind.axis is not None), ("axis_b", kind.has_two_axes)):
            if (axis := getattr(self, key)) is not None:
                if not is_allowed:
                    raise InvalidValueError(key, list(axis), f"none for a closure of type {name}")
                object.__setattr__(self, key, _unit_vector(key, axis))
        if kind.is_distance and not (self.length is not None and _MIN_LENGTH <= self.length <= LENGTH.greatest):
            raise InvalidValueError("length", self.length, f"the distance of the origins, at least {_MIN_LENGTH:g} m")
        if self.length is not None and not kind.is_distance:
            raise InvalidValueError("length", self.length, f"none for a closure of type {name}")

    @property
    def kind(self) -> ClosureType:
        """Its row in the table of types."""
        return CLOSURE_TYPES[self.type]

    @property
    def name(self) -> str:
        """Its name: `frame_a-frame_b`, with `-2` for a second one."""
        return self.joined("-")

    def joined(self, separator: str) -> str:
        """Return its name with another separator than the hyphen."""
        repetition = [str(self.repetition)] if self.repetition > 1 else []
        return separator.join([self.frame_a, self.frame_b, *repetition])

    @property
    def bases(self) -> tuple[Matrix, Matrix] | None:
        """The axes x, y, z of the type in frames a and b, as columns, shape=(3, 3) each; None if they are the frames'.

        An axis given with the closure turns those of its frame by the least angle.
        """
        if self.axis is None and self.axis_b is None:
            return None
        first = self.kind.axis or 0
        second = 1 if self.type == "universal" else first
        other = self.axis_b or (None if self.type == "universal" else self.axis)
        return _turned(first, self.axis), _turned(second, other)


def _unit_vector(name: str, axis: Axis) -> Axis:
    vector = finite_array(name, axis, (3,))
    if not (length := float(np.linalg.norm(vector))) > 0.0:
        raise InvalidValueError(name, list(axis), "three numbers that are not all zero")
    x, y, z = (vector if abs(length - 1.0) < _UNIT else vector / length).tolist()
    return x, y, z


def _turned(k: int, axis: Axis | None) -> Matrix:
    """Return the least rotation that takes a unit vector to an axis, shape=(3, 3)."""
    if axis is None:
        return np.eye(3)
    unit, direction = np.eye(3)[k], np.array(axis)
    cosine = float(unit @ direction)
    if cosine <= -1.0 + _UNIT:
        return np.diag(2.0 * np.eye(3)[(k + 1) % 3] - 1.0)
    x, y, z = np.cross(unit, direction)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + cosine))


def uniquely_named(closures: Iterable[LoopClosure]) -> tuple[LoopClosure, ...]:
    """Return closures of which no two have the same name: those between the same frames are counted."""
    found: dict[str, LoopClosure] = {}
    for loop in closures:
        named = (replace(loop, repetition=k) for k in count(1))
        first = next(each for each in named if each.name not in found)
        found[first.name] = first
    return tuple(found.values())


@dataclass(frozen=True)
class ClosuresFile:
    """A checked closures file; its names are not yet compared with the URDF.

    The keys `closed_loop`, `type`, `name_mot`, `joint_name` and `joint_type` are those of the `robot.yaml` files of
    example-parallel-robots; the others are this package's own.
    """

    path: Path  #: the file
    closures: tuple[LoopClosure, ...] = ()  #: the loop closures
    couplings: tuple[Coupling, ...] = ()  #: the couplings of joints
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
    closure_tolerance: float | None = None  #: largest closure error of closed loops [m, rad]; None for the usual one
    replaces_loops: bool = False  #: whether the closures stand in place of those that the tree's file has
    #: numbers of joints that replace those of the tree's file, by joint and name of :class:`JointSchema`
    joints: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    #: numbers of drives that replace those of the tree's file, by joint and name of :class:`DriveSchema`
    drives: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)


class JointSchema(Schema):
    """Numbers of a joint for which the dialect of the tree has no words [N, N m, m/s, rad/s, ...]."""

    effort: Positive | None = None
    velocity: Positive | None = None
    damping: NotNegative | None = None
    friction: NotNegative | None = None
    armature: NotNegative | None = None


class DriveSchema(Schema):
    """Numbers of a drive for which the dialect of the tree has no words, as in :class:`Drive`, in m, N, rad."""

    gear: Annotated[float, msgspec.Meta(ge=-1e6, le=1e6)] | None = None
    rotor_inertia: NotNegative | None = None
    kind: Name | None = None
    proportional_gain: NotNegative | None = None
    derivative_gain: NotNegative | None = None
    control_range: tuple[float, float] | None = None
    control_gain: float | None = None
    force_range: tuple[float, float] | None = None


class SwingLimitSchema(Schema):
    """The swing limit of a closure [rad]."""

    swing_rad: Annotated[float, msgspec.Meta(gt=0.0, le=math.pi)]


class CoordinateSchema(Schema):
    """A coordinate that places the tool."""

    name: Name
    unit: Unit
    joint: Name | None = None
    tool: ToolComponent | None = None
    offset: float = 0.0
    scale: float = 1.0
    range: tuple[Length, Length] | None = None


class AxesSchema(Schema):
    """The axes of a closure, in its first and second frame."""

    axis: Axis | None = None
    axis_b: Axis | None = None


class CouplingSchema(Schema):
    """A joint that follows others: coefficients by joint."""

    joint: Name
    of: dict[Name, float | Annotated[list[float], msgspec.Meta(min_length=1, max_length=MAX_DEGREE)]]
    offset: float = 0.0


class ClosuresSchema(Schema):
    """The keys and value types of a closures file."""

    closed_loop: list[tuple[Name, Name]] | None = None
    type: list[Name] | None = None
    closure_axes: list[AxesSchema | None] | None = None
    closure_lengths: list[PositiveLength | None] | None = None
    couplings: list[CouplingSchema] | None = None
    name_mot: list[Name] | None = None
    joint_name: list[Name] | None = None
    joint_type: list[Name] | None = None
    tool_frame: Name | None = None
    motion_coordinates: list[Name] | None = None
    closure_limits: list[SwingLimitSchema | None] | None = None
    springs: list[dict[str, Any]] | None = None
    commands: list[Command] | None = None
    coordinates: list[CoordinateSchema] | None = None
    limit_groups: dict[Name, list[Name | int]] | None = None
    tool_motions: Annotated[list[ToolComponent], msgspec.Meta(min_length=1)] | None = None
    closure_tolerance: Annotated[float, msgspec.Meta(gt=0.0, le=1e-2)] | None = None
    replaces_loops: bool = False
    joints: dict[Name, JointSchema] | None = None
    drives: dict[Name, DriveSchema] | None = None


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
        couplings=tuple(_coupling(path, k, entry) for k, entry in enumerate(file.couplings or ())),
        actuated_joints=tuple(file.name_mot or [command.joint for command in commands]),
        tool_frame=file.tool_frame,
        closure_tolerance=file.closure_tolerance,
        motion_coordinates=tuple(file.motion_coordinates or ()),
        springs=tuple(file.springs or ()),
        joint_types=dict(_pairs(path, "joint_name", file.joint_name, "joint_type", file.joint_type)),
        commands=commands,
        coordinates=tuple(_coordinate(path, k, entry) for k, entry in enumerate(file.coordinates or ())),
        limit_groups=tuple(
            _limit_group(path, name, members, closures) for name, members in (file.limit_groups or {}).items()
        ),
        tool_motions=tuple(file.tool_motions or ()),
        replaces_loops=file.replaces_loops,
        joints={name: _given(entry) for name, entry in (file.joints or {}).items()},
        drives={name: _given(entry) for name, entry in (file.drives or {}).items()},
    )


def _given(entry: Schema) -> Mapping[str, Any]:
    return {name: value for name, value in msgspec.structs.asdict(entry).items() if value is not None}


def _closures(path: Path, file: ClosuresSchema) -> tuple[LoopClosure, ...]:
    loops = list(_pairs(path, "closed_loop", file.closed_loop, "type", file.type))
    columns: dict[str, Sequence[Any]] = {}
    for key in ("closure_limits", "closure_axes", "closure_lengths"):
        entries = getattr(file, key)
        columns[key] = [None] * len(loops) if entries is None else entries
        _pairs(path, "closed_loop", loops, key, columns[key])
    closures = []
    for k, (((a, b), kind), limit, axes, length) in enumerate(zip(loops, *columns.values(), strict=True)):
        try:
            swing, (axis, axis_b) = limit and limit.swing_rad, (axes.axis, axes.axis_b) if axes else (None, None)
            closures.append(LoopClosure(a, b, kind, swing, axis, axis_b, length, origin=Origin(path)))
        except InvalidValueError as error:
            place = {"type": "type", "length": "closure_lengths"}.get(error.name, "closure_axes")
            place = f"{place}[{k}]" + (f".{error.name}" if error.name.startswith("axis") else "")
            raise DescriptionError(path, place, f"expected {error.expected}, not {error.value!r}") from error
    return uniquely_named(closures)


def _coupling(path: Path, index: int, entry: CouplingSchema) -> Coupling:
    powers = [(c,) if isinstance(c, float) else tuple(c) for c in entry.of.values()]
    try:
        return Coupling(entry.joint, tuple(entry.of), tuple(powers), entry.offset, Origin(path))
    except InvalidValueError as error:
        raise DescriptionError(path, f"couplings[{index}]", f"expected {error.expected}") from error


def _commands(path: Path, file: ClosuresSchema) -> tuple[Command, ...]:
    for k, entry in enumerate(file.commands or ()):
        _require_scale(path, f"commands[{k}]", entry)
    commands = tuple(file.commands or ())
    if commands and file.name_mot and [command.joint for command in commands] != file.name_mot:
        raise DescriptionError(
            path, "commands", f"expected one for each joint of name_mot, in that order: {', '.join(file.name_mot)}"
        )
    return commands


def _coordinate(path: Path, index: int, entry: CoordinateSchema) -> Coordinate:
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


def _require_scale(path: Path, place: str, entry: Command | CoordinateSchema) -> None:
    scale = entry.scale
    if not _MIN_SCALE <= abs(scale) <= 1.0 / _MIN_SCALE:
        expected = f"expected a magnitude from {_MIN_SCALE:g} to {1.0 / _MIN_SCALE:g}, not {scale:g}"
        raise DescriptionError(path, f"{place}.scale", expected)
    if problem := LENGTH.problem(entry.offset / scale):
        raise DescriptionError(path, f"{place}.offset", f"divided by the scale: {problem}")


def _limit_group(path: Path, name: str, members: Sequence[str | int], closures: Sequence[LoopClosure]) -> LimitGroup:
    """Sort the members into joints and closures; closures are given as "frame_a-frame_b" or by index."""
    positions = {closure.name: k for k, closure in enumerate(closures)}
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
