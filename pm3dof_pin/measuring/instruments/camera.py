"""A camera of unknown placement and known intrinsics that sees targets on the tool: g(X) = depth times X/Z, Y/Z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.measuring.datum import DatumKind
from pm3dof_pin.measuring.instrument import Instrument, PlacedDatum, as_points, circle_of_targets
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.typing import Array

_FLAT = 1e-3  # of the greatest extent: too flat for a camera's placement
_TRIALS, _SOME, _NEARER = 20, 12, 3  # with a tenth of the rows wrong, a quarter of such twelve have none
_DIRECTION = np.array([1.0, 0.5, 2.0])
_AWAY = 3.0  # times the greater of the extent of the points seen and their distance from the tool point


def _image(points: Array) -> Array:
    return np.asarray(points[:, :2] / points[:, 2:])


def _gradient(points: Array) -> Array:
    x, y, z = points.T
    nothing = np.zeros_like(x)
    return np.stack([np.stack([1.0 / z, nothing, -x / z**2], 1), np.stack([nothing, 1.0 / z, -y / z**2], 1)], axis=1)


def _start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    """Resections from all rows and, as a few may be of other targets, from the half that agrees best with itself.

    From some rows each, again from the half that is nearest to that (P. Rousseeuw, JASA 79, 1984).
    """
    extents = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    if extents[-1] < _FLAT * extents[0]:
        raise InvalidValueError("camera", problem="sees points in one plane", expected="points at different depths")
    generator, some, half = np.random.default_rng(0), min(_SOME, len(points)), max(_SOME, len(points) // 2 + 1)
    found: list[tuple[float, int, tuple[Array, Array]]] = []
    for trial in range(_TRIALS):
        rows = generator.permutation(len(points))[:some]
        for _ in range(_NEARER):
            axes, origin = _resection(points[rows], values[rows])
            off = np.linalg.norm(_image((points - origin) @ axes.T) - values, axis=1)
            rows = np.argsort(off)[:half]
        found.append((float(np.median(off)), trial, (axes, origin)))
    return [_resection(points, values), min(found)[2]]


def _resection(points: Array, values: Array) -> tuple[Array, Array]:
    """Return axes and origin by the direct linear transformation (I. Sutherland, 1974), about the points' middle."""
    middle = points.mean(axis=0)
    size = np.linalg.norm(points - middle, axis=1).max()
    whole = np.column_stack([(points - middle) / size, np.ones(len(points))])
    nothing = np.zeros_like(whole)
    u, v = values.T[:, :, None]
    matrix = np.concatenate([np.hstack([whole, nothing, -u * whole]), np.hstack([nothing, whole, -v * whole])])
    projection = np.linalg.svd(matrix, full_matrices=False)[2][-1].reshape(3, 4)
    left, scales, right = np.linalg.svd(projection[:, :3])
    turn = left @ right
    sign = np.sign(np.linalg.det(turn))
    axes, shift = sign * turn, sign * projection[:, 3] / scales.mean() * size
    return axes, middle - axes.T @ shift


def _read(cells: Array) -> tuple[Array, Array]:
    u, v, focal_u, focal_v, centre_u, centre_v = cells.T
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.column_stack([(u - centre_u) / focal_u, (v - centre_v) / focal_v]), 1.0 / np.abs(focal_u)


def _written(numbers: Array) -> Array:
    """Image coordinates of a focal length of 1, tangents."""
    return np.column_stack([numbers, np.tile([1.0, 1.0, 0.0, 0.0], (len(numbers), 1))])


LENS = DatumKind(
    "camera",
    dimension=2,
    moves=(0, 1, 2, 3, 4, 5),
    min_rows=6,
    measured=_image,
    gradient=_gradient,
    start=_start,
    columns=("image_u_px", "image_v_px", "focal_u_px", "focal_v_px", "centre_u_px", "centre_v_px"),
    needed=True,
    sigma_column="sigma_image_px",
    usual_sigma=0.1,
    read=_read,
    written=_written,
    through_a_lens=True,
)
"""A camera."""


def _place(setting: Setting) -> Instrument:
    targets = circle_of_targets() if setting.point is None else setting.targets
    points = setting.points(targets)
    middle = np.median(points, axis=0)
    away = _AWAY * setting.extent(points) * _DIRECTION / np.linalg.norm(_DIRECTION)
    place = np.array(setting.centres[0]) if setting.centres else middle + away
    ahead = (middle - place) / np.linalg.norm(middle - place)
    across = np.cross([0.0, 0.0, 1.0] if abs(ahead[2]) < 0.99 else [0.0, 1.0, 0.0], ahead)
    across /= np.linalg.norm(across)
    axes = as_points([across, np.cross(ahead, across), ahead])
    return replace(setting.at(PlacedDatum(LENS, as_points([place])[0], axes)), targets=targets)


CAMERA = InstrumentKind(
    "camera", "image points of targets on the tool", "its placement; its intrinsics are known", 20e-6, _place, LENS
)
