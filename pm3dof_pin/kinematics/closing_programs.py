"""The compiled programs that close a robot's loops: traced once for a robot and all its variants, and kept on disk."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from pm3dof_pin.kinematics.samples import samples_near
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.cache import compiled, stored
from pm3dof_pin.programs.checks import checks_program
from pm3dof_pin.programs.closing import Task, closing_program
from pm3dof_pin.programs.llvm import Compiled
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot


class ClosingPrograms(NamedTuple):
    """The programs of one robot for one task.

    Attributes:
        step: one Newton step, see :func:`~pm3dof_pin.programs.closing.closing_program`.
        step_parameters: its parameters for this robot.
        checks: see :func:`~pm3dof_pin.programs.checks.checks_program`.
        checks_parameters: its parameters for this robot.
    """

    step: Compiled
    step_parameters: Vector
    checks: Compiled
    checks_parameters: Vector


class ProgramSource:
    """Traces, compiles and keeps the programs of a robot.

    Its variants (robots with errors, recalibrated ones) use them with their own geometry and limits as parameters.
    Where a variant has another number than the robot in the place of a constant, a second program is made in which all
    of the geometry are parameters; it serves all further variants.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._numbers = geometry.numbers(robot)
        self._structure = geometry.structure(robot)
        self._known: dict[tuple[Task, bool], tuple[Compiled, Compiled]] = {}

    @cached_property
    def samples(self) -> Matrix:
        """Closed configurations near home, see :func:`~pm3dof_pin.kinematics.samples.samples_near`.

        Raises:
            ConvergenceError: no closed configurations were found near home.
        """
        return samples_near(self._robot, self._robot.home.q)

    def serves(self, robot: Robot) -> bool:
        """Tell whether a variant of the robot has the same structure."""
        return robot is self._robot or geometry.structure(robot) == self._structure

    def programs(self, robot: Robot, task: Task) -> ClosingPrograms:
        """Return the programs of the robot or of a variant.

        Args:
            robot: the robot or a variant.
            task: what is given when loops are closed.

        Raises:
            ProgramError: there is no program for the robot, or it does not agree with Pinocchio.
            ConvergenceError: no closed configurations were found near home.
        """
        numbers = self._numbers if robot is self._robot else geometry.numbers(robot)
        dense = not geometry.share_constants(numbers, self._numbers)
        if (task, dense) not in self._known:
            self._known[task, dense] = self._made(task, dense)
        step, checks = self._known[task, dense]
        return ClosingPrograms(step, _chosen(numbers, step), checks, _chosen(numbers, checks))

    def _made(self, task: Task, dense: bool) -> tuple[Compiled, Compiled]:
        robot = self._robot
        content = repr((self._structure, self._numbers, robot.home.q.tolist(), robot.velocity_scale.tolist()))
        key = f"{hashlib.sha256(content.encode()).hexdigest()} {dense}"

        def traced() -> Program:
            verify(robot, self.samples, dense=dense)
            return closing_program(robot, task, self.samples, dense=dense).program

        step = stored(f"closing {key} {task}", traced)
        checks = stored(f"checks {key}", lambda: checks_program(robot, self.samples, dense=dense).program)
        return compiled(step), compiled(checks)


def _chosen(numbers: Mapping[str, float], program: Compiled) -> Vector:
    return geometry.chosen(numbers, program.program.parameters)
