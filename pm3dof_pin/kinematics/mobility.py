"""Mobility: the degrees of freedom of the mechanism and of the tool, and idle ones."""

from __future__ import annotations

import random
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
_DISTANCE = 0.1  # largest for the first attempt [rad, characteristic lengths]


@dataclass(frozen=True, eq=False)
class Mobility:
    """The instantaneous degrees of freedom of a mechanism.

    At a singular configuration they differ from the usual ones: compare with :func:`generic_configuration`.
    """

    count: int  #: number of degrees of freedom, nv - rank G
    tool_mobility: int  #: number of independent twists of the tool; 0 without a tool frame
    redundant_constraints: int  #: number of dependent rows of G
    #: basis of the degrees of freedom that leave actuated joints and tool at rest, such as the spin of a link about its
    #: own axis, shape=(nv, k); without a tool frame, those that leave the actuated joints at rest
    idle_motions: Matrix
    constraint_rank: RankDecision  #: the rank decision on G
    actuator_rank: RankDecision  #: the rank decision on the actuated joints' rates
    tool_rank: RankDecision  #: the rank decision on the tool's twists
    idle_rank: RankDecision  #: the rank decision on both together


def instantaneous_mobility(configuration: Configuration) -> Mobility:
    """Count the degrees of freedom of an assembled configuration.

    Without a tool frame, the mechanism's own are counted alone, and no twists of a tool.

    Example:
        >>> import pm3dof_pin as pm
        >>> mobility = pm.instantaneous_mobility(pm.load("three_rps").home)
        >>> mobility.count, mobility.redundant_constraints
        (3, 15)

    Raises:
        InvalidValueError: the loops are not closed.
    """
    dof = DegreesOfFreedom(configuration)
    has_tool = configuration.mechanism.tool_frame is not None
    at_tool = dof.at_tool if has_tool else dof.over(np.zeros((0, len(dof.scale))))
    idle = dof.idle if has_tool else dof.at_actuators
    return Mobility(
        count=dof.count,
        tool_mobility=at_tool.rank.rank,
        redundant_constraints=len(configuration.closure_error) - dof.constraint_rank.rank,
        idle_motions=frozen(dof.scale[:, None] * idle.motions),
        constraint_rank=dof.constraint_rank,
        actuator_rank=dof.at_actuators.rank,
        tool_rank=at_tool.rank,
        idle_rank=idle.rank,
    )


def generic_configuration(configuration: Configuration, *, seed: int = 0) -> Configuration:
    """Find a nearby assembled configuration that is nonsingular with probability one.

    Every joint is moved randomly by at most a tenth of a radian or characteristic length, and the loops are closed
    again. Joint limits are not checked.

    Raises:
        ConvergenceError: no closed configuration was found nearby.
    """
    mechanism, generator, distance = configuration.mechanism, random.Random(seed), _DISTANCE
    for _ in range(_NEIGHBOUR_TRIALS):
        steps = [generator.uniform(-distance, distance) for _ in range(mechanism.model.nv)]
        motion = mechanism.velocity_scale * steps
        result = assemble(mechanism, pin.integrate(mechanism.model, configuration.q, motion))
        if result.converged:
            return result.configuration
        distance /= 2.0
    raise ConvergenceError("closing the loops near a configuration", result.residual, "m or rad", result.steps)
