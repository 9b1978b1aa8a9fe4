"""Commands that take a real machine to desired poses: the error compensation flow, Fig. 8.6 of the chapter.

Desired pose -> nominal inverse kinematics -> u -> predicted pseudo-error du(u) -> corrected command -> machine. The
prediction is a learned du on top of the nominal model, the inverse kinematics of a calibrated model, or both; then du
is what remains between the calibrated model and the machine. du is a function of the command finally given, so the
correction is iterated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, real_array
from pm3dof_pin.calibration.identification import Identification
from pm3dof_pin.calibration.learned_part import LearnedPart
from pm3dof_pin.calibration.scatter import COVERAGE, Scatter
from pm3dof_pin.calibration.session_effects import TIME_COLUMN, SessionEffects
from pm3dof_pin.elastic.tool_deflection import spring_deflections, stiffened
from pm3dof_pin.errors.command_correction import command_jacobians, nearest_poses, weighted_control
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.normal_vectors import covariance_root, norm_quantiles
from pm3dof_pin.errors.pose_error import TIP_LENGTH, moved_pose, pose_difference, tip_error, tip_weights
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import (
    ConvergenceError,
    InvalidValueError,
    ShapeError,
    SingularConfigurationError,
    UnreachablePoseError,
)
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import datum_motions
from pm3dof_pin.measuring.wrenches import is_wrench, wrenches_of
from pm3dof_pin.typing import Array, Indices, OnFailure

Conditions = Mapping[str, Array | float]
"""Temperatures, loads, times and directions of approach by the names of the measurements' columns, shape=(n,) or one
number each."""

_MAX_ITERATIONS = 30
_SETTLED = 1e-13  # of the drives' joints, in addition to the rounding of their counters
_MEETS = 1e-6  # greatest distance of the nominal machine from a desired pose [m, tip-weighted]
_UNLOADINGS = 2  # each reduces a deflection by the factor deflection / machine size
_CHUNK = 4096  # poses at a time, to bound the memory


@dataclass(frozen=True, eq=False)
class Compensated:
    """Corrected commands. Everything is NaN at a pose for which there are none."""

    commands: Array  #: corrected commands, shape=(n, number of commands) [m, rad]
    nominal_commands: Array  #: commands by the description alone, shape as above [m, rad]
    deviations: Array  #: predicted pseudo-error of the nominal machine at the nominal commands, shape as above [m, rad]
    #: expected tip error with the corrected commands, root mean square, shape=(n,) [m]: what no command corrects
    #: according to the calibrated model, and the uncertainty of everything predicted
    predicted_error: Array
    error_bound: Array  #: bound of the tip error, with the probability :data:`COVERAGE`, shape=(n,) [m]
    floor: Array  #: tip error that no command corrects according to the calibrated model, shape=(n,) [m]


@dataclass(frozen=True, eq=False)
class Compensation:
    """Knowledge of a machine's errors, in a form that corrects its commands."""

    errors: GeometricErrors  #: the geometric parameters, with the robot as described
    #: identified parameters, shape=(number of parameters,) [m, rad]; None for the nominal model
    values: Array | None = None
    #: covariance of the identified parameters; None for the nominal model. With twelve rows more, also of base and tool
    #: as the measurements define them: see :func:`pm3dof_pin.measuring.nuisances.datum_motions`
    covariance: Array | None = None
    learned: LearnedPart | None = None  #: pseudo-error on top of that model; None for none
    eta: float = TIP_LENGTH  #: weight of the orientation in the tip error [m/rad]
    #: what remains in the measurements, apart from all this and their noise
    scatter: Scatter = field(default_factory=Scatter)
    #: by spring, its identified stiffness over that of the description, and the standard deviation of the ratio's
    #: logarithm; springs not named are as described
    stiffness: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    session: SessionEffects = field(default_factory=SessionEffects)  #: hysteresis and drift, as identified

    @classmethod
    def from_identification(cls, found: Identification, eta: float = TIP_LENGTH) -> Compensation:
        """Return the compensation by everything that was identified, certain or not."""
        session = SessionEffects.from_identification(found)
        return cls(
            found.errors, found.values, found.seen_covariance, eta=eta, stiffness=found.stiffness, session=session
        )

    @cached_property
    def model(self) -> Robot:
        """The robot as described, or with the identified parameters."""
        robot = self.errors.robot if self.values is None else self.errors.apply(self.values)
        factors = {name: factor for name, (factor, _) in self.stiffness.items()}
        return stiffened(robot, factors) if factors else robot

    @property
    def weights(self) -> Array:
        """The weights of the tip error, 0 for what is not a motion of the tool, shape=(6,)."""
        return tip_weights(self.eta, self.errors.robot.tool_motions)

    @property
    def known_covariance(self) -> Array | None:
        """The covariance without infinite variances: undetermined parameters do not move the tool visibly."""
        if self.covariance is None:
            return None
        return np.where(np.isfinite(self.covariance), self.covariance, 0.0)

    @cached_property
    def _spread(self) -> Array:
        """Parameters for a standard deviation in each independent direction, shape=(rows of `covariance`, same)."""
        known = self.known_covariance
        return np.zeros((len(self.errors), 0)) if known is None else covariance_root(known)

    @property
    def bears_wrenches(self) -> bool:
        """Whether wrench columns deflect the springs, rather than being inputs of the learned part."""
        learned = () if self.learned is None else self.learned.inputs.conditions
        return bool(self.errors.robot.springs) and not any(map(is_wrench, learned))

    def without_loads(self, measurements: Measurements) -> Measurements:
        """Return measurements without the deflections of the identified springs under their wrenches.

        Raises:
            UnreachablePoseError: the loops do not close at a command.
        """
        wrenches = self._wrenches(measurements.conditions, len(measurements))
        if wrenches is None:
            return measurements
        poses = self.model_poses(self.errors.robot.forward(measurements.commands))
        unloaded = measurements.without_motions(poses, self._by_spring(poses, wrenches).sum(axis=1))
        others = {name: values for name, values in measurements.conditions.items() if not is_wrench(name)}
        return replace(unloaded, conditions=others)

    def with_usual_conditions(self, given: Conditions) -> dict[str, Array | float]:
        """Fill in missing temperatures and loads with the middle of the measured range.

        Times and directions of approach stay unknown.

        Raises:
            InvalidValueError: a condition that was not learned from, nor identified, and is not a wrench on the
                springs; or a direction other than 1, -1 and 0.
        """
        usual: dict[str, Array | float] = {} if self.learned is None else {**self.learned.inputs.middle()}
        session = self.session.columns(len(self.errors.robot.commands))
        for name in sorted(set(given) - set(usual) - set(session)):
            if not (self.bears_wrenches and is_wrench(name)):
                known = ", ".join([*usual, *session]) or "none: the correction depends on no condition"
                raise InvalidValueError("condition", name, f"one of {known}")
        for name in sorted(set(given) & set(session) - {TIME_COLUMN}):
            if not np.isin(given[name], (-1.0, 0.0, 1.0)).all():
                raise InvalidValueError(name, given[name], "1 or -1, the direction in which the drive arrives, or 0")
        return usual | dict(given)

    def compensate(
        self,
        wanted: Poses | ArrayLike,
        conditions: Conditions | None = None,
        *,
        on_failure: OnFailure = "raise",
        with_deviations: bool = True,
        progress: Callable[[int, int], None] | None = None,
    ) -> Compensated:
        """Return the commands for desired poses of the tool.

        Args:
            wanted: a pose of the robot as described, or poses of shape (n,), or homogeneous transforms of the tool,
                shape=(4, 4) or (n, 4, 4).
            conditions: temperatures and loads, named as the measurements' columns; where they were identified, also the
                directions `approach_u1` ... in which the drives arrive, to correct hysteresis, and `time_s`, to correct
                drift. See :mod:`pm3dof_pin.calibration.session_effects`.
            on_failure: "raise", or "nan" for singular poses and poses out of reach.
            with_deviations: whether to compute the deviations, which takes a third of the time; otherwise NaN.
            progress: called with the number of poses done and the total.

        Raises:
            UnreachablePoseError: the machine cannot reach a pose, and `on_failure` is "raise".
            SingularConfigurationError: the tool can move there with all drives locked, likewise; or it can anywhere.
            ConvergenceError: the correction does not converge.
            InvalidValueError: poses of a wrong shape, or a condition is missing.
        """
        self.errors.robot.require_regular_drives(from_home=False)
        if isinstance(wanted, Poses):
            nominal = wanted if wanted.shape else wanted.reshape(1)
        else:
            nominal = self._reached(real_array("wanted", wanted), on_failure)
        if len(nominal.shape) > 1:
            raise ShapeError("wanted", nominal.shape, "one pose, or a list of them")
        count, drives = len(nominal), len(self.errors.robot.commands)
        commands, deviations = np.full((2, count, drives), np.nan)
        predicted, bounds, floor = np.full((3, count), np.nan)
        answer = Compensated(commands, np.array(nominal.commands), deviations, predicted, bounds, floor)
        given = {name: np.broadcast_to(values, count) for name, values in (conditions or {}).items()}
        for start in range(0, count, _CHUNK):
            rows = np.arange(start, min(start + _CHUNK, count))[nominal.solved[start : start + _CHUNK]]
            self._fill(answer, rows, nominal, given, on_failure, with_deviations=with_deviations)
            if progress is not None:
                progress(min(start + _CHUNK, count), count)
        for array in vars(answer).values():
            frozen(array)
        return answer

    def _reached(self, transforms: Array, on_failure: OnFailure) -> Poses:
        """Return poses of the robot as described at tool placements, shape=(4, 4) or (n, 4, 4)."""
        if transforms.ndim not in (2, 3):
            raise ShapeError("wanted", transforms.shape, "(4, 4) or (n, 4, 4)")
        transforms = transforms[None] if transforms.ndim == 2 else transforms
        nominal = self.errors.robot.reach(transforms, on_failure=on_failure)
        solved = np.flatnonzero(nominal.solved)
        missed = tip_error(
            pose_difference(transforms[solved], nominal.transforms[solved]), self.eta, nominal.robot.tool_motions
        )
        if np.any(missed > _MEETS):
            raise UnreachablePoseError(f"{self.errors.robot.name} misses a desired pose by {missed.max():.3g} m")
        return nominal

    def _fill(
        self,
        answer: Compensated,
        rows: Indices,
        nominal: Poses,
        given: Mapping[str, Array],
        on_failure: OnFailure,
        *,
        with_deviations: bool,
    ) -> None:
        """Compensate some rows of nominal poses; singular ones stay NaN if `on_failure` is "nan"."""
        try:
            model = self.model_poses(nominal[rows], on_failure)
            taken, model = rows[model.solved], model[model.solved]
            part: Conditions = {name: values[taken] for name, values in given.items()}
            nearest = self._nearest(nominal[taken], model, part, on_failure)
            commands = self._corrected(nearest.commands, part) - self.session.counter_shifts(part, nearest)
            deviations = self._deviations(nominal[taken], model, part) if with_deviations else np.nan
            left, spread = self._left_over(nominal[taken], nearest, part)
            signed = self.session.signed_effects(part, nearest, self.eta)
        except (SingularConfigurationError, UnreachablePoseError):
            if on_failure == "raise":
                raise
            if len(rows) > 1:
                for half in np.array_split(rows, 2):
                    self._fill(answer, half, nominal, given, on_failure, with_deviations=with_deviations)
            return
        answer.commands[taken], answer.deviations[taken] = commands, deviations
        answer.floor[taken] = np.linalg.norm(left, axis=1)
        answer.predicted_error[taken] = np.sqrt(answer.floor[taken] ** 2 + np.einsum("nii->n", spread))
        if self.scatter.tails > 1.0:
            control = weighted_control(nearest, self.eta)
            spread = spread + (self.scatter.tails**2 - 1.0) * self.scatter.covariances(control)
        answer.error_bound[taken] = norm_quantiles(left, spread, COVERAGE, signed)

    def poses(self, nominal: Poses, conditions: Conditions | None = None) -> Poses:
        """Predict the machine's poses at the commands of nominal poses, under conditions by name.

        Raises:
            UnreachablePoseError: the loops do not close at a command.
        """
        reached = self._deviated(self.model_poses(nominal), nominal.commands, conditions or {})
        return self._deflected(reached, conditions or {})

    def corrected(self, nominal: Poses, conditions: Conditions | None = None) -> Array:
        """Return only the commands for desired poses, shape=(n, commands) [m, rad]; see :meth:`compensate`."""
        nearest = self._nearest(nominal, self.model_poses(nominal), conditions or {})
        return self._corrected(nearest.commands, conditions or {})

    def deviations(
        self, nominal: Poses, conditions: Conditions | None = None, *, on_failure: OnFailure = "raise"
    ) -> Array:
        """Predict du of Fig. 8.6, the nominal machine's pseudo-error at its commands, shape=(n, commands) [m, rad]."""
        return self._deviations(nominal, self.model_poses(nominal), conditions or {}, on_failure)

    def model_poses(self, nominal: Poses, on_failure: OnFailure = "raise") -> Poses:
        """Return the model's poses, nominal or calibrated, at the commands of nominal poses."""
        if self.values is None:
            return nominal if self.model is nominal.robot else Poses(self.model, nominal.q)
        return self.model.forward(nominal.commands, guess=nominal.q, on_failure=on_failure)

    def learned_deviations(self, commands: Array) -> Array:
        """Return the learned part at commands and usual conditions, shape=(n, number of commands) [m, rad].

        Zero without a learned part.
        """
        return np.broadcast_to(self._learned(commands, self.with_usual_conditions({})), commands.shape)

    def _learned(self, commands: Array, conditions: Conditions) -> Array:
        return np.zeros_like(commands) if self.learned is None else self.learned.deviations(commands, conditions)

    def _deviated(self, model: Poses, commands: Array, conditions: Conditions) -> Poses:
        if self.learned is None:
            return model
        return model.robot.forward(model.commands + self._learned(commands, conditions), guess=model.q)

    def _nearest(self, nominal: Poses, model: Poses, conditions: Conditions, on_failure: OnFailure = "raise") -> Poses:
        """Return the unloaded poses of the model that come nearest to the nominal ones under the given wrenches."""
        wrenches = self._wrenches(conditions, len(nominal))
        wanted = self.session.before_drift(nominal.transforms, conditions, nominal)
        if wrenches is None and self.values is None and wanted is nominal.transforms:
            return model
        if wrenches is None:
            return nearest_poses(model, wanted, self.eta, on_failure=on_failure)
        nearest = model
        for _ in range(_UNLOADINGS):
            unloaded = moved_pose(wanted, -self._by_spring(nearest, wrenches).sum(axis=1))
            nearest = nearest_poses(nearest, unloaded, self.eta, on_failure=on_failure)
        return nearest

    def _wrenches(self, conditions: Conditions, count: int) -> Array | None:
        return wrenches_of(conditions, self.errors.robot, count) if self.bears_wrenches else None

    def _by_spring(self, poses: Poses, wrenches: Array) -> Array:
        """Return the tool motion by each spring under the wrenches, shape=(n, springs, 6) [m, rad]."""
        return spring_deflections(Poses(self.model, poses.q), wrenches)

    def _deflected(self, poses: Poses, conditions: Conditions) -> Poses:
        wrenches = self._wrenches(conditions, len(poses))
        if wrenches is None:
            return poses
        moved = moved_pose(poses.transforms, self._by_spring(poses, wrenches).sum(axis=1))
        return Poses(poses.robot, poses.q, poses.residual, poses.broken_limits, moved)

    def _corrected(self, commands: Array, conditions: Conditions) -> Array:
        corrected = commands
        scales = np.array([command.scale for command in self.errors.robot.commands])
        settled = np.maximum(_SETTLED * np.abs(scales), 4.0 * np.spacing(np.abs(commands).max(initial=0.0)))
        for _ in range(_MAX_ITERATIONS):
            following = commands - self._learned(corrected, conditions)
            change = np.abs(following - corrected)
            corrected = following
            if np.all(change <= settled):
                return corrected
        worst = float((change / np.abs(scales)).max())
        raise ConvergenceError("iterating the corrected command", worst, "m or rad", _MAX_ITERATIONS)

    def _deviations(
        self, nominal: Poses, model: Poses, conditions: Conditions, on_failure: OnFailure = "raise"
    ) -> Array:
        if self.values is None and self._wrenches(conditions, len(nominal)) is None:
            return self._learned(nominal.commands, conditions)
        seen = self._deflected(self._deviated(model, nominal.commands, conditions), conditions).transforms
        return nearest_poses(nominal, seen, self.eta, on_failure=on_failure).commands - nominal.commands

    def _left_over(self, nominal: Poses, nearest: Poses, conditions: Conditions) -> tuple[Array, Array]:
        """Return mean and covariance of the tip-weighted error with corrected commands, (n, 6) and (n, 6, 6)."""
        reached = self._deflected(nearest, conditions)
        wanted = self.session.before_drift(nominal.transforms, conditions, nominal)
        left = pose_difference(wanted, reached.transforms) * self.weights
        control = weighted_control(nearest, self.eta)
        spread = self.covariances(nearest, conditions) + self.scatter.covariances(control)
        return left, spread + self.session.covariances(conditions, nearest, self.eta)

    def effects(self, poses: Poses) -> Array:
        """Return the tip-weighted tool motion by the parameters of `covariance`, shape=(n, 6, its rows)."""
        latest = vars(self).get("_latest")  # an interval asks twice
        if latest is None or latest[0] is not poses:
            effects = sensitivities(self.errors, poses, self.values).errors
            if self.covariance is not None and len(self.covariance) > len(self.errors):
                effects = np.concatenate([effects, datum_motions(poses)], axis=2)
            latest = poses, frozen(effects * self.weights[:, None])
            vars(self)["_latest"] = latest
        return np.asarray(latest[1])

    def standard_effects(self, poses: Poses) -> Array:
        """Return :meth:`effects` for a standard deviation in each independent direction of the parameters.

        No directions for a learning method: its error correlations between poses are unknown.
        """
        if self.learned is not None or self.known_covariance is None:
            return np.zeros((len(poses), 6, 0))
        return self.effects(poses) @ self._spread

    def rms_interval(self, wanted: Poses) -> tuple[float, float] | None:
        """Return an interval of the tip error with corrected commands [m], root mean square over poses, unloaded.

        Its probability is :data:`COVERAGE`, for others of as many poses drawn in the same way, in any order and at any
        time; None for a learning method. See :mod:`pm3dof_pin.calibration.scatter`.
        """
        if self.learned is not None:
            return None
        nearest = self._nearest(wanted, self.model_poses(wanted), {}, "nan")
        left, spread = self._left_over(wanted, nearest, {})
        effects = [self.standard_effects(nearest), self.session.common_effects({}, nearest, self.eta)]
        squares = np.sum(left**2, axis=1) + np.einsum("nii->n", spread)
        return self.scatter.rms_interval(
            left,
            np.concatenate(effects, axis=2),
            weighted_control(nearest, self.eta),
            beside=self.session.scatter({}, nearest, self.eta),
            variance=self.session.mean_square_variance(nearest, self.eta) + 2.0 * float(squares.var()) / len(squares),
        )

    def covariances(self, poses: Poses, conditions: Conditions | None = None) -> Array:
        """Return the covariance of predicted poses, without the scatter: tip-weighted, shape=(n, 6, 6) [m^2]."""
        weights, given = self.weights, conditions or {}
        total = np.zeros((len(poses), 6, 6))
        if self.values is not None and self.known_covariance is not None:
            effects = self.effects(poses)
            total = total + (effects @ self.known_covariance) @ np.swapaxes(effects, 1, 2)
        wrenches = self._wrenches(given, len(poses))
        if wrenches is not None and self.stiffness:
            names = [str(entry["name"]) for entry in self.errors.robot.springs]
            spread = np.array([self.stiffness.get(name, (1.0, 0.0))[1] for name in names])
            parts = self._by_spring(poses, wrenches) * weights * spread[:, None]
            total = total + np.swapaxes(parts, 1, 2) @ parts
        return np.asarray(total + self.learned_covariances(poses, given))

    def learned_covariances(self, poses: Poses, conditions: Conditions) -> Array:
        """Return the part of the learned deviations in :meth:`covariances`, shape=(n, 6, 6) [m^2]."""
        if self.learned is None:
            return np.zeros((len(poses), 6, 6))
        control = command_jacobians(poses) * self.weights[:, None]
        moved = control * self.learned.uncertainties(poses.commands, conditions)[:, None, :]
        return np.asarray(moved @ np.swapaxes(moved, 1, 2))
