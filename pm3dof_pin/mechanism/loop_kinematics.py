"""Closure errors and constraint Jacobians from Pinocchio, always at the requested configuration."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from pm3dof_pin.description.closure_types import ClosureType
from pm3dof_pin.description.couplings import Coupling
from pm3dof_pin.mechanism.scratch_data import ScratchData
from pm3dof_pin.mechanism.single_joint import SingleJoint
from pm3dof_pin.typing import Array, Matrix, Vector

_SMALL = 1e-4  # sine below which its series is more accurate [rad]


@dataclass(frozen=True, eq=False)
class Anchors:
    """One loop closure in the model: its type, and the joints and placements of its two frames, in the type's axes."""

    kind: ClosureType
    frame_a: tuple[int, pin.SE3]
    frame_b: tuple[int, pin.SE3]
    length: float = 0.0  #: of a distance [m]

    @property
    def error(self) -> Vector:
        """The error of the closure if both frames are on one body, shape=(size,) [m, rad]."""
        placement = self.frame_a[1].actInv(self.frame_b[1])
        return _held(self, placement.translation, placement.rotation)[0]


_scratch_data = ScratchData()  # apart from other uses: it may run in the midst of these


@dataclass(frozen=True, eq=False)
class CoupledJoints:
    """One coupling in the model."""

    coupling: Coupling
    joint: SingleJoint  #: the joint that follows
    others: tuple[SingleJoint, ...]  #: the joints that it follows

    def slopes(self, q: Array) -> list[Any]:
        """Return the derivatives by the other joints at q, shape=(..., nq)."""
        return self.coupling.slopes([joint.coordinate(q) for joint in self.others])


class LoopKinematics(threading.local):
    """Pinocchio's data for mechanisms of the same joints, one copy per thread.

    Pinocchio updates the data of a constraint only on `calc` and returns stale rows otherwise. Here every method starts
    from q, runs every step its result depends on, and returns new arrays: no state survives a call, and no other code
    uses the data. (The bindings return a one-column matrix as a vector, hence the reshaping.)
    """

    def __init__(self, model: pin.Model, closures: Sequence[Anchors], couplings: Sequence[CoupledJoints]) -> None:
        self._model = model
        self._closures = tuple(closures)
        self.couplings = tuple(couplings)
        self._constraints = pin.StdVec_ConstraintModel()
        self._constraint_datas = pin.StdVec_ConstraintData()
        for closure in closures:
            anchor = pin.FrameAnchorConstraintModel if closure.kind.rotations else pin.PointAnchorConstraintModel
            self._constraints.append(pin.ConstraintModel(anchor(model, *closure.frame_a, *closure.frame_b)))
            self._constraint_datas.append(self._constraints[-1].createData())
        self._pairs = list(zip(self._constraints, self._constraint_datas, strict=True))
        self.rows = _slices([*(closure.kind.size for closure in closures), *(1 for _ in couplings)])
        """Rows of each closure, then of each coupling."""
        self.row_count: int = self.rows[-1].stop if self.rows else 0
        own = _slices([constraint.residualSize() for constraint in self._constraints])
        self._own_count: int = own[-1].stop if own else 0
        datas = [constraint_data.extract() for constraint_data in self._constraint_datas]
        self._details = list(zip(closures, self.rows, own, datas, strict=False))
        self._are_points = all(closure.kind.name == "3d" for closure in closures) and not couplings

    @property
    def _data(self) -> pin.Data:
        return _scratch_data(self._model)

    def closures(self, q: Vector) -> tuple[Vector, Matrix]:
        """Compute the closure error e, shape=(m,) [m, rad], and its derivative G, de/dt = G v, shape=(m, nv), at q.

        For each closure, the held components of the position of frame b's origin in frame a and of the rotation from a
        to b: the rotation vector, or that of the least rotation which makes the z axes parallel, or the cosine of the
        axes that are perpendicular; for a 6d closure, log6 of the placement of b in a; for a distance, its excess. For
        each coupling, the joint's coordinate minus its value. G is exact at any q, closed or not.
        """
        own = self._constraint_rows(q)
        error = np.empty(self.row_count)
        if self._are_points:
            for _, rows, _, detail in self._details:
                error[rows] = detail.constraint_position_error
            return error, own
        jacobian = np.empty((self.row_count, self._model.nv))
        for closure, rows, own_rows, detail in self._details:
            if not closure.kind.rotations:
                error[rows], held = _held(closure, np.array(detail.constraint_position_error), np.eye(3))
                jacobian[rows] = held[:, :3] @ own[own_rows]
                continue
            placement = detail.c1Mc2
            if closure.kind.holds_vectors:
                error[rows] = pin.log6(placement).vector
                jacobian[rows] = pin.Jlog6(placement) @ placement.actionInverse @ own[own_rows]
                continue
            error[rows], held = _held(closure, placement.translation, placement.rotation)
            # Pinocchio's rows are the twist at frame a's origin, in its axes
            jacobian[rows] = held[:, :3] @ own[own_rows][:3]
            jacobian[rows] += (held[:, 3:] - held[:, :3] @ pin.skew(placement.translation)) @ own[own_rows][3:]
        for coupled, rows in zip(self.couplings, self.rows[len(self._details) :], strict=True):
            error[rows], jacobian[rows] = self._coupled(coupled, q)
        return error, jacobian

    def drift(self, q: Vector, v: Vector) -> Vector:
        """Compute dG/dt v, the second derivative of the closure error at constant v, for closed loops, shape=(m,)."""
        model, data = self._model, self._data
        pin.forwardKinematics(model, data, np.array(q), v, np.zeros(model.nv))
        drift = np.empty(self.row_count)
        for closure, rows in zip(self._closures, self.rows, strict=False):
            drift[rows] = _drift(
                closure, *(_Motion.from_data(data, *end) for end in (closure.frame_a, closure.frame_b))
            )
        for coupled, rows in zip(self.couplings, self.rows[len(self._closures) :], strict=True):
            curvatures = coupled.coupling.curvatures([float(joint.coordinate(q)) for joint in coupled.others])
            drift[rows] = -sum(
                curvature * v[joint.v_index] ** 2 for curvature, joint in zip(curvatures, coupled.others, strict=True)
            )
        return drift

    def _constraint_rows(self, q: Vector) -> Matrix:
        """Update the data at q and return Pinocchio's constraint Jacobian."""
        data = self._data
        pin.computeJointJacobians(self._model, data, q)
        for constraint, constraint_data in self._pairs:
            constraint.calc(self._model, data, constraint_data)
        stacked = pin.getConstraintsJacobian(self._model, data, self._constraints, self._constraint_datas)
        rows: Matrix = stacked.reshape(self._own_count, self._model.nv)
        return rows

    def _coupled(self, coupled: CoupledJoints, q: Vector) -> tuple[float, Vector]:
        """Return error and row of a coupling; angles that a continuous joint makes ambiguous are in (-pi, pi]."""
        value = coupled.coupling.value([float(joint.coordinate(q)) for joint in coupled.others])
        error = float(coupled.joint.coordinate(q)) - value
        if any(joint.is_continuous for joint in (coupled.joint, *coupled.others)):
            error = float(np.arctan2(np.sin(error), np.cos(error)))
        row = np.zeros(self._model.nv)
        row[coupled.joint.v_index] = 1.0
        for joint, slope in zip(coupled.others, coupled.slopes(q), strict=True):
            row[joint.v_index] -= slope
        return error, row

    def frame_placement(self, q: Vector, frame_id: int) -> pin.SE3:
        """Compute the placement of a frame in the world."""
        data = self._data
        pin.forwardKinematics(self._model, data, q)
        return pin.updateFramePlacement(self._model, data, frame_id).copy()

    def frame_jacobian(self, q: Vector, frame_id: int, reference: pin.ReferenceFrame) -> Matrix:
        """Compute the Jacobian of a frame, shape=(6, nv), linear part first."""
        jacobian: Matrix = pin.computeFrameJacobian(self._model, self._data, q, frame_id, reference)
        return jacobian.reshape(6, self._model.nv)


def _slices(sizes: Sequence[int]) -> list[slice]:
    return [slice(first, last) for first, last in pairwise(np.cumsum([0, *sizes]).tolist())]


def _held(closure: Anchors, t: Vector, rotation: Matrix) -> tuple[Vector, Matrix]:
    """Return the error of a closure, and its derivative by the relative velocity of the origins and the rotation.

    Both are in frame a: t is frame b's origin in it, shape=(3,), the derivative has the shape (size, 6).
    """
    kind = closure.kind
    if kind.is_distance:
        distance = np.linalg.norm(t)
        direction = t / distance if distance > 0.0 else np.eye(3)[0]
        return np.array([distance - closure.length]), np.concatenate([direction, np.zeros(3)])[None]
    along, about = list(kind.translations), list(kind.rotations)
    if len(about) == 3:
        angles, angular = pin.log3(rotation), pin.Jlog3(rotation) @ rotation.T
    elif len(about) == 2:
        angles, angular = _tilt(rotation[:, 2])
    else:
        _, y, z = rotation[:, 1]  # the rate of its x is (0, z, -y) times the angular velocity
        angles, angular = -rotation[0, 1] * np.ones(len(about)), np.array([[0.0, -z, y]])
    rows = np.zeros((kind.size, 6))
    rows[: len(along), along] = np.eye(len(along))
    if about:
        rows[len(along) :, 3:] = angular
    return np.concatenate([t[along], angles]), rows


def _tilt(z: Vector) -> tuple[Vector, Matrix]:
    """Return x and y of the rotation vector from (0, 0, 1) to z, and their derivative by z's angular velocity."""
    normal, cosine = np.array([-z[1], z[0]]), z[2]
    sine = float(np.hypot(*normal))
    angle = float(np.arctan2(sine, cosine))
    if sine < _SMALL and cosine < 0.0:  # the direction is lost
        return np.array([angle, 0.0]), np.eye(2, 3)
    ratio, change = (
        (angle / sine, (sine - angle * cosine) / sine**3) if sine >= _SMALL else (1.0 + sine**2 / 6.0, 1.0 / 3.0)
    )
    rows = ratio * np.array([[cosine, 0.0, -z[0]], [0.0, cosine, -z[1]]])
    rows[:, :2] += change * np.outer(normal, normal)
    return ratio * normal, rows


@dataclass(frozen=True, eq=False)
class _Motion:
    """Placement, velocity and acceleration of a frame at its origin, in world axes."""

    rotation: Matrix
    position: Vector
    velocity: Vector
    spin: Vector
    acceleration: Vector
    spin_rate: Vector

    @classmethod
    def from_data(cls, data: Any, joint: int, placement: pin.SE3) -> _Motion:
        """Return the motion of a frame after Pinocchio's forwardKinematics of second order."""
        at = data.oMi[joint] * placement
        twist, change = placement.actInv(data.v[joint]), placement.actInv(data.a[joint])
        R = at.rotation
        classical = change.linear + np.cross(twist.angular, twist.linear)
        return cls(R, at.translation, R @ twist.linear, R @ twist.angular, R @ classical, R @ change.angular)


def _drift(closure: Anchors, a: _Motion, b: _Motion) -> Vector:
    """Return the second derivative of a closed closure's error: of the motion of b in the moving axes of a."""
    kind, to_a = closure.kind, a.rotation.T
    between, speed = b.position - a.position, b.velocity - a.velocity
    seen = speed - np.cross(a.spin, between)
    change = b.acceleration - a.acceleration - np.cross(a.spin_rate, between)
    change = change - np.cross(a.spin, np.cross(a.spin, between)) - 2.0 * np.cross(a.spin, seen)
    t, dt, ddt = to_a @ between, to_a @ seen, to_a @ change
    if kind.is_distance:
        distance = np.linalg.norm(t)
        rate = t @ dt / distance
        return np.array([(dt @ dt + t @ ddt - rate**2) / distance])
    spin = to_a @ (b.spin - a.spin)
    spin_rate = to_a @ (b.spin_rate - a.spin_rate - np.cross(a.spin, b.spin))
    if kind.rotations == (2,):
        y = to_a @ b.rotation[:, 1]
        angular = -(np.cross(spin_rate, y) + np.cross(spin, np.cross(spin, y)))[:1]
    else:
        angular = spin_rate[list(kind.rotations)]
    return np.concatenate([ddt[list(kind.translations)], angular])
