"""The reference engine: poses one by one, on Pinocchio's Jacobians throughout, by continuation from home.

A walk reaches a pose in legs short enough to stay in one assembly mode, each closed by the damped solver of
:mod:`pm3dof_pin.kinematics.assembly`. A leg that leaves a joint far from its prediction, or changes the sign of the
determinant of the equations, or the branch, is repeated with shorter legs, which do not go beyond the other branch: a
walk ends at singular poses. For serial arms, which can pass these, and guesses with open loops, the solver goes to the
pose in one step. It shares no computation with the programs, which are held against it.
"""

from __future__ import annotations

from contextlib import suppress
from functools import cached_property

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.coordinates import Coordinate, pose_in_words
from pm3dof_pin.exceptions import ConvergenceError, PM3DofError
from pm3dof_pin.kinematics.assembly import Assembly, assemble
from pm3dof_pin.kinematics.branches import Branches, branches_of, start_of
from pm3dof_pin.kinematics.placed_mechanism import PlacedMechanism
from pm3dof_pin.kinematics.pose_search import Solution, waypoints
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales
from pm3dof_pin.typing import Matrix, Vector

_LEG = 0.25  # for distant poses [rad, characteristic lengths]
_SHORTEST_LEG = 1.0 / 1024.0  # relative to that
_FIRST_LEG = 1.0 / 8.0  # relative to it, as there is no prediction yet
_JUMP = 0.06  # largest distance of a joint from its prediction [rad, characteristic lengths]
_LEAP = 0.5  # the same of the first leg from the side of a singular home, which may pass that
_NARROWING = 2.0  # greatest usual loss of regularity [1/rad, 1/characteristic length]
_KEPT = 0.5  # part of the regularity that a leg leaves
_STEPS = 8  # per leg, if it may be repeated
_LAST_STEPS = 100
_DEPENDENT = 1e-10  # relative singular value of dependent equations
_SINGULAR = 1e-6  # relative singular value of a singular pose


def assemble_at(
    robot: PlacedMechanism,
    coordinates: tuple[Coordinate, ...],
    values: Vector,
    guess: Vector,
    max_steps: int = _LAST_STEPS,
) -> Assembly:
    """Close the loops at values of coordinates [m, rad], see :func:`~pm3dof_pin.kinematics.assembly.assemble`."""
    numbers = [(value - c.offset) / c.scale for c, value in zip(coordinates, values, strict=True)]
    joints = {c.joint: x for c, x in zip(coordinates, numbers, strict=True) if c.joint is not None}
    tool = {c.tool: float(x) for c, x in zip(coordinates, numbers, strict=True) if c.tool is not None}
    return assemble(robot, guess, joints=joints, tool=tool, max_steps=max_steps)


class Reference:
    """Finds poses of a robot at values of some coordinates, one by one."""

    def __init__(self, robot: PlacedMechanism, coordinates: tuple[Coordinate, ...]) -> None:
        self._robot, self._coordinates = robot, coordinates

    def walk(
        self, targets: Matrix, starts: Matrix | None = None, *, home_too: bool = True, keep_branch: bool = True
    ) -> Solution:
        """Find the poses at targets, see :class:`~pm3dof_pin.kinematics.pose_search.Solver`."""
        home: Vector | None = None
        if starts is not None and home_too:
            with suppress(PM3DofError):  # then poses are reached from guesses only
                home = start_of(self._robot)
        given = np.tile(start_of(self._robot), (len(targets), 1)) if starts is None else starts
        found = np.full(given.shape, np.nan)
        branches = self._branches(given) if keep_branch and self._robot.has_branches else None
        for row in np.flatnonzero(np.isfinite(targets).all(axis=1) & np.isfinite(given).all(axis=1)):
            found[row] = _Walk(self._robot, self._coordinates, branches, given[row], home).to(targets[row])
        return Solution(found)

    def first_order(self, targets: Matrix, starts: Matrix) -> Matrix:
        """Return the poses themselves, see :class:`~pm3dof_pin.kinematics.pose_search.Solver`."""
        return self.walk(targets, starts, keep_branch=False).q

    def _branches(self, starts: Matrix) -> Branches | None:
        """Return the branches around home or, if the loops do not close there, around a closed start."""
        try:
            return branches_of(self._robot)
        except ConvergenceError:
            rows = starts[np.isfinite(starts).all(axis=1)]
            around = (self._robot.configuration(q) for q in rows)
            closed = next((start for start in around if start.closure_residual <= self._robot.closure_tolerance), None)
            return None if closed is None else Branches(self._robot, closed)

    def obstacle(self, start: Vector, target: Vector) -> str:
        """Say which singularity a walk to a target meets, and how to go beyond it on purpose."""
        robot, coordinates = self._robot, self._coordinates
        branches = self._branches(start[None])
        walk = _Walk(robot, coordinates, branches, start, None)
        walk.to(target)
        beyond = _Walk(robot, coordinates, None, start, None).to(target)
        pose = pose_in_words(coordinates, _read(robot, coordinates, walk.last).round(6), ".4g")
        kind = "parallel" if coordinates == robot.command_coordinates else "serial"
        if branches is not None and np.isfinite(beyond).all():
            between = branches.kind(beyond, start)
            if between is None:
                return f"ways to it pass singular poses, from home one near {pose}; a guess near it makes it reachable"
            kind = between
        return (
            f"it lies beyond a {kind} singularity, met near {pose}, on another branch; a configuration 'home' of the "
            "description on that branch (pm3dof info --assemble), or a guess there, makes it reachable"
        )

    @cached_property
    def lattice(self) -> tuple[Matrix, Matrix]:
        """Values and poses of a lattice, reached from home by way of neighbours."""
        robot, coordinates = self._robot, self._coordinates
        branches = branches_of(robot)

        def walk(starts: Matrix, targets: Matrix) -> Matrix:
            walks = (
                _Walk(robot, coordinates, branches, start, None).to(x) for start, x in zip(starts, targets, strict=True)
            )
            return np.array(list(walks))

        return waypoints(robot, coordinates, start_of(robot), walk)


def _read(robot: PlacedMechanism, coordinates: tuple[Coordinate, ...], q: Vector) -> Vector:
    placed = any(coordinate.tool is not None for coordinate in coordinates)
    transform = robot.configuration(q).tool_placement.homogeneous if placed else None
    return np.asarray(robot.read(coordinates, q, transform))


class _Walk:
    """A walk from a configuration to values of coordinates, on the branch of its start if branches are given."""

    def __init__(
        self,
        robot: PlacedMechanism,
        coordinates: tuple[Coordinate, ...],
        branches: Branches | None,
        start: Vector,
        home: Vector | None,
    ) -> None:
        self._robot, self._coordinates, self._branches = robot, coordinates, branches
        self._start, self._home = start, home
        self.last: Vector = start  #: the last configuration reached

    def to(self, target: Vector) -> Vector:
        """Return the pose at the target, NaN if none is found."""
        robot, q = self._robot, self._start
        start = robot.configuration(q)
        is_open = start.closure_residual > self._robot.closure_tolerance
        branch = None if is_open or self._branches is None else self._branches.number(q)
        if not robot.has_branches or is_open or robot.has_null_motions(self._coordinates):
            guesses = (q,) if self._home is None else (q, self._home)
            results = (assemble_at(robot, self._coordinates, target, guess) for guess in guesses)
            kept = (result.q for result in results if result.converged and self._keeps(branch, result, is_end=True))
            return next(kept, np.full_like(q, np.nan))
        origin = _read(robot, self._coordinates, q)
        way, turns = target - origin, coordinate_periods(robot, self._coordinates)
        angles = np.isfinite(turns)
        way[angles] -= turns[angles] * np.round(way[angles] / turns[angles])  # the shorter direction
        units = coordinate_scales(robot, self._coordinates)
        length = float(np.abs(way / units).max(initial=0.0))
        first = 1.0 / max(np.ceil(length / _LEG), 1.0)
        done, step, last = 0.0, _FIRST_LEG * first, assemble_at(robot, self._coordinates, origin, q, 1)
        regularity = _regularity(last)
        is_beside = self._branches is not None and not self._branches.start_is_home
        # derivatives of q and the regularity along the path, unknown at first
        rate, narrowing = np.zeros(robot.model.nv), 0.0 if is_beside else -_NARROWING * length
        barrier = np.inf
        while done < 1.0:
            reached = min(done + step, 1.0)
            is_last_try = step <= _SHORTEST_LEG * first
            values = target if reached == 1.0 else origin + reached * way
            steps = _LAST_STEPS if is_last_try else _STEPS
            guess = pin.integrate(robot.model, q, rate * (reached - done))
            result = None
            leaves_singular = is_last_try and done == 0.0 and regularity <= _SINGULAR
            if regularity + narrowing * (reached - done) > 0.0 or leaves_singular:
                result = assemble_at(robot, self._coordinates, values, guess, steps)
            jump = _LEAP if done == 0.0 and is_beside else _JUMP
            if result is not None and self._is_near(guess, result, jump):
                if not self._stays(branch, last, result, is_end=reached == 1.0):
                    barrier = min(barrier, reached)  # a singular pose lies before it, whatever begins there
                found = _regularity(result)
                # from close to a singular pose, one beyond it must not be reached at once
                if reached < barrier and (is_last_try or found >= _KEPT * regularity):
                    rate = pin.difference(robot.model, q, result.q) / (reached - done)
                    narrowing = (found - regularity) / (reached - done)
                    self.last = q = result.q
                    done, step = reached, min(4.0 * step, first)
                    last, regularity = result, found
                    continue
            if is_last_try:
                return np.full_like(q, np.nan)
            step *= 0.25
        return q

    def _keeps(self, branch: int | None, result: Assembly, *, is_end: bool) -> bool:
        """Return whether a pose is on the branch of the start; the end may be a singular pose of the equations."""
        if branch is None or self._branches is None or (is_end and _regularity(result) <= _SINGULAR):
            return True
        return self._branches.number(result.q) == branch

    def _is_near(self, guess: Vector, result: Assembly, jump: float) -> bool:
        """Return whether a leg ended near its guess."""
        moves = pin.difference(self._robot.model, guess, result.q) / self._robot.velocity_scale
        return result.converged and bool(np.abs(moves).max(initial=0.0) <= jump)

    def _stays(self, branch: int | None, last: Assembly, result: Assembly, *, is_end: bool) -> bool:
        """Return whether a leg stayed in its assembly mode and on the branch; it may end at a singular pose.

        The determinant of the equations that were independent at its start, over the motions they determined, keeps
        its sign unless a singular pose was passed. There may be more equations or motions.
        """
        left, values, right = last.factors
        kept = values > _DEPENDENT * values.max(initial=0.0)
        turned = left[:, kept].T @ result.jacobian @ right[kept].T
        if np.linalg.slogdet(turned)[0] < 0.0:
            sizes = np.linalg.svd(turned, compute_uv=False)
            if not (is_end and sizes.min() <= _SINGULAR * sizes.max()):
                return False
        return self._keeps(branch, result, is_end=is_end)


def _regularity(assembly: Assembly) -> float:
    """Return the least singular value other than those of dependent equations, at most 1."""
    values = assembly.factors[1]
    return float(values[values > _DEPENDENT * values.max(initial=0.0)].min(initial=1.0))
