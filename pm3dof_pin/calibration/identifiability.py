"""Identifiability of the parameters from measurements: the scaled regressor, its rank, and what remains unknown.

A row of the regressor is a measured coordinate in units of its noise, a column a parameter in units of its tolerance:
R = diag(1/sigma) S diag(tolerance). A singular value s of R is then a ratio: along its direction, a measurement tells s
times as much as the tolerance. Directions without any effect are reported as combinations of parameters; none is fixed
silently.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen
from pm3dof_pin.calibration.elastic_term import ElasticTerm
from pm3dof_pin.errors.command_correction import command_scales
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import Sensitivities, sensitivities
from pm3dof_pin.exceptions import InvalidValueError, ShapeError
from pm3dof_pin.kinematics.degrees_of_freedom import RankDecision
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import with_joints
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.measuring.observation import planned_measurements
from pm3dof_pin.typing import Array

REGRESSOR_TOLERANCE = 1e-11
"""Singular values of the scaled regressor below this fraction of the greatest are treated as zero."""

_SHOWN = 0.05  # components smaller than this fraction of a direction's greatest are left out of its name
_AS_SHOWN = 5e-3  # of two decimals


def stacked_regressor(
    errors: GeometricErrors,
    poses: Poses,
    instrument: Instrument | None = None,
    elastic: ElasticTerm | None = None,
    found: Sensitivities | None = None,
) -> tuple[Array, Array, Nuisances]:
    """Return the scaled regressor (spring stiffness after the parameters), the nuisance rows and the nuisances.

    The nuisance rows, shape=(n, rows of a pose, k), are in units of the nuisance parameters' scales. `elastic` holds
    the known wrenches at these poses, `found` their sensitivities, if they are known already and no joint is read.
    """
    measurements = planned_measurements(poses, instrument or Instrument())
    rows = np.arange(len(measurements)) // (len(measurements) // len(poses))
    nuisances = Nuisances.from_measurements(measurements, tuple(command.unit for command in errors.robot.commands))
    if found is None or measurements.joints:
        found = sensitivities(errors, poses, joints=tuple(measurements.joints))
    drives = (found.commands * np.abs(command_scales(poses)))[rows]
    at_rows, of_a_pose = poses[rows], measurements.sigmas.size // len(poses)

    def scaled(motions: Array, scales: Array) -> Array:
        derivatives = measurements.derivatives(at_rows, motions) / measurements.sigmas[:, :, None] * scales
        return np.asarray(derivatives.reshape(len(poses), of_a_pose, derivatives.shape[2]))

    springs = elastic or ElasticTerm()
    by_springs = with_joints(springs.derivatives(poses, np.zeros(len(springs.names))), len(measurements.joints))
    motions = np.concatenate([found.errors, by_springs], axis=2)
    by_errors = scaled(motions[rows], np.concatenate([errors.tolerances, springs.sigmas]))
    return by_errors, scaled(nuisances.motions(measurements, at_rows, drives), nuisances.scales), nuisances


@dataclass(frozen=True)
class ObservabilityIndices:
    """Observability indices of a regressor with singular values s_1 >= ... >= s_L from N poses."""

    O1: float  #: (s_1 ... s_L)^(1/L) / sqrt(N) (J.-H. Borm and C.-H. Menq, 1989): D-optimality
    O2: float  #: s_L / s_1 (M. Driels and U. Pathre, 1990)
    O3: float  #: s_L (A. Nahvi, J. Hollerbach and V. Hayward, 1994): E-optimality
    O4: float  #: s_L^2 / s_1 (A. Nahvi and J. Hollerbach, 1996)
    O5: float  #: 1 / sum(1 / s_i) (Y. Sun and J. Hollerbach, 2008): A-optimality

    @classmethod
    def from_singular_values(cls, singular_values: ArrayLike, poses: int) -> ObservabilityIndices:
        """Compute the indices from the singular values over what is identifiable, shape=(L,).

        Raises:
            InvalidValueError: there are no singular values, or they are not positive.
        """
        s = np.sort(np.asarray(singular_values, dtype=float))[::-1]
        if not s.size or not np.all(s > 0.0):
            expected = "positive numbers, of identifiable combinations only"
            raise InvalidValueError("singular_values", s.tolist(), expected)
        return cls(
            O1=float(np.exp(np.mean(np.log(s))) / np.sqrt(poses)),
            O2=float(s[-1] / s[0]),
            O3=float(s[-1]),
            O4=float(s[-1] ** 2 / s[0]),
            O5=float(1.0 / np.sum(1.0 / s)),
        )


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Which parameters a set of measurements can identify."""

    names: tuple[str, ...]  #: the parameters
    poses: int  #: number of poses
    decision: RankDecision  #: rank of the scaled regressor and how it was decided
    #: right singular vectors as columns, in units of the tolerances, best known first, shape=(number of parameters,
    #: number of parameters)
    directions: Array

    @classmethod
    def from_regressor(
        cls, names: tuple[str, ...], regressor: ArrayLike, nuisances: ArrayLike | None = None
    ) -> Identifiability:
        """Analyse what a :func:`stacked_regressor` identifies; effects that nuisances can explain count as unobserved.

        The columns of the regressor, shape=(n, rows of a pose, parameters), are in units of the parameters' tolerances.

        Raises:
            InvalidValueError: the regressor has another shape or is not finite.
        """
        blocks = np.asarray(regressor, dtype=float)
        if blocks.ndim != 3 or blocks.shape[2] != len(names) or not np.isfinite(blocks).all():
            expected = f"finite numbers, (n, rows, {len(names)})"
            raise ShapeError("regressor", blocks.shape, expected)
        matrix = _beside(blocks, nuisances)
        # the triangular factor has the same singular values and right vectors, and is small
        triangle = np.asarray(np.linalg.qr(matrix, mode="r")) if len(matrix) > len(names) else matrix
        _, values, right = np.linalg.svd(triangle)
        decision = RankDecision.from_singular_values(values, REGRESSOR_TOLERANCE * values.max(initial=0.0))
        return cls(names, len(blocks), decision, frozen(right.T.copy()))

    @property
    def rank(self) -> int:
        """Number of combinations of parameters that have any effect on the measurements."""
        return self.decision.rank

    @property
    def identified(self) -> int:
        """Number of combinations that the measurements determine better than the tolerances: singular values above 1.

        The others stay within their tolerances by the prior, not by the measurements, which hardly contradict it.
        """
        return int(np.sum(self.decision.singular_values > 1.0))

    @cached_property
    def unidentified(self) -> tuple[str, ...]:
        """Names of the combinations that are not identified, in units of their tolerances."""
        return self._names(self.identified)

    @cached_property
    def unidentifiable(self) -> tuple[str, ...]:
        """Names of the combinations without any effect."""
        return self._names(self.rank)

    def _names(self, first: int) -> tuple[str, ...]:
        return tuple(_direction_name(self.names, column) for column in _sparse(self.directions[:, first:]).T)

    @property
    def observability(self) -> ObservabilityIndices:
        """Observability indices over the identifiable combinations."""
        return ObservabilityIndices.from_singular_values(self.decision.singular_values[: self.rank], self.poses)


def _rank(blocks: Array, nuisances: Array) -> int:
    """Return the rank of the regressor of some poses, beside nuisances."""
    values = np.linalg.svd(_beside(blocks, nuisances), compute_uv=False)
    return int(np.sum(values > REGRESSOR_TOLERANCE * values.max(initial=0.0)))


def seen_directions(rows: Array, least: float = 0.0) -> Array:
    """Return orthonormal directions, as columns, with singular values of the rows above rounding and `least`."""
    _, values, right = np.linalg.svd(np.linalg.qr(rows, mode="r"), full_matrices=False)
    seen = values > max(least, rows.shape[1] * np.finfo(float).eps * values.max(initial=0.0))
    return np.asarray(right[seen].T)


def minimum_poses(regressor: ArrayLike, nuisances: ArrayLike | None = None) -> int:
    """Return the least number of poses in general position that identify as much as all of these.

    Any such poses will do, so it is the number of the first ones that have the full rank. They need at least as many
    rows, and seldom many more: the search starts there, in steps that double, and ends by bisection.
    """
    blocks = np.asarray(regressor, dtype=float)
    others = np.zeros((*blocks.shape[:2], 0)) if nuisances is None else np.asarray(nuisances, dtype=float)
    blocks = blocks @ seen_directions(blocks.reshape(-1, blocks.shape[2]))
    full = _rank(blocks, others)
    too_few: int = max(0, -(-full // blocks.shape[1]) - 1)
    enough, step = min(len(blocks), too_few + 1), 1
    while enough < len(blocks) and _rank(blocks[:enough], others[:enough]) < full:
        too_few, enough, step = enough, min(len(blocks), enough + step), 2 * step
    while enough - too_few > 1:
        middle = (too_few + enough) // 2
        is_full = _rank(blocks[:middle], others[:middle]) == full
        too_few, enough = (too_few, middle) if is_full else (middle, enough)
    return enough


def _direction_name(names: Sequence[str], direction: Array) -> str:
    """Name a combination of parameters, such as "platform_x_joint.rx" or "a.tx - 0.5 b.tx"."""
    scaled = direction / direction[np.argmax(np.abs(direction))]
    terms = []
    for k in np.argsort(-np.abs(scaled), kind="stable"):
        amount = abs(float(scaled[k]))
        if amount < _SHOWN:
            break
        size = "" if abs(amount - 1.0) <= _AS_SHOWN else f"{amount:.2f} "
        terms.append((" - " if scaled[k] < 0.0 else " + ", f"{size}{names[k]}"))
    first = terms[0][1]
    return first + "".join(sign + term for sign, term in terms[1:])


def _beside(blocks: Array, nuisances: ArrayLike | None) -> Array:
    """Return the rows of a regressor with the effects of nuisances projected out, shape=(n rows, k)."""
    matrix = blocks.reshape(-1, blocks.shape[2])
    others = np.asarray([] if nuisances is None else nuisances, dtype=float)
    if not others.size:
        return matrix
    others = others.reshape(len(matrix), -1)
    sizes = np.linalg.norm(others, axis=0)
    left, values, _ = np.linalg.svd(others[:, sizes > 0.0] / sizes[sizes > 0.0], full_matrices=False)
    left = left[:, values > REGRESSOR_TOLERANCE * values.max(initial=0.0)]
    for _ in range(2):  # twice is enough (W. Kahan; B. Parlett, 1980)
        matrix = matrix - left @ (left.T @ matrix)
    return matrix


def _sparse(basis: Array) -> Array:
    """Return another basis of the same space whose vectors involve few parameters each: a reduced echelon form."""
    if not basis.shape[1]:
        return basis
    _, pivots = scipy.linalg.qr(basis.T, mode="r", pivoting=True)
    chosen = basis[pivots[: basis.shape[1]]]
    return np.asarray(basis @ np.linalg.inv(chosen))
