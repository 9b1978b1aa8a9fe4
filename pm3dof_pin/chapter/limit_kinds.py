"""The kinds of joint limits of the tripod, and a joint outside its range."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import IntFlag


class Limit(IntFlag):
    """What may exclude a pose; combinations are sums.

    Attributes:
        REACH: a link is too short, whatever its slider does.
        STROKE: a slider leaves its travel.
        UNIVERSAL: a universal joint at D_i turns too far.
        SPHERICAL: a link leaves the cone of its spherical joint at E_i.
        TILT: the universal joint of the passive leg turns too far.
        HEIGHT: the passive prismatic joint is at a stop.
    """

    NONE = 0
    REACH = 1
    STROKE = 2
    UNIVERSAL = 4
    SPHERICAL = 8
    TILT = 16
    HEIGHT = 32


@dataclass(frozen=True)
class LimitViolation:
    """One joint outside its range.

    Attributes:
        joint: name of the joint, as in the URDF, where the spherical joints `spherical1` .. are loop closures.
        limit: the kind of limit.
        value: where the joint stands [unit].
        lower: lower end of its range [unit].
        upper: upper end of its range [unit].
        unit: "m" or "rad".
    """

    joint: str
    limit: Limit
    value: float
    lower: float
    upper: float
    unit: str

    def __str__(self) -> str:
        """One line for a person, angles in degrees."""
        factor, unit, digits = (1.0, "m", 4) if self.unit == "m" else (180.0 / math.pi, "deg", 2)
        value, lower, upper = (f"{number * factor:.{digits}f}" for number in (self.value, self.lower, self.upper))
        return f"{self.joint} at {value} {unit}, outside {lower} .. {upper} {unit}"
