"""Ranks, compared with counts by the joints' degrees of freedom, and with the known numbers of this machine."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from pm3dof_pin.calibration.identifiability import (
    Identifiability,
    ObservabilityIndices,
    minimum_poses,
    stacked_regressor,
)
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.exceptions import InvalidValueError
from pm3dof_pin.kinematics.poses import Poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument


def _regressor(errors: GeometricErrors, poses: Poses, instrument: Instrument | None = None) -> np.ndarray:
    return stacked_regressor(errors, poses, instrument)[0]


def _of_poses(errors: GeometricErrors, poses: Poses) -> Identifiability:
    return Identifiability.from_regressor(errors.names, _regressor(errors, poses))


def test_the_tripods_40_parameters_and_its_nine_poses(redundant_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """A leg has nine parameters and adds one equation per pose; the 13 of the middle are known after five poses."""
    regressor = _regressor(redundant_errors, tripod_nominal[:40])
    growth = [Identifiability.from_regressor(redundant_errors.names, regressor[:count]).rank for count in range(1, 13)]
    np.testing.assert_array_equal(growth, [6, 12, 18, 24, 28, 31, 34, 37, 40, 40, 40, 40])
    assert minimum_poses(regressor) == 9
    result = Identifiability.from_regressor(redundant_errors.names, regressor)
    assert result.rank == 40
    assert result.decision.gap > 1e6
    assert result.unidentifiable == ("platform_x_joint.rx",)


def test_positions_alone_say_less(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    regressor = _regressor(tripod_errors, tripod_nominal[:60], Instrument("position"))
    assert regressor.shape[1] == 3
    result = Identifiability.from_regressor(tripod_errors.names, regressor)
    assert result.rank < 40
    assert minimum_poses(regressor) > 9


def test_too_few_poses_are_seen(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    result = Identifiability.from_regressor(tripod_errors.names, _regressor(tripod_errors, tripod_nominal[:5]))
    assert result.rank == 28
    assert len(result.unidentifiable) == 12


def test_unidentifiable_directions_do_nothing(tripod_errors: GeometricErrors, tripod_nominal: Poses) -> None:
    """Four poses leave 16 combinations undetermined; moving along them, closed loops give the same poses."""
    poses = tripod_nominal[:4]
    result = _of_poses(tripod_errors, poses)
    hidden = result.directions[:, result.rank :]
    values = 0.01 * tripod_errors.tolerances * (hidden @ np.random.default_rng(0).standard_normal(hidden.shape[1]))
    moved = tripod_errors.apply(values).forward(poses.commands, guess=poses.q)
    visible = tripod_errors.apply(np.abs(values)).forward(poses.commands, guess=poses.q)
    hidden_motion = np.abs(moved.transforms - poses.transforms).max()
    assert hidden_motion < 1e-3 * np.abs(visible.transforms - poses.transforms).max()


def _chain(joints: str) -> Robot:
    """A serial chain of revolute (R) and prismatic (P) joints along z, at random placements."""
    model, parent = pin.Model(), 0
    pin.seed(len(joints))
    for index, kind in enumerate(joints):
        joint = pin.JointModelRZ() if kind == "R" else pin.JointModelPZ()
        parent = model.addJoint(parent, joint, pin.SE3.Random(), f"joint{index}")
    model.addFrame(pin.Frame("tool", parent, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    return Robot(model, tool_frame="tool")


@pytest.mark.parametrize("joints", ["R", "RR", "RPR", "PPR", "RRPRRR", "RRRRRRR"])
def test_a_serial_arm_has_4r_2p_6_parameters(joints: str) -> None:
    """B. Mooring, Z. Roth and M. Driels, Fundamentals of Manipulator Calibration (1991); L. Everett and T.-W. Hsu."""
    arm = _chain(joints)
    poses = arm.forward(np.random.default_rng(0).uniform(-2.0, 2.0, (30, len(joints))))
    errors = GeometricErrors(arm)
    result = _of_poses(errors, poses)
    assert result.rank == 4 * joints.count("R") + 2 * joints.count("P") + 6
    assert result.decision.gap > 1e6


def test_a_real_arm_with_six_joints_has_30_parameters(serial_arm: Robot) -> None:
    errors = GeometricErrors(serial_arm)
    poses = serial_arm.forward(np.random.default_rng(0).uniform(-2.0, 2.0, (20, 6)))
    result = _of_poses(errors, poses)
    assert len(errors) == 42
    assert result.rank == 30
    assert minimum_poses(_regressor(errors, poses)) == 5


def _freedom_count(chain: str, driven: str) -> int:
    """Number of distinguishable parameters of a generic chain between two known frames.

    A displacement that commutes with a joint may be on either side of it: 2 for R, 4 for P, 3 for S. In a joint of
    unknown coordinate, its own motions are hidden too.
    """
    count = 6 * (len(chain) + 1)
    for kind, known in zip(chain, driven, strict=True):
        count -= {"R": 2, "P": 4, "S": 3}[kind] + (0 if known == "u" else {"R": 1, "P": 1, "S": 3}[kind])
    return count


def test_closed_chains_have_as_many_parameters_as_their_joints_leave(mechanism: Robot) -> None:
    """Near the described machine some have no first-order effect; on a machine far from it all have one."""
    hexapod = Robot.load("hexapod")
    legs, middle = _freedom_count("PRRS", "u..."), _freedom_count("PRR", "...")
    cases = (
        (mechanism, 100.0, 3 * legs + middle, 0.07),
        (hexapod, 50.0, 6 * _freedom_count("RRPS", "..u."), 0.004),
    )
    for nominal, size, expected, reach in cases:
        errors = GeometricErrors(nominal)
        rng = np.random.default_rng(1)
        far = errors.apply(size * errors.sample(rng))
        home = far.forward(nominal.at([nominal.home.q]).commands, guess=nominal.home.q)
        commands = home.commands + rng.uniform(-reach, reach, (40, home.commands.shape[1]))
        poses = far.forward(commands, guess=home.q[0], on_failure="nan")
        poses = poses[poses.solved]
        displaced = GeometricErrors(far)
        result = _of_poses(displaced, poses)
        values = result.decision.singular_values
        assert values[expected - 1] > 1e2 * values[expected]


def test_observability_indices_by_hand() -> None:
    indices = ObservabilityIndices.from_singular_values([8.0, 4.0, 2.0], 4)
    assert pytest.approx(4.0 / 2.0) == indices.O1
    assert pytest.approx(0.25) == indices.O2
    assert pytest.approx(2.0) == indices.O3
    assert pytest.approx(0.5) == indices.O4
    assert pytest.approx(1.0 / (0.125 + 0.25 + 0.5)) == indices.O5
    with pytest.raises(InvalidValueError):
        ObservabilityIndices.from_singular_values([1.0, 0.0], 1)


def test_names_of_directions_and_shapes(tripod_errors: GeometricErrors) -> None:
    few = tripod_errors.select(["O_e.tx", "O_e.ty", "O_e.tz"])
    result = Identifiability.from_regressor(few.names, np.array([[[1.0, 1.0, 0.0]], [[2.0, 2.0, 0.0]]]))
    assert set(result.unidentifiable) in ({"O_e.tx - O_e.ty", "O_e.tz"}, {"O_e.ty - O_e.tx", "O_e.tz"})
    with pytest.raises(InvalidValueError, match="shape"):
        Identifiability.from_regressor(few.names, np.ones((2, 1, 1)))


def test_the_noise_of_targets() -> None:
    """Against a least-squares fit of the pose to four targets on a circle, with noise."""
    angles = 2.0 * np.pi * np.arange(4) / 4
    points = 0.15 * np.stack([np.cos(angles), np.sin(angles), 0.0 * angles], axis=1)
    rows = np.concatenate([np.hstack([np.eye(3), -pin.skew(point)]) for point in points])
    covariance = np.linalg.inv(rows.T @ rows) * 15e-6**2
    instrument = Instrument.with_targets(15e-6, 4, 0.15)
    assert instrument == Instrument()
    np.testing.assert_allclose(np.sqrt(np.diag(covariance))[:5], instrument.sigmas[:5])
    assert np.sqrt(covariance[5, 5]) < instrument.sigmas[5]
    for wrong in ({"count": 2}, {"radius": 0.0}, {"sigma": 0.0}):
        with pytest.raises(InvalidValueError):
            Instrument.with_targets(**wrong)
