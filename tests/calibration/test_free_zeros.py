"""An arm whose drives were never homed to marks: its zeros are off by tens of milliradians."""

from __future__ import annotations

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.measuring.instrument import Instrument

ZEROS = np.array([0.0, 24e-3, -31e-3, 20e-3, 35e-3, -22e-3])


def test_zeros_far_off_are_found_by_default() -> None:
    descriptions = pytest.importorskip("example_robot_data")
    assert descriptions is not None
    errors = pm.GeometricErrors.load("ur5", tool_frame="tool0")
    generator = np.random.default_rng(3)
    machine = errors.apply(errors.sample(generator))
    commands = pm.reachable_poses(errors.robot, 40, generator).commands
    instrument = Instrument(
        "position", 3e-5, own_frame=True, targets=((0.1, 0, 0.02), (-0.05, 0.08, 0), (-0.05, -0.08, 0))
    )
    reached = machine.forward(commands + ZEROS).transforms
    seen = pm.Measurements.from_poses(commands, reached, instrument)
    noisy = seen.positions + 3e-5 * generator.standard_normal(seen.positions.shape)
    rows = type(seen)(**{**vars(seen), "positions": noisy})
    nominal = errors.robot.forward(rows.commands)
    found = rows.registered_at(nominal)
    calibration = pm.calibrate(type(seen)(**{**vars(rows.in_axes(found)), "registration": found}), errors, "lm")
    assert any("taken as unknown" in warning for warning in calibration.warnings)
    # errors against a machine whose base is where the calibrated one has it
    fresh = pm.reachable_poses(errors.robot, 60, np.random.default_rng(8)).commands
    model = calibration.compensation.model.forward(fresh)
    true = machine.forward(fresh + ZEROS)
    place = pm.Measurements.from_poses(fresh, true.transforms).registered_at(model)
    left = pm.Measurements.from_poses(fresh, true.transforms).in_axes(place)
    transforms = np.array(true.transforms)
    transforms[:, :3, :3], transforms[:, :3, 3] = left.rotations, left.positions
    assert np.median(tip_error(pose_difference(transforms, model.transforms))) < 1e-4
