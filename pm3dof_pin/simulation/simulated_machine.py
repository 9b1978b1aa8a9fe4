"""A simulated real machine: the closed-chain mechanism with more errors than any model fitted to it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, real_array
from pm3dof_pin.errors.body_temperatures import BodyTemperatures
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_parameters import (
    ANGLE_TOLERANCE,
    LENGTH_TOLERANCE,
    Distribution,
    GeometricErrors,
    all_parameters,
    beside_guideways,
    declared_numbers,
)
from pm3dof_pin.errors.normal_vectors import correlated_normal
from pm3dof_pin.errors.pose_error import moved_pose
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.thermal_growth import ThermalGrowth
from pm3dof_pin.errors.vibration import Vibration
from pm3dof_pin.errors.waviness import GuideWaviness
from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.typing import Array, Vector


@dataclass(frozen=True, eq=False)
class Conditions:
    """Conditions under which commands are carried out."""

    #: temperature rise of each screw since the machine was as described, one number, or shape=(n, number of actuated
    #: joints) [K]
    temperature_rises: ArrayLike = 0.0
    #: dead wrenches [f; m] on the tool, world axes, shape=(6,) or (n, 6) [N, N m]; none by default
    wrenches: ArrayLike | None = None
    hours: ArrayLike = 0.0  #: time since the machine was as described, one number, or shape=(n,) [h]
    #: temperature rises by link, screw, rod or group of :class:`~pm3dof_pin.errors.body_temperatures.BodyTemperatures`,
    #: one number each, or shape=(n,) [K]
    body_rises: Mapping[str, ArrayLike] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class GeometricSource:
    """Constant errors of joints and frames, from manufacturing and assembly."""

    errors: GeometricErrors  #: the parameters
    values: Vector  #: p, shape=(number of parameters,) [m, rad]

    def __post_init__(self) -> None:
        """Check the values."""
        self.errors.values(self.values)


@dataclass(frozen=True, eq=False)
class MachineDrift:
    """Rates at which a machine changes."""

    #: growth of the drives' position errors, shape=(actuated joints,) [m/h, rad/h]
    zeros: ArrayLike
    #: temperature rise of screws and members beyond the measured one, if the machine has thermal errors [K/h]
    warming: float = 0.0


@dataclass(frozen=True, eq=False)
class SimulatedMachine:
    """A machine with errors of every class, each of them optional.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> machine = pm.SimulatedMachine.random(pm.GeometricErrors.load("pm3dof"), np.random.default_rng(1))
        >>> machine.measure([[0.24, 0.24, 0.24], [0.25, 0.24, 0.23]], np.random.default_rng(2)).shape
        (2, 4, 4)

    Attributes:
        nominal: the robot as described, as its controller knows it.
        geometric: errors of joints and frames.
        waviness: errors of the drives along their travel.
        thermal: growth of screws and members.
        elastic: deflection under load.
        vibration: scatter.
        drift: changes with time.
    """

    nominal: Robot
    geometric: GeometricSource | None = None
    waviness: GuideWaviness | None = None
    thermal: ThermalGrowth | None = None
    elastic: ElasticDeflection | None = None
    vibration: Vibration | None = None
    drift: MachineDrift | None = None

    @classmethod
    def random(
        cls,
        errors: GeometricErrors,
        generator: np.random.Generator,
        *,
        everything: bool = True,
        distribution: Distribution = "normal",
    ) -> SimulatedMachine:
        """Draw a machine with geometric errors within the tolerances of the parameters to be identified.

        With `everything`, all six errors of every joint and frame are drawn, not only those that `errors` lists; the
        others within the smallest tolerances of `errors`.
        """
        truth = _with_all_parameters(errors) if everything else errors
        source = GeometricSource(truth, truth.sample(generator, distribution))
        return cls(errors.robot, source)

    def only(self, source: str) -> SimulatedMachine:
        """Return the machine with only one of its sources, "geometric" ... "drift"; InvalidValueError for others."""
        sources = tuple(field.name for field in fields(self) if field.name != "nominal")
        if source not in sources:
            raise InvalidValueError("source", source, f"one of {', '.join(sources)}")
        alone: dict[str, Any] = {source: getattr(self, source)}
        return SimulatedMachine(self.nominal, **alone)

    def poses(self, commands: ArrayLike, conditions: Conditions | None = None) -> Array:
        """Return the true poses of the tool, without scatter: homogeneous transforms, shape=(n, 4, 4).

        Args:
            commands: readings of the drives' counters, shape=(n, number of commands) [m, rad].
            conditions: temperatures and loads; the same for all commands or one each.

        Raises:
            ConvergenceError: the loops do not close at a command.
            InvalidValueError: commands or conditions of a wrong shape or not finite.
            DescriptionError: deflections are requested, but the description has no springs.
        """
        return self._carried_out(np.array(commands, dtype=float), conditions or Conditions())[0]

    def state(self, commands: ArrayLike, conditions: Conditions | None = None) -> tuple[Array, Array]:
        """Return :meth:`poses`, and the true coordinates of all joints, shape=(n, nq) [m, rad]."""
        return self._carried_out(np.array(commands, dtype=float), conditions or Conditions())

    def measure(
        self,
        commands: ArrayLike,
        generator: np.random.Generator,
        conditions: Conditions | None = None,
        instrument: Instrument | None = None,
    ) -> Array:
        """Return what an instrument measures: :meth:`poses` with vibration and its own noise.

        Full poses are returned even for an instrument that measures positions only. The noise of one that sees targets
        one by one is of each, and not of the pose.
        """
        given = real_array("commands", commands)
        if given.ndim != 2:
            raise ShapeError("commands", given.shape, "(n, number of commands)")
        seen_by, noise = instrument or Instrument(), np.zeros((len(given), 6))
        if not seen_by.targets:
            noise = correlated_normal(seen_by.covariance, len(given), generator)
        if self.vibration is not None:
            noise = noise + self.vibration.tool_displacements(self.nominal.forward(given), generator)
            given = given + self._scales * self.vibration.travel_errors(len(given), given.shape[1], generator)
        return moved_pose(self._carried_out(given, conditions or Conditions())[0], noise)

    @property
    def _scales(self) -> Array:
        return np.array([command.scale for command in self.nominal.commands])

    def _carried_out(self, commands: Array, conditions: Conditions) -> tuple[Array, Array]:
        """Return the poses of the tool, shape=(n, 4, 4), and the coordinates of the joints, shape=(n, nq)."""
        guesses = self.nominal.forward(commands).q
        rises = _rows("temperature_rises", conditions.temperature_rises, commands.shape)
        travels = (commands - [command.offset for command in self.nominal.commands]) / self._scales
        too_far, offsets = np.zeros_like(commands), np.zeros((*commands.shape, 2))
        if self.drift is not None:
            hours = _rows("hours", conditions.hours, commands.shape[:1])[:, None]
            too_far += hours * finite_array("zeros", self.drift.zeros, commands.shape[1:])
            rises = rises + hours * self.drift.warming
        if self.waviness is not None:
            too_far += self.waviness.travel_errors(travels)
            offsets = self.waviness.offsets(travels)
        if self.thermal is not None:
            slides = [self.nominal.single_joint(name).translates for name in self.nominal.actuated_joints]
            too_far += np.where(slides, self.thermal.travel_errors(travels, rises), 0.0)
        wrenches = None
        if conditions.wrenches is not None:
            wrenches = _rows("wrenches", conditions.wrenches, (len(commands), 6))
        carried, q = self._at(commands + self._scales * too_far, guesses, rises.mean(axis=1), offsets, wrenches)
        if not conditions.body_rises:
            return carried, q
        heat = BodyTemperatures(self.nominal, self._bearings, declared_numbers(self.nominal).thermal)
        poses = self.nominal.forward(commands, guess=guesses)
        return moved_pose(carried, heat.motions(poses, conditions.body_rises)), q

    @property
    def _bearings(self) -> Vector:
        """The fixed bearings of the screws; at the joints' zeros if neither growth nor geometry declares them."""
        if self.thermal is not None:
            return self.thermal.bearings
        return (
            np.zeros(len(self.nominal.actuated_joints))
            if self.geometric is None
            else self.geometric.errors.fixed_bearings
        )

    def _at(
        self, commands: Array, guesses: Array, rises: Array, offsets: Array, wrenches: Array | None
    ) -> tuple[Array, Array]:
        """Return the poses and the joints' coordinates; rows with the same geometry are computed together.

        Deflections are those of the geometry without waves and growth, which change them by less than a thousandth.
        """
        crooked = self.nominal
        if self.geometric is not None:
            crooked = self.geometric.errors.apply(self.geometric.values)
        beside = () if self.waviness is None else beside_guideways(crooked)
        growth, per_kelvin = ((), np.zeros(0)) if self.thermal is None else self.thermal.growth(crooked)
        changing = GeometricErrors(crooked, (*beside, *growth))
        states = np.hstack([offsets.reshape(len(rises), -1)[:, : len(beside)], np.outer(rises, per_kelvin)])
        transforms, q = np.empty((len(commands), 4, 4)), np.empty_like(guesses)
        for state in np.unique(states, axis=0):
            rows = np.flatnonzero((states == state).all(axis=1))
            robot = changing.apply(state) if state.any() else crooked
            if self.thermal is not None:
                robot = self.thermal.with_rods(robot, float(rises[rows[0]]))
            poses = robot.forward(commands[rows], guess=guesses[rows])
            transforms[rows], q[rows] = poses.transforms, poses.q
        if self.elastic is None:
            return transforms, q
        loaded = crooked.forward(commands, guess=guesses)
        return moved_pose(transforms, self.elastic.displacements(loaded, wrenches)), q


def _with_all_parameters(errors: GeometricErrors) -> GeometricErrors:
    """Return the errors of every joint and frame of a robot, keeping the tolerances of the listed ones.

    Unlisted errors get the smallest listed tolerance of their kind, or the usual one if none is listed. Errors with
    which the loops cannot close are left out.
    """
    robot = errors.robot
    least = {
        motion: min((p.tolerance for p in errors.parameters if p.motion == motion), default=usual)
        for motion, usual in (("translation", LENGTH_TOLERANCE), ("rotation", ANGLE_TOLERANCE))
    }
    listed = {(p.place, p.motion): p.tolerance for p in errors.parameters}
    everything = [replace(p, tolerance=listed.get((p.place, p.motion), least[p.motion])) for p in all_parameters(robot)]
    return closable(GeometricErrors(robot, everything))


def _rows(name: str, values: ArrayLike, shape: tuple[int, ...]) -> Array:
    array = np.asarray(values, dtype=float)
    try:
        rows = np.array(np.broadcast_to(array, shape))
    except ValueError as error:
        raise ShapeError(name, array.shape, f"one that fits shape {shape}") from error
    if not np.isfinite(rows).all():
        raise InvalidValueError(name, problem="is not finite", expected="finite numbers")
    return rows
