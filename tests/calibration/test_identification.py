"""Identification against simulated machines whose errors are known."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import null_space
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation
from scipy.stats import chi2, multivariate_normal, norm

from pm3dof_pin.calibration.identification import Identification, identify
from pm3dof_pin.calibration.linearisation import Linearisation
from pm3dof_pin.calibration.planning import PlanningProblem
from pm3dof_pin.calibration.prior import PRIOR, Prior
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.normal_vectors import covariance_root
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.presets import with_free_zeros
from pm3dof_pin.errors.sensitivity import closable, sensitivities
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.simulation.simulated_machine import SimulatedMachine


@pytest.fixture(scope="module")
def truth(tripod_errors: GeometricErrors) -> np.ndarray:
    return tripod_errors.sample(np.random.default_rng(5))


def simulated(errors: GeometricErrors, truth: np.ndarray, poses: Poses, seed: int | None = None) -> Measurements:
    """Measure a machine with geometric errors, with the instrument's noise if there is a seed."""
    reached = errors.apply(truth).forward(poses.commands, guess=poses.q).transforms
    if seed is not None:
        noise = np.random.default_rng(seed).standard_normal((len(poses), 6)) * Instrument().sigmas
        turned = np.array(reached)
        turned[:, :3, :3] = Rotation.from_rotvec(noise[:, 3:]).as_matrix() @ reached[:, :3, :3]
        turned[:, :3, 3] += noise[:, :3]
        reached = turned
    return Measurements.from_poses(poses.commands, reached)


def test_exact_without_noise(tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses) -> None:
    """All parameters are recovered to a nanometre and a nanoradian."""
    found = identify(simulated(tripod_errors, truth, tripod_nominal[:60]), tripod_errors, prior=np.inf)
    np.testing.assert_allclose(found.values, truth, atol=1e-9)
    assert np.abs(found.residuals).max() < 1e-12
    assert found.identifiability.rank == 40
    assert found.prior_dominated == ()


def test_a_redundant_parameter_is_reported_and_harmless(
    tripod_errors: GeometricErrors, redundant_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    redundant = redundant_errors.names[-1:]
    found = identify(simulated(tripod_errors, truth, tripod_nominal[:60]), redundant_errors, prior=np.inf)
    assert found.identifiability.unidentifiable == redundant
    assert redundant[0] in found.prior_dominated
    reached = redundant_errors.apply(found.values).forward(tripod_nominal.commands, guess=tripod_nominal.q).transforms
    expected = tripod_errors.apply(truth).forward(tripod_nominal.commands, guess=tripod_nominal.q).transforms
    np.testing.assert_allclose(reached, expected, atol=1e-9)


def test_within_three_predicted_sigmas(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """Over six machines of 40 parameters: none beyond four sigmas, and the normal distribution's share within one."""
    scores = []
    for seed in range(6):
        values = tripod_errors.sample(np.random.default_rng([seed, 1]))
        poses = tripod_nominal[50 * (seed % 6) : 50 * (seed % 6) + 50]
        found = identify(simulated(tripod_errors, values, poses, seed), tripod_errors, prior=1.0)
        deviations = np.sqrt(np.diag(found.covariance))
        scores.append((found.values - values) / deviations)
        # as parts, parameters are less certain: a smooth effect hidden in the noise would have shifted them
        assert np.all(found.sigmas > deviations)
    size = np.abs(np.array(scores))
    assert np.mean(size > 3.0) < 0.01
    assert size.max() < 4.0
    assert 0.6 < np.mean(size < 1.0) < 0.85


@pytest.mark.parametrize("kind", ["pose", "position", "point"])
def test_the_derivatives_are_those_of_finite_differences(
    kind: str, tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    poses = tripod_nominal[:5]
    measurements = simulated(tripod_errors, truth, poses)
    if kind != "pose":
        points = np.zeros((5, 3)) if kind == "position" else np.tile([0.05, -0.1, 0.02], (5, 1))
        measurements = replace(measurements, rotations=None, sigmas=measurements.sigmas[:, :3], points=points)
    rows = measurements.derivatives(poses, sensitivities(tripod_errors, poses).errors)
    step = 1e-6
    for k in range(0, len(tripod_errors), 3):
        values = tripod_errors.zeros
        values[k] = step
        ahead = measurements.residuals(tripod_errors.apply(values).forward(poses.commands, guess=poses.q))
        back = measurements.residuals(tripod_errors.apply(-values).forward(poses.commands, guess=poses.q))
        np.testing.assert_allclose(rows[:, :, k], -(ahead - back) / (2.0 * step), atol=2e-8)


def test_points_on_the_platform_tell_the_orientation(
    tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    """Three points measured one by one are worth a full pose; one alone is not."""
    poses = tripod_nominal[:40]
    reached = tripod_errors.apply(truth).forward(poses.commands, guess=poses.q).transforms
    offsets = np.array([[0.1, 0.0, 0.0], [-0.05, 0.09, 0.0], [-0.05, -0.09, 0.02]])
    seen = [reached[:, :3, 3] + reached[:, :3, :3] @ offset for offset in offsets]
    measurements = Measurements(
        np.tile(poses.commands, (3, 1)),
        np.concatenate(seen),
        None,
        np.full((120, 3), 15e-6),
        np.repeat(offsets, 40, axis=0),
    )
    found = identify(measurements, tripod_errors, prior=np.inf)
    assert found.identifiability.rank == 40
    calibrated = tripod_errors.apply(found.values).forward(poses.commands, guess=poses.q).transforms
    np.testing.assert_allclose(calibrated, reached, atol=1e-9)
    assert identify(measurements[:40], tripod_errors).identifiability.rank < 40


def test_nine_d_optimal_poses_predict_the_tip_within_13_um(tripod_errors: GeometricErrors) -> None:
    """Root mean square over ten machines and 100 other poses."""
    generator = np.random.default_rng(0)
    candidates, tests = (reachable_poses(tripod_errors.robot, count, generator) for count in (500, 100))
    problem = PlanningProblem(tripod_errors, candidates, tests)
    plan = problem.plan(9, "d-optimal", np.random.default_rng(0))
    poses = problem.candidates[:100]
    squares = []
    for seed in range(10):
        values = tripod_errors.sample(np.random.default_rng([seed, 2]))
        found = identify(simulated(tripod_errors, values, plan.poses, seed), tripod_errors)
        reached = [
            tripod_errors.apply(p).forward(poses.commands, guess=poses.q).transforms for p in (values, found.values)
        ]
        squares.append(tip_error(pose_difference(*reached)) ** 2)
    assert np.sqrt(np.mean(squares)) < 13e-6


@pytest.mark.parametrize("loss", ["huber", "tukey"])
def test_gross_outliers_are_named_and_do_little(
    loss: str, tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    """5 % of the rows are off by millimetres; the error at other poses stays within 20 % of the clean one's."""
    poses, others = tripod_nominal[:60], tripod_nominal[100:200]
    clean = simulated(tripod_errors, truth, poses, 3)
    positions = np.array(clean.positions)
    positions[[7, 31, 50]] += np.array([[3e-3, 0.0, 0.0], [0.0, -5e-3, 1e-3], [0.02, 0.0, 0.0]])
    dirty = replace(clean, positions=positions)

    def error(measurements: Measurements, how: str) -> float:
        found = identify(measurements, tripod_errors, loss=how)
        machines = [tripod_errors.apply(values) for values in (truth, found.values)]
        reached = [machine.forward(others.commands, guess=others.q).transforms for machine in machines]
        return float(np.sqrt(np.mean(tip_error(pose_difference(*reached)) ** 2)))

    found = identify(dirty, tripod_errors, loss=loss)
    assert found.outliers == (7, 31, 50)
    assert found.outlier_lines == (9, 33, 52)
    assert identify(clean, tripod_errors, loss=loss).outliers == ()
    if loss == "tukey":
        assert error(dirty, "tukey") < 1.2 * error(clean, "squares")
    assert error(dirty, "squares") > 5.0 * error(clean, "squares")


def test_residuals_are_noise_of_the_stated_size(
    tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    found: Identification = identify(simulated(tripod_errors, truth, tripod_nominal, 8), tripod_errors, loss="squares")
    total = float(np.sum(found.normalized_residuals**2))
    assert chi2.ppf(1e-4, 1800 - 40) < total < chi2.isf(1e-4, 1800 - 40)
    assert found.noise_factor == pytest.approx(1.0, abs=0.06)


def test_residuals_of_few_measurements_are_less_than_the_noise() -> None:
    """The parameters use up p of n numbers: squared residuals are (n - p) / n of those of the noise."""
    count, dimension, used = 1001, 6, 4000
    places = (np.arange(count) + 0.5) / count
    noise = 3.0**2 * chi2.ppf(places, dimension)
    problem = SimpleNamespace(dimensions=np.full((count, 2), dimension))
    left = (count * dimension - used) / (count * dimension)
    squares = np.stack([left * noise, 4.0 * noise], axis=1)
    found = Linearisation.noise_factors(problem, squares, np.array([used, 0.0]))  # type: ignore[arg-type]
    np.testing.assert_allclose(found, [3.0, 6.0], rtol=1e-9)


@pytest.mark.parametrize("count", [15, 1])
def test_parameters_use_up_the_trace_of_the_hat_matrix(count: int) -> None:
    """Of many rows, and of fewer than parameters."""
    generator = np.random.default_rng(0)
    rows, sigmas = generator.standard_normal((count, 3, 4)), np.array([0.1, 0.3, 1.0, 3.0])
    design = rows.reshape(-1, 4)
    kinds, factors = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([1.0, 5.0])
    design = design / np.tile(kinds @ factors, count)[:, None]  # rows of more noise are weighted less
    hat = design @ np.linalg.inv(design.T @ design + np.diag(sigmas**-2)) @ design.T
    problem = SimpleNamespace(prior=Prior(PRIOR, np.zeros(4, dtype=bool)), rows=rows, kinds=kinds, sigmas=sigmas)
    problem._informations = Linearisation._informations.func(problem)  # type: ignore[attr-defined]
    problem._gram = Linearisation._gram.func(problem)  # type: ignore[attr-defined]
    assert (problem._gram is None) == (count > 1)
    used = np.diag(hat).reshape(count, 3).sum(axis=0) @ kinds
    np.testing.assert_allclose(Linearisation._used(problem, factors), used, rtol=1e-12)  # type: ignore[arg-type]


class _Thirty:
    """Thirty parameters in units of their tolerances."""

    tolerances = np.ones(30)

    def __len__(self) -> int:
        return 30


@pytest.mark.parametrize("true", [0.3, 1.5])
def test_the_prior_from_data_is_the_most_likely_one(true: float) -> None:
    """Data of covariance I f^2 / w + k^2 X X', without the directions N, and four parameters off by 1.

    N has a nuisance parameter, and four zeros of drives that are free: small in their tolerances, which are wide.
    """
    generator, factor = np.random.default_rng(1), 2.0
    weights = generator.uniform(0.3, 1.0, 20)
    rows = generator.standard_normal((20, 3, 31)) * np.geomspace(0.05, 3.0, 31)
    free = np.isin(np.arange(30), [23, 25, 27, 29])
    scaled = (rows * np.sqrt(weights)[:, None, None] / factor).reshape(60, 31)
    sigmas = np.append(np.where(free, 1.0, PRIOR), np.inf)
    truth = np.append(np.where(free, 0.01, true), 1.0) * generator.standard_normal(31)
    seen = scaled @ truth + generator.standard_normal(60)
    design, others = scaled[:, :30][:, ~free], scaled[:, np.append(free, True)]
    found = SimpleNamespace(
        errors=_Thirty(),
        values=np.linalg.solve(scaled.T @ scaled + np.diag(1.0 / sigmas**2), scaled.T @ seen)[:30],
        prior=Prior(PRIOR, free),
        rows=rows,
        weights=weights,
        noise_factors=np.full(3, factor),
    )
    rest = null_space(others.T)
    design, seen = rest.T @ design, rest.T @ seen

    def unlikely(k: float) -> float:
        covariance = np.eye(55) + k**2 * design @ design.T
        return 2.0 * (np.log(k**2) + k**-2) - multivariate_normal.logpdf(seen, cov=covariance)

    wanted = minimize_scalar(unlikely, bounds=(0.05, PRIOR), method="bounded").x
    likely = Identification.likely_prior(found)  # type: ignore[arg-type]
    assert likely.k == pytest.approx(wanted, abs=0.01)
    # of a standard deviation from as many parameters as the trace of the hat matrix says, and four
    information = design.T @ design
    told = np.trace(np.linalg.solve(information + np.eye(26) / wanted**2, information))
    assert likely.error == pytest.approx(1.0 / np.sqrt(2.0 * (told + 4.0)), rel=0.01)


def test_smooth_effects_hidden_in_the_noise_shift_parameters_by_less_than_a_sigma(
    tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """All heights read twice their sigma too high, or in proportion to the travel of the first slider."""
    poses = tripod_nominal[:50]
    exact = simulated(tripod_errors, tripod_errors.zeros, poses)
    travel = poses.commands[:, 0]
    found = identify(exact, tripod_errors, prior=1.0, loss="squares")
    for effect in (np.ones(len(poses)), (travel - travel.mean()) / travel.std()):
        shifted = replace(
            exact, positions=exact.positions + np.outer(2.0 * exact.sigmas[0, 2] * effect, [0.0, 0.0, 1.0])
        )
        again = identify(shifted, tripod_errors, prior=1.0, loss="squares")
        assert again.noise_factor < 1.3
        assert np.abs((again.values - found.values) / found.sigmas).max() < 1.0


def test_what_is_beyond_the_noise_may_have_shifted_the_parameters(
    tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    """By as much as a refit to rows that are off by it, and only if there is something beyond the noise and chance."""
    poses = tripod_nominal[:40]
    quiet = simulated(tripod_errors, truth, poses)
    x = np.tile(np.eye(3)[0], (len(poses), 1))
    u2 = poses.commands[:, 1]
    varying = ((u2 - u2.mean()) / u2.std())[:, None]
    found = identify(quiet, tripod_errors, prior=1.0, loss="squares")
    assert not found.beyond.any()
    # both errors at once: the residuals of positions and of angles show them with factors of their own
    louder = found.noise_factors * np.repeat([1.25, 1.0], 3)
    shared = np.sqrt((louder**2 - 1.0) / 4.0)
    problem = found.linearised(quiet)
    shifts = problem.shifts(found.certainties, shared, found.covariance).reshape(4, 6, -1)
    for own, by in ((shifts[0, 0], np.ones((len(x), 1))), (shifts[2, 0], varying)):
        off = replace(quiet, positions=quiet.positions + 0.375 * quiet.sigmas[:, :1] * by * x)
        again = identify(off, tripod_errors, prior=1.0, loss="squares")
        np.testing.assert_allclose(again.values - found.values, own, rtol=0.0, atol=1e-2 * np.abs(own).max())
    loud = simulated(tripod_errors, truth, poses, 1)
    noisy = identify(replace(loud, sigmas=0.5 * loud.sigmas), tripod_errors, prior=1.0)
    chance = 1.4 * np.sqrt(2.0 / (3 * len(poses)))  # relative standard error of a variance by medians
    excess = np.sqrt((noisy.noise_factors**2 * (1.0 - chance) - 1.0) / 4.0)
    expected = noisy.linearised(noisy.measurements).shifts(noisy.certainties, excess, noisy.joint_covariance)
    np.testing.assert_allclose(noisy.beyond, expected, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(noisy.seen_covariance - noisy.covariance, expected.T @ expected, rtol=1e-6, atol=1e-18)
    assert noisy.noise_factor > 1.7


def test_a_wider_prior_widens_what_was_not_measured_of_the_parts(tripod_nominal: Poses) -> None:
    """By the law of total variance: machines of random k between fits of one k, and the effect of noise on each.

    Zeros of the drives known to 5 mm are as far off whatever k is.
    """
    errors = with_free_zeros(GeometricErrors.load("pm3dof"))
    exact = simulated(errors, errors.zeros, tripod_nominal[:6])
    known = identify(exact, errors, prior=0.7, loss="squares")
    wider = identify(exact, errors, prior=0.7, prior_error=0.5, loss="squares")
    free = np.array([parameter.group == "zeros" for parameter in errors.parameters])
    assert free.sum() == 4
    scaled, sigmas = known.rows.reshape(-1, known.rows.shape[2]), np.where(free, 1.0, 0.7)
    gain = np.linalg.solve(scaled.T @ scaled + np.diag(sigmas**-2.0), scaled.T)
    missed = (np.eye(len(gain)) - gain @ scaled) * np.where(free, 1.0, 1.5 * 0.7)  # of a machine, without noise
    expected = (gain @ gain.T + missed @ missed.T) * np.outer(errors.tolerances, errors.tolerances)
    np.testing.assert_allclose(wider.covariance, expected, rtol=1e-6, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("k", [0.5, 2.0])
@pytest.mark.parametrize("loud", [1.0, 5.0])
def test_the_evidence_is_the_density_of_the_rows(tripod_nominal: Poses, k: float, loud: float) -> None:
    """Rows are normal with the variance of noise and prior; k is as if four parts of one tolerance had been measured.

    Values are seen from an expansion about the values found; constants do not count.
    """
    errors = with_free_zeros(GeometricErrors.load("pm3dof"))
    truth = errors.sample(np.random.default_rng(2))
    rows, chosen = simulated(errors, truth, tripod_nominal[:12], seed=4), np.array([0, 2, 3, 7, 11])
    found = identify(replace(rows, sigmas=rows.sigmas / loud), errors, loss="squares")
    assert (found.noise_factor > 2.0) == (loud > 2.0)
    effects = found.rows[chosen].reshape(-1, found.rows.shape[2])
    off = found.normalized_residuals[chosen].ravel() + effects @ (found.values / errors.tolerances)
    sigmas = np.where([parameter.group == "zeros" for parameter in errors.parameters], 1.0, k)
    variance = np.diag(np.tile(found.noise_factors**2, len(chosen))) + (effects * sigmas**2) @ effects.T
    expected = multivariate_normal(np.zeros(len(off)), variance).logpdf(off) + 4.0 * norm(0.0, k).logpdf(1.0)
    constant = -0.5 * (len(off) + 4) * np.log(2.0 * np.pi)
    prior = Prior(k, found.prior.free)
    assert found.log_evidence(prior, chosen) == pytest.approx(expected - constant, rel=1e-7)


@pytest.mark.parametrize(("weak", "told"), [(1e-13, True), (1e-16, False)])
def test_a_direction_is_told_down_to_rounding(weak: float, told: bool) -> None:
    """Information is quadratic in the effects: so is the threshold, down to the rounding of its sum."""
    problem = SimpleNamespace(
        rows=np.diag(np.sqrt([1.0, weak]))[None],
        units=np.ones(2),
        prior=Prior(np.inf, np.zeros(2, dtype=bool)),
        sigmas=np.full(2, np.inf),
    )
    covariance = Linearisation.covariances(problem, np.ones((1, 2)), [1.0])[0]  # type: ignore[arg-type]
    assert covariance[0, 0] == pytest.approx(1.0, rel=1e-12)
    assert covariance[1, 1] == (pytest.approx(1.0 / weak, rel=1e-9) if told else np.inf)


@pytest.mark.parametrize("seed", range(3))
def test_a_covariance_stays_one_however_little_is_known(seed: int) -> None:
    """Singular values s of the rows and prior k: V (s^2 + 1 / k^2)^-1 V^T; seen also through twice as many unknowns."""
    generator, count = np.random.default_rng(seed), 30
    left, right = (np.linalg.qr(generator.normal(size=(count, count)))[0] for _ in range(2))
    sizes, few = np.geomspace(1e4, 1e-2, count), generator.normal(size=(6, 3)) @ np.eye(count)[-3:]
    problem = SimpleNamespace(
        rows=((left * sizes) @ right.T)[:, None],
        units=np.ones(count),
        sigmas=np.full(count, PRIOR),
        prior=Prior(PRIOR, np.zeros(count, dtype=bool)),
    )
    (found,) = Linearisation.covariances(problem, np.ones((count, 1)), (0.0,))  # type: ignore[arg-type]
    expected = (right / (sizes**2 + PRIOR**-2)) @ right.T
    np.testing.assert_allclose(found, expected, atol=1e-6)
    seen = np.vstack([np.eye(count), few])
    assert np.isfinite(covariance_root(seen @ found @ seen.T)).all()


def test_errors_that_are_missing_show_in_the_noise_factor(
    tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """Every joint of the machine has all six errors: the complete file explains them."""
    machine = SimulatedMachine.random(tripod_errors, np.random.default_rng(0))
    seen = machine.measure(tripod_nominal.commands[:60], np.random.default_rng(1))
    measurements = Measurements.from_poses(tripod_nominal.commands[:60], seen)
    missing = ["passive_slider_joint.rz", "platform_x_joint.ry", "platform_y_joint.tz", "platform_y_joint.rz"]
    assert identify(measurements, tripod_errors).noise_factor < 1.2
    assert identify(measurements, tripod_errors.without([*missing, "O_e.rx", "O_e.rz"])).noise_factor > 2.0


@pytest.mark.parametrize("name", ["hexapod", "serial"])
def test_other_mechanisms(name: str, serial_arm: Robot) -> None:
    """The measurements are predicted exactly, whichever redundant parameters are used."""
    everything = GeometricErrors(serial_arm) if name == "serial" else GeometricErrors.load("hexapod")
    mechanism = everything.robot
    generator = np.random.default_rng(0)
    spread = 1.5 if name == "serial" else 0.004
    commands = mechanism.home.commands + generator.uniform(-spread, spread, (60, 6))
    nominal = mechanism.forward(commands)
    errors = closable(everything, nominal[:5])
    truth = errors.sample(generator)
    found = identify(simulated(errors, truth, nominal[:50]), errors, prior=np.inf)
    expected = errors.apply(truth).forward(commands[50:], guess=nominal.q[50:]).transforms
    reached = errors.apply(found.values).forward(commands[50:], guess=nominal.q[50:]).transforms
    np.testing.assert_allclose(reached, expected, atol=1e-7)
    assert found.identifiability.rank == (48 if name == "hexapod" else 30)


def test_nothing_to_identify_with(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    measurements = Measurements.from_poses(tripod_nominal.commands[:3], tripod_nominal.transforms[:3])
    with pytest.raises(InvalidValueError, match="0 measurements"):
        identify(measurements[:0], tripod_errors)
    with pytest.raises(InvalidValueError, match="prior"):
        identify(measurements, tripod_errors, prior=0.0)
    assert identify(measurements, tripod_errors).identifiability.rank == 18


def test_fewer_coordinates_than_parameters_are_solved_in_what_they_see(
    monkeypatch: pytest.MonkeyPatch, tripod_errors: GeometricErrors, truth: np.ndarray, tripod_nominal: Poses
) -> None:
    """The same parameters as from the normal equations of all: their number decides only how they are solved."""
    measurements = simulated(tripod_errors, truth, tripod_nominal[:6], seed=3)
    found = identify(measurements, tripod_errors)

    def everything(whole: Linearisation) -> tuple[np.ndarray, np.ndarray, None]:
        return whole.rows.reshape(-1, len(whole.sigmas)), whole.sigmas, None

    assert measurements.sigmas.size < len(tripod_errors)
    monkeypatch.setattr(Linearisation, "_seen", property(everything))
    expected = identify(measurements, tripod_errors)
    np.testing.assert_allclose(
        found.values / tripod_errors.tolerances, expected.values / tripod_errors.tolerances, atol=1e-6
    )


@pytest.mark.parametrize("weighted", [0, 3, 15])
def test_information_is_the_sum_over_all_weighted_rows(weighted: int) -> None:
    """Whether few rows have other weights than 1, whose excess is subtracted, or many."""
    generator = np.random.default_rng(1)
    rows, weights = generator.standard_normal((15, 3, 4)), np.ones(15)
    weights[:weighted] = generator.uniform(0.0, 1.0, weighted)
    kinds, factors = np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 1.0]]), np.array([2.0, 5.0])
    problem = SimpleNamespace(rows=rows, kinds=kinds)
    problem._informations = Linearisation._informations.func(problem)  # type: ignore[attr-defined]
    found = Linearisation._weighted_information(problem, weights, factors)  # type: ignore[arg-type]
    sizes = weights[:, None] / (kinds @ factors) ** 2
    np.testing.assert_allclose(found, np.einsum("nr,nri,nrj->ij", sizes, rows, rows), rtol=1e-12)
