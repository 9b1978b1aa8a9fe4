"""Laser tracker: position and orientation of the tool, by targets on it."""

from __future__ import annotations

from pm3dof_pin.measuring.instrument import TARGET_SIGMA, Instrument
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting


def _place(setting: Setting) -> Instrument:
    return Instrument.with_targets(setting.sigma)


TRACKER = InstrumentKind(
    "tracker", "position and orientation, by targets", "its frame, with --own-frame", TARGET_SIGMA, _place, centres=0
)
