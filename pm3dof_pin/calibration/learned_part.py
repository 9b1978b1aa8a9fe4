"""The learned part: deviations of the commands as functions of commands, temperatures and loads."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from pm3dof_pin.calibration.gaussian_process import GaussianProcess
from pm3dof_pin.calibration.learned_model import LearnedModel
from pm3dof_pin.calibration.neural_network import NeuralNetwork
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.coordinate_ranges import coordinate_ranges
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.tolerances import SAME
from pm3dof_pin.typing import Array


def fitted_model(
    method: str, inputs: Array, deviations: Array, variances: Array, seed: int, similar: LearnedModel | None = None
) -> LearnedModel:
    """Learn deviations du with their noise variances, shape=(n, commands), by "nn" or "gp" as named in `method`.

    Processes are sought from those of `similar`, a model of the same inputs.

    Raises:
        ConvergenceError: see :meth:`GaussianProcess.fit`.
    """
    if "nn" in method:
        return NeuralNetwork.fit(inputs, deviations, seed)
    return GaussianProcess.fit(inputs, deviations, variances, similar if isinstance(similar, GaussianProcess) else None)


@dataclass(frozen=True, eq=False)
class InputScale:
    """Inputs of a learned model: the commands, then temperatures and loads, each scaled to about -1 .. 1."""

    conditions: tuple[str, ...]  #: names of the columns used besides the commands
    centre: Array  #: shape=(number of inputs,)
    half_range: Array  #: shape=(number of inputs,)

    @classmethod
    def from_measurements(cls, robot: Robot, measurements: Measurements) -> InputScale:
        """Scale commands by joint limits, conditions by their measured range; constant conditions are left out."""
        lower, upper = coordinate_ranges(robot, robot.command_coordinates)
        varied = {name: values for name, values in measurements.conditions.items() if np.ptp(values) > 0.0}
        least = np.array([*lower, *(values.min() for values in varied.values())])
        most = np.array([*upper, *(values.max() for values in varied.values())])
        return cls(tuple(varied), 0.5 * (least + most), 0.5 * (most - least))

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Least and greatest measured value of each condition, by name."""
        first = len(self.centre) - len(self.conditions)
        pairs = zip(self.centre[first:].tolist(), self.half_range[first:].tolist(), strict=True)
        return {name: (c - half, c + half) for name, (c, half) in zip(self.conditions, pairs, strict=True)}

    def middle(self) -> dict[str, float]:
        """Return the middle of each condition's range, by name."""
        return {name: 0.5 * (least + most) for name, (least, most) in self.ranges.items()}

    def beyond(self, conditions: Mapping[str, Array | float]) -> dict[str, tuple[float, float]]:
        """Return the measured range of each condition that has a value outside it, by name."""
        found = {}
        for name, (least, most) in self.ranges.items():
            slack = SAME * (most - least)
            if name in conditions and np.any((conditions[name] < least - slack) | (conditions[name] > most + slack)):
                found[name] = (least, most)
        return found

    def scaled(self, commands: Array, conditions: Mapping[str, Array | float]) -> Array:
        """Return inputs, shape=(n, number of inputs), of commands [m, rad] and conditions by name.

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
class LearnedPart:
    """A learned model and the scale of its inputs."""

    model: LearnedModel
    inputs: InputScale

    @classmethod
    def from_data(cls, model: Mapping[str, Any], inputs: InputScale) -> LearnedPart:
        """Combine inputs and a model from :meth:`LearnedModel.as_data`."""
        kinds = {kind.kind: kind for kind in (GaussianProcess, NeuralNetwork)}
        return cls(kinds[model["kind"]].from_data(model), inputs)

    def deviations(self, commands: Array, conditions: Mapping[str, Array | float]) -> Array:
        """Return du at commands, shape=(n, number of commands) [m, rad]; see :meth:`InputScale.scaled`."""
        return self.model.deviations(self.inputs.scaled(commands, conditions))

    def uncertainties(self, commands: Array, conditions: Mapping[str, Array | float]) -> Array:
        """Return the standard deviation of du at commands, shape=(n, number of commands) [m, rad]."""
        return self.model.uncertainties(self.inputs.scaled(commands, conditions))
