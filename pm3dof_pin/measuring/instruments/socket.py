"""A ball held in a seat of unknown place while the tool turns about it: g(X) = X, Y, Z."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.measuring.datum import DatumKind, constant
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.typing import Array


def _start(points: Array, values: Array) -> list[tuple[Array, Array]]:
    return [(np.eye(3), points.mean(axis=0))]


SEAT = DatumKind(
    "socket",
    dimension=3,
    moves=(0, 1, 2),
    min_rows=2,
    measured=lambda x: x,
    gradient=constant(np.eye(3)),
    start=_start,
)
"""A seat."""


def _place(setting: Setting) -> Instrument:
    return setting.at(setting.one(SEAT, np.eye(3), setting.middle, (0.0, 0.0, 0.0)), stops=True)


SOCKET = InstrumentKind("socket", "a ball held in a seat, the tool turning about it", "the seat", 2e-6, _place, SEAT)
