"""A machine whose bodies have temperatures: its warm geometry, and the commands that undo what warming does.

Every length that a material fills expands once, with the temperature of the body that it is in: from the previous joint
on a body to the next joint, closure or tool. The travel of a sliding drive expands from its fixed bearing with its
screw, a rod that is a closure of type "distance" with its own temperature, and the lengths in the ratio of coupled
joints with the bodies that carry them. If all are equally warm and of one material, the machine scales, and a counter
that scales with it reads as before. A gradient across a body bends it (:mod:`pm3dof_pin.errors.expansion_field`).

Heat comes from its sources: the air warms `all`, motors and spindle what carries them, which `drives` and `spindle`
name, and friction the `screws`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.error_file import AXES
from pm3dof_pin.description.source_numbers import Thermal
from pm3dof_pin.errors.command_correction import nearest_poses
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters, declared_numbers, placement_on_body
from pm3dof_pin.errors.expansion_field import ExpansionField, expanded, linear_field
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference
from pm3dof_pin.errors.warm_couplings import Ruler, expanded_coupling
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Indices, Vector

T = TypeVar("T")

EVERYTHING = "all"
"""Name of the temperature rise of whatever has none of its own."""

SCREWS, DRIVES, SPINDLE = "screws", "drives", "spindle"
"""Names of groups: all screws; the links that carry actuated joints; the link that carries the tool."""

_COLUMNS = (("rise_", "_K", ""), *(("gradient_", f"_{axis}_K_per_m", f":{axis}") for axis in AXES))
"""Beginning and end of a column's name, and what follows the name of the body in that of a temperature."""


def rise_column(name: str) -> str:
    """Return the column of files with a temperature rise [K], or with a gradient, such as of `platform:x` [K/m]."""
    for before, after, suffix in reversed(_COLUMNS):
        if name.endswith(suffix):
            return f"{before}{name.removesuffix(suffix)}{after}"
    raise AssertionError(name)  # the last suffix is empty


def rises_of(columns: Mapping[str, T]) -> dict[str, T]:
    """Return the temperature rises and gradients among columns, by the names of what has them."""
    return {
        f"{name.removeprefix(before).removesuffix(after)}{suffix}": values
        for name, values in columns.items()
        for before, after, suffix in _COLUMNS
        if name.startswith(before) and name.endswith(after)
    }


@dataclass(frozen=True, eq=False)
class BodyTemperatures:
    """The temperatures that a robot's bodies and screws can have, and what they do.

    Rises are above the state in which the machine is as described or calibrated [K], by the name of a link (with all
    that is fixed to it), of a sliding drive for its screw, of a rod by its closure, of a group, or `all` for the rest.
    A name counts before its group, a group before `all`. A screw without a rise has that of the link which carries its
    joint.

    Links and frames that are fixed to one another are places on one body, such as those of sensors: between different
    rises of these, temperature is linear, with the least gradient. `LINK:x` is a gradient along an axis of a link or
    frame [K/m]; then rises are the mean of those given.
    """

    robot: Robot  #: the robot, as described or calibrated
    #: coordinate of each actuated joint at the fixed bearing of its screw, shape=(number of actuated joints,) [m]
    bearings: Vector
    numbers: Thermal = field(default_factory=Thermal)  #: expansion of bodies and screws [1/K]

    @classmethod
    def from_errors(cls, errors: GeometricErrors, robot: Robot | None = None) -> BodyTemperatures:
        """Return those of a robot, or of its calibrated version, with bearings and materials of its error file."""
        numbers = declared_numbers(errors.robot).thermal
        return cls(errors.robot if robot is None else robot, errors.fixed_bearings, numbers)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names that may have a temperature rise; so may all other frames."""
        links = (frame.name for frame in self.robot.model.frames if frame.type == pin.FrameType.BODY)
        return tuple(dict.fromkeys((EVERYTHING, *self._groups, *links, *self._screws, *self._rods)))

    def warmed(self, rises: Mapping[str, float]) -> tuple[Robot, Vector]:
        """Return the robot with its bodies at temperature rises, and the strain of each drive's screw.

        Raises:
            InvalidValueError: a name is unknown, or a number is not finite.
        """
        self._check(rises)
        bodies = self._temperatures(rises)
        strains = {}
        for place, joint in self._places.items():
            (rise, gradient), expansion = bodies[joint], self._expansion(joint)
            strains[place] = ExpansionField(expansion * rise, expansion * gradient)
        robot = expanded(self.robot, strains, self.bearings)
        # at a sliding drive a body ends at the bearing; the part from there to the joint's zero is the screw's
        screws = np.array([self._screw_strain(name, bodies, rises) for name in self.robot.actuated_joints])
        usual = rises.get(EVERYTHING, 0.0)
        rods = {name: self._expansion(name) * rises.get(name, usual) for name in self._rods}
        if any(rods.values()):
            strained = [(loop, 1.0 + rods.get(loop.name, 0.0)) for loop in robot.closures]
            robot = robot.replace(
                closures=[replace(loop, length=loop.length * by) if loop.length else loop for loop, by in strained]
            )
        if robot.couplings:
            names = {name for one in robot.couplings for name in (one.joint, *one.joints)}
            rulers = {name: self._ruler(name, bodies, screws) for name in names}
            robot = robot.replace(couplings=[expanded_coupling(one, rulers) for one in robot.couplings])
        return robot, screws

    def poses(self, poses: Poses, rises: Mapping[str, float]) -> Array:
        """Return the placements of the tool of the warm machine at the counter readings of n poses, shape=(n, 4, 4).

        Raises:
            UnreachablePoseError: the loops of the warm machine do not close.
            InvalidValueError: as :meth:`warmed`.
        """
        warm, strains = self.warmed(rises)
        commands = poses.commands + self._scales * strains * (self._travels(poses.commands) - self.bearings)
        return np.asarray(warm.forward(commands, guess=poses.q).transforms)

    def motions(self, poses: Poses, rises: Mapping[str, ArrayLike]) -> Array:
        """Return the motion of the tool by warming at counter readings held, [translation; rotation vector].

        Args:
            poses: n solved poses of the robot.
            rises: temperature rises by name, one for all poses or n each [K].

        Raises:
            UnreachablePoseError, InvalidValueError: as :meth:`poses`.

        Returns:
            World axes, shape=(n, 6) [m, rad].
        """
        motions = np.zeros((len(poses), 6))
        for rows, state in self._states(poses, rises):
            motions[rows] = pose_difference(poses[rows].transforms, self.poses(poses[rows], state))
        return motions

    def corrections(self, poses: Poses, rises: Mapping[str, ArrayLike], *, eta: float = TIP_LENGTH) -> Array:
        """Return the change of counter readings that takes the warm tool where the cold one is, shape=(n, commands).

        What no command corrects is left, in the tip-weighted sense.

        Args:
            poses: n solved poses of the robot.
            rises: temperature rises by name, one for all poses or n each [K].
            eta: weight of the orientation [m/rad].

        Raises:
            UnreachablePoseError: the warm machine does not reach a pose.
            InvalidValueError: as :meth:`warmed`.
        """
        corrections = np.zeros_like(poses.commands)
        for rows, state in self._states(poses, rises):
            warm, screws = self.warmed(state)
            cold = poses[rows]
            start = warm.forward(cold.commands, guess=cold.q)
            travelled = nearest_poses(start, cold.transforms, eta).commands
            corrections[rows] = self._readings(travelled, screws) - cold.commands
        return corrections

    def _states(self, poses: Poses, rises: Mapping[str, ArrayLike]) -> Iterator[tuple[Indices, dict[str, float]]]:
        """Return the rows of poses at each combination of rises."""
        given = {name: np.broadcast_to(np.asarray(values, dtype=float), len(poses)) for name, values in rises.items()}
        table = np.column_stack([np.zeros((len(poses), 0)), *given.values()])
        states, rows_of = np.unique(table, axis=0, return_inverse=True)
        for k, state in enumerate(states):
            yield np.flatnonzero(rows_of.reshape(-1) == k), dict(zip(given, state.tolist(), strict=True))

    @property
    def _scales(self) -> Vector:
        return np.array([command.scale for command in self.robot.commands])

    @cached_property
    def _bodies(self) -> dict[str, tuple[int, pin.SE3]]:
        """The joint that carries each link or other frame, and its placement there; those fixed together have one."""
        types = (pin.FrameType.BODY, pin.FrameType.OP_FRAME)
        others = {*self._screws, *self._rods}
        return {
            frame.name: (frame.parentJoint, frame.placement)
            for frame in self.robot.model.frames
            if frame.type in types and frame.name not in others
        }

    @cached_property
    def _screws(self) -> tuple[str, ...]:
        robot = self.robot
        return tuple(name for name in robot.actuated_joints if robot.single_joint(name).translates)

    @cached_property
    def _rods(self) -> tuple[str, ...]:
        return tuple(loop.name for loop in self.robot.closures if loop.kind.is_distance)

    @cached_property
    def _groups(self) -> dict[str, tuple[str | int, ...]]:
        """The screws, or the joints that carry bodies, in each group of the robot; none with the name of a link."""
        robot, model = self.robot, self.robot.model
        groups: dict[str, tuple[str | int, ...]] = {
            SCREWS: self._screws,
            DRIVES: tuple(dict.fromkeys(self._carrier(name) for name in robot.actuated_joints)),
        }
        if robot.tool_frame is not None:
            groups[SPINDLE] = (model.frames[robot.frame_id(robot.tool_frame)].parentJoint,)
        return {name: members for name, members in groups.items() if members and name not in self._bodies}

    @cached_property
    def _places(self) -> dict[str, int]:
        """The joint of the body that each joint or frame at an end of it is on."""
        places = {p.place for p in all_parameters(self.robot) if p.motion == "translation"} - self.robot.rods.keys()
        return {place: self._carrier(place) for place in sorted(places)}

    @cached_property
    def _expansions(self) -> dict[str | int, float]:
        """Expansion of screws, rods and, by the joints that carry them, bodies of another material [1/K]."""
        found: dict[str | int, float] = {}
        for name, expansion in sorted(
            self.numbers.expansions_per_K.items(), key=lambda item: item[0] not in self._groups
        ):
            self._check({name: expansion})
            members = self._groups.get(name, (name,))
            found |= {self._bodies[m][0] if m in self._bodies else m: expansion for m in members}
        return found

    def _expansion(self, body: str | int) -> float:
        return self._expansions.get(body, self.numbers.expansion_per_K)

    def _carrier(self, place: str) -> int:
        model = self.robot.model
        if model.existJointName(place):
            return int(model.parents[model.getJointId(place)])
        return int(model.frames[self.robot.frame_id(place)].parentJoint)

    def _temperatures(self, rises: Mapping[str, float]) -> dict[int, tuple[float, Vector]]:
        """Return the rise of each body at the joint that carries it [K], and its gradient [K/m]."""
        grouped = {
            member: rises[group] for group, members in self._groups.items() if group in rises for member in members
        }
        at: dict[int, list[tuple[Vector, float]]] = {}
        gradients: dict[int, Vector] = {}
        for name, value in rises.items():
            place, _, axis = name.rpartition(":")
            if name in self._bodies:
                joint, placement = self._bodies[name]
                at.setdefault(joint, []).append((placement.translation, value))
            elif place in self._bodies:
                joint, placement = self._bodies[place]
                gradients[joint] = gradients.get(joint, 0.0) + value * placement.rotation[:, AXES.index(axis)]
        temperatures = {}
        for joint in range(self.robot.model.njoints):
            usual = (np.zeros(3), grouped.get(joint, rises.get(EVERYTHING, 0.0)))
            points, values = zip(*at.get(joint, [usual]), strict=True)
            temperatures[joint] = linear_field(np.array(points), np.array(values), gradients.get(joint))
        return temperatures

    def _screw_strain(self, name: str, bodies: Mapping[int, tuple[float, Vector]], rises: Mapping[str, float]) -> float:
        if name not in self._screws:
            return 0.0
        rise = rises.get(name, rises.get(SCREWS) if SCREWS in self._groups else None)
        return self._expansion(name) * (self._rise_at(name, bodies) if rise is None else rise)

    def _rise_at(self, joint: str, bodies: Mapping[int, tuple[float, Vector]]) -> float:
        """Return the temperature rise where a body carries a joint [K]."""
        rise, gradient = bodies[self._carrier(joint)]
        return rise + float(gradient @ placement_on_body(self.robot, joint).translation)

    def _ruler(self, name: str, bodies: Mapping[int, tuple[float, Vector]], screws: Vector) -> Ruler:
        """Return how the coordinate of a joint in a coupling grows."""
        joint = self.robot.single_joint(name)
        if not joint.translates:
            return Ruler()
        if name in self._screws:
            drive = self.robot.actuated_joints.index(name)
            return Ruler(float(screws[drive]), float(self.bearings[drive]))
        return Ruler(self._expansion(self._carrier(name)) * self._rise_at(name, bodies))

    def _travels(self, commands: Array) -> Array:
        """Return coordinates of the drives' joints by the readings of their counters."""
        offsets = np.array([command.offset for command in self.robot.commands])
        return np.asarray((commands - offsets) / self._scales)

    def _readings(self, commands: Array, strains: Vector) -> Array:
        """Return the counter readings at which the drives of warm screws are where cold ones would be at commands."""
        travels = (self._travels(commands) + strains * self.bearings) / (1.0 + strains)
        offsets = np.array([command.offset for command in self.robot.commands])
        return np.asarray(offsets + self._scales * travels)

    def _check(self, rises: Mapping[str, float]) -> None:
        for name, rise in rises.items():
            body, _, axis = name.rpartition(":")
            if name not in self.names and name not in self._bodies and not (body in self._bodies and axis in AXES):
                expected = f"one of {', '.join(self.names)}, or a frame; gradients: LINK:x, y or z"
                raise InvalidValueError("temperature of", name, expected)
            finite_array(f"temperature of {name}", rise, ())
