"""Couplings of joints whose lengths expand: of racks, screws and belts between sliding joints and others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial

from pm3dof_pin.description.couplings import Coupling


@dataclass(frozen=True)
class Ruler:
    """What measures a joint's coordinate: warm, x becomes x + strain (x - fixed)."""

    strain: float = 0.0  #: thermal strain; 0 for angles
    fixed: float = 0.0  #: coordinate that stays [m]

    @property
    def cold_coordinate(self) -> Polynomial:
        """The cold coordinate as a polynomial of the warm one."""
        return Polynomial([self.strain * self.fixed / (1.0 + self.strain), 1.0 / (1.0 + self.strain)])


def expanded_coupling(coupling: Coupling, rulers: Mapping[str, Ruler]) -> Coupling:
    """Return a coupling that holds between warm coordinates as it does between cold ones."""
    follower = rulers[coupling.joint]
    offset = coupling.offset * (1.0 + follower.strain) - follower.strain * follower.fixed
    coefficients = []
    for joint, powers in zip(coupling.joints, coupling.coefficients, strict=True):
        warm = np.zeros(len(powers) + 1)
        of_warm = np.asarray(Polynomial([0.0, *powers])(rulers[joint].cold_coordinate).coef, dtype=float)
        warm[: len(of_warm)] = (1.0 + follower.strain) * of_warm  # trailing zeros are cut off
        offset += float(warm[0])
        coefficients.append(tuple(warm[1:].tolist()))
    return replace(coupling, offset=offset, coefficients=tuple(coefficients))
