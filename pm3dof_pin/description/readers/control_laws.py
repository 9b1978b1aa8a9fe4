"""What force an actuator of MuJoCo gives: gain times control, and a bias by position and speed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from pm3dof_pin.description.description import Drive

BIASES = ("none", "affine")
"""Types of bias that are constants, or linear in position and speed."""

LAGS = ("none", "filter", "filterexact")
"""Types of activation that arrive at the control signal."""


def with_control_law(drive: Drive, gain: float, bias: Sequence[float]) -> Drive:
    """Return an actuator with the kind and gains of its law: force = gain control + b0 + b1 position + b2 speed.

    Without bias it is a motor, with b1 a position servo, with b2 alone one of speed; a law that is none of these leaves
    it as it is.
    """
    constant, position, speed = bias
    if constant or position > 0.0 or speed > 0.0:
        return drive
    usual = -position or -speed or 1.0
    return replace(
        drive,
        kind="position" if position else "velocity" if speed else "motor",
        proportional_gain=-position or None,
        derivative_gain=-speed or None,
        control_gain=None if gain == usual else gain,
    )
