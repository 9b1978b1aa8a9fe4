"""The bandwidth that a structure allows the position loop of a drive, measured at its joint.

An ideal velocity loop follows K_v e, e being the difference between the command and the joint's position, and moves the
motor's side of the drive's spring k. The joint follows that side by H = k G, with the receptance G of the joint by
itself, so that the open loop is K_v H / (i omega). Where H lags by a quarter turn, K_v |Im H| / omega must be below 1:
for one mode of damping ratio zeta, K_v < 2 zeta omega_n (Y. Altintas, Manufacturing Automation, 2012, chapter 6).
Other drives are held by their springs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pm3dof_pin.dynamics.receptance import VibratingSystem
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Vector

GAIN_MARGIN = 2.0
"""Gain at which the loop would become unstable, relative to the one recommended."""


@dataclass(frozen=True)
class ServoLimit:
    """The limit of a drive's position loop at one pose."""

    drive: str  #: joint of the drive
    critical_gain: float  #: K_v from which on the loop is unstable; infinite if none is [1/s]
    critical_frequency: float  #: frequency at which it then oscillates; NaN if there is none [Hz]

    @property
    def bandwidth(self) -> float:
        """Bandwidth K_v / (2 pi) with the gain margin [Hz]."""
        return self.critical_gain / (GAIN_MARGIN * 2.0 * np.pi)


def servo_limit(system: VibratingSystem, drive: str) -> ServoLimit:
    """Return the limit of the position loop of a drive with a spring at its joint.

    Example:
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.dynamics.receptance import vibrating_system
        >>> model = pm.ElasticModel.load("hexapod")
        >>> limit = servo_limit(vibrating_system(model, model.rigid.home), "strut1_joint")
        >>> bool(limit.bandwidth > 0.0)
        True

    Raises:
        InvalidValueError: the drive has no spring at its joint.
        PM3DofError: as :meth:`~pm3dof_pin.dynamics.receptance.VibratingSystem.receptance`.
    """
    return servo_limits(system, [drive])[0]


def servo_limits(system: VibratingSystem, drives: Sequence[str]) -> list[ServoLimit]:
    """Return the limits of the position loops of drives, each with the others held; errors as :func:`servo_limit`."""
    springs = {spring.joint: spring for spring in system.model.springs if isinstance(spring, JointSpring)}
    for drive in drives:
        if drive not in springs:
            raise InvalidValueError("drive", drive, f"one with a spring at its joint: {', '.join(springs) or 'none'}")
    frequencies = system.frequencies_around_modes()
    frequencies = frequencies[frequencies > 0.0]
    receptances = system.direct_receptances(frequencies, system.rows(drives))
    return [
        _limit(drive, frequencies, springs[drive].stiffness * receptance)
        for drive, receptance in zip(drives, receptances.T, strict=True)
    ]


def _limit(drive: str, frequencies: Vector, followed: Array) -> ServoLimit:
    """Return the limit of a drive by how its joint follows the motor's side at frequencies, shape=(f,)."""
    real = followed.real
    crossed = np.flatnonzero((real[:-1] > 0.0) != (real[1:] > 0.0))
    part = real[crossed] / (real[crossed] - real[crossed + 1])
    at = frequencies[crossed] + part * np.diff(frequencies)[crossed]
    lag = followed.imag[crossed] + part * np.diff(followed.imag)[crossed]
    gains = 2.0 * np.pi * at[lag < 0.0] / -lag[lag < 0.0]
    if not len(gains):
        return ServoLimit(drive, np.inf, np.nan)
    worst = int(gains.argmin())
    return ServoLimit(drive, float(gains[worst]), float(at[lag < 0.0][worst]))
