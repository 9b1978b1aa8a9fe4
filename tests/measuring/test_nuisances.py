"""Nuisance parameters: derivatives by finite differences, ranks by an SVD of finite differences, values recovered."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

from pm3dof_pin.calibration.identifiability import Identifiability, stacked_regressor
from pm3dof_pin.calibration.identification import identify
from pm3dof_pin.calibration.linearisation import tool_motions_by_drives
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurement_file import read_measurements, write_measurements
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.measuring.nuisances import Nuisances
from pm3dof_pin.measuring.registration import Registration, register

TARGETS = np.array([[0.12, 0.0, 0.01], [-0.06, 0.1, 0.0], [-0.06, -0.1, -0.02]])
BASE = pin.SE3(pin.exp3(np.array([0.4, -0.7, 1.9])), np.array([3.0, -1.5, 0.8]))
"""Placement of the base in the tracker's axes."""


def target_rows(commands: np.ndarray, transforms: np.ndarray, points: np.ndarray, sigma: float = 15e-6) -> Measurements:
    """Positions of the targets, pose by pose."""
    seen = transforms[:, None, :3, 3] + np.einsum("nij,kj->nki", transforms[:, :3, :3], points)
    rows = len(commands) * len(points)
    return Measurements(
        np.repeat(commands, len(points), axis=0),
        seen.reshape(-1, 3),
        None,
        np.full((rows, 3), sigma),
        np.tile(points, (len(commands), 1)),
        target_sigma=1e-3,
    )


@pytest.fixture
def everything(tripod_nominal: Poses) -> Measurements:
    """Targets measured in the tracker's own frame, with times and approaches."""
    poses, generator = tripod_nominal[:6], np.random.default_rng(0)
    rows = target_rows(poses.commands, poses.transforms, TARGETS)
    approaches = np.repeat(generator.choice([-1.0, 1.0], (6, 3)), 3, axis=0)
    at_base = Registration(np.eye(3), np.zeros(3), 0.0)
    return replace(rows, registration=at_base, times=10.0 * np.arange(18.0), approaches=approaches)


def test_zeros_of_an_earlier_homing_are_told(
    tripod_errors: GeometricErrors, tripod_nominal: Poses, tmp_path: Path
) -> None:
    """Drives were farther by these at the same readings: the machine is that of the present zeros."""
    shift, sliders = (
        np.array([3e-5, -5e-5, 4e-5]),
        tripod_errors.select(["slider1_joint.tx", "link1_tip.tz"]),
    )
    truth = np.array([5e-5, -8e-5])
    machine, earlier = sliders.apply(truth), np.arange(len(tripod_nominal)) % 3 > 0
    reached = machine.forward(tripod_nominal.commands + shift * earlier[:, None])
    rows = replace(
        Measurements.from_poses(tripod_nominal.commands, reached.transforms), homings=np.where(earlier, 2, 0)
    )
    seen = read_measurements(write_measurements(rows, sliders.robot, tmp_path / "rows.csv"), sliders.robot)
    found = identify(seen, sliders, loss="squares")
    assert found.nuisances.names == ("homing2.u1", "homing2.u2", "homing2.u3")
    np.testing.assert_allclose(found.nuisance_values, shift, atol=1e-7)
    np.testing.assert_allclose(found.values, truth, atol=1e-7)


def test_times_and_directions_are_written_and_read(
    everything: Measurements, tripod_nominal: Poses, tmp_path: Path
) -> None:
    path = write_measurements(everything, tripod_nominal.robot, tmp_path / "seen.csv")
    again = read_measurements(path, tripod_nominal.robot)
    np.testing.assert_array_equal(again.times, everything.times)
    np.testing.assert_array_equal(again.approaches, everything.approaches)


def test_derivatives_are_those_of_finite_differences(everything: Measurements, tripod_nominal: Poses) -> None:
    """Removing part of a parameter changes the residuals as its derivative says."""
    poses = tripod_nominal[:6][everything.pose_numbers]
    nuisances = Nuisances.from_measurements(everything, ("m", "m", "m"))
    assert len(nuisances) == 6 + 9 + 9 + 3
    drives = tool_motions_by_drives(poses)
    rows = everything.derivatives(poses, nuisances.motions(everything, poses, drives))
    step = 1e-6
    for k in range(len(nuisances)):
        values = np.zeros(len(nuisances))
        values[k] = step
        ahead, back = (nuisances.removed(everything, poses, drives, sign * values).residuals(poses) for sign in (1, -1))
        np.testing.assert_allclose(rows[:, :, k], -(ahead - back) / (2.0 * step), atol=1e-8, err_msg=nuisances.names[k])


def _numerical_ranks(errors: GeometricErrors, poses: Poses) -> list[int]:
    """Rank of full poses by the parameters, and with the frame, by central differences of closed loops."""

    def seen(values: np.ndarray, frame: np.ndarray) -> np.ndarray:
        base = pin.SE3(pin.exp3(frame[3:]), frame[:3]).homogeneous
        reached = base @ errors.apply(values).forward(poses.commands, guess=poses.q).transforms
        return np.concatenate([reached[:, :3, 3].ravel(), reached[:, :3, :3].ravel()])

    still, columns = np.zeros(6), []
    for k in range(len(errors)):
        values = errors.zeros
        values[k] = 0.1 * errors.tolerances[k]
        columns.append(0.5 * (seen(values, still) - seen(-values, still)))
    frames = [0.5 * (seen(errors.zeros, step) - seen(errors.zeros, -step)) for step in 1e-5 * np.eye(6)]

    def rank(matrix: np.ndarray) -> int:
        values = np.linalg.svd(matrix / np.maximum(np.linalg.norm(matrix, axis=0), 1e-7), compute_uv=False)
        return int(np.sum(values > 1e-6 * values[0]))

    alone, frame, both = (rank(np.array(rows).T) for rows in (columns, frames, columns + frames))
    return [alone, both - frame]


def test_the_rank_with_a_free_frame(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    poses = tripod_nominal[:20]
    at_base = Measurements.from_poses(poses.commands, poses.transforms)
    free = replace(at_base, registration=Registration(np.eye(3), np.zeros(3), 0.0))
    ranks = [identify(measured, tripod_errors).identifiability.rank for measured in (at_base, free)]
    assert ranks == _numerical_ranks(tripod_errors, poses)
    assert ranks[0] - ranks[1] == 6  # a motion of everything is one of the base


@pytest.mark.parametrize("name", ["hexapod", "linear_delta", "three_rps"])
def test_the_ranks_of_other_robots(name: str) -> None:
    errors = GeometricErrors.load(name)
    poses = reachable_poses(errors.robot, 12, np.random.default_rng(3))
    ranks = []
    for own_frame in (False, True):
        by_errors, others, _ = stacked_regressor(errors, poses, Instrument(own_frame=own_frame))
        ranks.append(Identifiability.from_regressor(errors.names, by_errors, others).rank)
    assert ranks == _numerical_ranks(errors, poses)


def test_a_trackers_frame_and_unknown_targets_are_found(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """From metres away, with targets a millimetre off: everything within four sigmas, and the base too."""
    scores = []
    for seed in range(3):
        generator = np.random.default_rng([seed, 7])
        poses = tripod_nominal[60 * seed : 60 * seed + 40]
        truth = tripod_errors.sample(generator)
        off = TARGETS + generator.normal(0.0, 1e-3, TARGETS.shape)
        reached = tripod_errors.apply(truth).forward(poses.commands, guess=poses.q).transforms
        seen = target_rows(poses.commands, BASE.homogeneous @ reached, off)
        seen = replace(seen, positions=seen.positions + generator.normal(0.0, 15e-6, seen.positions.shape))
        seen = replace(seen, points=np.tile(TARGETS, (40, 1)))
        nominal = target_rows(poses.commands, poses.transforms, TARGETS)
        registration = register(seen.positions, nominal.positions)
        read = replace(seen, positions=registration.positions(seen.positions), registration=registration)
        found = identify(read, tripod_errors, prior=1.0)
        assert found.noise_factor < 1.3
        assert found.measurements.registration is not None
        base = BASE.inverse() * pin.SE3(found.measurements.registration.base)
        twist = np.concatenate([-base.translation, -Rotation.from_matrix(base.rotation).as_rotvec()])
        wanted = np.concatenate([truth, twist, (off - TARGETS).ravel()])
        got = np.concatenate([found.values, found.nuisance_values])
        sigmas = np.sqrt(np.diag(found.joint_covariance))
        scores.append((got - wanted) / sigmas)
    assert np.abs(scores).max() < 4.0
    assert 0.5 < np.mean(np.abs(scores) < 1.0) < 0.85  # they are not independent


def test_drift_and_hysteresis_are_found(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    generator = np.random.default_rng(3)
    poses = tripod_nominal[:60]
    truth = tripod_errors.sample(generator)
    approaches = generator.choice([-1.0, 1.0], (60, 3))
    backlash, growth = np.array([20e-6, 30e-6, 10e-6]), np.array([25e-6, 25e-6, 40e-6])
    times = np.sort(generator.uniform(0.0, 3600.0, 60))
    part = (times - times.min()) / np.ptp(times) - 0.5
    commands = poses.commands + 0.5 * backlash * approaches + growth * part[:, None]
    reached = tripod_errors.apply(truth).forward(commands, guess=poses.q).transforms
    seen = replace(Measurements.from_poses(poses.commands, reached), times=times, approaches=approaches)
    noisy = seen.positions + generator.normal(0.0, 7.5e-6, (60, 3))
    found = identify(replace(seen, positions=noisy), tripod_errors)
    names = found.nuisances.names
    for label, values in (("hysteresis", backlash), ("drift", growth)):
        columns = [names.index(f"{label}.u{k}") for k in (1, 2, 3)]
        off = (found.nuisance_values[columns] - values) / found.nuisance_sigmas[columns]
        assert np.abs(off).max() < 4.0
        assert np.all(found.nuisance_sigmas[columns] < 15e-6 if label == "hysteresis" else True)
