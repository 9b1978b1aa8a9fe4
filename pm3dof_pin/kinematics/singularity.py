"""Singular configurations and their names."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE, DegreesOfFreedom
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix

SingularityType = Literal["constraint", "parallel", "serial", "passive"]


@dataclass(frozen=True, eq=False)
class Singularity:
    """One way in which a configuration is singular.

    Attributes:
        type: "constraint": the loop closures lose rank and the mechanism gains degrees of freedom. "parallel": the tool
            can move with the actuated joints at rest. "serial": actuated joints can move with the tool at rest, and it
            loses a degree of freedom. "passive": passive joints can move with both at rest.
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
    drives and idle degrees of freedom that a mechanism always has are no singularities. "serial" and "parallel" are
    those of C. Gosselin and J. Angeles, IEEE Trans. Robotics and Automation 6 (1990), "constraint" that of D. Zlatanov,
    I. Bonev and C. Gosselin, ICRA 2002, and "passive" the redundant passive motion of D. Zlatanov, R. Fenton and B.
    Benhabib (1995).

    Where c degrees of freedom are gained at a constraint singularity, actuated joints at rest leave motions free for
    lack of number. This consequence is not reported once more as "parallel".

    Example:
        A hexapod is singular where its platform is turned by 90 degrees about its axis:

        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> hexapod = pm.load("hexapod")
        >>> turned = hexapod.solve([0.0, 0.0, 0.135, 0.0, 0.0, np.pi / 2]).configuration()
        >>> [singularity.type for singularity in pm.singularities(turned)]
        ['parallel']

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
    dof = DegreesOfFreedom(configuration, tolerance)
    gained = dof.count - usual.count
    actuator_rank = min(usual.actuator_rank.rank + gained, len(dof.actuators))
    tool_rank, idle_rank = usual.tool_rank.rank + gained, usual.idle_rank.rank + gained
    passive = idle_rank - dof.idle.rank.rank
    candidates: tuple[tuple[SingularityType, int, float, Matrix], ...] = (
        (
            "constraint",
            gained,
            dof.constraint_rank.least(usual.constraint_rank.rank),
            _by_movement(dof.basis, dof.actuators)[:, ::-1],
        ),
        (
            "parallel",
            actuator_rank - dof.at_actuators.rank.rank - passive,
            dof.at_actuators.rank.least(actuator_rank),
            _by_movement(dof.at_actuators.motions, dof.tool),
        ),
        (
            "serial",
            tool_rank - dof.at_tool.rank.rank - passive,
            dof.at_tool.rank.least(tool_rank),
            _by_movement(dof.at_tool.motions, dof.actuators),
        ),
        ("passive", passive, dof.idle.rank.least(idle_rank), dof.idle.motions),
    )
    return tuple(
        _singularity(dof, kind, measure, motions[:, :count])
        for kind, count, measure, motions in candidates
        if count > 0
    )


def _by_movement(motions: Matrix, rows: Matrix) -> Matrix:
    """Turn a basis of motions so that its columns move the rows less and less."""
    turned: Matrix = motions @ np.linalg.svd(rows @ motions)[2].T
    return turned


def _singularity(dof: DegreesOfFreedom, kind: SingularityType, measure: float, motions: Matrix) -> Singularity:
    twists = dof.twist_scale[:, None] * (dof.tool @ motions)
    return Singularity(kind, measure, frozen(dof.scale[:, None] * motions), frozen(twists))
