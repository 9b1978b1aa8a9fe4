"""Closing the loops of many poses with care: on Pinocchio's Jacobians throughout, by continuation from home.

All poses walk together, in steps short enough to stay in one assembly mode. A pose at which Newton's method does not
converge goes to the damped solver of :mod:`pm3dof_pin.kinematics.assembly`.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.coordinates import Coordinate
from pm3dof_pin.kinematics.assembly import CLOSURE_TOLERANCE, LONGEST_STEP, assemble
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Array, Matrix, Vector

_NEWTON_STEPS = 8
_NEARLY_CLOSED = 1e-9  # from here one quadratic step ends in rounding
_LONGEST_LEG = 0.25  # of the way to a far pose, so that no other assembly mode is met [rad, characteristic lengths]


def close_all(
    mechanism: Mechanism, home: Vector, coordinates: tuple[Coordinate, ...], targets: Matrix, starts: Matrix | None
) -> tuple[Matrix, Vector]:
    """Find closed configurations with coordinates at targets, from starts or by walks from home.

    Returns q, shape=(n, nq), NaN where none was found, and what was left of the errors there, shape=(n,) [m, rad].
    """
    q = np.array(np.broadcast_to(home, (len(targets), mechanism.model.nq)) if starts is None else starts)
    residuals = np.zeros(len(targets))
    finite = np.isfinite(targets).all(axis=-1) & np.isfinite(q).all(axis=-1)
    q[~finite], residuals[~finite] = np.nan, np.nan
    rows = np.flatnonzero(finite)
    if any(coordinate.tool is not None for coordinate in coordinates):
        for row in rows:
            q[row], residuals[row] = _closed(mechanism, coordinates, targets[row], q[row], home)
    elif rows.size:
        q[rows], residuals[rows] = _JointsGiven(mechanism, coordinates).closed(
            q[rows], targets[rows], starts is None, home
        )
    return q, residuals


def _closed(
    mechanism: Mechanism, coordinates: tuple[Coordinate, ...], target: Vector, start: Vector, home: Vector
) -> tuple[Vector, float]:
    joints = {
        c.joint: (value - c.offset) / c.scale
        for c, value in zip(coordinates, target, strict=True)
        if c.joint is not None
    }
    tool = {c.tool: float(value) for c, value in zip(coordinates, target, strict=True) if c.tool is not None}
    best = np.inf
    for guess in (start, home):
        result = assemble(mechanism, guess, joints=joints, tool=tool)
        if result.converged:
            return np.array(result.configuration.q), result.residual
        best = min(best, result.residual)
    return np.full(mechanism.model.nq, np.nan), best


class _JointsGiven:
    """A mechanism with the coordinates of some joints given, many configurations at a time."""

    def __init__(self, mechanism: Mechanism, coordinates: tuple[Coordinate, ...]) -> None:
        self._mechanism = mechanism
        self._model = mechanism.model
        self._coordinates = coordinates
        joints = [coordinate.joint for coordinate in coordinates if coordinate.joint is not None]
        self._singles = [mechanism.single_joint(name) for name in joints]
        self._indices = mechanism.velocity_indices(joints)
        self._free = np.delete(np.arange(mechanism.model.nv), self._indices)
        self._scale = mechanism.velocity_scale[self._free]
        self._offsets = np.array([coordinate.offset for coordinate in coordinates])
        self._factors = np.array([coordinate.scale for coordinate in coordinates])

    def closed(self, q: Matrix, targets: Matrix, walk: bool, home: Vector) -> tuple[Matrix, Vector]:
        values = (targets - self._offsets) / self._factors
        starts = np.array([[single.coordinate(row) for single in self._singles] for row in q])
        distances = np.abs(values - starts) / self._mechanism.velocity_scale[self._indices]
        legs = 1
        if walk and self._mechanism.closures:
            legs = max(1, int(np.ceil(distances.max(initial=0.0) / _LONGEST_LEG)))
        for leg in range(1, legs + 1):
            q = self._newton(self._write(q, values if leg == legs else starts + (values - starts) * (leg / legs)))
        if not self._mechanism.closures:
            return q, np.zeros(len(q))
        residuals = np.abs(self._closures(q)[0]).max(axis=1, initial=0.0)
        for row in np.flatnonzero(~(residuals <= CLOSURE_TOLERANCE)):
            guess = q[row] if residuals[row] < 1.0 else home
            q[row], residuals[row] = _closed(self._mechanism, self._coordinates, targets[row], guess, home)
        return q, residuals

    def _write(self, q: Matrix, values: Matrix) -> Matrix:
        q = np.array(q)
        for row, numbers in zip(q, values, strict=True):
            for single, number in zip(self._singles, numbers, strict=True):
                single.set_coordinate(row, float(number))
        return q

    def _newton(self, q: Matrix) -> Matrix:
        """Take Newton steps until the loops of all configurations are closed, or the steps are used up."""
        if not self._mechanism.closures:
            return q
        open_rows = np.arange(len(q))
        for _ in range(_NEWTON_STEPS):
            errors, jacobians = self._closures(q[open_rows])
            moves = self._moves(errors, jacobians)
            for row, move in zip(open_rows, moves, strict=True):
                velocity = np.zeros(self._model.nv)
                velocity[self._free] = move
                q[row] = pin.integrate(self._model, q[row], velocity)
            open_rows = open_rows[np.abs(errors).max(axis=1, initial=0.0) > _NEARLY_CLOSED]
            if not open_rows.size:
                break
        return q

    def _closures(self, q: Matrix) -> tuple[Matrix, Array]:
        kinematics = self._mechanism.loop_kinematics
        errors = np.empty((len(q), kinematics.row_count))
        jacobians = np.empty((len(q), kinematics.row_count, self._model.nv))
        for row, positions in enumerate(q):
            errors[row], jacobians[row] = kinematics.closures(positions)
        return errors, jacobians

    def _moves(self, errors: Matrix, jacobians: Array) -> Matrix:
        """Return the shortest velocities (in scaled numbers) that close the linearised loops, shape=(n, free)."""
        scale = self._mechanism.closure_scale
        scaled = jacobians[:, :, self._free] * self._scale / scale[:, None]
        moves = -np.einsum("nij,nj->ni", np.linalg.pinv(scaled, rcond=1e-10), errors / scale)
        longest = np.abs(moves).max(axis=1, initial=0.0, keepdims=True)
        short: Matrix = moves * self._scale * np.minimum(1.0, LONGEST_STEP / np.maximum(longest, LONGEST_STEP))
        return short
