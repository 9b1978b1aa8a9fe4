"""Compiled arithmetic of the tripod family: one pose in, numbers out, broadcast over any grid.

Each kernel is a NumPy generalised ufunc compiled by Numba. They take the pose (theta_x, theta_y, z_e), the leg table of
:class:`pm3dof_pin.chapter.tripod.Tripod` and the assembly mode of each leg (-1 slider below the platform, the chapter's
choice, or +1), and return NaN where a leg cannot reach the pose. The functions with checks and words around them are in
the other files of this folder.

All kernels stand in one file because Numba's cache on disk notices a change of the file a kernel stands in, but not of
the files it calls.

Symbols: D. Zhang, Parallel Robotic Machine Tools (Springer 2010), section 8.2; docs/theory.md.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import numba
import numpy as np

from pm3dof_pin.chapter.limit_kinds import Limit
from pm3dof_pin.kernel_cache import KEEP

_Function = TypeVar("_Function", bound=Callable[..., Any])

# Columns of the leg table, one row a leg.
BASE = 0  # B_i, base frame
GUIDE = 3  # e_i, unit direction of the guideway, base frame
JOINT = 6  # p_i, E_i in the platform frame
LENGTH = 9  # l
SOCKET = 10  # axis of the spherical joint, platform frame
FRAME_X = 13  # axes of the link at home, base frame
FRAME_Y = 16
FRAME_Z = 19
WIDTH = 22

_REACH = int(Limit.REACH)
_STROKE = int(Limit.STROKE)
_UNIVERSAL = int(Limit.UNIVERSAL)
_SPHERICAL = int(Limit.SPHERICAL)
_TILT = int(Limit.TILT)
_HEIGHT = int(Limit.HEIGHT)


def _scalar(function: _Function) -> _Function:
    compiled: _Function = numba.njit(cache=KEEP, error_model="numpy")(function)
    return compiled


def _gufunc(signature: str, layout: str) -> Callable[[_Function], Any]:
    """Compile to a generalised ufunc, at its first call, in which NaN is an answer and no floating-point warning."""

    def decorate(function: _Function) -> Any:
        @functools.cache
        def compiled() -> Any:
            return numba.guvectorize([signature], layout, nopython=True, cache=KEEP)(function)

        @functools.wraps(function)
        def call(*arrays: Any, **keywords: Any) -> Any:
            with np.errstate(all="ignore"):
                return compiled()(*arrays, **keywords)

        return call

    return decorate


@_scalar
def _rotate(cx: float, sx: float, cy: float, sy: float, a: float, b: float, c: float) -> tuple[float, float, float]:
    """R (a, b, c) with R = Rx(theta_x) Ry(theta_y), (8.3)."""
    return cy * a + sy * c, sx * sy * a + cx * b - sx * cy * c, -cx * sy * a + sx * b + cx * cy * c


@_scalar
def _leg(cx: float, sx: float, cy: float, sy: float, z: float, leg: Any, mode: float) -> tuple[float, ...]:
    """(u, k, R p): slider travel (NaN out of reach), link vector D_i E_i, platform joint from O_e; (8.6), (8.7)."""
    rx, ry, rz = _rotate(cx, sx, cy, sy, leg[JOINT], leg[JOINT + 1], leg[JOINT + 2])
    wx, wy, wz = rx - leg[BASE], ry - leg[BASE + 1], rz + z - leg[BASE + 2]
    along = wx * leg[GUIDE] + wy * leg[GUIDE + 1] + wz * leg[GUIDE + 2]
    radicand = along * along - (wx * wx + wy * wy + wz * wz - leg[LENGTH] * leg[LENGTH])
    u = along + mode * math.sqrt(radicand) if radicand >= 0.0 else math.nan
    return u, wx - u * leg[GUIDE], wy - u * leg[GUIDE + 1], wz - u * leg[GUIDE + 2], rx, ry, rz


@_scalar
def _rows(cx: float, sx: float, cy: float, sy: float, z: float, leg: Any, mode: float) -> tuple[float, ...]:
    """(J_a row of a leg, n.e): link elongation against (theta_x, theta_y, z_e), (8.10), and the cosine to the guide."""
    _, kx, ky, kz, rx, ry, rz = _leg(cx, sx, cy, sy, z, leg, mode)
    nx, ny, nz = kx / leg[LENGTH], ky / leg[LENGTH], kz / leg[LENGTH]
    moment_x, moment_y, moment_z = ry * nz - rz * ny, rz * nx - rx * nz, rx * ny - ry * nx
    cosine = nx * leg[GUIDE] + ny * leg[GUIDE + 1] + nz * leg[GUIDE + 2]
    return moment_x, cx * moment_y + sx * moment_z, nz, cosine


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:])", "(p),(n,k),(n)->(n)")
def slider_travel(pose, legs, modes, u):  # type: ignore[no-untyped-def]
    """u_i of every leg [m], (8.6)-(8.7)."""
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    for i in range(legs.shape[0]):
        u[i] = _leg(cx, sx, cy, sy, pose[2], legs[i], modes[i])[0]


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:,:])", "(p),(n,k),(n)->(n,p)")
def link_vectors(pose, legs, modes, vectors):  # type: ignore[no-untyped-def]
    """k_i = D_i E_i of every leg in the base frame [m], (8.7)."""
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    for i in range(legs.shape[0]):
        _, vectors[i, 0], vectors[i, 1], vectors[i, 2], _, _, _ = _leg(cx, sx, cy, sy, pose[2], legs[i], modes[i])


@_gufunc("void(float64[:], float64[:,:], float64[:,:,:])", "(p),(n,k)->(n,p,p)")
def platform_joint_jacobians(pose, legs, jacobians):  # type: ignore[no-untyped-def]
    """J_i of every leg: dE_i against (theta_x, theta_y, z_e), (8.5)."""
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    for i in range(legs.shape[0]):
        rx, ry, rz = _rotate(cx, sx, cy, sy, legs[i, JOINT], legs[i, JOINT + 1], legs[i, JOINT + 2])
        jacobians[i, 0, 0], jacobians[i, 1, 0], jacobians[i, 2, 0] = 0.0, -rz, ry
        jacobians[i, 0, 1], jacobians[i, 1, 1], jacobians[i, 2, 1] = cx * rz - sx * ry, sx * rx, -cx * rx
        jacobians[i, 0, 2], jacobians[i, 1, 2], jacobians[i, 2, 2] = 0.0, 0.0, 1.0


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:,:], float64[:,:])", "(p),(n,k),(n)->(n,p),(n,p)")
def leg_jacobians(pose, legs, modes, link, slider):  # type: ignore[no-untyped-def]
    """J_a (8.10) and J_t (8.9): link elongation and slider travel against (theta_x, theta_y, z_e)."""
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    for i in range(legs.shape[0]):
        a, b, c, cosine = _rows(cx, sx, cy, sy, pose[2], legs[i], modes[i])
        link[i, 0], link[i, 1], link[i, 2] = a, b, c
        slider[i, 0], slider[i, 1], slider[i, 2] = a / cosine, b / cosine, c / cosine


@_scalar
def _joint_angles(cx: float, sx: float, cy: float, sy: float, leg: Any, k: Any) -> tuple[float, float, float]:
    """Both angles of the universal joint at D_i, from home, and the swing of the spherical joint at E_i."""
    kx, ky, kz = k
    x = kx * leg[FRAME_X] + ky * leg[FRAME_X + 1] + kz * leg[FRAME_X + 2]
    y = kx * leg[FRAME_Y] + ky * leg[FRAME_Y + 1] + kz * leg[FRAME_Y + 2]
    z = kx * leg[FRAME_Z] + ky * leg[FRAME_Z + 1] + kz * leg[FRAME_Z + 2]
    ax, ay, az = _rotate(cx, sx, cy, sy, leg[SOCKET], leg[SOCKET + 1], leg[SOCKET + 2])
    dx, dy, dz = ay * kz - az * ky, az * kx - ax * kz, ax * ky - ay * kx
    swing = math.atan2(math.sqrt(dx * dx + dy * dy + dz * dz), ax * kx + ay * ky + az * kz)
    return math.atan2(x, z), -math.atan2(y, math.sqrt(x * x + z * z)), swing


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:,:])", "(p),(n,k),(n)->(n,p)")
def passive_angles(pose, legs, modes, angles):  # type: ignore[no-untyped-def]
    """(first, second universal angle, swing of the spherical joint) of every leg [rad]."""
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    for i in range(legs.shape[0]):
        _, kx, ky, kz, _, _, _ = _leg(cx, sx, cy, sy, pose[2], legs[i], modes[i])
        angles[i, 0], angles[i, 1], angles[i, 2] = _joint_angles(cx, sx, cy, sy, legs[i], (kx, ky, kz))


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:], uint8[:])", "(p),(n,k),(n),(b)->()")
def broken_limits(pose, legs, modes, bounds, flags):  # type: ignore[no-untyped-def]
    """Bits of :class:`~pm3dof_pin.chapter.limit_kinds.Limit` for every limit that the pose breaks.

    bounds: u_min, u_max [m], universal, spherical [rad], z_min, z_max [m].
    """
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    broken = 0
    # written so that a pose that is not a number breaks its limit
    if not (abs(pose[0]) <= bounds[2] and abs(pose[1]) <= bounds[2]):
        broken |= _TILT
    if not (bounds[4] <= pose[2] <= bounds[5]):
        broken |= _HEIGHT
    for i in range(legs.shape[0]):
        u, kx, ky, kz, _, _, _ = _leg(cx, sx, cy, sy, pose[2], legs[i], modes[i])
        if math.isnan(u):
            broken |= _REACH
            continue
        first, second, swing = _joint_angles(cx, sx, cy, sy, legs[i], (kx, ky, kz))
        if not bounds[0] <= u <= bounds[1]:
            broken |= _STROKE
        if abs(first) > bounds[2] or abs(second) > bounds[2]:
            broken |= _UNIVERSAL
        if swing > bounds[3]:
            broken |= _SPHERICAL
    flags[0] = broken


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:], float64[:])", "(p),(n,k),(n),(d)->(d)")
def chapter_diagonal(pose, legs, modes, springs, diagonal):  # type: ignore[no-untyped-def]
    """The chapter's stiffness (theta_x, theta_y, t_z, t_x, t_y, theta_z), section 8.2.3 as recovered.

    springs: k_a, k_t [N/m], E I, G J [N m^2], z_b [m] and one unused place that gives the result its length.
    """
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    length = pose[2] - springs[4]
    bending = springs[2] / length**3
    theta_x = bending
    theta_y = bending
    t_z = 0.0
    for i in range(legs.shape[0]):
        a, b, c, cosine = _rows(cx, sx, cy, sy, pose[2], legs[i], modes[i])
        stiffness = springs[1] + springs[0] / (cosine * cosine)
        theta_x += stiffness * a * a
        theta_y += stiffness * b * b
        t_z += stiffness * c * c
    if length <= 0.0 or math.isnan(t_z):
        diagonal[:] = math.nan
        return
    diagonal[0], diagonal[1], diagonal[2] = theta_x, theta_y, t_z
    diagonal[3] = diagonal[4] = bending / length**2
    diagonal[5] = springs[3] / length**2


@_scalar
def _solve_3(a: Any, b: Any) -> None:
    """Solve the 3 x 3 system a x = b in place of b, Gauss with partial pivoting; a singular one gives inf or NaN."""
    for column in range(3):
        pivot = column
        for row in range(column + 1, 3):
            if abs(a[row, column]) > abs(a[pivot, column]):
                pivot = row
        if pivot != column:
            for other in range(3):
                a[column, other], a[pivot, other] = a[pivot, other], a[column, other]
            b[column], b[pivot] = b[pivot], b[column]
        for row in range(column + 1, 3):
            factor = a[row, column] / a[column, column]
            for other in range(column, 3):
                a[row, other] -= factor * a[column, other]
            b[row] -= factor * b[column]
    for row in range(2, -1, -1):
        for other in range(row + 1, 3):
            b[row] -= a[row, other] * b[other]
        b[row] /= a[row, row]


@_gufunc(
    "void(float64[:], float64[:], float64[:,:], float64, int64, float64[:], float64[:], int64[:])",
    "(n),(p),(n,k),(),()->(p),(),()",
)
def newton(u, guess, legs, tolerance, most_steps, pose, residual, steps):  # type: ignore[no-untyped-def]
    """Direct kinematics by Newton's method on the link lengths, from a guess.

    The equations are (|k_i|^2 - l^2) / (2 l) = 0, in metres, and their derivative k_i . J_i / l (8.5); with more than
    three legs the step is the least-squares one. A step turns the platform by 0.3 rad and moves it by 0.1 m at most.
    residual is the largest link-length error [m].
    """
    matrix = np.empty((3, 3))
    step = np.empty(3)
    pose[:] = guess
    count = 0
    while True:
        cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
        matrix[:] = 0.0
        step[:] = 0.0
        worst = 0.0
        for i in range(legs.shape[0]):
            rx, ry, rz = _rotate(cx, sx, cy, sy, legs[i, JOINT], legs[i, JOINT + 1], legs[i, JOINT + 2])
            length = legs[i, LENGTH]
            nx = (rx - legs[i, BASE] - u[i] * legs[i, GUIDE]) / length
            ny = (ry - legs[i, BASE + 1] - u[i] * legs[i, GUIDE + 1]) / length
            nz = (rz + pose[2] - legs[i, BASE + 2] - u[i] * legs[i, GUIDE + 2]) / length
            error = 0.5 * length * (nx * nx + ny * ny + nz * nz - 1.0)
            worst = error if math.isnan(error) else max(worst, abs(error))
            a = ry * nz - rz * ny
            b = cx * (rz * nx - rx * nz) + sx * (rx * ny - ry * nx)
            if legs.shape[0] == 3:
                matrix[i, 0], matrix[i, 1], matrix[i, 2] = a, b, nz
                step[i] = error
            else:
                row = (a, b, nz)
                for j in range(3):
                    step[j] += row[j] * error
                    for k in range(3):
                        matrix[j, k] += row[j] * row[k]
        if not worst > tolerance or count >= most_steps:
            break
        _solve_3(matrix, step)
        reduction = max(1.0, abs(step[0]) / 0.3, abs(step[1]) / 0.3, abs(step[2]) / 0.1)
        for j in range(3):
            pose[j] -= step[j] / reduction
        count += 1
    residual[0] = worst
    steps[0] = count


@_gufunc("void(float64[:], float64[:,:], float64[:], float64[:], float64[:,:])", "(p),(n,k),(n),(d)->(d,d)")
def elastic_stiffness(pose, legs, modes, springs, stiffness):  # type: ignore[no-untyped-def]
    """The 6 x 6 stiffness at O_e, docs/theory.md: axial springs of the legs in series and the cantilever in the middle.

    springs: as for chapter_diagonal. Order x, y, z, rx, ry, rz in the axes of the base. NaN out of reach and at or
    below the clamp.
    """
    cx, sx, cy, sy = math.cos(pose[0]), math.sin(pose[0]), math.cos(pose[1]), math.sin(pose[1])
    length = pose[2] - springs[4]
    # The cantilever's tip compliance on the three directions that the universal joint holds: x, y and the turn about
    # (0, -sin theta_x, cos theta_x); y is by itself, x and the turn form a 2 x 2 block.
    lateral = length**3 / (3.0 * springs[2])
    coupling = -sx * length**2 / (2.0 * springs[2])
    turn = length * (sx * sx / springs[2] + cx * cx / springs[3])
    determinant = lateral * turn - coupling * coupling
    reached = length > 0.0
    k_xx, k_yy, k_xt, k_tt = turn / determinant, 1.0 / lateral, -coupling / determinant, lateral / determinant
    k_xy = k_xz = k_xa = k_yz = k_ya = k_yb = k_yc = k_zz = k_za = k_zb = k_zc = k_aa = k_ab = k_ac = 0.0
    k_xb, k_xc = -sx * k_xt, cx * k_xt
    k_bb, k_bc, k_cc = sx * sx * k_tt, -sx * cx * k_tt, cx * cx * k_tt
    for i in range(legs.shape[0]):
        u, kx, ky, kz, rx, ry, rz = _leg(cx, sx, cy, sy, pose[2], legs[i], modes[i])
        reached = reached and not math.isnan(u)
        inverse = 1.0 / legs[i, LENGTH]
        x, y, z = kx * inverse, ky * inverse, kz * inverse
        cosine = x * legs[i, GUIDE] + y * legs[i, GUIDE + 1] + z * legs[i, GUIDE + 2]
        spring = springs[0] * springs[1] / (springs[0] + springs[1] * cosine * cosine)
        a, b, c = ry * z - rz * y, rz * x - rx * z, rx * y - ry * x
        fx, fy, fz, fa, fb = spring * x, spring * y, spring * z, spring * a, spring * b
        k_xx += fx * x
        k_xy += fx * y
        k_xz += fx * z
        k_xa += fx * a
        k_xb += fx * b
        k_xc += fx * c
        k_yy += fy * y
        k_yz += fy * z
        k_ya += fy * a
        k_yb += fy * b
        k_yc += fy * c
        k_zz += fz * z
        k_za += fz * a
        k_zb += fz * b
        k_zc += fz * c
        k_aa += fa * a
        k_ab += fa * b
        k_ac += fa * c
        k_bb += fb * b
        k_bc += fb * c
        k_cc += spring * c * c
    if not reached:
        stiffness[:] = math.nan
        return
    stiffness[0, 0] = k_xx
    stiffness[0, 1] = stiffness[1, 0] = k_xy
    stiffness[0, 2] = stiffness[2, 0] = k_xz
    stiffness[0, 3] = stiffness[3, 0] = k_xa
    stiffness[0, 4] = stiffness[4, 0] = k_xb
    stiffness[0, 5] = stiffness[5, 0] = k_xc
    stiffness[1, 1] = k_yy
    stiffness[1, 2] = stiffness[2, 1] = k_yz
    stiffness[1, 3] = stiffness[3, 1] = k_ya
    stiffness[1, 4] = stiffness[4, 1] = k_yb
    stiffness[1, 5] = stiffness[5, 1] = k_yc
    stiffness[2, 2] = k_zz
    stiffness[2, 3] = stiffness[3, 2] = k_za
    stiffness[2, 4] = stiffness[4, 2] = k_zb
    stiffness[2, 5] = stiffness[5, 2] = k_zc
    stiffness[3, 3] = k_aa
    stiffness[3, 4] = stiffness[4, 3] = k_ab
    stiffness[3, 5] = stiffness[5, 3] = k_ac
    stiffness[4, 4] = k_bb
    stiffness[4, 5] = stiffness[5, 4] = k_bc
    stiffness[5, 5] = k_cc
