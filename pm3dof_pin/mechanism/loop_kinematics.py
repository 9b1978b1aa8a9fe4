"""Closure errors and constraint Jacobians from Pinocchio, always at the requested configuration."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pinocchio as pin

from pm3dof_pin.typing import Matrix, Vector

_CLOSED = 1e-13
"""Closure error due to rounding [m, rad]."""


class LoopKinematics(threading.local):
    """Pinocchio's data for one mechanism, one copy per thread.

    Pinocchio updates the data of a constraint only on `calc` and returns stale rows otherwise. Here every method starts
    from q, runs every step its result depends on, and returns new arrays: no state survives a call, and no other code
    uses the data. (The bindings return a one-column matrix as a vector, hence the reshaping.)
    """

    def __init__(
        self,
        model: pin.Model,
        constraint_models: Sequence[pin.PointAnchorConstraintModel | pin.FrameAnchorConstraintModel],
    ) -> None:
        self._model = model
        self._data = model.createData()
        self._constraints = pin.StdVec_ConstraintModel()
        self._constraint_datas = pin.StdVec_ConstraintData()
        for constraint_model in constraint_models:
            constraint = pin.ConstraintModel(constraint_model)
            self._constraints.append(constraint)
            self._constraint_datas.append(constraint.createData())
        self._pairs = list(zip(self._constraints, self._constraint_datas, strict=True))
        ends = np.cumsum([0, *(constraint.residualSize() for constraint in self._constraints)]).tolist()
        self.rows = [slice(first, last) for first, last in pairwise(ends)]
        """Rows of each closure, shape=(number of closures,)."""
        self.row_count: int = ends[-1]
        self._details = [
            (rows, constraint_data.extract(), rows.stop - rows.start == 6)
            for rows, constraint_data in zip(self.rows, self._constraint_datas, strict=True)
        ]

    def closures(self, q: Vector) -> tuple[Vector, Matrix]:
        """Compute the closure error e, shape=(m,) [m, rad], and its derivative G, de/dt = G v, shape=(m, nv), at q.

        For a 3d closure, e is the position of frame b's origin in frame a; for a 6d closure, log6 of the placement M of
        b in a. G is exact at any q, closed or not. Pinocchio's own rows for a 6d closure, Ad(M) J_b - J_a, are the
        derivative of log6(M) only where the loop is closed; the factor Jlog6(M) Ad(M)^-1 makes them exact everywhere.
        """
        jacobian = self._constraint_rows(q)
        error = np.empty(self.row_count)
        for rows, detail, is_frame in self._details:
            error[rows] = detail.constraint_position_error
            if is_frame:
                placement = detail.c1Mc2
                jacobian[rows] = pin.Jlog6(placement) @ placement.actionInverse @ jacobian[rows]
        return error, jacobian

    def _constraint_rows(self, q: Vector) -> Matrix:
        """Update the data at q and return Pinocchio's constraint Jacobian, shape=(m, nv)."""
        pin.computeJointJacobians(self._model, self._data, q)
        for constraint, constraint_data in self._pairs:
            constraint.calc(self._model, self._data, constraint_data)
        stacked = pin.getConstraintsJacobian(self._model, self._data, self._constraints, self._constraint_datas)
        rows: Matrix = stacked.reshape(self.row_count, self._model.nv)
        return rows

    def frame_placement(self, q: Vector, frame_id: int) -> pin.SE3:
        """Compute the placement of a frame in the world."""
        pin.forwardKinematics(self._model, self._data, q)
        return pin.updateFramePlacement(self._model, self._data, frame_id).copy()

    def frame_jacobian(self, q: Vector, frame_id: int, reference: pin.ReferenceFrame) -> Matrix:
        """Compute the Jacobian of a frame, shape=(6, nv), linear part first."""
        jacobian: Matrix = pin.computeFrameJacobian(self._model, self._data, q, frame_id, reference)
        return jacobian.reshape(6, self._model.nv)
