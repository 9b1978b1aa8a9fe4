"""Singular configurations, their types, and the distance from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pm3dof_pin.arrays import frozen
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom, Restriction
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.singular_values import svd
from pm3dof_pin.typing import Matrix, Vector

SingularityType = Literal["constraint", "parallel", "serial", "passive"]


@dataclass(frozen=True, eq=False)
class Singularity:
    """One way in which a configuration is singular."""

    # "constraint": the loop closures lose rank and the mechanism gains degrees of freedom. "parallel": the tool can
    # move with the actuated joints at rest. "serial": actuated joints can move with the tool at rest, and it loses a
    # degree of freedom. "passive": passive joints can move with both at rest
    type: SingularityType
    measure: float  #: smallest scaled singular value of the matrix that loses rank
    motions: Matrix  #: these motions as velocities, shape=(nv, k), each of length 1 in scaled numbers
    twists: Matrix  #: twists [v; omega] of the tool in these motions, world axes, shape=(6, k)


@dataclass(frozen=True, eq=False)
class SingularityDistance:
    """How far a configuration is from one type of singularity."""

    type: SingularityType  # as in :class:`Singularity`
    measure: float  #: the singular value that becomes zero there, in scaled numbers
    #: the motion nearest to being lost or gained, as velocities, shape=(nv,), of length 1 in scaled numbers
    motion: Vector
    twist: Vector  #: twist [v; omega] of the tool in this motion, world axes, shape=(6,)


def singularities(configuration: Configuration, *, generic: Mobility | None = None) -> tuple[Singularity, ...]:
    """Return the singularities of a configuration; none if it is regular.

    Ranks are compared with those at a nearby generic configuration, so that redundant constraints, redundant drives
    and idle degrees of freedom that a mechanism always has are not singularities. "serial" and "parallel" are
    those of C. Gosselin and J. Angeles, IEEE Trans. Robotics and Automation 6 (1990), "constraint" that of D. Zlatanov,
    I. Bonev and C. Gosselin, ICRA 2002, and "passive" the redundant passive motion of D. Zlatanov, R. Fenton and B.
    Benhabib (1995).

    If c degrees of freedom are gained at a constraint singularity, the actuated joints are too few to hold all
    motions. This consequence is not reported again as "parallel".

    The tool's motion is given by the robot's `tool_motions`: for a point tool its translations, so that it does not
    matter which of the bodies that meet at the point carries the tool frame.

    Example:
        A hexapod is singular if its platform is turned by 90 degrees about its axis:

        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> hexapod = pm.load("hexapod")
        >>> turned = hexapod.solve([0.0, 0.0, 0.135, 0.0, 0.0, np.pi / 2]).configuration()
        >>> [singularity.type for singularity in pm.singularities(turned)]
        ['parallel']

    Args:
        configuration: an assembled configuration.
        generic: mobility at a generic configuration of the same assembly mode, to save time when many configurations
            are checked; by default that at :func:`generic_configuration`.

    Raises:
        DescriptionError: the mechanism has no tool frame.
        InvalidValueError: the loops are not closed.
        ConvergenceError: no generic configuration was found nearby.
    """
    dof = DegreesOfFreedom(configuration)
    bases: dict[SingularityType, Matrix] = {
        "constraint": _by_movement(dof.basis, dof.actuators)[:, ::-1],
        "parallel": _by_movement(dof.at_actuators.motions, dof.tool),
        "serial": _by_movement(dof.at_tool.motions, dof.actuators),
        "passive": dof.idle.motions,
    }
    return tuple(
        _singularity(dof, loss.type, loss.measure, bases[loss.type][:, : loss.lost])
        for loss in _rank_losses(dof, _usual(configuration, generic))
        if loss.lost > 0
    )


def singularity_distances(
    configuration: Configuration, *, generic: Mobility | None = None
) -> tuple[SingularityDistance, ...]:
    """Measure how far a configuration is from each type of singularity.

    The measure is the least singular value, among as many as the generic rank, of the matrix that loses rank there: of
    the closures, the actuated joints' rates, the tool's motions, or the latter two together, over the degrees of
    freedom. It is zero at the singularity, and practically linear in the distance near it. Lengths are divided by the
    characteristic length. Arguments and errors as in :func:`singularities`.

    Returns:
        One for each type that the mechanism can have: without closures there is no constraint singularity.
    """
    dof = DegreesOfFreedom(configuration)
    found = []
    for loss in _rank_losses(dof, _usual(configuration, generic)):
        if loss.rank > 0:
            motion = loss.restriction.directions[:, min(loss.rank, loss.restriction.directions.shape[1]) - 1]
            twist = dof.twist_scale * (dof.twist @ motion)
            found.append(SingularityDistance(loss.type, loss.measure, frozen(dof.scale * motion), frozen(twist)))
    return tuple(found)


@dataclass(frozen=True, eq=False)
class _RankLoss:
    """A matrix over the degrees of freedom: its usual rank, and how much of it is lost."""

    type: SingularityType
    restriction: Restriction
    rank: int
    lost: int

    @property
    def measure(self) -> float:
        return self.restriction.rank.least(self.rank)


def _usual(configuration: Configuration, generic: Mobility | None) -> Mobility:
    return generic or instantaneous_mobility(generic_configuration(configuration))


def _rank_losses(dof: DegreesOfFreedom, usual: Mobility) -> tuple[_RankLoss, ...]:
    gained = dof.count - usual.count
    actuator_rank = min(usual.actuator_rank.rank + gained, len(dof.actuators))
    tool_rank = min(usual.tool_rank.rank + gained, len(dof.tool))
    idle_rank = usual.idle_rank.rank + gained
    passive = idle_rank - dof.idle.rank.rank
    return (
        _RankLoss("constraint", dof.closures, usual.constraint_rank.rank, gained),
        _RankLoss("parallel", dof.at_actuators, actuator_rank, actuator_rank - dof.at_actuators.rank.rank - passive),
        _RankLoss("serial", dof.at_tool, tool_rank, tool_rank - dof.at_tool.rank.rank - passive),
        _RankLoss("passive", dof.idle, idle_rank, passive),
    )


def _by_movement(motions: Matrix, rows: Matrix) -> Matrix:
    """Rotate a basis of motions so that its columns have descending effect on the rows."""
    turned: Matrix = motions @ svd(rows @ motions)[2].T
    return turned


def _singularity(dof: DegreesOfFreedom, kind: SingularityType, measure: float, motions: Matrix) -> Singularity:
    twists = dof.twist_scale[:, None] * (dof.twist @ motions)
    return Singularity(kind, measure, frozen(dof.scale[:, None] * motions), frozen(twists))
