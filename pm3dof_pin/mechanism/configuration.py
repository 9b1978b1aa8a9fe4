"""One configuration of a mechanism: placements, Jacobians and closure errors at its q."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, listed, require_kind
from pm3dof_pin.description.coordinates import pose_in_words
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.mechanism.mechanism import Mechanism
from pm3dof_pin.typing import Matrix, Vector

LIMIT_TOLERANCE = 1e-9
"""Tolerance of limits, for rounding [m, rad]."""

ASSEMBLED_TOLERANCE = 1e-6
"""Largest closure residual of an assembled configuration [characteristic lengths, or rad]."""


@dataclass(frozen=True)
class LimitViolation:
    """A joint (`joint[k]` for component k), or the swing of a closure, outside its range [m, rad]."""

    name: str
    kind: Literal["joint", "swing"]
    value: float
    lower: float
    upper: float


class Configuration:
    """A mechanism at one q: placements, Jacobians and closure errors. Read-only.

    Created by :meth:`Robot.configuration`. The closure error and its Jacobian are computed on construction, frames on
    request, always from this q; since q cannot change, nothing can be stale. The loops need not be closed: see
    :attr:`closure_residual`.

    Velocities v, shape=(nv,), are Pinocchio's (tangent) velocities. Twists are [v; omega], linear part first. All
    arrays are read-only.

    Example:
        >>> import pm3dof_pin as pm
        >>> home = pm.load("pm3dof").home
        >>> home.tool_placement.translation.round(6)
        array([0.      , 0.      , 0.492991])
        >>> home.constraint_jacobian.shape
        (9, 12)

    Args:
        mechanism: the mechanism.
        q: joint configuration, shape=(nq,) [m, rad; cosine and sine for a continuous joint].

    Raises:
        InvalidValueError: q has the wrong shape, is not finite, or contains a cosine-sine pair or quaternion that is
            not of unit length.
    """

    __slots__ = ("_closure_error", "_constraint_jacobian", "_mechanism", "_q")

    def __init__(self, mechanism: Mechanism, q: ArrayLike) -> None:
        require_kind("mechanism", mechanism, Mechanism, "pm.load")
        self._mechanism = mechanism
        self._q = mechanism.checked_positions(q)
        self._closure_error, self._constraint_jacobian = mechanism.loop_kinematics.closures(self._q)
        for array in (self._q, self._closure_error, self._constraint_jacobian):
            frozen(array)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._mechanism, np.array(self._q))

    def __repr__(self) -> str:
        return f"Configuration({self._mechanism.name}, q={self._q}, closure_residual={self.closure_residual:.3e})"

    def __str__(self) -> str:
        numbers = np.array2string(self._q, precision=4, suppress_small=True, threshold=12, separator=", ")
        return f"q = {numbers} of {self._mechanism.name}"

    @property
    def in_words(self) -> str:
        """Where it is, for messages: its commands, as in "u1 = 0.2 m, u2 = 15 deg", or q of a robot without drives."""
        commands = self._mechanism.commands
        if not commands:
            return f"q = {listed(self._q)}"
        return pose_in_words(commands, self.commands, ".4g")

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism."""
        return self._mechanism

    @property
    def q(self) -> Vector:
        """Joint configuration, shape=(nq,) [m, rad]."""
        return self._q

    @property
    def closure_error(self) -> Vector:
        """Closure error e, shape=(m,), closure by closure, then coupling by coupling [m, rad].

        For a 3d closure, the position of frame b's origin in frame a, axes of frame a; for a 6d closure, log6 of the
        placement of frame b in frame a; for other types the held components, see
        :meth:`~pm3dof_pin.mechanism.loop_kinematics.LoopKinematics.closures`. For a coupling, the joint's coordinate
        minus that which follows from the others.
        """
        return self._closure_error

    @property
    def closure_residual(self) -> float:
        """Greatest absolute entry of the closure error [m, rad]; 0 without closures."""
        return float(np.abs(self._closure_error).max(initial=0.0))

    @property
    def constraint_jacobian(self) -> Matrix:
        """Constraint Jacobian G, shape=(m, nv): de/dt = G v with e the :attr:`closure_error`.

        Exact at any q. On a closed loop, G v is the velocity of frame b relative to frame a, in the axes of frame a. A
        force (6d: wrench) f on frame b with -f on frame a, in the same axes, has the generalised forces G^T f; types
        that hold only some components have rows for these.
        """
        return self._constraint_jacobian

    @property
    def tool_placement(self) -> pin.SE3:
        """Placement of the tool frame in the world; DescriptionError if the mechanism has none."""
        return self._placement(self._mechanism.tool_frame_id)

    @property
    def tool_jacobian(self) -> Matrix:
        """Jacobian J of the tool point, shape=(6, nv): twist [v; omega] = J v, world axes; errors as above."""
        return self._jacobian(self._mechanism.tool_frame_id)

    def frame_placement(self, name: str) -> pin.SE3:
        """Compute the placement of a link or frame in the world; FrameNotFoundError if there is no such frame."""
        return self._placement(self._mechanism.frame_id(name))

    def frame_jacobian(self, name: str) -> Matrix:
        """Compute the Jacobian of a frame's origin, shape=(6, nv), as :attr:`tool_jacobian`; errors as above."""
        return self._jacobian(self._mechanism.frame_id(name))

    @property
    def commands(self) -> Vector:
        """Counter readings of the drives, in order, shape=(number of actuated joints,) [m, rad]."""
        commands = self._mechanism.commands
        return frozen(np.array([c.scale * self.joint_position(c.joint) + c.offset for c in commands]))

    def joint_position(self, name: str) -> float:
        """Return the coordinate of a single-DoF joint [m, rad]; for a continuous joint, the angle in (-pi, pi].

        Raises as :meth:`Mechanism.single_joint <pm3dof_pin.mechanism.mechanism.Mechanism.single_joint>`.
        """
        return float(self._mechanism.single_joint(name).coordinate(self._q))

    def swing(self, closure: int) -> float:
        """Return the angle between the z axes of the two frames of the closure of this index [rad], in [0, pi]."""
        loop = self._mechanism.closures[closure]
        x, y, z = self.frame_placement(loop.frame_a).actInv(self.frame_placement(loop.frame_b)).rotation[:, 2]
        return math.atan2(math.hypot(x, y), z)

    def violated_limits(self) -> tuple[LimitViolation, ...]:
        """Return the joints outside their limits and the closures beyond their swing limit, in the model's order."""
        mechanism, q = self._mechanism, self._q
        outside = (q < mechanism.lower_limits - LIMIT_TOLERANCE) | (q > mechanism.upper_limits + LIMIT_TOLERANCE)
        lower, upper = mechanism.lower_limits, mechanism.upper_limits
        violations = [
            LimitViolation(mechanism.q_names[k], "joint", float(q[k]), float(lower[k]), float(upper[k]))
            for k in np.flatnonzero(outside)
        ]
        for index, loop in enumerate(mechanism.closures):
            if loop.swing_limit is not None and (swing := self.swing(index)) > loop.swing_limit + LIMIT_TOLERANCE:
                violations.append(LimitViolation(loop.name, "swing", swing, 0.0, loop.swing_limit))
        return tuple(violations)

    def _placement(self, frame_id: int) -> pin.SE3:
        return self._mechanism.loop_kinematics.frame_placement(self._q, frame_id)

    def _jacobian(self, frame_id: int) -> Matrix:
        return frozen(self._mechanism.loop_kinematics.frame_jacobian(self._q, frame_id, pin.LOCAL_WORLD_ALIGNED))


def require_assembled(configuration: Configuration) -> None:
    """Raise InvalidValueError unless the loops are closed."""
    mechanism = configuration.mechanism
    tolerance = max(ASSEMBLED_TOLERANCE * mechanism.characteristic_length, mechanism.closure_tolerance)
    if configuration.closure_residual > tolerance:
        problem = f"has its loops open by {configuration.closure_residual:.3g} m or rad"
        expected = f"closed loops, to {tolerance:.3g}, as of robot.home or robot.assemble(q)"
        raise InvalidValueError("configuration", problem=problem, expected=expected)


def mechanism_of(configuration: Configuration) -> Mechanism:
    """Return the mechanism of a configuration; InvalidValueError for any other object."""
    require_kind("configuration", configuration, Configuration, "Poses.configuration")
    return configuration.mechanism
