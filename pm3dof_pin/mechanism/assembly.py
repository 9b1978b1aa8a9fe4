"""Closing the loops: one damped least-squares solver for assembly, forward geometry and inverse geometry."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.mechanism.arrays import Matrix, Vector, finite_array
from pm3dof_pin.mechanism.configuration import Configuration

if TYPE_CHECKING:
    from pm3dof_pin.mechanism.mechanism import Mechanism

CLOSURE_TOLERANCE = 1e-12
"""Greatest residual that counts as closed [m, rad]."""

_FIRST_DAMPING, _LEAST_DAMPING, _GREATEST_DAMPING = 1e-2, 1e-8, 1e12
_LONGEST_STEP = 0.5  # rad, or characteristic lengths: beyond it the linear model of a rotation is worth little
_LEAST_GAIN, _GOOD_GAIN = 1e-4, 0.75
_STATIONARY = 1e-13
_ROTATION_TOLERANCE = 1e-9


@dataclass(frozen=True, eq=False)
class Assembly:
    """What the assembly solver found.

    Attributes:
        converged: the loops are closed, and the tool is where it was wanted, within the tolerance.
        steps: iterations done.
        residual: greatest entry of what is left of the closure error and the pose error [m, rad].
        configuration: where the solver stopped; assembled only if `converged`.
    """

    converged: bool
    steps: int
    residual: float
    configuration: Configuration


def assemble(
    mechanism: Mechanism,
    guess: Configuration | ArrayLike | None = None,
    *,
    held: Mapping[str, ArrayLike] | None = None,
    pose: pin.SE3 | ArrayLike | None = None,
    tolerance: float = CLOSURE_TOLERANCE,
    max_steps: int = 100,
) -> Assembly:
    """Close the loops of a mechanism, with joints held or the tool at a pose where wanted.

    A failure to do so is no error here: look at `converged`. The methods of :class:`Mechanism` raise instead.

    Levenberg-Marquardt on the closure error and the pose error, lengths divided by the characteristic length. The
    damping falls with the square of the residual (J. Fan and Y. Yuan, Computing 74, 2005), which keeps convergence
    quadratic where the solutions are no isolated points (a mechanism free to move) or constraints are redundant too;
    there each step is the shortest one. At a singular configuration convergence is linear.

    Args:
        mechanism: the mechanism.
        guess: configuration to start from; the home configuration by default.
        held: joints to hold, with their coordinates [m, rad]; shape=(joint's nq,) for a joint with several freedoms.
        pose: placement of the tool frame in the world as a `pin.SE3` or a homogeneous matrix, shape=(4, 4); or its
            position alone, shape=(3,) [m].
        tolerance: greatest residual that counts as converged [m, rad]. One more step is tried beyond it.
        max_steps: iterations to give up after.

    Raises:
        InvalidValueError: an argument is not finite or of the wrong shape, or the matrix is no placement.
        JointNotFoundError: a held joint is not in the model.
        DescriptionError: a pose is given and the mechanism has no tool frame.
    """
    q, free = mechanism.held_positions(_first_positions(mechanism, guess), held or {})
    equations = _Equations(mechanism, free, None if pose is None else _checked_pose(pose))
    point, steps = _iterate(equations, equations.at(q), tolerance, max_steps)
    return Assembly(point.residual <= tolerance, steps, point.residual, mechanism.configuration(point.q))


@dataclass(frozen=True, eq=False)
class _Point:
    """The equations at one q: residual [m, rad], scaled error, and its derivative by the scaled free velocities."""

    q: Vector
    residual: float
    error: Vector
    jacobian: Matrix

    @property
    def cost(self) -> float:
        return float(self.error @ self.error)

    @cached_property
    def factors(self) -> tuple[Vector, Vector, Matrix]:
        """The error in the left singular directions, the singular values, and the right singular directions."""
        left, values, right = np.linalg.svd(self.jacobian, full_matrices=False)
        return left.T @ self.error, values, right

    def move(self, damping: float) -> Vector:
        """Return the scaled velocities of one damped step."""
        error, values, right = self.factors
        noise = np.finfo(float).eps * max(self.jacobian.shape, default=0) * values.max(initial=0.0)
        kept = values > noise
        weights = np.zeros_like(values)
        weights[kept] = values[kept] / (values[kept] ** 2 + damping * self.cost)
        move = -(right.T @ (weights * error))
        longest = np.abs(move).max(initial=0.0)
        return move if longest <= _LONGEST_STEP else move * (_LONGEST_STEP / longest)


class _Equations:
    """Closure equations and, if wanted, tool pose equations, in the velocities that are free to move."""

    def __init__(self, mechanism: Mechanism, free: NDArray[np.intp], pose: pin.SE3 | Vector | None) -> None:
        self._kinematics = mechanism.loop_kinematics
        self._model = mechanism.model
        self._free = free
        self._pose = pose
        self._tool = mechanism.tool_frame_id if pose is not None else 0
        length = mechanism.characteristic_length
        pose_scale = np.full(3, length) if isinstance(pose, np.ndarray) else np.repeat([length, 1.0], 3)
        self._scale = np.concatenate([mechanism.closure_scale, pose_scale if pose is not None else []])
        self._velocity_scale = mechanism.velocity_scale[free]

    def at(self, q: Vector) -> _Point:
        error, jacobian = self._kinematics.closures(q)
        if self._pose is not None:
            pose_error, pose_jacobian = self._pose_equations(q, self._pose)
            error, jacobian = np.concatenate([error, pose_error]), np.vstack([jacobian, pose_jacobian])
        scaled = jacobian[:, self._free] * self._velocity_scale / self._scale[:, None]
        return _Point(q, float(np.abs(error).max(initial=0.0)), error / self._scale, scaled)

    def moved(self, q: Vector, move: Vector) -> Vector:
        velocity = np.zeros(self._model.nv)
        velocity[self._free] = self._velocity_scale * move
        moved: Vector = pin.integrate(self._model, q, velocity)
        return moved

    def _pose_equations(self, q: Vector, pose: pin.SE3 | Vector) -> tuple[Vector, Matrix]:
        placement = self._kinematics.frame_placement(q, self._tool)
        if isinstance(pose, np.ndarray):
            jacobian = self._kinematics.frame_jacobian(q, self._tool, pin.LOCAL_WORLD_ALIGNED)
            return placement.translation - pose, jacobian[:3]
        difference = pose.actInv(placement)
        jacobian = self._kinematics.frame_jacobian(q, self._tool, pin.LOCAL)
        return pin.log6(difference).vector, pin.Jlog6(difference) @ jacobian


def _iterate(equations: _Equations, point: _Point, tolerance: float, max_steps: int) -> tuple[_Point, int]:
    damping = _FIRST_DAMPING
    for step in range(max_steps):
        was_closed = point.residual <= tolerance
        move = point.move(damping)
        left = point.error + point.jacobian @ move
        predicted = point.cost - float(left @ left)
        if predicted <= _STATIONARY * point.cost or damping > _GREATEST_DAMPING:
            return point, step
        trial = equations.at(equations.moved(point.q, move))
        gain = (point.cost - trial.cost) / predicted
        if gain > _LEAST_GAIN:
            point = trial
            damping = max(damping / 10.0, _LEAST_DAMPING) if gain > _GOOD_GAIN else damping
        else:
            damping *= 10.0
        if was_closed:
            return point, step + 1
    return point, max_steps


def _first_positions(mechanism: Mechanism, guess: Configuration | ArrayLike | None) -> Vector:
    if guess is None:
        return mechanism.home.q
    if isinstance(guess, Configuration):
        return mechanism.checked_positions(guess.q)
    return mechanism.checked_positions(guess)


def _checked_pose(pose: pin.SE3 | ArrayLike) -> pin.SE3 | Vector:
    numbers = finite_array("tool pose", pose.homogeneous if isinstance(pose, pin.SE3) else pose, (3,), (4, 4))
    if numbers.shape == (3,):
        return numbers
    rotation = numbers[:3, :3]
    defect = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if defect > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0 or (numbers[3] != [0.0, 0.0, 0.0, 1.0]).any():
        raise InvalidValueError("tool pose", numbers, "a rotation matrix, a position and the last row 0 0 0 1")
    return pin.SE3(rotation, numbers[:3, 3])
