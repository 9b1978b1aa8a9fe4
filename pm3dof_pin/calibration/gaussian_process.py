"""Gaussian processes for joint deviations with known measurement noise; sparse ones for many poses.

C. Rasmussen and C. Williams, Gaussian Processes for Machine Learning (2006), chapters 2 and 5. For the deviation of
drive i, with scaled inputs x,

    k(x, x') = c^2 (1 + x.x') + s^2 exp(-sum_j (x_j - x_j')^2 / (2 l_j^2)) + o^2 exp(-(x_i - x_i')^2 / (2 m^2))

The first term models most geometric errors, the second bends it, the third models the screw or guideway of drive i.
The amplitudes are chosen by marginal likelihood; they fall to zero if there is nothing to learn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from pm3dof_pin.calibration.learned_model import LearnedModel
from pm3dof_pin.exceptions import ConvergenceError
from pm3dof_pin.typing import Array, Indices

_MIN_AMPLITUDE = 1e-4  # of the deviations' scale
_MAX_AMPLITUDE = 30.0
# Prior medians of the scales, whose logarithms have standard deviation _SCALE_SPREAD; inputs are in -1 .. 1.
_SMOOTH_SCALE, _OWN_SCALE = 2.5, 0.25
_SCALE_SPREAD = 0.4
_STARTS = ((0.5, 0.5, 0.1), (0.05, 0.05, 0.3))  # c, s, o over the deviations' scale
_JITTER = 1e-10
EXACT_UP_TO = 300
"""Above this number of poses, inducing points represent them, and the time grows linearly."""
_INDUCING = 200
_FORETOLD = 0.9  # greatest fraction of the squared deviations not predicted by the others
_SPARSE_JITTER = 1e-9
_UNSEEN_SCALE = 1e-6  # [m, rad], for a drive that no measurement shows: its deviations are 0


@dataclass(frozen=True, eq=False)
class GaussianProcess(LearnedModel):
    """One process for each drive."""

    kind = "gaussian process"

    inputs: Array  #: of the measurements, shape=(n, number of inputs)
    targets: Array  #: their du, shape=(n, number of commands) [m, rad]
    noise: Array  #: noise variance of each du, shape=(n, number of commands) [m^2, rad^2]
    #: of c, s, o, excess noise [m, rad], l_1 ... l_k, m, for each drive, shape=(number of commands, k + 5)
    logarithms: Array

    @cached_property
    def _processes(self) -> list[_Exact | _Sparse]:
        chosen = _spread(self.inputs)
        kind = _Exact if len(chosen) == len(self.inputs) else _Sparse
        return [
            kind(self.inputs, self.targets[:, drive], self.noise[:, drive], parameters, drive, chosen)
            for drive, parameters in enumerate(self.logarithms)
        ]

    @classmethod
    def fit(
        cls, inputs: Array, deviations: Array, noise: Array, similar: GaussianProcess | None = None
    ) -> GaussianProcess:
        """Choose the kernels by marginal likelihood, given deviations du and their noise variance, shape=(n, commands).

        The search starts from the kernels of `similar`, of most of the same measurements, where these are given.

        Raises:
            ConvergenceError: no kernel was found.
        """
        some = _spread(inputs)
        chosen = [
            _most_likely(
                _Kernel(inputs[some], drive),
                deviations[some, drive],
                noise[some, drive],
                None if similar is None else similar.logarithms[drive],
            )
            for drive in range(deviations.shape[1])
        ]
        return cls(inputs, deviations, noise, np.array(chosen))

    @staticmethod
    def typical_covariance(first: Array, second: Array, drive: int) -> Array:
        """Return the prior covariance of a drive's deviations at scaled inputs, shape=(n, m).

        This is the kernel with the initial amplitudes and scales of the fit, in units of the deviations' variance.
        """
        scales = [*[_SMOOTH_SCALE] * first.shape[1], _OWN_SCALE]
        return _kernel_between(first, second, drive, np.log([*_STARTS[0], 1.0, *scales]))

    @staticmethod
    def typical_variance(inputs: Array) -> Array:
        """Return the diagonal of :meth:`typical_covariance` at the same inputs, shape=(n,)."""
        return _own_variance(inputs, np.log(_STARTS[0]))

    def deviations(self, inputs: Array) -> Array:
        """Return the mean of du, shape=(n, number of commands) [m, rad]."""
        return np.stack([process.mean(inputs) for process in self._processes], axis=1)

    def uncertainties(self, inputs: Array) -> Array:
        """Return the standard deviation of du, shape=(n, number of commands) [m, rad]."""
        variances = np.stack([process.variance(inputs) for process in self._processes], axis=1)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))


class _Exact:
    """The process of one drive, given all its measurements."""

    def __init__(
        self, inputs: Array, targets: Array, noise: Array, parameters: Array, drive: int, chosen: Indices
    ) -> None:
        self._inputs, self._parameters, self._drive = inputs[chosen], parameters, drive
        covariance = _Kernel(inputs, drive).value(parameters) + np.diag(_noise(noise, parameters))
        self._factor = scipy.linalg.cholesky(covariance, lower=True)
        self._weights = scipy.linalg.cho_solve((self._factor, True), targets)

    def mean(self, inputs: Array) -> Array:
        return np.asarray(_kernel_between(inputs, self._inputs, self._drive, self._parameters) @ self._weights)

    def variance(self, inputs: Array) -> Array:
        return np.asarray(_own_variance(inputs, self._parameters) - np.sum(self._explained(inputs) ** 2, axis=0))

    def _explained(self, inputs: Array) -> Array:
        across = _kernel_between(inputs, self._inputs, self._drive, self._parameters)
        return np.asarray(scipy.linalg.solve_triangular(self._factor, across.T, lower=True))


class _Sparse(_Exact):
    """The process of one drive, given many measurements through a few inducing points.

    The measurements are independent of each other given the process at the inducing points (E. Snelson and
    Z. Ghahramani, Sparse Gaussian processes using pseudo-inputs, 2006), which are spread over the inputs.
    """

    def __init__(
        self, inputs: Array, targets: Array, noise: Array, parameters: Array, drive: int, chosen: Indices
    ) -> None:
        self._inputs, self._parameters, self._drive = inputs[chosen], parameters, drive
        covariance = _Kernel(self._inputs, drive).value(parameters)
        jitter = _SPARSE_JITTER * np.trace(covariance) / len(chosen)
        self._factor = scipy.linalg.cholesky(covariance + jitter * np.eye(len(chosen)), lower=True)
        across = _kernel_between(self._inputs, inputs, drive, parameters)
        explained = scipy.linalg.solve_triangular(self._factor, across, lower=True)
        own = np.maximum(_own_variance(inputs, parameters) - np.sum(explained**2, axis=0), 0.0)
        scaled = explained / np.sqrt(own + _noise(noise, parameters))
        self._known = scipy.linalg.cholesky(np.eye(len(chosen)) + scaled @ scaled.T, lower=True)
        pull = scipy.linalg.cho_solve(
            (self._known, True), scaled @ (targets / np.sqrt(own + _noise(noise, parameters)))
        )
        self._weights = scipy.linalg.solve_triangular(self._factor, pull, lower=True, trans="T")

    def variance(self, inputs: Array) -> Array:
        explained = self._explained(inputs)
        open_part = scipy.linalg.solve_triangular(self._known, explained, lower=True)
        squares = np.sum(explained**2, axis=0) - np.sum(open_part**2, axis=0)
        return np.asarray(_own_variance(inputs, self._parameters) - squares)


def _spread(inputs: Array) -> Indices:
    """Return all rows if they are few, otherwise the inducing points: each the farthest from those before it."""
    if len(inputs) <= EXACT_UP_TO:
        return np.arange(len(inputs))
    chosen = [int(np.argmin(np.sum((inputs - inputs.mean(axis=0)) ** 2, axis=1)))]
    nearest = np.full(len(inputs), np.inf)
    for _ in range(_INDUCING - 1):
        nearest = np.minimum(nearest, np.sum((inputs - inputs[chosen[-1]]) ** 2, axis=1))
        chosen.append(int(np.argmax(nearest)))
    return np.array(chosen)


class _Kernel:
    """The kernel over one set of inputs, with derivatives with respect to the logarithms."""

    def __init__(self, inputs: Array, drive: int) -> None:
        self._inputs = inputs
        self._products = 1.0 + inputs @ inputs.T
        self._own_squares = (inputs[:, None, drive] - inputs[:, drive]) ** 2
        self.count = inputs.shape[1]

    def value(self, logarithms: Array) -> Array:
        return np.asarray(sum(self.parts(logarithms)))

    def parts(self, logarithms: Array) -> tuple[Array, Array, Array]:
        c, s, o, _, *scales = np.exp(logarithms)
        scaled = self._inputs / scales[:-1]
        smooth: Array = scaled @ scaled.T
        half_squares = 0.5 * np.diag(smooth)
        smooth = np.exp(smooth - half_squares[:, None] - half_squares)
        own = np.exp(self._own_squares * (-0.5 / scales[-1] ** 2))
        return c**2 * self._products, s**2 * smooth, o**2 * own

    def slopes(self, inner: Array, parts: tuple[Array, Array, Array], logarithms: Array) -> Array:
        """Return the sums of symmetric `inner` times the derivatives by all logarithms except the noise's, in order."""
        linear, smooth, own = (inner * part for part in parts)
        squared = np.exp(2.0 * logarithms[4:])
        # sum_ab k_ab (x_a - x_b)^2 = 2 sum_a x_a (sum_b k_ab x_a - sum_b k_ab x_b)
        apart = smooth.sum(axis=1)[:, None] * self._inputs - smooth @ self._inputs
        by_scales = 2.0 * np.sum(self._inputs * apart, axis=0) / squared[:-1]
        by_own = np.vdot(own, self._own_squares) / squared[-1]
        return np.array([2.0 * linear.sum(), 2.0 * smooth.sum(), 2.0 * own.sum(), *by_scales, by_own])


def _kernel_between(first: Array, second: Array, drive: int, logarithms: Array) -> Array:
    c, s, o, _, *scales = np.exp(logarithms)
    a, b = first / scales[:-1], second / scales[:-1]
    smooth: Array = a @ b.T
    smooth -= 0.5 * np.sum(a**2, axis=1)[:, None]
    smooth -= 0.5 * np.sum(b**2, axis=1)
    np.exp(smooth, out=smooth)
    smooth *= s**2
    own: Array = first[:, None, drive] / scales[-1] - second[:, drive] / scales[-1]
    own *= own
    own *= -0.5
    np.exp(own, out=own)
    own *= o**2
    smooth += own
    smooth += (c**2 * first) @ second.T
    smooth += c**2
    return smooth


def _own_variance(inputs: Array, logarithms: Array) -> Array:
    c, s, o = np.exp(logarithms[:3])
    return np.asarray(c**2 * (1.0 + np.sum(inputs**2, axis=1)) + s**2 + o**2)


def _noise(variances: Array, logarithms: Array) -> Array:
    excess = np.exp(2.0 * logarithms[3])
    return np.asarray(variances + excess + _JITTER * variances.mean())


def _most_likely(kernel: _Kernel, deviations: Array, noise: Array, near: Array | None) -> Array:
    """Return the logarithms of greatest posterior probability, sought near given ones if there are any."""
    scale = float(np.sqrt(np.mean(deviations**2) + np.mean(noise))) or _UNSEEN_SCALE
    lengths = np.log([*[_SMOOTH_SCALE] * kernel.count, _OWN_SCALE])
    floor = np.log(_MIN_AMPLITUDE * scale)
    bounds = [(floor, np.log(_MAX_AMPLITUDE * scale))] * 3 + [(floor, np.log(3.0 * scale))]
    bounds += [(length - 3.0, length + 3.0) for length in lengths]

    def cost(logarithms: Array) -> tuple[float, Array]:
        parts = kernel.parts(logarithms)
        factor = np.linalg.cholesky(sum(parts) + np.diag(_noise(noise, logarithms)))
        half = scipy.linalg.lapack.dtrtri(factor, lower=1)[0]
        inverse = half.T @ half
        weights = half.T @ (half @ deviations)
        value = 0.5 * deviations @ weights + np.log(np.diag(factor)).sum()
        inner = inverse - np.outer(weights, weights)
        by_noise = np.trace(inner) * np.exp(2.0 * logarithms[3])
        slopes = 0.5 * kernel.slopes(inner, parts, logarithms)
        gradient = np.concatenate([slopes[:3], [by_noise], slopes[3:]])
        off = (logarithms[4:] - lengths) / _SCALE_SPREAD
        gradient[4:] += off / _SCALE_SPREAD
        return float(value + 0.5 * off @ off), gradient

    starts = [np.concatenate([np.log([*amplitudes, 0.1]) + np.log(scale), lengths]) for amplitudes in _STARTS]
    best, least = None, np.inf
    for start in starts if near is None else [np.clip(near, *np.transpose(bounds))]:
        found = scipy.optimize.minimize(cost, start, jac=True, method="L-BFGS-B", bounds=bounds)
        if found.fun < least:
            best, least = found.x, float(found.fun)
    if best is None:
        raise ConvergenceError("choosing the kernel of a Gaussian process", least, "in likelihood", 0)
    if not _foretells(kernel, best, deviations, noise):
        best[:3] = floor  # learn nothing rather than a deviation that the others do not support
    return np.asarray(best)


def _foretells(kernel: _Kernel, logarithms: Array, deviations: Array, noise: Array) -> bool:
    """Tell whether predicting each deviation from the others beats predicting zero, overall.

    Leaving one out at a time, in closed form (Rasmussen and Williams, 2006, eq. 5.12), weighted by their noise.
    """
    variances = _noise(noise, logarithms)
    inverse = np.linalg.inv(kernel.value(logarithms) + np.diag(variances))
    missed = inverse @ deviations / np.diag(inverse)
    return bool(np.sum(missed**2 / variances) < _FORETOLD * np.sum(deviations**2 / variances))
