"""The path of equilibria of an elastic mechanism under loads that grow, followed by its arc length.

Points of the path are equilibria with their load factor f. With T = Z^T H Z and p the growing loads' forces on the
motions Z, the path's direction (y, df) solves T y - p df = 0; a step goes along it and comes back to the path by the
shortest way, the least (y, df) with T y - p df = -residual (E. Allgower and K. Georg, Numerical Continuation Methods,
1990). So it goes through limit points, where the load has a maximum and T is singular. Lengths are measured with f on a
typical factor and y on the strain that the loads cause at first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loaded_state import LoadedState, find_equilibrium
from pm3dof_pin.elastic.loads import AppliedLoads, Loads
from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.typing import Matrix, Vector

_CORRECTIONS = 12
_SINGULAR = 1e-9
_BRANCHING = 1e-6  # singular values below leave more than one direction to go
_SHARPEST_TURN = 0.8  # least cosine of the angle between two points' directions
_SMALLEST_STEP = 2.0**-16


@dataclass(frozen=True, eq=False)
class PathPoint:
    """One equilibrium on the path.

    Attributes:
        factor: what the growing loads are multiplied by.
        state: motions, forces and tangent stiffness.
        direction: where the path goes: strains (see :meth:`LoadedState.invariant`) and, last, the load, in the path's
            measures; of length 1.
        steps: corrections done.
    """

    factor: float
    state: LoadedState
    direction: Vector
    steps: int

    @property
    def load_grows(self) -> bool:
        """Whether the load grows along the path's direction."""
        return bool(self.direction[-1] > 0.0)

    def reversed(self) -> PathPoint:
        """Return the same point, with the path followed the other way."""
        return PathPoint(self.factor, self.state, -self.direction, self.steps)


class LoadPath:
    """The equilibria under permanent loads and others that grow.

    Args:
        model: the elastic mechanism.
        configuration: where the springs are at rest.
        loads: loads, which are multiplied by a factor.
        permanent: loads that always act in full.
        tolerance: imbalance that counts as none, as a part of the size of the loads.
        max_steps: Newton steps to give up after.

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
        *,
        tolerance: float,
        max_steps: int,
    ) -> None:
        self.rest = model.configuration(configuration)
        self.growing = AppliedLoads(model.mechanism, [(1.0, loads)])
        self._model = model
        self._loads, self._permanent = loads, permanent or Loads()
        self._tolerance, self._max_steps = tolerance, max_steps
        self._typical_factor = self._typical_strain = 1.0

    def equilibrium(self, factor: float, guess: Configuration) -> tuple[LoadedState, int]:
        """Find an equilibrium at a factor from a guess; return it and the number of Newton's steps.

        Raises:
            ConvergenceError: there was none near by.
        """
        start = LoadedState(self._model, self.rest, self._applied(factor), guess)
        return find_equilibrium(start, tolerance=self._tolerance, max_steps=self._max_steps)

    def begin(self, state: LoadedState, typical_factor: float) -> PathPoint:
        """Return the beginning of the path, at factor 0, in the direction of growing load.

        Args:
            state: equilibrium under the permanent loads.
            typical_factor: factor to measure others on.
        """
        self._typical_factor = typical_factor
        self._typical_strain = float(np.linalg.norm(state.force(self.growing))) * typical_factor or 1.0
        towards = np.zeros(len(state.motions.whitened) + len(self.rest.constraint_jacobian.T) + 1)
        towards[-1] = 1.0
        return PathPoint(0.0, state, self._direction(state, towards), 0)

    def advance(self, point: PathPoint, step: float) -> tuple[PathPoint, float]:
        """Go on along the path; return the next point and the length of the step, which is halved where needed.

        Raises:
            ConvergenceError: the path could not be followed; the message says from where.
        """
        length = step
        while length > _SMALLEST_STEP * step:
            found = self.point_at(point, length)
            if found is not None:
                return found, length
            length /= 2.0
        residual = float(np.abs(point.state.unbalanced).max(initial=0.0))
        raise ConvergenceError(
            f"the load path beyond a factor of {point.factor:.6g}", residual, "N or N m", _CORRECTIONS
        )

    def point_at(self, point: PathPoint, step: float) -> PathPoint | None:
        """Return the point of the path at a distance from another; None if not found, or if the path turns sharply."""
        y, rise = self._split(point.state, step * point.direction)
        factor, velocity = point.factor + rise, point.state.bearing_motions @ y
        state = point.state.moved(velocity, self._applied(factor))
        for count in range(_CORRECTIONS):
            if state is None:
                return None
            balanced = state.balanced(self._tolerance)
            y, rise = self._correction(state)
            closer = state.moved(state.bearing_motions @ y, self._applied(factor + rise))
            if balanced:
                if closer is not None and closer.imbalance < state.imbalance:
                    state, factor = closer, factor + rise
                direction = self._direction(state, point.direction)
                turned = direction @ point.direction < _SHARPEST_TURN
                return None if turned else PathPoint(factor, state, direction, count + 1)
            state, factor = closer, factor + rise
        return None

    def point_with_factor(self, point: PathPoint, factor: float) -> PathPoint | None:
        """Return the point near by with a given factor; None if not found, or if the path turns sharply."""
        step = (factor - point.factor) / (self._typical_factor * point.direction[-1])
        y, _ = self._split(point.state, step * point.direction)
        state = point.state.moved(point.state.bearing_motions @ y, self._applied(factor))
        if state is None:
            return None
        try:
            state, steps = find_equilibrium(state, tolerance=self._tolerance, max_steps=_CORRECTIONS)
        except ConvergenceError:
            return None
        direction = self._direction(state, point.direction)
        return None if direction @ point.direction < _SHARPEST_TURN else PathPoint(factor, state, direction, steps)

    def follow(self, point: PathPoint, factor: float, longest_step: float) -> PathPoint:
        """Follow the path to a factor.

        Raises:
            ConvergenceError: the path turns round before, at a limit point, or could not be followed.
        """
        grows = factor > point.factor
        if point.load_grows != grows:
            point = point.reversed()
        while point.factor != factor:
            remaining = (factor - point.factor) / (self._typical_factor * point.direction[-1])
            found = self.point_with_factor(point, factor) if remaining <= longest_step else None
            if found is None:
                found, _ = self.advance(point, min(longest_step, 0.5 * remaining))
            if found.load_grows != grows:
                residual = float(np.abs(found.state.unbalanced).max(initial=0.0))
                raise ConvergenceError(
                    f"the load path beyond a factor of {point.factor:.6g}",
                    residual,
                    "N or N m",
                    found.steps,
                    "it turns round there, at a limit point: no equilibrium near by bears more",
                )
            point = found
        return point

    def _applied(self, factor: float) -> AppliedLoads:
        return AppliedLoads(self._model.mechanism, [(factor, self._loads), (1.0, self._permanent)])

    def _equations(self, state: LoadedState) -> Matrix:
        """T y - p df as a matrix over (y, df) in the path's measures."""
        load = self._typical_factor * state.force(self.growing)
        return np.hstack([self._typical_strain * state.tangent, -load[:, None]])

    def _split(self, state: LoadedState, direction: Vector) -> tuple[Vector, float]:
        """Return y and df of a direction in the path's measures."""
        y = self._typical_strain * state.coordinates(direction[:-1])
        return y, self._typical_factor * float(direction[-1])

    def _correction(self, state: LoadedState) -> tuple[Vector, float]:
        solved = np.linalg.lstsq(self._equations(state), -state.bearing_residual, rcond=_SINGULAR)[0]
        least = np.asarray(solved, dtype=np.float64)
        y: Vector = self._typical_strain * least[:-1]
        return y, self._typical_factor * float(least[-1])

    def _direction(self, state: LoadedState, before: Vector) -> Vector:
        """Return the direction of the path that turns least from the one before."""
        _, values, right = np.linalg.svd(self._equations(state))
        threshold = _BRANCHING * float(values.max(initial=0.0))
        directions = right[int(np.count_nonzero(values > threshold)) :]
        wanted = np.append(state.coordinates(before[:-1]), before[-1])
        nearest = directions.T @ (directions @ wanted)
        nearest /= np.linalg.norm(nearest)
        return np.append(state.invariant(nearest[:-1]), nearest[-1])
