"""The pseudo-error source: all errors of a machine as deviations of its joint variables, Fig. 8.5 of the chapter.

At command u the machine stands where a model of it stands at u + du. du is found by inverting the model's kinematics at
the pose measured. With fewer drives than a pose has freedoms no du gives the whole pose: the one taken brings the model
nearest to it in the tip-weighted sense, |translation|^2 + eta^2 |rotation|^2. What is left is what no command corrects.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from pm3dof_pin.calibration.identification import measured_residuals, measured_rows
from pm3dof_pin.calibration.measurements import Measurements
from pm3dof_pin.errors.error_map import best_commands
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import coordinate_ranges
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array

SEEN = 0.02
"""Deviations that move what is seen by less than this part of the most effective ones count as unseen: they stay 0. On
the tripod positions of the tool point alone show its height only; both tilts turn it on the spot. Near a singular pose
an arm has such directions even where whole poses are measured."""

_INVERSION_STEPS = 3  # each leaves about a thousandth of the error
_SHORTER = (0.25, 0.25, 0.25, 0.0, 1.0)  # what a step that leads away is multiplied by, one trial after the other
_ROUNDING = 1e-12  # [m]
_SAME = 1e-9


class PseudoErrorModel(Protocol):
    """What is learned: joint deviations as functions of scaled inputs."""

    def deviations(self, inputs: Array) -> Array:
        """Return du, shape=(n, number of actuated joints) [m, rad].

        Args:
            inputs: shape=(n, number of inputs), from :class:`InputScale`.
        """
        ...

    def uncertainties(self, inputs: Array) -> Array:
        """Return the standard deviation of du, shape=(n, number of actuated joints) [m, rad]."""
        ...

    def as_data(self) -> dict[str, object]:
        """Return the model as numbers and lists, for JSON."""
        ...


@dataclass(frozen=True, eq=False)
class InputScale:
    """Inputs of a learned model: the commands, then temperatures and loads, each scaled to about -1 .. 1.

    Attributes:
        conditions: names of the columns used beside the commands.
        centre: shape=(number of inputs,).
        half_range: shape=(number of inputs,).
    """

    conditions: tuple[str, ...]
    centre: Array
    half_range: Array

    @classmethod
    def of(cls, mechanism: Robot, measurements: Measurements) -> InputScale:
        """Scale commands by the joints' limits, conditions by what was measured; constant conditions are left out."""
        lower, upper = coordinate_ranges(mechanism, mechanism.command_coordinates)
        varied = {name: values for name, values in measurements.conditions.items() if np.ptp(values) > 0.0}
        least = np.array([*lower, *(values.min() for values in varied.values())])
        most = np.array([*upper, *(values.max() for values in varied.values())])
        return cls(tuple(varied), 0.5 * (least + most), 0.5 * (most - least))

    def middle(self) -> dict[str, float]:
        """Return the middle of each condition's range, by name."""
        first = len(self.centre) - len(self.conditions)
        return dict(zip(self.conditions, self.centre[first:].tolist(), strict=True))

    def beyond(self, conditions: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """Return the range measured of each condition that is outside it, by name.

        Args:
            conditions: one number each.
        """
        first = len(self.centre) - len(self.conditions)
        ranges = zip(self.conditions, self.centre[first:], self.half_range[first:], strict=True)
        return {
            name: (float(centre - half), float(centre + half))
            for name, centre, half in ranges
            if name in conditions and abs(conditions[name] - centre) > half * (1.0 + _SAME)
        }

    def scaled(self, commands: Array, conditions: Mapping[str, Array | float]) -> Array:
        """Return inputs, shape=(n, number of inputs).

        Args:
            commands: shape=(n, number of actuated joints) [m, rad].
            conditions: temperatures and loads by name, shape=(n,) or one number each.

        Raises:
            InvalidValueError: a condition is missing.
        """
        columns = [*commands.T]
        for name in self.conditions:
            if name not in conditions:
                raise InvalidValueError("conditions", ", ".join(conditions) or "none", f"{name} among them")
            columns.append(np.broadcast_to(np.asarray(conditions[name], dtype=float), (len(commands),)))
        return np.asarray((np.column_stack(columns) - self.centre) / self.half_range)


@dataclass(frozen=True, eq=False)
class PseudoErrors:
    """Pseudo-errors found from measurements against a model of the machine.

    Attributes:
        deviations: du, shape=(n, number of actuated joints) [m, rad].
        covariances: of du, from the measurements' noise, shape=(n, number of actuated joints, same).
        before: tip-weighted residuals of the model at the commands, shape=(n, 3 or 6) [m].
        left: those at the deviated commands: what no command corrects, shape=(n, 3 or 6) [m].
        control: tip-weighted motion of what is seen by the commands, shape=(n, 3 or 6, number of actuated joints).
    """

    deviations: Array
    covariances: Array
    before: Array
    left: Array
    control: Array


def command_jacobians(poses: Poses) -> Array:
    """Return how commands move the tool, shape=(n, 6, number of actuated joints)."""
    return sensitivities(GeometricErrors(poses.robot, ()), poses).commands


def control_inverse(control: Array, seen: float = SEEN) -> Array:
    """Return the pseudo-inverse of tip-weighted motions by the commands, without directions that are not seen.

    Args:
        control: shape=(n, 3 or 6, number of actuated joints).
        seen: see :data:`SEEN`.
    """
    return np.asarray(np.linalg.pinv(control, rcond=seen))


def pseudo_errors(
    measurements: Measurements, model: Poses, eta: float = TIP_LENGTH, *, seen: float = SEEN
) -> PseudoErrors:
    """Find the joint deviations that explain measurements, by inverting a model's kinematics.

    Args:
        measurements: poses, positions or points.
        model: poses of the model, nominal or calibrated, at the commands of the measurements.
        eta: weight of the orientation [m/rad].
        seen: see :data:`SEEN`.

    Raises:
        ConvergenceError: the loops do not close at a deviated command.
        SingularConfigurationError: at a command the tool can move with all commands held.
    """
    weights = tip_weights(eta)[: measurements.sigmas.shape[1]]

    def residuals(poses: Poses) -> Array:
        return np.asarray(measured_residuals(measurements, poses) * weights)

    def control(poses: Poses) -> Array:
        return np.asarray(measured_rows(measurements, poses, command_jacobians(poses)) * weights[:, None])

    def step(poses: Poses) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", control_inverse(control(poses), seen), residuals(poses)))

    deviations, poses = _descend(model, measurements.commands, step, residuals)
    reached = control(poses)
    spread = control_inverse(reached, seen) * (weights * measurements.sigmas)[:, None, :]
    return PseudoErrors(deviations, spread @ np.swapaxes(spread, 1, 2), residuals(model), residuals(poses), reached)


def nearest_commands(poses: Poses, wanted: Array, eta: float = TIP_LENGTH) -> Poses:
    """Return the poses of a mechanism that come nearest to wanted ones, in the tip-weighted sense.

    Args:
        poses: poses of the mechanism near to the wanted ones.
        wanted: homogeneous transforms, shape=(n, 4, 4).
        eta: weight of the orientation [m/rad].

    Raises:
        ConvergenceError: the loops do not close at a command.
    """

    def residuals(poses: Poses) -> Array:
        return pose_difference(wanted, poses.transforms) * tip_weights(eta)

    def step(poses: Poses) -> Array:
        return best_commands(command_jacobians(poses), pose_difference(wanted, poses.transforms), eta)

    return _descend(poses, poses.commands, step, residuals)[1]


def _descend(
    poses: Poses, commands: Array, step: Callable[[Poses], Array], residuals: Callable[[Poses], Array]
) -> tuple[Array, Poses]:
    """Take Gauss-Newton steps in the commands; where one leads away, as near a singularity, a shorter one or none.

    Args:
        poses: where to start, the poses at `commands`.
        commands: shape=(n, number of actuated joints) [m, rad].
        step: changes of the commands, shape as theirs.
        residuals: what is to become small, shape=(n, anything).

    Returns:
        The change of the commands, and the poses there.

    Raises:
        ConvergenceError: the loops do not close at a command.
    """
    deviations, left = np.zeros_like(commands), np.linalg.norm(residuals(poses), axis=1)
    for _ in range(_INVERSION_STEPS):
        move = step(poses)
        for factor in _SHORTER:
            trial = poses.robot.forward(commands + deviations + move, guess=poses.q)
            found = np.linalg.norm(residuals(trial), axis=1)
            farther = found > left + _ROUNDING
            if not farther.any():
                break
            move[farther] *= factor
        poses, left, deviations = trial, found, deviations + move
    return deviations, poses
