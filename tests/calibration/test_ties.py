"""Calibrations with tied parameters whose parts may differ."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.calibrate import Calibration, calibrate
from pm3dof_pin.calibration.fit import Options
from pm3dof_pin.calibration.ties import noticed_differences
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.measuring.measurements import Measurements
from pm3dof_pin.typing import Array

RODS = ", ".join(f"rod{k}_{side}_tip" for k in (1, 2, 3) for side in ("left", "right"))
CLASSES = f"""classes:
  rods: {{length_tolerance_m: 1.0e-4, angle_tolerance_rad: 1.0e-3, errors: [{{at: [{RODS}], translation: [z]}}]}}
"""
TOWERS = """  towers:
    length_tolerance_m: 1.0e-4
    angle_tolerance_rad: 1.0e-3
    errors: [{at: [carriage1_joint, carriage2_joint, carriage3_joint], translation: [x]}]
"""
RADIUS = """ties:
  radius: {of: [carriage1_joint.tx, carriage2_joint.tx, carriage3_joint.tx], tolerance_m: 1.0e-3}
"""


def machine(errors: GeometricErrors, own: Mapping[str, float]) -> Robot:
    """Build a machine with errors of single places beside the tied ones."""
    parts = [part for part, _ in errors.parameters[-1].parts if part.name in own]
    return GeometricErrors(errors.robot, [*errors.parameters, *parts]).apply({"radius": 5e-4, **own})


def calibrated(errors: GeometricErrors, real: Robot) -> Calibration:
    """Calibrate a machine by exact positions."""
    commands = pm.reachable_poses(errors.robot, 12, np.random.default_rng(2)).commands
    seen = Measurements.from_poses(commands, real.forward(commands).transforms, Instrument("position"))
    return calibrate(seen, errors, Options("lm", prior=1.0))


def test_differences_from_which_bounds_are_too_small(tmp_path: Path) -> None:
    """Parts that differ so much, one after the other, move the tip by half of what it is uncertain by, rms."""
    path = tmp_path / "delta.errors.yaml"
    path.write_text(CLASSES + RADIUS)
    errors = GeometricErrors.from_file(pm.load("linear_delta"), path)
    poses, share = pm.reachable_poses(errors.robot, 100, np.random.default_rng(3)), 0.05

    def left_by(found: Calibration, real: Robot) -> Array:
        model = errors.apply(found.identification.values)
        return pose_difference(*(each.forward(poses.commands).transforms for each in (model, real)))

    held = calibrated(errors, machine(errors, {}))
    (most,) = noticed_differences(held).values()
    assert any(
        f"differ by more than a little, as a standard deviation radius by {1e6 * most:.2g} µm" in words
        for words in held.warnings
    )
    before, squares = left_by(held, machine(errors, {})), 0.0
    for part, _ in errors.parameters[-1].parts:
        real = machine(errors, {part.name: share * most})
        squares += float(np.mean(tip_error(left_by(calibrated(errors, real), real) - before) ** 2)) / share**2
    told = held.compensate(poses)
    assert squares == pytest.approx(0.25 * float(np.mean(told.predicted_error**2 - told.floor**2)), rel=0.1)


def test_parts_that_are_parameters_of_their_own_may_differ(tmp_path: Path) -> None:
    path = tmp_path / "delta.errors.yaml"
    path.write_text(CLASSES + TOWERS + RADIUS)
    errors = GeometricErrors.from_file(pm.load("linear_delta"), path)
    assert noticed_differences(calibrated(errors, errors.apply({"radius": 5e-4}))) == {}
