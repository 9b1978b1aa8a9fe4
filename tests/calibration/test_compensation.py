"""Compensation in a loop with simulated machines: do corrected commands bring the tool to the desired poses?"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.fit import Fit, Options, fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.learned_part import InputScale, LearnedPart
from pm3dof_pin.chapter import Tripod
from pm3dof_pin.chapter.kinematics import inverse_kinematics, placement
from pm3dof_pin.errors.command_correction import nearest_poses
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.exceptions import CalibrationRefusedError, InvalidValueError, UnreachablePoseError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.simulation.worlds import World

pytestmark = pytest.mark.usefixtures("small_networks", "few_folds")

METHODS = ("lm", "gp", "nn", "lm+gp", "lm+nn")


@pytest.fixture(scope="module")
def world(tripod_errors: GeometricErrors) -> World:
    return World.random("everything", tripod_errors, np.random.default_rng(0))


@pytest.fixture(scope="module")
def measured(world: World, tripod_nominal: Poses) -> Measurements:
    return world.measure(tripod_nominal.commands[:60], np.random.default_rng(1))


_CALIBRATED: dict[tuple[int, str], tuple[Measurements, Fit]] = {}


def calibration_from(measured: Measurements, errors: GeometricErrors, method: str) -> Fit:
    """Calibrate with a method; earlier calibrations are reused."""
    key = id(measured), method  # the measurements are kept, so that no others get their address
    if key not in _CALIBRATED:
        _CALIBRATED[key] = measured, fit(measured, errors, Options(method))
    return _CALIBRATED[key][1]


def calibrated(measured: Measurements, errors: GeometricErrors, method: str) -> Compensation:
    """Calibrate with a method, once."""
    return calibration_from(measured, errors, method).compensation


@pytest.fixture(scope="module")
def positions(measured: Measurements) -> Measurements:
    """Of the tool point alone."""
    return replace(measured, rotations=None, sigmas=measured.sigmas[:, :3])


@pytest.fixture(scope="module")
def geometric(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> list[Measurements]:
    """Of two machines whose only errors are those of the parameters."""
    return [
        World.random("geometry", tripod_errors, np.random.default_rng([seed, 4])).measure(
            tripod_nominal.commands[40 * seed : 40 * seed + 40], np.random.default_rng(seed)
        )
        for seed in range(2)
    ]


@pytest.fixture(scope="module")
def conditions(measured: Measurements) -> dict[str, np.ndarray]:
    """Conditions at 25 poses, over the range of those measured."""
    return {name: np.linspace(values.min(), values.max(), 25) for name, values in measured.conditions.items()}


@pytest.fixture(scope="module")
def best(world: World, tripod_nominal: Poses, conditions: dict[str, np.ndarray]) -> np.ndarray:
    """Commands that bring the machine closest to 25 unmeasured poses, shape=(25, 3)."""
    wanted = tripod_nominal[200:225]
    best = wanted.commands
    for _ in range(2):
        reached = world.poses(best, conditions)
        nearest = nearest_poses(wanted, reached).commands
        best = best - (nearest - wanted.commands)
    return np.asarray(best)


@pytest.mark.parametrize("method", METHODS)
def test_sixty_poses_bring_the_tip_to_its_floor(
    method: str,
    world: World,
    measured: Measurements,
    tripod_errors: GeometricErrors,
    tripod_nominal: Poses,
    conditions: dict[str, np.ndarray],
    best: np.ndarray,
) -> None:
    """The true machine is commanded: within 10 % of the best commands' tip error."""
    wanted = tripod_nominal[200:225]
    floor = tip_error(pose_difference(wanted.transforms, world.poses(best, conditions)))
    commands = calibrated(measured, tripod_errors, method).corrected(wanted, conditions)
    left = tip_error(pose_difference(wanted.transforms, world.poses(commands, conditions)))
    before = tip_error(pose_difference(wanted.transforms, world.poses(wanted.commands, conditions)))
    assert left.mean() < 1.1 * floor.mean() < before.mean()
    excess = np.sqrt(np.mean((commands - best) ** 2))
    assert excess < (15e-6 if "+" in method else 25e-6)
    assert excess < 0.15 * np.sqrt(np.mean((wanted.commands - best) ** 2))


def test_the_flow_of_the_figure(tripod_errors: GeometricErrors, tripod_nominal: Poses, tripod: Tripod) -> None:
    """u - du(u) at the given command: a machine with that pseudo-error is then at the desired pose."""

    class Linear:
        def deviations(self, inputs: np.ndarray) -> np.ndarray:
            return 2e-4 * inputs[:, :3] + 1e-4

        def uncertainties(self, inputs: np.ndarray) -> np.ndarray:
            return np.full((len(inputs), 3), 3e-6)

        def as_data(self) -> dict[str, object]:
            return {}

    scale = InputScale((), np.full(3, 0.24), np.full(3, 0.085))
    compensation = Compensation(tripod_errors, learned=LearnedPart(Linear(), scale))
    pose = np.array([0.1, -0.2, 0.5])
    answer = compensation.compensate(placement(pose))
    nominal = inverse_kinematics(tripod, pose)
    np.testing.assert_allclose(answer.nominal_commands[0], nominal, atol=1e-9)
    at_corrected, at_nominal = (Linear().deviations((u - 0.24) / 0.085) for u in (answer.commands, nominal[None]))
    np.testing.assert_allclose(answer.commands + at_corrected, nominal[None], atol=1e-9)
    np.testing.assert_allclose(answer.deviations, at_nominal, atol=1e-9)
    assert answer.predicted_error[0] > 0.0


def test_without_anything_known_the_nominal_commands_come_out(tripod_errors: GeometricErrors, tripod: Tripod) -> None:
    answer = Compensation(tripod_errors).compensate(tripod_errors.robot.solve([[0.1, -0.2, 0.5]]))
    np.testing.assert_array_equal(answer.commands, answer.nominal_commands)
    np.testing.assert_allclose(answer.commands[0], inverse_kinematics(tripod, [0.1, -0.2, 0.5]), atol=1e-13)
    np.testing.assert_array_equal(answer.predicted_error, 0.0)


def test_the_inverse_of_the_true_model_has_only_the_floor(
    tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    values = tripod_errors.sample(np.random.default_rng(0))
    poses = tripod_nominal[:10]
    compensation = Compensation(tripod_errors, values)
    commands = compensation.corrected(poses)
    machine = tripod_errors.apply(values)

    def missed(u: np.ndarray) -> np.ndarray:
        return tip_error(pose_difference(poses.transforms, machine.forward(u, guess=poses.q).transforms))

    least = missed(commands)
    np.testing.assert_allclose(compensation.compensate(poses).predicted_error, least, rtol=1e-6)
    for step in 2e-6 * np.concatenate([np.eye(3), -np.eye(3)]):
        assert np.all(missed(commands + step) > least)


@pytest.mark.parametrize("method", METHODS)
def test_the_predicted_error_is_about_the_error(
    method: str, world: World, measured: Measurements, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    wanted = tripod_nominal[200:225]
    conditions = {name: np.full(25, values.mean()) for name, values in measured.conditions.items()}
    compensation = calibrated(measured, tripod_errors, method)
    reached = world.poses(compensation.corrected(wanted, conditions), conditions)
    left = np.sqrt(np.mean(tip_error(pose_difference(wanted.transforms, reached)) ** 2))
    predicted = np.sqrt(np.mean(compensation.compensate(wanted, conditions).predicted_error ** 2))
    assert 0.6 < predicted / left < 1.7


@pytest.mark.parametrize("method", ["lm+gp", "lm+nn"])
def test_hybrids_do_a_geometric_machine_no_harm(
    method: str, geometric: list[Measurements], tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    wanted, noise = tripod_nominal[200:300], 8.6e-6  # of a joint deviation found from one measurement
    for measured in geometric:
        parametric = calibrated(measured, tripod_errors, "lm").corrected(wanted)
        hybrid = calibrated(measured, tripod_errors, method).corrected(wanted)
        assert np.sqrt(np.mean((hybrid - parametric) ** 2)) < 0.3 * noise


@pytest.fixture(scope="module")
def dirty(measured: Measurements, tripod_errors: GeometricErrors) -> Measurements:
    """5 % of the rows are off by millimetres, and reported."""
    positions = np.array(measured.positions)
    positions[[5, 20, 41]] += np.array([[4e-3, 0.0, 0.0], [0.0, 6e-3, 0.0], [0.0, 0.0, -3e-3]])
    wrong = replace(measured, positions=positions)
    assert calibration_from(wrong, tripod_errors, "lm").identification.outliers == (5, 20, 41)
    return wrong


@pytest.mark.parametrize("method", ["lm", "lm+gp", "lm+nn"])
def test_gross_outliers_change_little(
    method: str, measured: Measurements, dirty: Measurements, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """The corrected commands leave less than a fifth of the original error."""
    wanted = tripod_nominal[200:260]
    middle = {name: float(values.mean()) for name, values in measured.conditions.items()}
    clean = calibrated(measured, tripod_errors, method).corrected(wanted, middle)
    changed = calibrated(dirty, tripod_errors, method).corrected(wanted, middle)
    assert np.sqrt(np.mean((changed - clean) ** 2)) < 5e-6


def test_a_row_half_a_metre_off_is_no_more_than_an_outlier(
    measured: Measurements, tripod_errors: GeometricErrors
) -> None:
    """No commands bring the machine there, so none may be requested."""
    some = measured[:20]
    positions = np.array(some.positions)
    positions[7, 2] *= 1000.0  # millimetres
    found = fit(replace(some, positions=positions), tripod_errors, Options("lm+gp"))
    assert found.identification.outliers == (7,)
    assert 7 not in HeldOut.from_cross_validation(found).rows


def test_measurements_in_another_frame_are_refused(measured: Measurements, tripod_errors: GeometricErrors) -> None:
    with pytest.raises(CalibrationRefusedError, match="larger than the machine could be off"):
        calibrate(replace(measured, positions=measured.positions - 0.3), tripod_errors, "lm")


def test_cross_validation_tells_before_after_and_floor(measured: Measurements, tripod_errors: GeometricErrors) -> None:
    held_out = HeldOut.from_cross_validation(calibration_from(measured, tripod_errors, "lm+gp"))
    assert len(held_out.rows) == 60
    assert np.all(held_out.floor <= held_out.before + 1e-9)
    assert held_out.floor.mean() < held_out.after.mean() < 1.2 * held_out.floor.mean() < held_out.before.mean()
    np.testing.assert_allclose(held_out.noise, np.sqrt(3.0 * 7.5e-6**2 + 3.0 * (0.1 * 7.0710678e-5) ** 2), rtol=1e-6)


def test_one_pose_or_a_list_of_them_and_nothing_else(
    measured: Measurements, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    correction = Compensation(tripod_errors)
    np.testing.assert_array_equal(
        correction.compensate(tripod_nominal[0]).commands, correction.compensate(tripod_nominal[:1]).commands
    )
    for wanted in (tripod_nominal[:4].reshape(2, 2), tripod_nominal[:4].transforms.reshape(2, 2, 4, 4), "a pose"):
        with pytest.raises(InvalidValueError, match="wanted"):
            correction.compensate(wanted)


def test_too_few_and_out_of_reach(measured: Measurements, tripod_errors: GeometricErrors) -> None:
    with pytest.raises(InvalidValueError, match="at least 4"):
        fit(measured[:3], tripod_errors, Options("gp"))
    with pytest.raises(InvalidValueError, match="more than 4 for a cross-validation"):
        HeldOut.from_cross_validation(fit(measured[:4], tripod_errors, Options("lm")))
    with pytest.raises(InvalidValueError, match="one of lm, nn, gp"):
        Options("svm")  # type: ignore[arg-type]
    with pytest.raises(UnreachablePoseError):
        Compensation(tripod_errors).compensate(placement([0.0, 0.0, 1.5]))


def test_too_few_poses_are_said(
    measured: Measurements, tripod_errors: GeometricErrors, caplog: pytest.LogCaptureFixture
) -> None:
    fit(measured[:5], tripod_errors, Options("lm"))
    said = re.search(r"5 measurements give 30 equations for 40 parameters, too few: (\d+) combinations", caplog.text)
    assert said is not None
    assert 0 < int(said[1]) < 28  # the rank of five poses


def test_three_targets_are_as_good_as_poses(
    world: World, measured: Measurements, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """Positions of targets on the platform, one row each, at the same commands."""
    assert measured.rotations is not None
    offsets = np.array([[0.15, 0.0, 0.0], [-0.075, 0.13, 0.0], [-0.075, -0.13, 0.0]])
    seen = [measured.positions + measured.rotations @ offset for offset in offsets]
    points = replace(
        measured,
        commands=np.tile(measured.commands, (3, 1)),
        positions=np.concatenate(seen),
        rotations=None,
        sigmas=np.full((180, 3), 15e-6),
        points=np.repeat(offsets, 60, axis=0),
        conditions={name: np.tile(values, 3) for name, values in measured.conditions.items()},
        lines=tuple(range(2, 182)),
    )
    wanted = tripod_nominal[200:225]
    middle = {name: np.full(25, values.mean()) for name, values in measured.conditions.items()}
    commands = calibrated(points, tripod_errors, "lm").corrected(wanted, middle)
    from_poses = calibrated(measured, tripod_errors, "lm").corrected(wanted, middle)
    assert np.sqrt(np.mean((commands - from_poses) ** 2)) < 10e-6


def test_positions_of_the_tool_point_correct_its_height(
    world: World,
    measured: Measurements,
    positions: Measurements,
    tripod_errors: GeometricErrors,
    tripod_nominal: Poses,
    caplog: pytest.LogCaptureFixture,
) -> None:
    """It is in the universal joint: the tilts are unobservable, and a message says so."""
    wanted = tripod_nominal[200:225]
    middle = {name: np.full(25, values.mean()) for name, values in measured.conditions.items()}
    commands = calibrated(positions, tripod_errors, "gp").corrected(wanted, middle)

    def height_error(u: np.ndarray) -> float:
        return float(np.abs(world.poses(u, middle)[:, 2, 3] - wanted.positions[:, 2]).mean())

    assert height_error(commands) < 0.2 * height_error(wanted.commands)
    assert "shows 1 of the 3 motions of the drives" in caplog.text


def test_tilts_that_positions_do_not_show_are_expected_to_be_off(
    measured: Measurements, positions: Measurements, tripod_errors: GeometricErrors, tripod_nominal: Poses
) -> None:
    """Only the tolerances inform these: the error of commands is known to a factor of two. A method without parameters
    has no tolerances, and gives nothing."""
    wanted = tripod_nominal[200:225]
    middle = {name: np.full(25, values.mean()) for name, values in measured.conditions.items()}
    whole, blind = (calibration_from(rows, tripod_errors, "lm") for rows in (measured, positions))
    commands = (found.compensation.corrected(wanted, middle) for found in (whole, blind))
    off = np.sqrt(np.mean(np.subtract(*commands) ** 2))
    assert 0.5 * off < np.sqrt(np.mean(HeldOut.from_cross_validation(blind).excess ** 2)) < 2.0 * off
    assert np.isnan(HeldOut.from_cross_validation(fit(positions[:15], tripod_errors, Options("gp"))).excess).all()


def test_all_rows_of_one_pose_are_hidden_together(measured: Measurements, tripod_errors: GeometricErrors) -> None:
    """A pose measured twice must not be predicted from its own copy: only distinct poses are evaluated."""
    twice = measured[[*range(5), *range(5)]]
    assert not fit(twice, tripod_errors, Options("lm")).can_be_judged
    once = HeldOut.from_cross_validation(fit(measured[:12], tripod_errors, Options("lm", loss="squares")))
    again = HeldOut.from_cross_validation(fit(measured[[*range(12)] * 2], tripod_errors, Options("lm", loss="squares")))
    np.testing.assert_allclose(again.after[:12], again.after[12:], rtol=1e-9)
    assert again.after.mean() > 0.8 * once.after.mean()


def test_near_singular_poses_of_an_arm_do_not_spoil_the_judgement(serial_arm: Robot) -> None:
    """Six drives correct everything except where the wrist is straight: such poses are few, and no error is huge."""
    errors = GeometricErrors(serial_arm)
    generator = np.random.default_rng(0)
    arm = World.random("geometry", errors, generator)
    commands = generator.uniform(-2.0, 2.0, (40, 6))
    commands[::8, 4] = 1e-3  # straight
    found = fit(arm.measure(commands, generator), errors, Options("lm"))
    held_out = HeldOut.from_cross_validation(found)
    assert np.median(held_out.floor) < 1e-6
    assert np.median(held_out.after) < 2.0 * np.median(held_out.noise)
    assert np.all(held_out.after < 1.1 * held_out.before)
    assert np.median(held_out.excess) < 3e-4
    assert held_out.excess.max() < 0.03
