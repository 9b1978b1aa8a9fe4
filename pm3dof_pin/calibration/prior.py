"""What is expected of parameters before anything is measured: errors of k tolerances, and of one if nearly free.

k tells how well the parts of a machine were made. The zero of a drive that no absolute mark defines was not made: on
good and on bad machines alike it is as far off as its tolerance says.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Indices, Mask

PRIOR = 3.0
"""k that allows for machines out of tolerance."""


@dataclass(frozen=True, eq=False)
class Prior:
    """Prior standard deviations of a machine's parameters, in units of their tolerances.

    Raises:
        InvalidValueError: k is not positive.
    """

    k: float  #: prior standard deviation of the parts; infinite for no prior of any parameter
    free: Mask  #: parameters that are nearly free: :func:`pm3dof_pin.errors.presets.nearly_free`, shape=(parameters,)
    error: float = 0.0  #: relative standard error of k

    def __post_init__(self) -> None:
        """Check k."""
        if not self.k > 0.0:
            raise InvalidValueError("prior", self.k, "a positive multiple of the tolerances")

    @property
    def parts(self) -> Indices:
        """The parameters that k scales, shape=(parts,)."""
        return np.flatnonzero(~self.free)

    @cached_property
    def sigmas(self) -> Array:
        """Standard deviation of each parameter, shape=(parameters,)."""
        return np.where(self.free & np.isfinite(self.k), 1.0, self.k)

    def of_all(self, springs: int, nuisances: Array) -> Array:
        """Return those of all unknowns in their scales: of the machine, of so many springs, and given ones."""
        return np.concatenate([self.sigmas, np.ones(springs), nuisances])

    @cached_property
    def widening(self) -> Array:
        """Factor on each of them for a k one standard error larger, shape=(parameters,)."""
        return np.where(self.free, 1.0, 1.0 + self.error)
