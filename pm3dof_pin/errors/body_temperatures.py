"""A machine whose bodies have temperatures: its warm geometry, and the commands that undo what warming does.

Every length that a material fills expands once, with the temperature of the body that it is in: from the previous joint
on a body to the next joint, closure or tool. The travel of a sliding drive expands from its fixed bearing with its
screw, a rod that is a closure of type "distance" with its own temperature. If all are equally warm, the machine scales,
and a counter that scales with it reads as before.

Heat comes from its sources: the air warms `all`, motors and spindle what carries them, which `drives` and `spindle`
name, and friction the `screws`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.errors.command_correction import nearest_poses
from pm3dof_pin.errors.error_parameters import GeometricErrors, all_parameters
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference
from pm3dof_pin.errors.thermal_growth import STEEL_EXPANSION, ThermalGrowth
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Indices, Vector

T = TypeVar("T")

EVERYTHING = "all"
"""Name of the temperature rise of whatever has none of its own."""

SCREWS, DRIVES, SPINDLE = "screws", "drives", "spindle"
"""Names of groups: all screws; the links that carry actuated joints; the link that carries the tool."""

_PREFIX, _SUFFIX = "rise_", "_K"


def rise_column(name: str) -> str:
    """Return the column of files with the temperature rise of a link, screw, rod or group [K]."""
    return f"{_PREFIX}{name}{_SUFFIX}"


def rises_of(columns: Mapping[str, T]) -> dict[str, T]:
    """Return the temperature rises among columns, by the names of what has them."""
    return {
        name.removeprefix(_PREFIX).removesuffix(_SUFFIX): values
        for name, values in columns.items()
        if name.startswith(_PREFIX) and name.endswith(_SUFFIX)
    }


@dataclass(frozen=True, eq=False)
class BodyTemperatures:
    """The temperatures that a robot's bodies and screws can have, and what they do.

    Rises are above the state in which the machine is as described or calibrated [K], by the name of a link (with all
    that is fixed to it), of a sliding drive for its screw, of a rod by its closure, of a group, or `all` for the rest.
    A name counts before its group, a group before `all`. A screw without a rise has that of the link which carries its
    joint.
    """

    robot: Robot  #: the robot, as described or calibrated
    #: coordinate of each actuated joint at the fixed bearing of its screw, shape=(number of actuated joints,) [m]
    bearings: Vector
    expansion: float = STEEL_EXPANSION  #: of all bodies and screws [1/K]

    @classmethod
    def from_errors(cls, errors: GeometricErrors, robot: Robot | None = None) -> BodyTemperatures:
        """Return those of a robot, or of its calibrated version, with the bearings of its error file."""
        return cls(errors.robot if robot is None else robot, errors.fixed_bearings)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names that may have a temperature rise."""
        return tuple(dict.fromkeys((EVERYTHING, *self._groups, *self._bodies, *self._screws, *self._rods)))

    def warmed(self, rises: Mapping[str, float]) -> tuple[Robot, Vector]:
        """Return the robot with its bodies at temperature rises, and the rise of each drive's screw [K].

        Raises:
            InvalidValueError: a name is unknown, or a rise is not finite.
        """
        rises = self._single(rises)
        usual = rises.get(EVERYTHING, 0.0)
        by_joint = {self._bodies[name]: rise for name, rise in rises.items() if name in self._bodies}
        members = {place: by_joint.get(joint, usual) for place, joint in self._places.items()}
        # at a sliding drive a body ends at the bearing; the part from there to the joint's zero is the screw's
        screws = [rises.get(name, by_joint.get(self._carrier(name), usual)) for name in self.robot.actuated_joints]
        rods = {name: rises.get(name, usual) for name in self._rods}
        return self._growth(members, rods).grown(self.robot, 1.0), np.array(screws)

    def poses(self, poses: Poses, rises: Mapping[str, float]) -> Array:
        """Return the placements of the tool of the warm machine at the counter readings of n poses, shape=(n, 4, 4).

        Raises:
            UnreachablePoseError: the loops of the warm machine do not close.
            InvalidValueError: as :meth:`warmed`.
        """
        warm, screws = self.warmed(rises)
        commands = poses.commands + self._scales * self._excess(poses.commands, screws)
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
    def _bodies(self) -> dict[str, int]:
        """The joint that carries each link; those fixed to each other have the same."""
        frames = self.robot.model.frames
        return {frame.name: frame.parentJoint for frame in frames if frame.type == pin.FrameType.BODY}

    @cached_property
    def _screws(self) -> tuple[str, ...]:
        robot = self.robot
        return tuple(name for name in robot.actuated_joints if robot.single_joint(name).translates)

    @cached_property
    def _rods(self) -> tuple[str, ...]:
        return tuple(loop.name for loop in self.robot.closures if loop.kind.is_distance)

    @cached_property
    def _groups(self) -> dict[str, tuple[str, ...]]:
        """The names in each group that the robot has; none with the name of a link."""
        robot, model = self.robot, self.robot.model
        carriers = {self._carrier(name) for name in robot.actuated_joints}
        groups = {SCREWS: self._screws, DRIVES: tuple(n for n, joint in self._bodies.items() if joint in carriers)}
        if robot.tool_frame is not None:
            carrier = model.frames[robot.frame_id(robot.tool_frame)].parentJoint
            groups[SPINDLE] = tuple(name for name, joint in self._bodies.items() if joint == carrier)
        return {name: members for name, members in groups.items() if members and name not in self._bodies}

    @cached_property
    def _places(self) -> dict[str, int]:
        """The joint of the body that each member is part of, by the joint or frame at its end."""
        places = {p.place for p in all_parameters(self.robot) if p.motion == "translation"}
        return {place: self._carrier(place) for place in sorted(places)}

    def _carrier(self, place: str) -> int:
        model = self.robot.model
        if model.existJointName(place):
            return int(model.parents[model.getJointId(place)])
        return int(model.frames[self.robot.frame_id(place)].parentJoint)

    def _growth(self, members: Mapping[str, float], rods: Mapping[str, float] | None = None) -> ThermalGrowth:
        return ThermalGrowth(self.bearings, members=members, expansion=self.expansion, rods=rods or {})

    def _excess(self, commands: Array, screws: Vector) -> Array:
        """Return how much farther the drives are than their counters say, in joint units."""
        offsets = np.array([command.offset for command in self.robot.commands])
        travels = (commands - offsets) / self._scales
        slides = np.array([name in self._screws for name in self.robot.actuated_joints])
        return np.where(slides, self._growth({}).travel_errors(travels, screws), 0.0)

    def _readings(self, commands: Array, screws: Vector) -> Array:
        """Return the counter readings at which the drives of warm screws are where cold ones would be at commands."""
        offsets = np.array([command.offset for command in self.robot.commands])
        slides = np.array([name in self._screws for name in self.robot.actuated_joints])
        strain = np.where(slides, self.expansion * screws, 0.0)
        travels = (commands - offsets) / self._scales
        return np.asarray(offsets + self._scales * (travels + strain * self.bearings) / (1.0 + strain))

    def _single(self, rises: Mapping[str, float]) -> dict[str, float]:
        """Return checked rises with groups replaced by their members."""
        for name, rise in rises.items():
            if name not in self.names:
                raise InvalidValueError("temperature of", name, f"one of {', '.join(self.names)}")
            finite_array(f"temperature rise of {name}", rise, ())
        single: dict[str, float] = {}
        for group, members in self._groups.items():
            if group in rises:
                single |= dict.fromkeys(members, rises[group])
        return single | {name: rise for name, rise in rises.items() if name not in self._groups}
