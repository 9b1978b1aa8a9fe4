"""Compiled programs of a robot, traced once and cached on disk: those that close its loops, and of quantities at q.

The first serve the robot's variants too.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Iterable, Mapping
from functools import cached_property
from importlib.util import find_spec
from typing import TYPE_CHECKING, NamedTuple

import pinocchio as pin

from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.programs import geometry
from pm3dof_pin.programs.cache import compiled, known, require_short, stored
from pm3dof_pin.programs.checks import checks_program
from pm3dof_pin.programs.closing import Task, closing_program, damped_closing_program
from pm3dof_pin.programs.llvm_ir import NO_COMPILER
from pm3dof_pin.programs.masses import mass_content, mass_numbers, mass_pattern
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.programs.walk import Walk, branch_program, control_program, side_program, start_program
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.programs.llvm import Compiled, Walked

_KEPT, _KEPT_QUANTITIES = "_program_source", "_quantity_programs"
_MAX_KEPT = 100  # programs of a robot, with its payloads


def program_source(robot: PlacedMechanism) -> ProgramSource:
    """Return the source of a robot's programs: its prototype's, unless their structures differ."""
    if _KEPT not in vars(robot):
        first = robot.prototype
        shared = program_source(first) if first is not robot else None
        vars(robot)[_KEPT] = shared if shared and shared.serves(robot) else ProgramSource(robot)
    found: ProgramSource = vars(robot)[_KEPT]
    return found


class BoundProgram(NamedTuple):
    """A compiled program with the geometry and limits of one robot."""

    compiled: Compiled
    parameters: Vector

    def __call__(self, inputs: Matrix, out: Matrix | None = None, threads: int | None = None) -> Matrix:
        """Evaluate the program at many poses, shape=(n, number of outputs)."""
        return self.compiled(inputs, self.parameters, out, threads)

    def walk(self, starts: Matrix, targets: Matrix, shortest: float, tolerance: float) -> Walked:
        """Walk from starts to targets, see :meth:`~pm3dof_pin.programs.llvm.Compiled.walk`."""
        return self.compiled.walk(starts, targets, self.parameters, shortest=shortest, tolerance=tolerance, threads=1)

    def iterate(self, inputs: Matrix, tolerance: float, max_steps: int) -> tuple[Array, Array]:
        """Repeat the program until its residual is small; return states and residuals."""
        return self.compiled.iterate(inputs, self.parameters, tolerance=tolerance, max_steps=max_steps)

    def with_doubt(self, inputs: Matrix, threads: int | None = None) -> tuple[Array, Mask]:
        """Evaluate the program at many poses; return all outputs but the last, and a mask of those not in doubt."""
        return self.compiled.with_doubt(inputs, self.parameters, threads)

    def named(self, inputs: Matrix) -> dict[str, Array]:
        """Evaluate the program at many poses; return groups of outputs by name."""
        return self.compiled.program.split(self(inputs))


def quantity_program(
    robot: PlacedMechanism,
    own: tuple[object, ...],
    trace: Callable[[], Program],
    *,
    frames: Iterable[str] = (),
    model: pin.Model | None = None,
) -> BoundProgram:
    """Return the program of a quantity at q, which is kept for the robot.

    Args:
        robot: the robot.
        own: what the program depends on besides the robot's structure, geometry and masses.
        trace: records it.
        frames: frames that it needs in addition to those of the closures and the tool.
        model: whose masses it takes, the robot's or a copy with payloads; by default it takes none.

    Raises:
        ProgramError: there is no program for this robot.
    """
    kept: dict[tuple[str, bytes], BoundProgram] = vars(robot).setdefault(_KEPT_QUANTITIES, {})
    name = repr(own), b"" if model is None else mass_content(model)
    if name not in kept:
        numbers = {} if model is None else mass_numbers(model)
        pattern = [] if model is None else mass_pattern(model)
        key = repr((*own, pattern, geometry.structure(robot), geometry.pattern(robot, frames)))
        found = known(key, trace)
        if len(kept) >= _MAX_KEPT:
            kept.clear()
        kept[name] = BoundProgram(found, geometry.values(robot, found.program.parameters, numbers))
    return kept[name]


class ProgramSource:
    """Traces, compiles and caches the programs of a robot.

    Variants of the robot (with errors, or recalibrated) use them with their own geometry and limits as parameters. If
    a variant differs in a number that is a constant of the program, a second program is made with the whole geometry
    as parameters, which serves all further variants.
    """

    def __init__(self, robot: PlacedMechanism) -> None:
        self._robot = robot
        self._numbers = geometry.numbers(robot)
        self._constants = geometry.constants(self._numbers)
        self._structure = geometry.structure(robot)
        self._latest: tuple[PlacedMechanism, Mapping[str, float], bool] = robot, self._numbers, False
        self._known: dict[tuple[str, bool], Compiled] = {}

    @cached_property
    def samples(self) -> Matrix:
        """Closed configurations near home, see :func:`~pm3dof_pin.kinematics.branches.samples_near_home`."""
        return samples_near_home(self._robot)

    def serves(self, robot: PlacedMechanism) -> bool:
        """Return whether a variant of the robot has the same structure."""
        return robot is self._robot or geometry.structure(robot) == self._structure

    def walk(self, robot: PlacedMechanism, task: Task) -> BoundProgram:
        """Return the walk that closes the loops of the robot or a variant, and its Newton step.

        Raises:
            ProgramError: there is no program for the robot, or it disagrees with Pinocchio.
        """
        own, samples = self._robot, self.samples

        def trace(dense: bool) -> Walk:
            step = self._recorded_step(task, dense)
            start = self._stored(f"start {task}", dense, lambda: start_program(own, task, samples, dense=dense))
            control = self._stored(
                f"control {task}", dense, lambda: control_program(own, start, task, samples, dense=dense)
            )
            return Walk.from_programs(step, start, control)

        return self._bound(robot, f"walk {task}", trace)

    def require_walk(self, robot: PlacedMechanism, task: Task) -> None:
        """Raise what :meth:`walk` and :meth:`checks` do, except where LLVM fails: nothing is compiled."""
        if find_spec("llvmlite") is None:
            raise ProgramError(NO_COMPILER)
        dense = self._geometry_of(robot)[1]
        for program in (self._recorded_step(task, dense), self._recorded_checks(dense)):
            require_short(program)

    def _recorded_step(self, task: Task, dense: bool) -> Program:
        own, samples = self._robot, self.samples
        return self._stored(f"step {task}", dense, lambda: closing_program(own, task, samples, dense=dense))

    def sides(self, robot: PlacedMechanism, task: Task) -> BoundProgram | None:
        """Return the program that tells sides of singular configurations apart, None if a walk's modes do.

        See :func:`~pm3dof_pin.programs.walk.side_program`; arguments and errors as in :meth:`walk`.
        """
        own, samples = self._robot, self.samples
        name = f"sides {task}"

        def trace(dense: bool) -> Program:
            return self._stored(name, dense, lambda: side_program(own, task, samples, dense=dense))

        return self._bound(robot, name, trace) if len(trace(self._geometry_of(robot)[1])) else None

    def printable_walk(self, robot: PlacedMechanism, task: Task) -> tuple[Walk, Vector]:
        """Return the walk, with the program that tells branches apart, and its parameters; errors as above."""
        walk, coordinates = self.walk(robot, task).compiled.walk_program, Task.from_coordinates(self._robot.coordinates)
        assert walk is not None
        numbers, dense = self._geometry_of(robot)
        own, samples = self._robot, self.samples
        name = f"branch {coordinates}"
        branch = self._stored(name, dense, lambda: branch_program(own, coordinates, samples, dense=dense))
        walk = walk.with_branch(branch, robot.closure_tolerance)
        return walk, geometry.chosen(numbers, walk.parameters)

    def damped_step(self, robot: PlacedMechanism, task: Task) -> BoundProgram:
        """Return the damped step that closes the loops of the robot or a variant; errors as in :meth:`walk`."""
        name = f"damped step {task}"
        own, samples = self._robot, self.samples
        return self._bound(
            robot,
            name,
            lambda dense: self._stored(name, dense, lambda: damped_closing_program(own, task, samples, dense=dense)),
        )

    def checks(self, robot: PlacedMechanism) -> BoundProgram:
        """Return the program that checks closed configurations, see :func:`~pm3dof_pin.programs.checks.checks_program`.

        Arguments and errors as in :meth:`walk`.
        """
        return self._bound(robot, "checks", self._recorded_checks)

    def _recorded_checks(self, dense: bool) -> Program:
        own, samples, task = self._robot, self.samples, Task.from_coordinates(self._robot.coordinates)
        return self._stored(f"checks {task}", dense, lambda: checks_program(own, samples, task, dense=dense))

    def _stored(self, name: str, dense: bool, trace: Callable[[], Program]) -> Program:
        """Return a program from the cache, or trace it after a comparison with Pinocchio."""

        def traced() -> Program:
            verify(self._robot, self.samples, dense=dense)
            return trace()

        return stored(f"{name} {dense} {self._content}", traced)

    def _bound(self, robot: PlacedMechanism, name: str, trace: Callable[[bool], Program | Walk]) -> BoundProgram:
        numbers, dense = self._geometry_of(robot)
        if (name, dense) not in self._known:
            self._known[name, dense] = compiled(trace(dense))
        found = self._known[name, dense]
        return BoundProgram(found, geometry.chosen(numbers, found.program.parameters))

    def _geometry_of(self, robot: PlacedMechanism) -> tuple[Mapping[str, float], bool]:
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
