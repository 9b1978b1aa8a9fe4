"""Compiled programs that close a robot's loops: traced once for a robot and its variants, and cached on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from pm3dof_pin.kinematics.samples import samples_near_home
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.cache import compiled, stored
from pm3dof_pin.programs.checks import checks_program
from pm3dof_pin.programs.closing import Task, closing_program, damped_closing_program
from pm3dof_pin.programs.llvm import Compiled, Iteration
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot


def program_source(robot: Robot) -> ProgramSource:
    """Return the source of a robot's programs: its prototype's, unless their structures differ."""
    source = robot.prototype.program_source
    return source if source.serves(robot) else robot.program_source


class BoundProgram(NamedTuple):
    """A compiled program with the geometry and limits of one robot."""

    compiled: Compiled
    parameters: Vector

    def __call__(self, inputs: Matrix, out: Matrix | None = None) -> Matrix:
        """Evaluate the program at many poses, shape=(n, number of outputs)."""
        return self.compiled(inputs, self.parameters, out)

    def iterate(self, inputs: Matrix, tolerance: float, max_steps: int) -> Iteration:
        """Repeat the program until its residual is small."""
        return self.compiled.iterate(inputs, self.parameters, tolerance=tolerance, max_steps=max_steps)

    def with_doubt(self, inputs: Matrix, threads: int | None = None) -> tuple[Array, Mask]:
        """Evaluate the program at many poses; return all outputs but the last, and a mask of those not in doubt."""
        return self.compiled.with_doubt(inputs, self.parameters, threads)

    def named(self, inputs: Matrix) -> dict[str, Array]:
        """Evaluate the program at many poses; return groups of outputs by name."""
        return self.compiled.program.split(self(inputs))


class ProgramSource:
    """Traces, compiles and caches the programs of a robot.

    Variants of the robot (with errors, or recalibrated) use them with their own geometry and limits as parameters. If
    a variant differs in a number that is a constant of the program, a second program is made with the whole geometry
    as parameters, which serves all further variants.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._numbers = geometry.numbers(robot)
        self._constants = geometry.constants(self._numbers)
        self._structure = geometry.structure(robot)
        self._latest: tuple[Robot, Mapping[str, float], bool] = robot, self._numbers, False
        self._known: dict[tuple[str, bool], Compiled] = {}

    @cached_property
    def samples(self) -> Matrix:
        """Closed configurations near home, see :func:`~pm3dof_pin.kinematics.samples.samples_near_home`."""
        return samples_near_home(self._robot)

    def serves(self, robot: Robot) -> bool:
        """Return whether a variant of the robot has the same structure."""
        return robot is self._robot or geometry.structure(robot) == self._structure

    def step(self, robot: Robot, task: Task, *, damped: bool = False) -> BoundProgram:
        """Return the program of a solver step, damped or not, that closes the loops of the robot or a variant.

        Raises:
            ProgramError: there is no program for the robot, or it disagrees with Pinocchio.
        """
        trace = damped_closing_program if damped else closing_program
        return self._bound(
            robot,
            f"step {task} {damped}",
            lambda dense: trace(self._robot, task, self.samples, dense=dense),
        )

    def checks(self, robot: Robot) -> BoundProgram:
        """Return the program that checks closed configurations, see :func:`~pm3dof_pin.programs.checks.checks_program`.

        Arguments and errors as in :meth:`step`.
        """
        return self._bound(robot, "checks", lambda dense: checks_program(self._robot, self.samples, dense=dense))

    def _bound(self, robot: Robot, name: str, trace: Callable[[bool], Program]) -> BoundProgram:
        numbers, dense = self._geometry_of(robot)

        def traced() -> Program:
            verify(self._robot, self.samples, dense=dense)
            return trace(dense)

        if (name, dense) not in self._known:
            self._known[name, dense] = compiled(stored(f"{name} {dense} {self._content}", traced))
        found = self._known[name, dense]
        return BoundProgram(found, geometry.chosen(numbers, found.program.parameters))

    def _geometry_of(self, robot: Robot) -> tuple[Mapping[str, float], bool]:
        """Return the numbers of the robot or a variant, and whether one of them differs from a constant."""
        if robot is self._robot:
            return self._numbers, False
        variant, numbers, dense = self._latest
        if variant is not robot:
            numbers = geometry.numbers(robot)
            dense = any(numbers[name] != value for name, value in self._constants)
            self._latest = robot, numbers, dense
        return numbers, dense

    @cached_property
    def _content(self) -> str:
        """Everything that the programs depend on besides their task."""
        robot = self._robot
        content = (self._structure, self._numbers, robot.home.q.tolist(), robot.characteristic_length)
        return hashlib.sha256(repr(content).encode()).hexdigest()
