"""The verdict of a calibration: valid bounds, a budget that adds up, and three lines first."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.calibration import caution
from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.caution import HARM, Gain
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.expectation import Expectation, Systematic
from pm3dof_pin.calibration.fit import Fit, Options, fit
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.calibration.planning import order_with_references
from pm3dof_pin.calibration.refusals import refusals
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.normal_vectors import norm_quantiles
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.presets import with_free_zeros
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.instruments.table import placed_instrument
from pm3dof_pin.measuring.measurement_file import write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.observation import touching_poses
from pm3dof_pin.simulation.worlds import World

REPEATS = 5
SCATTER = 12e-6
"""Deviation of the test machine from its own mean, each coordinate [m]."""


@pytest.fixture(scope="module")
def truth(tripod_errors: GeometricErrors) -> np.ndarray:
    return tripod_errors.sample(np.random.default_rng(21))


@pytest.fixture(scope="module")
def calibration(truth: np.ndarray, tripod_errors: GeometricErrors, tripod_nominal: Poses) -> Fit:
    """A machine with errors of geometry that scatters; its first pose is visited six times."""
    generator = np.random.default_rng(4)
    poses = tripod_nominal[[*range(30), *[0] * REPEATS]]
    reached = np.array(tripod_errors.apply(truth).forward(poses.commands, guess=poses.q).transforms)
    noise = generator.standard_normal((len(poses), 6)) * Instrument().sigmas
    reached[:, :3, 3] += noise[:, :3] + SCATTER * generator.standard_normal((len(poses), 3))
    reached[:, :3, :3] = Rotation.from_rotvec(noise[:, 3:]).as_matrix() @ reached[:, :3, :3]
    times = 60.0 * np.arange(len(poses))
    return fit(replace(Measurements.from_poses(poses.commands, reached), times=times), tripod_errors, Options("lm"))


@pytest.fixture(scope="module")
def judgement(calibration: Fit) -> Expectation:
    return Expectation.from_fit(calibration)


def test_upper_quantiles_against_samples() -> None:
    generator = np.random.default_rng(0)
    for size in (1, 3, 6):
        half = generator.standard_normal((6, size)) * 10.0 ** generator.uniform(-1.5, 0.0, size)
        mean = generator.standard_normal(6) * 10.0 ** generator.uniform(-2.0, 0.5)
        drawn = np.linalg.norm(mean + generator.standard_normal((40000, size)) @ half.T, axis=1)
        for probability in (0.9, 0.95, 0.99):
            bound = norm_quantiles(mean, half @ half.T, probability)
            assert np.mean(drawn <= bound) == pytest.approx(probability, abs=0.01)
    np.testing.assert_allclose(norm_quantiles(np.array([3.0, 4.0]), np.zeros((2, 2)), 0.95), 5.0)
    with pytest.raises(InvalidValueError, match="coverage"):
        norm_quantiles(mean, np.eye(6), 0.1)


def test_bounds_hold_on_the_machine(
    calibration: Fit, truth: np.ndarray, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    wanted, generator = tripod_nominal[200:260], np.random.default_rng(9)
    answer = calibration.compensation.compensate(wanted)
    reached = np.array(tripod_errors.apply(truth).forward(answer.commands, guess=wanted.q).transforms)
    reached[:, :3, 3] += SCATTER * generator.standard_normal((60, 3))
    errors = tip_error(pose_difference(wanted.transforms, reached))
    assert np.mean(errors <= answer.error_bound) >= 0.85  # of 60, with one machine's errors in common
    assert np.sqrt(np.mean(answer.predicted_error**2)) == pytest.approx(np.sqrt(np.mean(errors**2)), rel=0.15)
    assert np.all(answer.error_bound > answer.predicted_error)


def test_the_budget_adds_up(judgement: Expectation, calibration: Fit, tripod_nominal: Poses) -> None:
    total = np.sqrt(sum(value**2 for value in judgement.budget.values()))
    expected = calibration.compensation.compensate(tripod_nominal[:150]).predicted_error
    assert total == pytest.approx(np.sqrt(np.mean(expected**2)), rel=0.1)  # over other poses of the workspace
    assert judgement.budget["floor"] > judgement.budget["instrument"] > 0.0
    assert judgement.budget["frame"] < 1e-9


def test_the_budget_adds_up_where_zeros_are_free(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """Three heights leave most of the zeros to their tolerance, which the scale of the others leaves as it is."""
    errors, poses = with_free_zeros(tripod_errors), tripod_nominal[:3]
    reached = tripod_errors.apply(0.5 * tripod_errors.sample(np.random.default_rng(1))).forward(poses.commands)
    seen = Measurements.from_poses(poses.commands, reached.transforms)
    heights = replace(seen, rotations=None, sigmas=np.tile([np.inf, np.inf, 1e-5], (3, 1)))
    found = fit(heights, errors, Options("lm"))
    assert found.identification.prior.error > 0.2
    judged = Expectation.from_fit(found)
    total = np.sqrt(sum(value**2 for value in judged.budget.values()))
    answer = found.compensation.compensate(reachable_poses(errors.robot, 2000, np.random.default_rng(0)))
    assert total == pytest.approx(np.sqrt(np.mean(answer.predicted_error**2)), rel=0.01)


def test_repeated_poses_tell_the_scatter(judgement: Expectation) -> None:
    repeated = judgement.repeated
    assert repeated is not None
    assert repeated.freedom == REPEATS
    # five degrees of freedom of three coordinates: within a half of it
    assert repeated.tip_sigma == pytest.approx(np.sqrt(3.0) * SCATTER, rel=0.5)
    assert repeated.poses.tolist() == [0]
    assert repeated.repeatability[0] > SCATTER


def test_where_nothing_drifts_no_drift_is_claimed(judgement: Expectation) -> None:
    assert {found.kind: found.sure for found in judgement.systematic} == {"drift": False}


@pytest.mark.usefixtures("report_without_pictures")
def test_warming_and_backlash_are_said(
    truth: np.ndarray, tripod_errors: GeometricErrors, tripod_nominal: Poses, run: Callable[..., Any], tmp_path: Path
) -> None:
    """Steel that warms by 8 K while poses are measured, one again and again, and 20 µm of backlash in every drive."""
    generator = np.random.default_rng(3)
    nominal = tripod_nominal[:30][order_with_references(tripod_nominal[:30], 5, 0)]
    commands, machine = nominal.commands, tripod_errors.apply(truth)
    side = np.sign(np.diff(commands, axis=0, prepend=commands[:1] - 1.0))
    part = np.linspace(0.0, 1.0, len(commands))
    reached = np.array(machine.forward(commands + 10e-6 * side, guess=nominal.q).transforms)
    growth = 8.0 * 12e-6 * part[:, None] * reached[:, :3, 3]
    reached[:, :3, 3] += growth + generator.normal(0.0, 7.5e-6, growth.shape)
    seen = replace(Measurements.from_poses(commands, reached), times=3600.0 * part, approaches=side)
    found = {each.kind: each for each in Systematic.all_from_fit(fit(seen, tripod_errors, Options("lm")))}
    slid = np.abs(
        machine.forward(commands + 10e-6 * side, guess=nominal.q).positions - machine.forward(commands).positions
    )
    assert all(each.sure for each in found.values())
    whole = float(np.sqrt(np.mean(np.sum(reached[:, :3, 3] ** 2, axis=1)))) * 8.0 * 12e-6
    assert abs(found["drift"].tip - whole) < 3.0 * found["drift"].tip_sigma
    assert found["hysteresis"].tip > np.sqrt(np.mean(np.sum(slid**2, axis=1)))
    write_measurements(seen, tripod_errors.robot, tmp_path / "seen.csv")
    answer = run("calibrate", "seen.csv", "--method", "lm", "--out", "found", cwd=tmp_path)
    assert answer.returncode == 0, answer.stderr
    assert "drift moved the tool by" in answer.stdout
    assert "hysteresis moved the tool by" in answer.stdout


def test_the_chance_of_harm_is_that_of_machines_drawn(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """Heights do not determine the tilts: machines consistent with the data, with full or cautious corrections."""
    poses, generator = tripod_nominal[:12], np.random.default_rng(3)
    truth = tripod_errors.apply(0.6 * tripod_errors.sample(generator)).forward(poses.commands, guess=poses.q)
    measured = Measurements.from_poses(poses.commands, truth.transforms)
    heights = replace(measured, rotations=None, sigmas=np.tile([np.inf, np.inf, 7.5e-6], (12, 1)))
    found = fit(heights, tripod_errors, Options("lm", prior=1.0))
    whole = Compensation.from_identification(found.identification, found.options.eta)
    where = reachable_poses(tripod_errors.robot, 60, generator)
    corrections = [compensation.corrected(where) for compensation in (whole, found.compensation)]
    commands, starts = np.concatenate([where.commands, *corrections]), np.tile(where.q, (3, 1))
    wanted = np.tile(where.transforms, (3, 1, 1))
    gains = []
    for values in generator.multivariate_normal(found.identification.values, found.identification.covariance, 150):
        reached = tripod_errors.apply(values).forward(commands, guess=starts).transforms
        sums = np.sum(tip_error(pose_difference(wanted, reached)).reshape(3, -1) ** 2, axis=1)
        gains.append(sums[0] - sums[1:])
    harmed, gained = np.mean(np.array(gains) < 0.0, axis=0), np.mean(gains, axis=0)
    gain = Gain.from_compensation(whole)
    assert gain is not None
    chance = gain.chance_of_harm(found.identification.values)
    assert 0.05 < chance < 0.5
    assert chance == pytest.approx(harmed[0], abs=0.1)
    # caution has a price: on average the full correction gains more
    assert found.chance_of_harm <= HARM + 1e-12
    assert harmed[1] <= 5 / 150  # of 1 % of them, which more than so many are once in 200 draws
    assert 0.0 < gained[1] < gained[0]
    assert 0.1 < found.part_corrected < 0.95
    assert not any("worse than uncorrected ones" in reason for reason in refusals(found, None))
    assert fit(measured, tripod_errors, Options("lm")).chance_of_harm < 1e-6


@pytest.mark.parametrize(("seed", "most"), [(1, 0.05), (5, 0.025)])
def test_a_correction_does_as_little_harm_over_other_poses(
    seed: int, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The little that touches of a line allow is judged by enough poses to hold over twelve thousand others."""
    errors, generator = GeometricErrors.load("three_rps"), np.random.default_rng(seed)
    machine = World.random("geometry", errors, generator)
    poses = reachable_poses(errors.robot, 24, generator)
    instrument = placed_instrument("line", poses, point=(0.12, 0.0, 0.01))
    measured = machine.measure(touching_poses(poses, instrument).commands, generator, instrument)
    whole = Compensation.from_identification(identify(measured, errors, prior=1.0))
    values = Gain.from_compensation(whole).sure_values()
    monkeypatch.setattr(caution, "_POSES", 12_000)
    monkeypatch.setattr(
        caution, "reachable_poses", lambda robot, count, _: reachable_poses(robot, count, np.random.default_rng(98))
    )
    assert Gain.from_compensation(whole).chance_of_harm(values) < most


def test_commands_of_few_drives_may_increase_what_is_seen() -> None:
    """Three drives correct the whole tip, and two tilts that a level shows may grow: the machine is better for it."""
    errors, generator = GeometricErrors.load("three_rps"), np.random.default_rng(4)
    machine = errors.apply(errors.sample(generator))
    poses, wanted = (reachable_poses(errors.robot, 40, np.random.default_rng(seed)) for seed in (0, 1))
    seen = Measurements.from_poses(poses.commands, machine.forward(poses.commands, guess=poses.q).transforms)
    tilts = replace(seen, sigmas=np.tile([*[np.inf] * 3, 1e-6, 1e-6, np.inf], (40, 1)))
    found = calibrate(tilts, errors, "lm")
    before, after = (
        tip_error(pose_difference(wanted.transforms, machine.forward(commands, guess=wanted.q).transforms))
        for commands in (wanted.commands, found.compensate(wanted).commands)
    )
    assert np.mean(after**2) < 0.7 * np.mean(before**2)
    held_out = found.held_out
    assert held_out is not None
    assert np.mean(held_out.after**2) > 2.0 * np.mean(held_out.before**2)
    gained = np.mean(held_out.whole[0] ** 2 - held_out.whole[1] ** 2)
    assert gained == pytest.approx(np.mean(before**2 - after**2), rel=0.3)  # of other poses


def test_sigmas_that_are_too_small_are_one_of_two_explanations() -> None:
    """With three times the noise declared, the tip error is that of a larger noise, and said as an alternative."""
    errors, generator = GeometricErrors.load("hexapod"), np.random.default_rng(2)
    machine = errors.apply(errors.sample(generator))
    poses = reachable_poses(errors.robot, 40, generator)
    reached = np.array(machine.forward(poses.commands, guess=poses.q).transforms)
    noise = 3.0 * generator.standard_normal((len(poses), 6)) * Instrument().sigmas
    reached[:, :3, 3] += noise[:, :3]
    reached[:, :3, :3] = Rotation.from_rotvec(noise[:, 3:]).as_matrix() @ reached[:, :3, :3]
    found = calibrate(Measurements.from_poses(poses.commands, reached), errors, "lm")
    wanted = reachable_poses(errors.robot, 100, generator)
    answer = found.compensate(wanted)
    left = tip_error(pose_difference(wanted.transforms, machine.forward(answer.commands, guess=wanted.q).transforms))
    actual = float(np.sqrt(np.mean(left**2)))
    said = found.expectation.if_noise_is_larger
    assert said is not None
    assert 0.6 * actual < said < 1.8 * actual  # without it, 3 to 5 times
    assert found.summary()["tip_error_rms_if_sigmas_are_too_small_m"] == said
    assert "times too small" in found.expectation.text
