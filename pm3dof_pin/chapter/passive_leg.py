"""The passive leg as a round bar: effect of its radius on stiffness and mass."""

from __future__ import annotations

import dataclasses
import math

from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import InvalidValueError


def with_passive_leg_radius(tripod: Tripod, factor: float) -> Tripod:
    """Return the machine with a passive leg `factor` times as thick: E I and G J scale with r^4, its mass with r^2.

    Equivalent to changing `section.passive_leg_radius` (and bore) in the parameter file.

    Raises:
        InvalidValueError: the factor is not a positive number.
    """
    if not (math.isfinite(factor) and factor > 0.0):
        raise InvalidValueError("factor", factor, "a positive number")
    p = tripod.parameters
    bar = p.passive_leg
    return Tripod(
        dataclasses.replace(
            p,
            bending_stiffness=factor**4 * p.bending_stiffness,
            torsional_stiffness=factor**4 * p.torsional_stiffness,
            passive_leg_mass=factor**2 * p.passive_leg_mass,
            passive_leg=dataclasses.replace(bar, radius=factor * bar.radius, bore=factor * bar.bore),
        )
    )
