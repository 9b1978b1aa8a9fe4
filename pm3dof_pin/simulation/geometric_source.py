"""Geometry that is wrong for good, one of the sources of a simulated machine's errors."""

from __future__ import annotations

from dataclasses import dataclass

from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.typing import Vector


@dataclass(frozen=True, eq=False)
class GeometricSource:
    """Joints and frames that sit wrong, for good: manufacturing and assembly."""

    errors: GeometricErrors  #: the parameters
    values: Vector  #: p, shape=(number of parameters,) [m, rad]

    def __post_init__(self) -> None:
        """Check the values."""
        self.errors.values(self.values)
