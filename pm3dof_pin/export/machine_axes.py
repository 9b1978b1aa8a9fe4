"""Robots as machine controllers see them: axes by letter, joints, and poses that straight moves reach."""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.exceptions import InvalidValueError, SingularConfigurationError, UnreachablePoseError
from pm3dof_pin.export.axis_limits import AxisLimits, axis_limits
from pm3dof_pin.export.controller import Controller
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.jacobians import jacobian
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Matrix

_LETTERS = {"x": "X", "y": "Y", "z": "Z", "rx": "A", "ry": "B", "rz": "C"}
_SPARE = {"m": "XYZUVW", "rad": "ABC"}
SHOWN = {"m": 1000.0, "rad": 180.0 / math.pi}
"""Units of controllers: mm, degrees."""

_PARALLEL = 1e-6  # greatest deviation of an axis from a component of the tool's motion
_STOPS, _TRIALS, _SEED = 12, 400, 1
_NEARER = 0.7  # of the way from home to a random pose, for stops between which straight moves stay within limits
_BETWEEN = 20  # poses of a move that are compared with the limits
AXIS_INDICES = {letter: index for index, letter in enumerate("XYZABCUVW")}
"""Places of axes in the pose of a controller."""

DIGITS = 6
"""Digits of millimetres and degrees in programs."""


@dataclass(frozen=True, eq=False)
class Axes:
    """Axis letters of the coordinates, and which component of the tool's position each is."""

    letters: tuple[str, ...]
    positions: tuple[int | None, ...]  #: 0, 1, 2 for x, y, z of the tool; None for others

    @classmethod
    def of(cls, robot: Robot) -> Axes:
        """Match coordinates with axes: those of the tool's motion at home, or else the first that are left.

        Raises:
            InvalidValueError: there is no axis left for a coordinate.
        """
        components = [_component(robot, k) for k in range(len(robot.coordinates))]
        taken = [_LETTERS[name] for name in components if name is not None]
        letters = []
        for coordinate, component in zip(robot.coordinates, components, strict=True):
            if component is not None:
                letters.append(_LETTERS[component])
                continue
            left = [letter for letter in _SPARE[coordinate.unit] if letter not in (*taken, *letters)]
            if not left:
                raise InvalidValueError(f"{robot.name} has no axis for {coordinate.name}", expected="at most nine axes")
            letters.append(left[0])
        if len(set(letters)) < len(letters):
            raise InvalidValueError("axes of " + robot.name, " ".join(letters), "a different one for each coordinate")
        places = [None if c is None or c.startswith("r") else "xyz".index(c) for c in components]
        return cls(tuple(letters), tuple(places))


def _component(robot: Robot, index: int) -> str | None:
    """Return the component of the tool's placement that a coordinate is, or None."""
    coordinate = robot.coordinates[index]
    if coordinate.tool is not None:
        return coordinate.tool
    if robot.tool_frame is None:
        return None
    with suppress(SingularConfigurationError):
        twists = jacobian(robot, robot.home, of="tool", by="coordinates").values
        for k, name in enumerate(TOOL_COMPONENTS):
            unit = (k < 3) == (coordinate.unit == "m")
            across = np.delete(twists[:3] if k < 3 else twists[3:], k % 3, axis=0)[:, index]
            if unit and abs(twists[k, index] - 1.0) < _PARALLEL and np.abs(across).max() < _PARALLEL:
                return name
    return None


class Machine:
    """A robot as a controller sees it: axes, and joints in millimetres and degrees.

    Attributes:
        robot: the robot.
        controller: its programs.
        name: prefix of files.
        axes: letters of its coordinates.
        shown, joint_shown: units of coordinates and commands: mm, degrees, by m and rad.
    """

    def __init__(self, controller: Controller) -> None:
        self.controller, self.robot = controller, controller.robot
        self.name = controller.name
        self.axes = Axes.of(self.robot)
        self.shown = np.array([SHOWN[c.unit] for c in self.robot.coordinates])
        self.joint_shown = np.array([SHOWN[c.unit] for c in self.robot.commands])

    @cached_property
    def limits(self) -> AxisLimits:
        """Speeds and accelerations of the axes that keep every drive within its own."""
        return axis_limits(self.robot)

    @cached_property
    def stops(self) -> tuple[Matrix, Matrix]:
        """Poses that straight moves reach one after the other [mm, deg], and the joints there, by Pinocchio."""
        robot = self.robot
        home = robot.home_coordinates
        drawn = reachable_poses(robot, _TRIALS, np.random.default_rng(_SEED)).coordinates
        wanted = np.round((home + _NEARER * (drawn - home)) * self.shown, DIGITS)
        lower, upper = coordinate_ranges(robot, robot.coordinates)
        wanted = wanted[((wanted >= lower * self.shown) & (wanted <= upper * self.shown)).all(axis=1)]
        stops, last = [], home
        for values in wanted:
            here = values / self.shown
            between = last + np.linspace(0.0, 1.0, _BETWEEN)[:, None] * (here - last)
            if robot.solve(between, on_failure="nan").within_limits.all():
                stops.append(values)
                last = here
            if len(stops) == _STOPS:
                break
        if len(stops) < _STOPS:
            raise UnreachablePoseError(f"{robot.name}: straight moves reach only {len(stops)} of {_STOPS} random poses")
        poses = robot.solve(np.array(stops) / self.shown, engine="pinocchio")
        return np.array(stops), poses.commands * self.joint_shown
