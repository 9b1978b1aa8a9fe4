"""Robust solution of poses: on Pinocchio's Jacobians throughout, by continuation from home.

A walk reaches a pose in legs short enough to stay in one assembly mode, each closed by the damped solver of
:mod:`pm3dof_pin.kinematics.assembly`. A leg that leaves a joint far from its prediction, or changes the sign of the
determinant of the equations, is repeated with shorter legs: a walk ends at singular poses. For serial arms, which can
pass these, and guesses with open loops, the solver goes to the pose in one step.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.assembly import CLOSURE_TOLERANCE, Assembly, assemble
from pm3dof_pin.kinematics.units import coordinate_periods, coordinate_scales
from pm3dof_pin.typing import Matrix, Vector

if TYPE_CHECKING:
    from pm3dof_pin.kinematics.robot import Robot

_LEG = 0.25  # for distant poses [rad, characteristic lengths]
_SHORTEST_LEG = 1.0 / 256.0  # relative to that
_FIRST_LEG = 1.0 / 8.0  # relative to it, as there is no prediction yet
_JUMP = 0.5  # largest distance of a joint from its prediction [rad, characteristic lengths]
_STEPS = 20  # per leg, if it may be repeated
_LAST_STEPS = 100
_DEPENDENT = 1e-10  # relative singular value of dependent equations
_SINGULAR = 1e-6  # relative singular value of a singular pose


def close_all(robot: Robot, coordinates: tuple[Coordinate, ...], targets: Matrix, starts: Matrix) -> Matrix:
    """Find closed configurations with coordinates at targets, from starts; shape=(n, nq), NaN where none is found."""
    found = np.full(starts.shape, np.nan)
    for row in np.flatnonzero(np.isfinite(targets).all(axis=1) & np.isfinite(starts).all(axis=1)):
        found[row] = _Walk(robot, coordinates, starts[row]).end(targets[row])
    return found


def assemble_at(
    robot: Robot, coordinates: tuple[Coordinate, ...], values: Vector, guess: Vector, max_steps: int = _LAST_STEPS
) -> Assembly:
    """Close the loops at values of coordinates [m, rad], see :func:`~pm3dof_pin.kinematics.assembly.assemble`."""
    numbers = [(value - c.offset) / c.scale for c, value in zip(coordinates, values, strict=True)]
    joints = {c.joint: x for c, x in zip(coordinates, numbers, strict=True) if c.joint is not None}
    tool = {c.tool: float(x) for c, x in zip(coordinates, numbers, strict=True) if c.tool is not None}
    return assemble(robot, guess, joints=joints, tool=tool, max_steps=max_steps)


class _Walk:
    """A walk from a configuration to values of coordinates."""

    def __init__(self, robot: Robot, coordinates: tuple[Coordinate, ...], start: Vector) -> None:
        self._robot, self._coordinates, self._start = robot, coordinates, start

    def end(self, target: Vector) -> Vector:
        """Return the pose at the target, NaN if none is found."""
        robot, q = self._robot, self._start
        start = robot.configuration(q)
        if not robot.closures or start.closure_residual > CLOSURE_TOLERANCE:
            results = (assemble_at(robot, self._coordinates, target, guess) for guess in (q, robot.home.q))
            return next((result.q for result in results if result.converged), np.full_like(q, np.nan))
        placed = any(coordinate.tool is not None for coordinate in self._coordinates)
        origin = robot.read(self._coordinates, q, start.tool_placement.homogeneous if placed else None)
        way, turns = target - origin, coordinate_periods(robot, self._coordinates)
        angles = np.isfinite(turns)
        way[angles] -= turns[angles] * np.round(way[angles] / turns[angles])  # the shorter direction
        units = coordinate_scales(robot, self._coordinates)
        first = 1.0 / max(np.ceil(np.abs(way / units).max(initial=0.0) / _LEG), 1.0)
        done, step, last = 0.0, _FIRST_LEG * first, assemble_at(robot, self._coordinates, origin, q, 1)
        regularity = _regularity(last)
        rate, narrowing = np.zeros(robot.model.nv), 0.0  # derivatives of q and the regularity along the path
        while done < 1.0:
            reached = min(done + step, 1.0)
            is_last_try = step <= _SHORTEST_LEG * first
            values = target if reached == 1.0 else origin + reached * way
            steps = _LAST_STEPS if is_last_try else _STEPS
            guess = pin.integrate(robot.model, q, rate * (reached - done))
            result = None
            if regularity + narrowing * (reached - done) > 0.0:
                result = assemble_at(robot, self._coordinates, values, guess, steps)
            if result is not None and self._continues(last, guess, result, is_end=reached == 1.0):
                found = _regularity(result)
                rate = pin.difference(robot.model, q, result.q) / (reached - done)
                narrowing = (found - regularity) / (reached - done)
                q, done, step = result.q, reached, min(4.0 * step, first)
                last, regularity = result, found
            elif is_last_try:
                return np.full_like(q, np.nan)
            else:
                step *= 0.25
        return q

    def _continues(self, last: Assembly, guess: Vector, result: Assembly, *, is_end: bool) -> bool:
        """Return whether a leg ended near its guess and stayed in its assembly mode; it may end at a singular pose.

        The determinant of the equations that were independent at its start, over the motions they determined, keeps
        its sign unless a singular pose was passed. There may be more equations or motions.
        """
        robot = self._robot
        moves = pin.difference(robot.model, guess, result.q) / robot.velocity_scale
        if not result.converged or np.abs(moves).max(initial=0.0) > _JUMP:
            return False
        left, values, right = last.factors
        kept = values > _DEPENDENT * values.max(initial=0.0)
        turned = left[:, kept].T @ result.jacobian @ right[kept].T
        if np.linalg.slogdet(turned)[0] >= 0.0:
            return True
        sizes = np.linalg.svd(turned, compute_uv=False)
        return is_end and bool(sizes.min() <= _SINGULAR * sizes.max())


def _regularity(assembly: Assembly) -> float:
    """Return the least singular value other than those of dependent equations, at most 1."""
    values = assembly.factors[1]
    return float(values[values > _DEPENDENT * values.max(initial=0.0)].min(initial=1.0))
