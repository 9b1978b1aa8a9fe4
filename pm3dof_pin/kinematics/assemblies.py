"""The assemblies of a robot near its described home, one on each branch, from which a home can be chosen."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from pm3dof_pin.exceptions import PM3DofError
from pm3dof_pin.kinematics.assembly import assemble
from pm3dof_pin.kinematics.branches import Branches, not_closed
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Vector

_DISTANCES = (0.1, 0.3, 1.0, 2.0)  # of random starts from home [rad, characteristic lengths]
_STARTS = 24  # at each distance
_MAX_TRIED = 8  # candidates of a branch, until one is regular


@dataclass(frozen=True, eq=False)
class AssembledHome:
    """A closed, regular configuration on one branch."""

    configuration: Configuration  #: the configuration
    distance: float  #: largest motion of a joint from the described home [rad, characteristic lengths]
    within_limits: bool  #: whether it breaks no limits


def assembled_homes(robot: PlacedMechanism) -> list[AssembledHome]:
    """Find closed regular configurations near the described home, the nearest on each branch found, nearest first.

    Random starts up to 2 rad or characteristic lengths away are closed by the damped solver; those within all limits
    are preferred. There may be further branches, farther away. Deterministic.

    Raises:
        ConvergenceError: no closed regular configuration was found.
    """
    described, generator, model = robot.described_home, np.random.default_rng(0), robot.model
    found: list[AssembledHome] = []
    result = assemble(robot, described)
    for distance in _DISTANCES:
        for _ in range(_STARTS):
            motion = robot.velocity_scale * generator.uniform(-distance, distance, model.nv)
            result = assemble(robot, pin.integrate(model, described.q, motion))
            if result.converged:
                found.append(_candidate(robot, described, result.configuration))
    found.sort(key=lambda home: (not home.within_limits, home.distance))
    branches: Branches | None = None
    chosen: dict[int, AssembledHome] = {}
    tried: dict[int, int] = {}
    for home in found:
        number = 0 if branches is None else branches.number(home.configuration.q)
        if number in chosen or tried.get(number, 0) == _MAX_TRIED:
            continue
        with suppress(PM3DofError):
            around = Branches(robot, home.configuration)
            if around.start_is_home:
                branches = branches or around
                chosen[number] = home
        if branches is not None:
            tried[number] = tried.get(number, 0) + 1
    if not chosen:
        raise not_closed(robot, result)
    return sorted(chosen.values(), key=lambda home: home.distance)


def _candidate(robot: PlacedMechanism, described: Configuration, configuration: Configuration) -> AssembledHome:
    moves: Vector = pin.difference(robot.model, described.q, configuration.q) / robot.velocity_scale
    distance = float(np.abs(moves).max(initial=0.0))
    return AssembledHome(configuration, distance, not configuration.violated_limits())
