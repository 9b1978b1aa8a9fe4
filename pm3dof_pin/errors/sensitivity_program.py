"""Sensitivities of the tool to errors and commands, as a compiled program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import cache, geometry
from pm3dof_pin.programs.elimination import Doubt, zeros
from pm3dof_pin.programs.graph import Graph, less, select
from pm3dof_pin.programs.joints import Transform, placement_of
from pm3dof_pin.programs.llvm import Compiled
from pm3dof_pin.programs.motion_equations import joint_columns
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tool_motion import Displacement, Lengthening, response_to_displacements
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.programs.verification import verify
from pm3dof_pin.typing import Array, Mask, Matrix, Objects, Vector


@dataclass(frozen=True, eq=False)
class Motions:
    """The tool's twists [v; omega] at its origin, world axes, as recorded numbers."""

    graph: Graph  #: graph that records them
    errors: Objects  #: for one unit of each error, shape=(6, k)
    drives: Objects  #: for one unit of the coordinate of each drive, shape=(6, u)
    doubt: Doubt  #: their assumptions


Outputs = Mapping[str, Objects]


def evaluated(robot: Robot, q: Matrix, errors: GeometricErrors, local_twists: Matrix) -> tuple[Array, Array, Mask]:
    """Evaluate the tool's motion with errors and drives at closed configurations q, shape=(n, nq).

    The robot is as described or displaced; `local_twists` are the twists of each place per unit of its parameters,
    in its axes. Returns the tool's twists for one unit of each error, shape=(n, 6, k), and of each drive's coordinate,
    shape=(n, 6, u); and the poses at which nothing is in doubt, shape=(n,).

    Raises:
        ProgramError: there is no program for this robot, the tool is free, or loops cannot close with an error.
    """
    at_zero = bool(np.isin(local_twists, (0.0, 1.0, -1.0)).all())
    key = _key("sensitivities", robot, errors, at_zero)
    compiled = cache.known(key, lambda: _traced(robot, errors, local_twists, at_zero=at_zero))
    values, sound = compiled.with_doubt(q, _parameters(robot, compiled.program, local_twists))
    places = compiled.program.slices
    by_errors, by_drives = (values[:, places[name]].reshape(len(q), 6, -1) for name in ("errors", "drives"))
    return by_errors, by_drives, sound


def at_zero_errors(errors: GeometricErrors) -> tuple[Program, Vector]:
    """Return the program of a robot as described, for printing in other languages, and its parameter values.

    Its outputs are `errors`, shape=(6, k), `drives`, shape=(6, u), and `sound`, 1 where nothing is in doubt.

    Raises:
        ProgramError: see :func:`evaluated`.
    """
    _require_places(errors)
    robot, twists = errors.robot, errors.local_twists(errors.zeros)
    key = _key("sensitivities", robot, errors, at_zero=True)
    program = cache.known(key, lambda: _traced(robot, errors, twists, at_zero=True)).program
    return program, _parameters(robot, program, twists)


def reduced(
    name: str, errors: GeometricErrors, reduce: Callable[[Motions], Outputs], numbers: Mapping[str, float]
) -> tuple[Compiled, Vector]:
    """Return a program of a robot as described that reduces the tool's motions, and its parameter values.

    `reduce` maps motions to groups of outputs, followed by `sound`, 1 where nothing is in doubt; `name` is the name of
    the reduction, and `numbers` are the values of the parameters that it adds.

    Raises:
        ProgramError: see :func:`evaluated`.
    """
    _require_places(errors)
    robot = errors.robot
    compiled = cache.known(_key(name, robot, errors, at_zero=True), lambda: _reduced(name, errors, reduce))
    return compiled, geometry.values(robot, compiled.program.parameters, numbers)


def _require_places(errors: GeometricErrors) -> None:
    if errors.components is not errors:
        raise ProgramError(f"{errors.robot.name}: no program for tied parameters: they have several places")


def _reduced(name: str, errors: GeometricErrors, reduce: Callable[[Motions], Outputs]) -> Program:
    """Record a reduction of the motions, whose own program is recorded once for all of these."""
    program, parameters = at_zero_errors(errors)
    graph, doubt = Graph(), Doubt()
    found = graph.again(program, samples_near_home(errors.robot), parameters)
    outputs = reduce(Motions(graph, found["errors"], found["drives"], doubt))
    sound = less(0.5, found["sound"].item()) & doubt.is_none(found["sound"])
    return graph.program(name, {**outputs, "sound": select(sound, 1.0, 0.0)})


def _traced(
    robot: Robot,
    errors: GeometricErrors,
    local_twists: Matrix,
    *,
    at_zero: bool,
) -> Program:
    poses = samples_near_home(robot)
    verify(robot, poses)
    places = [parameter.place for parameter in errors.parameters]
    graph, tool = Graph(), robot.frame_name()
    frames = [place for place in places if not (place in errors.robot.rods or robot.model.existJointName(place))]
    tree = Tree(graph, robot, poses, frames, in_working_axes=True)
    driven = robot.actuated_indices
    passive = joint_columns(tree, np.setdiff1d(np.arange(robot.model.nv), driven), tool)
    displaced, order = _displacements(tree, errors, local_twists, at_zero=at_zero)
    doubt = Doubt()
    by_errors, by_drives = response_to_displacements(
        tree,
        tool,
        passive,
        joint_columns(tree, driven, tool),
        displaced,
        doubt,
        shared=len(robot.placing_drives) < len(driven),
    )
    by_errors, by_drives = map(tree.turned_to_world, (by_errors[:, np.argsort(order)], by_drives))
    sound = select(doubt.is_none(np.hstack([by_errors, by_drives])), 1.0, 0.0)
    return graph.program("sensitivities", {"errors": by_errors, "drives": by_drives, "sound": sound})


def _displacements(
    tree: Tree, errors: GeometricErrors, local_twists: Matrix, *, at_zero: bool
) -> tuple[list[Displacement | Lengthening], list[int]]:
    """Return the errors of each place, twists of everything beyond it or lengths of a rod; and their numbers."""
    numbers: dict[str, list[int]] = {}
    for k, parameter in enumerate(errors.parameters):
        numbers.setdefault(parameter.place, []).append(k)
    displaced: list[Displacement | Lengthening] = []
    for place, own in numbers.items():
        if place in errors.robot.rods:
            displaced.append(Lengthening(errors.robot.rods[place], len(own)))
            continue
        local = zeros(6, len(own))
        for column, k in enumerate(own):
            for row in range(3) if local_twists[:3, k].any() else range(3, 6):
                number = float(local_twists[row, k])
                local[row, column] = number if at_zero else tree.graph.parameter(_name(k, row), number)
        displaced.append(Displacement(_place(tree, place), _moved_frames(errors, place), local))
    return displaced, [k for own in numbers.values() for k in own]


def _place(tree: Tree, place: str) -> Transform:
    """Return the placement of a place, before its joint moves."""
    model = tree.mechanism.model
    if not model.existJointName(place):
        return tree.frame(place)
    return tree.body(model.parents[model.getJointId(place)]) * placement_of(tree.geometry, place)


def _moved_frames(errors: GeometricErrors, place: str) -> frozenset[str]:
    """Return the frames of closures and tool that move with a place."""
    robot, (joints, frames) = errors.robot, errors.moved[place]
    ids = {name: robot.frame_id(name) for name in geometry.frame_names(robot)}
    return frozenset(
        name for name, index in ids.items() if index in frames or robot.model.frames[index].parentJoint in joints
    )


def _name(number: int, entry: int) -> str:
    return f"error/{number}/{entry}"


def _parameters(robot: Robot, program: Program, local_twists: Matrix) -> Array:
    twists = {_name(k, i): float(twist) for (i, k), twist in np.ndenumerate(local_twists)}
    return geometry.values(robot, program.parameters, twists)


def _key(name: str, robot: Robot, errors: GeometricErrors, at_zero: bool) -> str:
    parameters = [(p.place, p.motion, p.axis if at_zero else None) for p in errors.parameters]
    places = sorted(
        {p.place for p in errors.parameters if not robot.model.existJointName(p.place)} - errors.robot.rods.keys()
    )
    return repr(
        (
            *(name, at_zero, parameters, robot.actuated_indices.tolist()),
            robot.length_unit,
            *(geometry.structure(robot), geometry.pattern(robot, places)),
        )
    )
