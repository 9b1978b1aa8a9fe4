"""A mechanism: a tree of bodies in Pinocchio, its loop closures, and its actuated joints."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Any, Self

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen, require_kind
from pm3dof_pin.description.closures import LoopClosure, uniquely_named
from pm3dof_pin.description.coordinates import (
    TOOL_COMPONENTS,
    Command,
    Coordinate,
    LimitGroup,
    ToolComponent,
)
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.description.description import Description
from pm3dof_pin.description.inertia_checks import inertia_problem
from pm3dof_pin.description.readers.pinocchio_model import describe_model
from pm3dof_pin.description.robots import RobotFiles
from pm3dof_pin.exceptions import DescriptionError, FrameNotFoundError, InvalidValueError, JointNotFoundError
from pm3dof_pin.mechanism.loop_kinematics import Anchors, CoupledJoints, LoopKinematics
from pm3dof_pin.mechanism.single_joint import SingleJoint
from pm3dof_pin.tolerances import CLOSED, RANK_CEILING, RANK_PER_ERROR
from pm3dof_pin.typing import Indices, Mask, Vector

_MEETING = 1e-9  # m, rad
_MAX_GROUPS = 31  # with REACH, 32 bits
_NORM_TOLERANCE = 1e-9


class Mechanism:
    """A closed-chain (or serial) mechanism. Immutable by convention; its arrays are read-only.

    Data and Jacobians only: :class:`~pm3dof_pin.kinematics.robot.Robot` closes the loops.

    Args:
        model: tree of bodies and joints; copied.
        closures: loop closures between frames of the model; none for a serial robot.
        couplings: joints that follow others, exactly.
        actuated_joints: actuated joints, each single-DoF. By default, all single-DoF joints of a mechanism without
            closures, except those that follow others, and none of one with closures.
        tool_frame: the tool's frame; operations that need it raise if it is None.
        motion_coordinates: single-DoF joints whose rates are the platform's independent motions.
        springs: raw spring entries of the description, not yet parsed.
        commands: counter readings of the drives, one for each actuated joint, in that order; by default the joint
            coordinates.
        coordinates: the independent numbers that place the tool; by default those of the motion coordinates, or none.
        limit_groups: named groups of limits; limits in none of them are grouped by the names of their joints.
        tool_motions: components of the tool's twist, world axes, that make up its motion when degrees of freedom are
            counted and singularities are named, such as x, y of a planar point tool; all six by default.
        characteristic_length: length that makes translations comparable with rotations wherever ranks or directions
            are determined [m]. By default the root mean square distance of joints, closure points and tool from their
            centroid at the neutral configuration.
        closure_tolerance: largest closure error of closed loops [m, rad]; by default rounding, or what the loops of a
            robot can be closed to at home, if that is less precise.
        source: file with the names of frames, joints and springs, for messages; by default that of `files`.
        files: the files the mechanism was read from, if any.
        description: the description that the mechanism is made of, if any.

    Attributes:
        model: Pinocchio's model, to be treated as read-only. The other arguments are attributes of the same name.
        declared_coordinates: the coordinates declared by the description; may be empty.
        passive_joints: names of all joints that are not actuated, in the model's order.
        actuated_indices, passive_indices: indices in v of the actuated joints, shape=(number of actuated joints,), and
            of all others.
        lower_limits, upper_limits: limits of each entry of q, shape=(nq,) [m, rad]; infinite if there is none.
        q_names: name of each entry of q: its joint, or `joint[k]` where a joint has several.
        named_configurations: joint configurations by name, each of shape=(nq,).
        velocity_scale: the characteristic length for every linear entry of v [m/s], 1 for angular ones, shape=(nv,).
        twist_scale, closure_scale: the same for the entries of a twist, shape=(6,), and of the closure error, first of
            the closures and then of the couplings, shape=(m,).

    Raises:
        FrameNotFoundError: a closure or the tool names a frame that the model does not have.
        JointNotFoundError: an actuated joint or motion coordinate is not in the model.
        DescriptionError: such a joint has several degrees of freedom; a closure joins two frames of one body; or two
            hold the distance of the same frames.
        InvalidValueError: the characteristic length is not a positive number.
    """

    def __init__(
        self,
        model: pin.Model,
        closures: Iterable[LoopClosure] = (),
        *,
        couplings: Iterable[Coupling] = (),
        actuated_joints: Iterable[str] = (),
        tool_frame: str | None = None,
        motion_coordinates: Iterable[str] = (),
        springs: Iterable[Mapping[str, Any]] = (),
        commands: Iterable[Command] = (),
        coordinates: Iterable[Coordinate] = (),
        limit_groups: Iterable[LimitGroup] = (),
        tool_motions: Iterable[ToolComponent] = (),
        characteristic_length: float | None = None,
        closure_tolerance: float | None = None,
        source: Path | str | None = None,
        files: RobotFiles | None = None,
        description: Description | None = None,
    ) -> None:
        require_kind("model", model, pin.Model, "Pinocchio")
        self._prototype: Self | None = None
        self.model = model.copy()
        self.name: str = model.name or "robot"
        self.closures = uniquely_named(closures)
        self.couplings = tuple(couplings)
        self.tool_frame = tool_frame
        self.springs = tuple(springs)
        self.files = files
        self._description = description
        self.source = str(source or (files.source if files is not None else model.name))
        self._frame_ids = _frame_ids(self.model)
        translates = _is_translation(self.model)
        self._single_joints = _single_joints(self.model, translates)

        followers = {coupling.joint for coupling in self.couplings}
        free = () if self.closures else tuple(name for name in self._single_joints if name not in followers)
        driven = tuple(actuated_joints) or free
        self.actuated_joints = self._checked_joints(driven, "name_mot")
        self.passive_joints = tuple(name for name in list(model.names)[1:] if name not in set(self.actuated_joints))
        self.motion_coordinates = self._checked_joints(tuple(motion_coordinates), "motion_coordinates")
        self.commands = self._checked_commands(tuple(commands))
        self.declared_coordinates = tuple(coordinates) or self._motion_coordinates()
        self.actuated_indices = self.velocity_indices(self.actuated_joints)
        self.passive_indices = frozen(np.delete(np.arange(model.nv), self.actuated_indices))

        self.lower_limits = frozen(_limits(model, model.lowerPositionLimit, -np.inf))
        self.upper_limits = frozen(_limits(model, model.upperPositionLimit, np.inf))
        self.q_names = _coordinate_names(model)
        self.named_configurations: Mapping[str, Vector] = MappingProxyType(
            {entry.key(): frozen(np.array(entry.data())) for entry in model.referenceConfigurations}
        )

        if tool_frame is not None:
            index = self._frame_id(tool_frame, f"{self.source}: tool_frame")
            if model.frames[index].parentJoint == 0 and model.njoints > 1:
                raise DescriptionError(self.source, "tool_frame", f"expected a frame that moves, not '{tool_frame}'")
        self._check_couplings()
        self._check_closures()
        angular = [entry for closure in self.closures for entry in closure.kind.is_angular]
        angular += [not self.single_joint(coupling.joint).translates for coupling in self.couplings]
        length = self._typical_length() if characteristic_length is None else characteristic_length
        if not (np.isfinite(length) and length > 0.0):
            raise InvalidValueError("characteristic_length", length, "a positive length [m]")
        self.characteristic_length = float(length)
        if closure_tolerance is not None and not 0.0 < closure_tolerance <= self.characteristic_length:
            expected = "a positive number of metres, less than the machine's size"
            raise InvalidValueError("closure_tolerance", closure_tolerance, expected)
        self.declared_closure_tolerance = closure_tolerance
        self.velocity_scale = frozen(np.where(translates, self.characteristic_length, 1.0))
        self.twist_scale = frozen(np.repeat([self.characteristic_length, 1.0], 3))
        self.closure_scale = frozen(np.where(np.array(angular, dtype=bool), 1.0, self.characteristic_length))
        self.limit_groups = self._complete_limit_groups(tuple(limit_groups))
        self.tool_motions = tuple(tool_motions) or TOOL_COMPONENTS
        self._arguments: dict[str, Any] = {
            "couplings": self.couplings,
            "actuated_joints": self.actuated_joints,
            "tool_frame": tool_frame,
            "motion_coordinates": self.motion_coordinates,
            "springs": self.springs,
            "commands": self.commands,
            "coordinates": self.declared_coordinates,
            "limit_groups": self.limit_groups,
            "tool_motions": self.tool_motions,
            "characteristic_length": self.characteristic_length,
            "closure_tolerance": closure_tolerance,
            "source": self.source,
            "files": files,
            "description": description,
        }
        # excludes properties cached later
        self._described = frozenset(vars(self)) | {"_described"}

    def __repr__(self) -> str:
        return (
            f"{type(self).__name__}({self.name}: {self.model.njoints - 1} joints, "
            f"{len(self.actuated_joints)} actuated, "
            f"{len(self.closures)} closures, {f'{len(self.couplings)} couplings, ' if self.couplings else ''}"
            f"tool {self.tool_frame})"
        )

    def __reduce__(self) -> tuple[Any, ...]:
        return partial(type(self), **self._arguments), (self.model, self.closures)

    def replace(
        self, *, model: pin.Model | None = None, closures: Iterable[LoopClosure] | None = None, **changes: Any
    ) -> Self:
        """Return a copy with another model, closures, or other arguments of :class:`Mechanism`."""
        variant = type(self)(
            self.model if model is None else model,
            self.closures if closures is None else closures,
            **(self._arguments | changes),
        )
        variant._prototype = self.prototype
        return variant

    def with_home(self, q: ArrayLike) -> Self:
        """Return a mechanism of its own, with no prototype, that differs in the named configuration "home"."""
        model = self.model.copy()
        model.referenceConfigurations["home"] = np.array(self.checked_positions(q))
        variant = self.replace(model=model)
        variant._prototype = None
        return variant

    def displaced(self, model: pin.Model, lengthened: Mapping[str, float] | None = None) -> Self:
        """Return a copy with a model that differs in placements only; faster than :meth:`replace`.

        Some :attr:`rods` may be longer by lengths [m]; InvalidValueError if one has no length left.
        """
        kind = type(self)
        variant = kind.__new__(kind)
        vars(variant).update({name: vars(self)[name] for name in self._described})
        variant.model, variant._prototype = model, self.prototype
        if lengthened:
            variant.closures = tuple(
                replace(loop, length=(loop.length or 0.0) + lengthened[loop.name]) if loop.name in lengthened else loop
                for loop in self.closures
            )
        return variant

    def matches(self, other: Mechanism) -> bool:
        """Tell whether another mechanism has the same bodies, joints and closures, as two loads of one robot have.

        Configurations of one are configurations of the other.
        """
        return self is other or (self.closures == other.closures and bool(self.model == other.model))

    @cached_property
    def loop_kinematics(self) -> LoopKinematics:
        """Pinocchio's data, one copy per thread."""
        couplings = [
            CoupledJoints(c, self.single_joint(c.joint), tuple(map(self.single_joint, c.joints)))
            for c in self.couplings
        ]
        return LoopKinematics(self.model, [self._anchors(*loop) for loop in enumerate(self.closures)], couplings)

    @cached_property
    def description(self) -> Description:
        """The description that the mechanism was made of, or else one of its model; variants keep the original's."""
        return describe_model(self.model, self.closures) if self._description is None else self._description

    @cached_property
    def rods(self) -> Mapping[str, int]:
        """The closures of type "distance" by name, with their numbers; none with the name of a joint or frame."""
        taken = {*self.model.names, *(frame.name for frame in self.model.frames)}
        return MappingProxyType(
            {
                loop.name: number
                for number, loop in enumerate(self.closures)
                if loop.kind.is_distance and loop.name not in taken
            }
        )

    @property
    def has_loops(self) -> bool:
        """Whether it has loop closures or couplings, so that its joints are not independent."""
        return bool(self.closures or self.couplings)

    @property
    def has_branches(self) -> bool:
        """Whether singular poses may separate assembly modes.

        An arm with gears, or with a gripper of which one finger follows the other, passes its singular poses like any.
        """
        return bool(self.closures or not all(coupling.is_linear for coupling in self.couplings))

    @property
    def branching_drives(self) -> list[int]:
        """Entries of v of the drives whose rates tell branches apart."""
        return [int(index) for index in self.actuated_indices]

    @property
    def constraint_names(self) -> tuple[str, ...]:
        """Names of the closures, then of the couplings, in the order of :attr:`LoopKinematics.rows`."""
        return (*(loop.name for loop in self.closures), *(coupling.name for coupling in self.couplings))

    @property
    def prototype(self) -> Self:
        """The mechanism from which this one was originally made by :meth:`replace`, or itself.

        Compiled programs of the prototype serve all mechanisms that differ from it in numbers only.
        """
        return self if self._prototype is None else self._prototype

    @cached_property
    def impossible_inertias(self) -> Mapping[str, str]:
        """Problems with the moments of inertia of moving bodies, by link; links fixed to each other are one body."""
        links = [frame for frame in self.model.frames if frame.type == pin.FrameType.BODY]
        links.sort(key=lambda link: self.model.frames[link.parentFrame].type == pin.FrameType.JOINT)
        bodies = {link.parentJoint: str(link.name) for link in links}  # the link moved directly by each joint
        problems = {
            bodies.get(joint, self.model.names[joint]): inertia_problem(inertia.mass, np.array(inertia.inertia))
            for joint, inertia in enumerate(self.model.inertias)
            if joint > 0
        }
        return MappingProxyType({name: problem for name, problem in problems.items() if problem})

    def require_possible_inertias(self) -> None:
        """Raise DescriptionError if a moving body has :attr:`impossible_inertias`."""
        for name, problem in self.impossible_inertias.items():
            path = self.source if self.files is None else self.files.path
            raise DescriptionError(path, f"link '{name}', with all links fixed to it: inertia", problem)

    @cached_property
    def closure_tolerance(self) -> float:
        """Largest closure error of closed loops [m, rad]: as declared, or :data:`CLOSED`, more for a large machine."""
        if self.declared_closure_tolerance is not None:
            return self.declared_closure_tolerance
        return self.rounding_of_closures

    @property
    def rounding_of_closures(self) -> float:
        """Closure error of loops that close but for rounding [m, rad]: :data:`CLOSED`, more for a large machine."""
        return CLOSED * max(1.0, self.characteristic_length)

    @cached_property
    def rank_tolerance(self) -> float:
        """Relative singular value up to which a gap may lie: what the precision of the closures leaves undecided."""
        return max(RANK_CEILING, RANK_PER_ERROR * self.closure_tolerance / self.characteristic_length)

    @cached_property
    def length_unit(self) -> float:
        """The power of two nearest to the characteristic length [m], so that scaling by it does not round."""
        return float(2.0 ** np.round(np.log2(self.characteristic_length)))

    @property
    def tool_frame_id(self) -> int:
        """Pinocchio's index of the tool frame; DescriptionError if the mechanism has none."""
        if self.tool_frame is None:
            raise DescriptionError(
                self.source,
                "tool_frame",
                "is missing: --tool-frame NAME (tool_frame=NAME), or `tool_frame` in a closures file",
            )
        return self._frame_ids[self.tool_frame]

    def frame_id(self, name: str) -> int:
        """Return Pinocchio's index of a frame, preferring links to joints; FrameNotFoundError if there is none."""
        return self._frame_id(name, self.name)

    def frame_name(self, name: str | None = None) -> str:
        """Return the name of an existing frame, by default the tool's; raises as the indices above."""
        index = self.tool_frame_id if name is None else self.frame_id(name)
        return str(self.model.frames[index].name)

    def single_joint(self, name: str) -> SingleJoint:
        """Return the indices of the coordinate and rate of a single-DoF joint.

        Raises:
            JointNotFoundError: the model has no such joint.
            InvalidValueError: the joint has several degrees of freedom.
        """
        if (joint := self._single_joints.get(name)) is None:
            self._require_joint(name, self.name)
            raise InvalidValueError("joint", name, "a single-DoF joint")
        return joint

    def joint_axis(self, name: str) -> Vector:
        """Return the axis of a :meth:`single_joint` in the joint frame, a unit vector, shape=(3,)."""
        column = self.single_joint(name).v_index
        joint = self.model.joints[self.model.getJointId(name)]
        data = joint.createData()
        joint.calc(data, pin.neutral(self.model))
        twist = np.reshape(data.S, (6, joint.nv))[:, column - joint.idx_v]
        direction = twist[3:] if twist[3:].any() else twist[:3]
        return np.asarray(direction / np.linalg.norm(direction))

    def velocity_indices(self, joints: Iterable[str]) -> Indices:
        """Return the indices in v of single-DoF joints, in the order given; raises as :meth:`single_joint`."""
        return frozen(np.array([self.single_joint(name).v_index for name in joints], dtype=np.intp))

    def checked_positions(self, q: ArrayLike) -> Vector:
        """Return q as a new array; InvalidValueError unless it is finite and valid for this mechanism."""
        positions = finite_array("q", q, (self.model.nq,))
        if self.model.nq != self.model.nv and not pin.isNormalized(self.model, positions, _NORM_TOLERANCE):
            raise InvalidValueError("q", positions, "cosine-sine pairs and quaternions of length 1")
        return positions

    def place_joints(self, q: Vector, coordinates: Mapping[str, ArrayLike]) -> tuple[Vector, Indices]:
        """Set joint coordinates [m, rad] in q; return q and the indices in v that remain free.

        Raises:
            JointNotFoundError: the model has no such joint.
            InvalidValueError: a value is not finite or of the wrong shape.
        """
        q, free = np.array(q), np.ones(self.model.nv, dtype=bool)
        for name, value in coordinates.items():
            self._require_joint(name, "joints")
            joint = self.model.joints[self.model.getJointId(name)]
            single = self._single_joints.get(name)
            numbers = finite_array(f"coordinate of joint {name}", value, () if single else (joint.nq,))
            if single:
                single.set_coordinate(q, float(numbers))
            else:
                q[joint.idx_q : joint.idx_q + joint.nq] = numbers
            free[joint.idx_v : joint.idx_v + joint.nv] = False
        return self.checked_positions(q), np.flatnonzero(free)

    def _anchors(self, index: int, loop: LoopClosure) -> Anchors:
        element = f"{self.source}: closed_loop[{index}]"
        frames = [self.model.frames[self._frame_id(name, element)] for name in (loop.frame_a, loop.frame_b)]
        turns = [pin.SE3(basis, np.zeros(3)) for basis in loop.bases] if loop.bases else [pin.SE3.Identity()] * 2
        ends = [(f.parentJoint, f.placement * turn) for f, turn in zip(frames, turns, strict=True)]
        anchors = Anchors(loop.kind, ends[0], ends[1], loop.length or 0.0)
        if ends[0][0] == ends[1][0] and not (self.springs and np.abs(anchors.error).max() < _MEETING):
            raise DescriptionError(
                self.source,
                f"closed_loop[{index}]",
                f"'{loop.frame_a}' and '{loop.frame_b}' are on one body, expected frames of two bodies, or coincident "
                "frames with springs between them",
            )
        return anchors

    def _check_closures(self) -> None:
        rods: dict[frozenset[str], int] = {}
        for index, loop in enumerate(self.closures):
            self._anchors(index, loop)  # whose frames must exist
            first = rods.setdefault(frozenset((loop.frame_a, loop.frame_b)), index) if loop.kind.is_distance else index
            if first != index:
                raise DescriptionError(
                    self.source,
                    f"closed_loop[{index}]",
                    f"closed_loop[{first}] holds the distance of these frames already: expected "
                    "other frames, as one distance has one length",
                )

    def _check_couplings(self) -> None:
        for coupling in self.couplings:
            names = self._checked_joints((coupling.joint, *coupling.joints), "couplings")
            joints = [self._single_joints[name] for name in names[1:]]
            for joint, powers in zip(joints, coupling.coefficients, strict=True):
                is_turn = not self.single_joint(coupling.joint).translates and len(powers) == 1 and powers[0] % 1 == 0
                if joint.is_continuous and not is_turn:
                    raise DescriptionError(
                        self.source,
                        f"coupling of '{coupling.joint}'",
                        f"the angle of '{joint.name}' is ambiguous after a turn: expected a ratio that is a whole "
                        "number, or limits of that joint",
                    )

    def _checked_joints(self, names: tuple[str, ...], element: str) -> tuple[str, ...]:
        for name in names:
            self._require_joint(name, f"{self.source}: {element}")
            if name not in self._single_joints:
                raise DescriptionError(self.source, element, f"'{name}' has several degrees of freedom, expected one")
        return names

    def _checked_commands(self, commands: tuple[Command, ...]) -> tuple[Command, ...]:
        """Return a command for each actuated joint, in order."""
        declared = {command.joint: command for command in commands}
        for joint in declared:
            if joint not in self.actuated_joints:
                self._require_joint(joint, f"{self.source}: commands")
                raise DescriptionError(self.source, "commands", f"'{joint}' is not actuated, expected one of name_mot")
        return tuple(
            declared.get(name, Command(name, name, self._single_joints[name].unit)) for name in self.actuated_joints
        )

    def _motion_coordinates(self) -> tuple[Coordinate, ...]:
        return tuple(Coordinate(name, self._single_joints[name].unit, joint=name) for name in self.motion_coordinates)

    def _complete_limit_groups(self, groups: tuple[LimitGroup, ...]) -> tuple[LimitGroup, ...]:
        """Add groups for ungrouped limits, named after their joints or frames without numbers; at most 31."""
        joints = {joint for group in groups for joint in group.joints}
        for group in groups:
            for name in group.joints:
                self._require_joint(name, f"{self.source}: limit_groups: {group.name}")
        closures = {index for group in groups for index in group.closures}
        found: dict[str, tuple[list[str], list[int]]] = defaultdict(lambda: ([], []))
        for name, joint in list(zip(self.model.names, self.model.joints, strict=True))[1:]:
            positions = slice(joint.idx_q, joint.idx_q + joint.nq)
            limited = np.isfinite(self.lower_limits[positions]) | np.isfinite(self.upper_limits[positions])
            if limited.any() and name not in joints:
                found[re.sub(r"\d+", "", name)][0].append(name)
        for index, loop in enumerate(self.closures):
            if loop.swing_limit is not None and index not in closures:
                found[re.sub(r"\d+", "", f"{loop.frame_a}-{loop.frame_b}")][1].append(index)
        groups += tuple(LimitGroup(kind, tuple(members[0]), tuple(members[1])) for kind, members in found.items())
        if len(groups) > _MAX_GROUPS:
            groups, rest = groups[: _MAX_GROUPS - 1], groups[_MAX_GROUPS - 1 :]
            others = tuple(name for group in rest for name in group.joints)
            groups += (LimitGroup("others", others, tuple(index for group in rest for index in group.closures)),)
        return groups

    def _require_joint(self, name: str, source: str) -> None:
        if not self.model.existJointName(name):
            raise JointNotFoundError(name, source, list(self.model.names)[1:])

    def _frame_id(self, name: str, source: str) -> int:
        if name not in self._frame_ids:
            raise FrameNotFoundError(name, source, sorted(self._frame_ids))
        return self._frame_ids[name]

    def _typical_length(self) -> float:
        data, neutral = self.model.createData(), pin.neutral(self.model)
        pin.framesForwardKinematics(self.model, data, neutral)
        named = [name for loop in self.closures for name in (loop.frame_a, loop.frame_b)]
        named += [self.tool_frame] if self.tool_frame is not None else []
        points = [data.oMi[joint].translation for joint in range(1, self.model.njoints)]
        points += [data.oMf[self._frame_ids[name]].translation for name in named]
        if not points:
            return 1.0
        radius = float(np.sqrt(np.mean(np.sum((points - np.mean(points, axis=0)) ** 2, axis=1))))
        return radius if radius > np.sqrt(np.finfo(float).eps) else 1.0


def _frame_ids(model: pin.Model) -> dict[str, int]:
    """Index the frames by name; of frames with the same name, a body's wins, and a joint's loses."""
    ranks = {pin.FrameType.BODY: 2, pin.FrameType.OP_FRAME: 1}
    ids: dict[str, int] = {}
    best: dict[str, int] = {}
    for index, frame in enumerate(model.frames):
        name, rank = frame.name, ranks.get(frame.type, 0)
        if rank > best.get(name, -1):
            ids[name], best[name] = index, rank
    return ids


def _single_joints(model: pin.Model, translates: Mask) -> dict[str, SingleJoint]:
    return {
        model.names[index]: SingleJoint(
            model.names[index], joint.idx_q, joint.idx_v, joint.nq == 2, bool(translates[joint.idx_v])
        )
        for index, joint in enumerate(model.joints)
        if index > 0 and joint.nv == 1
    }


def _coordinate_names(model: pin.Model) -> tuple[str, ...]:
    names = []
    for name, joint in list(zip(model.names, model.joints, strict=True))[1:]:
        names += [name] if joint.nq == 1 else [f"{name}[{k}]" for k in range(joint.nq)]
    return tuple(names)


def _limits(model: pin.Model, limits: Vector, unlimited: float) -> Vector:
    """Put `unlimited` where Pinocchio has no limit: for cosines, sines, quaternions, and its greatest number."""
    limited = list(model.hasConfigurationLimit())
    if len(limited) != model.nq:  # Pinocchio says twice that helical joints, of one coordinate, have limits
        limited = [known for joint in list(model.joints)[1:] for known in list(joint.hasConfigurationLimit)[: joint.nq]]
    return np.where(np.array(limited, dtype=bool) & (np.abs(limits) < np.finfo(float).max), limits, unlimited)


def _is_translation(model: pin.Model) -> Mask:
    """Return which entries of v are linear velocities without any rotation, shape=(nv,)."""
    neutral, translates = pin.neutral(model), np.empty(model.nv, dtype=bool)
    for joint in list(model.joints)[1:]:
        data = joint.createData()
        joint.calc(data, neutral)
        turns = np.reshape(data.S, (6, joint.nv))[3:]
        translates[joint.idx_v : joint.idx_v + joint.nv] = ~turns.any(axis=0)
    return translates
