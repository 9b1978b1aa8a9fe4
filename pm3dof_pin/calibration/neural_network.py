"""Neural networks for joint deviations, as the chapter proposes.

The mean of a few small networks with one hidden layer. Cross-validation chooses their smoothness and decides
whether they are used: they must beat no correction by more than one standard error.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import scipy
from numpy.typing import NDArray

from pm3dof_pin.calibration.learned_model import LearnedModel
from pm3dof_pin.typing import Array

_HIDDEN = 10
_MEMBERS = 5
_FOLDS = 5
_DECAYS = (1e-3, 1e-2, 1e-1, 1.0)
_MAX_STEPS = 400
_SLOPE = 1e-4  # gradient of the cost at which training ends


@dataclass(frozen=True, eq=False)
class NeuralNetwork(LearnedModel):
    """The mean of several networks, du = scale part mean(W2 tanh(W1 x + b1) + b2)."""

    kind = "neural network"

    hidden_weights: Array  #: W1 of each network, shape=(networks, number of inputs, hidden)
    hidden_biases: Array  #: b1, shape=(networks, hidden)
    output_weights: Array  #: W2, shape=(networks, hidden, number of commands)
    output_biases: Array  #: b2, shape=(networks, number of commands)
    scale: Array  #: scale of each deviation, shape=(number of commands,) [m, rad]
    #: fraction of the networks' answer that is used, shape=(number of commands,); 0 if no better than no correction
    part: Array
    sigmas: Array  #: error in cross-validation, measurement noise included, shape=(number of commands,) [m, rad]

    @classmethod
    def fit(cls, inputs: Array, deviations: Array, seed: int) -> NeuralNetwork:
        """Train networks on deviations du, shape=(n, commands) [m, rad], with a seed for weights and folds."""
        scale = np.sqrt(np.mean(deviations**2, axis=0))
        scale = np.where(scale > 0.0, scale, 1.0)
        targets = deviations / scale
        folds = np.random.default_rng(seed).permutation(np.arange(len(inputs)) % min(_FOLDS, len(inputs)))
        predicted = {decay: _cross_validated(inputs, targets, folds, decay, seed) for decay in _DECAYS}
        decay = min(_DECAYS, key=lambda value: float(np.sum((targets - predicted[value]) ** 2)))
        part = _worthwhile_part(targets, predicted[decay])
        sigmas = scale * np.sqrt(np.mean((targets - part * predicted[decay]) ** 2, axis=0))
        members = [_train(inputs, targets, decay, seed + member) for member in range(_MEMBERS)]
        hidden, hidden_bias, output, output_bias = (np.stack(arrays) for arrays in zip(*members, strict=True))
        return cls(hidden, hidden_bias, output, output_bias, scale, part, sigmas)

    def deviations(self, inputs: Array) -> Array:
        """Return du, shape=(n, number of commands) [m, rad]."""
        members = zip(self.hidden_weights, self.hidden_biases, self.output_weights, self.output_biases, strict=True)
        return np.asarray(self.scale * self.part * np.mean([_answer(inputs, member) for member in members], axis=0))

    def uncertainties(self, inputs: Array) -> Array:
        """Return the error in cross-validation, shape=(n, number of commands) [m, rad]."""
        return np.tile(self.sigmas, (len(inputs), 1))


_Weights = tuple[Array, Array, Array, Array]


def _answer(inputs: Array, weights: _Weights) -> Array:
    hidden, hidden_bias, output, output_bias = weights
    return np.asarray(np.tanh(inputs @ hidden + hidden_bias) @ output + output_bias)


def _cross_validated(inputs: Array, targets: Array, folds: NDArray[np.int_], decay: float, seed: int) -> Array:
    """Return the networks' predictions of held-out measurements, shape=(n, number of commands)."""
    predicted = np.zeros_like(targets)
    for fold in range(int(folds.max()) + 1):
        shown = folds != fold
        if shown.any():
            predicted[~shown] = _answer(inputs[~shown], _train(inputs[shown], targets[shown], decay, seed))
    return predicted


def _worthwhile_part(targets: Array, predicted: Array) -> Array:
    """Return the fraction of a prediction that reduces the error most; 0 unless by more than a standard error."""
    squares = np.sum(predicted**2, axis=0)
    part = np.clip(np.sum(targets * predicted, axis=0) / np.where(squares > 0.0, squares, 1.0), 0.0, 1.0)
    gains = targets**2 - (targets - part * predicted) ** 2
    error = np.std(gains, axis=0) / np.sqrt(max(len(targets) - 1, 1))
    return np.where(gains.mean(axis=0) > error, part, 0.0)


def _train(inputs: Array, targets: Array, decay: float, seed: int) -> _Weights:
    """Minimise squared errors plus `decay` times squared weights, initialised after Glorot and Bengio (2010)."""
    shapes = (inputs.shape[1], _HIDDEN), (_HIDDEN,), (_HIDDEN, targets.shape[1]), (targets.shape[1],)
    ends = np.cumsum([math.prod(shape) for shape in shapes])
    parts = [(slice(end - math.prod(shape), end), shape) for end, shape in zip(ends, shapes, strict=True)]
    weighed = np.repeat([decay, 0.0, decay, 0.0], np.diff(ends, prepend=0))  # no decay of biases
    ones = np.ones(len(inputs))

    def split(numbers: Array) -> list[Array]:
        return [numbers[part].reshape(shape) for part, shape in parts]

    def cost(numbers: Array) -> tuple[float, Array]:
        hidden, hidden_bias, output, output_bias = split(numbers)
        activity = np.tanh(inputs @ hidden + hidden_bias)
        error = activity @ output + output_bias - targets
        back = (error @ output.T) * (1.0 - activity * activity)
        pull = weighed * numbers
        slopes = ((inputs.T @ back).ravel(), ones @ back, (activity.T @ error).ravel(), ones @ error)
        gradient = (np.concatenate(slopes) + pull) / len(inputs)
        return float(np.vdot(error, error) + pull @ numbers) / (2.0 * len(inputs)), gradient

    bounds = [math.sqrt(6.0 / sum(shapes[layer])) for layer in (0, 0, 2, 2)]
    start = np.random.default_rng(seed).uniform(-1.0, 1.0, ends[-1]) * np.repeat(bounds, np.diff(ends, prepend=0))
    # stopping early only makes the network smoother, and cross-validation judges the result
    found = scipy.optimize.minimize(
        cost, start, jac=True, method="L-BFGS-B", options={"maxiter": _MAX_STEPS, "gtol": _SLOPE}
    )
    hidden, hidden_bias, output, output_bias = split(found.x)
    return hidden, hidden_bias, output, output_bias
