"""Solving many poses by compiled programs: walks from home, and marches over grids.

A *walk* follows a straight line in coordinate space from its start, in legs short enough to stay in one assembly mode.
A *march* fills a product grid outward from its point nearest to home, axis by axis: each pose starts from a prediction
by its neighbours on a line. Newton steps are programs of :mod:`pm3dof_pin.programs.closing`, and lines are followed in
machine code.

A pose is accepted if the loops are closed to rounding, the joints are near their predictions, no closing system is
singular or has changed its orientation, and the pose is on the branch of the walk's start
(:mod:`pm3dof_pin.kinematics.branches`). Otherwise the walk is repeated in shorter legs; poses that a march leaves
unsolved are walked to from home and from solved neighbours. A walk may end at a singular pose but does not pass it:
poses beyond are on another branch and stay unsolved.

For serial arms, which can pass singular poses, and guesses with open loops, damped steps are taken. If these settle
with an error, the pose is unsolved; if they do not settle, the solver
:func:`~pm3dof_pin.kinematics.assembly.assemble` on Pinocchio's Jacobians decides.

The result for a pose depends on the mechanism, the coordinates and the grid (or the part of it that is marched), but
not on the number of threads or on other poses of a walk.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pm3dof_pin.arrays import frozen
from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.exceptions import PM3DofError, ProgramError
from pm3dof_pin.kinematics.branches import start_of
from pm3dof_pin.kinematics.closing_programs import BoundProgram, program_source
from pm3dof_pin.kinematics.grid import Grid
from pm3dof_pin.kinematics.null_motions import NullMotions
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.pose_search import Solution, find_poses, waypoints
from pm3dof_pin.kinematics.reference import assemble_at
from pm3dof_pin.programs.closing import Task, regularity_and_mode
from pm3dof_pin.programs.llvm import Walked
from pm3dof_pin.programs.llvm_ir import HISTORY
from pm3dof_pin.programs.walk import NEARLY_CLOSED, REACHED, SHORTEST_LEG, WALK
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_SHORTEST_QUICK_LEG = 0.25  # relative to the usual one
_LAST_STEPS = 50  # of damped poses: near a singular pose the first steps only halve the distance
_DAMPED_STEPS = 50  # per round
_DAMPED_ROUNDS = 20
_AT_REST = 0.99  # ratio of squared errors after and before a round that has settled
_DAMPING = 0.1  # of the first damped step
_MAX_SHARE = 20.0  # largest weight in a prediction; that of equally spaced poses is 6
_AT_ONCE = 4096  # poses per block, to stay in cache
_ISLANDS = 100  # points of a grid, evenly taken from those not reached, that are sought one by one


class Continuation:
    """Finds poses of a robot at values of some coordinates, by continuation from home.

    Raises:
        ProgramError: there is no program for the robot, or it disagrees with Pinocchio.
    """

    def __init__(self, robot: PlacedMechanism, coordinates: Sequence[Coordinate]) -> None:
        self._robot = mechanism = robot
        self._nq = mechanism.model.nq
        self._coordinates = tuple(coordinates)
        self._given = [mechanism.single_joint(c.joint) for c in self._coordinates if c.joint is not None]
        self._tool = tuple(c.tool for c in self._coordinates if c.tool is not None)
        # the program's order of the coordinates: joints first
        self._order = sorted(range(len(self._coordinates)), key=lambda k: self._coordinates[k].joint is None)
        self._offsets = np.array([c.offset for c in self._coordinates])
        self._scales = np.array([c.scale for c in self._coordinates])
        self._source = source = program_source(robot)
        self._task = Task.from_coordinates(self._coordinates)
        self._step = source.walk(robot, self._task)
        self._checks = source.checks(robot)
        self._null_motions: NullMotions | None = None
        if robot.has_branches and robot.has_null_motions(self._coordinates):
            commands = robot.placing_commands
            solver = Continuation(robot, commands)
            self._null_motions = NullMotions(robot, self._coordinates, commands, solver, self.read)

    @property
    def operations(self) -> int:
        """How many operations a Newton step takes."""
        return len(self._step.compiled.program.codes)

    @cached_property
    def _damped_step(self) -> BoundProgram | None:
        """None if it is too long to be compiled: then the solver on Pinocchio's Jacobians takes its place."""
        with suppress(ProgramError):
            return self._source.damped_step(self._robot, self._task)
        return None

    @property
    def has_damped_steps(self) -> bool:
        """Whether :meth:`ends` takes steps by a program, not one by one on Pinocchio's Jacobians."""
        return self._damped_step is not None

    @cached_property
    def _sides(self) -> BoundProgram | None:
        """Tells sides of singular configurations apart where the mode does not, see :meth:`ProgramSource.sides`."""
        return self._source.sides(self._robot, self._task)

    @cached_property
    def _home(self) -> Vector:
        """The configuration from which poses are reached."""
        return start_of(self._robot)

    @cached_property
    def _home_mode(self) -> float:
        return float(self._regularity_and_mode(self._home[None])[1][0])

    def _regularity_and_mode(self, q: Matrix, values: Matrix | None = None) -> tuple[Vector, Vector]:
        """Return both at q, with the coordinates at these values."""
        outputs = self._step(self._inputs(q, self._given_numbers(self.read(q) if values is None else values)))
        return regularity_and_mode(outputs[:, self._nq])

    def read(self, q: Matrix) -> Matrix:
        """Return the coordinates of configurations, closed or nearly so, shape=(n, number of coordinates) [m, rad]."""
        placed = self._checks.compiled.program.split(self._checks(q))["transform"] if self._tool else None
        return self._robot.read(self._coordinates, q, placed)

    # walking

    def walk(
        self,
        targets: Matrix,
        starts: Matrix | None = None,
        *,
        thorough: bool = True,
        home_too: bool = True,
        keep_branch: bool = True,
    ) -> Solution:
        """Find the poses at targets [m, rad], see :class:`~pm3dof_pin.kinematics.pose_search.Solver`.

        If not `thorough`, a walk in trouble is abandoned: faster if many poses are out of reach, but may miss poses
        next to singular ones.
        """
        targets = np.asarray(targets, dtype=float)
        q = np.tile(self._home, (len(targets), 1)) if starts is None else np.array(starts, dtype=float)
        for first in range(0, len(q), _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            if self._null_motions is not None:
                q[part] = self._null_motions.poses(targets[part], q[part], keep_branch=keep_branch)
            elif thorough:
                self._solve_each(q[part], targets[part], home_too=home_too, keep_branch=keep_branch)
            else:
                q[part] = self._reached(q[part], targets[part], _SHORTEST_QUICK_LEG, keep_branch=keep_branch)[0]
        return self._check(q, targets)

    def first_order(self, targets: Matrix, starts: Matrix) -> Matrix:
        """Return the ends of one Newton step, see :class:`~pm3dof_pin.kinematics.pose_search.Solver`."""
        return self._step(self._inputs(starts, self._given_numbers(targets)))[:, : self._nq]

    @cached_property
    def lattice(self) -> tuple[Matrix, Matrix]:
        """Values and poses of a lattice around home, or at random commands of drives with null motions."""
        if self._null_motions is not None:
            return self._null_motions.samples()
        return waypoints(
            self._robot, self._coordinates, self._home, lambda starts, targets: self._reached(starts, targets)[0]
        )

    def _solve_each(self, q: Matrix, targets: Matrix, *, home_too: bool = False, keep_branch: bool = True) -> None:
        """Walk from q to the targets, in place; permitted damped steps start from there and from home."""
        found, ends = self._reached(q, targets, keep_branch=keep_branch)
        failed = np.flatnonzero(np.isnan(found[:, 0]) & np.isfinite(q[:, 0]))
        if self._robot.has_branches and failed.size:
            failed = failed[np.isnan(self._check(q[failed]).q[:, 0])]  # open at the start
        if failed.size:
            found[failed] = self._damped(ends[failed], targets[failed], home_too=home_too)
        q[:] = found

    def _reached(
        self, q: Matrix, targets: Matrix, shortest: float = SHORTEST_LEG, *, keep_branch: bool = True
    ) -> tuple[Matrix, Matrix]:
        """Walk to targets; return the poses there, NaN where none is on the branch, and the ends of the walks."""
        walked = self._walked(q, targets, shortest)
        reached = walked.status == REACHED
        if keep_branch and self._robot.has_branches and (rows := np.flatnonzero(reached)).size:
            others = rows[self._branches(walked.q[rows]) != self._branches(q[rows])]
            # at a singular pose signs are undefined
            reached[others] = self._regularity_and_mode(walked.q[others])[0] <= WALK.regularity
        return np.where(reached[:, None], walked.q, np.nan), walked.q

    def _branches(self, q: Matrix) -> Vector:
        """Return the branch numbers of closed configurations, see :mod:`~pm3dof_pin.kinematics.branches`."""
        program = self._checks.compiled.program
        numbers: Vector = self._checks(q)[:, program.slices["branch"].start]
        return numbers

    @cached_property
    def _home_branch(self) -> np.int64:
        """Number of home's branch in the programs, which are the prototype's; zero unless its home is another."""
        return np.int64(self._branches(self._home[None])[0])

    def _damped(self, q: Matrix, targets: Matrix, *, home_too: bool = False) -> Matrix:
        """Return the poses found by damped steps from q or else from home; NaN where these settle with an error.

        Where they do not settle, the damped solver on Pinocchio's Jacobians decides.
        """
        found = np.full_like(q, np.nan)
        numbers = self._given_numbers(targets)
        guesses = [q]
        if home_too:
            with suppress(PM3DofError):  # then poses are reached from guesses only
                guesses.append(np.tile(self._home, (len(q), 1)))
        for starts in guesses:
            rows = np.flatnonzero(np.isnan(found[:, 0]) & np.isfinite(numbers).all(axis=1))
            ends, moving = self._damped_ends(starts[rows], numbers[rows])
            closed = self._residuals(ends, targets[rows]) <= self._robot.closure_tolerance
            undecided = ~closed & moving
            for k in np.flatnonzero(undecided):
                result = assemble_at(self._robot, self._coordinates, targets[rows[k]], starts[rows[k]])
                ends[k] = result.configuration.q if result.converged else np.nan
            found[rows] = np.where((closed | undecided)[:, None], ends, np.nan)
        return found

    def ends(self, starts: Matrix, targets: Matrix) -> Matrix:
        """Return the closed configurations at targets that damped steps from starts lead to, on whatever branch.

        NaN where these do not close the loops. Shapes (n, nq) and (n, number of coordinates) [m, rad].
        """
        if self._damped_step is None:
            return self._damped(starts, targets)
        q, _ = self._damped_ends(starts, self._given_numbers(targets))
        closed = self._residuals(q, targets) <= self._robot.closure_tolerance
        return np.where(closed[:, None], q, np.nan)

    def _damped_ends(self, q: Matrix, numbers: Matrix) -> tuple[Matrix, Mask]:
        """Take damped steps until the error no longer falls, then Newton steps; return q, and where it still falls."""
        nq, step = self._nq, self._damped_step
        if step is None:
            return np.array(q), np.ones(len(q), dtype=bool)
        inputs = np.hstack([q, q, np.tile([_DAMPING, np.inf], (len(q), 1)), numbers])
        rows = np.arange(len(q))
        for _ in range(_DAMPED_ROUNDS):
            before = inputs[rows, 2 * nq + 1]
            states, residuals = step.iterate(inputs[rows], NEARLY_CLOSED, _DAMPED_STEPS)
            inputs[rows, : 2 * nq + 2] = states
            rows = rows[(residuals > NEARLY_CLOSED) & (states[:, 2 * nq + 1] < _AT_REST * before)]
            if not rows.size:
                break
        moving = np.zeros(len(q), dtype=bool)
        moving[rows] = True
        ends = np.array(inputs[:, :nq])
        near = np.flatnonzero(inputs[:, 2 * nq + 1] < NEARLY_CLOSED)
        inputs = self._inputs(ends[near], numbers[near])
        ends[near] = self._step.iterate(inputs, self._robot.closure_tolerance, _LAST_STEPS)[0][:, :nq]
        return ends, moving

    def _residuals(self, q: Matrix, targets: Matrix) -> Vector:
        """Return the largest errors of closures and tool, shape=(n,) [m, rad]."""
        outputs = self._step(self._inputs(q, self._given_numbers(targets)))
        residuals: Vector = outputs[:, -1]
        return residuals

    def _walked(self, q: Matrix, targets: Matrix, shortest: float = SHORTEST_LEG) -> Walked:
        """Walk as far as possible."""
        return self._step.walk(q, self._given_numbers(targets), shortest, self._robot.closure_tolerance)

    # marching

    def march(self, grid: Grid, threads: int | None = None, *, keep_branch: bool = True) -> Solution:
        """Find the poses of a product grid, flat, in the order of `grid.values`; `keep_branch` as in :meth:`walk`.

        Poses depend on the whole grid: a part marched alone may differ in the last digits, since its poses start from
        other neighbours.
        """
        shape, values = grid.shape, np.reshape(grid.values, (*grid.shape, -1))
        names = [coordinate.name for coordinate in self._coordinates]
        at_home = dict(zip(names, self.read(self._home[None])[0], strict=True))
        first = tuple(int(np.abs(axis - at_home[name]).argmin()) for name, axis in grid.axes.items())
        q = np.empty((*shape, self._nq))  # filled completely below
        nearest = self._home[None].copy()
        if self._null_motions is None:
            self._solve_each(nearest, values[first][None], home_too=True, keep_branch=keep_branch)
        else:
            target = values[first][None]
            nearest = find_poses(self._robot, self._coordinates, target, None, self, keep_branch=keep_branch).q
        q[first] = nearest[0]
        numbers = self._given_numbers(values)
        for dimension, axis in enumerate(grid.axes.values()):
            part: tuple[Any, ...] = (*[slice(None)] * (dimension + 1), *first[dimension + 1 :])
            lines, given = (x[part].reshape(math.prod(shape[:dimension]), len(axis), -1) for x in (q, numbers))
            start = first[dimension]
            self._march_lines(lines[:, start:], given[:, start:], axis[start:], 1, threads)
            known = min(HISTORY + 1, len(axis) - start)
            back = slice(start + known - 1, None, -1)
            self._march_lines(lines[:, back], given[:, back], axis[back], known, threads)
        flat_values = values.reshape(-1, values.shape[-1])
        solution = self._check(q.reshape(-1, self._nq), flat_values, placed=False, threads=threads)
        q = solution.q.reshape(q.shape)
        if keep_branch:
            self._leave_branch(q, solution.branch, first)
        if not np.isnan(q[..., 0]).any():
            return solution
        self._fill(q, values, keep_branch=keep_branch)
        return self._check(q.reshape(-1, self._nq), flat_values, placed=False, threads=threads)

    def _leave_branch(self, q: Array, branch: NDArray[np.int64] | None, first: tuple[int, ...]) -> None:
        """Make the points of a march NaN that do not follow only points on the branch, outward from `first`."""
        if self._sides is None and (branch is None or not branch.any()):
            return
        kept = np.ones(q.shape[:-1], dtype=bool) if branch is None else np.reshape(branch == 0, q.shape[:-1])
        for dimension, start in enumerate(first):
            part: tuple[Any, ...] = (*[slice(None)] * (dimension + 1), *first[dimension + 1 :])
            line, poses = kept[part], q[part]
            if self._sides is not None:
                line[..., start + 1 :] &= self._same_side(poses[..., start + 1 :, :], poses[..., start:-1, :])
                line[..., :start] &= self._same_side(poses[..., :start, :], poses[..., 1 : start + 1, :])
            line[..., start:] = np.logical_and.accumulate(line[..., start:], axis=-1)
            line[..., start::-1] = np.logical_and.accumulate(line[..., start::-1], axis=-1)
        q[~kept] = np.nan

    def _same_side(self, q: Array, before: Array) -> Mask:
        """Return whether no overconstrained system is singular between neighbours, shape=(..., nq) each."""
        assert self._sides is not None
        pairs = np.concatenate([q, before], axis=-1)
        outputs = self._sides(pairs.reshape(-1, 2 * self._nq))
        same: Mask = outputs[:, 0].reshape(pairs.shape[:-1]) > 0.5
        return same

    def _march_lines(self, lines: Array, numbers: Array, axis: Vector, known: int, threads: int | None) -> None:
        """March along lines of a grid, in place, shape=(n, points, nq); the first points are known."""
        compiled, parameters = self._step
        compiled.march(
            *(lines, numbers, parameters, _shares(axis.tobytes())[known:]),
            mode=self._home_mode,
            threads=threads,
        )

    def _fill(self, q: Array, values: Array, *, keep_branch: bool) -> None:
        """Find poses that a march left unsolved, in place.

        By walks from home, then from solved neighbours and, for some of those without, as single poses are found.
        """
        missing = np.isnan(q[..., 0])
        home = np.tile(self._home, (int(missing.sum()), 1))
        q[missing] = self._reached(home, values[missing], keep_branch=keep_branch)[0]
        untried, islands = np.isnan(q[..., 0]), True
        while untried.any():
            starts = _solved_neighbours(q)
            frontier = untried & np.isfinite(starts[..., 0])
            if not frontier.any():
                if not self._robot.has_branches:
                    q[untried] = self._damped(
                        np.tile(self._home, (int(untried.sum()), 1)), values[untried], home_too=False
                    )
                elif islands and self._null_motions is None:
                    points = np.argwhere(untried)
                    some = tuple(points[:: max(1, len(points) // _ISLANDS)].T)
                    q[some] = find_poses(
                        self._robot, self._coordinates, values[some], None, self, keep_branch=keep_branch
                    ).q
                    untried[some], islands = False, False
                    continue
                return
            untried &= ~frontier
            found = starts[frontier]
            self._solve_each(found, values[frontier], keep_branch=keep_branch)
            if self._null_motions is not None:  # joints kept at rest make poses singular that are not
                lost = np.isnan(found[:, 0])
                targets, neighbours = values[frontier][lost], starts[frontier][lost]
                found[lost] = self._null_motions.poses(targets, neighbours, keep_branch=keep_branch)
            q[frontier] = found

    def _given_numbers(self, values: Array) -> Array:
        """Return coordinates in the form the program takes."""
        is_ordered = self._order == list(range(len(self._order)))
        numbers: Array = np.array(values, dtype=float) if is_ordered else np.take(values, self._order, axis=-1)
        for column, k in enumerate(self._order):  # one by one: over an axis of three it takes three times as long
            if self._offsets[k]:
                numbers[..., column] -= self._offsets[k]
            if self._scales[k] != 1.0:
                numbers[..., column] /= self._scales[k]
        return numbers

    def _inputs(self, q: Matrix, numbers: Matrix) -> Matrix:
        nq = self._nq
        inputs = np.empty((len(q), nq + 2 + numbers.shape[1]))
        inputs[:, :nq] = q
        inputs[:, nq : nq + 2] = 1.0, 0.0
        inputs[:, nq + 2 :] = numbers
        return inputs

    def _check(
        self, q: Matrix, values: Matrix | None = None, *, placed: bool = True, threads: int | None = None
    ) -> Solution:
        """Check configurations, tool values included; unsolved ones become NaN in a copy."""
        n, program = len(q), self._checks.compiled.program
        residual, broken = np.empty(n), np.empty(n, dtype=np.uint32)
        branch = np.empty(n, dtype=np.int64) if "branch" in program.outputs else None
        transforms = np.empty((n, 4, 4)) if placed and "transform" in program.outputs else None
        room = np.empty((min(n, _AT_ONCE), len(program.results)))
        for first in range(0, n, _AT_ONCE):
            part = slice(first, first + _AT_ONCE)
            outputs = program.split(self._checks(q[part], room[: len(q[part])], threads))
            broken[part] = outputs["broken"]
            if branch is not None:
                branch[part] = outputs["branch"].astype(np.int64) ^ self._home_branch
            if values is not None and self._tool:
                residual[part] = self._residuals_of_placed(q[part], values[part], outputs)
            else:
                residual[part] = outputs["residual"]
            if transforms is not None:
                transforms[part] = outputs["transform"]
        unsolved = ~(residual <= self._robot.closure_tolerance)
        if unsolved.any():
            q = q.copy()
            q[unsolved], residual[unsolved], broken[unsolved] = np.nan, np.nan, 1
            if transforms is not None:
                transforms[unsolved] = np.nan
            if branch is not None:
                branch[unsolved] = 0
        return Solution(q, residual, broken, transforms, branch)

    def _residuals_of_placed(self, q: Matrix, values: Matrix, outputs: dict[str, Array]) -> Vector:
        """Return the same as :meth:`_residuals`, from the checks if only the tool's position is given."""
        if not set(self._tool) <= {"x", "y", "z"}:
            return self._residuals(q, values)
        numbers = self._given_numbers(values)[:, len(self._given) :]
        place = outputs["transform"][:, ["xyz".index(component) for component in self._tool], 3]
        residuals: Vector = np.maximum(outputs["residual"], np.abs(place - numbers).max(axis=1))
        return residuals


def _solved_neighbours(q: Array) -> Array:
    """Return for each point of a grid a solved neighbour along some dimension, or NaN."""
    neighbours = np.full_like(q, np.nan)
    for others in _neighbours(q):
        neighbours = np.where(np.isfinite(neighbours), neighbours, others)
    return neighbours


def _neighbours(q: Array) -> Iterator[Array]:
    """Yield for each direction of a grid the neighbours of all points there, NaN at the end."""
    for dimension in range(q.ndim - 1):
        size = q.shape[dimension]
        near, far = slice(0, size - 1), slice(1, size)
        for target, source in ((far, near), (near, far)):
            index: list[slice] = [slice(None)] * q.ndim
            neighbours = np.full_like(q, np.nan)
            index[dimension] = source
            others = q[tuple(index)]
            index[dimension] = target
            neighbours[tuple(index)] = others
            yield neighbours


@lru_cache(maxsize=64)  # parts of a grid share axes
def _shares(values: bytes) -> Matrix:
    """Return minus the weights with which a polynomial through its predecessors predicts each point.

    Shape=(n, HISTORY); zero for missing points, and where the spacing is too uneven for a polynomial.
    """
    axis = np.frombuffer(values)
    shares = np.zeros((len(axis), HISTORY))
    for count in range(2, HISTORY + 2):
        points = np.arange(count, len(axis) if count > HISTORY else min(count + 1, len(axis)))
        back = axis[points[:, None] - np.arange(1, count + 1)]
        gaps = axis[points, None] - back
        for j in range(1, count):
            others = [k for k in range(count) if k != j]
            with np.errstate(divide="ignore", invalid="ignore"):
                shares[points, j - 1] = -np.prod(gaps[:, others] / (back[:, j, None] - back[:, others]), axis=1)
    shares[~(np.abs(shares).max(axis=1) < _MAX_SHARE)] = 0.0
    return frozen(shares)
