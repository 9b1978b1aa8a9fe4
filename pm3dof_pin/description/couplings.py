"""Couplings between joints: gears, mimicking joints, and polynomials of MJCF."""

from __future__ import annotations

from dataclasses import dataclass

from pm3dof_pin.description.origin import NOWHERE, Origin


@dataclass(frozen=True)
class Coupling:
    """The coordinate of a joint as a polynomial of that of another."""

    joint: str  #: the joint that follows
    other: str  #: the joint that it follows
    coefficients: tuple[float, ...] = (0.0, 1.0)  #: of the powers 0, 1, ... of the other's coordinate [m, rad]
    origin: Origin = NOWHERE
