"""Errors of a corrected machine beyond all known uncertainty: those of its drives, and those in all directions.

What parameters do not describe comes from the drives (leads, waves, backlash), which deviate from their commands, and
from everything else (guides, sag, heat), which has no preferred direction: the tip-weighted error e at a pose has the
covariance

    V = K + a P + b (1 - P) + C diag(d) C^T,

with K known, from noise and parameters, P the projection on positions, and C the motion of the tool by the drives'
joints. a, b and d are fitted to errors of held-out poses by Fisher's scoring (minimum-variance quadratic estimates:
C. R. Rao, J. Multivariate Analysis 1, 1971), as far as each pose shows them; a = b if poses are not shown completely.
Drives of one kind, translating or rotating, are taken to be alike, and both kinds to have the same effect on the tool.
Variances are not negative: if there is no scatter at all, they are too large by 0.4 of their standard error, on
average. That is on the safe side for a bound; for an expected value, a part below its standard error may be left out.

**The root mean square of one machine's errors over many poses.** At pose i the error is m_i + E_i x + G_i s_i. m is
known; x, independent standard normal, are the errors of the parameters, the same at all poses; s is the scatter, of
covariance V. Over n poses, with A = sum E^T E / n and v = sum E^T m / n, the mean square has

    mean = sum |m|^2 / n + tr A + sum tr G V G^T / n,   variance = 2 tr A^2 + 4 |v|^2 + that of the estimate of V,

and is approximated by a scaled chi square with the same two moments (F. Satterthwaite, Biometrics Bulletin 2, 1946).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from pm3dof_pin.calibration.pseudo_error import control_inverse
from pm3dof_pin.errors.normal_vectors import norm_quantiles
from pm3dof_pin.tolerances import SOLVED
from pm3dof_pin.typing import Array, Mask

COVERAGE = 0.95
"""Probability of intervals and of error bounds."""

_PROBABILITIES = np.array([0.5 - 0.5 * COVERAGE, 0.5 + 0.5 * COVERAGE])
_ROUNDS = 20
_SETTLED = 1e-3
_RIDGE = 1e-9
_MISTAKE = 4.0  # times its bound: an error of eight or more standard deviations
_LIKELY = 0.2  # chance from which on bounds are kept: on real arms, rarer counts came back on other poses
_CHANCE = 0.01  # probability of calling normal errors long-tailed
_TAILS = 1.1 ** np.arange(1, 25)  # up to 10
_NOT_SHOWN = 0.5  # average number of directions per pose that may be missing to separate positions from orientations
_DIRECTIONS = np.stack([np.diag([1.0, 1.0, 1.0, 0.0, 0.0, 0.0]), np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])])


@dataclass(frozen=True, eq=False)
class Scatter:
    """Variances of otherwise unexplained tip errors."""

    #: a and b, variance of each direction of the tip-weighted error: positions and orientations, shape=(2,) [m^2]
    everywhere: Array = field(default_factory=lambda: np.zeros(2))
    #: d, variance of each drive's joint, shape=(drives,) [m^2, rad^2]; empty for none
    drives: Array = field(default_factory=lambda: np.zeros(0))
    tip_error: float = 0.0  #: size of both, root mean square over the poses used to estimate them [m]
    #: d is proportional to the square of these, shape=(drives,); and the covariance of a, b and that factor
    alike: Array = field(default_factory=lambda: np.zeros(0))
    uncertainty: Array = field(default_factory=lambda: np.zeros((3, 3)))
    #: 1 for components of the tip error that count, 0 for others: orientations that do not, shape=(6,)
    counted: Array = field(default_factory=lambda: np.ones(6))
    #: factor on the scatter in bounds; above 1 if fewer held-out poses than promised are within bounds without it
    tails: float = 1.0
    long_tailed: bool = False  #: whether chance hardly explains that: errors have longer tails than normal ones

    @classmethod
    def from_errors(
        cls,
        errors: Array,
        covariances: Array,
        shown: Array,
        control: Array,
        units: Sequence[str],
        *,
        counted: Mask | None = None,
        least: float = 0.0,
    ) -> Scatter:
        """Estimate the scatter in errors whose covariance is partly known.

        Args:
            errors: tip-weighted, shape=(n, 6) [m].
            covariances: their known part, K, shape=(n, 6, 6) [m^2].
            shown: projections on the directions they were seen in, shape=(n, 6, 6).
            control: tip-weighted motion of the tool by the drives' joints, shape=(n, 6, drives).
            units: of the drives' joints, "m" or "rad".
            counted: mask of the components of the tip error that count, shape=(6,); by default all.
            least: number of estimated standard errors below which a part is set to zero.
        """
        counting = np.ones(6) if counted is None else counted.astype(float)
        # a projection is of size 1, or nothing but rounding: where drives correct all, none is left
        shown = np.where(np.linalg.norm(shown, axis=(1, 2), keepdims=True) < SOLVED, 0.0, shown)
        unit = float(np.einsum("nii->", covariances)) / max(1.0, float(np.einsum("nii->", shown)))
        if not shown.any():
            return cls(counted=counting)
        squares, same = np.mean(np.sum(control**2, axis=1), axis=0), np.equal.outer(units, units)
        effects = np.sqrt((same @ squares) / same.sum(axis=1))  # by kind of drive, rms
        alike = np.where(effects > 0.0, 1.0 / np.maximum(effects, np.finfo(float).tiny), 0.0)
        by_drives = shown @ (control * alike)
        of_each = counting.reshape(2, 3).sum(axis=1)
        whole = of_each.all() and np.mean(np.einsum("nii->n", shown)) > of_each.sum() - _NOT_SHOWN
        directions = shown @ (_DIRECTIONS if whole else np.eye(6)[None])[:, None] @ shown
        parts = np.concatenate([directions, [by_drives @ np.swapaxes(by_drives, 1, 2)]])
        known, products = covariances / unit, errors[:, :, None] * errors[:, None, :] / unit
        kept, variances, uncertainty = list(range(len(parts))), np.zeros(len(parts)), np.zeros(0)
        while kept:
            found, covariance = _variances(products, known, shown, parts[kept])
            standard_errors = np.sqrt(np.diag(covariance))
            uncertainty = uncertainty if uncertainty.size else covariance
            weakest = int(np.argmin(found - least * standard_errors))
            if found[weakest] >= least * standard_errors[weakest]:
                variances[kept] = found
                break
            kept.pop(weakest)
        everywhere, drives = np.resize(unit * variances[:-1], 2), unit * float(variances[-1])
        tip_error = float(np.sqrt(everywhere @ of_each + drives * np.count_nonzero(alike)))
        places = [0, len(parts) - 2, len(parts) - 1]
        of_places = unit**2 * uncertainty[np.ix_(places, places)]
        return cls(everywhere, drives * alike**2, tip_error, alike, of_places, counting)

    def with_tails(self, errors: Array, covariances: Array, shown: Array, control: Array) -> Scatter:
        """Return the scatter with the factor in bounds that errors of held-out poses, outliers among them, ask for.

        Where more of them are beyond their bounds than is likely, the scatter is widened until as many are within as
        bounds promise. Errors several times their bounds are taken for mistakes of measuring, not of the machine.

        Args:
            errors: tip-weighted, shape=(n, 6) [m].
            covariances: their known part, K, shape=(n, 6, 6) [m^2].
            shown: projections on the directions they were seen in, shape=(n, 6, 6).
            control: tip-weighted motion of the tool by the drives' joints, shape=(n, 6, drives).
        """
        lengths, zeros = np.linalg.norm(errors, axis=1), np.zeros_like(errors)
        scatter = shown @ self.covariances(control) @ shown

        def bounds(tails: float) -> Array:
            return norm_quantiles(zeros, covariances + tails**2 * scatter, COVERAGE)

        usual = bounds(1.0)
        kept = lengths <= _MISTAKE * usual
        count, beyond = int(np.count_nonzero(kept)), int(np.count_nonzero(kept & (lengths > usual)))
        most = int((1.0 - COVERAGE) * (count + 1))  # a new pose is as likely in any place among these
        # the probability of as many or more if the bounds were right
        chance = float(scipy.special.bdtrc(beyond - 1, count, 1.0 - COVERAGE)) if beyond > most else 1.0
        if chance > _LIKELY:
            return self
        for tails in _TAILS:
            if np.count_nonzero(kept & (lengths > bounds(tails))) <= most:
                break
        return replace(self, tails=float(tails), long_tailed=chance < _CHANCE)

    def covariances(self, control: Array) -> Array:
        """Return the covariance of tip-weighted errors, shape=(n, 6, 6) [m^2].

        Args:
            control: tip-weighted motion of the tool by the drives' joints, shape=(n, 6, drives).
        """
        by_drives = (control * self.drives) @ np.swapaxes(control, 1, 2) if self.drives.size else 0.0
        return np.asarray(
            np.diag(np.repeat(self.everywhere, 3) * self.counted) + by_drives + np.zeros((len(control), 6, 6))
        )

    def mean_square_variance(self, gains: Array, control: Array) -> float:
        """Return the variance of the mean square of `gains` times the errors, due to the scatter's own uncertainty.

        Args:
            gains: shape=(n, k, 6).
            control: tip-weighted motion of the tool by the drives' joints, shape=(n, 6, drives).
        """
        counted = gains * self.counted
        parts = counted[:, :, :3], counted[:, :, 3:], gains @ (control * (self.alike if self.alike.size else 0.0))
        squares = np.array([np.sum(part**2) for part in parts]) / len(gains)
        return float(squares @ self.uncertainty @ squares)

    def rms_interval(
        self,
        fixed: Array,
        effects: Array,
        control: Array,
        gains: Array | None = None,
        *,
        beside: Array | float = 0.0,
        variance: float = 0.0,
    ) -> tuple[float, float]:
        """Return the interval that holds the root mean square with the probability :data:`COVERAGE`.

        Args:
            fixed: m, shape=(n, k).
            effects: E, effects of one standard deviation in each direction of the parameters, shape=(n, k, directions).
            control: tip-weighted motion of the tool by the drives' joints, which the scatter depends on, shape=(n, 6,
                drives).
            gains: G, shape=(n, k, 6); None for the tip-weighted error itself, k = 6.
            beside: covariance of other errors that are independent from pose to pose, shape=(n, 6, 6) [m^2].
            variance: of the mean square, due to anything else, such as the choice of the poses [m^4].
        """
        count = len(fixed)
        gains = np.broadcast_to(np.eye(6), (count, 6, 6)) if gains is None else gains
        flat, known = np.concatenate(effects) / np.sqrt(count), fixed.ravel() / np.sqrt(count)
        spread = self.covariances(control) + beside
        product, scattered = flat.T @ flat, np.einsum("nij,njk,nik->", gains, spread, gains) / count
        mean = float(known @ known + np.trace(product) + scattered)
        variance += 2.0 * np.sum(product**2) + 4.0 * np.sum((known @ flat) ** 2)
        variance += self.mean_square_variance(gains, control)
        freedom = 2.0 * mean**2 / float(variance)
        low, high = np.sqrt(2.0 * mean * scipy.special.gammaincinv(0.5 * freedom, _PROBABILITIES) / freedom).tolist()
        return low, high

    def excess_interval(self, effects: Array, control: Array) -> tuple[float, float] | None:
        """Return the interval of the commands' difference from the best ones, over poses and drives' joints [m, rad].

        None without directions, or near a singular pose, where commands can be far off and hardly move the tool.

        Args:
            effects: effects on the tip-weighted error, shape=(n, 6, directions) [m].
            control: tip-weighted motion by the drives' joints, shape=(n, 6, drives).
        """
        gains = control_inverse(control) / np.sqrt(control.shape[2])
        if not effects.size or np.linalg.matrix_rank(gains).min() < control.shape[2]:
            return None
        return self.rms_interval(np.zeros(gains.shape[:2]), gains @ effects, control, gains)


def _variances(products: Array, known: Array, shown: Array, parts: Array) -> tuple[Array, Array]:
    """Return the amount of each part in the products of errors beyond the known part, and its covariance."""
    hidden, variances = np.eye(6) - shown, np.zeros(len(parts))
    for _ in range(_ROUNDS):
        weights = shown @ np.linalg.inv(known + np.tensordot(variances, parts, 1) + hidden) @ shown
        weighted = parts @ weights
        information = np.einsum("anij,bnji->ab", weighted, weighted)
        information += _RIDGE * np.trace(information) * np.eye(len(parts))
        pull = np.einsum("anij,njk,nki->a", weighted, products - known, weights)
        factor = np.linalg.cholesky(information)
        last, variances = variances, scipy.optimize.nnls(factor.T, np.linalg.solve(factor, pull))[0]
        if np.abs(variances - last).max() <= _SETTLED * variances.max():
            break
    return variances, 2.0 * np.linalg.inv(information)
