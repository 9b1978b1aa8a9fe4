"""A plane of unknown pose: a probe touches it, a dial gauge or a bed sensor measures heights above it. g(X) = Z."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pm3dof_pin.errors.command_correction import command_jacobians, command_scales
from pm3dof_pin.measuring.datum import INCLINATION, DatumKind, axes_of_extents, constant, narrowness
from pm3dof_pin.measuring.instrument import Instrument, PlacedDatum
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.typing import Array

_IN_A_PLANE = 1e-6  # of the greatest motion
_THIN = 0.02  # extent over the first of points that a machine moving in a plane touches a plane across it with


def _start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    axes, centre = axes_of_extents(points), points.mean(axis=0)
    if not np.ptp(values) and 0.0 < narrowness(points, axes) < _THIN:
        return [(axes[[2, 0, 1]], centre - values.mean() * axes[1])]
    upward = axes if axes[2] @ np.ones(3) >= 0.0 else np.array([axes[0], -axes[1], -axes[2]])
    starts = [upward, np.eye(3)] if not np.ptp(values) else [upward, upward * [[1.0], [-1.0], [-1.0]], np.eye(3)]
    return [(each, centre - values.mean() * each[2]) for each in starts]


PLANE = DatumKind(
    "plane",
    dimension=1,
    moves=(2, 3, 4),
    min_rows=4,
    measured=lambda x: x[:, 2:],
    gradient=constant(np.eye(3)[2:]),
    start=_start,
    columns=("height_m",),
    read=lambda cells: (np.nan_to_num(cells), 1.0),
    written=lambda numbers: numbers,
    even=True,
)
"""A plane; without a height it is touched."""


def _plane(setting: Setting, touch: tuple[float, ...] | None = None) -> PlacedDatum:
    """Return the plane, across that of a machine which moves in one: through the greatest extent of its points."""
    across = _normal_of_motion(setting)
    if across is None:
        return setting.one(PLANE, np.eye(3), setting.middle, touch)
    points = setting.points(setting.targets)
    along = np.cross(np.cross(across, axes_of_extents(points)[0]), across)
    along /= np.linalg.norm(along)
    found = setting.one(PLANE, np.stack([across, along, np.cross(across, along)]), setting.middle)
    return replace(found, touch=touch, idle=() if touch is None else INCLINATION)


def _normal_of_motion(setting: Setting) -> Array | None:
    """Return the normal of the plane in which the drives move the point at all poses, shape=(3,); None without one."""
    poses, target = setting.poses, np.array(setting.targets[0])
    motions, arms = command_jacobians(poses) * command_scales(poses), poses.rotations @ target
    linear = motions[:, :3] + np.cross(motions[:, 3:], arms[:, :, None], axisa=1, axisb=1, axisc=1)
    _, sizes, axes = np.linalg.svd(np.swapaxes(linear, 1, 2).reshape(-1, 3), full_matrices=False)
    return np.asarray(axes[2]) if sizes[2] < _IN_A_PLANE * sizes[0] < sizes[1] else None


def _probe(setting: Setting) -> Instrument:
    return setting.at(_plane(setting, (0.0,)), stops=True)


def _gauge(setting: Setting) -> Instrument:
    return setting.at(_plane(setting))


PROBE = InstrumentKind("probe", "a touch of a plane", "the plane", 5e-6, _probe, PLANE)
GAUGE = InstrumentKind("gauge", "a height above a plane", "the plane", 2e-6, _gauge, PLANE)
