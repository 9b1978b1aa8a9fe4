"""A taut wire, a straight edge or a bore of unknown pose that is touched: g(X) = X, Y."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.measuring.datum import DatumKind, axes_of_extents, constant
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.typing import Array

_ALONG_X = np.eye(3)[[1, 2, 0]]


def _start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    return [(axes_of_extents(points)[[1, 2, 0]], points.mean(axis=0))]


LINE_DATUM = DatumKind(
    "line",
    dimension=2,
    moves=(0, 1, 3, 4),
    min_rows=3,
    measured=lambda x: x[:, :2],
    gradient=constant(np.eye(3)[:2]),
    start=_start,
)
"""A line."""


def _place(setting: Setting) -> Instrument:
    return setting.at(setting.one(LINE_DATUM, _ALONG_X, setting.middle, (0.0, 0.0)), stops=True)


LINE = InstrumentKind("line", "a touch of a straight edge or taut wire", "the line", 5e-6, _place, LINE_DATUM)
