"""Singular configurations and their names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.kinematics.freedoms import RANK_TOLERANCE, Freedoms
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix

SingularityType = Literal["constraint", "parallel", "serial", "passive"]


@dataclass(frozen=True, eq=False)
class Singularity:
    """One way in which a configuration is singular.

    Attributes:
        type: "constraint": the loop closures lose rank and the mechanism gains freedoms. "parallel": the tool can move
            with the actuated joints at rest. "serial": actuated joints can move with the tool at rest, and it loses a
            freedom. "passive": passive joints can move with both at rest.
        measure: smallest scaled singular value of the matrix that loses rank.
        motions: these motions as velocities, shape=(nv, k), each of length 1 in scaled numbers.
        twists: twists [v; omega] of the tool in these motions, world axes, shape=(6, k).
    """

    type: SingularityType
    measure: float
    motions: Matrix
    twists: Matrix


def singularities(
    configuration: Configuration, *, generic: Mobility | None = None, tolerance: float = RANK_TOLERANCE
) -> tuple[Singularity, ...]:
    """Name the singularities of a configuration; none if it is regular.

    What is exceptional is judged against a generic configuration near by, so that redundant constraints, redundant
    drives and idle freedoms that a mechanism always has are no singularities. "serial" and "parallel" are those of
    C. Gosselin and J. Angeles, IEEE Trans. Robotics and Automation 6 (1990), "constraint" that of D. Zlatanov,
    I. Bonev and C. Gosselin, ICRA 2002, and "passive" the redundant passive motion of D. Zlatanov, R. Fenton and
    B. Benhabib (1995).

    Where c freedoms are gained at a constraint singularity, actuated joints at rest leave motions free for lack of
    number. This consequence is not reported once more as "parallel".

    Args:
        configuration: an assembled configuration.
        generic: mobility at a generic configuration of the same assembly mode, worth giving when many configurations
            are judged; by default that at :func:`generic_configuration`.
        tolerance: singular values below this times their reference count as zero.

    Raises:
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
        ConvergenceError: no generic configuration was found near by.
    """
    usual = generic or instantaneous_mobility(generic_configuration(configuration), tolerance=tolerance)
    here = Freedoms(configuration, tolerance)
    gained = here.count - usual.count
    locked_rank = min(usual.actuator_rank.rank + gained, len(here.actuators))
    held_rank, idle_rank = usual.tool_rank.rank + gained, usual.idle_rank.rank + gained
    passive = idle_rank - here.idle.rank.rank
    candidates: tuple[tuple[SingularityType, int, float, Matrix], ...] = (
        (
            "constraint",
            gained,
            here.constraint_rank.least(usual.constraint_rank.rank),
            _by_movement(here.basis, here.actuators)[:, ::-1],
        ),
        (
            "parallel",
            locked_rank - here.locked.rank.rank - passive,
            here.locked.rank.least(locked_rank),
            _by_movement(here.locked.motions, here.tool),
        ),
        (
            "serial",
            held_rank - here.held.rank.rank - passive,
            here.held.rank.least(held_rank),
            _by_movement(here.held.motions, here.actuators),
        ),
        ("passive", passive, here.idle.rank.least(idle_rank), here.idle.motions),
    )
    return tuple(
        _singularity(here, kind, measure, motions[:, :count])
        for kind, count, measure, motions in candidates
        if count > 0
    )


def _by_movement(motions: Matrix, rows: Matrix) -> Matrix:
    """Turn a basis of motions so that its columns move the rows less and less."""
    turned: Matrix = motions @ np.linalg.svd(rows @ motions)[2].T
    return turned


def _singularity(here: Freedoms, kind: SingularityType, measure: float, motions: Matrix) -> Singularity:
    twists = here.twist_scale[:, None] * (here.tool @ motions)
    return Singularity(kind, measure, frozen(here.scale[:, None] * motions), frozen(twists))
