"""Robust loop closing: one damped least-squares solver for all kinds of targets."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS, ToolComponent
from pm3dof_pin.mechanism.configuration import Configuration
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.mechanism.tool_components import angle_rates, rotation_of_angles, tool_components
from pm3dof_pin.singular_values import svd
from pm3dof_pin.tolerances import CLOSED
from pm3dof_pin.typing import Indices, Matrix, Vector

_FIRST_DAMPING, _MIN_DAMPING, _MAX_DAMPING = 1e-2, 1e-8, 1e12
LONGEST_STEP = 0.5  # rad, or characteristic lengths: for longer steps the linear model of a rotation is poor
_MIN_GAIN, _GOOD_GAIN = 1e-4, 0.75
_STATIONARY = 1e-13
_ROUNDING = float(np.finfo(float).eps)


@dataclass(frozen=True, eq=False)
class Assembly:
    """The result of the assembly solver."""

    converged: bool  #: whether the loops are closed and the tool is on target, within the tolerance
    steps: int  #: iterations done
    residual: float  #: greatest absolute entry of the remaining closure and pose errors [m, rad]
    mechanism: Mechanism  #: the mechanism
    q: Vector  #: the last iterate; assembled only if `converged`
    jacobian: Matrix  #: of the scaled errors by the scaled free velocities, at the last iterate

    @cached_property
    def configuration(self) -> Configuration:
        """The configuration of the last iterate."""
        return Configuration(self.mechanism, self.q)

    @cached_property
    def factors(self) -> tuple[Matrix, Vector, Matrix]:
        """The singular value decomposition of the Jacobian, U, s, V^T."""
        return svd(self.jacobian, full_matrices=False)


def assemble(
    mechanism: Mechanism,
    guess: Configuration | ArrayLike,
    *,
    joints: Mapping[str, ArrayLike] | None = None,
    tool: Mapping[ToolComponent, float] | None = None,
    max_steps: int = 100,
    tolerance: float | None = None,
) -> Assembly:
    """Close the loops of a mechanism, with given joints or components of the tool's placement.

    Failure does not raise: check `converged`. The methods of :class:`~pm3dof_pin.kinematics.robot.Robot` raise instead.

    Levenberg-Marquardt on the closure and pose errors, with lengths divided by the characteristic length. The damping
    is proportional to the square of the residual (J. Fan and Y. Yuan, Computing 74, 2005), which keeps convergence
    quadratic even if solutions are not isolated (a mechanism free to move) or constraints are redundant; each step is
    then the one of least norm. At a singular configuration convergence is linear.

    Args:
        mechanism: the mechanism.
        guess: configuration to start from.
        joints: coordinates of joints to hold [m, rad]; shape=(joint's nq,) for a joint with several degrees of freedom.
        tool: components of the tool's placement in the base, x, y, z [m], rx, ry, rz [rad], R = Rx Ry Rz.
        max_steps: maximum number of iterations.
        tolerance: largest residual of a closed loop [m, rad]; by default the mechanism's.

    Raises:
        InvalidValueError: an argument is not finite or of the wrong shape.
        JointNotFoundError: a joint is not in the model.
        DescriptionError: a component of the tool is given and the mechanism has no tool frame.
    """
    start = mechanism.checked_positions(guess.q if isinstance(guess, Configuration) else guess)
    q, free = mechanism.place_joints(start, joints or {})
    equations = _Equations(mechanism, free, tool or {})
    largest = mechanism.closure_tolerance if tolerance is None else tolerance
    point, steps = _iterate(equations, equations.at(q), max_steps, min(largest, CLOSED))
    converged = point.residual <= largest
    return Assembly(converged, steps, point.residual, mechanism, point.q, point.jacobian)


@dataclass(frozen=True, eq=False)
class _Point:
    """The equations at one q: residual [m, rad], scaled error, and its Jacobian by the scaled free velocities."""

    q: Vector
    residual: float
    error: Vector
    jacobian: Matrix

    @cached_property
    def cost(self) -> float:
        return float(self.error @ self.error)

    @cached_property
    def factors(self) -> tuple[Vector, Vector, Matrix]:
        """The error in the left singular directions, the singular values above noise, and the right directions."""
        left, values, right = svd(self.jacobian, full_matrices=False)
        noise = _ROUNDING * max(self.jacobian.shape, default=0) * values.max(initial=0.0)
        kept = np.count_nonzero(values > noise)
        return self.error @ left[:, :kept], values[:kept], right[:kept]

    def move(self, damping: float) -> Vector:
        """Return the scaled velocities of one damped step."""
        error, values, right = self.factors
        weights = values / (values * values + damping * self.cost)
        move = -((weights * error) @ right)
        longest = np.abs(move).max(initial=0.0)
        return move if longest <= LONGEST_STEP else move * (LONGEST_STEP / longest)


class _Equations:
    """Closure equations and, if requested, tool pose equations, in the free velocities."""

    def __init__(self, mechanism: Mechanism, free: Indices, tool: Mapping[ToolComponent, float]) -> None:
        self._kinematics = mechanism.loop_kinematics
        self._model = mechanism.model
        self._free = free
        self._rows = [TOOL_COMPONENTS.index(component) for component in tool]
        self._target = finite_array("tool placement", list(tool.values()), (len(tool),))
        self._turned = {"rx", "ry", "rz"} <= set(tool)
        self._tool = mechanism.tool_frame_id if tool else 0
        self._scale = np.concatenate([mechanism.closure_scale, mechanism.twist_scale[self._rows]])
        self._velocity_scale = mechanism.velocity_scale[free]

    def at(self, q: Vector) -> _Point:
        error, jacobian = self._kinematics.closures(q)
        if self._rows:
            pose_error, pose_jacobian = self._tool_equations(q)
            error, jacobian = np.concatenate([error, pose_error]), np.vstack([jacobian, pose_jacobian])
        scaled = jacobian[:, self._free] * self._velocity_scale / self._scale[:, None]
        return _Point(q, float(np.abs(error).max(initial=0.0)), error / self._scale, scaled)

    def moved(self, q: Vector, move: Vector) -> Vector:
        velocity = np.zeros(self._model.nv)
        velocity[self._free] = self._velocity_scale * move
        moved: Vector = pin.integrate(self._model, q, velocity)
        return moved

    def _tool_equations(self, q: Vector) -> tuple[Vector, Matrix]:
        placement = self._kinematics.frame_placement(q, self._tool)
        jacobian = self._kinematics.frame_jacobian(q, self._tool, pin.LOCAL_WORLD_ALIGNED)
        components = tool_components(placement.homogeneous)
        error = components[self._rows] - self._target
        turns = np.array(self._rows) >= 3
        if self._turned:  # by the remaining rotation, which is regular where the angles are singular
            angles_of_target = np.empty(3)
            angles_of_target[np.array(self._rows)[turns] - 3] = self._target[turns]
            left = pin.log3(placement.rotation @ rotation_of_angles(angles_of_target).T)
            jacobian[3:] = np.linalg.solve(pin.Jexp3(-left), jacobian[3:])
            error[turns] = left[np.array(self._rows)[turns] - 3]
        elif turns.any():
            jacobian[3:] = angle_rates(components[3:]) @ jacobian[3:]
            error[turns] = np.remainder(error[turns] + np.pi, 2.0 * np.pi) - np.pi
        return error, jacobian[self._rows]


def _iterate(equations: _Equations, point: _Point, max_steps: int, tolerance: float) -> tuple[_Point, int]:
    damping = _FIRST_DAMPING
    for step in range(max_steps):
        was_closed = point.residual <= tolerance
        move = point.move(damping)
        left = point.error + point.jacobian @ move
        predicted = point.cost - float(left @ left)
        if predicted <= _STATIONARY * point.cost or damping > _MAX_DAMPING:
            return point, step
        trial = equations.at(equations.moved(point.q, move))
        gain = (point.cost - trial.cost) / predicted
        if gain > _MIN_GAIN:
            point = trial
            damping = max(damping / 10.0, _MIN_DAMPING) if gain > _GOOD_GAIN else damping
        else:
            damping *= 10.0
        if was_closed:
            return point, step + 1
    return point, max_steps
