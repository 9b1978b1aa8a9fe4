"""Electronic level or inclinometer on the tool: two tilts; the base is level."""

from __future__ import annotations

from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting


def _place(setting: Setting) -> Instrument:
    return Instrument("pose", position_sigma=setting.sigma, angle_sigma=setting.sigma, tilts_only=True)


LEVEL = InstrumentKind("level", "two tilts", "nothing", 10e-6, _place, centres=0)
