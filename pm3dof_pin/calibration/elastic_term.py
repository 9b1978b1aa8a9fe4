"""Deflections under known wrenches in the measurement model, with the springs' stiffness as unknowns.

Under a wrench w on the tool, the machine is at exp(C(q, k) w) T(q), where T follows from its joints and errors. The
unknowns are ln k of each spring, in addition to the geometry: d(C w) / d ln k_j = -C_j w. The change of C with the
geometry is of second order (deflection times error over machine size) and left out of the derivatives; the deflections
themselves are those of the displaced machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pm3dof_pin.elastic.tool_deflection import spring_deflections, stiffened
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import moved_pose
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.wrenches import wrenches_of
from pm3dof_pin.typing import Array

STIFFNESS_SIGMA = 0.3
"""Prior standard deviation of ln k: a computed stiffness is accurate to about a third."""

_PROGRAM_FROM = 20  # number of poses, all evaluated at every step


@dataclass(frozen=True, eq=False)
class ElasticTerm:
    """Deflections of a robot's tool under wrenches, shape=(n, 6), world axes, by springs of unknown stiffness."""

    springs: tuple[str, ...] = ()
    wrenches: Array | None = None

    @classmethod
    def from_measurements(cls, robot: Robot, measurements: Measurements) -> ElasticTerm:
        """Make the term for measurements; without wrenches or springs it is zero."""
        return cls.under(robot, wrenches_of(measurements.conditions, robot, len(measurements)))

    @classmethod
    def under(cls, robot: Robot, wrenches: Array | None) -> ElasticTerm:
        """Make the term for wrenches on the tool, world axes, shape=(n, 6) [N, N m]; zero without any or springs."""
        if wrenches is None or not wrenches.any() or not robot.springs:
            return cls()
        return cls(tuple(str(entry["name"]) for entry in robot.springs), wrenches)

    def of(self, measurements: Measurements, robot: Robot) -> ElasticTerm:
        """Return the term of the same unknowns for other measurements."""
        if not self.springs:
            return self
        wrenches = wrenches_of(measurements.conditions, robot, len(measurements))
        return ElasticTerm(self.springs, np.zeros((len(measurements), 6)) if wrenches is None else wrenches)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the unknowns, `spring.ln_k`."""
        return tuple(f"{spring}.ln_k" for spring in self.springs)

    @property
    def sigmas(self) -> Array:
        """Prior standard deviation of the unknowns, shape=(springs,)."""
        return np.full(len(self.springs), STIFFNESS_SIGMA)

    def with_parameters(self, errors: GeometricErrors) -> tuple[tuple[str, ...], Array]:
        """Return names and scales of geometric parameters, then of the unknowns."""
        return (*errors.names, *self.names), np.concatenate([errors.tolerances, self.sigmas])

    def deflected(self, poses: Poses, logarithms: Array) -> tuple[Poses, Array]:
        """Return poses with the tool displaced, and its motion by each unknown, shape=(n, 6, springs) [m, rad].

        The unknowns are the logarithms of each spring's stiffness over that of the description, shape=(springs,).
        """
        derivatives = self.derivatives(poses, logarithms)
        if self.wrenches is None:
            return poses, derivatives
        moved = moved_pose(poses.transforms, -derivatives.sum(axis=2))
        return Poses(poses.robot, poses.q, poses.residual, poses.broken_limits, moved), derivatives

    def derivatives(self, poses: Poses, logarithms: Array) -> Array:
        """Return the tool's motion by each unknown alone, shape=(n, 6, springs) [m, rad]; see :meth:`deflected`."""
        if self.wrenches is None:
            return np.zeros((len(poses), 6, 0))
        factors = dict(zip(self.springs, np.exp(logarithms).tolist(), strict=True))
        stiff = Poses(stiffened(poses.robot, factors), poses.q)
        return -np.swapaxes(spring_deflections(stiff, self.wrenches), 1, 2)
