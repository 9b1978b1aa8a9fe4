"""Redundant encoders: readings of passive joints along with measurements of the tool."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from pm3dof_pin.calibration.calibrate import calibrate
from pm3dof_pin.calibration.identifiability import Identifiability, stacked_regressor
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.calibration.refusals import _noise_in_words
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.sensitivity import sensitivities
from pm3dof_pin.exceptions import InvalidValueError, MeasurementError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import Nuisances

TILTS = {"platform_x_joint": "rad", "platform_y_joint": "rad"}
SIGMA = 1e-5


def _readings(poses: Poses, joints: dict[str, str]) -> np.ndarray:
    """The joints' coordinates, by Pinocchio's own indices."""
    model = poses.robot.model
    return poses.q[:, [model.joints[model.getJointId(name)].idx_q for name in joints]]


def _measured(errors: GeometricErrors, machine: Poses, joints: dict[str, str]) -> Measurements:
    count = len(machine)
    seen = Measurements(machine.commands, machine.positions, None, np.full((count, 3), SIGMA), np.zeros((count, 3)))
    return seen.with_encoders(joints, _readings(machine, joints), np.full((count, len(joints)), SIGMA))


@pytest.mark.parametrize(
    ("name", "joints"),
    [
        ("pm3dof", {**TILTS, "passive_slider_joint": "m", "universal2_first_joint": "rad"}),
        ("three_rps", {"hinge1_left_joint": "rad", "hinge3_right_joint": "rad"}),
    ],
)
def test_derivatives_are_those_of_finite_differences(name: str, joints: dict[str, str]) -> None:
    """By errors, drives, their drift and zeros: of a machine that is a tolerance off."""
    errors = GeometricErrors.load(name)
    rng = np.random.default_rng(0)
    nominal = reachable_poses(errors.robot, 4, rng)
    at = errors.sample(rng)
    machine = errors.apply(at).forward(nominal.commands, guess=nominal.q)
    seen = _measured(errors, machine, joints)
    found = sensitivities(errors, machine, at, joints=tuple(joints))
    rows = seen.derivatives(machine, found.errors)
    step = 1e-6
    for k in range(0, len(errors), 3):
        ahead, back = (
            seen.residuals(
                errors.apply(at + sign * step * np.eye(len(errors))[k]).forward(nominal.commands, guess=machine.q)
            )
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(rows[:, :, k], -(ahead - back) / (2.0 * step), atol=5e-8)
    for k in range(3):
        ahead, back = (
            seen.residuals(machine.robot.forward(nominal.commands + sign * step * np.eye(3)[k], guess=machine.q))
            for sign in (1.0, -1.0)
        )
        np.testing.assert_allclose(
            seen.derivatives(machine, found.commands)[:, :, k], -(ahead - back) / (2.0 * step), atol=5e-8
        )
    timed = replace(seen, times=60.0 * np.arange(4.0))
    units = tuple(command.unit for command in errors.robot.commands)
    nuisances = Nuisances.from_measurements(timed, units)
    assert nuisances.names[-len(joints) :] == tuple(f"encoder.{joint}" for joint in joints)
    moved = timed.derivatives(machine, nuisances.motions(timed, machine, found.commands))
    for k in range(len(nuisances)):
        values = step * np.eye(len(nuisances))[k]
        left = nuisances.removed(timed, machine, found.commands, values).residuals(machine)
        np.testing.assert_allclose(moved[:, :, k], -(left - timed.residuals(machine)) / step, atol=1e-6)


def test_the_plan_counts_them(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """Positions show less than positions and the universal joint's angles: by an SVD of differences."""
    nominal = tripod_nominal[:20]
    ranks = []
    for joints in ({}, TILTS):
        step = 1e-5
        columns = []
        for k in range(len(tripod_errors)):
            ends = [
                tripod_errors.apply(sign * step * np.eye(len(tripod_errors))[k]).forward(
                    nominal.commands, guess=nominal.q
                )
                for sign in (1.0, -1.0)
            ]
            seen = [np.hstack([poses.positions, _readings(poses, joints)]) for poses in ends]
            columns.append((seen[0] - seen[1]).ravel() / (2.0 * step) * tripod_errors.tolerances[k] / SIGMA)
        matrix = np.column_stack(columns)
        zeros = np.tile(np.eye(3 + len(joints))[:, 3:], (len(nominal), 1))
        matrix = matrix - zeros @ np.linalg.pinv(zeros) @ matrix if joints else matrix
        values = np.linalg.svd(matrix, compute_uv=False)
        ranks.append(int(np.sum(values > 1e-6 * values[0])))
        instrument = Instrument("position", SIGMA, SIGMA, encoders=tuple(joints))
        rows, others, nuisances = stacked_regressor(tripod_errors, nominal, instrument)
        assert Identifiability.from_regressor(tripod_errors.names, rows, others).rank == ranks[-1]
        assert len(nuisances) == len(joints)
    assert ranks[1] > ranks[0]
    with pytest.raises(InvalidValueError, match="expected a passive joint"):
        stacked_regressor(tripod_errors, nominal, Instrument(encoders=("slider1_joint",)))


@pytest.mark.usefixtures("few_folds")
def test_they_make_a_calibration_from_positions_better(tripod_errors: GeometricErrors, tmp_path: Path) -> None:
    """The tool point is in the universal joint: its two encoders determine the tilts, positions do not."""
    robot, rng = tripod_errors.robot, np.random.default_rng(6)
    nominal, wanted = reachable_poses(robot, 40, rng), reachable_poses(robot, 20, rng)
    truth = tripod_errors.apply(tripod_errors.sample(rng))
    machine = truth.forward(nominal.commands, guess=nominal.q)
    seen = _measured(tripod_errors, machine, TILTS)
    zeros = np.array([0.01, -0.02])
    noisy = replace(
        seen,
        positions=seen.positions + rng.normal(0.0, SIGMA, (40, 3)),
        readings=_readings(machine, TILTS) + zeros + rng.normal(0.0, SIGMA, (40, 2)),
    )
    path = write_measurements(noisy, robot, tmp_path / "encoders.csv")
    read = read_measurements(path, robot)
    np.testing.assert_array_equal(read.residuals(nominal), noisy.residuals(nominal))
    found = identify(read, tripod_errors)
    kept = np.flatnonzero([part.startswith("encoder.") for part in found.nuisances.names])
    assert np.all(np.abs(found.nuisance_values[kept] - zeros) < 4.0 * found.nuisance_sigmas[kept])
    assert found.noise_factor < 1.5
    blind = identify(replace(noisy, joints={}, readings=None, sigmas=noisy.sigmas[:, :3]), tripod_errors)
    true = truth.forward(wanted.commands, guess=wanted.q).transforms
    missed = []
    for values in (tripod_errors.zeros, blind.values, found.values):
        believed = tripod_errors.apply(values).forward(wanted.commands, guess=wanted.q)
        missed.append(float(np.sqrt(np.mean(tip_error(pose_difference(believed.transforms, true)) ** 2))))
    assert missed[2] < 0.5 * missed[1] < 0.5 * missed[0]
    assert calibrate(read, tripod_errors, "lm").refusals == ()


def test_what_is_wrong_with_encoders_is_named(tripod_nominal: Poses, tmp_path: Path) -> None:
    robot, machine = tripod_nominal.robot, tripod_nominal[:5]
    joints = {"platform_x_joint": "rad"}
    seen = _measured(GeometricErrors(robot, ()), machine, joints)
    path = write_measurements(seen, robot, tmp_path / "good.csv")
    text = path.read_text()
    for wrong, problem in (
        (text.replace("encoder_platform_x_joint_rad", "encoder_slider1_joint_m"), "columns of passive joints"),
        (text.replace("encoder_platform_x_joint_rad", "encoder_platform_x_joint_mm"), "columns of passive joints"),
        (text.replace(f",{SIGMA!r}\n", ",-1\n"), "sigma_encoder_platform_x_joint_rad is not positive"),
    ):
        path.write_text(wrong)
        with pytest.raises(MeasurementError, match=problem):
            read_measurements(path, robot)
    off = seen.with_encoders(joints, np.degrees(_readings(machine, joints)) + 3.0, np.full((5, 1), SIGMA))
    with pytest.raises(MeasurementError, match="another unit, zero"):
        read_measurements(write_measurements(off, robot, path), robot)
    sigmas, tilts = np.full((5, 2), SIGMA), _readings(machine, TILTS)
    for wrong_ones, follows in (
        (tilts * [1.0, -1.0], "y_joint_rad follows minus"),
        (tilts[:, ::-1], "x_joint_rad follows"),
    ):
        off = seen.with_encoders(TILTS, wrong_ones + np.array([0.01, -0.02]), sigmas)
        with pytest.raises(MeasurementError, match=f"encoder_platform_{follows} platform_y_joint"):
            read_measurements(write_measurements(off, robot, path), robot)
    alone = seen.with_encoders(joints, _readings(machine, joints), np.full((5, 1), SIGMA))
    lines = [line.split(",") for line in write_measurements(alone, robot, path).read_text().splitlines()]
    keep = [k for k, name in enumerate(lines[0]) if name.startswith(("u", "encoder", "sigma_encoder"))]
    path.write_text("\n".join(",".join(line[k] for k in keep) for line in lines) + "\n")
    only = read_measurements(path, robot)
    assert only.seen.tolist() == 5 * [[False, False, False, True]]


def test_noise_of_encoders_that_is_said_to_be_too_large_is_named_as_theirs() -> None:
    """With positions, their readings replace the orientations of full poses."""
    found = SimpleNamespace(
        noise_factor=1.0,
        trusted=np.arange(20),
        normalized_residuals=np.tile([1.0, 1.0, 1.0, 0.1], (20, 1)),
        expected_squares=np.ones((20, 4)),
        measurements=SimpleNamespace(tool_columns=3),
    )
    text = _noise_in_words(SimpleNamespace(identification=found))  # type: ignore[arg-type]
    assert text.startswith("residuals of encoders are 0.1 times the noise")
