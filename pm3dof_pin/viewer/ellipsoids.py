"""Ellipsoids at the tool: the block they show, and the drawn length of their axes.

The ellipsoid of a symmetric 3 x 3 block has its principal directions as axes and its principal values, times a scale,
as semi-axes. For a compliance block it shows the displacements under unit forces in all directions; for a stiffness
block, the forces for unit displacements. Velocity and force ellipsoids (T. Yoshikawa, Manipulability of robotic
mechanisms, 1985) show the effect at the tool of command rates, or actuator forces, of unit norm; the error ellipsoid
has the standard deviations of the tool's pose for the tolerances of its parts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import finite_array
from pm3dof_pin.elastic import indices
from pm3dof_pin.elastic.definite_inverse import inverse_definite
from pm3dof_pin.elastic.indices import OtherMotions
from pm3dof_pin.exceptions import InvalidValueError, RigidDirectionError, SingularConfigurationError
from pm3dof_pin.typing import Array, Motion
from pm3dof_pin.viewer import objects
from pm3dof_pin.viewer.plane import MotionSpace
from pm3dof_pin.viewer.scene import Scene

EllipsoidMatrix = Literal["stiffness", "compliance"]
MotionQuantity = Literal["velocity", "force", "error"]
EllipsoidQuantity: TypeAlias = EllipsoidMatrix | MotionQuantity

UNITS: dict[tuple[EllipsoidQuantity, Motion], str] = {
    ("stiffness", "translation"): "N/m",
    ("stiffness", "rotation"): "N m/rad",
    ("compliance", "translation"): "m/N",
    ("compliance", "rotation"): "rad/(N m)",
    ("velocity", "translation"): "m/s",
    ("velocity", "rotation"): "rad/s",
    ("force", "translation"): "N",
    ("force", "rotation"): "N m",
    ("error", "translation"): "m",
    ("error", "rotation"): "rad",
}
"""Units of principal values."""

EXPLANATIONS: dict[MotionQuantity, str] = {
    "velocity": "command rates of unit norm",
    "force": "actuator forces of unit norm",
    "error": "standard deviation due to the tolerances",
}
"""Explanations of velocity, force and error ellipsoids."""

COLOURS: dict[Motion, tuple[float, float, float]] = {"translation": (0.33, 0.20, 0.72), "rotation": (0.86, 0.24, 0.44)}


_MIN_LENGTH = 1e-6  # relative to the longest semi-axis
_OPACITY: dict[Motion, float] = {"translation": 0.24, "rotation": 0.14}
_RING_POINTS = 72
_NO_DEFLECTION = 1e-13  # relative to the greatest compliance of the same unit: less is rounding
_RIGID = 1e-7  # relative to the greatest velocity: roots of rounding errors are smaller


@dataclass(frozen=True)
class DrawnEllipsoid:
    """A drawn ellipsoid: ascending principal values, and their directions as columns of a right-handed frame.

    `scale` is the length of a semi-axis of value 1 [m per unit].
    """

    values: Array
    axes: Array
    position: Array
    scale: float
    unit: str

    @classmethod
    def from_matrix(cls, matrix: ArrayLike, position: ArrayLike, *, scale: float, unit: str) -> DrawnEllipsoid:
        """Return the ellipsoid of a 3 x 3 block at a point [m]; InvalidValueError unless the scale is positive."""
        if not (math.isfinite(scale) and scale > 0.0):
            raise InvalidValueError("scale", scale, "a positive length for one unit")
        principal = indices.principal_axes(matrix)
        return cls(principal.values, principal.axes, np.asarray(position, dtype=float), scale, unit)

    @property
    def transform(self) -> Array:
        """Transform from the unit sphere to this ellipsoid, shape=(4, 4)."""
        lengths = self.scale * np.abs(self.values)
        # a zero length, as of a rigid direction, would leave no axes
        return objects.transform(self.axes * np.maximum(lengths, _MIN_LENGTH * lengths.max()), self.position)


def block(
    stiffness: ArrayLike | None,
    compliance: ArrayLike | None,
    kind: Motion,
    of: EllipsoidMatrix,
    others: OtherMotions,
    space: MotionSpace | None = None,
) -> Array:
    """Return the 3 x 3 block of K or C that an ellipsoid shows, in the unit of :data:`UNITS`.

    C_ff of a compliance and inv(C_ff) of a stiffness with the other motions free (no force or moment in them); K_ff and
    inv(K_ff) with them held. The motions are all six, or those of a plane, outside of which the block is zero.

    Raises:
        InvalidValueError: neither or both of K and C are given, the matrix is not finite or not 6 x 6, or a choice is
            unknown.
        SingularConfigurationError: the block does not exist, since some motion is free or rigid.
    """
    for word, given_word, known in (
        ("kind", kind, Motion),
        ("of", of, EllipsoidMatrix),
        ("others", others, OtherMotions),
    ):
        if given_word not in get_args(known):
            raise InvalidValueError(word, given_word, f"one of {', '.join(get_args(known))}")
    matrices: dict[EllipsoidMatrix, ArrayLike | None] = {"stiffness": stiffness, "compliance": compliance}
    given = [(name, entries) for name, entries in matrices.items() if entries is not None]
    if len(given) != 1:
        raise InvalidValueError("stiffness, compliance", "both" if given else "none", "one of them")
    name, entries = given[0]
    matrix = finite_array(name, entries, (6, 6))
    basis, translations = (np.eye(6), 3) if space is None else (space.basis, space.translations)
    matrix = basis.T @ matrix @ basis
    submatrix_of: EllipsoidMatrix = "stiffness" if others == "held" else "compliance"
    rows = slice(0, translations) if kind == "translation" else slice(translations, None)
    part: Array = (matrix if name == submatrix_of else inverse_definite(matrix))[rows, rows]
    if of != submatrix_of:
        if of == "stiffness" and np.all(np.isfinite(part)):
            softness = np.linalg.eigvalsh(part)
            if softness[0] <= _NO_DEFLECTION * softness[-1]:
                raise RigidDirectionError(f"no {of} ellipsoid of {kind}: some motion is rigid")
        part = inverse_definite(part)
    if not np.all(np.isfinite(part)):
        raise SingularConfigurationError(f"no {of} ellipsoid of {kind}: some motion is free or rigid")
    axes = basis[:3, rows] if kind == "translation" else basis[3:, rows]
    result: Array = axes @ part @ axes.T
    return result


def motion_block(motions: ArrayLike, kind: Motion, of: MotionQuantity) -> Array:
    """Return the root of M M^T, or its inverse for a force, shape=(3, 3), in the unit of :data:`UNITS`.

    M, shape=(6, n), has the twists [v; omega] of the tool for one unit of each command, or one standard deviation of
    each error.

    Raises:
        SingularConfigurationError: for a force ellipsoid, if commands do not move the tool in some direction.
    """
    rows = slice(0, 3) if kind == "translation" else slice(3, 6)
    columns = np.asarray(motions, dtype=float)[rows]
    left, values, _ = np.linalg.svd(columns @ columns.T)
    values = np.sqrt(values)
    if of == "force":
        if values[-1] <= _RIGID * values[0]:
            raise SingularConfigurationError(f"no force ellipsoid of {kind}: the tool does not move in some direction")
        values = 1.0 / values
    root: Array = (left * values) @ left.T
    return root


def draw_ellipsoid(scene: Scene, path: str, kind: Motion) -> None:
    """Draw a unit sphere with axes and rings at a path; :attr:`DrawnEllipsoid.transform` makes it an ellipsoid.

    The surface is faint, so as not to hide the machine, and seen through it; rings in its principal planes show its
    shape.
    """
    colour = COLOURS[kind]
    surface = objects.mesh(objects.sphere(1.0), colour, opacity=_OPACITY[kind], overlaid=True)
    scene.set_object(f"{path}/surface", surface, casts_shadow=False)
    ends = np.stack([-np.eye(3), np.eye(3)], axis=1).reshape(-1, 3)
    angle = np.linspace(0.0, 2.0 * np.pi, _RING_POINTS + 1)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    segments = np.stack([circle[:-1], circle[1:]], axis=1).reshape(-1, 3)
    rings = [np.roll(segments, shift, axis=1) for shift in range(3)]
    lines = objects.line_segments(np.concatenate([ends, *rings]), colour, overlaid=True)
    scene.set_object(f"{path}/axes", lines, casts_shadow=False)


def round_scale(greatest: float, length: float) -> float:
    """Return a scale [m per unit] at which a length [m] is 1, 2 or 5 times 10^n units, at least the greatest value."""
    if greatest <= 0.0:
        return length
    power = 10.0 ** math.floor(math.log10(greatest))
    steps = [factor * power for factor in (1.0, 2.0, 5.0, 10.0)]
    return length / next(step for step in steps if greatest <= step * (1.0 + 1e-9))


def round_length(size: float) -> float:
    """Return the greatest of the lengths 1, 2 or 5 times 10^n not exceeding a size [m]."""
    power = 10.0 ** math.floor(math.log10(size))
    return max(factor * power for factor in (1.0, 2.0, 5.0) if factor * power <= size * (1.0 + 1e-9))
