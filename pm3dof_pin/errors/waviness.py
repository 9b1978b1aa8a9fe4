"""Drive errors that vary along the travel: of a screw's pitch, and of a guideway's straightness."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.description.source_numbers import Waviness
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array


@dataclass(frozen=True)
class Wave:
    """One harmonic of a guideway's or screw's error along its travel [m], its phase [rad] at joint coordinate 0."""

    amplitude: float
    length: float
    phase: float

    def at(self, travel: Array) -> Array:
        """Return the error at a travel [m]."""
        return np.asarray(self.amplitude * np.sin(2.0 * np.pi * travel / self.length + self.phase))


@dataclass(frozen=True, eq=False)
class GuideWaviness:
    """Errors of each drive that vary along its travel: of the screw's pitch, and of the guideway's straightness.

    No constant parameter of a robot describes them.
    """

    pitch: tuple[tuple[Wave, ...], ...]  #: waves along the drive, for each actuated joint
    #: waves across it, in the two directions across the joint's axis, for each actuated joint; empty for straight
    #: guideways
    straightness: tuple[tuple[tuple[Wave, ...], tuple[Wave, ...]], ...] = ()

    def travel_errors(self, travels: Array) -> Array:
        """Return the position errors of drives along their travel, shape=(n, drives) [m]."""
        _check_count("pitch", self.pitch, travels.shape[1])
        errors = np.zeros_like(travels)
        for drive, waves in enumerate(self.pitch):
            errors[:, drive] = sum((wave.at(travels[:, drive]) for wave in waves), np.zeros(len(travels)))
        return errors

    def offsets(self, travels: Array) -> Array:
        """Return the offsets of carriages from their lines at joint coordinates, shape=(n, drives, 2) [m]."""
        offsets = np.zeros((*travels.shape, 2))
        if self.straightness:
            _check_count("straightness", self.straightness, travels.shape[1])
        for drive, directions in enumerate(self.straightness):
            for across, waves in enumerate(directions):
                offsets[:, drive, across] = sum((wave.at(travels[:, drive]) for wave in waves), np.zeros(len(travels)))
        return offsets

    @classmethod
    def random(cls, drives: int, generator: np.random.Generator) -> GuideWaviness:
        """Draw waves with random phases, with the default lengths and amplitudes of error files."""
        numbers = Waviness()

        def waves(amplitude: float) -> tuple[Wave, ...]:
            return tuple(
                Wave(amplitude * generator.standard_normal(), length, generator.uniform(0.0, 2.0 * np.pi))
                for length in numbers.lengths_m
            )

        return cls(
            tuple(waves(numbers.pitch_m) for _ in range(drives)),
            tuple((waves(numbers.straightness_m), waves(numbers.straightness_m)) for _ in range(drives)),
        )


def _check_count(name: str, entries: Sequence[object], drives: int) -> None:
    if len(entries) != drives:
        raise InvalidValueError(
            name, problem=f"has {len(entries)} entries", expected=f"one for each of {drives} actuated joints"
        )
