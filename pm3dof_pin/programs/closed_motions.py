"""Joint motions that keep the loops closed, for given driven joints, on recorded numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from pm3dof_pin.programs.elimination import (
    Doubt,
    Elimination,
    eliminate,
    identity,
    rank,
    solve_upper,
    without_zeros,
    zeros,
)
from pm3dof_pin.programs.graph import is_zero
from pm3dof_pin.programs.motion_equations import joint_columns, motion_equations
from pm3dof_pin.programs.tree import Tree
from pm3dof_pin.typing import Objects

_OF_CHAIN = 2
"""How many loops share a joint between two loops of a chain; a platform's joints are shared by more."""


@dataclass(frozen=True, eq=False)
class ClosedMotions:
    """Velocities that keep the loops closed; those of prismatic joints are in units of length."""

    #: velocities of all joints at unit rate of each driven one, if the rates satisfy the relations, shape=(nv, k)
    rates: Objects
    idle: Objects  #: basis of the motions with all driven joints at rest, shape=(nv, u)
    relations: Objects  #: independent equations that the rates of the driven joints satisfy, shape=(r, k)


def closed_motions(
    tree: Tree, driven: Sequence[int], passive: Sequence[int], unit: float, doubt: Doubt
) -> ClosedMotions:
    """Record the motions of a mechanism, by a unit of length [m]; joints neither driven nor passive are locked."""
    equations = motion_equations(tree, unit, joint_columns(tree, passive), joint_columns(tree, driven))
    count = equations.unknown
    result = eliminate(equations.rates, range(count), doubt)
    sources = range(count, count + len(driven))
    motions = _motions(
        result,
        [*result.dropped, *sources],
        dict(zip(sources, driven, strict=True)) | dict(enumerate(passive)),
        len(tree.screws),
    )
    relations = without_zeros(result.rest[:, count:], doubt)
    relations = relations[[not all(map(is_zero, row)) for row in relations]]
    if rank(relations) < len(relations):
        relations = eliminate(relations, range(len(driven)), doubt).pivot_rows
    idle = len(result.dropped)
    return ClosedMotions(motions[:, idle:], motions[:, :idle], relations)


def all_motions(tree: Tree, order: Sequence[int], unit: float, doubt: Doubt) -> Objects:
    """Record a basis of the motions that keep the loops closed, by a unit of length [m], shape=(nv, mobility).

    Joints follow whichever others their own loops leave free, so that a platform on many legs takes operations in
    proportion to these. What more loops share follows later: legs follow their platform, which some of their joints
    would place badly at many poses. `order` are the joints' entries of v; of equally sparse ones, the last follow
    first.
    """
    equations = motion_equations(tree, unit, joint_columns(tree, order))
    turns = [
        max(_OF_CHAIN, len({block.closure for block in equations.blocks if not all(map(is_zero, column[block.rows]))}))
        for column in equations.rates.T[: equations.unknown]
    ]
    result = eliminate(equations.rates, range(equations.unknown), doubt, turns=turns)
    return _motions(result, result.dropped, dict(enumerate(order)), len(tree.screws))


def _motions(result: Elimination, given: Sequence[int], joints: Mapping[int, int], count: int) -> Objects:
    """Return the motions of all joints at unit rate of each of some columns, shape=(count, number of these).

    `joints` are the entries of v by column; other columns are rates of free motions.
    """
    followed = solve_upper(result.pivot_rows[:, list(result.columns)], -result.pivot_rows[:, list(given)])
    motions = zeros(count, len(given))
    for column, rates in [*zip(result.columns, followed, strict=True), *zip(given, identity(len(given)), strict=True)]:
        if column in joints:
            motions[joints[column]] = rates
    return motions
