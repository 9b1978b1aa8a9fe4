"""Tool errors to first order, from independent errors of any origin: averages and bounds.

The tool moves by dx = shift + sum of E_k x_k, with x_k independent, of mean 0 and deviation 1, |x_k| at most g_k. With
W = diag(1, 1, 1, eta, eta, eta), the tip error is, root mean square over machines,

    sqrt(|W shift|^2 + sum_k |W E_k|^2),

and at most the smaller of |W (|shift| + sum_k g_k |E_k|)| and |W shift| + sum_k g_k |W E_k|. Known shifts are added
as vectors before they are squared. Corrected commands leave (1 - W C (W C)^+) W dx, C the tool's motion by commands.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from functools import cached_property

import numpy as np

from pm3dof_pin.errors.normal_vectors import expected_norm
from pm3dof_pin.errors.pose_error import tip_weights
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Mask

LEAST_SENSITIVE_PART = 0.2
"""Fraction of the poses that form the least sensitive region."""


class ToolErrors(ABC):
    """Errors of the tool at n poses of a robot as described."""

    poses: Poses  #: the poses
    eta: float  #: weight of the orientation in the tip error [m/rad]

    @property
    @abstractmethod
    def shift(self) -> Array:
        """The known error, shape=(n, 6) [m, rad]."""

    @property
    @abstractmethod
    def effects(self) -> Array:
        """Effect of each independent number at one standard deviation, shape=(n, 6, k) [m, rad]."""

    @property
    @abstractmethod
    def greatest(self) -> Array:
        """Greatest value of each number in standard deviations, shape=(k,)."""

    @abstractmethod
    def _by_commands(self) -> Array:
        """Return the tool's motion by the commands, shape=(n, 6, number of commands)."""

    @property
    def weights(self) -> Array:
        """The weights of the tip error: W, 0 for what is not a motion of the tool, shape=(6,)."""
        return tip_weights(self.eta, self.poses.robot.tool_motions)

    @property
    def tip_rms(self) -> Array:
        """Tip error, root mean square over machines, shape=(n,) [m]."""
        weights = self.weights
        squares = np.sum((self.shift * weights) ** 2, axis=1)
        return np.asarray(np.sqrt(squares + self._sizes(np.swapaxes(self.effects, 1, 2), weights) ** 2))

    @property
    def worst_tip(self) -> Array:
        """Bound of the tip error with every number within its greatest value, shape=(n,) [m]."""
        weights = self.weights
        effects, greatest = self.effects, self.greatest
        components = np.abs(self.shift) + np.abs(effects) @ greatest
        sizes = np.sqrt(np.einsum("nik,nik,i->nk", effects, effects, weights**2))
        added = np.linalg.norm(self.shift * weights, axis=1) + sizes @ greatest
        return np.asarray(np.minimum(np.linalg.norm(components * weights, axis=1), added))

    @property
    def energy(self) -> Array:
        """E of (8.15), E_xyz + eta E_orientation, mean over machines with normal errors, shape=(n,) [m]."""
        shift, covariance = self.shift * self.weights, self.covariance() * np.outer(self.weights, self.weights)
        position, orientation = (
            expected_norm(shift[:, part], covariance[:, part, part]) for part in (slice(0, 3), slice(3, 6))
        )
        return np.asarray(position + orientation)

    def covariance(self) -> Array:
        """Return the covariance of the tool's pose error, shape=(n, 6, 6) [m^2, m rad, rad^2]."""
        effects = self.effects
        return np.asarray(effects @ np.swapaxes(effects, 1, 2))

    def least_sensitive(self, part: float = LEAST_SENSITIVE_PART) -> Mask:
        """Tell which poses are in the fraction with the smallest tip error, shape=(n,).

        Raises:
            InvalidValueError: the fraction is not in (0, 1].
        """
        if not 0.0 < part <= 1.0:
            raise InvalidValueError("part", part, "a fraction of the poses, more than 0 and at most 1")
        sizes = self.tip_rms
        return np.asarray(sizes <= np.sort(sizes)[max(1, round(part * len(sizes))) - 1])

    @cached_property
    def _basis(self) -> Array:
        """Orthonormal basis of tip-weighted motions by the commands, shape=(n, 6, k); zero-padded."""
        left, values, _ = np.linalg.svd(self._by_commands() * self.weights[:, None], full_matrices=False)
        return np.asarray(left * (values > SOLVED * values.max(axis=1, keepdims=True))[:, None, :])

    @staticmethod
    def _sizes(effects: Array, sigmas: Array) -> Array:
        """Return root-sum-square sizes of effects, shape=(n, rows, k), by deviations, shape=(k,); no copies."""
        return np.asarray(np.sqrt(np.einsum("nik,nik,k->n", effects, effects, np.square(sigmas))))
