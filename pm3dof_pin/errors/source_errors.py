"""Effect of each source of error on the tool, to first order, in the classes of Table 8.4.

A source is a known shift (a deflection under a given wrench) plus independent random numbers of known standard
deviation, each of which moves the tool along some twist. All sources have this form, so they add.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.description.error_file import AXES
from pm3dof_pin.description.source_numbers import SourceNumbers, Thermal
from pm3dof_pin.dynamics.batch import actuator_forces
from pm3dof_pin.errors.body_temperatures import EVERYTHING, SCREWS, BodyTemperatures
from pm3dof_pin.errors.command_correction import command_scales
from pm3dof_pin.errors.elastic_deflection import ElasticDeflection
from pm3dof_pin.errors.error_parameters import (
    HALF_WIDTH,
    Distribution,
    GeometricErrors,
    all_parameters,
    beside_guideways,
    declared_numbers,
    displacement_errors,
)
from pm3dof_pin.errors.normal_vectors import covariance_root
from pm3dof_pin.errors.pose_error import pose_difference
from pm3dof_pin.errors.sensitivity import Sensitivities, closable, sensitivities
from pm3dof_pin.errors.thermal_growth import Bending, ThermalGrowth
from pm3dof_pin.errors.vibration import Vibration
from pm3dof_pin.exceptions import PM3DofError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import Array

ErrorClass = Literal["kinematic parameters", "thermal", "stiffness", "drives", "vibration"]
"""Classes of Table 8.4; "drives" are clearance and the other factors that the chapter's text adds."""

CLASSES: tuple[ErrorClass, ...] = get_args(ErrorClass)
"""All classes, in their order."""

MAX_VIBRATION = 3.0
"""Greatest vibration assumed in worst cases, in standard deviations, since normal numbers are unbounded."""

_WARM = 10.0  # [K]: large against rounding in the closing of loops, small against expansion


@dataclass(frozen=True, eq=False)
class SourceErrors:
    """Effect of one source on the tool at n poses."""

    name: str  #: the source, unique; words joined by underscores
    error_class: ErrorClass  #: its class
    long_name: str  #: its description
    repeats: bool  #: whether it is the same at every visit to a pose, so that commands can undo it
    shift: Array  #: known effect, [translation; rotation vector], world axes, shape=(n, 6) [m, rad]
    effects: Array  #: effect of each independent number at one standard deviation, shape=(n, 6, k) [m, rad]
    greatest: Array  #: the greatest value of each number, in standard deviations, shape=(k,)


@dataclass(frozen=True, eq=False)
class KinematicNumbers:
    """The independent numbers of class "kinematic parameters", whose effects are columns of constant sensitivities."""

    errors: GeometricErrors  #: geometric errors, then waves across guideways
    deviations: Array  #: standard deviation of each, then of each drive's waviness along its joint [m, rad]
    greatest: Array  #: greatest value of each, in standard deviations


class ErrorSources:
    """The sources of error of one robot, with their magnitudes.

    Args:
        errors: its geometric errors, with their tolerances.
        numbers: magnitudes of the other sources; by default those of the robot's error file or documented defaults.
        wrench: force and moment on the tool at work, instead of the file's, world axes, shape=(6,) [N, N m].
        rise: greatest temperature difference, colder or warmer, from the described state, instead of the file's [K].
        large: whether deflections are those of the loaded equilibrium instead of linear.
        distribution: meaning of the geometric tolerances.

    Attributes are `errors`, the `numbers` used, `wrench`, `rise`, `large` and `distribution`.

    Raises:
        DescriptionError: the error file is unreadable or malformed.
        InvalidValueError: the wrench is not finite or not of shape (6,).
    """

    def __init__(
        self,
        errors: GeometricErrors,
        numbers: SourceNumbers | None = None,
        *,
        wrench: ArrayLike | None = None,
        rise: float | None = None,
        large: bool = False,
        distribution: Distribution = "normal",
    ) -> None:
        self.errors, self.large = errors, large
        self.distribution: Distribution = distribution
        found = declared_numbers(errors.robot) if numbers is None else numbers
        load, thermal = found.load, found.thermal
        self.wrench = finite_array("wrench", load.wrench if wrench is None else wrench, (6,))
        self.rise = float(finite_array("rise", thermal.rise_K if rise is None else rise, ()))
        self.numbers = found

    @property
    def robot(self) -> Robot:
        """The robot as described."""
        return self.errors.robot

    @cached_property
    def thermal_growth(self) -> ThermalGrowth:
        """Thermal growth of the robot, as in simulated machines."""
        numbers, robot = self.numbers.thermal, self.robot
        shares = numbers.members
        if not isinstance(shares, dict):
            shares = {
                p.place: shares
                for p in all_parameters(robot)
                if p.motion == "translation" and p.place not in robot.rods
            }
        bearings, rods = np.array(self.errors.fixed_bearings), {}
        if not isinstance(numbers.members, dict):
            rods = {loop.name: numbers.members for loop in robot.closures if loop.kind.is_distance}
        together = ThermalGrowth(bearings, members=shares, expansion=numbers.expansion_per_K, rods=rods)
        kept = shares
        try:
            together.grown(robot, _WARM).forward(robot.home.commands, guess=robot.home)
        except PM3DofError:  # members that do not close the loops together: those that do alone
            growing = GeometricErrors(robot, displacement_errors(robot, shares, "thermal", ["translation"]))
            closing = {parameter.place for parameter in closable(growing).parameters}
            kept = {place: share for place, share in shares.items() if place in closing}
        bending = {
            place: Bending((1.0 / member.depth_m, 1.0 / member.depth_m), member.along_m)
            for place, member in numbers.bending.items()
        }
        return ThermalGrowth(bearings, numbers.profile, kept, numbers.expansion_per_K, bending, rods)

    @cached_property
    def vibration(self) -> Vibration | None:
        """Vibration of the robot; None without springs, as it has no modes."""
        if not self.robot.springs:
            return None
        payload, tool = self.numbers.load.payload_kg, self.robot.tool_frame
        return Vibration(
            spectra=self.numbers.vibration, payloads={tool: payload} if payload and tool is not None else None
        )

    def at(
        self, poses: Poses, classes: Collection[ErrorClass] = CLASSES, found: Sensitivities | None = None
    ) -> tuple[SourceErrors, ...]:
        """Return the effects of the sources, or of some classes, at poses of the robot as described, of shape (n,).

        Sources that a robot cannot have are left out: those of springs without springs, of screws without linear
        drives. `found` are the sensitivities to the geometric errors at these poses, if they are known already.

        Raises:
            InvalidValueError: the loops cannot close with a geometric error.
            SingularConfigurationError: at some pose the tool can move with all drives locked, or with all springs at
                rest.
            ConvergenceError: no equilibrium was found, for large deflections.
        """
        at_poses = _SourcesAtPoses(self, poses, found)
        return tuple(source for error_class in CLASSES if error_class in classes for source in at_poses.of(error_class))

    @cached_property
    def others(self) -> GeometricErrors:
        """Displacements by sources other than geometry: across guideways, by heat, within clearances."""
        robot, numbers = self.robot, self.numbers
        parameters = displacement_errors(robot, self.thermal_growth.members, "thermal", ["translation"])
        parameters += displacement_errors(robot, self.thermal_growth.bending, "bending")
        if numbers.clearance.play_m:
            parameters += displacement_errors(robot, numbers.clearance.at, "clearance", ["translation"])
        if numbers.waviness.straightness_m and numbers.waviness.lengths_m and self.slides.any():
            parameters += itertools.compress(beside_guideways(robot), np.repeat(self.slides, 2))
        named = [replace(parameter, name=f"{parameter.group} {parameter.name}") for parameter in parameters]
        return closable(GeometricErrors(robot, named))

    @cached_property
    def kinematic(self) -> KinematicNumbers:
        """The numbers of class "kinematic parameters", without poses."""
        errors, numbers = self.errors, self.numbers.waviness
        beside = [parameter for parameter in self.others.parameters if parameter.group == "waviness"]
        counts = (len(errors), len(beside), len(self.slides))
        scatter, most = _of_waves(len(numbers.lengths_m))
        along = np.where(self.slides, numbers.pitch_m, 0.0)
        waves = np.concatenate([np.full(len(beside), numbers.straightness_m), along]) * scatter
        factor = self.geometry_factor
        return KinematicNumbers(
            GeometricErrors(self.robot, (*errors.parameters, *beside)),
            np.concatenate([errors.tolerances / factor, waves]),
            np.repeat([factor, most, most], counts),
        )

    @property
    def geometry_factor(self) -> float:
        """Number of standard deviations in a geometric tolerance."""
        return HALF_WIDTH if self.distribution == "uniform" else 1.0

    @cached_property
    def slides(self) -> Array:
        """Mask of the linear drives, shape=(number of drives,)."""
        return np.array([self.robot.single_joint(name).translates for name in self.robot.actuated_joints])


class _SourcesAtPoses:
    """The sources of one robot at some poses; shared quantities are computed once."""

    def __init__(self, sources: ErrorSources, poses: Poses, found: Sensitivities | None) -> None:
        self._sources, self._poses, self._found = sources, poses, found
        self._robot, self._numbers = sources.robot, sources.numbers
        self._scales = command_scales(poses)
        self._moved = sensitivities(sources.others, poses)
        self._by_drives = self._moved.commands * self._scales  # by the drives' joints

    def of(self, error_class: ErrorClass) -> Iterator[SourceErrors]:
        """Return the sources of a class that the robot has."""
        found: dict[ErrorClass, Callable[[], Iterator[SourceErrors]]] = {
            "kinematic parameters": self._kinematic,
            "thermal": self._thermal,
            "stiffness": self._stiffness,
            "drives": self._drives,
            "vibration": self._vibration,
        }
        return (replace(source, error_class=error_class) for source in found[error_class]())

    def _source(
        self,
        name: str,
        long_name: str,
        effects: Array | None = None,
        *,
        greatest: float = 1.0,
        shift: Array | None = None,
        repeats: bool = True,
    ) -> SourceErrors:
        count = len(self._poses)
        effects = np.zeros((count, 6, 0)) if effects is None else effects
        shift = np.zeros((count, 6)) if shift is None else shift
        sizes = np.full(effects.shape[2], greatest)
        return SourceErrors(name, CLASSES[0], long_name, repeats, shift, effects, sizes)

    def _uniform(self, name: str, long_name: str, reach: Array, *, repeats: bool = True) -> SourceErrors:
        """A source of uniform numbers; `reach` is the effect of each at its greatest value."""
        return self._source(name, long_name, reach / HALF_WIDTH, greatest=HALF_WIDTH, repeats=repeats)

    def _drift(self, name: str, long_name: str, per_hour: Array) -> SourceErrors:
        """A source that grows with time; rate and time are uniform up to their greatest values."""
        effects = per_hour * (self._numbers.drift.hours / 3.0)
        return self._source(name, long_name, effects, greatest=3.0, repeats=False)

    def _kinematic(self) -> Iterator[SourceErrors]:
        errors, factor = self._sources.errors, self._sources.geometry_factor
        if len(errors):
            found = sensitivities(errors, self._poses) if self._found is None else self._found
            effects = found.errors * errors.tolerances / factor
            for group in errors.groups:
                words = f"manufacturing and assembly: {group.replace('_', ' ')}"
                yield self._source(f"geometry_{group}", words, effects[:, :, errors.indices(group)], greatest=factor)
        numbers, slides = self._numbers.waviness, self._sources.slides
        if slides.any() and numbers.lengths_m and (numbers.pitch_m or numbers.straightness_m):
            scatter, most = _of_waves(len(numbers.lengths_m))
            along = self._by_drives[:, :, slides] * (numbers.pitch_m * scatter)
            beside = self._others("waviness") * (numbers.straightness_m * scatter)
            effects = np.concatenate([along, beside], axis=2)
            yield self._source("waviness", "waviness of guides and screws", effects, greatest=most)

    def _thermal(self) -> Iterator[SourceErrors]:
        growth, sources, drift = self._sources.thermal_growth, self._sources, self._numbers.drift
        offsets = np.array([command.offset for command in self._robot.commands])
        travels = (self._poses.commands - offsets) / self._scales
        per_kelvin = np.where(sources.slides, growth.travel_errors(travels, np.ones_like(travels)), 0.0)
        by_screw = self._by_drives * per_kelvin[:, None, :]
        together = self._together(growth, by_screw)[:, :, None]
        if together.any() and sources.rise:
            words = "mean thermal growth of screws and members"
            yield self._uniform("thermal_growth", words, together * sources.rise)
        if together.any() and drift.warming_K_per_h * drift.hours:
            rates = together * drift.warming_K_per_h
            yield self._drift("thermal_drift", "warming during the job", rates)
        between, count = self._numbers.thermal.between_drives_K, by_screw.shape[2]
        if between and by_screw.any() and count > 1:
            # independent rises minus their mean, which is the source above
            differences = by_screw @ (np.eye(count) - 1.0 / count) * between
            yield self._uniform("thermal_gradient", "temperature differences between screws", differences)
        yield from self._bodies()
        bent = self._bent() * (growth.expansion * self._numbers.thermal.across_K)
        if bent.any():
            yield self._uniform("thermal_bending", "bending of members by temperature gradients", bent)

    def _together(self, growth: ThermalGrowth, by_screw: Array) -> Array:
        """Effect of the mean rise on screws and members per kelvin, shape=(n, 6) [m/K, rad/K]."""
        numbers = self._numbers.thermal
        members, is_uniform = numbers.members, numbers.profile == Thermal().profile
        if is_uniform and not isinstance(members, dict) and (self._robot.couplings or numbers.expansions_per_K):
            return self._warming({EVERYTHING: members} | ({SCREWS: 1.0} if SCREWS in self._heat.names else {}))
        return np.asarray(by_screw.sum(axis=2) + self._by_members(growth))

    def _bodies(self) -> Iterator[SourceErrors]:
        """Single bodies colder or warmer than the rest, or on one side, by differences of a warm machine."""
        numbers = self._numbers.thermal
        if any(numbers.bodies_K.values()):
            reach = np.stack([self._warming({name: 1.0}) * most for name, most in numbers.bodies_K.items()], axis=2)
            yield self._uniform("thermal_bodies", "temperatures of single bodies", reach)
        columns = []
        for name, most in numbers.gradients_K_per_m.items():
            for axis in AXES:
                with suppress(UnreachablePoseError):  # it would strain the loops, as out of the plane of a planar robot
                    columns.append(self._warming({f"{name}:{axis}": 1.0}) * most)
        if columns:
            yield self._uniform("thermal_fields", "temperature gradients in bodies", np.stack(columns, axis=2))

    @cached_property
    def _heat(self) -> BodyTemperatures:
        errors = self._sources.errors
        return BodyTemperatures(self._robot, np.array(errors.fixed_bearings), self._numbers.thermal)

    def _warming(self, rises: dict[str, float]) -> Array:
        """Effect of temperatures in the units given, shape=(n, 6) [m, rad]."""
        ends = [
            self._heat.poses(self._poses, {name: sign * _WARM * rise for name, rise in rises.items()})
            for sign in (-1.0, 1.0)
        ]
        return pose_difference(*ends) / (2.0 * _WARM)

    def _by_members(self, growth: ThermalGrowth) -> Array:
        """Effect of the growth of all members per kelvin, shape=(n, 6) [m/K, rad/K]."""
        members = {f"thermal {name}": size for name, size in growth.growth_per_kelvin(self._robot).items() if size}
        names = self._names("thermal")
        if members.keys() <= set(names) and not growth.rods:
            return np.asarray(self._others("thermal") @ [members.get(name, 0.0) for name in names])
        # rods, and members that close the loops only together, as in a planar mechanism that is warm all over
        ends = [
            growth.grown(self._robot, rise).forward(self._poses.commands, guess=self._poses.q).transforms
            for rise in (-_WARM, _WARM)
        ]
        return pose_difference(*ends) / (2.0 * _WARM)

    def _bent(self) -> Array:
        """Effect of each kelvin across each member, over its expansion, shape=(n, 6, 2 members that bend)."""
        moved = dict(zip(self._names("bending"), np.moveaxis(self._others("bending"), 2, 0), strict=True))
        growth, columns = self._sources.thermal_growth, []
        for bend in (bend for place in growth.bending for bend in growth.bends(self._robot, place)):
            named = {f"bending {name}": amount for name, amount in bend.items()}
            if named.keys() <= moved.keys():  # otherwise it would strain the loops
                column = np.sum([amount * moved[name] for name, amount in named.items()], axis=0)
                # a link between two joints rotates about them, which does not move the tool
                if np.abs(column).max() > ROUNDING * max(map(abs, named.values())):
                    columns.append(column)
        return np.stack(columns, axis=2) if columns else np.zeros((len(self._poses), 6, 0))

    def _stiffness(self) -> Iterator[SourceErrors]:
        if not self._robot.springs:
            return
        load, sources = self._numbers.load, self._sources
        weight = ElasticDeflection(load.own_weight, load.payload_kg, sources.large)
        under_weight = np.zeros((len(self._poses), 6))
        if load.own_weight or load.payload_kg:
            under_weight = weight.displacements(self._poses)
            yield self._source("weight", "deflection under weight and payload", shift=under_weight)
        if sources.wrench.any():
            wrenches = np.tile(sources.wrench, (len(self._poses), 1))
            if sources.large:
                deflection = weight.displacements(self._poses, wrenches) - under_weight
            else:
                deflection = ElasticDeflection(own_weight=False).displacements(self._poses, wrenches)
            size = "large" if sources.large else "small"
            yield self._source("wrench", f"deflection under the wrench at work ({size})", shift=deflection)

    def _drives(self) -> Iterator[SourceErrors]:
        numbers, slides, drift = self._numbers.drives, self._sources.slides, self._numbers.drift
        backlash = np.where(slides, numbers.backlash_m, numbers.backlash_rad)
        step = np.where(slides, numbers.encoder_step_m, numbers.encoder_step_rad)
        if backlash.any():
            effects = self._by_drives * (0.5 * backlash)
            yield self._source("backlash", "backlash of the drives", effects, repeats=False)
        if step.any():
            yield self._uniform("encoder", "encoder resolution", self._by_drives * (0.5 * step), repeats=False)
        yield from self._servo()
        if self._names("clearance"):
            reach = self._others("clearance") * self._numbers.clearance.play_m
            yield self._uniform("clearance", "clearance of passive joints", reach, repeats=False)
        rates = np.where(slides, drift.zeros_m_per_h, drift.zeros_rad_per_h)
        if rates.any() and drift.hours:
            yield self._drift("drift", "drift of the drives' zeros during the job", self._by_drives * rates)

    def _servo(self) -> Iterator[SourceErrors]:
        """Following errors of the drives: their load over the servo's stiffness."""
        numbers, slides = self._numbers.drives, self._sources.slides
        linear, angular = numbers.servo_stiffness_N_per_m, numbers.servo_stiffness_Nm_per_rad
        stiffness = np.where(slides, linear or np.inf, angular or np.inf)
        if np.isinf(stiffness).all():
            return
        load = self._numbers.load
        wrench = self._sources.wrench.copy()
        wrench[:3] += load.payload_kg * self._robot.model.gravity.linear
        pushed = np.einsum("nij,i->nj", self._by_drives, wrench)
        if load.own_weight:
            pushed -= actuator_forces(self._robot, self._poses)
        shift = np.einsum("nij,nj->ni", self._by_drives, pushed / stiffness)
        yield self._source("servo", "servo deflection under weight and wrench", shift=shift)

    def _vibration(self) -> Iterator[SourceErrors]:
        vibration = self._sources.vibration
        words = {"tool": "of the tool", "motors": "of the motors", "axes": "of the system's axes, through the floor"}
        for cause, covariance in ({} if vibration is None else vibration.covariances_by_cause(self._poses)).items():
            name, effects = f"vibration_{cause}", covariance_root(covariance)
            yield self._source(name, words[cause], effects, greatest=MAX_VIBRATION, repeats=False)

    def _names(self, group: str) -> list[str]:
        return [parameter.name for parameter in self._sources.others.parameters if parameter.group == group]

    def _others(self, group: str) -> Array:
        return self._moved.errors[:, :, [parameter.group == group for parameter in self._sources.others.parameters]]


def _of_waves(count: int) -> tuple[float, float]:
    """Return the standard deviation of waves of random phase in amplitudes, and their total reach in deviations."""
    return float(np.sqrt(0.5 * count)), float(np.sqrt(2.0 * count))
