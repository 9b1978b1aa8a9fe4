"""Direct kinematics of the tripod, from slider travels to poses, by Newton's method and by elimination."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pm3dof_pin.chapter.kinematics import motion_twists, rotation
from pm3dof_pin.chapter.tripod import Tripod
from pm3dof_pin.exceptions import ConvergenceError, InvalidValueError, ShapeError
from pm3dof_pin.typing import Array

TOLERANCE = 1e-13  # largest link-length error of a solution [m]
_MAX_STEPS = 50

# Origins of the half-angle tangents, chosen so that no pose of interest has an infinite tangent, and that symmetric
# machines are not in a special position for the elimination.
_ORIGIN_X = 0.3217
_ORIGIN_Y = -0.1873
_DISTINCT = 1e-7  # solutions closer than this are the same [rad, m]


@dataclass(frozen=True)
class DirectKinematics:
    """Result of Newton's method."""

    poses: Array  #: (theta_x, theta_y, z_e), shape=(..., 3) [rad, rad, m]
    residual: Array  #: largest link-length error at each pose, shape=(...) [m]
    steps: NDArray[np.int64]  #: number of Newton steps for each pose, shape=(...)
    converged: NDArray[np.bool_]  #: residual within :data:`TOLERANCE`, shape=(...)


def newton(
    tripod: Tripod, u: ArrayLike, guess: ArrayLike | None = None, *, most_steps: int = _MAX_STEPS
) -> DirectKinematics:
    """Solve the direct kinematics by Newton's method on the link lengths; quadratic near a solution.

    The equations are (|k_i|^2 - l^2) / (2 l) = 0, in metres, and their derivative k_i . J_i / l (8.5); with more than
    three legs the step is the least-squares one. A step rotates the platform by at most 0.3 rad and moves it by at most
    0.1 m. From home, the default guess, every pose of the chapter's workspace is found. Divergence does not raise.

    Raises:
        InvalidValueError: the travels u are not of shape (..., n).
    """
    travels = _checked_travels(tripod, u)
    start = tripod.home if guess is None else np.asarray(guess, dtype=float)
    shape = np.broadcast_shapes(travels.shape[:-1], start.shape[:-1])
    sliders = tripod.base_joints + travels[..., None] * tripod.guide_directions
    sliders = np.broadcast_to(sliders, (*shape, tripod.leg_count, 3)).reshape(-1, tripod.leg_count, 3)
    poses = np.array(np.broadcast_to(start, (*shape, 3))).reshape(-1, 3)
    residual, steps = np.empty(len(poses)), np.zeros(len(poses), dtype=np.int64)
    moving = np.arange(len(poses))
    for step in range(most_steps + 1):
        errors, jacobian = _length_errors(tripod, poses[moving], sliders[moving])
        residual[moving] = np.abs(errors).max(axis=-1)
        # a quarter of the tolerance, so that a different order of summation still meets it
        far = residual[moving] > 0.25 * TOLERANCE
        if step == most_steps or not far.any():
            break
        moving = moving[far]
        poses[moving] -= _shortened(_least_squares_step(jacobian[far], errors[far]))
        steps[moving] += 1
    return DirectKinematics(
        poses.reshape(*shape, 3), residual.reshape(shape), steps.reshape(shape), (residual <= TOLERANCE).reshape(shape)
    )


def _length_errors(tripod: Tripod, poses: Array, sliders: Array) -> tuple[Array, Array]:
    """Return (|k_i|^2 - l^2) / (2 l) and its derivative by the pose, shapes=(m, n), (m, n, 3)."""
    length = tripod.parameters.link_length
    turned = rotation(poses[:, 0], poses[:, 1])
    arms = np.einsum("mij,nj->mni", turned, tripod.platform_joints)
    directions = (arms + poses[:, None, 2:] * [0.0, 0.0, 1.0] - sliders) / length
    errors = 0.5 * length * (np.einsum("mni,mni->mn", directions, directions) - 1.0)
    wrenches = np.concatenate([directions, np.cross(arms, directions)], axis=-1)
    return errors, wrenches @ motion_twists(poses)


def _least_squares_step(jacobian: Array, errors: Array) -> Array:
    """Return x of least |J x - e|, shape=(m, 3), not finite where J is singular; three rows by Cramer's rule."""
    matrix, right = jacobian, errors
    if jacobian.shape[1] != 3:
        transposed = np.swapaxes(jacobian, 1, 2)
        matrix, right = transposed @ jacobian, (transposed @ errors[..., None])[..., 0]
    a, b, c = np.moveaxis(matrix, 1, 0)
    adjugate = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)
    with np.errstate(all="ignore"):
        step: Array = np.einsum("mij,mj->mi", adjugate, right) / np.sum(a * adjugate[..., 0], axis=-1)[:, None]
    return step


def _shortened(step: Array) -> Array:
    longest: Array = np.maximum(1.0, np.abs(step / [0.3, 0.3, 0.1]).max(axis=-1, keepdims=True))
    with np.errstate(invalid="ignore"):
        shorter: Array = step / longest
    return shorter


def direct_kinematics(tripod: Tripod, u: ArrayLike) -> Array:
    """Return the poses, shape=(..., 3) [rad, rad, m], at slider travels u [m] in the assembly mode of home.

    Raises:
        ConvergenceError: no pose was found for some travels: the loops cannot be closed, or not from home.
        InvalidValueError: u is not finite or not of shape (..., n).
    """
    travels = _checked_travels(tripod, u)
    if not np.all(np.isfinite(travels)):
        raise InvalidValueError("u", travels, "finite slider travels in metres")
    result = newton(tripod, travels)
    if not np.all(result.converged):
        worst = np.unravel_index(np.nanargmax(np.nan_to_num(result.residual, nan=np.inf)), result.residual.shape)
        listed = ", ".join(
            f"{travel:.6g}" for travel in np.broadcast_to(travels, (*result.residual.shape, tripod.leg_count))[worst]
        )
        raise ConvergenceError(
            f"direct kinematics at u = ({listed}) m",
            float(result.residual[worst]),
            "m of link length",
            int(result.steps[worst]),
            "the links may not reach the platform at these travels; all_assembly_modes(), or fk --all, needs no guess",
        )
    return result.poses


def all_assembly_modes(tripod: Tripod, u: ArrayLike) -> Array:
    """Return every real pose of a machine with three legs at slider travels u [m], without a guess.

    The three link equations are polynomials in the half-angle tangents s, t of theta_x, theta_y and in z_e. The
    differences of two of them are linear in z_e; with s hidden, a Sylvester-type matrix over the monomials t^0..3
    z^0..3 turns them into a quadratic eigenvalue problem in s of size 16. Its real eigenvalues are refined by Newton's
    method. Poses have shape=(m, 3) [rad, rad, m], angles in (-pi, pi], the highest platform first; m is zero if the
    loops cannot be closed. Limits and collisions are not checked.

    Raises:
        InvalidValueError: the machine does not have three legs, or u is not three finite numbers.
    """
    travels = _checked_travels(tripod, u)
    if tripod.leg_count != 3 or travels.shape != (3,) or not np.all(np.isfinite(travels)):
        raise InvalidValueError("u", travels, "three finite slider travels, and a machine with three legs")
    candidates = _candidates(_link_polynomials(tripod, travels))
    if len(candidates) == 0:
        return np.empty((0, 3))
    result = newton(tripod, travels, candidates)
    poses = result.poses[result.converged]
    poses[:, :2] = np.pi - np.mod(np.pi - poses[:, :2], 2.0 * np.pi)
    return _distinct(poses)


def _checked_travels(tripod: Tripod, u: ArrayLike) -> Array:
    travels = np.asarray(u, dtype=np.float64)
    if travels.ndim == 0 or travels.shape[-1] != tripod.leg_count:
        raise ShapeError("u", travels.shape, f"(..., {tripod.leg_count})")
    return travels


def _tangent_basis(origin: float) -> tuple[Array, Array, Array]:
    """1, cos, sin of (origin + 2 atan s), times (1 + s^2), as coefficients of s^0, s^1, s^2."""
    c, s = np.cos(origin), np.sin(origin)
    return np.array([1.0, 0.0, 1.0]), np.array([c, -2.0 * s, -c]), np.array([s, 2.0 * c, -s])


def _link_polynomials(tripod: Tripod, u: Array) -> Array:
    """Return |k_i|^2 - l^2 times (1 + s^2)(1 + t^2), coefficients [leg, power of s, power of t, power of z]."""
    one_x, cos_x, sin_x = _tangent_basis(_ORIGIN_X)
    one_y, cos_y, sin_y = _tangent_basis(_ORIGIN_Y)
    sliders = tripod.base_joints + u[:, None] * tripod.guide_directions
    polynomials = np.zeros((3, 3, 3, 3))
    for polynomial, (dx, dy, dz), (px, py, pz) in zip(polynomials, sliders, tripod.platform_joints, strict=True):
        x = np.outer(one_x, px * cos_y + pz * sin_y)
        y = np.outer(sin_x, px * sin_y - pz * cos_y) + np.outer(cos_x, py * one_y)
        z = np.outer(cos_x, pz * cos_y - px * sin_y) + np.outer(sin_x, py * one_y)
        one = np.outer(one_x, one_y)
        constant = dx**2 + dy**2 + dz**2 + px**2 + py**2 + pz**2 - tripod.parameters.link_length**2
        polynomial[:, :, 0] = constant * one - 2.0 * (dx * x + dy * y + dz * z)
        polynomial[:, :, 1] = 2.0 * (z - dz * one)
        polynomial[:, :, 2] = one
    return polynomials


def _candidates(polynomials: Array) -> Array:
    """Return starting poses that include all real solutions, shape=(m, 3)."""
    tangents = [(s, t, z) for s in _hidden_tangents(polynomials) for t, z in _remaining_unknowns(polynomials, s)]
    s, t, z = np.array(tangents).reshape(-1, 3).T
    return np.stack([_ORIGIN_X + 2.0 * np.arctan(s), _ORIGIN_Y + 2.0 * np.arctan(t), z], axis=-1)


def _hidden_tangents(polynomials: Array) -> Array:
    """Return the real values of s at which the resultant matrix is singular."""
    first, second, third = polynomials
    shifted = [(first, power, height) for power in range(2) for height in range(2)]
    for other in (second, third):
        shifted += [(first - other, power, height) for power in range(2) for height in range(3)]
    matrices = np.zeros((3, 16, 4, 4))  # power of s, equation, power of t, power of z
    for row, (polynomial, power, height) in enumerate(shifted):
        count = min(3, 4 - height)  # differences have no z^2
        matrices[:, row, power : power + 3, height : height + count] = polynomial[:, :, :count]
    constant, linear, quadratic = matrices.reshape(3, 16, 16)
    identity, zero = np.eye(16), np.zeros((16, 16))
    left = np.block([[zero, identity], [-constant, -linear]])
    right = np.block([[identity, zero], [zero, quadratic]])
    import scipy.linalg  # only for all assembly modes

    numerator, denominator = scipy.linalg.eigvals(left, right, homogeneous_eigvals=True)
    finite = np.abs(denominator) > 1e-12 * np.abs(numerator)
    return _nearly_real(numerator[finite] / denominator[finite])


def _remaining_unknowns(polynomials: Array, s: float) -> list[tuple[float, float]]:
    """Return possible (t, z) for s: t from both differences without z, z from the first equation.

    Solutions may share s, and even s and t, as at symmetric travels; so every combination is returned.
    """
    first, second, third = np.tensordot(np.array([1.0, s, s * s]), polynomials, axes=(0, 1))
    g, h = first - second, first - third
    quartic = np.convolve(g[::-1, 0], h[::-1, 1]) - np.convolve(g[::-1, 1], h[::-1, 0])
    pairs = []
    for t in _nearly_real(np.roots(quartic)):
        quadratic = np.array([1.0, t, t * t]) @ first
        pairs += [(float(t), float(z)) for z in _nearly_real(np.roots(quadratic[::-1]))]
    return pairs


def _nearly_real(numbers: NDArray[Any]) -> Array:
    """Real parts of numbers that are real up to rounding, which moves double roots off the axis by about 1e-4."""
    return np.asarray(numbers.real[np.abs(numbers.imag) < 1e-3 * (1.0 + np.abs(numbers))])


def _distinct(poses: Array) -> Array:
    kept: list[Array] = []
    for pose in poses[np.argsort(-poses[:, 2], kind="stable")]:
        if all(_distance(pose, other) > _DISTINCT for other in kept):
            kept.append(pose)
    return np.array(kept).reshape(-1, 3)


def _distance(pose: Array, other: Array) -> float:
    """Largest difference between two poses, with angles taken the short way round."""
    difference = pose - other
    difference[:2] = np.remainder(difference[:2] + np.pi, 2.0 * np.pi) - np.pi
    return float(np.abs(difference).max())
