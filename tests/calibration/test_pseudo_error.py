"""Pseudo-errors and the methods that learn them."""

from __future__ import annotations

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import multivariate_normal

from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.gaussian_process import GaussianProcess
from pm3dof_pin.calibration.learned_part import InputScale
from pm3dof_pin.calibration.neural_network import NeuralNetwork
from pm3dof_pin.calibration.pseudo_error import pseudo_errors, seen_errors
from pm3dof_pin.errors.command_correction import _damped, command_jacobians, nearest_poses
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements

NOISE = 5e-6


def smooth(inputs: np.ndarray) -> np.ndarray:
    """Three deviations of 50 to 100 um, bent like those of geometric errors."""
    x, y, z = inputs.T
    columns = [60.0 + 40.0 * x - 20.0 * y * z, -30.0 + 50.0 * y**2 + 10.0 * x, 20.0 * z - 40.0 * np.sin(1.5 * x)]
    return 1e-6 * np.stack(columns, axis=1)


@pytest.fixture(scope="module")
def samples() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    generator = np.random.default_rng(1)
    inputs = generator.uniform(-1.0, 1.0, (160, 3))
    return inputs[:60], smooth(inputs[:60]) + NOISE * generator.standard_normal((60, 3)), inputs[60:]


def test_motions_by_the_commands_are_computed_once_for_the_same_poses(tripod_nominal: Poses) -> None:
    few = tripod_nominal[:3]
    found = command_jacobians(few)
    assert command_jacobians(few) is found
    np.testing.assert_allclose(command_jacobians(tripod_nominal)[:3], found, rtol=1e-9, atol=1e-12)
    assert command_jacobians(tripod_nominal[3:6]) is not found


def test_a_deviation_of_the_joints_is_found_again(tripod_nominal: Poses) -> None:
    """A machine whose only errors are its commands has that pseudo-error, to rounding."""
    poses = tripod_nominal[:20]
    deviations = np.random.default_rng(0).normal(0.0, 2e-4, (20, 3))
    reached = poses.robot.forward(poses.commands + deviations, guess=poses.q)
    found = pseudo_errors(Measurements.from_poses(poses.commands, reached.transforms), poses)
    np.testing.assert_allclose(found.deviations, deviations, atol=1e-12)
    assert np.abs(found.left).max() < 1e-12


def test_positions_show_the_height_and_nothing_else(tripod_nominal: Poses) -> None:
    """The tool point is in the universal joint: tilts rotate it in place, and get no deviations."""
    poses = tripod_nominal[:20]
    moved = np.array(poses.transforms)
    moved[:, :3, 3] += [2e-4, -1e-4, 3e-4]
    found = pseudo_errors(Measurements.from_poses(poses.commands, moved, Instrument("position")), poses)
    np.testing.assert_allclose(found.left, np.tile([2e-4, -1e-4, 0.0, 0.0, 0.0, 0.0], (20, 1)), atol=1e-9)
    assert np.abs(found.deviations).max() < 1e-3


def test_steps_near_a_singularity_lead_nowhere_else(serial_arm: Robot) -> None:
    """Some of 400 random poses of an arm are so near a singularity that full Newton steps would diverge."""
    errors = GeometricErrors(serial_arm)
    generator = np.random.default_rng(3)
    nominal = serial_arm.forward(generator.uniform(-np.pi, np.pi, (400, 6)))
    machine = errors.apply(errors.sample(generator))
    wanted = machine.forward(nominal.commands, guess=nominal.q).transforms
    before = tip_error(pose_difference(wanted, nominal.transforms))
    nearest = nearest_poses(nominal, wanted)
    after = tip_error(pose_difference(wanted, nearest.transforms))
    assert np.all(after <= before)
    assert np.median(after) < 1e-12
    assert np.abs(nearest.commands - nominal.commands).max() < 1.0


def test_the_nearest_poses_near_singularities_are_least_squares(serial_arm: Robot) -> None:
    """Where most is left, SciPy finds nothing nearer, started there and at the nominal commands."""
    model = serial_arm.model.copy()
    model.lowerPositionLimit, model.upperPositionLimit = np.full(6, -20.0), np.full(6, 20.0)
    arm = Robot(model, tool_frame="tool0")
    errors, generator = GeometricErrors(arm), np.random.default_rng(3)
    nominal = arm.forward(generator.uniform(-np.pi, np.pi, (400, 6)))
    wanted = errors.apply(10.0 * errors.sample(generator)).forward(nominal.commands, guess=nominal.q).transforms
    nearest = nearest_poses(nominal, wanted)
    after = tip_error(pose_difference(wanted, nearest.transforms))
    weights = np.repeat([1e3, 1e2], 3)
    for k in np.argsort(after)[-12:].tolist():

        def missed(commands: np.ndarray, k: int = k) -> np.ndarray:
            return np.asarray(pose_difference(wanted[k], arm.forward(commands).transforms) * weights)

        starts = nearest.commands[k], nominal.commands[k]
        found = [least_squares(missed, start, xtol=1e-12, ftol=1e-12, gtol=1e-12, max_nfev=100) for start in starts]
        best = min(found, key=lambda result: float(result.cost))
        assert after[k] < 1e-3 * np.sqrt(2.0 * best.cost) + 1e-6, k


def test_damped_steps_break_no_limit(serial_arm: Robot) -> None:
    """Unlike the best commands of some of these poses."""
    errors, generator = GeometricErrors(serial_arm), np.random.default_rng(3)
    nominal = serial_arm.forward(generator.uniform(-np.pi, np.pi, (400, 6)))
    wanted = errors.apply(10.0 * errors.sample(generator)).forward(nominal.commands, guess=nominal.q).transforms
    everywhere = np.ones(len(nominal), dtype=bool)
    assert _damped(nominal, everywhere, wanted, 0.1).within_limits.all()
    assert not _damped(nominal, ~everywhere, wanted, 0.1).within_limits.all()


@pytest.mark.parametrize("eta", [0.02, 0.1, 0.5])
def test_no_other_deviation_comes_nearer(eta: float, tripod_nominal: Poses) -> None:
    """In the tip-weighted sense, compared with commands a micrometre off."""
    poses, generator = tripod_nominal[:10], np.random.default_rng(0)
    moved = np.array(poses.transforms)
    moved[:, :3, 3] += generator.normal(0.0, 1e-4, (10, 3))
    moved[:, :3, :3] = Rotation.from_rotvec(generator.normal(0.0, 1e-3, (10, 3))).as_matrix() @ moved[:, :3, :3]
    best = poses.commands + pseudo_errors(Measurements.from_poses(poses.commands, moved), poses, eta).deviations
    np.testing.assert_allclose(nearest_poses(poses, moved, eta).commands, best, atol=1e-9)

    def distance(commands: np.ndarray) -> np.ndarray:
        reached = poses.robot.forward(commands, guess=poses.q).transforms
        return tip_error(pose_difference(moved, reached), eta)

    least = distance(best)
    for step in 1e-6 * np.concatenate([np.eye(3), -np.eye(3)]):
        assert np.all(distance(best + step) > least)


def test_the_noise_of_a_deviation_is_that_of_the_measurement(tripod_nominal: Poses) -> None:
    """Against 2000 noisy measurements of one pose."""
    pose, generator = tripod_nominal[:1], np.random.default_rng(0)
    commands = np.repeat(pose.commands, 2000, axis=0)
    nominal = Poses(pose.robot, np.repeat(pose.q, 2000, axis=0))
    sigmas = Instrument().sigmas
    noise = generator.standard_normal((2000, 6)) * sigmas
    seen = np.array(nominal.transforms)
    seen[:, :3, 3] += noise[:, :3]
    seen[:, :3, :3] = Rotation.from_rotvec(noise[:, 3:]).as_matrix() @ seen[:, :3, :3]
    found = pseudo_errors(Measurements.from_poses(commands, seen), nominal)
    spread = np.cov(found.deviations.T)
    np.testing.assert_allclose(spread, found.covariances[0], atol=0.1 * np.abs(spread).max())


def test_inputs_are_scaled_by_the_limits(tripod_nominal: Poses) -> None:
    """The stroke is 85 mm to either side; temperatures are scaled by the measured range."""
    measurements = Measurements.from_poses(tripod_nominal.commands[:3], tripod_nominal.transforms[:3])
    conditions = {"temperature_a_K": np.array([2.0, 4.0, 6.0]), "load_z_N": np.full(3, 7.0)}
    scale = InputScale.from_measurements(tripod_nominal.robot, replace(measurements, conditions=conditions))
    assert scale.conditions == ("temperature_a_K",)
    assert scale.middle() == {"temperature_a_K": 4.0}
    scaled = scale.scaled(0.240272 + np.array([[0.085, 0.0, -0.085]]), {"temperature_a_K": 6.0})
    np.testing.assert_allclose(scaled, [[1.0, 0.0, -1.0, 1.0]], atol=1e-12)
    with pytest.raises(InvalidValueError, match="temperature_a_K among them"):
        scale.scaled(measurements.commands, {})


def test_a_gaussian_process_learns_a_smooth_function(samples: tuple[np.ndarray, ...]) -> None:
    inputs, deviations, others = samples
    process = GaussianProcess.fit(inputs, deviations, np.full((60, 3), NOISE**2))
    errors = process.deviations(others) - smooth(others)
    assert np.sqrt(np.mean(errors**2)) < 0.7 * NOISE
    score = errors / process.uncertainties(others)
    assert np.sqrt(np.mean(score**2)) == pytest.approx(1.0, abs=0.35)


def test_a_process_of_most_of_the_measurements_is_found_from_that_of_all(
    samples: tuple[np.ndarray, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The same kernels as from the usual starts, in less than half the evaluations."""
    inputs, deviations, others = samples
    noise = np.full((60, 3), NOISE**2)
    whole = GaussianProcess.fit(inputs, deviations, noise)
    evaluations, minimize = [0], scipy.optimize.minimize

    def counted(*arguments: Any, **options: Any) -> Any:
        found = minimize(*arguments, **options)
        evaluations[-1] += found.nfev
        return found

    monkeypatch.setattr(scipy.optimize, "minimize", counted)
    alone = GaussianProcess.fit(inputs[:48], deviations[:48], noise[:48])
    evaluations.append(0)
    near = GaussianProcess.fit(inputs[:48], deviations[:48], noise[:48], whole)
    np.testing.assert_allclose(near.deviations(others), alone.deviations(others), atol=0.01 * NOISE)
    np.testing.assert_allclose(near.uncertainties(others), alone.uncertainties(others), rtol=0.01)
    assert 2 * evaluations[1] < evaluations[0]


def test_a_gaussian_process_is_the_conditional_of_a_normal_law() -> None:
    """Mean and deviation from the joint covariance of ten measurements and one more, by its definition."""
    generator = np.random.default_rng(0)
    x = generator.uniform(-1.0, 1.0, (11, 2))
    c, s, o, excess, lengths, own = 2e-5, 3e-5, 1e-5, 4e-6, np.array([0.7, 1.3]), 0.3
    logarithms = np.log([[c, s, o, excess, *lengths, own]])
    joint = np.empty((11, 11))
    for i in range(11):
        for j in range(11):
            d = x[i] - x[j]
            joint[i, j] = c**2 * (1.0 + x[i] @ x[j]) + s**2 * np.exp(-0.5 * np.sum((d / lengths) ** 2))
            joint[i, j] += o**2 * np.exp(-0.5 * (d[0] / own) ** 2)
    noisy = joint[:10, :10] + (excess**2 + NOISE**2) * np.eye(10)
    y = multivariate_normal(np.zeros(10), noisy, seed=1).rvs()
    process = GaussianProcess(x[:10], y[:, None], np.full((10, 1), NOISE**2), logarithms)
    gain = np.linalg.solve(noisy, joint[:10, 10])
    np.testing.assert_allclose(process.deviations(x[10:])[0, 0], gain @ y, rtol=1e-6)
    variance = joint[10, 10] - gain @ joint[:10, 10]
    np.testing.assert_allclose(process.uncertainties(x[10:])[0, 0], np.sqrt(variance), rtol=1e-6)


@pytest.fixture(scope="module")
def network(samples: tuple[np.ndarray, ...]) -> NeuralNetwork:
    """With the usual training."""
    inputs, deviations, _ = samples
    return NeuralNetwork.fit(inputs, deviations, seed=0)


def test_a_network_learns_a_smooth_function(samples: tuple[np.ndarray, ...], network: NeuralNetwork) -> None:
    _, _, others = samples
    errors = network.deviations(others) - smooth(others)
    assert np.sqrt(np.mean(errors**2)) < 1.5 * NOISE
    assert np.all(network.uncertainties(others) > 0.5 * NOISE)


def test_numpy_answers_as_scikit_learn_does(samples: tuple[np.ndarray, ...], network: NeuralNetwork) -> None:
    """One member of the networks, by scikit-learn's own evaluation."""
    neural_network = pytest.importorskip("sklearn.neural_network")
    inputs, deviations, others = samples
    model = neural_network.MLPRegressor(hidden_layer_sizes=(10,), activation="tanh", max_iter=1, solver="sgd")
    with pytest.warns(UserWarning, match="Maximum iterations"):
        model.fit(inputs, deviations)
    total = np.zeros((len(others), 3))
    for k in range(len(network.hidden_weights)):
        model.coefs_ = [network.hidden_weights[k], network.output_weights[k]]
        model.intercepts_ = [network.hidden_biases[k], network.output_biases[k]]
        total += model.predict(others) / len(network.hidden_weights)
    np.testing.assert_allclose(network.deviations(others), total * network.scale * network.part, rtol=1e-10)


@pytest.mark.usefixtures("small_networks")
@pytest.mark.parametrize("kind", [GaussianProcess, NeuralNetwork])
def test_where_there_is_only_noise_nothing_is_learned(kind: type, samples: tuple[np.ndarray, ...]) -> None:
    inputs, _, others = samples
    sizes = []
    for seed in range(3):
        noise = NOISE * np.random.default_rng(seed).standard_normal((60, 3))
        model = (
            NeuralNetwork.fit(inputs, noise, seed)
            if kind is NeuralNetwork
            else GaussianProcess.fit(inputs, noise, np.full((60, 3), NOISE**2))
        )
        sizes.append(np.sqrt(np.mean(model.deviations(others) ** 2)))
    assert np.median(sizes) < 0.2 * NOISE
    assert max(sizes) < 0.6 * NOISE


@pytest.mark.usefixtures("small_networks")
@pytest.mark.parametrize("kind", [GaussianProcess, NeuralNetwork])
def test_stored_models_answer_the_same(kind: type, samples: tuple[np.ndarray, ...]) -> None:
    inputs, deviations, others = samples
    if kind is NeuralNetwork:
        first, second = (NeuralNetwork.fit(inputs, deviations, 7) for _ in range(2))
    else:
        first, second = (GaussianProcess.fit(inputs, deviations, np.full((60, 3), NOISE**2)) for _ in range(2))
    text = json.dumps(first.as_data())
    assert text == json.dumps(second.as_data())
    again = kind.from_data(json.loads(text))
    np.testing.assert_array_equal(again.deviations(others), first.deviations(others))
    np.testing.assert_array_equal(again.uncertainties(others), first.uncertainties(others))


def test_a_drive_that_no_measurement_shows_stays_where_it_is(
    samples: tuple[np.ndarray, np.ndarray, np.ndarray],
) -> None:
    """A gripper does not move the tool: its deviations and their noise are exact zeros."""
    inputs, deviations, others = samples
    idle, noise = deviations.copy(), np.full_like(deviations, NOISE**2)
    idle[:, 1], noise[:, 1] = 0.0, 0.0
    process = GaussianProcess.fit(inputs, idle, noise)
    assert np.abs(process.deviations(others)[:, 1]).max() < 1e-15
    assert process.uncertainties(others)[:, 1].max() < 1e-8
    assert np.sqrt(np.mean((process.deviations(others) - smooth(others))[:, [0, 2]] ** 2)) < NOISE


def test_conditions_beyond_those_measured_are_told() -> None:
    scale = InputScale(("temperature_screws_K", "load_tool_N"), np.array([0.0, 4.0, 25.0]), np.array([1.0, 4.0, 25.0]))
    assert scale.beyond({"temperature_screws_K": 8.0, "load_tool_N": 0.0}) == {}
    assert scale.beyond({"temperature_screws_K": 293.0}) == {"temperature_screws_K": (0.0, 8.0)}


def test_poses_that_are_no_numbers_are_infinitely_wrong(tripod_nominal: Poses) -> None:
    """So that a step there is shortened: eigenvalues of NaN are a LAPACK error."""
    poses = tripod_nominal[:3]
    measurements = Measurements.from_poses(poses.commands, poses.transforms)
    q = np.array(poses.q)
    q[1] = np.nan
    errors = seen_errors(measurements, poses.robot.at(q)).errors
    assert np.isinf(errors[1]).all()
    np.testing.assert_allclose(errors[[0, 2]], 0.0, atol=1e-12)


@pytest.mark.usefixtures("few_folds")
@pytest.mark.parametrize("count", [1, 2, 3])
def test_three_targets_at_every_pose_show_it_wholly(count: int, tripod_nominal: Poses) -> None:
    """The turn about the line through two targets is not seen; three that are not on a line show all six components."""
    poses, targets = tripod_nominal[:30], ((0.1, 0.0, 0.0), (-0.05, 0.09, 0.0), (-0.05, -0.09, 0.02))[:count]
    seen = Measurements.from_poses(poses.commands, poses.transforms, Instrument("position", targets=targets))
    warnings = calibrate(seen, poses.robot, "gp", on_refusal="keep").warnings
    assert any("a learned correction is poor" in warning for warning in warnings) == (count < 3)
