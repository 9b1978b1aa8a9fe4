"""Passive joints that are locked while the drives move: each closes one loop more, whose consistency is observed.

Nothing but the drives' counters is read (W. Khalil and D. Besnard, "Self calibration of Stewart-Gough parallel robots
without extra sensors", IEEE Transactions on Robotics and Automation 15, 1999, 1116-1121). A locked joint is an encoder
that always reads the same, its zero being estimated; the machine is moved until the joint is where it is locked.
"""

from __future__ import annotations

import numpy as np

from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.kind import InstrumentKind, Setting
from pm3dof_pin.measuring.measurements import joint_coordinates


def _place(setting: Setting) -> Instrument:
    if not setting.joints:
        raise InvalidValueError("joints", problem="are not given", expected="the passive joints that are locked")
    held = np.median(joint_coordinates(setting.poses.robot, setting.poses.q, setting.joints), axis=0)
    return Instrument(
        "position",
        position_sigma=setting.sigma,
        angle_sigma=setting.sigma,
        encoders=setting.joints,
        locked=tuple(held.tolist()),
        stops=True,
    )


LOCK = InstrumentKind(
    "lock", "that passive joints are locked while the drives move", "where each is locked", 50e-6, _place, centres=0
)
