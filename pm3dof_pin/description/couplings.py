"""Couplings: joints that follow others by gears, belts, cables or a program, exactly."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from typing import Any

from pm3dof_pin.description.origin import NOWHERE, Origin
from pm3dof_pin.exceptions import InvalidValueError

MAX_DEGREE = 4
"""Greatest degree of the polynomial of a coupling, that of MJCF's `polycoef`."""


@dataclass(frozen=True)
class Coupling:
    """A single-DoF joint whose coordinate is a polynomial of others: offset + sum of c[k] x^k, k from 1 on.

    Gears, `mimic` of a URDF, `<coupling>` of URDF+ and the joint equalities of MJCF are all of this form.

    Raises:
        InvalidValueError: it names no other joint, itself or one twice, or the degree of a polynomial is not 1 to 4.
    """

    joint: str  #: the joint that follows
    joints: tuple[str, ...]  #: the joints that it follows
    #: for each of them the coefficients of its powers, from the first on [m, rad, per m^k or rad^k]
    coefficients: tuple[tuple[float, ...], ...]
    offset: float = 0.0  #: its coordinate with all of them at zero [m, rad]
    origin: Origin = field(default=NOWHERE, compare=False, repr=False)  #: where it is described

    def __post_init__(self) -> None:
        """Check names and sizes."""
        if not self.joints or len({self.joint, *self.joints}) <= len(self.joints):
            raise InvalidValueError(f"coupling of '{self.joint}'", list(self.joints), "other joints, each named once")
        if len(self.coefficients) != len(self.joints):
            expected = f"coefficients for each of {', '.join(self.joints)}"
            raise InvalidValueError(f"coupling of '{self.joint}'", self.coefficients, expected)
        for powers in self.coefficients:
            if not 1 <= len(powers) <= MAX_DEGREE:
                expected = f"1 to {MAX_DEGREE} coefficients, of the powers from 1 on"
                raise InvalidValueError(f"coupling of '{self.joint}'", list(powers), expected)

    @classmethod
    def from_powers(cls, joint: str, other: str, powers: Sequence[float], origin: Origin = NOWHERE) -> Coupling:
        """Return the coupling of a joint to one other by coefficients of the powers 0, 1, ... of its coordinate."""
        return cls(joint, (other,), (tuple(powers[1:]),), powers[0], origin)

    @property
    def name(self) -> str:
        """Its name in messages: the joint and those it follows."""
        return f"{self.joint} = f({', '.join(self.joints)})"

    @property
    def is_linear(self) -> bool:
        """Whether all polynomials are of the first degree."""
        return all(not any(powers[1:]) for powers in self.coefficients)

    def value(self, positions: Sequence[Any]) -> Any:
        """Return the joint's coordinate at coordinates of the others (numbers, or recorded ones) [m, rad]."""
        result: Any = self.offset
        for powers, x in zip(self.coefficients, positions, strict=True):
            term: Any = 0.0
            for coefficient in reversed(powers):
                term = (term + coefficient) * x
            result = result + term
        return result

    def slopes(self, positions: Sequence[Any]) -> list[Any]:
        """Return the derivative of :meth:`value` by each of the others."""
        return [
            _horner([k * c for k, c in zip(count(1), powers, strict=False)], x)
            for powers, x in zip(self.coefficients, positions, strict=True)
        ]

    def curvatures(self, positions: Sequence[float]) -> list[float]:
        """Return the second derivative of :meth:`value` by each of the others; mixed ones vanish."""
        return [
            float(_horner([k * (k + 1) * c for k, c in zip(count(1), powers[1:], strict=False)], x))
            for powers, x in zip(self.coefficients, positions, strict=True)
        ]


def _horner(coefficients: Sequence[float], x: Any) -> Any:
    """Return the polynomial with these coefficients, of the powers from 0 on."""
    result: Any = 0.0
    for coefficient in reversed(coefficients):
        result = result * x + coefficient
    return result


def polynomial_of_difference(powers: Sequence[float], zero: float) -> list[float]:
    """Return the coefficients of a polynomial of x - zero, by powers of x, without the highest that vanish."""
    result = [0.0] * len(powers)
    for coefficient in reversed(powers):
        shifted = [0.0, *result[:-1]]
        result = [one - zero * other for one, other in zip(shifted, result, strict=True)]
        result[0] += coefficient
    while len(result) > 2 and not result[-1]:
        result.pop()
    return result
