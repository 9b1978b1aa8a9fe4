"""What a quantity of a map is: a function of poses with a name, a unit, and dimensions of its own."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array, frozen
from pm3dof_pin.dynamics.dynamic_stiffness import DynamicStiffness, dynamic_stiffness
from pm3dof_pin.elastic.batch import evaluate
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.free_motions import FreeMotionStiffness, free_motion_stiffness
from pm3dof_pin.elastic.quantities import ElasticQuantity
from pm3dof_pin.elastic.report import cartesian_compliance
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.errors.source_errors import ErrorSources
from pm3dof_pin.exceptions import PM3DofError, ProgramError
from pm3dof_pin.kinematics.branches import samples_near_home
from pm3dof_pin.kinematics.mobility import Mobility, generic_configuration, instantaneous_mobility
from pm3dof_pin.kinematics.pose_values import BatchOptions
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.kinematics.singularity import singularity_distances
from pm3dof_pin.typing import Array

NO_WRENCH = ((0.0,) * 6,)
"""No load but the weight."""


class MappedRobot:
    """A robot, or an elastic model, whose quantities are mapped; its springs are read when a quantity needs them.

    Attributes:
        robot: the robot.
        wrenches: wrenches [f; m] of the tool on its environment that the drives are to hold, shape=(k, 6) [N, N m].
    """

    def __init__(self, robot: Robot | ElasticModel, wrenches: ArrayLike = NO_WRENCH) -> None:
        self.robot = robot.rigid if isinstance(robot, ElasticModel) else robot
        self.wrenches = frozen(finite_array("wrenches", wrenches, (np.shape(wrenches)[0], 6)))
        self._given = robot

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self._given, self.wrenches)

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

    @cached_property
    def error_sources(self) -> ErrorSources:
        """The sources of error with the magnitudes of the robot's error file."""
        files = self.robot.files
        declared = GeometricErrors(self.robot) if files is None else GeometricErrors.from_file(self.robot, files.errors)
        return ErrorSources(closable(declared))

    def _free_motions_at(self, q: Array) -> FreeMotionStiffness | None:
        """Return the free motions at a configuration; None where they are not independent, or the tool is free."""
        configuration = self.robot.configuration(q)
        try:
            if cartesian_compliance(self.elastic, configuration).free_directions.size:
                return None
            return free_motion_stiffness(self.elastic, configuration)
        except PM3DofError:
            return None


class Evaluation:
    """A robot at a batch of poses (unsolved ones give NaN); shared results are computed once."""

    def __init__(self, mapped: MappedRobot, poses: Poses, *, threads: int | None = None) -> None:
        self.mapped = mapped
        self.poses = poses
        self.batch: BatchOptions = {"on_failure": "nan", "threads": threads}
        self._elastic: dict[str, Array] = {}
        self._dynamic_stiffness: DynamicStiffness | None = None

    def elastic(self, quantity: ElasticQuantity) -> Array:
        """Return a quantity of the elastic behaviour of the tool, shape=(..., *its shape); NaN where it fails."""
        if quantity.name not in self._elastic:
            self._elastic[quantity.name] = evaluate(self.mapped.elastic, self.poses, quantity, **self.batch).values
        return self._elastic[quantity.name]

    @property
    def dynamic_stiffness(self) -> DynamicStiffness:
        """Extremes of the receptance of the tool; NaN where it fails."""
        if self._dynamic_stiffness is None:
            self._dynamic_stiffness = dynamic_stiffness(self.mapped.elastic, self.poses, **self.batch)
        return self._dynamic_stiffness


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
    compute: Callable[[Evaluation], Array]  #: by the robot's engine, to an array, shape=(..., *own dimensions)
    unit: Unit  #: its unit; if the entries differ, each unit followed by its entries in brackets
    long_name: str  #: its description
    dims: tuple[Dimension, ...] = ()  #: its own dimensions, after those of the poses
    exists: Callable[[MappedRobot], bool] = lambda mapped: True  #: whether a robot has it

    def unit_for(self, mapped: MappedRobot) -> str:
        """Return the unit for a robot."""
        return self.unit if isinstance(self.unit, str) else self.unit(mapped)

    def shape_for(self, mapped: MappedRobot) -> tuple[int, ...]:
        """Return the shape of its value at one pose of a robot."""
        return tuple(len(dim.labels(mapped)) for dim in self.dims)
