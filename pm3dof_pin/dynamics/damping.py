"""Damping of the springs of a mechanism: loss factors, viscous dampers at joints, servo drives, or one modal ratio.

A spring of loss factor eta has the stiffness k (1 + i eta) at every frequency (structural damping). A drive with a
velocity loop inside a position loop of gain K_v = 2 pi f_b, its bandwidth f_b, pushes back with
c_v (K_v e - de/dt): its stiffness is k = c_v K_v, and it damps like a viscous damper c = k / (2 pi f_b)
(Y. Altintas, Manufacturing Automation, 2012, chapter 6).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.springs import JointSpring
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Vector

LOSS_FACTOR = 0.04
"""Loss factor of springs that declare none: an assumption, twice the damping ratio 0.02 of bolted machines."""


@dataclass(frozen=True)
class Damping:
    """Damping of a mechanism; where a spring of the description declares its own, that counts instead of the default.

    Raises:
        InvalidValueError: a loss factor is negative, a bandwidth not positive, or the ratio not between 0 and 1.
    """

    loss_factor: float = LOSS_FACTOR  #: of springs that neither declare one nor are named below
    loss_factors: Mapping[str, float] = field(default_factory=dict)  #: by spring, instead of the description's
    #: bandwidth of the position loop of drives, by joint [Hz]; their springs are the servos' stiffness, without loss
    bandwidths: Mapping[str, float] = field(default_factory=dict)
    #: of all natural modes, relative to critical damping, instead of everything above; None for the springs' own
    ratio: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers."""
        for name, value in {"loss_factor": self.loss_factor, **self.loss_factors}.items():
            if not 0.0 <= value < np.inf:
                raise InvalidValueError(f"loss factor of {name}", value, "a finite number, not negative")
        for name, value in self.bandwidths.items():
            if not 0.0 < value < np.inf:
                raise InvalidValueError(f"bandwidth of {name}", value, "a positive frequency [Hz]")
        if self.ratio is not None and not 0.0 <= self.ratio < 1.0:
            raise InvalidValueError("damping ratio", self.ratio, "a number from 0 to below 1")

    def of_springs(self, model: ElasticModel) -> tuple[Vector, Vector]:
        """Return loss factors, and viscous damping relative to the stiffness, c / k [s].

        Both by entry of the model's `spring_indices`, shape=(s,).

        Raises:
            InvalidValueError: a loss factor or bandwidth is given for a spring or drive that there is not.
        """
        joints = {spring.joint for spring in model.springs if isinstance(spring, JointSpring)}
        for what, given, known in (
            ("loss_factors", self.loss_factors, set(model.spring_names)),
            ("bandwidths", self.bandwidths, joints),
        ):
            if unknown := sorted(set(given) - known):
                raise InvalidValueError(what, ", ".join(unknown), f"names of {', '.join(sorted(known)) or 'none'}")
        losses, times = np.zeros(len(model.spring_indices)), np.zeros(len(model.spring_indices))
        for spring, rows in zip(model.springs, model.spring_slices, strict=True):
            joint = spring.joint if isinstance(spring, JointSpring) else ""
            if joint in self.bandwidths:
                times[rows] = 1.0 / (2.0 * np.pi * self.bandwidths[joint])
                continue
            if isinstance(spring, JointSpring) and spring.damping is not None:
                times[rows] = spring.damping / spring.stiffness
            declared = spring.loss_factor
            if declared is None:
                declared = 0.0 if times[rows].any() else self.loss_factor
            losses[rows] = self.loss_factors.get(spring.name, declared)
        return losses, times
