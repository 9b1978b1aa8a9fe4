"""Quantities that can be mapped over the poses of a robot, with names, dimensions and units.

A new quantity is a function of an :class:`Evaluation`, decorated with :func:`quantity`. Higher rooms add their own in
the same way, and say for which robots they exist.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.batch import actuator_forces, drive_mass_matrices, natural_frequencies
from pm3dof_pin.elastic.batch import evaluate
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.free_motions import FreeMotionStiffness, free_motion_stiffness
from pm3dof_pin.elastic.indices import axis_stiffness
from pm3dof_pin.elastic.quantities import (
    AXIS_COMPLIANCE,
    COMPLIANCE,
    CONDITIONING,
    PRINCIPAL_STIFFNESS,
    STIFFNESS,
    ElasticQuantity,
    free_stiffness,
    spring_shares,
)
from pm3dof_pin.exceptions import InvalidValueError, PM3DofError, ProgramError
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.pose_values import BatchOptions
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.samples import samples_near_home
from pm3dof_pin.kinematics.singularity import singularity_distances
from pm3dof_pin.kinematics.singularity_measures import singularity_measures
from pm3dof_pin.typing import Array

_MODES = 6


class MappedRobot:
    """A robot, or an elastic model, whose quantities are mapped; its springs are read when a quantity needs them."""

    def __init__(self, robot: Robot | ElasticModel) -> None:
        self.robot = robot.rigid if isinstance(robot, ElasticModel) else robot
        self._given = robot

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._given,)

    @cached_property
    def elastic(self) -> ElasticModel:
        """The robot with its springs; DescriptionError if the description has none."""
        return self._given if isinstance(self._given, ElasticModel) else ElasticModel(self._given)

    @cached_property
    def free_motions(self) -> FreeMotionStiffness | None:
        """The free motions of the robot; None if they are not independent or not elastic.

        They are those at home or, if home is singular, at most of the closed configurations near it.
        """
        found = [motions for q in self.usual_poses.q if (motions := self._free_motions_at(q)) is not None]
        names = Counter(motions.names for motions in found).most_common(1)
        return next((motions for motions in found if motions.names == names[0][0]), None)

    @cached_property
    def usual_poses(self) -> Poses:
        """Home; or, if that is singular, closed configurations near it."""
        home = self.robot.home.q
        if self._free_motions_at(home) is None:
            with suppress(ProgramError):
                return self.robot.at(samples_near_home(self.robot))
        return self.robot.at(home[None])

    @cached_property
    def usual_mobility(self) -> Mobility:
        """The degrees of freedom at a generic configuration near home, as a reference for singular ones."""
        return instantaneous_mobility(generic_configuration(self.robot.home))

    @cached_property
    def singularity_types(self) -> tuple[str, ...]:
        """The types of singularity that the robot can have."""
        home = singularity_distances(self.robot.home, generic=self.usual_mobility)
        return tuple(distance.type for distance in home)

    def _free_motions_at(self, q: Array) -> FreeMotionStiffness | None:
        try:
            return free_motion_stiffness(self.elastic, self.robot.configuration(q))
        except PM3DofError:
            return None


class Evaluation:
    """A robot at a batch of poses (unsolved ones give NaN); shared results are computed once."""

    def __init__(self, mapped: MappedRobot, poses: Poses, *, threads: int | None = None) -> None:
        self.mapped = mapped
        self.poses = poses
        self.batch: BatchOptions = {"on_failure": "nan", "threads": threads}
        self._elastic: dict[str, Array] = {}

    def elastic(self, quantity: ElasticQuantity) -> Array:
        """Return a quantity of the elastic behaviour of the tool, shape=(..., *its shape); NaN where it fails."""
        if quantity.name not in self._elastic:
            self._elastic[quantity.name] = evaluate(self.mapped.elastic, self.poses, quantity, **self.batch).values
        return self._elastic[quantity.name]


@dataclass(frozen=True)
class Dimension:
    """A named dimension of a quantity, in addition to those of the poses, with labels depending on the robot."""

    name: str
    labels: Callable[[MappedRobot], tuple[str, ...]]


Unit: TypeAlias = str | Callable[[MappedRobot], str]


@dataclass(frozen=True)
class Quantity:
    """One quantity of a map."""

    name: str  #: its name
    compute: Callable[[Evaluation], Array]  #: from an evaluation to an array, shape=(..., *own dimensions)
    unit: Unit  #: its unit; if the entries differ, each unit followed by its entries in brackets
    long_name: str  #: its description
    dims: tuple[Dimension, ...]  #: its own dimensions, after those of the poses
    exists: Callable[[MappedRobot], bool]  #: whether a robot has it

    def unit_for(self, mapped: MappedRobot) -> str:
        """Return the unit for a robot."""
        return self.unit if isinstance(self.unit, str) else self.unit(mapped)

    def shape_for(self, mapped: MappedRobot) -> tuple[int, ...]:
        """Return the shape of its value at one pose of a robot."""
        return tuple(len(dim.labels(mapped)) for dim in self.dims)


QUANTITIES: dict[str, Quantity] = {}
"""All known quantities by name."""


def quantity(
    *names: str,
    unit: Unit,
    long_name: str,
    dims: tuple[Dimension, ...] = (),
    exists: Callable[[MappedRobot], bool] = lambda mapped: True,
) -> Callable[[Callable[[Evaluation], Array]], Callable[[Evaluation], Array]]:
    """Register a function of an :class:`Evaluation` as a quantity with one or more names; see :class:`Quantity`."""

    def register(compute: Callable[[Evaluation], Array]) -> Callable[[Evaluation], Array]:
        for name in names:
            QUANTITIES[name] = Quantity(name, compute, unit, long_name, dims, exists)
        return compute

    return register


def select_quantities(names: Iterable[str], mapped: MappedRobot | None = None) -> tuple[Quantity, ...]:
    """Return the quantities of the given names, in that order, each once.

    Raises:
        InvalidValueError: no names, an unknown one, or one that the robot, if given, does not have.
    """
    known = {name: entry for name, entry in QUANTITIES.items() if mapped is None or entry.exists(mapped)}
    selected = tuple(dict.fromkeys(names))
    unknown = [name for name in selected if name not in known]
    if unknown or not selected:
        raise InvalidValueError("quantities", ", ".join(unknown) or "none", f"some of {', '.join(known)}")
    return tuple(known[name] for name in selected)


def has_drives_and_tool(mapped: MappedRobot) -> bool:
    """Tell whether the robot has drives and a tool."""
    return mapped.robot.tool_frame is not None and bool(mapped.robot.actuated_joints)


def _command_unit(mapped: MappedRobot) -> str:
    """Return the units of the commands."""
    return _listed_units((command.unit, command.name) for command in mapped.robot.commands)


def _force_unit(mapped: MappedRobot) -> str:
    """Return the units of the forces of the actuated joints."""
    robot = mapped.robot
    return _listed_units(("N" if robot.single_joint(n).translates else "N m", n) for n in robot.actuated_joints)


def _listed_units(entries: Iterable[tuple[str, str]]) -> str:
    """Return units; if they differ, each followed by the names that have it."""
    by_unit: dict[str, list[str]] = {}
    for unit, name in entries:
        by_unit.setdefault(unit, []).append(name)
    if len(by_unit) == 1:
        return next(iter(by_unit))
    return ", ".join(f"{unit} ({', '.join(names)})" for unit, names in by_unit.items())


_SIX = tuple(str(number + 1) for number in range(_MODES))  # ascending values
AXIS = Dimension("axis", lambda mapped: TOOL_COMPONENTS)
AXIS_2 = Dimension("axis_2", lambda mapped: TOOL_COMPONENTS)
PRINCIPAL = Dimension("principal", lambda mapped: ("least", "middle", "greatest"))
MODE = Dimension("mode", lambda mapped: _SIX)
NATURAL_MODE = Dimension("natural_mode", lambda mapped: _SIX)
SPRING = Dimension("spring", lambda mapped: mapped.elastic.spring_names)
SINGULARITY = Dimension("singularity", lambda mapped: mapped.singularity_types)
COMMAND = Dimension("command", lambda mapped: tuple(command.name for command in mapped.robot.commands))
DRIVE = Dimension("drive", lambda mapped: mapped.robot.actuated_joints)


def _part_of(source: ElasticQuantity, part: Any = np.s_[...]) -> Callable[[Evaluation], Array]:
    """Return a quantity that is a part of an elastic quantity."""
    return lambda evaluation: evaluation.elastic(source)[part]


for _names, _source, _unit, _long_name in (
    (("K", "stiffness"), STIFFNESS, "N/m, N, N m/rad", "elastic stiffness at the tool, axes of the base"),
    (("C", "compliance"), COMPLIANCE, "m/N, 1/N, rad/(N m)", "elastic compliance at the tool"),
):
    quantity(*_names, dims=(AXIS, AXIS_2), unit=_unit, long_name=_long_name)(_part_of(_source))


quantity(
    "felt_stiffness",
    dims=(AXIS,),
    unit="N/m (x, y, z), N m/rad (rx, ry, rz)",
    long_name="felt stiffness, all other motions free",
)(lambda evaluation: axis_stiffness(evaluation.elastic(AXIS_COMPLIANCE)))


for _name, _row, _unit, _long_name in (
    ("translational_stiffness", 0, "N/m", "principal translational stiffnesses, rotations free"),
    ("rotational_stiffness", 1, "N m/rad", "principal rotational stiffnesses, translations free"),
):
    _principal = _part_of(PRINCIPAL_STIFFNESS, np.s_[..., _row, :])
    quantity(_name, dims=(PRINCIPAL,), unit=_unit, long_name=_long_name)(_principal)
quantity("eigenvalues", dims=(MODE,), unit="N/m", long_name="eigenvalues of K at its characteristic length")(
    _part_of(CONDITIONING, np.s_[..., :_MODES])
)


@quantity("condition_number", unit="1", long_name="condition number of K at its characteristic length")
def _condition_number(evaluation: Evaluation) -> Array:
    values = evaluation.elastic(CONDITIONING)
    ratio: Array = values[..., _MODES - 1] / values[..., 0]
    return ratio


quantity("characteristic_length", unit="m", long_name="length that makes rotations as stiff as translations")(
    _part_of(CONDITIONING, np.s_[..., _MODES])
)
quantity("spring_shares", dims=(AXIS, SPRING), unit="1", long_name="share of each spring in the deflection")(
    lambda evaluation: evaluation.elastic(spring_shares(evaluation.mapped.elastic))
)


def _frequencies(evaluation: Evaluation, count: int) -> Array:
    return natural_frequencies(evaluation.mapped.elastic, evaluation.poses, count=count, **evaluation.batch)


quantity("natural_frequencies", dims=(NATURAL_MODE,), unit="Hz", long_name="lowest natural frequencies")(
    lambda evaluation: _frequencies(evaluation, _MODES)
)
quantity("first_frequency", unit="Hz", long_name="lowest natural frequency")(
    lambda evaluation: _frequencies(evaluation, 1)[..., 0]
)
quantity(
    "holding_forces",
    dims=(DRIVE,),
    unit=_force_unit,
    long_name="drive forces that hold the weight",
    exists=has_drives_and_tool,
)(lambda evaluation: actuator_forces(evaluation.mapped.robot, evaluation.poses, **evaluation.batch))
quantity(
    "drive_inertia",
    dims=(DRIVE, Dimension("drive_2", DRIVE.labels)),
    unit="kg, kg m, kg m^2",
    long_name="mass matrix as seen by the drives",
    exists=has_drives_and_tool,
)(lambda evaluation: drive_mass_matrices(evaluation.mapped.robot, evaluation.poses, **evaluation.batch))


@quantity(
    "singularity_distance",
    dims=(SINGULARITY,),
    unit="1",
    long_name="least scaled singular value of each type of singularity, zero where it is singular",
    exists=has_drives_and_tool,
)
def _singularity_distance(evaluation: Evaluation) -> Array:
    mapped = evaluation.mapped
    return singularity_measures(mapped.robot, evaluation.poses, mapped.usual_mobility, **evaluation.batch)


quantity("commands", dims=(COMMAND,), unit=_command_unit, long_name="readings of the drives' counters")(
    lambda evaluation: evaluation.poses.commands
)


def _free_motion_names(mapped: MappedRobot) -> tuple[str, ...]:
    """Return the names of the robot's free motions."""
    motions = mapped.free_motions
    return () if motions is None else motions.names


def _free_motion_unit(mapped: MappedRobot) -> str:
    """Return the units of the free motions' stiffnesses, with the diagonal entries in brackets."""
    motions = mapped.free_motions
    if motions is None:
        return "1"
    names = {
        unit: [name for name, own in zip(motions.names, motions.units, strict=True) if own == unit]
        for unit in ("m", "rad")
    }
    listed = [f"{word} ({', '.join(names[unit])})" for unit, word in (("m", "N/m"), ("rad", "N m/rad")) if names[unit]]
    return ", ".join(listed)


@quantity(
    "free_stiffness",
    dims=(Dimension("free_motion", _free_motion_names), Dimension("free_motion_2", _free_motion_names)),
    unit=_free_motion_unit,
    long_name="stiffness of the free motions",
    exists=lambda mapped: mapped.free_motions is not None,
)
def _free_stiffness(evaluation: Evaluation) -> Array:
    motions = evaluation.mapped.free_motions
    assert motions is not None  # it exists
    return evaluation.elastic(free_stiffness(evaluation.mapped.elastic, motions.components))
