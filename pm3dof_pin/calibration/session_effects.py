"""Hysteresis and drift of a machine, as identified from its measurements: what moves the tool besides the parameters.

Commands can correct them where one knows from which side each drive arrives (`approach_u1` ...: 1, -1, 0 for unknown)
and when (`time_s`, in the session's time). Where one does not, they remain, and count: from either side a drive is off
by half its hysteresis h, up or down from pose to pose, and at any time of the session of duration T the machine is off
by (t / T - 1/2) of its drift d, the same at all poses:

    variance h^2 / 4 of each drive's joint,      covariance d d^T / 12 of base and drives' zeros.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.errors.command_correction import command_scales, weighted_control
from pm3dof_pin.errors.normal_vectors import covariance_root
from pm3dof_pin.errors.pose_error import moved_pose, tip_weights
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.joint_columns import approach_columns
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.typing import Array

TIME_COLUMN = "time_s"
"""Condition with which drift is corrected."""

_BASE = 6  # components of the base's motion, before those of the drives


@dataclass(frozen=True, eq=False)
class SessionEffects:
    """Hysteresis and drift with their covariances; empty arrays for what was not identified."""

    #: h, each drive's joint after arriving from below minus from above, shape=(drives,) [m, rad]
    hysteresis: Array = field(default_factory=lambda: np.zeros(0))
    hysteresis_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    #: d, motion of the base and of the drives' joints from the first row to the last, shape=(6 + drives,) [m, rad]
    drift: Array = field(default_factory=lambda: np.zeros(0))
    drift_covariance: Array = field(default_factory=lambda: np.zeros((0, 0)))
    start: float = 0.0  #: time of the first row [s]
    duration: float = 1.0  #: T, time to the last row [s]

    @classmethod
    def from_identification(cls, found: Identification) -> SessionEffects:
        """Return what was identified from times and directions of approach."""
        hysteresis, drift = (found.nuisance_values[found.nuisances.columns(kind)] for kind in ("hysteresis", "drift"))
        of_hysteresis, of_drift = map(found.nuisance_covariance, ("hysteresis", "drift"))
        times = found.measurements.times
        span = (0.0, 1.0) if times is None or not drift.size else (float(times.min()), float(np.ptp(times)))
        return cls(hysteresis, of_hysteresis, drift, of_drift, *span)

    def columns(self, drives: int) -> tuple[str, ...]:
        """Return the conditions, by column, with which commands correct what was identified."""
        approaches = approach_columns(drives) if self.hysteresis.size else ()
        return (*approaches, *((TIME_COLUMN,) if self.drift.size else ()))

    def joint_shifts(self, conditions: Mapping[str, Array | float], poses: Poses) -> Array:
        """Return the known shifts of the drives' joints under conditions by column, shape=(n, drives) [m, rad]."""
        shifts = np.zeros((len(poses), len(poses.robot.commands)))
        if self.hysteresis.size:
            shifts += 0.5 * self.hysteresis * self._approaches(conditions, poses)
        if self.drift.size and TIME_COLUMN in conditions:
            shifts += self._part(conditions[TIME_COLUMN], poses)[:, None] * self.drift[_BASE:]
        return shifts

    def counter_shifts(self, conditions: Mapping[str, Array | float], poses: Poses) -> Array:
        """Return the same as readings of the counters, shape=(n, drives) [m, rad]."""
        return np.asarray(self.joint_shifts(conditions, poses) * np.abs(command_scales(poses)))

    def before_drift(self, transforms: Array, conditions: Mapping[str, Array | float], poses: Poses) -> Array:
        """Return placements of the tool that the known motion of the base takes to these, shape=(n, 4, 4)."""
        if not self.drift.size or TIME_COLUMN not in conditions:
            return transforms
        part = self._part(conditions[TIME_COLUMN], poses)
        return moved_pose(transforms, -part[:, None] * (datum_motions(poses)[:, :, :_BASE] @ self.drift[:_BASE]))

    def signed_effects(self, conditions: Mapping[str, Array | float], poses: Poses, eta: float) -> Array:
        """Return half the hysteresis of each drive whose side is unknown, at the tool, shape=(n, 6, drives) [m].

        It is added or subtracted, independently from pose to pose.
        """
        if not self.hysteresis.size:
            return np.zeros((len(poses), 6, 0))
        unknown = self._approaches(conditions, poses) == 0.0
        return np.asarray(_by_joints(poses, eta) * (0.5 * self.hysteresis * unknown)[:, None, :])

    def scatter(self, conditions: Mapping[str, Array | float], poses: Poses, eta: float) -> Array:
        """Return the covariance of what hysteresis leaves, independent from pose to pose, shape=(n, 6, 6) [m^2].

        That of :meth:`signed_effects`, and that of the uncertainty of the hysteresis.
        """
        signed = self.signed_effects(conditions, poses, eta)
        left = signed @ np.swapaxes(signed, 1, 2)
        if self.hysteresis.size:
            sides = self._approaches(conditions, poses)
            known = sides[:, :, None] * self.hysteresis_covariance * sides[:, None, :]
            unknown = np.eye(sides.shape[1]) * np.where(sides == 0.0, np.diag(self.hysteresis_covariance), 0.0)[:, None]
            control = _by_joints(poses, eta)
            left += control @ (0.25 * (known + unknown)) @ np.swapaxes(control, 1, 2)
        return np.asarray(left)

    def mean_square_variance(self, poses: Poses, eta: float) -> float:
        """Return the variance of the mean square over poses due to the uncertainty of the hysteresis [m^4]."""
        if not self.hysteresis.size:
            return 0.0
        gains = 0.25 * np.mean(np.sum(_by_joints(poses, eta) ** 2, axis=1), axis=0)
        spread = 4.0 * np.outer(self.hysteresis, self.hysteresis) * self.hysteresis_covariance
        return float(gains @ (spread + 2.0 * self.hysteresis_covariance**2) @ gains)

    def common_effects(self, conditions: Mapping[str, Array | float], poses: Poses, eta: float) -> Array:
        """Return the effects of drift for one standard deviation in each direction, shape=(n, 6, k) [m].

        They are the same at all poses of a moment.
        """
        if not self.drift.size:
            return np.zeros((len(poses), 6, 0))
        base = datum_motions(poses)[:, :, :_BASE] * tip_weights(eta, poses.robot.tool_motions)[:, None]
        motions = np.concatenate([base, _by_joints(poses, eta)], axis=2)
        if TIME_COLUMN in conditions:
            part = self._part(conditions[TIME_COLUMN], poses)[:, None, None]
            return np.asarray(motions @ covariance_root(self.drift_covariance) * part)
        unknown = (np.outer(self.drift, self.drift) + self.drift_covariance) / 12.0
        return np.asarray(motions @ covariance_root(unknown))

    def covariances(self, conditions: Mapping[str, Array | float], poses: Poses, eta: float) -> Array:
        """Return the covariance of what hysteresis and drift leave, shape=(n, 6, 6) [m^2]."""
        drift = self.common_effects(conditions, poses, eta)
        return np.asarray(drift @ np.swapaxes(drift, 1, 2) + self.scatter(conditions, poses, eta))

    def _approaches(self, conditions: Mapping[str, Array | float], poses: Poses) -> Array:
        count = len(poses.robot.commands)
        return np.column_stack(
            [np.broadcast_to(conditions.get(name, 0.0), len(poses)) for name in approach_columns(count)]
        )

    def _part(self, times: Array | float, poses: Poses) -> Array:
        """Return the part of the drift at times, -1/2 at the start of the session."""
        return np.broadcast_to((np.asarray(times, dtype=float) - self.start) / self.duration - 0.5, len(poses))


def session_conditions(measurements: Measurements) -> dict[str, Array]:
    """Return the directions of approach and the times of measurements as conditions by column; none where unknown."""
    found: dict[str, Array] = {}
    if measurements.approaches is not None:
        found |= dict(zip(approach_columns(measurements.commands.shape[1]), measurements.approaches.T, strict=True))
    if measurements.times is not None:
        found[TIME_COLUMN] = measurements.times
    return found


def approaches_along(commands: Array) -> Array:
    """Return the direction in which each drive arrives at each row of a path, shape=(n, drives): 1, -1, 0 for unknown.

    A drive that stands still has not changed sides; until it first moves, its side is unknown.
    """
    steps = np.sign(np.diff(commands, axis=0, prepend=commands[:1]))
    for row in range(1, len(steps)):
        steps[row] = np.where(steps[row] == 0.0, steps[row - 1], steps[row])
    return np.asarray(steps)


def _by_joints(poses: Poses, eta: float) -> Array:
    """Return the tip-weighted motion of the tool by the drives' joints, positive as their counters."""
    return np.asarray(weighted_control(poses, eta) * np.sign(command_scales(poses)))
