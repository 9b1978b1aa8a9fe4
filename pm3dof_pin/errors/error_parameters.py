"""Geometric errors of any robot: displacements of joints and frames, as named parameters with tolerances."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Unpack

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.description.error_file import AXES, ErrorFile, TiedEntry, read_error_file
from pm3dof_pin.description.source_numbers import SourceNumbers
from pm3dof_pin.exceptions import DescriptionError, InvalidValueError, JointNotFoundError
from pm3dof_pin.kinematics.robot import LoadOptions, Robot
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Matrix, Motion, Vector

Distribution = Literal["normal", "uniform"]

HALF_WIDTH = math.sqrt(3.0)
"""Half width of a uniform distribution, in standard deviations."""

LENGTH_TOLERANCE = 1e-4
"""Default tolerance of a length [m]."""
ANGLE_TOLERANCE = 5e-4
"""Default tolerance of an angle [rad]: 0.1 mm over 0.2 m."""

_ALONG, _ROD_AXIS = "_along", (1.0, 0.0, 0.0)
_NEARLY_PARALLEL = 0.99
_UNIT = 1e-5  # greatest difference of an axis length from 1


@dataclass(frozen=True)
class GeometricParameter:
    """One small displacement of a joint or frame from its described place, or a change of the length of a rod.

    A rod is a closure of type "distance": its name is the place, and its only error a translation along its x axis,
    from the first frame to the second. Elsewhere, everything attached to the place moves with it. A displacement along
    (about) the axis of a prismatic (revolute) joint is an offset of its coordinate: the actuator's zero.
    """

    name: str  #: its name, usually `place.tx` or `place.rz`
    place: str  #: the joint, frame or rod
    motion: Motion  #: "translation" or "rotation"
    axis: tuple[float, float, float]  #: unit vector in the place's own axes, those of its origin before the joint moves
    group: str  #: its class of parts: legs, platform, tool
    tolerance: float  #: standard deviation of a normal, or half width of a uniform distribution [m, rad]

    @property
    def unit(self) -> str:
        """Return "m" or "rad"."""
        return "m" if self.motion == "translation" else "rad"

    @property
    def parts(self) -> tuple[tuple[GeometricParameter, float], ...]:
        """Itself with the factor 1, as those of a :class:`TiedParameter`."""
        return ((self, 1.0),)


@dataclass(frozen=True)
class TiedParameter:
    """Displacements that are one number of the machine: the radius of three towers, the length of six equal rods.

    Each part is displaced by its factor times the number.
    """

    name: str  #: its name
    parts: tuple[tuple[GeometricParameter, float], ...]  #: displacements, all translations or all rotations; factors
    group: str  #: its class
    tolerance: float  #: as of a :class:`GeometricParameter` [m, rad]

    @property
    def place(self) -> str:
        """The place of its first part."""
        return self.parts[0][0].place

    @property
    def motion(self) -> Motion:
        """The motion of its parts."""
        return self.parts[0][0].motion

    @property
    def axis(self) -> tuple[float, float, float]:
        """The axis of its first part."""
        return self.parts[0][0].axis

    @property
    def unit(self) -> str:
        """Return "m" or "rad"."""
        return self.parts[0][0].unit


class GeometricErrors:
    """The geometric error parameters of one robot. Immutable.

    The parameters p at one place displace its placement M to M D, D = (exp3(sum of the rotations), sum of the
    translations), in the place's own axes: finite, not linearised.

    Example:
        >>> import pm3dof_pin as pm
        >>> errors = pm.GeometricErrors.load("pm3dof")
        >>> errors.apply({"slider1_joint.tx": 1e-4}).forward([0.24, 0.24, 0.24]).commands
        array([0.24, 0.24, 0.24])

    Args:
        robot: the robot as described.
        parameters: the error parameters; by default all, see :func:`all_parameters`. Redundant parameters are harmless:
            :mod:`pm3dof_pin.calibration.identifiability` finds them. A :class:`TiedParameter` moves several places.
        fixed_bearings: coordinate of each actuated joint at the fixed bearing of its screw, from which it expands
            as it warms up, shape=(number of actuated joints,) [m, rad]; 0 by default.
        file: the error file that declares them, if any.

    The arguments are attributes too.

    Attributes:
        parameters: the parameters, in the order of p; their `names`.
        components: the errors of single places that they consist of: these errors themselves if none are tied.
        combinations: values of the components by one unit of each parameter, shape=(components, parameters).
        tolerances: of the parameters, shape=(number of parameters,) [m, rad].

    Raises:
        InvalidValueError: two parameters share a name, an axis is not a unit vector, or a tolerance is not positive; an
            error of a rod is not along it; or a tied parameter has a displacement twice, or a factor that is 0 or not
            finite.
        FrameNotFoundError: a place is neither a joint nor a frame of the robot, nor one of its rods.
    """

    def __init__(
        self,
        robot: Robot,
        parameters: Iterable[GeometricParameter | TiedParameter] | None = None,
        *,
        fixed_bearings: ArrayLike | None = None,
        file: Path | None = None,
    ) -> None:
        require_kind("robot", robot, Robot, "pm.load")
        self.robot = robot
        self.parameters: tuple[GeometricParameter | TiedParameter, ...] = tuple(
            all_parameters(robot) if parameters is None else parameters
        )
        self.names = tuple(parameter.name for parameter in self.parameters)
        self.file = file
        self._index = {name: index for index, name in enumerate(self.names)}
        _check(robot, self.parameters)
        self.tolerances = frozen(np.array([parameter.tolerance for parameter in self.parameters], dtype=float))
        actuated = len(robot.actuated_joints)
        bearings = np.zeros(actuated) if fixed_bearings is None else fixed_bearings
        self.fixed_bearings = frozen(finite_array("fixed_bearings", bearings, (actuated,)))
        self.components, self.combinations = self, frozen(np.eye(len(self.parameters)))
        if any(isinstance(parameter, TiedParameter) for parameter in self.parameters):
            self.components, self.combinations = _components(self)
        self._places = _places_in_order(robot, {parameter.place for parameter in self.parameters})
        numbers = {place: number for number, place in enumerate(self._places)}
        self._place_numbers = np.array([numbers[parameter.place] for parameter in self.parameters], dtype=np.intp)
        turning = [parameter.motion == "rotation" for parameter in self.parameters]
        self._turning = np.array(turning, dtype=np.intp)
        self._axes = np.array([parameter.axis for parameter in self.parameters], dtype=float).reshape(-1, 3)
        self._movers: dict[int, Vector] = {}

    @classmethod
    def load(cls, source: str | Path | pin.Model | Robot, **options: Unpack[LoadOptions]) -> GeometricErrors:
        """Load a robot with the error parameters of its `<stem>.errors.yaml`; without that file, with all of them.

        Arguments are those of :meth:`Robot.load <pm3dof_pin.kinematics.robot.Robot.load>`, or a robot that is loaded.

        Raises:
            UnknownRobotError: no such robot.
            DescriptionError: a file is unreadable or malformed.
            FrameNotFoundError: a file names a joint or frame that the URDF does not have.
        """
        robot = source if isinstance(source, Robot) else Robot.load(source, **options)
        return cls(robot) if robot.files is None else cls.from_file(robot, robot.files.errors)

    @classmethod
    def from_file(cls, robot: Robot, file: Path) -> GeometricErrors:
        """Return the error parameters that a file declares for a robot; all of them if the file does not exist.

        Raises:
            DescriptionError: the file is unreadable or malformed.
            FrameNotFoundError: it names a joint or frame that the robot does not have.
        """
        if not file.is_file():
            return cls(robot)
        declared = read_error_file(file)
        return cls(robot, _parameters_of(robot, declared), fixed_bearings=_fixed_bearings(robot, declared), file=file)

    def __len__(self) -> int:
        return len(self.parameters)

    def __repr__(self) -> str:
        counts = ", ".join(f"{len(self.indices(group))} {group}" for group in self.groups)
        return f"GeometricErrors({self.robot.name}: {len(self)} parameters: {counts})"

    def __reduce__(self) -> tuple[object, ...]:
        bearings = np.array(self.fixed_bearings)
        return functools.partial(GeometricErrors, fixed_bearings=bearings, file=self.file), (
            self.robot,
            self.parameters,
        )

    @functools.cached_property
    def groups(self) -> tuple[str, ...]:
        """Classes of parts, ordered by their first parameter."""
        return tuple(dict.fromkeys(parameter.group for parameter in self.parameters))

    @functools.cached_property
    def units(self) -> tuple[str, ...]:
        """Unit of each parameter, "m" or "rad"."""
        return tuple(parameter.unit for parameter in self.parameters)

    @property
    def zeros(self) -> Vector:
        """The p of the robot as described, shape=(number of parameters,)."""
        return np.zeros(len(self))

    def indices(self, group: str) -> NDArray[np.intp]:
        """Return the indices in p of a class of parts.

        Raises:
            InvalidValueError: there is no such class.
        """
        found = np.array([k for k, parameter in enumerate(self.parameters) if parameter.group == group], dtype=np.intp)
        if not found.size:
            raise InvalidValueError("group", group, f"one of {', '.join(self.groups)}")
        return found

    def select(self, names: Iterable[str]) -> GeometricErrors:
        """Return the errors with these parameters only, in this order.

        Raises:
            InvalidValueError: there is no parameter of this name.
        """
        chosen = [self.parameters[self._parameter(name)] for name in names]
        return GeometricErrors(self.robot, chosen, fixed_bearings=self.fixed_bearings, file=self.file)

    def without(self, names: Iterable[str]) -> GeometricErrors:
        """Return the errors without these parameters; InvalidValueError as for :meth:`select`."""
        dropped = {self._parameter(name) for name in names}
        return self.select(name for index, name in enumerate(self.names) if index not in dropped)

    def values(self, values: ArrayLike | Mapping[str, float]) -> Vector:
        """Return p, shape=(number of parameters,) [m, rad], checked; parameters not given by name are 0.

        Raises:
            InvalidValueError: an unknown name, a wrong shape, or a number that is not finite.
        """
        if isinstance(values, Mapping):
            p = self.zeros
            for name, value in values.items():
                p[self._parameter(name)] = value
            values = p
        return finite_array("geometric errors", values, (len(self),))

    def named(self, values: ArrayLike | Mapping[str, float]) -> dict[str, float]:
        """Return p by name [m, rad]."""
        return dict(zip(self.names, self.values(values).tolist(), strict=True))

    def sample(self, generator: np.random.Generator, distribution: Distribution = "normal") -> Vector:
        """Draw p at random; its tolerances are standard deviations ("normal"), or half widths ("uniform")."""
        normal = distribution == "normal"
        unit = generator.standard_normal(len(self)) if normal else generator.uniform(-1.0, 1.0, len(self))
        return self.tolerances * unit

    def displacements(self, values: ArrayLike | Mapping[str, float]) -> dict[str, pin.SE3]:
        """Return the displacement D of each place, in its own axes, ordered from the root; rods last."""
        if self.components is not self:
            return self.components.displacements(self.combinations @ self.values(values))
        moves = np.zeros((2, len(self._places), 3))
        np.add.at(moves, (self._turning, self._place_numbers), self.values(values)[:, None] * self._axes)
        return {place: pin.SE3(pin.exp3(turn), shift) for place, shift, turn in zip(self._places, *moves, strict=True)}

    def local_twists(self, values: ArrayLike | Mapping[str, float]) -> Matrix:
        """Return the twist of each place per unit of its parameters, in the axes of the displaced place.

        Returns:
            Columns [v; omega] at the place's origin, shape=(6, number of parameters). At p = 0 they are the axes;
            elsewhere the derivative of exp3 makes them exact.
        """
        rotations = [displacement.rotation for displacement in self.displacements(values).values()]
        by_shift_and_turn = np.array([(turn.T, pin.Jexp3(pin.log3(turn))) for turn in rotations]).reshape(-1, 2, 3, 3)
        columns = np.zeros((len(self), 2, 3))
        derivatives = by_shift_and_turn[self._place_numbers, self._turning]
        columns[np.arange(len(self)), self._turning] = np.einsum("kij,kj->ki", derivatives, self._axes)
        return columns.reshape(-1, 6).T

    @functools.cached_property
    def moved(self) -> dict[str, tuple[set[int], set[int]]]:
        """The joints and frames, by index, that move with each place; all frames on these joints also move."""
        return {place: _moved_by(self.robot, place) for place in self._places}

    def movers(self, frame: int) -> Vector:
        """Indicate which joint velocities and then errors move a frame, 1 or 0, shape=(nv + number of parameters,)."""
        if frame not in self._movers:
            model = self.robot.model
            body = model.frames[frame].parentJoint
            moves = np.zeros(model.nv + len(self))
            for joint in model.supports[body].tolist()[1:]:
                moves[model.idx_vs[joint] : model.idx_vs[joint] + model.nvs[joint]] = 1.0
            moved = [body in joints or frame in frames for joints, frames in self.moved.values()]
            moves[model.nv :] = np.array(moved, dtype=float)[self._place_numbers]
            self._movers[frame] = frozen(moves)
        return self._movers[frame]

    def apply(self, values: ArrayLike | Mapping[str, float]) -> Robot:
        """Build a new robot with these errors; see :meth:`values` for their form and the errors raised."""
        nominal = self.robot
        model = nominal.model.copy()
        hanging, lengthened = self.components._hanging, dict[str, float]()
        for place, displacement in self.displacements(values).items():
            if place in nominal.rods:
                lengthened[place] = float(displacement.translation[0])
            elif place in hanging:
                _displace_frames(model, hanging[place], displacement)
            else:
                joint = model.getJointId(place)
                model.jointPlacements[joint] = model.jointPlacements[joint] * displacement
        return nominal.displaced(model, lengthened)

    @functools.cached_property
    def _hanging(self) -> dict[str, list[int]]:
        """Each place that is a frame, with the frames attached to it, itself first."""
        model = self.robot.model
        return {
            place: _frame_and_descendants(model, self.robot.frame_id(place))
            for place in self._places
            if not (place in self.robot.rods or model.existJointName(place))
        }

    def _parameter(self, name: str) -> int:
        if name not in self._index:
            raise InvalidValueError("geometric parameter", name, f"one of {', '.join(self.names)}")
        return self._index[name]


def _components(errors: GeometricErrors) -> tuple[GeometricErrors, Matrix]:
    """Return the displacements of single places that parameters consist of, and their values by one unit of each."""
    every = {(part.place, part.motion, part.axis): part for own in errors.parameters for part, _ in own.parts}
    numbers = {key: k for k, key in enumerate(every)}
    combinations = np.zeros((len(every), len(errors)))
    for column, parameter in enumerate(errors.parameters):
        for part, factor in parameter.parts:
            combinations[numbers[part.place, part.motion, part.axis], column] += factor
    named = [replace(part, name=f"{k}") for k, part in enumerate(every.values())]
    return GeometricErrors(errors.robot, named, fixed_bearings=errors.fixed_bearings), frozen(combinations)


def all_parameters(robot: Robot) -> tuple[GeometricParameter, ...]:
    """Return all error parameters: six for each joint and for the tool, and those of closure points and rods.

    A closure point (3d) has three, a closure frame (6d) six, a rod (distance) its length. A frame that is itself a
    moving link has none, nor has a joint with six degrees of freedom. Classes: "legs" for rods and for joints that do
    not carry the tool, "tool_chain" for those that do, "platform" for closure frames on them, "tool" for the tool.
    """
    model = robot.model
    carriers = set(model.supports[model.frames[robot.tool_frame_id].parentJoint]) if robot.tool_frame else set()
    tolerances = {"translation": LENGTH_TOLERANCE, "rotation": ANGLE_TOLERANCE}
    parameters: dict[str, GeometricParameter] = {}

    def add(place: str, group: str, motions: Sequence[Motion]) -> None:
        for motion in motions:
            for parameter in _axis_parameters(place, motion, group, tolerances[motion]):
                parameters.setdefault(parameter.name, parameter)

    for index, joint in enumerate(model.joints):
        if index > 0 and joint.nv < 6:
            group = "tool_chain" if index in carriers else "legs"
            add(model.names[index], group, ("translation", "rotation"))
    if robot.tool_frame is not None and _is_fixed_to_body(robot, robot.tool_frame):
        add(robot.tool_frame, "tool", ("translation", "rotation"))
    for loop in robot.closures:
        for frame in (loop.frame_a, loop.frame_b):
            if _is_fixed_to_body(robot, frame):
                on_tool_chain = model.frames[robot.frame_id(frame)].parentJoint in carriers - {0}
                motions: Sequence[Motion] = ("translation", "rotation") if loop.kind.rotations else ("translation",)
                add(frame, "platform" if on_tool_chain else "legs", motions)
    lengths = [_parameter(rod, "translation", _ALONG, _ROD_AXIS, "legs", LENGTH_TOLERANCE) for rod in robot.rods]
    return (*parameters.values(), *lengths)


def displacement_errors(
    robot: Robot, places: Iterable[str], group: str, motions: Sequence[Motion] = ("translation", "rotation")
) -> list[GeometricParameter]:
    """Return the displacements of joints or frames in their own axes as error parameters, with unit tolerances.

    Raises:
        FrameNotFoundError: the robot has no such joint or frame.
    """
    places = list(places)
    for place in places:
        placement_on_body(robot, place)
    return [p for place in places for motion in motions for p in _axis_parameters(place, motion, group, 1.0)]


def declared_numbers(robot: Robot) -> SourceNumbers:
    """Return the magnitudes of a robot's sources, from its error file or defaults; DescriptionError if malformed."""
    if robot.files is None or not robot.files.errors.is_file():
        return SourceNumbers()
    return read_error_file(robot.files.errors).sources


def beside_guideways(robot: Robot) -> tuple[GeometricParameter, ...]:
    """Return two error parameters of unit tolerance per drive: offsets of its carriage across the guideway."""
    return tuple(
        GeometricParameter(f"{joint}.beside{k}", joint, "translation", direction, "waviness", 1.0)
        for joint in robot.actuated_joints
        for k, direction in enumerate(_across_directions(robot, joint))
    )


def placement_on_body(robot: Robot, place: str) -> pin.SE3:
    """Return the placement of a joint (at coordinate 0) or frame in the axes of the previous joint.

    Raises:
        FrameNotFoundError: the robot has no such joint or frame.
    """
    model = robot.model
    if model.existJointName(place):
        return model.jointPlacements[model.getJointId(place)]
    return model.frames[robot.frame_id(place)].placement


def _axis_parameters(place: str, motion: Motion, group: str, tolerance: float) -> list[GeometricParameter]:
    """Return the displacements of a place along, or about, its own three axes."""
    return [_parameter(place, motion, axis, _unit_vector(axis), group, tolerance) for axis in AXES]


def _check(robot: Robot, parameters: Sequence[GeometricParameter | TiedParameter]) -> None:
    for name, count in Counter(parameter.name for parameter in parameters).items():
        if count > 1:
            raise InvalidValueError("geometric parameter", name, "each name once")
    for parameter in parameters:
        if len({part.motion for part, _ in parameter.parts}) != 1:
            raise InvalidValueError(parameter.name, "its parts", "translations only, or rotations only, at least one")
        if twice := _repeated(parameter.parts):
            raise InvalidValueError(f"parts of {parameter.name}", twice, "each displacement once")
        for part, factor in parameter.parts:
            if not (math.isfinite(factor) and factor != 0.0):
                raise InvalidValueError(f"factor of {part.name} in {parameter.name}", factor, "finite and not 0")
            if part.place in robot.rods and (part.motion, part.axis) != ("translation", _ROD_AXIS):
                expected = f"a translation along x, which is {part.place}.t{_ALONG}, as for every rod"
                raise InvalidValueError(part.name, f"a {part.motion} of axis {part.axis}", expected)
            if not abs(math.hypot(*part.axis) - 1.0) <= _UNIT:
                raise InvalidValueError(f"axis of {part.name}", part.axis, "a unit vector")
        if not (np.isfinite(parameter.tolerance) and parameter.tolerance > 0.0):
            raise InvalidValueError(f"tolerance of {parameter.name}", parameter.tolerance, "a positive number")


def _repeated(parts: Sequence[tuple[GeometricParameter, float]]) -> str | None:
    """Return the name of a part that is the same displacement as one before it, perhaps by another name."""
    seen: set[tuple[str, Motion, tuple[float, float, float]]] = set()
    for part, _ in parts:
        if (displacement := (part.place, part.motion, part.axis)) in seen:
            return part.name
        seen.add(displacement)
    return None


def _parameter(
    place: str, motion: Motion, label: str, axis: tuple[float, float, float], group: str, tolerance: float
) -> GeometricParameter:
    return GeometricParameter(f"{place}.{motion[0]}{label}", place, motion, axis, group, tolerance)


def _unit_vector(axis: str) -> tuple[float, float, float]:
    x, y, z = (float(axis == name) for name in AXES)
    return (x, y, z)


def _parameters_of(robot: Robot, file: ErrorFile) -> list[GeometricParameter | TiedParameter]:
    parameters: list[GeometricParameter | TiedParameter] = []
    for entry in file.entries:
        words: list[tuple[Motion, str, float]] = [
            *(("translation", word, entry.length_tolerance) for word in entry.translations),
            *(("rotation", word, entry.angle_tolerance) for word in entry.rotations),
        ]
        for place in entry.places:
            for motion, word, tolerance in words:
                for label, axis in _directions(robot, place, word, file):
                    parameters.append(_parameter(place, motion, label, axis, entry.group, tolerance))
    for tie in file.ties:
        parts = tuple((_part(robot, name, tie, file), factor) for name, factor in tie.parts.items())
        unit = parts[0][0].unit
        if any(part.unit != unit for part, _ in parts) or unit != tie.unit:
            expected = f"translations with tolerance_m, or rotations with tolerance_rad, not {', '.join(tie.parts)}"
            raise DescriptionError(file.path, f"ties.{tie.name}", f"expected {expected}")
        if twice := _repeated(parts):
            problem = f"expected each displacement once, not that of {twice} twice"
            raise DescriptionError(file.path, f"ties.{tie.name}.of", problem)
        parameters.append(TiedParameter(tie.name, parts, tie.group, tie.tolerance))
    return parameters


def _part(robot: Robot, name: str, tie: TiedEntry, file: ErrorFile) -> GeometricParameter:
    """Return the displacement that a tie names: joint.tx, frame.ry, joint.t_along, joint.r_across2, rod.t_along."""
    place, _, label = name.rpartition(".")
    motion: Motion = "rotation" if label[:1] == "r" else "translation"
    word = label[1:].strip("_12")
    if label[:1] in ("t", "r") and word in (*AXES, "along", "across"):
        if place not in robot.rods:
            placement_on_body(robot, place)
        for found, axis in _directions(robot, place, word, file):
            if found == label[1:]:
                return _parameter(place, motion, found, axis, tie.group, tie.tolerance)
    expected = f"displacements such as {robot.actuated_joints[0]}.tx or .r_along, not '{name}'"
    raise DescriptionError(file.path, f"ties.{tie.name}", f"expected {expected}")


def _directions(robot: Robot, place: str, word: str, file: ErrorFile) -> list[tuple[str, tuple[float, float, float]]]:
    """Return the directions that a word of the file means, with their labels."""
    if place in robot.rods:
        if word != "along":
            raise DescriptionError(file.path, f"errors of {place}", f"expected translation: along, not '{word}'")
        return [(_ALONG, _ROD_AXIS)]
    if word in AXES:
        return [(word, _unit_vector(word))]
    if not robot.model.existJointName(place):
        raise JointNotFoundError(place, f"{file.path}: '{word}'", list(robot.model.names)[1:])
    if word == "along":
        return [(_ALONG, _as_tuple(robot.joint_axis(place)))]
    return [(f"_across{k}", direction) for k, direction in enumerate(_across_directions(robot, place), start=1)]


def _across_directions(robot: Robot, joint: str) -> tuple[tuple[float, float, float], tuple[float, float, float]]:
    """Return two unit vectors across the axis of a single-DoF joint, in its own axes.

    The first is horizontal if the joint's frame has z up: rotation about it changes a guideway's slope, rotation about
    the second its heading. For the errors raised see :meth:`Mechanism.single_joint`.
    """
    along = robot.joint_axis(joint)
    reference = np.array([1.0, 0.0, 0.0] if abs(along[2]) > _NEARLY_PARALLEL else [0.0, 0.0, 1.0])
    first = np.cross(reference, along)
    first /= np.linalg.norm(first)
    return _as_tuple(first), _as_tuple(np.cross(along, first))


def _as_tuple(vector: Vector) -> tuple[float, float, float]:
    x, y, z = (float(number) for number in vector)
    return (x, y, z)


def _fixed_bearings(robot: Robot, file: ErrorFile) -> Vector:
    """Coordinate at which each drive would be at the frame that the file names for it, along the drive's axis."""
    neutral = robot.configuration(pin.neutral(robot.model))
    bearings = np.zeros(len(robot.actuated_joints))
    for joint, frame in file.command_zeros.items():
        if joint not in robot.actuated_joints:
            raise JointNotFoundError(joint, f"{file.path}: command_zeros", robot.actuated_joints)
        placement = neutral.frame_placement(joint)
        axis = placement.rotation @ robot.joint_axis(joint)
        start = neutral.frame_placement(frame).translation
        bearings[robot.actuated_joints.index(joint)] = axis @ (start - placement.translation)
    return bearings


def _is_fixed_to_body(robot: Robot, frame: str) -> bool:
    """Tell whether a frame is fixed to a moving link or the world, without being such a link itself."""
    frames = robot.model.frames
    entry = frames[robot.frame_id(frame)]
    if entry.type != pin.FrameType.BODY:
        return bool(entry.type == pin.FrameType.OP_FRAME)
    return bool(frames[entry.parentFrame].type == pin.FrameType.FIXED_JOINT and entry.parentFrame > 0)


def _moved_by(mechanism: Mechanism, place: str) -> tuple[set[int], set[int]]:
    """Return the joints and frames, by index, that move with a place; all frames on these joints also move."""
    model = mechanism.model
    if place in mechanism.rods:
        return set(), set()
    frames = [] if model.existJointName(place) else _frame_and_descendants(model, mechanism.frame_id(place))
    roots = {model.frames[f].parentJoint for f in frames if model.frames[f].type == pin.FrameType.JOINT}
    if model.existJointName(place):
        roots = {model.getJointId(place)}
    return {joint for root in roots for joint in model.subtrees[root]}, set(frames)


def _frame_and_descendants(model: pin.Model, frame: int) -> list[int]:
    """Return the frames attached to a frame, itself first, including joints and what they carry."""
    found = [frame]
    for index in range(frame + 1, model.nframes):
        if model.frames[index].parentFrame in found:
            found.append(index)
    return found


def _displace_frames(model: pin.Model, frames: list[int], displacement: pin.SE3) -> None:
    """Move the first of some frames, and the others on the same body, by a displacement in its axes."""
    placement = model.frames[frames[0]].placement.copy()
    body, moved = model.frames[frames[0]].parentJoint, placement * displacement * placement.inverse()
    for index in frames:
        entry = model.frames[index]
        if entry.type == pin.FrameType.JOINT and model.parents[entry.parentJoint] == body:
            model.jointPlacements[entry.parentJoint] = moved * model.jointPlacements[entry.parentJoint]
        elif entry.parentJoint == body:
            entry.placement = moved * entry.placement


def _places_in_order(robot: Robot, places: set[str]) -> tuple[str, ...]:
    """Order places so that each is displaced before those attached to it."""
    model = robot.model

    def key(place: str) -> tuple[int, int]:
        if place in robot.rods:
            return 2, robot.rods[place]
        is_frame = not model.existJointName(place)
        return is_frame, robot.frame_id(place) if is_frame else model.getJointId(place)

    return tuple(sorted(places, key=key))
