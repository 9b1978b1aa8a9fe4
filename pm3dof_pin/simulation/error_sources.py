"""The sources of a machine's errors, by the classes of Table 8.4: each a thing of its own, to be combined at will.

Quasi-static errors are those of kinematic parameters (manufacturing and assembly: :class:`GeometricSource`, and what no
constant parameter describes: :class:`GuideWaviness`), thermal ones (:class:`ThermalGrowth`) and deflections under load
(:class:`ElasticDeflection`). Vibration (:class:`Vibration`) is what a pose scatters by.
:class:`~pm3dof_pin.simulation.simulated_machine.SimulatedMachine` puts them together.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.loads import AppliedLoads, Loads
from pm3dof_pin.elastic.motions import elastic_motions
from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.degrees_of_freedom import RANK_TOLERANCE
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.typing import Array, Matrix, Vector

STEEL_EXPANSION = 11.5e-6
"""Thermal expansion of steel [1/K]."""


@dataclass(frozen=True, eq=False)
class GeometricSource:
    """Joints and frames that sit wrong, for good: manufacturing and assembly.

    Attributes:
        errors: the parameters.
        values: p, shape=(number of parameters,) [m, rad].
    """

    errors: GeometricErrors
    values: Vector

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InvalidValueError: they are not finite numbers of the right shape.
        """
        self.errors.values(self.values)


@dataclass(frozen=True)
class Wave:
    """One harmonic of a guideway's or screw's error along its travel.

    Attributes:
        amplitude: half of its height [m].
        length: its wavelength [m].
        phase: its phase where the drive's joint has coordinate 0 [rad].
    """

    amplitude: float
    length: float
    phase: float

    def at(self, travel: Array) -> Array:
        """Return the error at a travel [m]."""
        return np.asarray(self.amplitude * np.sin(2.0 * np.pi * travel / self.length + self.phase))


@dataclass(frozen=True, eq=False)
class GuideWaviness:
    """Errors of each drive that change along its travel: of the screw's pitch, and of the guideway's straightness.

    No constant parameter of a robot describes them.

    Attributes:
        pitch: waves along the drive, for each actuated joint.
        straightness: waves across it, in the two directions across the joint's axis, for each actuated joint; empty for
            straight guideways.
    """

    pitch: tuple[tuple[Wave, ...], ...]
    straightness: tuple[tuple[tuple[Wave, ...], tuple[Wave, ...]], ...] = ()

    def travel_errors(self, travels: Array) -> Array:
        """Return how much farther each drive stands than its command says, shape=(n, number of actuated joints) [m].

        Args:
            travels: wanted coordinates of the actuated joints, shape=(n, number of actuated joints) [m].
        """
        _check_count("pitch", self.pitch, travels.shape[1])
        errors = np.zeros_like(travels)
        for drive, waves in enumerate(self.pitch):
            errors[:, drive] = sum((wave.at(travels[:, drive]) for wave in waves), np.zeros(len(travels)))
        return errors

    def offsets(self, travels: Array) -> Array:
        """Return how far each carriage stands beside its line, shape=(n, number of actuated joints, 2) [m].

        Args:
            travels: see :meth:`travel_errors`.
        """
        offsets = np.zeros((*travels.shape, 2))
        if self.straightness:
            _check_count("straightness", self.straightness, travels.shape[1])
        for drive, directions in enumerate(self.straightness):
            for across, waves in enumerate(directions):
                offsets[:, drive, across] = sum((wave.at(travels[:, drive]) for wave in waves), np.zeros(len(travels)))
        return offsets

    @classmethod
    def random(
        cls,
        drives: int,
        generator: np.random.Generator,
        *,
        pitch_amplitude: float = 3e-6,
        straightness_amplitude: float = 3e-6,
        lengths: Sequence[float] = (0.12, 0.05, 0.02),
    ) -> GuideWaviness:
        """Draw waves of given lengths with random phases and amplitudes.

        Args:
            drives: number of actuated joints.
            generator: source of the random numbers.
            pitch_amplitude: standard deviation of the waves along the drive [m].
            straightness_amplitude: standard deviation of the waves across it [m].
            lengths: wavelengths [m].
        """

        def waves(amplitude: float) -> tuple[Wave, ...]:
            return tuple(
                Wave(amplitude * generator.standard_normal(), length, generator.uniform(0.0, 2.0 * np.pi))
                for length in lengths
            )

        return cls(
            tuple(waves(pitch_amplitude) for _ in range(drives)),
            tuple((waves(straightness_amplitude), waves(straightness_amplitude)) for _ in range(drives)),
        )


@dataclass(frozen=True, eq=False)
class ThermalGrowth:
    """Growth of the screws from their fixed bearings, and of members between joints.

    The travel of a drive is too long by the growth of its screw between the fixed bearing and the nut,
    du = a * integral of the temperature rise from the bearing to u.

    Attributes:
        bearings: coordinate of each actuated joint at the fixed bearing of its screw, shape=(number of actuated
            joints,) [m].
        profile: temperature along each screw as multiples of the rise that is measured, at growing distances from the
            bearing [m]: linear between these, constant beyond the ends. The same everywhere by default.
        members: joints or frames whose distance from the joint before grows, by their temperature's share of the rise
            measured: 1 for links as warm as the screws, 0.2 for cooler ones.
        expansion: a [1/K].
    """

    bearings: Vector
    profile: tuple[tuple[float, float], ...] = ((0.0, 1.0),)
    members: Mapping[str, float] = field(default_factory=dict)
    expansion: float = STEEL_EXPANSION

    def travel_errors(self, travels: Array, temperature_rises: Array) -> Array:
        """Return how much too far each drive goes, shape=(n, number of actuated joints) [m].

        Args:
            travels: wanted coordinates of the actuated joints, shape=(n, number of actuated joints) [m].
            temperature_rises: of each screw, shape=(n, number of actuated joints) [K].
        """
        distance = travels - finite_array("bearings", self.bearings, (travels.shape[1],))
        return self.expansion * temperature_rises * self._integral(distance)

    def grown(self, robot: Robot, temperature_rise: float) -> Robot:
        """Return a robot with grown members.

        Args:
            robot: the robot.
            temperature_rise: mean rise [K].
        """
        if not self.members or temperature_rise == 0.0:
            return robot
        parameters = [_translation(place, axis) for place in self.members for axis in range(3)]
        growth: dict[str, float] = {}
        for place, share in self.members.items():
            placement = _placement_on_body(robot, place)
            longer = self.expansion * share * temperature_rise * (placement.rotation.T @ placement.translation)
            growth |= {_translation(place, axis).name: float(longer[axis]) for axis in range(3)}
        return GeometricErrors(robot, parameters).apply(growth)

    def _integral(self, distance: Array) -> Array:
        """Integrate the profile from the bearing to a distance."""
        places, shares = np.array(self.profile, dtype=float).T
        if np.any(np.diff(places) <= 0.0):
            raise InvalidValueError("profile", self.profile, "growing distances from the bearing")
        # from the first place of the profile on, then back to the bearing
        knots = np.concatenate([[0.0], np.cumsum(0.5 * (shares[1:] + shares[:-1]) * np.diff(places))])

        def from_first(x: Array) -> Array:
            inner = np.clip(x, places[0], places[-1])
            k = np.clip(np.searchsorted(places, inner, side="right") - 1, 0, max(len(places) - 2, 0))
            share = np.interp(inner, places, shares)
            within = knots[k] + 0.5 * (shares[k] + share) * (inner - places[k])
            return np.asarray(within + (x - inner) * np.where(x < places[0], shares[0], shares[-1]))

        return from_first(distance) - from_first(np.zeros(1))


@dataclass(frozen=True, eq=False)
class ElasticDeflection:
    """Deflection of joints and links under the machine's own weight, a payload and a wrench on the tool.

    Linear in the loads, with the springs of the description; see :mod:`pm3dof_pin.elastic.loaded` for large ones.

    Attributes:
        own_weight: whether the bodies have their weight. The deflection counts from the weightless machine.
        payload: mass at the tool point [kg].
    """

    own_weight: bool = True
    payload: float = 0.0

    def displacements(self, poses: Poses, wrenches: Array | None = None) -> Matrix:
        """Return how far the tool gives at each pose, commands held, world axes, shape=(n, 6) [m, rad].

        Args:
            poses: poses of a robot with springs.
            wrenches: dead wrenches [f; m] on the tool, world axes, shape=(n, 6) [N, N m].

        Raises:
            DescriptionError: the robot has no springs, or no tool frame.
        """
        tool = poses.robot.model.frames[poses.robot.tool_frame_id].name
        model = ElasticModel(poses.robot)
        weights = AppliedLoads(model.mechanism, [(1.0, Loads({}, {tool: self.payload}, self.own_weight))])
        displacements = np.empty((len(poses), 6))
        for row, q in enumerate(poses.q):
            configuration = model.configuration(q)
            motions = elastic_motions(model, configuration, tolerance=RANK_TOLERANCE).elastic
            jacobian = configuration.tool_jacobian
            forces = weights.forces(configuration)
            if wrenches is not None:
                forces = forces + jacobian.T @ wrenches[row]
            displacements[row] = jacobian @ motions @ (motions.T @ forces)
        return displacements


@dataclass(frozen=True, eq=False)
class Vibration:
    """What a pose scatters by while it is measured or worked at: of the tool, and of the drives with their motors.

    Attributes:
        tool_covariance: covariance of the tool's displacement [translation; rotation vector], world axes, shape=(6, 6)
            [m^2, m rad, rad^2].
        drive_sigma: standard deviation of each drive's coordinate [m, rad].
    """

    tool_covariance: Matrix
    drive_sigma: float = 0.0

    @classmethod
    def from_spectrum(
        cls, frequencies: ArrayLike, amplitudes: ArrayLike, *, averaging_time: float = 0.0, drive_sigma: float = 0.0
    ) -> Vibration:
        """Make a vibration out of lines of a spectrum with random phases.

        Averaging over a time T leaves sin(pi f T) / (pi f T) of a line at f.

        Args:
            frequencies: of the lines, shape=(k,) [Hz].
            amplitudes: of the tool's displacement at each line, all six in phase, shape=(k, 6) [m, rad].
            averaging_time: time over which a measurement averages [s].
            drive_sigma: standard deviation of each drive's coordinate [m, rad].

        Raises:
            InvalidValueError: lines of different number or that are not finite.
        """
        lines = finite_array("amplitudes", amplitudes, (np.size(frequencies), 6))
        left = np.sinc(finite_array("frequencies", frequencies, (len(lines),)) * averaging_time)
        reduced = lines * left[:, None]
        return cls(0.5 * reduced.T @ reduced, drive_sigma)

    def tool_displacements(self, count: int, generator: np.random.Generator) -> Matrix:
        """Draw displacements of the tool, shape=(count, 6) [m, rad]."""
        return correlated_normal(self.tool_covariance, count, generator)

    def travel_errors(self, count: int, drives: int, generator: np.random.Generator) -> Matrix:
        """Draw displacements of the drives, shape=(count, drives) [m, rad]."""
        return self.drive_sigma * generator.standard_normal((count, drives))


def correlated_normal(covariance: ArrayLike, count: int, generator: np.random.Generator) -> Matrix:
    """Draw normal vectors of a covariance that may be singular, shape=(count, k).

    Raises:
        InvalidValueError: the covariance is not symmetric and positive semidefinite.
    """
    matrix = np.asarray(covariance, dtype=float)
    scale = np.sqrt(np.diag(matrix).clip(min=0.0))
    unit = np.where(scale > 0.0, scale, 1.0)
    values, axes = np.linalg.eigh(matrix / np.outer(unit, unit))
    if not np.allclose(matrix, matrix.T) or values.min(initial=0.0) < -1e-9:
        raise InvalidValueError("covariance", matrix.tolist(), "a symmetric positive semidefinite matrix")
    root = unit[:, None] * axes * np.sqrt(values.clip(min=0.0))
    draws: Matrix = generator.standard_normal((count, len(matrix))) @ root.T
    return draws


def _check_count(name: str, entries: Sequence[object], drives: int) -> None:
    if len(entries) != drives:
        raise InvalidValueError(name, f"{len(entries)} entries", f"one for each of {drives} actuated joints")


def _translation(place: str, axis: int) -> GeometricParameter:
    x, y, z = (float(axis == k) for k in range(3))
    return GeometricParameter(f"{place}.t{'xyz'[axis]}", place, "translation", (x, y, z), "thermal", 1.0)


def _placement_on_body(robot: Robot, place: str) -> pin.SE3:
    model = robot.model
    if model.existJointName(place):
        return model.jointPlacements[model.getJointId(place)]
    return model.frames[robot.frame_id(place)].placement
