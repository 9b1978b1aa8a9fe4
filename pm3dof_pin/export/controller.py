"""What a controller needs of a robot: programs for both directions, their numbers, and poses to test them with."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError
from pm3dof_pin.export.ros import ros_package_name
from pm3dof_pin.kinematics.branches import start_of
from pm3dof_pin.kinematics.closing_programs import program_source
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.jacobian_programs import jacobian_program
from pm3dof_pin.kinematics.jacobians import motion_rates
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.units import coordinate_scales
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.checks import checks_program
from pm3dof_pin.programs.closing import Task, regularity_and_mode
from pm3dof_pin.programs.readings import readings_program
from pm3dof_pin.programs.walk import REACHED, Walk, acceptance_program
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array, Matrix, Vector

Deviations = Callable[[Matrix], Array]
"""Learned deviations of the commands at commands, shape=(n, number of commands) [m, rad]."""

_GOLDEN_POSES = 8
_WAYPOINTS = 32  # golden poses of an arm, by which it goes round singular ones
_NODES = {1: 65, 2: 33, 3: 17}  # per drive of a table, by the number of drives
_TRIALS = 2000  # random commands at which a table is compared with its function
_SEED = 0
_NEAR = 0.05  # distance of golden poses from home, where limits leave hardly any [rad, characteristic lengths]


@dataclass(frozen=True, eq=False)
class CorrectionTable:
    """Learned deviations of the commands on a grid of commands, to be interpolated linearly in each."""

    lower: Vector  #: first node by drive, shape=(k,) [m, rad]
    step: Vector  #: distance of nodes, shape=(k,) [m, rad]
    values: Array  #: deviations at the nodes, shape=(n, ..., n, k) [m, rad]
    error: float  #: greatest error of the interpolation at random commands [m, rad]

    @classmethod
    def from_deviations(cls, robot: Robot, deviations: Deviations) -> CorrectionTable:
        """Tabulate deviations over the ranges of the drives; InvalidValueError for more than three drives."""
        count = len(robot.commands)
        if count not in _NODES:
            raise InvalidValueError(
                f"learned correction of {robot.name}",
                problem=f"has {count} drives, and a table of fixed size would be too coarse",
                expected="at most 3 drives, or a calibration with the method lm",
            )
        lower, upper = coordinate_ranges(robot, robot.command_coordinates)
        nodes = _NODES[count]
        axes = np.linspace(lower, upper, nodes)
        grid = np.stack(np.meshgrid(*axes.T, indexing="ij"), axis=-1)
        values = deviations(grid.reshape(-1, count)).reshape(grid.shape)
        table = cls(lower, (upper - lower) / (nodes - 1), values, 0.0)
        trials = np.random.default_rng(_SEED).uniform(lower, upper, (_TRIALS, count))
        return replace(table, error=float(np.abs(table.interpolated(trials) - deviations(trials)).max()))

    def interpolated(self, commands: Matrix) -> Array:
        """Return the deviations at commands, shape=(n, k), as the printed functions do."""
        count, nodes = commands.shape[1], self.values.shape[0]
        places = np.clip((commands - self.lower) / self.step, 0.0, nodes - 1.0)
        first = np.minimum(places.astype(int), nodes - 2)
        shares, total = places - first, np.zeros_like(commands)
        for corner in np.ndindex(*(2,) * count):
            weights = np.prod(np.where(corner, shares, 1.0 - shares), axis=1)
            total += weights[:, None] * self.values[tuple((first + corner).T)]
        return total


@dataclass(frozen=True, eq=False)
class Model:
    """One set of numbers for the programs: the robot as described, or calibrated."""

    numbers: Vector  #: geometry, then home's q, its modes in both directions, and the number of its branch
    golden: Matrix  #: poses computed by Pinocchio: coordinates, then commands, shape=(n, m + k) [m, rad]
    correction: CorrectionTable | None = None  #: learned deviations of the commands


class Controller:
    """The programs that a controller runs for a robot, with one layout of their numbers.

    Args:
        robot: the robot as described.
        calibrated: the same robot with identified parameters, or None.
        deviations: learned deviations of the commands of `calibrated`, or of `robot` without it; None for none.

    Attributes:
        robot: the robot as described.
        name: prefix of functions and files: lower-case letters, digits and underscores.
        inverse, forward: walks to coordinates and to commands.
        programs: `branch`, `accept`, `readings`, `checks`, and `jacobian` of the commands by the coordinates.
        parameters: names of the parameters that all share.
        models: `nominal`, and `calibrated` if there is one.

    Raises:
        ProgramError: there is no program for the robot, or it disagrees with Pinocchio.
        InvalidValueError: the robot has no drives, or more independent ones than coordinates, or its learned correction
            does not fit a table.
        ConvergenceError: the loops do not close at home.
        SingularConfigurationError: several branches meet there, or the drives do not determine the pose.
    """

    def __init__(self, robot: Robot, *, calibrated: Robot | None = None, deviations: Deviations | None = None) -> None:
        if not robot.commands:
            raise InvalidValueError(robot.name, problem="has no actuated joints", expected="drives to control")
        robot.require_regular_drives()
        self.robot = robot
        self.name = ros_package_name(robot.name).removesuffix("_description")
        variants = {"nominal": robot} | ({} if calibrated is None else {"calibrated": calibrated})
        if calibrated is None and deviations is not None:
            variants["calibrated"] = robot
        widest = variants.get("calibrated", robot)
        source = program_source(robot)
        samples, dense = source.samples, calibrated is not None
        count, given = len(robot.placing_drives), len(robot.coordinates)
        if given < count:  # said before the programs of the loops are compiled
            raise InvalidValueError(
                robot.name,
                problem=f"has {count} independent drives, which {given} coordinates do not determine",
                expected=f"{count} coordinates, such as further joints of the arm or the legs",
            )
        self.inverse, self.forward = (
            source.printable_walk(widest, Task.from_coordinates(way))[0]
            for way in (robot.coordinates, self.robot.placing_commands)
        )
        groups = {"commands": robot.command_coordinates, "coordinates": robot.coordinates}
        rates = [motion_rates(robot, name, name) for name in groups]
        assert self.inverse.branch is not None
        programs = {
            "branch": self.inverse.branch,
            "accept": acceptance_program(),
            "readings": readings_program(robot, groups, samples, dense=dense),
            "checks": checks_program(robot, samples, dense=dense),
            "jacobian": jacobian_program(robot, rates[0], rates[1], samples, dense=dense),
        }
        walked = [program for walk in (self.inverse, self.forward) for program in walk.parts.values()]
        self.parameters = tuple(
            dict.fromkeys(name for each in (*walked, *programs.values()) for name in each.parameters)
        )
        self.programs = {name: each.with_parameters(self.parameters) for name, each in programs.items()}
        self.inverse, self.forward = self._widened(self.inverse), self._widened(self.forward)
        self.models = {
            name: self._model(variant, deviations if name == "calibrated" else None)
            for name, variant in variants.items()
        }

    @cached_property
    def single_precision_error(self) -> float:
        """Greatest error at the golden poses of what single precision computes, counters over their scale [m, rad]."""
        worst, scales = 0.0, np.array([c.scale for c in (*self.robot.coordinates, *self.robot.command_coordinates)])
        for model in self.models.values():
            count, single = len(self.parameters), np.float32
            sizes = np.split(np.abs(scales), [len(self.robot.coordinates)])
            numbers, wanted = model.numbers[:count], np.split(model.golden, [len(self.robot.coordinates)], axis=1)
            ways = zip(
                self._ways, wanted, reversed(wanted), reversed(sizes), (self._commands, self._coordinates), strict=True
            )
            for (walk, coordinates), given, answers, units, read in ways:
                targets = self.targets(coordinates, given[:, self._placing_of(coordinates)])
                q, _ = walk.evaluate(self._starts(model, len(targets)), targets, numbers)
                for _ in range(2):
                    state = np.column_stack([q, np.tile([1.0, 0.0], (len(q), 1)), targets])
                    q = walk.step.evaluate(state, numbers, single)[:, : walk.nq]
                found = read(self.programs["readings"].evaluate(q, numbers, single))
                worst = max(worst, float(np.abs((found - answers) / units).max(initial=0.0)))
        return worst

    def order(self, coordinates: Sequence[Coordinate]) -> list[int]:
        """Return the order of a walk's targets: joints before components of the tool."""
        return sorted(range(len(coordinates)), key=lambda k: coordinates[k].joint is None)

    def targets(self, coordinates: Sequence[Coordinate], values: Matrix) -> Matrix:
        """Return the targets of a walk to values of coordinates, shape=(n, m)."""
        chosen = [coordinates[k] for k in self.order(coordinates)]
        offsets, scales = np.array([[c.offset, c.scale] for c in chosen]).T
        targets: Matrix = (values[:, self.order(coordinates)] - offsets) / scales
        return targets

    def _widened(self, walk: Walk) -> Walk:
        step, start, control, branch = (part.with_parameters(self.parameters) for part in walk.parts.values())
        return replace(walk, step=step, start=start, control=control, branch=branch)

    def _model(self, robot: Robot, deviations: Deviations | None) -> Model:
        numbers, q = geometry.values(robot, self.parameters), start_of(robot)
        at_home = robot.at([q])
        given = (at_home.coordinates, at_home.commands[:, self._placing_of(self.robot.placing_commands)])
        modes = []
        for (walk, coordinates), values in zip(self._ways, given, strict=True):
            state = np.concatenate([q, [1.0, 0.0], self.targets(coordinates, values)[0]])
            margin = walk.step.evaluate(state[None], numbers)[:, walk.step.slices["margin"].start]
            modes.append(regularity_and_mode(margin)[1][0])
        branch = self.programs["branch"].evaluate(q[None], numbers)[0, 0] if robot.has_branches else 0.0
        model = Model(np.concatenate([numbers, q, modes, [branch]]), np.empty((0, 0)))
        table = None if deviations is None else CorrectionTable.from_deviations(robot, deviations)
        return replace(model, golden=self._golden(robot, model), correction=table)

    def _golden(self, robot: Robot, model: Model) -> Matrix:
        """Return poses that walks from home reach in both directions, solved by Pinocchio."""
        poses = _some_poses(robot)
        values = poses.coordinates
        if not robot.has_loops:  # then a walk may end in another posture
            targets, own = self.targets(robot.coordinates, values), model.numbers[: len(self.parameters)]
            ends, status = self.inverse.evaluate(self._starts(model, len(targets)), targets, own)
            poses, values = robot.at(ends[status == REACHED]), values[status == REACHED]
        with suppress(PM3DofError):
            poses = robot.solve(values, guess=poses.q, on_failure="nan", engine="pinocchio")
        sound, numbers = np.array(poses.solved), model.numbers[: len(self.parameters)]
        for (walk, coordinates), given in zip(self._ways, (values, poses.commands), strict=True):
            targets = self.targets(coordinates, np.where(sound[:, None], given, 0.0)[:, self._placing_of(coordinates)])
            ends, status = walk.evaluate(self._starts(model, len(targets)), targets, numbers)
            read = self.programs["readings"].evaluate(ends, numbers)
            same = np.abs(self._coordinates(read) - values).max(axis=1) < SAME
            sound &= (status == REACHED) & same & (np.abs(self._commands(read) - poses.commands).max(axis=1) < SAME)
        golden: Matrix = np.hstack([values, poses.commands])[sound]
        return golden

    @property
    def _ways(self) -> tuple[tuple[Walk, tuple[Coordinate, ...]], ...]:
        return (self.inverse, self.robot.coordinates), (self.forward, self.robot.placing_commands)

    def _placing_of(self, coordinates: tuple[Coordinate, ...]) -> list[int]:
        """Return which of the commands, or of the coordinates, a walk takes."""
        return (
            self.robot.placing_drives if coordinates == self.robot.placing_commands else list(range(len(coordinates)))
        )

    def _starts(self, model: Model, count: int) -> Matrix:
        first = len(self.parameters)
        starts: Matrix = np.tile(model.numbers[first : first + self.inverse.nq], (count, 1))
        return starts

    def _commands(self, readings: Matrix) -> Matrix:
        found: Matrix = readings[:, self.programs["readings"].slices["commands"]]
        return found

    def _coordinates(self, readings: Matrix) -> Matrix:
        found: Matrix = readings[:, self.programs["readings"].slices["coordinates"]]
        return found


def _some_poses(robot: Robot) -> Poses:
    """Return random poses within limits; or else, if these leave hardly any, poses near home."""
    generator = np.random.default_rng(_SEED)
    try:
        return reachable_poses(robot, _GOLDEN_POSES if robot.has_loops else _WAYPOINTS, generator)
    except PM3DofError:
        scales = coordinate_scales(robot, robot.coordinates)
        around = generator.uniform(-_NEAR, _NEAR, (_GOLDEN_POSES, len(scales))) * scales
        found = robot.solve(robot.home_coordinates + around, on_failure="nan")
        return found[found.solved]
