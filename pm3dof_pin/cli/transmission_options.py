"""Options of commands about joints driven through loops: which joints, the drives' limits, and the box."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, get_args

import numpy as np
import typer

from pm3dof_pin.capability.polytopes import MOST_FACETS, pairs_of_facets
from pm3dof_pin.capability.transmission import (
    Transmission,
    described_gains,
    held_as_described,
    held_outside,
    joint_driven,
    transmission,
)
from pm3dof_pin.cli.drive_options import NUMBER_OF_DRIVES, DriveEffort, DriveSpeed, limits_of_drives
from pm3dof_pin.cli.map_options import CoordinateRange, declared_ranges, robot_grid
from pm3dof_pin.cli.options import Payload, finite_number, payloads_of
from pm3dof_pin.cli.output import message
from pm3dof_pin.exceptions import (
    FrameNotFoundError,
    InvalidValueError,
    JointNotFoundError,
    SingularConfigurationError,
)
from pm3dof_pin.export.functions import Target, export_functions
from pm3dof_pin.kinematics.assemblies import home_within_limits
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Vector

_POINTS = 21  # of each joint, unless that makes too many poses
_FEWEST_POINTS = 3  # of each joint where facets are many: both ends and the middle
_MAX_POSES = 30_000  # of a box by default
_MAX_NUMBERS = 100_000_000  # of all poses of a box: under a gigabyte


@dataclass(frozen=True, kw_only=True)
class TransmissionOptions:
    """Joints, limits of the drives, and the box of a transmission."""

    joints: Annotated[
        str | None,
        typer.Option(
            metavar="A,B",
            help="Joints of the serial model; by default the robot's coordinates, which `export serial` takes if they "
            "are joints.",
        ),
    ] = None
    subtree: Annotated[
        str | None,
        typer.Option(
            metavar="LINK",
            help="Only what this link carries; all other joints are held at home, unless --joints names them.",
        ),
    ] = None
    hold: Annotated[
        str | None,
        typer.Option(metavar="A,B", help="Joints that are held as described, as those of springs that count as rigid."),
    ] = None
    over: Annotated[
        list[CoordinateRange] | None,
        typer.Option(
            "--over",
            metavar="NAME FIRST LAST COUNT",
            parser=CoordinateRange.parse,
            help="Values of a joint [deg, m]; may be repeated. By default each joint's range.",
        ),
    ] = None
    effort: DriveEffort = None
    speed: DriveSpeed = None
    armature: Annotated[
        str | None,
        typer.Option(metavar=NUMBER_OF_DRIVES, help="Inertia of the rotors at the driven joints [kg m^2, kg]."),
    ] = None
    gains: Annotated[
        str | None, typer.Option(metavar="KP,KD", help="Gains of each drive; the description's by default.")
    ] = None
    to: Annotated[
        str,
        typer.Option(
            metavar="A,B",
            help="Also write the mapping between joints and drives as functions: numpy, jax, torch, casadi, c.",
        ),
    ] = ""
    payload: Payload = 0.0

    def part(self, robot: Robot) -> Robot:
        """Return the part of a robot that is asked about, with the joints as its coordinates."""
        return self.whole_and_part(robot)[1]

    def whole_and_part(self, robot: Robot) -> tuple[Robot, Robot]:
        """Return the robot, and the part of it that is asked about, with the joints as its coordinates.

        A home that is open, singular or beyond limits is replaced by the only assembly within limits, with a message.
        """
        if both := sorted({*self.held} & {*_names(self.joints)}):
            raise typer.BadParameter(f"--hold {both[0]}: is one of --joints")
        try:
            part = robot if self.hold is None else held_as_described(robot, self.held)
            if (home := home_within_limits(part)) is not None:
                part = part.with_home(home.q)
                message(
                    f"pm3dof: {robot.name}: its described home is open, singular or beyond limits; home is here the "
                    "only assembly found within all limits: pm3dof info --assemble writes it next to the file"
                )
            if home is not None or self.hold is not None:
                robot = robot.with_home(_completed(robot, part))
            if self.subtree is not None:
                part = held_outside(part, self.subtree, _names(self.joints))
            part = joint_driven(part, _names(self.joints))
        except (JointNotFoundError, FrameNotFoundError, InvalidValueError) as error:
            raise typer.BadParameter(str(error)) from error
        pairs = pairs_of_facets(len(part.actuated_joints), len(part.coordinates))
        if pairs > MOST_FACETS:
            raise typer.BadParameter(
                f"{robot.name}: {len(part.actuated_joints)} drives move {len(part.coordinates)} joints together, whose "
                f"torques have up to {pairs:,} pairs of limits, more than {MOST_FACETS:,}: take one part of the robot "
                "with --subtree LINK, hold some joints with --hold, or name fewer with --joints"
            )
        if part.commands and {c.name for c in part.coordinates} == {command.name for command in part.commands}:
            message(
                "pm3dof: these coordinates are the drives' own: name the joints of the serial model with --joints A,B, "
                "and one leg of several with --subtree LINK"
            )
        return robot, part

    @property
    def held(self) -> list[str]:
        """Joints of --hold."""
        return _names(self.hold)

    def at(self, poses: Poses) -> Transmission:
        """Compute the transmission at one pose, of the given limits."""
        return self._of(poses.robot, poses)

    def _of(self, robot: Robot, values: Poses | Grid) -> Transmission:
        limits: Any = limits_of_drives(robot, effort=self.effort, speed=self.speed, armature=self.armature)
        limits["payloads"] = payloads_of(robot, self.payload)
        try:
            return transmission(robot, values, on_failure="nan" if values.shape else "raise", **limits)
        except SingularConfigurationError as error:
            if self.joints is None:
                raise
            raise SingularConfigurationError(
                f"{error}; the joints and the drives must determine each other: name others with --joints and "
                "--drives, make springs rigid with --hold, or take one leg with --subtree LINK"
            ) from error

    def box(self, robot: Robot) -> Transmission:
        """Compute the transmission over the box: the given ranges, and those declared of all other joints."""
        given = {entry.name: entry.count for entry in self.over or ()}
        others = [coordinate for coordinate in robot.coordinates if coordinate.name not in given]
        most = _MAX_POSES / max(1, math.prod(given.values()))
        points = min(_POINTS, max(2, math.floor(most ** (1.0 / len(others)) + 1e-9))) if others else 0
        drives, joints = len(robot.actuated_joints), len(robot.coordinates)
        # three polytopes are kept, each with two facets a pair, and a fourth one is made
        of_facets = pairs_of_facets(drives, joints) * (6 * (joints + 1) + drives + 3 * joints)
        most = _MAX_NUMBERS / (robot.model.nq + drives * joints**2 + of_facets)
        while points > _FEWEST_POINTS and math.prod(given.values()) * points ** len(others) > most:
            points -= 1
        count = math.prod(given.values()) * points ** len(others)
        if count > most:
            raise typer.BadParameter(
                f"{robot.name}: a box of {count:,} poses of {joints} joints and {drives} drives is too large, at most "
                f"{math.floor(most):,} can be computed: name fewer joints with --joints, hold some with --hold, take "
                "one part of the robot with --subtree LINK, or give --over smaller counts"
            )
        ranges = [*(self.over or ()), *declared_ranges(robot, others, [points] * len(others))]
        order = [coordinate.name for coordinate in robot.coordinates]
        ranges.sort(key=lambda entry: order.index(entry.name) if entry.name in order else -1)
        found = self._of(robot, robot_grid(robot, ranges))
        within = found.poses.within_limits
        if within.any() and np.isnan(found.jacobian[within]).all():  # at one pose, the error says why
            self._of(robot, found.poses[tuple(np.argwhere(within)[0])])
        return found

    def write_functions(self, robot: Robot, folder: Path) -> list[Path]:
        """Write the mapping for the libraries of --to, into `functions` of a folder; return the files."""
        libraries: list[Any] = list(dict.fromkeys(_names(self.to)))
        known = [name for choice in get_args(Target) for name in (get_args(choice) or (choice,))]
        if unknown := [name for name in libraries if name not in known]:
            raise typer.BadParameter(f"--to {unknown[0]}: expected some of {', '.join(known)}")
        files = []
        for library in libraries:
            of = ["commands"] if library == "c" else ["commands", "coordinates", "jacobian"]
            files += export_functions(robot, of, library, folder / "functions")
        return files

    def gains_of(self, robot: Robot) -> dict[str, Vector | float | None]:
        """Return the gains of the drives as "kp" and "kd": those given, or those that all drives are described with."""
        numbers: Sequence[float] = [finite_number(entry) for entry in _names(self.gains)]
        if len(numbers) not in (0, 2) or min(numbers, default=0.0) < 0.0:
            raise typer.BadParameter(f"--gains {self.gains}: expected KP,KD, not negative")
        if not numbers:
            return dict(described_gains(robot))
        return dict(zip(("kp", "kd"), numbers, strict=True))


def _completed(robot: Robot, part: Robot) -> Vector:
    """Return the home of a robot without some joints, completed by these as they are described."""
    q, home = robot.described_home.q.copy(), part.home.q
    for name, joint in zip(list(part.model.names)[1:], list(part.model.joints)[1:], strict=True):
        start = robot.model.joints[robot.model.getJointId(name)].idx_q
        q[start : start + joint.nq] = home[joint.idx_q : joint.idx_q + joint.nq]
    return q


def _names(text: str | None) -> list[str]:
    return [name.strip() for name in (text or "").split(",") if name.strip()]
