"""Sensitivities of the tool to errors and commands, as a compiled program."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.programs import cache, geometry
from pm3dof_pin.programs.elimination import Doubt
from pm3dof_pin.programs.graph import Graph, select
from pm3dof_pin.programs.joints import Placement, Screw
from pm3dof_pin.programs.llvm import Compiled
from pm3dof_pin.programs.program import Program
from pm3dof_pin.programs.tool_motion import Column, joint_columns, response
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
    compiled = cache.known(key, lambda: _traced(robot, errors, local_twists, _apart, at_zero=at_zero))
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
    twists = errors.local_twists(errors.zeros)
    program = _traced(errors.robot, errors, twists, _apart, at_zero=True)
    return program, _parameters(errors.robot, program, twists)


def reduced(
    name: str, errors: GeometricErrors, reduce: Callable[[Motions], Outputs], numbers: Mapping[str, float]
) -> tuple[Compiled, Vector]:
    """Return a program of a robot as described that reduces the tool's motions, and its parameter values.

    `reduce` maps motions to groups of outputs, followed by `sound`, 1 where nothing is in doubt; `name` is the name of
    the reduction, and `numbers` are the values of the parameters that it adds.

    Raises:
        ProgramError: see :func:`evaluated`.
    """
    robot, twists = errors.robot, errors.local_twists(errors.zeros)
    compiled = cache.known(
        _key(name, robot, errors, at_zero=True), lambda: _traced(robot, errors, twists, reduce, at_zero=True, name=name)
    )
    return compiled, _parameters(robot, compiled.program, twists, numbers)


def _apart(motions: Motions) -> Outputs:
    return {"errors": motions.errors, "drives": motions.drives}


def _traced(
    robot: Robot,
    errors: GeometricErrors,
    local_twists: Matrix,
    reduce: Callable[[Motions], Outputs],
    *,
    at_zero: bool,
    name: str = "sensitivities",
) -> Program:
    poses = samples_near_home(robot)
    verify(robot, poses)
    places = [parameter.place for parameter in errors.parameters]
    graph, tool = Graph(), robot.frame_name()
    tree = Tree(graph, robot, poses, [place for place in places if not robot.model.existJointName(place)])
    driven = robot.actuated_indices
    passive = joint_columns(tree, np.setdiff1d(np.arange(robot.model.nv), driven), tool)
    sources = [
        _error_column(tree, place, k, twist, _moved_frames(errors, place), at_zero=at_zero)
        for k, (place, twist) in enumerate(zip(places, local_twists.T, strict=True))
    ]
    doubt = Doubt()
    motions = response(tree, tool, passive, [*sources, *joint_columns(tree, driven, tool)], doubt)
    outputs = reduce(Motions(graph, motions[:, : len(sources)], motions[:, len(sources) :], doubt))
    return graph.program(name, {**outputs, "sound": select(doubt.is_none(motions), 1.0, 0.0)})


def _error_column(tree: Tree, place: str, number: int, local: Array, moves: frozenset[str], *, at_zero: bool) -> Column:
    """Return the column of an error: a twist of everything beyond its place, in the place's axes."""
    entries: Objects = np.zeros(6, dtype=object)
    rows = range(3) if local[:3].any() else range(3, 6)
    for k in rows:
        entries[k] = float(local[k]) if at_zero else tree.graph.parameter(_name(number, k), float(local[k]))
    frame = _place(tree, place)
    linear, angular = frame.rotation @ entries[:3], frame.rotation @ entries[3:]
    return Column(Screw(angular, linear, frame.translation), moves)


def _place(tree: Tree, place: str) -> Placement:
    """Return the placement of a place, before its joint moves."""
    model = tree.mechanism.model
    if not model.existJointName(place):
        return tree.frame(place)
    fixed = Placement(tree.geometry.rotation(place), tree.geometry.vector(place, "p"))
    return tree.body(model.parents[model.getJointId(place)]) * fixed


def _moved_frames(errors: GeometricErrors, place: str) -> frozenset[str]:
    """Return the frames of closures and tool that move with a place."""
    robot, (joints, frames) = errors.robot, errors.moved[place]
    ids = {name: robot.frame_id(name) for name in geometry.frame_names(robot)}
    return frozenset(
        name for name, index in ids.items() if index in frames or robot.model.frames[index].parentJoint in joints
    )


def _name(number: int, entry: int) -> str:
    return f"error/{number}/{entry}"


def _parameters(
    robot: Robot, program: Program, local_twists: Matrix, numbers: Mapping[str, float] | None = None
) -> Array:
    twists = {_name(k, i): float(twist) for (i, k), twist in np.ndenumerate(local_twists)}
    return geometry.values(robot, program.parameters, twists | dict(numbers or {}))


def _key(name: str, robot: Robot, errors: GeometricErrors, at_zero: bool) -> str:
    parameters = [(p.place, p.motion, p.axis if at_zero else None) for p in errors.parameters]
    places = sorted({p.place for p in errors.parameters if not robot.model.existJointName(p.place)})
    return repr(
        (
            *(name, at_zero, parameters, robot.actuated_indices.tolist()),
            robot.length_unit,
            *(geometry.structure(robot), geometry.pattern(robot, places)),
        )
    )
