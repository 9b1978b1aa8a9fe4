"""Touches of a flat bed by a delta printer, and distances measured on what it printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array, Indices

PROBE_SIGMA = 25e-6
"""Noise of a touch, repeatability of the probe and unevenness of the bed [m]."""
CALIPER_SIGMA = 50e-6
"""Noise of a distance measured on a print [m]."""

_CLEARLY = 2.0
"""Standard errors by which errors are smaller on the whole: one touch alone that is better makes about one."""


@dataclass(frozen=True, eq=False)
class Touches:
    """Heights of the nozzle over the bed, and distances between two of its places, by the drives' travels."""

    travels: Array  #: from the end stops, shape=(touches, 3) [m, rad]
    heights: Array  #: of the nozzle at the touch, shape=(touches,) [m]
    distances: Array  #: shape=(distances,) [m]
    ends: Array  #: travels at their two ends, shape=(distances, 2, 3) [m, rad]

    @classmethod
    def of(cls, travels: Array, heights: Array, pairs: Sequence[tuple[float, Array, Array]] = ()) -> Touches:
        """Collect touches, and distances with the travels at both ends."""
        return cls(
            travels,
            heights,
            np.array([pair[0] for pair in pairs], dtype=float),
            np.array([pair[1:] for pair in pairs], dtype=float).reshape(-1, 2, 3),
        )

    def __len__(self) -> int:
        return len(self.travels)

    @property
    def sigmas(self) -> Array:
        """Noise of each touch, then of each distance, shape=(touches + distances,) [m]."""
        return np.repeat([PROBE_SIGMA, CALIPER_SIGMA], [len(self), len(self.distances)])

    def errors(self, robot: Robot) -> Array:
        """Return heights, then distances, minus those that a robot predicts, shape=(touches + distances,) [m]."""
        heights = robot.forward(self.travels).positions[:, 2]
        one, two = robot.forward(self.ends.reshape(-1, 3)).positions.reshape(-1, 2, 3).transpose(1, 0, 2)
        return np.concatenate([self.heights - heights, self.distances - np.linalg.norm(two - one, axis=1)])

    def measurements(self, chosen: Indices | None = None) -> Measurements:
        """Return some touches and distances, by default all, as measurements; distances are counted after touches."""
        rows = np.arange(len(self) + len(self.distances)) if chosen is None else chosen
        rows, far_rows = rows[rows < len(self)], rows[rows >= len(self)] - len(self)
        commands = np.concatenate([self.travels[rows], self.ends[far_rows].reshape(-1, 3)])
        touches, count = len(rows), len(commands)
        positions, sigmas = np.zeros((count, 3)), np.full((count, 3), np.inf)
        positions[:touches, 2], sigmas[:touches, 2] = self.heights[rows], PROBE_SIGMA
        far, partners = np.full(count, np.nan), np.full(count, -1)
        second = touches + 1 + 2 * np.arange(len(far_rows))
        far[second], partners[second], sigmas[second, 0] = self.distances[far_rows], second - 1, CALIPER_SIGMA
        seen = Measurements(commands, positions, None, sigmas, np.zeros((count, 3)))
        if not len(second):
            return seen
        return replace(seen, distances=far, origins=np.zeros((count, 3)), partners=partners)


def are_clearly_smaller(errors: Array, others: Array) -> bool:
    """Tell whether errors of the same measurements are smaller in the mean square, beyond chance.

    Args:
        errors: measured minus predicted, all in one unit or in standard deviations, shape=(n,).
        others: by another prediction.
    """
    gains = others**2 - errors**2
    return bool(gains.mean() > _CLEARLY * gains.std() / np.sqrt(len(gains)))
