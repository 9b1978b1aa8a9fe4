"""Mobility: how many degrees of freedom there are, how many the tool has, and which leave everything at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.arrays import frozen
from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, RankDecision
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix

_NEIGHBOUR_TRIALS = 5
_DISTANCE = 0.1  # of the first of them [rad, characteristic lengths]


@dataclass(frozen=True, eq=False)
class Mobility:
    """The degrees of freedom that a mechanism has at one instant.

    At a singular configuration they are not what they are everywhere else: compare with :func:`generic_configuration`.
    """

    count: int  #: number of degrees of freedom, nv - rank G
    tool_mobility: int  #: number of independent twists of the tool
    redundant_constraints: int  #: number of rows of G that follow from the others
    #: basis of the degrees of freedom that leave actuated joints and tool at rest, such as that of a link which spins
    #: about its own axis, shape=(nv, k)
    idle_motions: Matrix
    constraint_rank: RankDecision  #: the decision on G
    actuator_rank: RankDecision  #: the decision on the actuated joints' rates over the dof
    tool_rank: RankDecision  #: the decision on the tool's twists over the dof
    idle_rank: RankDecision  #: the decision on both together


def instantaneous_mobility(configuration: Configuration) -> Mobility:
    """Count the degrees of freedom of an assembled configuration.

    Example:
        >>> import pm3dof_pin as pm
        >>> mobility = pm.instantaneous_mobility(pm.load("three_rps").home)
        >>> mobility.count, mobility.redundant_constraints
        (3, 15)

    Raises:
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
    """
    dof = DegreesOfFreedom(configuration)
    return Mobility(
        count=dof.count,
        tool_mobility=dof.at_tool.rank.rank,
        redundant_constraints=len(configuration.closure_error) - dof.constraint_rank.rank,
        idle_motions=frozen(dof.scale[:, None] * dof.idle.motions),
        constraint_rank=dof.constraint_rank,
        actuator_rank=dof.at_actuators.rank,
        tool_rank=dof.at_tool.rank,
        idle_rank=dof.idle.rank,
    )


def generic_configuration(configuration: Configuration, *, seed: int = 0) -> Configuration:
    """Find an assembled configuration near by at which, with probability one, nothing is singular.

    Every joint is moved at random by at most a tenth of a radian or characteristic length, and the loops are closed
    again. Joint limits are not checked.

    Raises:
        ConvergenceError: the loops did not close anywhere near.
    """
    mechanism, generator, distance = configuration.mechanism, np.random.default_rng(seed), _DISTANCE
    for _ in range(_NEIGHBOUR_TRIALS):
        motion = mechanism.velocity_scale * generator.uniform(-distance, distance, mechanism.model.nv)
        result = assemble(mechanism, pin.integrate(mechanism.model, configuration.q, motion))
        if result.converged:
            return result.configuration
        distance /= 2.0
    raise ConvergenceError("closing the loops near a configuration", result.residual, "m or rad", result.steps)
