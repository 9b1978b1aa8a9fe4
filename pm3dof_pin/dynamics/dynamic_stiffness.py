"""Receptances of the tool at many poses: at given frequencies, or their extremes over all.

For the extremes, frequencies are chosen by pose: at rest, and around the natural modes that move the tool most, in
multiples of their damping, where the extremes of lightly damped modes lie; a parabola through the best three refines
them. A depth of cut that keeps the force in one direction is stable at every speed below -1 / (2 K_s min Re G), K_s
being the cutting force per depth and chip thickness (J. Tlusty and M. Polacek, 1963).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike

from pm3dof_pin.arrays import frozen, require_kind
from pm3dof_pin.description.coordinates import TOOL_COMPONENTS
from pm3dof_pin.dynamics.damping import Damping
from pm3dof_pin.dynamics.receptance import angular_frequencies, vibrating_system
from pm3dof_pin.elastic.elastic_model import ElasticModel
from pm3dof_pin.kinematics.pose_values import PROGRAM_FROM, BatchOptions, evaluate_at
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.mechanism.loads import Payloads, model_with_payloads
from pm3dof_pin.tolerances import MASSLESS
from pm3dof_pin.typing import Array, Mask, Matrix, Vector

_MODES = 12  # natural modes around which frequencies are chosen
_MIN_RATIO = 1e-3  # of damping, by which frequencies of undamped modes are spread
_SPREAD = np.array([0.0, 0.2, 0.4, 0.6, 0.8, 1.0, 1.3, 2.0, 4.0])  # dampings from a natural frequency
_CHUNK = 200  # poses solved at once
RIGID = 1e-12
"""Movements in a direction, relative to the largest [m or rad], that are rounding of none."""


@dataclass(frozen=True, eq=False)
class DynamicStiffness:
    """Extremes over frequency of the receptance of the tool in each direction x, y, z, rx, ry, rz by itself."""

    minimum: Array  #: least 1 / |G|, shape=(..., 6) [N/m, N m/rad]
    critical_frequency: Array  #: the frequency of it, shape=(..., 6) [Hz]
    negative_real_part: Array  #: least Re G, negative unless overdamped, shape=(..., 6) [m/N, rad/(N m)]


def dynamic_stiffness(
    model: ElasticModel,
    poses: Poses | ArrayLike,
    *,
    damping: Damping | None = None,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> DynamicStiffness:
    """Compute the least dynamic stiffness of the tool at many poses.

    Example:
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.dynamics.dynamic_stiffness import dynamic_stiffness
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> least = dynamic_stiffness(model, model.rigid.home.q)
        >>> print(f"{least.minimum[0]:.3g} N/m in x at {least.critical_frequency[0]:.1f} Hz")
        7.24e+04 N/m in x at 264.2 Hz

    Args:
        model: the mechanism with its springs.
        poses: solved poses, or configurations q with closed loops, shape=(..., nq) [m, rad].
        damping: of the springs; by default those of the description, or `LOSS_FACTOR`.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia` in its axes.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Raises:
        FreeDirectionError: the tool can move with all springs at rest.
        PM3DofError: as :func:`~pm3dof_pin.dynamics.receptance.vibrating_system`.
    """
    values = _of_poses(
        model, poses, "dynamic stiffness", (3, len(TOOL_COMPONENTS)), _extremes, damping, payloads, options
    )
    return DynamicStiffness(values[..., 0, :], values[..., 1, :], values[..., 2, :])


def tool_receptances(
    model: ElasticModel,
    poses: Poses | ArrayLike,
    frequencies: ArrayLike,
    *,
    damping: Damping | None = None,
    payloads: Payloads | None = None,
    **options: Unpack[BatchOptions],
) -> Array:
    """Compute the receptance of the tool at many poses and frequencies.

    Example:
        >>> import numpy as np
        >>> import pm3dof_pin as pm
        >>> from pm3dof_pin.dynamics.dynamic_stiffness import tool_receptances
        >>> model = pm.ElasticModel.load("pm3dof")
        >>> poses = model.rigid.solve(model.rigid.grid(z_e=(0.45, 0.55, 3)))
        >>> G = tool_receptances(model, poses, [0.0, 50.0])
        >>> print(G.shape, (1e-6 / np.abs(G[:, 1, 0, 0])).round(3), "N/um in x at 50 Hz")
        (3, 2, 6, 6) [7.299 1.45  0.477] N/um in x at 50 Hz

    Args:
        model: the mechanism with its springs.
        poses: solved poses, or configurations q with closed loops, shape=(..., nq) [m, rad].
        frequencies: frequencies of the force, shape=(f,) [Hz]. At rest, springs lose nothing.
        damping: of the springs; by default those of the description, or `LOSS_FACTOR`.
        payloads: bodies fixed to frames, by frame: a point mass at its origin [kg], or a `pin.Inertia` in its axes.
        options: see :class:`~pm3dof_pin.kinematics.pose_values.BatchOptions`.

    Returns:
        Twist of the tool per wrench on it, linear before angular, in axes of the base, shape=(..., f, 6, 6), complex
        [m/N, 1/N, rad/(N m)].

    Raises:
        FreeDirectionError: the tool can move with all springs at rest.
        PM3DofError: as :func:`~pm3dof_pin.dynamics.receptance.vibrating_system`.
    """
    omegas = angular_frequencies(frequencies)
    size = len(TOOL_COMPONENTS)

    def receptances(inverse_squares: Array, twists: Array, structural: Array, viscous: Array) -> Array:
        at = np.broadcast_to(omegas, (len(twists), len(omegas)))
        poles, seen, excited, variable = _partial_fractions(at, inverse_squares, twists, structural, viscous)
        residues = seen.transpose(0, 2, 1)[..., None] * excited[:, :, None, :]
        found = 1.0 / (1.0 - variable[:, :, None] * poles[:, None, :]) @ residues.reshape(*poles.shape, size**2)
        found[:, omegas == 0.0] = (twists @ twists.transpose(0, 2, 1)).reshape(-1, 1, size**2)
        return np.ascontiguousarray(found).view(float)

    shape = (len(omegas), size, size, 2)  # real and imaginary parts
    values = _of_poses(model, poses, "receptance", shape, receptances, damping, payloads, options)
    return frozen(np.ascontiguousarray(values).view(complex)[..., 0])


_OfModes = Callable[[Array, Array, Array, Array], Array]
"""A function of n tools in natural modes of strain energy 1/2: 1 / omega_r^2, shape=(n, e), twists, shape=(n, 6, e),
loss factors and viscous damping in the modes, shape=(n, e, e)."""


def _of_poses(
    model: ElasticModel,
    poses: Poses | ArrayLike,
    name: str,
    shape: tuple[int, ...],
    of_modes: _OfModes,
    damping: Damping | None,
    payloads: Payloads | None,
    options: BatchOptions,
) -> Array:
    """Return a function of the tool's modes at many poses, shape=(..., *shape); errors as its callers'."""
    require_kind("model", model, ElasticModel, "pm.ElasticModel.load")
    model.mechanism.require_possible_inertias()
    damping = damping or Damping()
    tree = model_with_payloads(model.mechanism, payloads)

    def program(q: Matrix, threads: int | None) -> tuple[Array, Mask]:
        from pm3dof_pin.dynamics.traced import vibrating_tools

        tools, sound = vibrating_tools(model, tree, q, threads)
        values = np.full((len(q), math.prod(shape)), np.nan)
        modes = (part[sound] for part in tools)
        if sound.any():
            values[sound] = _of_batch(model, damping, *modes, of_modes=of_modes, threads=threads).reshape(
                sound.sum(), -1
            )
        return values, sound

    def reference(q: Vector) -> Array:
        system = vibrating_system(model, q, damping=damping, payloads=payloads)
        tool = system.rows([f"tool:{component}" for component in TOOL_COMPONENTS])
        system.receptance([0.0], tool, tool)  # raises if the tool is free
        parts = (system.inverse_squares, tool @ system.shapes, system.structural, system.viscous)
        value: Array = of_modes(*(part[None] for part in parts))[0]
        return value

    return evaluate_at(
        model.rigid, poses, name, shape, program=program, reference=reference, program_from=PROGRAM_FROM, **options
    ).values


def _of_batch(
    model: ElasticModel,
    damping: Damping,
    masses: Array,
    twists: Array,
    whitened: Array,
    *,
    of_modes: _OfModes,
    threads: int | None,
) -> Array:
    """Return a function of the modes of n systems, shape=(n, ...).

    Systems are given in any basis of strain energy 1/2: masses, shape=(n, e, e), and in each motion the twist of the
    tool, shape=(n, 6, e), and the strains in units of the springs, shape=(n, s, e).
    """
    losses, times = damping.of_springs(model)

    def chunk(start: int) -> Array:
        rows = slice(start, start + _CHUNK)
        inverse_squares, directions = np.linalg.eigh(masses[rows])
        inverse_squares, directions = inverse_squares[:, ::-1], directions[..., ::-1]
        inverse_squares = np.where(inverse_squares > MASSLESS * inverse_squares[:, :1], inverse_squares, 0.0)
        strains = whitened[rows] @ directions
        transposed = strains.transpose(0, 2, 1)
        structural, viscous = (transposed * losses) @ strains, (transposed * times) @ strains
        if damping.ratio is not None:
            structural = np.zeros_like(structural)
            viscous = 2.0 * damping.ratio * np.sqrt(inverse_squares)[..., None] * np.eye(inverse_squares.shape[1])
        return of_modes(inverse_squares, twists[rows] @ directions, structural, viscous)

    with ThreadPoolExecutor(threads) as pool:  # the linear algebra of NumPy runs beside other threads
        return np.concatenate(list(pool.map(chunk, range(0, len(masses), _CHUNK))))


def _extremes(inverse_squares: Array, twists: Array, structural: Array, viscous: Array) -> Array:
    """Return the extremes of n systems in their modes, shape=(n, 3, 6); infinite stiffness where the tool is rigid."""
    omegas = _frequencies(inverse_squares, twists, structural, viscous)
    largest = np.abs(twists).max(axis=2)
    is_rigid = largest <= RIGID * largest.max(axis=1, keepdims=True)
    direct = _direct_receptances(omegas, inverse_squares, twists, structural, viscous)
    greatest, at = _peaks(omegas, np.abs(direct))
    lowest, _ = _peaks(omegas, -direct.real)
    values = [
        1.0 / np.where(is_rigid, 1.0, greatest) + np.where(is_rigid, np.inf, 0.0),
        np.where(is_rigid, np.nan, at / (2.0 * np.pi)),
        np.where(is_rigid, 0.0, np.minimum(-lowest, 0.0)),
    ]
    return np.stack(values, axis=1)


def _frequencies(inverse_squares: Array, twists: Array, structural: Array, viscous: Array) -> Array:
    """Return angular frequencies at which to look, ascending, shape=(n, f) [rad/s]."""
    with np.errstate(divide="ignore"):
        natural = 1.0 / np.sqrt(inverse_squares)
    natural = np.where(np.isfinite(natural), natural, 0.0)
    losses = np.einsum("nrr->nr", structural) + natural * np.einsum("nrr->nr", viscous)
    ratios = np.clip(0.5 * losses, _MIN_RATIO, 0.2)
    if natural.shape[1] > _MODES:
        # by the height of each mode's own peak in each direction, relative to the highest there
        peaks = np.where(natural[:, None] > 0.0, twists**2 / ratios[:, None], 0.0)
        highest = peaks.max(axis=2, keepdims=True)
        shares = (peaks / np.where(highest > 0.0, highest, 1.0)).max(axis=1)
        kept = np.argsort(-shares, axis=1, kind="stable")[:, :_MODES]
        natural, ratios = (np.take_along_axis(values, kept, axis=1) for values in (natural, ratios))
    steps = np.concatenate([-_SPREAD[:0:-1], _SPREAD])
    around = natural[:, :, None] * (1.0 + ratios[:, :, None] * steps)
    omegas = np.concatenate([np.zeros((len(natural), 1)), around.reshape(len(natural), -1)], axis=1)
    return np.sort(omegas, axis=1)


def _direct_receptances(
    omegas: Array, inverse_squares: Array, twists: Array, structural: Array, viscous: Array
) -> Array:
    """Return G of each direction with itself, shape=(n, f, 6), complex; the first frequency is at rest."""
    poles, seen, excited, variable = _partial_fractions(omegas, inverse_squares, twists, structural, viscous)
    fractions = 1.0 / (1.0 - variable[:, :, None] * poles[:, None, :])
    direct: Array = fractions @ (seen * excited.transpose(0, 2, 1)).transpose(0, 2, 1)
    direct[:, 0] = (twists**2).sum(axis=2)
    return direct


def _partial_fractions(
    omegas: Array, inverse_squares: Array, twists: Array, structural: Array, viscous: Array
) -> tuple[Array, Array, Array, Array]:
    """Return poles, shape=(n, p), twists in their modes, (n, 6, p), their loads, (n, p, 6), and the variable, (n, f).

    Without dampers, D = k (1 - omega^2 A) with k = 1 + i H. With dampers, (x, omega x) satisfies a linear equation of
    twice the size in omega. The eigenvalues of A are the poles: G = sum of twist times load over 1 - variable * pole.
    """
    size = inverse_squares.shape[1]
    flexible = np.eye(size) + 1j * structural
    loads = np.linalg.solve(flexible, twists.transpose(0, 2, 1).astype(complex))
    inertia = np.linalg.solve(flexible, inverse_squares[:, :, None] * np.eye(size, dtype=complex))
    if viscous.any():
        damper = np.linalg.solve(flexible, 1j * viscous)
        matrix = np.zeros((len(inertia), 2 * size, 2 * size), dtype=complex)
        matrix[:, :size, :size], matrix[:, :size, size:] = -damper, inertia
        matrix[:, size:, :size] = np.eye(size)
        variable = omegas
        loads = np.concatenate([loads, np.zeros_like(loads)], axis=1)
    else:
        matrix, variable = inertia, omegas**2
    poles, vectors = np.linalg.eig(matrix)
    return poles, twists @ vectors[:, :size], np.linalg.solve(vectors, loads), variable


def _peaks(omegas: Array, heights: Array) -> tuple[Array, Array]:
    """Return the greatest heights over frequency and where, shape=(n, 6), by a parabola through the best three."""
    best = heights.argmax(axis=1)
    middle = np.clip(best, 1, heights.shape[1] - 2)
    axes = np.arange(heights.shape[2])
    rows = np.arange(len(heights))[:, None]
    (h0, h1, h2) = (heights[rows, middle + step, axes] for step in (-1, 0, 1))
    (w0, w1, w2) = (omegas[rows, middle + step] for step in (-1, 0, 1))
    with np.errstate(divide="ignore", invalid="ignore"):
        rise, fall = (h1 - h0) / (w1 - w0), (h2 - h1) / (w2 - w1)
        bend = (fall - rise) / (w2 - w0)
        top = 0.5 * (w0 + w1) - 0.5 * rise / bend
        height = h1 + (top - w1) * (rise + bend * (top - w0))
    inside = (best == middle) & (bend < 0.0) & (top >= w0) & (top <= w2)
    at_best = heights[rows, best, axes]
    return np.where(inside, height, at_best), np.where(inside, top, omegas[rows, best])
