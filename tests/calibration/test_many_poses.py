"""Learning from many poses: inducing points instead of a full covariance matrix."""

from __future__ import annotations

import numpy as np

from pm3dof_pin.calibration import gaussian_process
from pm3dof_pin.calibration.gaussian_process import GaussianProcess

NOISE = 1e-5


def _truth(inputs: np.ndarray) -> np.ndarray:
    smooth = np.sin(2.0 * inputs[:, 0]) + 0.5 * inputs[:, 1] * inputs[:, 2]
    return 1e-4 * np.stack([smooth + 0.1 * np.sin(20.0 * inputs[:, 0]), np.cos(inputs[:, 1])], axis=1)


def _learned(count: int) -> tuple[GaussianProcess, float, float]:
    """Return a process of `count` noisy values, its error at others, and that in units of the expected error."""
    rng = np.random.default_rng(0)
    inputs, others = rng.uniform(-1.0, 1.0, (count, 3)), rng.uniform(-1.0, 1.0, (500, 3))
    seen = _truth(inputs) + NOISE * rng.standard_normal((count, 2))
    process = GaussianProcess.fit(inputs, seen, np.full((count, 2), NOISE**2))
    errors = process.deviations(others) - _truth(others)
    return (
        process,
        float(np.sqrt(np.mean(errors**2))),
        float(np.sqrt(np.mean((errors / process.uncertainties(others)) ** 2))),
    )


def test_more_poses_are_better_and_the_process_knows() -> None:
    few, many = _learned(150), _learned(2000)
    assert many[1] < 0.6 * few[1]
    assert 0.6 < many[2] < 1.5


def test_inducing_points_lose_little() -> None:
    """Against the textbook's formula with all measurements (Rasmussen and Williams, 2006, eq. 2.25)."""
    process, _, _ = _learned(gaussian_process.EXACT_UP_TO + 100)
    others = np.random.default_rng(9).uniform(-0.9, 0.9, (100, 3))
    c, s, o, excess, *scales = np.exp(process.logarithms[1])

    def kernel(a: np.ndarray, b: np.ndarray) -> np.ndarray:
        ways = a[:, None] - b
        smooth = np.exp(-0.5 * np.sum((ways / scales[:-1]) ** 2, axis=2))
        own = np.exp(-0.5 * (ways[:, :, 1] / scales[-1]) ** 2)
        return np.asarray(c**2 * (1.0 + a @ b.T) + s**2 * smooth + o**2 * own)

    covariance = kernel(process.inputs, process.inputs) + (NOISE**2 + excess**2) * np.eye(len(process.inputs))
    exact = kernel(others, process.inputs) @ np.linalg.solve(covariance, process.targets[:, 1])
    assert np.abs(process.deviations(others)[:, 1] - exact).max() < 0.2 * NOISE


def test_a_process_comes_back_from_its_numbers() -> None:
    process, _, _ = _learned(gaussian_process.EXACT_UP_TO + 1)
    others = np.random.default_rng(9).uniform(-1.0, 1.0, (10, 3))
    again = GaussianProcess.from_data(process.as_data())
    np.testing.assert_array_equal(again.deviations(others), process.deviations(others))
