"""Touches of a flat bed by a delta printer, and distances measured on what it printed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

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

    def measurements(self, chosen: Indices | None = None) -> Measurements:
        """Return some touches, by default all, and all distances as measurements."""
        rows = np.arange(len(self)) if chosen is None else chosen
        commands = np.concatenate([self.travels[rows], self.ends.reshape(-1, 3)])
        touches, count = len(rows), len(commands)
        positions, sigmas = np.zeros((count, 3)), np.full((count, 3), np.inf)
        positions[:touches, 2], sigmas[:touches, 2] = self.heights[rows], PROBE_SIGMA
        far, partners = np.full(count, np.nan), np.full(count, -1)
        second = touches + 1 + 2 * np.arange(len(self.distances))
        far[second], partners[second], sigmas[second, 0] = self.distances, second - 1, CALIPER_SIGMA
        seen = Measurements(commands, positions, None, sigmas, np.zeros((count, 3)))
        if not len(second):
            return seen
        return replace(seen, distances=far, origins=np.zeros((count, 3)), partners=partners)


def are_clearly_smaller(errors: Array, others: Array) -> bool:
    """Tell whether errors of the same touches are smaller in the mean square, beyond chance.

    Args:
        errors: heights minus predictions, shape=(touches,) [m].
        others: by another prediction [m].
    """
    gains = others**2 - errors**2
    return bool(gains.mean() > _CLEARLY * gains.std() / np.sqrt(len(gains)))
