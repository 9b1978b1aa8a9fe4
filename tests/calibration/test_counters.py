"""The unit of a counter does not affect the machine's motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pm3dof_pin.calibration.compensation import Compensation
from pm3dof_pin.calibration.fit import Options, fit
from pm3dof_pin.calibration.held_out import HeldOut
from pm3dof_pin.calibration.pseudo_error import pseudo_errors
from pm3dof_pin.calibration.recheck import recheck
from pm3dof_pin.description.coordinates import Command
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.sensitivity import closable
from pm3dof_pin.kinematics.reachable_poses import reachable_poses
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.simulation.worlds import World

MACHINE = Path(__file__).parents[1] / "machines" / "three_rpr"


def _calibrated(robot: Robot) -> tuple[Measurements, np.ndarray, np.ndarray, np.ndarray]:
    """Return measurements, and in the joints' units: corrections at ten poses and how commands miss the best ones."""
    scales = np.array([command.scale for command in robot.commands])
    poses = reachable_poses(robot, 16, np.random.default_rng(3))
    errors = closable(GeometricErrors(robot), poses)
    world = World.random("everything", errors, np.random.default_rng(4))
    measured = world.measure(poses.commands, np.random.default_rng(5))
    calibration = fit(measured, errors, Options(method="lm"))
    answer = calibration.compensation.compensate(poses[:10])
    judged = HeldOut.from_cross_validation(calibration)
    return measured, (answer.commands - answer.nominal_commands) / scales, judged.excess, judged.floor


def test_counters_of_micrometres_backwards_against_metres() -> None:
    robot = Robot.load(MACHINE)
    plain = robot.replace(commands=[Command(c.name, c.joint, c.unit) for c in robot.commands])
    measured, corrections, excess, floor = _calibrated(robot)
    measured_plainly, corrections_plainly, excess_plainly, floor_plainly = _calibrated(plain)
    np.testing.assert_allclose(measured.positions, measured_plainly.positions, atol=1e-9)
    np.testing.assert_allclose(corrections, corrections_plainly, atol=1e-9)
    np.testing.assert_allclose(excess, excess_plainly, atol=1e-8)
    np.testing.assert_allclose(floor, floor_plainly, atol=1e-8)


def test_zeros_are_rechecked_in_the_units_of_the_joints() -> None:
    """Drives that are farther than their counters say, which count micrometres backwards."""
    robot = Robot.load(MACHINE)
    poses = reachable_poses(robot, 10, np.random.default_rng(0))
    errors = closable(GeometricErrors(robot), poses)
    known = Compensation(errors, np.zeros(len(errors)), 1e-16 * np.eye(len(errors)))
    moved = np.array([2e-4, -1e-4, 1.5e-4])[: len(robot.commands)]
    scales = np.abs([command.scale for command in robot.commands])
    there = robot.forward(poses.commands + scales * moved, guess=poses.q)
    found = recheck(known, Measurements.from_poses(poses.commands, there.transforms))
    assert found.verdict == "re-zero"
    np.testing.assert_allclose(found.zeros, moved, atol=1e-8)


def test_the_noise_of_deviations_is_in_the_counters_units() -> None:
    """A covariance has the square of the unit."""
    robot = Robot.load(MACHINE)
    plain = robot.replace(commands=[Command(c.name, c.joint, c.unit) for c in robot.commands])
    scales = np.array([command.scale for command in robot.commands])
    found = []
    for each in (robot, plain):
        poses = each.at(reachable_poses(plain, 5, np.random.default_rng(0)).q)
        found.append(pseudo_errors(Measurements.from_poses(poses.commands, poses.transforms), poses).covariances)
    np.testing.assert_allclose(found[0] / np.outer(scales, scales), found[1], rtol=1e-6)


def test_all_errors_that_a_planar_machine_is_left_with_close_together() -> None:
    """Rotating a rod about its own axis moves nothing unless its tip is off the axis: then out of the plane."""
    robot = Robot.load(MACHINE)
    poses = reachable_poses(robot, 10, np.random.default_rng(0))
    errors = closable(GeometricErrors(robot), poses)
    assert not {"cyl2.rx", "cyl3.rx"}.intersection(errors.names)
    assert {"tip2.tx", "tip2.ty", "cyl2.ty", "swing3.rz"}.issubset(errors.names)
    crooked = errors.apply(3.0 * errors.sample(np.random.default_rng(1)))
    assert crooked.forward(poses.commands, guess=poses.q).solved.all()
