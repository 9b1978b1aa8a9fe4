"""Poses at the commands of more drives than degrees of freedom.

Commands of such drives agree only up to the machine's errors. The pose is then where they are met by least squares, in
joint units (radians, characteristic lengths): there equally stiff drives would hold it, with internal forces of least
norm. It is sought over the coordinates, in which no choice of drives can be singular; or, where these do not determine
the pose, over the commands of independent drives.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.pose_search import Solver
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Indices, Matrix, Vector

_logger = logging.getLogger(__name__)

AGREEING = 1e-6
"""Greatest difference of commands that agree [rad, characteristic lengths]."""

_CONTRADICTION = 2e-3  # greatest one that errors of a machine explain, of a robot as described
_OF_ERRORS = 0.05  # the same of a machine with errors
# ways to other starts, where commands change least
_VALLEY = (0.1, -0.1, 0.2, -0.2, 0.4, -0.4, 0.8, -0.8, 1.2, -1.2, 0.3, -0.3, 0.6, -0.6, 1.6, -1.6)
_CLEARLY = 0.9  # times as far off: then another pose is taken; that of a symmetric machine differs by rounding
_STEPS = 30
_SHORTER = (1.0, 0.5, 0.25, 0.1, 0.02)  # factors tried in turn on a step that does not reduce the error
_FARTHEST = 0.3  # of a coordinate in one step [rad, characteristic lengths]
_SMALL = 1e-6  # of a coordinate, for differences [rad, characteristic lengths]
_VISIBLE = 1e-4  # the same, for differences of differences
_SLOWLY = 0.1  # of the step before
_NEAR = 0.03  # step from which second derivatives are of use [rad, characteristic lengths]
_SETTLED = 1e-11  # last step [rad, characteristic lengths]


class SharedCommands:
    """Poses at the commands of a robot with more drives than degrees of freedom.

    Args:
        robot: the robot.
        solver: finds poses at the coordinates.
        coordinates: as many as the robot has degrees of freedom.
        read: function of configurations, shape=(n, nq), that returns the coordinates there, shape=(n, k).
    """

    def __init__(
        self,
        robot: PlacedMechanism,
        solver: Solver,
        coordinates: tuple[Coordinate, ...],
        read: Callable[[Matrix], Matrix],
    ) -> None:
        self._robot, self._solver, self._coordinates = robot, solver, read
        self._scales = coordinate_scales(robot, robot.command_coordinates)
        self._units = coordinate_scales(robot, coordinates)
        self._tolerated = AGREEING  #: greatest difference that needs no warning, twice what was told

    def differences(self, q: Matrix, commands: Matrix) -> Matrix:
        """Return the differences of the commands at q from those given, shape=(n, number of commands) [m, rad]."""
        robot = self._robot
        differences = robot.read(robot.command_coordinates, q) - commands
        turns = coordinate_periods(robot, robot.command_coordinates)
        angles = np.isfinite(turns)
        differences[:, angles] -= turns[angles] * np.round(differences[:, angles] / turns[angles])
        return differences

    def agreeing(self, q: Matrix, commands: Matrix) -> Matrix:
        """Return q, NaN where not all commands are those given."""
        return np.where((self._off(q, commands) <= AGREEING)[:, None], q, np.nan)

    def worst(self, differences: Vector) -> int:
        """Return the number of the command that is the farthest off."""
        return int(np.argmax(np.abs(differences / self._scales)))

    def poses(
        self, placed: Callable[[Indices], Matrix], commands: Matrix, starts: Matrix | None, *, keep_branch: bool
    ) -> Matrix:
        """Return the poses at all commands; NaN where they contradict each other.

        `placed` returns the poses of some rows by independent drives alone. Commands that no pose meets are met by
        least squares if they differ from the pose's by little, with a warning if the robot is as described.
        """
        robot, every = self._robot, np.arange(len(commands))
        described, is_guessed = robot.prototype is robot, starts is not None
        # of a machine with errors near its guess, only where least squares fail from there
        later = is_guessed and not described
        alone = np.full((len(every), robot.model.nq), np.nan) if later else placed(every)
        off = self._off(alone, commands)
        rows = np.flatnonzero(~(off <= SOLVED) & np.isfinite(commands).all(axis=1))
        if not rows.size:
            return self.agreeing(alone, commands)
        answer, off = np.where((off <= SOLVED)[:, None], alone, np.nan), np.where(off <= SOLVED, off, np.inf)
        enough, most = (AGREEING, _CONTRADICTION) if described else (_OF_ERRORS, _OF_ERRORS)
        home = np.tile(robot.home.q, (len(every), 1)) if starts is None else starts
        for near in (alone, home) if described and not is_guessed else (home, alone):
            own = rows[~(off[rows] <= enough)]
            if near is alone and later and own.size:
                alone[own] = placed(own)
            own = own[np.isfinite(near[own, 0])]
            self._improve(answer, off, own, commands, near[own], keep_branch=keep_branch)
        # near a singular pose of the drives, two poses have nearly the same commands
        for length in _VALLEY if described and not is_guessed else ():
            own = rows[(off[rows] > enough) & np.isfinite(off[rows])]
            if own.size:
                weakest = np.linalg.svd(self._by_coordinates(answer[own]))[2][:, -1] * self._units
                beside = self._coordinates(answer[own]) + length * weakest
                near = self._solver.walk(beside, answer[own], keep_branch=keep_branch).q
                found = np.isfinite(near[:, 0])
                self._improve(answer, off, own[found], commands, near[found], keep_branch=keep_branch)
        worst = np.max(off, initial=0.0, where=off <= most)
        if worst > self._tolerated and described:
            self._tolerated = 2.0 * worst
            _logger.warning(
                "%s: the commands of %d drives contradict each other by up to %.2g rad or characteristic lengths; the "
                "pose meets them by least squares",
                *(robot.name, len(self._scales), worst),
            )
        return np.where((off <= most)[:, None], answer, np.nan)

    def _off(self, q: Matrix, commands: Matrix) -> Vector:
        return np.asarray(np.abs(self.differences(q, commands) / self._scales).max(axis=1))

    def _improve(
        self, answer: Matrix, off: Vector, rows: Indices, commands: Matrix, starts: Matrix, *, keep_branch: bool
    ) -> None:
        """Replace some rows of poses, in place, by those found from starts whose commands are clearly less far off."""
        if rows.size:
            found = self._least_squares(commands[rows], starts, keep_branch=keep_branch)
            left = self._off(found, commands[rows])
            better = left < _CLEARLY * off[rows]
            answer[rows[better]], off[rows[better]] = found[better], left[better]

    def _read(self, q: Matrix, moves: Array) -> Array:
        """Return the scaled changes of the commands by some moves of the coordinates, shape=(n, moves, commands).

        The moves are scaled too, shape=(moves, k).
        """
        beside = (self._coordinates(q)[:, None] + moves * self._units).reshape(-1, len(self._units))
        found = self._solver.walk(beside, np.repeat(q, len(moves), axis=0), keep_branch=False).q
        before = np.repeat(self._robot.read(self._robot.command_coordinates, q), len(moves), axis=0)
        return (self.differences(found, before) / self._scales).reshape(len(q), len(moves), len(self._scales))

    def _by_coordinates(self, q: Matrix) -> Array:
        """Return the derivatives of the commands by the coordinates, both scaled, by differences, shape=(n, u, k)."""
        n, k = len(q), len(self._units)
        moves = np.concatenate([np.zeros((1, k)), _SMALL * np.diag(self._units)])  # the first closes fully
        beside = (self._coordinates(q)[:, None] + moves).reshape(-1, k)
        found = self._solver.first_order(beside, np.repeat(q, k + 1, axis=0)).reshape(n, k + 1, q.shape[1])
        before = np.repeat(self._robot.read(self._robot.command_coordinates, found[:, 0]), k, axis=0)
        changes = self.differences(found[:, 1:].reshape(n * k, q.shape[1]), before) / self._scales
        return np.swapaxes(changes.reshape(n, k, len(self._scales)), 1, 2) / _SMALL

    def _curvatures(self, q: Matrix, left: Matrix) -> Array:
        """Return the sums of second derivatives of the commands times what they are off, shape=(n, k, k)."""
        k = len(self._units)
        first, second = np.triu_indices(k)
        along = _VISIBLE * np.eye(k)
        sums = np.einsum("nmu,nu->nm", self._read(q, np.concatenate([along, along[first] + along[second]])), left)
        curvatures = np.empty((len(q), k, k))
        curvatures[:, first, second] = (sums[:, k:] - sums[:, first] - sums[:, second]) / _VISIBLE**2
        curvatures[:, second, first] = curvatures[:, first, second]
        return np.where(np.isfinite(curvatures).all(axis=(1, 2), keepdims=True), curvatures, 0.0)

    def _least_squares(self, commands: Matrix, starts: Matrix, *, keep_branch: bool) -> Matrix:
        """Return the poses that meet commands by least squares; NaN where they do not settle.

        By Gauss-Newton steps, and by Newton's where these shrink slowly: near singular poses, what the commands are off
        curves the sum of squares as much as their derivatives do.
        """

        def misfits(q: Matrix, rows: Indices) -> Matrix:
            return self.differences(q, commands[rows]) / self._scales

        values = np.array(self._coordinates(starts))
        q = self._solver.walk(values, starts, keep_branch=False).q
        rows, settled = np.flatnonzero(np.isfinite(q).all(axis=1)), np.zeros(len(q), dtype=bool)
        left, k = misfits(q, np.arange(len(q))), len(self._units)
        slopes, curvatures = np.empty((*left.shape, k)), np.zeros((len(q), k, k))
        last = before = np.full(len(q), np.inf)  # steps
        for _ in range(_STEPS):
            # the error by derivatives of the step before is what the commands are off times that step
            changed = rows[~(last[rows] * np.linalg.norm(left[rows], axis=1) <= _SETTLED)]
            slopes[changed] = self._by_coordinates(q[changed])
            rows = rows[np.isfinite(slopes[rows]).all(axis=(1, 2))]
            if not rows.size:
                break
            slow = rows[(last[rows] > _SLOWLY * before[rows]) & (last[rows] < _NEAR)]
            curvatures[slow] = self._curvatures(q[slow], left[slow])
            transposed = np.swapaxes(slopes[rows], 1, 2)
            sizes, axes = np.linalg.eigh(transposed @ slopes[rows] + curvatures[rows])
            sizes = np.maximum(np.abs(sizes), np.finfo(float).eps * np.abs(sizes).max(axis=1, keepdims=True))
            pulls = np.swapaxes(axes, 1, 2) @ (transposed @ left[rows, :, None])
            steps: Array = -(axes @ (pulls / sizes[:, :, None]))[:, :, 0]
            steps /= np.maximum(1.0, np.abs(steps).max(axis=1, initial=0.0) / _FARTHEST)[:, None]
            lengths = np.abs(steps).max(axis=1, initial=0.0)
            tiny, waiting = lengths < _SMALL, np.arange(len(rows))
            for factor in _SHORTER:
                own = rows[waiting]
                tried = values[own] + factor * steps[waiting] * self._units
                reached = self._solver.walk(tried, q[own], keep_branch=keep_branch).q
                after = misfits(reached, own)
                # sums of squares do not tell tiny steps from rounding
                most = np.linalg.norm(left[own], axis=1) + np.where(tiny[waiting], _SMALL, 0.0)
                lower = np.linalg.norm(after, axis=1) < most  # false where not reached
                better = own[lower]
                values[better], q[better], left[better] = tried[lower], reached[lower], after[lower]
                waiting = waiting[~lower]
                if not waiting.size:
                    break
            stuck = np.isin(np.arange(len(rows)), waiting)
            done = (lengths < _SETTLED) | (tiny & (stuck | (lengths > 0.5 * last[rows])))
            settled[rows[done]] = True
            before = last.copy()
            last[rows] = lengths
            rows = rows[~done & ~stuck]
        return np.where(settled[:, None], q, np.nan)
