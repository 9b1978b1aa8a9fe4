"""Mobility: how many freedoms a configuration has, what the tool has of them, and which leave everything at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.freedoms import RANK_TOLERANCE, Freedoms, RankDecision
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix

_NEIGHBOUR_TRIALS = 5


@dataclass(frozen=True, eq=False)
class Mobility:
    """The freedoms that a mechanism has at one instant.

    At a singular configuration they are not what they are everywhere else: compare with :func:`generic_configuration`.

    Attributes:
        count: number of freedoms, nv - rank G.
        tool_mobility: number of independent twists of the tool.
        redundant_constraints: number of rows of G that follow from the others.
        idle_freedoms: basis of the freedoms that leave actuated joints and tool at rest, such as that of a link which
            spins about its own axis, shape=(nv, k).
        constraint_rank: the decision on G.
        actuator_rank: the decision on the actuated joints' rates over the freedoms.
        tool_rank: the decision on the tool's twists over the freedoms.
        idle_rank: the decision on both together.
    """

    count: int
    tool_mobility: int
    redundant_constraints: int
    idle_freedoms: Matrix
    constraint_rank: RankDecision
    actuator_rank: RankDecision
    tool_rank: RankDecision
    idle_rank: RankDecision


def instantaneous_mobility(configuration: Configuration, *, tolerance: float = RANK_TOLERANCE) -> Mobility:
    """Count the freedoms of a configuration.

    Args:
        configuration: an assembled configuration.
        tolerance: singular values below this times their reference count as zero.

    Raises:
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    freedoms = Freedoms(configuration, tolerance)
    return Mobility(
        count=freedoms.count,
        tool_mobility=freedoms.held.rank.rank,
        redundant_constraints=len(configuration.closure_error) - freedoms.constraint_rank.rank,
        idle_freedoms=frozen(freedoms.scale[:, None] * freedoms.idle.motions),
        constraint_rank=freedoms.constraint_rank,
        actuator_rank=freedoms.locked.rank,
        tool_rank=freedoms.held.rank,
        idle_rank=freedoms.idle.rank,
    )


def generic_configuration(configuration: Configuration, *, distance: float = 0.1, seed: int = 0) -> Configuration:
    """Find an assembled configuration near by at which, with probability one, nothing is singular.

    Every joint is moved at random and the loops are closed again. Joint limits are not looked at.

    Args:
        configuration: where to start.
        distance: how far each joint is moved at most [rad, characteristic lengths]; less where the loops do not close.
        seed: seed of the random motion.

    Raises:
        ConvergenceError: the loops did not close anywhere near.
    """
    mechanism, generator = configuration.mechanism, np.random.default_rng(seed)
    for _ in range(_NEIGHBOUR_TRIALS):
        motion = mechanism.velocity_scale * generator.uniform(-distance, distance, mechanism.model.nv)
        result = assemble(mechanism, pin.integrate(mechanism.model, configuration.q, motion))
        if result.converged:
            return result.configuration
        distance /= 2.0
    raise ConvergenceError("closing the loops near a configuration", result.residual, "m or rad", result.steps)
