"""Poses of robots whose drives can move while the tool rests, sought over the commands.

Many commands put the tool at a pose, and any of them serves. From a start they are reached by steps of least norm, in
joint units (radians, characteristic lengths), each followed by a walk at the new commands: loops stay closed and on
their branch, and no joint has to be kept at rest, which would make poses singular that are not.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import cached_property

import numpy as np

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import ProgramError
from pm3dof_pin.kinematics.closing_programs import BoundProgram
from pm3dof_pin.kinematics.jacobian_programs import bound_jacobian, rate_of_coordinate
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.pose_search import Solver
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales
from pm3dof_pin.typing import Array, Matrix

_SAMPLES = 1000  # poses all over the reach, of which the nearest ones are starts
_WIDTH = 3.0  # of commands without limits on both sides of home [characteristic lengths]
_STEPS = 15
_SHORTER = (1.0, 0.5, 0.25, 0.1, 0.02)  # factors tried in turn on a step that does not reduce the error
_FARTHEST = 0.3  # of a command in one step [rad, characteristic lengths]
_SMALL = 1e-6  # of a command, for differences [rad, characteristic lengths]
_SINGULAR = 1e-4  # relative singular value of directions in which the tool cannot move
_REACHED = 1e-10  # error of a pose that counts as reached [rad, characteristic lengths]
_EXACT = 1e-12  # error at which steps end, the same


class NullMotions:
    """Poses at coordinates of the tool that leave some motions of the drives free.

    Args:
        robot: the robot.
        coordinates: the coordinates.
        commands: those of the drives that place the robot.
        solver: finds poses at these commands.
        read: function of configurations, shape=(n, nq), that returns the coordinates there, shape=(n, k).
    """

    def __init__(
        self,
        robot: PlacedMechanism,
        coordinates: Sequence[Coordinate],
        commands: Sequence[Coordinate],
        solver: Solver,
        read: Callable[[Matrix], Matrix],
    ) -> None:
        self._robot, self._solver, self._read = robot, solver, read
        self._coordinates, self._commands = tuple(coordinates), tuple(commands)
        self._units = coordinate_scales(robot, tuple(commands))
        self._scales = coordinate_scales(robot, tuple(coordinates))
        self._periods = coordinate_periods(robot, tuple(coordinates))

    def samples(self) -> tuple[Matrix, Matrix]:
        """Return values of the coordinates, shape=(m, k), and poses, shape=(m, nq), at random commands within limits.

        Commands without limits are taken up to half a turn, or three characteristic lengths, from home.
        """
        robot = self._robot
        home = robot.read(self._commands, robot.home.q[None])[0]
        width = np.array([_WIDTH if c.unit == "m" else np.pi for c in self._commands]) * self._units
        lower, upper = np.transpose([robot.range_of(command) for command in self._commands])
        first, last = (np.where(np.isfinite(x), x, home + far) for x, far in ((lower, -width), (upper, width)))
        drawn = np.random.default_rng(0).uniform(first, last, (_SAMPLES, len(home)))
        q = self._solver.walk(drawn, np.tile(robot.home.q, (_SAMPLES, 1))).q
        q = q[np.isfinite(q[:, 0])]
        return self._read(q), q

    def poses(self, targets: Matrix, starts: Matrix, *, keep_branch: bool) -> Matrix:
        """Return poses at targets, shape=(n, k), from starts, shape=(n, nq); NaN where the steps do not lead there."""
        commands = np.asarray(self._robot.read(self._commands, starts))
        q = self._solver.walk(commands, starts, keep_branch=False).q  # open loops are closed
        error = self._errors(q, targets)
        rows = np.flatnonzero(np.isfinite(error).all(axis=1))
        for _ in range(_STEPS):
            rows = rows[np.abs(error[rows]).max(axis=1, initial=0.0) > _EXACT]
            slopes = self._by_commands(q[rows], commands[rows])
            regular = np.isfinite(slopes).all(axis=(1, 2))  # the loops' system may be singular
            rows = rows[regular]
            if not rows.size:
                break
            inverse = np.linalg.pinv(slopes[regular], rcond=_SINGULAR)
            steps = np.einsum("nij,nj->ni", inverse, error[rows])
            steps /= np.maximum(1.0, np.abs(steps).max(axis=1, initial=0.0) / _FARTHEST)[:, None]
            waiting = np.arange(len(rows))
            for factor in _SHORTER:
                own = rows[waiting]
                tried = commands[own] + factor * steps[waiting] * self._units
                reached = self._solver.walk(tried, q[own], keep_branch=keep_branch).q
                after = self._errors(reached, targets[own])
                lower = np.linalg.norm(after, axis=1) < np.linalg.norm(error[own], axis=1)  # false where not reached
                better = own[lower]
                q[better], commands[better], error[better] = reached[lower], tried[lower], after[lower]
                waiting = waiting[~lower]
                if not waiting.size:
                    break
            rows = np.delete(rows, waiting)
        return np.where((np.abs(error).max(axis=1, initial=0.0) <= _REACHED)[:, None], q, np.nan)

    def _errors(self, q: Matrix, targets: Matrix) -> Matrix:
        """Return the scaled errors of the coordinates, shape=(n, k); NaN where there is no pose."""
        errors = np.full_like(targets, np.nan)
        known = np.isfinite(q[:, 0])
        errors[known] = self._changes(self._read(q[known]), targets[known])
        return errors

    def _changes(self, before: Array, after: Array) -> Array:
        """Return scaled changes of the coordinates, the shorter way round."""
        turns = np.where(np.isfinite(self._periods), self._periods, 0.0)
        changes = after - before
        changes = changes - turns * np.round(changes / np.where(turns > 0.0, turns, 1.0))
        return np.asarray(changes / self._scales)

    @cached_property
    def _jacobian(self) -> BoundProgram | None:
        """None if it cannot be recorded, or is too long to be compiled: then differences take its place."""
        of, by = (tuple(map(rate_of_coordinate, rates)) for rates in (self._coordinates, self._commands))
        with suppress(ProgramError):
            return bound_jacobian(self._robot, of, by, with_derivatives=False)
        return None

    def _by_commands(self, q: Matrix, commands: Matrix) -> Array:
        """Return the derivatives of the coordinates by the commands, both scaled, shape=(n, k, u)."""
        if self._jacobian is None:
            return self._differences(q, commands)
        values, sound = self._jacobian.with_doubt(q)
        slopes = values.reshape(len(q), len(self._scales), len(self._units)) * self._units / self._scales[:, None]
        if not sound.all():
            slopes[~sound] = self._differences(q[~sound], commands[~sound])
        return np.asarray(slopes)

    def _differences(self, q: Matrix, commands: Matrix) -> Array:
        """Return the same by differences."""
        n, u = commands.shape
        moves = np.concatenate([np.zeros((1, u)), _SMALL * np.diag(self._units)])  # the first closes fully
        beside = (commands[:, None] + moves).reshape(-1, u)
        found = self._solver.first_order(beside, np.repeat(q, u + 1, axis=0))
        values = self._read(found).reshape(n, u + 1, len(self._scales))
        return np.swapaxes(self._changes(values[:, :1], values[:, 1:]), 1, 2) / _SMALL
