"""Elastic quantities for maps, reduced within the program: a few numbers per pose instead of a matrix.

Each quantity is defined twice: traced, from a root of the compliance or the stiffness, and in NumPy, from the report of
one pose, for poses at which the program is in doubt.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import reduce

import numpy as np

from pm3dof_pin.description.coordinates import ToolComponent
from pm3dof_pin.elastic import indices
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.elastic.free_motions import free_motion_stiffness
from pm3dof_pin.elastic.report import CartesianCompliance
from pm3dof_pin.elastic.traced import Roots
from pm3dof_pin.exceptions import RigidDirectionError
from pm3dof_pin.programs.elimination import squared_singular_values, total, zeros
from pm3dof_pin.programs.graph import Scalar, is_zero, less, maximum, select, sqrt
from pm3dof_pin.tolerances import ROUNDING
from pm3dof_pin.typing import Array, Matrix, Objects, Vector

_SINGULAR = 1e-10  # of the greatest eigenvalue of K: so little may be that of a free direction


@dataclass(frozen=True)
class ElasticQuantity:
    """An elastic quantity of a frame."""

    name: str  #: its name
    shape: tuple[int, ...]  #: shape of its value
    traced: Callable[[Roots], Objects]  #: maps roots to numbers of that shape
    computed: Callable[[CartesianCompliance], Array]  #: maps the report of one pose to the value


def _matrix(columns: Objects) -> Objects:
    """Return X X^T, exactly symmetric."""
    size = len(columns)
    result = zeros(size, size)
    for i in range(size):
        for j in range(i, size):
            result[i, j] = result[j, i] = total([a * b for a, b in zip(columns[i], columns[j], strict=True)])
    return result


def _stiffness(roots: Roots) -> Objects:
    try:
        return _matrix(roots.stiffness)
    except RigidDirectionError:
        return np.full((6, 6), math.nan, dtype=object)


def _axis_compliance(roots: Roots) -> Objects:
    return np.array([total([entry * entry for entry in row]) for row in roots.compliance], dtype=object)


def _axis_stiffness(roots: Roots) -> Objects:
    """Return the same as :func:`~pm3dof_pin.elastic.indices.axis_stiffness`."""
    compliances = _axis_compliance(roots)
    pairs = zip(compliances, _rounding(roots, compliances), strict=True)
    return np.array([_inverse(compliance, zero, math.inf) for compliance, zero in pairs], dtype=object)


def _rounding(roots: Roots, compliances: Objects) -> list[Scalar]:
    """Return the same as :func:`~pm3dof_pin.elastic.indices.rounding`, for each axis."""
    softest = [reduce(maximum, compliances[:3]), reduce(maximum, compliances[3:])]
    square = roots.model.mechanism.length_unit**2
    others = [softest[1] * (ROUNDING**2 * square), softest[0] * (ROUNDING**2 / square)]
    return [maximum(own * ROUNDING, other) for own, other in zip(softest, others, strict=True) for _ in range(3)]


def _inverse(value: Scalar, zero: Scalar, otherwise: float) -> Scalar:
    """Return 1 / value, or another number where the value is no more than rounding."""
    if is_zero(value):
        return otherwise
    with np.errstate(divide="ignore"):
        return select(less(zero, value), 1.0 / value, otherwise)


def _principal(roots: Roots) -> Objects:
    """Return the principal stiffnesses of both blocks of the compliance, ascending, shape=(2, 3)."""
    result = zeros(2, 3)
    for block, zero in enumerate(_rounding(roots, _axis_compliance(roots))[::3]):
        squares = squared_singular_values(roots.compliance[3 * block : 3 * block + 3])
        result[block] = [_inverse(s, zero, math.inf) for s in reversed(squares)]
    return result


def _conditioning(roots: Roots) -> Objects:
    """Return the eigenvalues of K at its characteristic length, ascending, and this length.

    Where the least of them may be zero, as the tool may be free, they are in doubt.
    """
    try:
        columns = roots.stiffness
    except RigidDirectionError:
        return np.full(7, math.nan, dtype=object)
    translation, rotation = (
        total([entry * entry for entry in columns[rows].ravel()]) for rows in (slice(0, 3), slice(3, 6))
    )
    if is_zero(translation) or is_zero(rotation):  # the tool is free
        return np.full(7, math.nan, dtype=object)
    length = sqrt(rotation / translation)
    scaled = columns.copy()
    scaled[3:] = scaled[3:] * (1.0 / length)
    squares = squared_singular_values(scaled)
    roots.is_sound = roots.is_sound & less(squares[-1] * _SINGULAR, squares[0])
    return np.array([*squares, length], dtype=object)


def _computed_stiffness(report: CartesianCompliance) -> Array:
    return np.full((6, 6), np.nan) if report.rigid_directions.size else report.stiffness


def _computed_principal(report: CartesianCompliance) -> Array:
    blocks = (report.compliance[:3, :3], report.compliance[3:, 3:])
    return np.stack(
        [_principal_stiffnesses(block, zero) for block, zero in zip(blocks, _rounding_of(report), strict=True)]
    )


def _rounding_of(report: CartesianCompliance) -> Vector:
    compliances = report.contributions.sum(axis=0).diagonal()
    return indices.rounding(compliances, report.configuration.mechanism.length_unit)


def _principal_stiffnesses(block: Matrix, zero: float) -> Vector:
    """Return the principal stiffnesses of a block of the compliance, ascending; infinite where it is rigid."""
    found = indices.principal_axes(inverse_definite(block)).values
    with np.errstate(divide="ignore"):
        values = 1.0 / found if np.isfinite(found).all() else np.linalg.eigvalsh(block)[::-1]
        return np.where(values > zero, 1.0 / values, np.inf)


def _computed_conditioning(report: CartesianCompliance) -> Array:
    if report.rigid_directions.size:
        return np.full(7, np.nan)
    unit = report.configuration.mechanism.length_unit
    kinds = np.trace(report.stiffness[:3, :3]) * unit**2, np.trace(report.stiffness[3:, 3:])
    if min(kinds) <= ROUNDING * max(kinds):  # all rotations are free, or all translations
        return np.full(7, np.nan)
    length = indices.characteristic_length(report.stiffness)
    values = np.array(indices.eigenvalues(report.stiffness, length))
    values[: report.free_directions.shape[1]] = 0.0
    return np.append(values, length)


COMPLIANCE = ElasticQuantity(
    "compliance", (6, 6), lambda roots: _matrix(roots.compliance), lambda report: report.compliance
)
"""C, twist = C wrench [m/N, 1/N, rad/(N m)]."""

STIFFNESS = ElasticQuantity("stiffness", (6, 6), _stiffness, _computed_stiffness)
"""K, wrench = K twist [N/m, N, N m/rad]; NaN if a direction is rigid."""

AXIS_COMPLIANCE = ElasticQuantity(
    "axis_compliance", (6,), _axis_compliance, lambda report: report.compliance.diagonal()
)
"""Deflection along each axis under a unit force or moment along it, all else free [m/N, rad/(N m)]."""

AXIS_STIFFNESS = ElasticQuantity(
    "axis_stiffness",
    (6,),
    _axis_stiffness,
    lambda report: indices.axis_stiffness(report.compliance.diagonal(), report.configuration.mechanism.length_unit),
)
"""Stiffness along and about each axis, all else free; infinite where it is rigid [N/m, N m/rad]."""

PRINCIPAL_STIFFNESS = ElasticQuantity("principal_stiffness", (2, 3), _principal, _computed_principal)
"""Principal stiffnesses of the translations, then of the rotations, all else free, ascending [N/m], [N m/rad]."""

CONDITIONING = ElasticQuantity("conditioning", (7,), _conditioning, _computed_conditioning)
"""Eigenvalues of K at its characteristic length, ascending, zero for free directions [N/m], and this length [m]."""


def spring_shares(model: ElasticModel) -> ElasticQuantity:
    """Return the share of each spring in the deflection under a unit wrench along each axis, shape=(6, springs).

    NaN along rigid axes.
    """

    def traced(roots: Roots) -> Objects:
        squares = roots.compliance_by_spring * roots.compliance_by_spring
        shares = zeros(6, len(model.blocks))
        for i, row in enumerate(squares):
            shares[i] = [total(list(row[spring])) for spring in model.spring_slices]
        compliances = np.array([total(list(parts)) for parts in shares], dtype=object)
        for parts, whole, zero in zip(shares, compliances, _rounding(roots, compliances), strict=True):
            inverse = _inverse(whole, zero, math.nan)
            parts[:] = [part * inverse for part in parts]
        return shares

    def computed(report: CartesianCompliance) -> Array:
        parts = np.einsum("sii->is", report.contributions)
        whole = parts.sum(axis=1, keepdims=True)
        is_rigid = whole <= np.repeat(_rounding_of(report), 3)[:, None]
        return np.asarray(parts / np.where(is_rigid, np.nan, whole))

    return ElasticQuantity("spring_shares", (6, len(model.blocks)), traced, computed)


def compliance_by_spring(model: ElasticModel) -> ElasticQuantity:
    """Return the compliance contribution of each spring, shape=(springs, 6, 6) [m/N, 1/N, rad/(N m)]."""
    return ElasticQuantity(
        "contributions",
        (len(model.blocks), 6, 6),
        lambda roots: np.stack([_matrix(roots.compliance_by_spring[:, spring]) for spring in model.spring_slices]),
        lambda report: report.contributions,
    )


def free_stiffness(model: ElasticModel, components: tuple[ToolComponent, ...] = ()) -> ElasticQuantity:
    """Return the stiffness of components of the tool's twist, or of the declared coordinates, shape=(p, p).

    In N/m, N and N m/rad; NaN where these are not the robot's free motions.
    """
    names: tuple[str, ...] = components or tuple(c.name for c in model.rigid.declared_coordinates)

    def computed(report: CartesianCompliance) -> Array:
        configuration = model.rigid.configuration(model.project(report.configuration.q))
        found = free_motion_stiffness(model, configuration, components=components)
        return found.stiffness if found.names == names else np.full((len(names), len(names)), np.nan)

    return ElasticQuantity(
        "_".join(("free_stiffness", *components)),
        (len(names), len(names)),
        lambda roots: _matrix(roots.coordinate_stiffness(components)),
        computed,
    )
