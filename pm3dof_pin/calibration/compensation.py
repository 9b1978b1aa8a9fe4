"""Commands that bring a real machine where it is wanted: the error compensation flow, Fig. 8.6 of the chapter.

Wanted pose -> nominal inverse kinematics -> u -> predicted pseudo-error du(u) -> corrected command -> machine. The
prediction is a learned du on top of the nominal model, the inverse kinematics of a calibrated model, or both: then
du is what is left between the calibrated model and the machine. du is a function of the command that is given in the
end, so the correction is iterated.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen
from pm3dof_pin.calibration.pseudo_error import InputScale, PseudoErrorModel, command_jacobians, nearest_commands
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import TIP_LENGTH, pose_difference, tip_error, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import ConvergenceError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.typing import Array

_MAX_ITERATIONS = 30
_SETTLED = 1e-13
_MEETS = 1e-6  # what a nominal machine may miss of a wanted pose [m, tip-weighted]


@dataclass(frozen=True, eq=False)
class Compensated:
    """Corrected commands.

    Attributes:
        commands: what to command, as the machine counts, shape=(n, number of actuated joints) [m, rad].
        nominal_commands: what the description alone would command.
        deviations: predicted pseudo-error of the nominal machine at the nominal commands [m, rad].
        predicted_error: tip error to be expected with the corrected commands, shape=(n,) [m]: what the calibrated model
            says no command corrects, and the uncertainty of all that is predicted.
    """

    commands: Array
    nominal_commands: Array
    deviations: Array
    predicted_error: Array


@dataclass(frozen=True, eq=False)
class Compensation:
    """What is known of a machine, in a form to command it by.

    Attributes:
        errors: the geometric parameters, with the mechanism as described.
        values: identified parameters, shape=(number of parameters,) [m, rad]; None for the nominal model.
        covariance: theirs; None for the nominal model.
        learned: pseudo-error on top of that model; None for none.
        inputs: scale of the learned model's inputs; None if there is none.
        eta: weight of the orientation [m/rad].
        unexplained: tip error that was left in the measurements beside all this and beside their noise [m].
    """

    errors: GeometricErrors
    values: Array | None = None
    covariance: Array | None = None
    learned: PseudoErrorModel | None = None
    inputs: InputScale | None = None
    eta: float = TIP_LENGTH
    unexplained: float = 0.0

    def model_poses(self, nominal: Poses) -> Poses:
        """Return the model's poses, nominal or calibrated, at the commands of nominal ones."""
        if self.values is None:
            return nominal
        return self.errors.apply(self.values).forward(nominal.commands, guess=nominal.q)

    def learned_deviations(self, commands: Array, conditions: Mapping[str, Array | float] | None = None) -> Array:
        """Return the learned du, shape=(n, number of actuated joints) [m, rad]; 0 without a learned model."""
        if self.learned is None or self.inputs is None:
            return np.zeros_like(commands)
        return self.learned.deviations(self.inputs.scaled(commands, conditions or {}))

    def poses(self, nominal: Poses, conditions: Mapping[str, Array | float] | None = None) -> Poses:
        """Predict where the machine is at the commands of nominal poses.

        Args:
            nominal: poses of the mechanism as described.
            conditions: temperatures and loads by name.

        Raises:
            ConvergenceError: the loops do not close at a command.
        """
        model = self.model_poses(nominal)
        if self.learned is None:
            return model
        deviated = model.commands + self.learned_deviations(nominal.commands, conditions)
        return model.robot.forward(deviated, guess=model.q)

    def corrected(self, nominal: Poses, conditions: Mapping[str, Array | float] | None = None) -> Array:
        """Return the commands for wanted poses that the nominal mechanism reaches.

        Args:
            nominal: wanted poses, of the mechanism as described.
            conditions: temperatures and loads by name.

        Returns:
            Coordinates of the actuated joints, shape=(n, number of actuated joints) [m, rad].

        Raises:
            ConvergenceError: the correction does not settle, or the loops do not close.
        """
        return self._corrected(self._nearest(nominal).commands, conditions)

    def compensate(self, poses: ArrayLike, conditions: Mapping[str, Array | float] | None = None) -> Compensated:
        """Return what to command for wanted poses of the tool.

        Args:
            poses: homogeneous transforms, shape=(4, 4) or (n, 4, 4).
            conditions: temperatures and loads by the names of the measurements' columns.

        Raises:
            UnreachablePoseError: the machine, as described, cannot bring its tool there.
            ConvergenceError: the correction does not settle.
            InvalidValueError: poses of a wrong shape, or a condition is missing.
        """
        return self._compensated(self._nominal(poses), conditions)

    def compensate_coordinates(
        self, values: ArrayLike, conditions: Mapping[str, Array | float] | None = None
    ) -> Compensated:
        """Return what to command for wanted values of the motion coordinates.

        Args:
            values: coordinates of the mechanism's motion coordinates, shape=(n, their number) [m, rad].
            conditions: temperatures and loads by name.

        Raises:
            UnreachablePoseError: the machine, as described, cannot get there.
            DescriptionError: the mechanism has no motion coordinates.
            ConvergenceError: the correction does not settle.
            InvalidValueError: values of a wrong shape, or a condition is missing.
        """
        mechanism = self.errors.mechanism
        return self._compensated(mechanism.solve(values), conditions)

    def predicted_error(self, nominal: Poses, conditions: Mapping[str, Array | float] | None = None) -> Array:
        """Return the tip error to be expected at wanted poses after correction, shape=(n,) [m]."""
        return self._predicted_error(nominal, self._nearest(nominal), conditions)

    def _nominal(self, poses: ArrayLike) -> Poses:
        array = np.asarray(poses, dtype=float)
        wanted = finite_array("poses", np.atleast_3d(array).reshape(-1, 4, 4), (array.size // 16, 4, 4))
        mechanism = self.errors.mechanism
        nominal = mechanism.reach(wanted)
        missed = tip_error(pose_difference(wanted, nominal.transforms), self.eta)
        if np.any(missed > _MEETS):
            raise UnreachablePoseError(f"{mechanism.name} misses a wanted pose by {missed.max():.3g} m")
        return nominal

    def _nearest(self, nominal: Poses) -> Poses:
        if self.values is None:
            return nominal
        return nearest_commands(self.model_poses(nominal), nominal.transforms, self.eta)

    def _corrected(self, commands: Array, conditions: Mapping[str, Array | float] | None) -> Array:
        corrected = commands
        for _ in range(_MAX_ITERATIONS):
            following = commands - self.learned_deviations(corrected, conditions)
            change = float(np.abs(following - corrected).max(initial=0.0))
            corrected = following
            if change <= _SETTLED:
                return corrected
        raise ConvergenceError("iterating the corrected command", change, "m or rad", _MAX_ITERATIONS)

    def _compensated(self, nominal: Poses, conditions: Mapping[str, Array | float] | None) -> Compensated:
        nearest = self._nearest(nominal)
        commands = self._corrected(nearest.commands, conditions)
        return Compensated(
            frozen(commands),
            frozen(np.array(nominal.commands)),
            frozen(self.deviations(nominal, conditions)),
            frozen(self._predicted_error(nominal, nearest, conditions)),
        )

    def deviations(self, nominal: Poses, conditions: Mapping[str, Array | float] | None = None) -> Array:
        """Predict the pseudo-error of the nominal machine at its own commands, the du of Fig. 8.6.

        Args:
            nominal: poses of the mechanism as described.
            conditions: temperatures and loads by name.

        Returns:
            shape=(n, number of actuated joints) [m, rad].
        """
        if self.values is None:
            return self.learned_deviations(nominal.commands, conditions)
        seen = self.poses(nominal, conditions).transforms
        return nearest_commands(nominal, seen, self.eta).commands - nominal.commands

    def _predicted_error(self, nominal: Poses, nearest: Poses, conditions: Mapping[str, Array | float] | None) -> Array:
        squares = tip_error(pose_difference(nominal.transforms, nearest.transforms), self.eta) ** 2
        weights = tip_weights(self.eta)
        if self.values is not None and self.covariance is not None:
            effects = sensitivities(self.errors, nearest, self.values).errors * weights[:, None]
            # a direction that nothing tells moves the tool by nothing that the measurements would not have shown
            known = np.where(np.isfinite(self.covariance), self.covariance, 0.0)
            squares = squares + np.einsum("nij,jk,nik->n", effects, known, effects)
        if self.learned is not None and self.inputs is not None:
            control = command_jacobians(nearest) * weights[:, None]
            spread = self.learned.uncertainties(self.inputs.scaled(nearest.commands, conditions or {}))
            squares = squares + np.sum((control * spread[:, None, :]) ** 2, axis=(1, 2))
        return np.asarray(np.sqrt(squares + self.unexplained**2))
