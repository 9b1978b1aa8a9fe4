"""Correct only by what is certain enough: a machine's commands must not be made worse.

The identified parameters x are wrong by a d of covariance S, and they move the tool by E x. Commands corrected for the
parameters y correct T y, where T = C C^+ E is the part of E that the drives undo. Over the workspace the gain is

    g = sum |E (x + d)|^2 - |E (x + d) - T y|^2,

which is normal. y = x is best on average, but where little was seen the spread of g may be as large as its mean:
correcting directions that were not seen is a gamble. Of all corrections with the same chance that g < 0, the one that
gains most is

    y = (1 + m S M)^-1 x,    M = sum T^T T,

with a multiplier m >= 0: the more uncertain a direction is, the less it is corrected. The sum is not over the measured
poses: those at which a line is touched say little of the others, where the machine works.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.errors.command_correction import weighted_control
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.typing import Array

HARM = 0.01
"""Admissible probability, given the parameters, that corrected commands are worse than uncorrected ones."""

_POSES = 800  # at which it is evaluated: over 200 the gain of a few per cent is 3 % likely to be none over others
_MANY, _FEW_POSES = 150, 200  # parameters from which poses take long, and as many as are evaluated then
_SINGULAR = 3.0  # times the median effect of the tolerances: a few poses beyond it would outweigh all others
_MULTIPLIERS = np.logspace(-4.0, 6.0, 81)  # in units of the trace of S M


@dataclass(frozen=True, eq=False)
class Gain:
    """Gain of commands corrected for some parameters, given what was identified."""

    identified: Array  #: x, shape=(parameters,) [m, rad]
    covariance: Array  #: S, with or without rows of base and tool, shape=(p or p + 12, same)
    effects: Array  #: E, tip-weighted, shape=(n, 6, p or p + 12)
    corrected: Array  #: T, shape=(n, 6, parameters)

    @classmethod
    def from_compensation(cls, compensation: Compensation) -> Gain:
        """Return the gain over the workspace of a compensation by identified parameters."""
        values, covariance = compensation.values, compensation.known_covariance
        assert values is not None
        assert covariance is not None
        count = _POSES if len(values) <= _MANY else _FEW_POSES
        poses = reachable_poses(compensation.errors.robot, count, np.random.default_rng(0))
        # near singular poses the calibrated machine may not reach what the described one does
        model = compensation.model_poses(poses, on_failure="nan")
        poses, model = poses[model.solved], model[model.solved]
        effects = compensation.effects(model)
        sizes = np.linalg.norm(effects[:, :, : len(values)] * compensation.errors.tolerances, axis=(1, 2))
        regular = sizes <= _SINGULAR * np.median(sizes)
        effects, control = effects[regular], weighted_control(poses[regular], compensation.eta)
        corrected = (control @ np.linalg.pinv(control)) @ effects[:, :, : len(values)]
        return cls(values, covariance, effects, corrected)

    def chance_of_harm(self, values: Array) -> float:
        """Return the probability that commands corrected for these values are worse than uncorrected ones."""
        before = self.effects[:, :, : len(values)] @ self.identified
        correction = self.corrected @ values
        along = np.einsum("nij,ni->j", self.effects, correction)
        mean = float(np.sum((2.0 * before - correction) * correction))
        spread = 2.0 * float(np.sqrt(along @ self.covariance @ along))
        return float(scipy.special.ndtr(-mean / max(spread, np.finfo(float).tiny)))

    def part(self, values: Array) -> float:
        """Return the size of the correction for these values relative to that for x, root mean squares."""
        return float(np.linalg.norm(self.corrected @ values) / np.linalg.norm(self.corrected @ self.identified))

    def sure_values(self) -> Array:
        """Return y with the least m at which the chance of harm is :data:`HARM`, or the least chance if none is."""
        if self.chance_of_harm(self.identified) <= HARM:
            return self.identified
        count = len(self.identified)
        flat = self.corrected.reshape(-1, count)
        product = self.covariance[:count, :count] @ (flat.T @ flat)
        values = self.identified
        for multiplier in _MULTIPLIERS / max(float(np.trace(product)), np.finfo(float).tiny):
            values = np.linalg.solve(np.eye(count) + multiplier * product, self.identified)
            if self.chance_of_harm(values) <= HARM:
                break
        return np.asarray(values)
