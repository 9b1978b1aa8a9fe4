"""Programs that move a robot in a page without Python: traced from its model, printed as JavaScript."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import logging
from collections.abc import Iterable, Iterator, Sequence
from functools import cached_property, lru_cache
from typing import Any

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.dynamics.traced import holding_program
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.quantities import COMPLIANCE
from pm3dof_pin.elastic.springs import Spring
from pm3dof_pin.elastic.traced import elastic_program
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.sensitivity_program import at_zero_errors
from pm3dof_pin.exceptions import DescriptionError, ProgramError
from pm3dof_pin.kinematics.closing_programs import program_source
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import geometry, masses
from pm3dof_pin.programs.closing import Task
from pm3dof_pin.programs.graph import Graph
from pm3dof_pin.programs.javascript import javascript
from pm3dof_pin.programs.loops import closure_residual, swing
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Vector
from pm3dof_pin.viewer.lacks import reason_without_commands

_logger = logging.getLogger(__name__)

_MAX_OPERATIONS = 12_000  # of a program with errors; a longer one would dominate the page


@dataclasses.dataclass(frozen=True, eq=False)
class PageProgram:
    """A program with parameter values."""

    program: Program
    parameters: Vector

    def __call__(self, q: Vector) -> Vector:
        """Return the outputs at one configuration, as computed by the page."""
        outputs: Vector = self.program.evaluate(q[None], self.parameters)[0]
        return outputs


def placing_sets(robot: Robot) -> dict[str, tuple[Coordinate, ...]]:
    """Return what places a robot in a page: its coordinates, and its commands if these are others and can."""
    sets = {"coordinates": robot.coordinates}
    if robot.commands and robot.command_coordinates != robot.coordinates and not reason_without_commands(robot):
        sets["commands"] = robot.command_coordinates
    return sets


class PagePrograms:
    """Everything that a page computes for a robot closed at home; None where there is no program, or no answer.

    - `place(q)`: placements of all joints, rotation and translation row by row, shape=(joints, 3, 4); of the tool; the
      greatest closure error; squared sine, and cosine, of each swing angle with a limit.
    - `walk_coordinates`, `walk_commands`: walks to values of these, see
      :func:`~pm3dof_pin.programs.javascript.javascript`.
    - `compliance(q)`: C at the tool, and 1 if nothing is in doubt, else 0.
    - `holding(q)`: actuator forces that hold the weight, and the least pivot, small near singular poses.
    - `motion(q)`: twists of the tool [v; omega] for one unit of each error, shape=(6, errors), then of each command,
      shape=(6, commands), and 1 if nothing is in doubt, else 0.
    - `sigmas`: standard deviation of each error of `motion` [m, rad].

    Raises:
        ProgramError: there is no program for the robot, or it disagrees with Pinocchio.
    """

    def __init__(self, robot: Robot, model: ElasticModel | None = None) -> None:
        self.robot = robot
        self._model = ElasticModel(robot) if model is None and robot.springs else model
        self._samples = program_source(robot).samples
        self.place = self._place()

    @property
    def springs(self) -> tuple[Spring, ...]:
        """The robot's springs."""
        return () if self._model is None else self._model.springs

    @cached_property
    def spring_lengths(self) -> list[dict[str, Any]]:
        """Lengths that must be positive for a compliance: q[index] + at_zero [m]."""
        if self.compliance is None or self._model is None:
            return []
        lengths = [block.length for block in self._model.blocks if block.length is not None]
        return [{"index": self.robot.single_joint(at.joint).q_index, "at_zero": at.at_zero} for at in lengths]

    @cached_property
    def compliance(self) -> PageProgram | None:
        """C at the tool, shape=(6, 6), then 1 if nothing is in doubt, else 0."""
        robot = self.robot
        if self._model is None or robot.tool_frame is None:
            return None
        try:
            found = elastic_program(self._model, robot.tool_frame, "compliance", COMPLIANCE.traced, closed=True)
        except ProgramError as error:
            _logger.info("no compliance in the page: %s", error)
            return None
        return PageProgram(found.compiled.program, found.parameters)

    @cached_property
    def holding(self) -> PageProgram | None:
        """Forces of the actuators, then the least pivot; None also where these do not determine the pose anywhere."""
        if self.robot.drives_are_dependent:
            return None
        try:
            program = holding_program(self.robot, self._samples)
        except ProgramError as error:
            _logger.info("no holding forces in the page: %s", error)
            return None
        numbers = masses.mass_numbers(self.robot.model)
        return PageProgram(program, geometry.values(self.robot, program.parameters, numbers))

    @property
    def motion(self) -> PageProgram | None:
        """Twists of the tool for one unit of each error, then of each drive, then 1 if nothing is in doubt, else 0."""
        return self._motion_and_sigmas[0]

    @property
    def sigmas(self) -> Vector:
        """Standard deviation of each error of `motion`."""
        return self._motion_and_sigmas[1]

    @cached_property
    def _motion_and_sigmas(self) -> tuple[PageProgram | None, Vector]:
        robot = self.robot
        has_motions = robot.tool_frame is not None and not robot.drives_are_dependent
        for errors in self._error_parameters() if has_motions else ():
            try:
                program, parameters = at_zero_errors(errors)
            except ProgramError as error:
                _logger.info("no motions of the tool by %d errors in the page: %s", len(errors), error)
                continue
            if not len(errors) or len(program) <= _MAX_OPERATIONS:
                return PageProgram(dataclasses.replace(program, name="motion"), parameters), errors.tolerances
        return None, np.empty(0)

    def _error_parameters(self) -> Iterator[GeometricErrors]:
        """Yield the errors declared by the robot's error file, if there is one; then no errors."""
        with contextlib.suppress(DescriptionError):
            yield declared_errors(self.robot)
        yield GeometricErrors(self.robot, [])

    def _walk(self, name: str, coordinates: Sequence[Coordinate]) -> str:
        """Return the walk to values of coordinates as JavaScript; joints come before components of the tool."""
        joints = tuple(coordinate.joint for coordinate in coordinates if coordinate.joint is not None)
        tool = tuple(coordinate.tool for coordinate in coordinates if coordinate.tool is not None)
        walk, parameters = program_source(self.robot).printable_walk(self.robot, Task(joints, tool))
        return javascript(walk.renamed(name), parameters)

    @cached_property
    def source(self) -> str:
        """All programs as JavaScript: an object `programs` of functions."""
        walks = {f"walk_{name}": coordinates for name, coordinates in placing_sets(self.robot).items()}
        entries = {"place": self.place, "holding": self.holding, "motion": self.motion}
        printed = {name: entry for name, entry in entries.items() if entry is not None}
        functions = [self._walk(name, coordinates) for name, coordinates in walks.items()]
        functions += [javascript(entry.program, entry.parameters) for entry in printed.values()]
        members = [f"{name}, {name}_step" for name in walks]
        members += [f"{name}, {name}_size: {len(entry.program.results)}" for name, entry in printed.items()]
        if self.compliance is not None:
            # the page varies its springs to compute their shares
            functions.append(javascript(self.compliance.program))
            values = json.dumps(self.compliance.parameters.tolist())
            members.append(f"compliance, compliance_size: {len(self.compliance.program.results)}, springs: {values}")
        return "\n".join([*functions, f"const programs = {{ {', '.join(members)} }};"])

    def spring_places(self, names: Iterable[str]) -> list[int]:
        """Return the indices of springs' numbers among the parameters of `compliance`."""
        assert self.compliance is not None
        starts = tuple(f"spring/{spring}/U" for spring in names)
        return [k for k, name in enumerate(self.compliance.program.parameters) if name.startswith(starts)]

    def _place(self) -> PageProgram:
        robot = self.robot
        graph = Graph()
        tree = Tree(graph, robot, self._samples)
        placements = [tree.body(joint) for joint in range(robot.model.njoints)]
        if robot.tool_frame is not None:
            placements.append(tree.frame(robot.tool_frame))
        rows = [[[*p.rotation[i], p.translation[i]] for i in range(3)] for p in placements]
        swings = [swing(tree, k) for k, loop in enumerate(robot.closures) if loop.swing_limit is not None]
        outputs: dict[str, Any] = {"placements": rows, "residual": closure_residual(tree), "swings": swings}
        program = graph.program("place", outputs)
        return PageProgram(program, geometry.values(robot, program.parameters))


def declared_errors(robot: Robot) -> GeometricErrors:
    """Return the errors of the robot's error file that leave its loops closable; DescriptionError without a file."""
    if robot.files is None:
        raise DescriptionError(robot.source, "error file", "the robot was not read from a file")
    file = robot.files.errors
    if not file.is_file():
        raise DescriptionError(file, "file", "is missing, expected the tolerances of the robot's parts")
    return closable(GeometricErrors.from_file(robot, file), robot.at([robot.home.q]))


@lru_cache(maxsize=8)
def programs_of(robot: Robot, model: ElasticModel | None = None) -> PagePrograms | None:
    """Return the programs of a robot, traced once; None, with a warning, if there are none."""
    try:
        programs = PagePrograms(robot, model)
        _ = programs.source
    except ProgramError as error:
        _logger.warning("no sliders for %s: %s", robot.name, error)
        return None
    return programs
