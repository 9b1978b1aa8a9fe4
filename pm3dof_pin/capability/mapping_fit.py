"""The positions of drives as polynomials of the joints that they move through loops, with their worst error."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product
from typing import Any

import numpy as np

from pm3dof_pin.arrays import frozen
from pm3dof_pin.capability.transmission import Transmission
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.typing import Array, Matrix, Vector

MAX_FIT_DEGREE = 12
"""Greatest degree of a fitted polynomial."""


@dataclass(frozen=True, eq=False)
class MappingFit:
    """Drives' counter readings as polynomials of the joints, in coordinates -1 .. 1 over their box."""

    joints: tuple[str, ...]  #: names of the m joints
    drives: tuple[str, ...]  #: names of the u drives
    middle: Vector  #: of the box, shape=(m,) [rad, m]
    half: Vector  #: half its edges, shape=(m,) [rad, m]
    powers: Matrix  #: exponents of the monomials of (q - middle) / half, shape=(k, m)
    coefficients: Matrix  #: shape=(u, k) [rad, m]
    worst: Vector  #: greatest error at the poses of the box and between them, shape=(u,) [rad, m]

    def commands(self, values: Array) -> Array:
        """Return the drives' readings at values of the joints, shape=(..., m) -> (..., u) [rad, m]."""
        return np.asarray(_monomials((values - self.middle) / self.half, self.powers) @ self.coefficients.T)

    def entries(self) -> dict[str, Any]:
        """Return the polynomials for JSON."""
        return {
            "joints": self.joints,
            "drives": self.drives,
            "variables": "(q - middle) / half",
            "middle": self.middle.tolist(),
            "half": self.half.tolist(),
            "powers": self.powers.astype(int).tolist(),
            "coefficients": self.coefficients.tolist(),
            "worst_error": self.worst.tolist(),
        }


def fit_mapping(box: Transmission, degree: int) -> MappingFit:
    """Fit the drives' readings over a grid of joints by least squares, for poses within limits.

    Args:
        box: the transmission over a grid of the joints.
        degree: greatest sum of exponents of a monomial.

    Raises:
        InvalidValueError: the degree is not one from 1 to 12, or the grid has too few poses or values for it.
    """
    if not 1 <= degree <= MAX_FIT_DEGREE:
        raise InvalidValueError("degree", degree, f"a degree from 1 to {MAX_FIT_DEGREE}")
    count = len(box.joints)
    within = box.poses.within_limits
    q, u = box.poses.coordinates[within], box.poses.commands[within]
    lower, upper = q.min(axis=0), q.max(axis=0)
    half = np.where(upper > lower, 0.5 * (upper - lower), 1.0)
    middle = 0.5 * (lower + upper)
    powers = np.array([p for p in product(range(degree + 1), repeat=count) if sum(p) <= degree])
    rows = _monomials((q - middle) / half, powers)
    if np.linalg.matrix_rank(rows) < len(powers):
        raise InvalidValueError("degree", degree, f"one that {len(q)} poses of the box determine: a finer --over")
    coefficients = np.linalg.lstsq(rows, u, rcond=None)[0].T
    fit = MappingFit(
        joints=box.joints,
        drives=box.drives,
        middle=frozen(middle),
        half=frozen(half),
        powers=frozen(powers),
        coefficients=frozen(np.asarray(coefficients, dtype=float)),
        worst=frozen(np.zeros(len(u.T))),
    )
    centres = box.poses.robot.solve(_cell_centres(box.poses.coordinates), on_failure="nan")
    errors = [
        np.abs(fit.commands(poses.coordinates) - poses.commands)[poses.within_limits] for poses in (box.poses, centres)
    ]
    return replace(fit, worst=frozen(np.concatenate(errors).max(axis=0)))


def _cell_centres(grid: Array) -> Array:
    """Return the centres of the cells of a grid of values, shape=(n1, ..., nm, m)."""
    for axis, size in enumerate(grid.shape[:-1]):
        if size > 1:
            part = np.moveaxis(grid, axis, 0)
            grid = np.asarray(np.moveaxis(0.5 * (part[1:] + part[:-1]), 0, axis))
    return grid


def _monomials(values: Array, powers: Matrix) -> Array:
    return np.asarray(np.prod(values[..., None, :] ** powers, axis=-1))
