"""The equilibrium path of an elastic mechanism under growing loads, followed by arc length.

Points of the path are equilibria with their load factor f. With T = Z^T H Z and p the growing loads' forces on the
motions Z, the path's direction (y, df) solves T y - p df = 0. A step follows it and returns to the path by the least
(y, df) with T y - p df = -residual (E. Allgower and K. Georg, Numerical Continuation Methods, 1990). This passes limit
points, where the load has a maximum and T is singular. Lengths are measured with f relative to a typical factor and y
relative to the initial strain due to the loads.

A step is accepted as a piece of one path only if the number of T's negative eigenvalues is unchanged, or has changed by
one while the load has begun to fall or to grow again. Otherwise the step is halved, until it is a piece of one path
(which may bend sharply, as for a slightly imperfect structure) or so short that two paths meet within it, at a
bifurcation.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.elastic.contact_laws import SEAT
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded_state import LoadedState
from pm3dof_pin.elastic.loads import AppliedLoads, Loads
from pm3dof_pin.exceptions import ConvergenceError, DeflectionRangeError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.tolerances import ROUNDING, SOLVED
from pm3dof_pin.typing import Matrix, Vector

FIRST_STEP = 0.2
"""Length of the first step along a path, in scaled measures."""

_CORRECTIONS = 12
_BRANCHING = 1e-6  # smaller singular values leave more than one direction
_SHARPEST_TURN = 0.9  # least cosine of the angle between the directions at two points
_MAX_DRIFT = 0.5  # total corrections, relative to the step
_LONGEST_MOTION = 0.3  # rad, or characteristic lengths
_SHORTEST_STEP = 1e-6
_MEETING = 1e-5  # longest step assumed to cross a bifurcation
_NEARLY_SINGULAR = 1e2  # times the rank threshold
_AT_RANGE = 0.02  # longest step assumed to leave the springs' range
_GROWTH = 2.0
_MAX_POINTS = 1000
_BRACKETINGS = 60
_MAX_FALLS = 500
_LONGEST_FALL = 0.1  # rad, or characteristic lengths
_HALVINGS = 20
_SOFTENINGS = 13  # stages from a filled play to an open one
_MIN_DAMPING = 1e-3  # relative to the springs' stiffness
_AT_REST = 1e-3  # relative to the loads; a smaller imbalance means that an unstable equilibrium is near
_PUSH = 1e-2  # relative to the loads
_BRANCH_STEPS = (0.02, 0.05, 0.1, 0.2)

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class PathPoint:
    """An equilibrium on the path."""

    factor: float  #: the factor of the growing loads
    state: LoadedState  #: motions, forces and tangent stiffness
    #: unit vector along the path: strains (see :meth:`LoadedState.invariant`) and, last, the load, in scaled measures
    direction: Vector
    steps: int  #: number of corrections

    @property
    def load_grows(self) -> bool:
        """Whether the load grows along the path's direction."""
        return bool(self.direction[-1] > 0.0)

    @property
    def stable(self) -> bool:
        """Whether the equilibrium is stable."""
        return self.state.least_eigenvalue > 0.0

    def reversed(self) -> PathPoint:
        """Return the same point with the opposite direction."""
        return replace(self, direction=-self.direction)


@dataclass(frozen=True, eq=False)
class PathStep:
    """One step along the path."""

    start: PathPoint  #: its start
    end: PathPoint  #: its end
    length: float  #: its length
    bifurcation: bool  #: whether two paths meet within it

    @property
    def limit_point(self) -> bool:
        """Whether the load has an extremum within it."""
        return self.end.load_grows != self.start.load_grows and not self.bifurcation


class LoadPath:
    """The equilibria under permanent and growing loads.

    Args:
        model: the elastic mechanism.
        configuration: configuration with springs at rest.
        loads: loads that are multiplied by a factor.
        permanent: loads that always act in full.

    Attributes:
        rest: configuration with the springs at rest, of the mechanism with virtual joints.
        growing: the loads at factor 1.
    """

    def __init__(
        self,
        model: ElasticModel,
        configuration: Configuration | ArrayLike,
        loads: Loads,
        permanent: Loads | None,
    ) -> None:
        self.rest = model.configuration(configuration)
        self.growing = AppliedLoads(model.mechanism, [(1.0, loads)])
        self._model = model
        self._loads, self._permanent = loads, permanent or Loads()
        self._typical_factor = self._typical_strain = 1.0

    def equilibrium(self, factor: float, guess: Configuration) -> tuple[LoadedState, int]:
        """Find an equilibrium at a factor from a guess; return it and the number of Newton steps.

        Raises:
            ConvergenceError: there is none nearby.
        """
        return LoadedState(self._model, self.rest, self._applied(factor), guess).settled()

    def begin(self, state: LoadedState, typical_factor: float) -> PathPoint:
        """Return the start of the path, at factor 0, in the direction of growing load, scaled by a typical factor."""
        self._typical_factor = typical_factor
        self._typical_strain = float(np.linalg.norm(state.force(self.growing))) * typical_factor or 1.0
        towards = np.zeros(len(state.motions.whitened) + len(self.rest.constraint_jacobian.T) + 1)
        towards[-1] = 1.0
        return PathPoint(0.0, state, self._direction(state, towards), 0)

    def settle(self) -> tuple[LoadedState, int]:
        """Find the equilibrium under the full growing loads, and the corrections of the last step.

        This is on the path from rest, if that reaches the full loads; otherwise it is the stable equilibrium elsewhere
        to which the mechanism settles when released under them.

        Raises:
            DeflectionRangeError: the path from rest leaves the springs' range.
            ConvergenceError: no stable equilibrium was found.
        """
        if any(block.law is not None and block.law.play is not None for block in self._model.blocks):
            return self._close_play()
        rest = LoadedState(self._model, self.rest, self._applied(0.0), self.rest)
        pushed = rest.motions.unstrained.T @ self.growing.forces(self.rest)
        if np.abs(pushed).max(initial=0.0) > SOLVED * self.growing.size:
            return self.equilibrium(1.0, self.rest)  # motions without springs have no equilibrium without loads
        try:
            point = self.follow(self.begin(rest, 1.0), 1.0)
        except ConvergenceError as error:
            found = self._let_go(LoadedState(self._model, self.rest, self._applied(1.0), self.rest))
            if found is None:
                raise
            _log.warning("the mechanism jumps to a stable equilibrium elsewhere: %s", error)
            return found
        return point.state, point.steps

    def _close_play(self) -> tuple[LoadedState, int]:
        """Find the equilibrium of contacts with play: at first filled with material, which becomes softer and softer.

        Raises:
            ConvergenceError: Newton's method failed on the way.
        """
        state, steps = LoadedState(self._model, self.rest, self._applied(1.0), self.rest, seat=1.0).settled()
        for seat in np.geomspace(1.0, SEAT, _SOFTENINGS)[1:]:
            near, loads = state.deflections, self._applied(1.0)
            softer = LoadedState(self._model, self.rest, loads, state.configuration, near, float(seat))
            state, steps = softer.settled()
        return state, steps

    def _let_go(self, state: LoadedState) -> tuple[LoadedState, int] | None:
        """Follow the damped motion without inertia from a state under its loads; None if it does not settle.

        Steps are implicit, (T + shift) y = -residual: Newton steps where T is positive definite. At an unstable
        equilibrium the mechanism is pushed off along the softest motion.
        """
        for step in range(_MAX_FALLS):
            if state.out_of_range:
                break
            least, residual = state.least_eigenvalue, state.bearing_residual
            if least > 0.0 and state.balanced:
                return state, step
            shift = max(0.0, _MIN_DAMPING - 2.0 * least)
            move = -np.linalg.solve(state.tangent + shift * np.eye(len(residual)), residual)
            if least <= 0.0 and state.imbalance < _AT_REST * state.load_size:
                move += np.copysign(_PUSH * state.load_size, state.softest @ move) * state.softest
            velocity = state.bearing_motions @ move
            longest = np.abs(velocity / self._model.mechanism.velocity_scale).max(initial=0.0)
            parts = min(1.0, _LONGEST_FALL / longest) * 0.5 ** np.arange(_HALVINGS)
            moved = next(filter(None, (state.moved(part * velocity) for part in parts)), None)
            if moved is None:
                break
            state = moved
        return None

    def unloaded(self) -> LoadedState:
        """Find the equilibrium under the permanent loads alone.

        Raises:
            PM3DofError: as :meth:`settle`.
        """
        path = LoadPath(self._model, self.rest, self._permanent, None)
        state, _ = path.settle()
        return LoadedState(self._model, self.rest, self._applied(0.0), state.configuration, state.deflections)

    def advance(self, point: PathPoint, length: float) -> PathStep:
        """Continue along the path by a length, or less where the path bends or branches.

        Raises:
            DeflectionRangeError: a spring would be deflected further than it can be.
            ConvergenceError: the path could not be followed; the message says from where.
        """
        beyond = ""
        while length > _SHORTEST_STEP and not (beyond and length < _AT_RANGE):
            found = self.point_at(point, length)
            if found is not None and _one_piece(point, found):
                beyond = found.state.out_of_range
                if not beyond:
                    return PathStep(point, found, length, bifurcation=False)
            elif found is not None:
                if length <= _MEETING:
                    return PathStep(point, found, length, bifurcation=True)
                length *= float(np.clip(0.95 * _crossing(point, found), 0.02, 0.7))
                continue
            length /= 2.0
        if beyond:
            raise DeflectionRangeError(beyond, point.factor)
        rank = point.state.motions.passive_rank
        nearly = rank.least(rank.rank) < _NEARLY_SINGULAR * rank.threshold
        self._give_up(
            point, "it reaches a singular configuration, a dead point of its passive joints" if nearly else ""
        )

    def follow(self, point: PathPoint, factor: float) -> PathPoint:
        """Follow the path to a factor. If it becomes unstable at a bifurcation, a stable branch is taken.

        Raises:
            DeflectionRangeError: a spring would be deflected further than it can be.
            ConvergenceError: the path turns back before that factor, at a limit point or at a bifurcation without a
                stable branch that continues, or could not be followed.
        """
        grows = factor > point.factor
        if point.load_grows != grows:
            point = point.reversed()
        length = FIRST_STEP
        for _ in range(_MAX_POINTS):
            if point.factor == factor:
                return point
            remaining = (factor - point.factor) / (self._typical_factor * point.direction[-1])
            if remaining <= max(2.0, 4.0 * length):
                found = self.point_at(point, remaining, factor)
                if found is not None and _one_piece(point, found) and not found.state.out_of_range:
                    point = found
                    continue
            step = self.advance(point, min(length, 0.5 * remaining))
            if step.bifurcation:
                point = self._past_bifurcation(step, grows=grows)
                length = FIRST_STEP
                continue
            if step.limit_point:
                self._give_up(self.critical_point(step), "it turns back there, at a limit point")
            point, length = step.end, _GROWTH * step.length
        self._give_up(point, f"a factor of {factor:.6g} is not reached after {_MAX_POINTS} points")

    def critical_point(self, step: PathStep) -> PathPoint:
        """Return the point within a step where an eigenvalue of the tangent changes sign.

        The bracket is narrowed from the nearest point found so far, so that every search starts next to the path.
        """
        near, far, width = step.start, step.end, step.length
        index = min(near.state.instability, far.state.instability)

        def value(point: PathPoint) -> float:
            return float(point.state.eigenvalues[index])

        best = min(near, far, key=lambda point: abs(value(point)))
        for _ in range(_BRACKETINGS):
            if abs(value(best)) <= ROUNDING or width <= ROUNDING:
                break
            fraction = float(np.clip(value(near) / (value(near) - value(far)), 0.05, 0.95))
            found = self.point_at(near, fraction * width) or self.point_at(near, 0.5 * fraction * width)
            if found is None:
                break
            if (value(found) > 0.0) == (value(near) > 0.0):
                # the end is at the same distance, or slightly further if the path is curved
                near, width = found, 1.2 * (1.0 - fraction) * width
            else:
                far, width = found, fraction * width
            best = min(best, found, key=lambda point: abs(value(point)))
        return best

    def _past_bifurcation(self, step: PathStep, *, grows: bool) -> PathPoint:
        """Continue past a bifurcation: on a stable branch if the path was stable, else straight on."""
        if not step.start.stable:
            _log.warning("bifurcation at a factor of %.6g, branch followed: straight on, unstable", step.start.factor)
            return step.end
        critical = self.critical_point(step)
        if step.end.stable:
            return step.end
        for sign in (1.0, -1.0):
            sideways = np.append(critical.state.invariant(sign * critical.state.softest), 0.0)
            for length in _BRANCH_STEPS:
                found = self.point_at(replace(critical, direction=sideways), length)
                if found is not None and found.stable and found.load_grows == grows:
                    _log.warning(
                        "bifurcation at a factor of %.6g, branch followed: a stable one that bends away, %s",
                        critical.factor,
                        self._mode(sign * critical.state.softest, critical.state),
                    )
                    return found
        self._give_up(critical, "it becomes unstable there, at a bifurcation without a stable branch")

    def _mode(self, motion: Vector, state: LoadedState) -> str:
        """Describe a motion in words by the joint that moves most."""
        mechanism = self._model.mechanism
        velocity = state.bearing_motions @ motion / mechanism.velocity_scale
        most = int(np.argmax(np.abs(velocity)))
        joints = [joint.nv for joint in list(mechanism.model.joints)[1:]]
        name = mechanism.model.names[1 + int(np.searchsorted(np.cumsum(joints), most, side="right"))]
        return f"with '{name}' {'growing' if velocity[most] > 0.0 else 'falling'}"

    def _give_up(self, point: PathPoint, why: str) -> NoReturn:
        residual = float(np.abs(point.state.unbalanced).max(initial=0.0))
        task = f"the load path beyond a factor of {point.factor:.8g}"
        raise ConvergenceError(task, residual, "N or N m", point.steps, why)

    def point_at(self, point: PathPoint, length: float, target: float | None = None) -> PathPoint | None:
        """Return the point of the path at a distance from another; None if not found or if the path turns sharply.

        Corrections return to the path by the least move, or at a target factor if given.
        """
        y, rise = self._split(point.state, length * point.direction)
        factor, velocity = point.factor + rise, point.state.bearing_motions @ y
        if target is not None:
            factor = target
        if np.abs(velocity / self._model.mechanism.velocity_scale).max(initial=0.0) > _LONGEST_MOTION:
            return None
        state = point.state.moved(velocity, self._applied(factor))
        drift = 0.0
        for count in range(_CORRECTIONS):
            if state is None or drift > _MAX_DRIFT * length:
                return None
            balanced = state.balanced
            change = self._correction(state, factor_fixed=target is not None)
            drift += float(np.linalg.norm(change))
            rise = self._typical_factor * float(change[-1])
            velocity = state.bearing_motions @ (self._typical_strain * change[:-1])
            closer = state.moved(velocity, self._applied(factor + rise))
            if balanced:
                if closer is not None and closer.imbalance < state.imbalance:
                    state, factor = closer, factor + rise
                direction = self._direction(state, point.direction)
                turned = direction @ point.direction < _SHARPEST_TURN
                return None if turned else PathPoint(factor, state, direction, count + 1)
            state, factor = closer, factor + rise
        return None

    def _applied(self, factor: float) -> AppliedLoads:
        return AppliedLoads(self._model.mechanism, [(factor, self._loads), (1.0, self._permanent)])

    def _equations(self, state: LoadedState) -> Matrix:
        """T y - p df as a matrix over (y, df) in scaled measures."""
        load = self._typical_factor * state.force(self.growing)
        return np.hstack([self._typical_strain * state.tangent, -load[:, None]])

    def _split(self, state: LoadedState, direction: Vector) -> tuple[Vector, float]:
        """Return y and df of a direction in scaled measures."""
        y = self._typical_strain * state.coordinates(direction[:-1])
        return y, self._typical_factor * float(direction[-1])

    def _correction(self, state: LoadedState, *, factor_fixed: bool) -> Vector:
        """Return the least (y, df), in scaled measures, that removes the imbalance."""
        equations = self._equations(state)
        if factor_fixed:
            equations[:, -1] = 0.0
        solved = np.linalg.lstsq(equations, -state.bearing_residual, rcond=SOLVED)[0]
        return np.asarray(solved, dtype=np.float64)

    def _direction(self, state: LoadedState, before: Vector) -> Vector:
        """Return the direction of the path nearest to the previous one."""
        equations = self._equations(state)
        previous = np.append(state.coordinates(before[:-1]), before[-1])
        # the previous direction projected onto the null space, which may have more than one dimension
        nearest = previous - np.linalg.lstsq(equations, equations @ previous, rcond=_BRANCHING)[0]
        nearest /= np.linalg.norm(nearest)
        return np.append(state.invariant(nearest[:-1]), nearest[-1])


def _one_piece(start: PathPoint, end: PathPoint) -> bool:
    """Return whether at most one limit point lies between two points of a path, and nothing else."""
    changed = abs(end.state.instability - start.state.instability)
    return changed == (end.load_grows != start.load_grows)


def _crossing(start: PathPoint, end: PathPoint) -> float:
    """Estimate where between two points an eigenvalue vanishes, relative to their distance."""
    index = min(start.state.instability, end.state.instability)
    near, far = float(start.state.eigenvalues[index]), float(end.state.eigenvalues[index])
    return near / (near - far) if near * far < 0.0 else 0.5
