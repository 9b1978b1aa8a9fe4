"""The assemblies of a robot near its described home, one on each branch, from which a home can be chosen."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from pm3dof_pin.exceptions import ConvergenceError, PM3DofError, SingularConfigurationError
from pm3dof_pin.kinematics.assembly import Assembly, assemble
from pm3dof_pin.kinematics.branches import Branches
from pm3dof_pin.kinematics.degrees_of_freedom import DegreesOfFreedom
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.singularity import singularity_distances
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.tolerances import CLOSED
from pm3dof_pin.typing import Vector

_DISTANCES = (0.1, 0.3, 1.0, 2.0, 3.0)  # of random starts from home [rad, characteristic lengths]
_STARTS = 24  # at each distance
_TRIAL_STARTS = 6  # at each distance, of a trial
_MANY_JOINTS = 100  # from which a start takes tenths of a second, and there are as many as in a trial
_LISTED = 6  # open loops at most in a message
_MAX_TRIED = 8  # candidates of a branch, until one is regular
_WELL = 0.3  # of the best candidate's distance from singular configurations


@dataclass(frozen=True, eq=False)
class AssembledHome:
    """A closed, regular configuration on one branch."""

    configuration: Configuration  #: the configuration
    distance: float  #: largest motion of a joint from the described home [rad, characteristic lengths]
    within_limits: bool  #: whether it breaks no limits
    #: distance from singular configurations: the least measure of
    #: :func:`~pm3dof_pin.kinematics.singularity.singularity_distances`, without a tool that of the loops
    regularity: float = math.nan


@dataclass(frozen=True, eq=False)
class ClosingTrial:
    """What the damped solver makes of the loops of a robot from random starts around the described home."""

    starts: int  #: number of random starts
    closed: int  #: from how many of them all loops close
    gaps: Mapping[str, float]  #: largest error of each loop where the end is nearest to closed [m, rad]

    def __str__(self) -> str:
        if self.closed:
            return f"they close from {self.closed} of {self.starts} random starts"
        gaps = sorted(((name, gap) for name, gap in self.gaps.items() if gap > CLOSED), key=lambda pair: -pair[1])
        listed = ", ".join(f"{name} by {gap:.3g}" for name, gap in gaps[:_LISTED]) + " m or rad"
        listed += f" and {len(gaps) - _LISTED} more by less" if len(gaps) > _LISTED else ""
        return f"from {self.starts} random starts none closes: the nearest end leaves open {listed}"


def closing_trial(robot: PlacedMechanism) -> ClosingTrial:
    """Try to close the loops from thirty random starts, up to 3 rad or characteristic lengths away. Deterministic."""
    return _trial(robot, list(_ends(robot, _TRIAL_STARTS)))


def _starts(robot: PlacedMechanism) -> int:
    """Return how many random starts there are at each distance."""
    return _STARTS if robot.model.nv <= _MANY_JOINTS else _TRIAL_STARTS


def _ends(robot: PlacedMechanism, count: int) -> Iterator[Assembly]:
    """Close the loops from random starts, so many at each distance from the described home."""
    generator, model = np.random.default_rng(0), robot.model
    for distance in _DISTANCES:
        for _ in range(count):
            motion = robot.velocity_scale * generator.uniform(-distance, distance, model.nv)
            yield assemble(robot, pin.integrate(model, robot.described_home.q, motion))


def _ends_within(robot: PlacedMechanism) -> Iterator[Assembly]:
    """Close the loops from random starts within the limits of joints, those without limits as in the described home."""
    generator = np.random.default_rng(0)
    lower, upper, home = robot.lower_limits, robot.upper_limits, robot.described_home.q
    limited = np.isfinite(lower) & np.isfinite(upper)
    for _ in range(len(_DISTANCES) * _starts(robot)):
        q = np.array(home)
        q[limited] = generator.uniform(lower[limited], upper[limited])
        yield assemble(robot, q)


def _trial(robot: PlacedMechanism, ends: list[Assembly]) -> ClosingTrial:
    nearest = min(ends, key=lambda end: end.residual).configuration
    error = np.abs(nearest.closure_error)
    names = [closure.name for closure in robot.closures]
    names += [f"coupling of {coupling.joint}" for coupling in robot.couplings]
    gaps = [float(error[part].max(initial=0.0)) for part in robot.loop_kinematics.rows]
    return ClosingTrial(len(ends), sum(end.converged for end in ends), dict(zip(names, gaps, strict=False)))


def assembled_homes(robot: PlacedMechanism) -> list[AssembledHome]:
    """Find closed regular configurations near the described home, one on each branch found, nearest first.

    Of each branch it is the nearest that is at least a third as far from singular ones as the best found there. Random
    starts up to 3 rad or characteristic lengths away are closed by the damped solver; those within all limits are
    preferred. If none is within, starts within the limits of all joints follow, as for files whose joints have ranges
    without zero and no keyframe. There may be further branches, farther away. Deterministic.

    Raises:
        ConvergenceError: no closed regular configuration was found; the message says which loops stay open.
    """
    described, ends = robot.described_home, list(_ends(robot, _starts(robot)))
    found = [_candidate(robot, described, end.configuration) for end in ends if end.converged]
    if not any(home.within_limits for home in found):
        inside = [_candidate(robot, described, end.configuration) for end in _ends_within(robot) if end.converged]
        found += [home for home in inside if home.within_limits]
    found.sort(key=lambda home: (not home.within_limits, home.distance))
    branches = next((around for home in found if (around := _regular(robot, home)) is not None), None)
    if branches is None:
        nearest = min(ends, key=lambda end: end.residual)
        advice = "all of these are singular poses" if found else str(_trial(robot, ends))
        task = f"{robot.name}: closing the loops"
        raise ConvergenceError(task, nearest.residual, "m or rad", nearest.steps, advice)
    groups: dict[int, list[AssembledHome]] = {}
    for home in found:
        groups.setdefault(branches.number(home.configuration.q), []).append(home)
    usual = instantaneous_mobility(generic_configuration(found[0].configuration))
    chosen = (_nearest_regular(robot, group, usual) for group in groups.values())
    return sorted((home for home in chosen if home is not None), key=lambda home: home.distance)


def _nearest_regular(robot: PlacedMechanism, homes: list[AssembledHome], usual: Mobility) -> AssembledHome | None:
    """Return the nearest of a branch's configurations, sorted, that is not much nearer to singular ones than the best.

    One within the limits, if there is one. None if the first few are singular.
    """
    homes = [home for home in homes if home.within_limits == homes[0].within_limits]
    measured = [replace(home, regularity=_regularity(home.configuration, usual)) for home in homes]
    enough = _WELL * max(home.regularity for home in measured)
    tried = [home for home in measured if home.regularity >= enough][:_MAX_TRIED]
    return next((home for home in tried if _regular(robot, home) is not None), None)


def _regularity(configuration: Configuration, usual: Mobility) -> float:
    if configuration.mechanism.tool_frame is None:  # the loops' condition only
        return DegreesOfFreedom(configuration).closures.rank.least(usual.constraint_rank.rank)
    return min(entry.measure for entry in singularity_distances(configuration, generic=usual))


def _regular(robot: PlacedMechanism, home: AssembledHome) -> Branches | None:
    """Return the branches around a configuration, None if it is singular."""
    with suppress(PM3DofError):
        around = Branches(robot, home.configuration)
        return around if around.start_is_home else None
    return None


def home_within_limits(robot: PlacedMechanism) -> Configuration | None:
    """Return the only assembly found within all limits, for a robot whose home is open, singular or beyond limits.

    None otherwise. Files whose joints have ranges without zero, and no keyframe, describe a home that is none.
    """
    if not robot.has_loops:
        return None
    if robot.home.closure_residual <= robot.closure_tolerance and not robot.home.violated_limits():
        with suppress(SingularConfigurationError):
            if Branches(robot).start is not None:
                return None
    try:
        within = [home for home in assembled_homes(robot) if home.within_limits]
    except ConvergenceError:
        return None
    return within[0].configuration if len(within) == 1 else None


def _candidate(robot: PlacedMechanism, described: Configuration, configuration: Configuration) -> AssembledHome:
    moves: Vector = pin.difference(robot.model, described.q, configuration.q) / robot.velocity_scale
    distance = float(np.abs(moves).max(initial=0.0))
    return AssembledHome(configuration, distance, not configuration.violated_limits())
