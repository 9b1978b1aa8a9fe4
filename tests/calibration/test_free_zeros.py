"""Machines whose drives were never homed to marks: zeros are off by tens of milliradians, or millimetres."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.fit import Options
from pm3dof_pin.calibration.identification import Identification, identify
from pm3dof_pin.errors.pose_error import pose_difference, tip_error
from pm3dof_pin.errors.presets import with_free_zeros
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.typing import Array

ZEROS = np.array([0.0, 24e-3, -31e-3, 20e-3, 35e-3, -22e-3])


POINTS = ((0.1, 0.0, 0.02), (-0.05, 0.08, 0.0), (-0.05, -0.08, 0.0))


def _seen(machine: pm.Robot, commands: Array, generator: np.random.Generator) -> pm.Measurements:
    """Return what a tracker with a frame of its own sees of a machine whose zeros are far off."""
    reached = machine.forward(commands + ZEROS).transforms
    seen = pm.Measurements.from_poses(commands, reached, Instrument("position", 3e-5, own_frame=True, targets=POINTS))
    return replace(seen, positions=seen.positions + 3e-5 * generator.standard_normal(seen.positions.shape))


def _registered(seen: pm.Measurements, robot: pm.Robot) -> pm.Measurements:
    """Return measurements as they are read from a file: in the base located by the machine as described."""
    found = seen.registered_at(robot.forward(seen.commands))
    return replace(seen.in_axes(found), registration=found)


def test_zeros_far_off_are_found_by_default() -> None:
    descriptions = pytest.importorskip("example_robot_data")
    assert descriptions is not None
    errors = pm.GeometricErrors.load("ur5", tool_frame="tool0")
    generator = np.random.default_rng(3)
    machine = errors.apply(errors.sample(generator))
    commands = pm.reachable_poses(errors.robot, 40, generator).commands
    rows = _registered(_seen(machine, commands, generator), errors.robot)
    calibration = pm.calibrate(rows, errors, "lm")
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


def test_a_validation_of_the_same_session_sees_the_same_targets() -> None:
    """The frame is that of the calibrated machine, and a target 0.1 mm off in the file is the same target."""
    pytest.importorskip("example_robot_data")
    errors, generator = pm.GeometricErrors.load("ur5", tool_frame="tool0"), np.random.default_rng(3)
    machine = errors.apply(errors.sample(generator))
    files = []
    for count in (40, 60):
        seen = _seen(machine, pm.reachable_poses(errors.robot, count, generator).commands, generator)
        files.append(replace(_registered(seen, errors.robot), target_sigma=1e-3))
    second = (files[1].points == POINTS[1]).all(axis=1)
    calibration = pm.calibrate(
        files[0], errors, "lm", validation=files[1].with_points(files[1].points + 1e-4 * second[:, None])
    )
    assert any("is taken for that of the calibration 0.173 mm away" in warning for warning in calibration.warnings)
    assert not any("station" in warning for warning in calibration.warnings)
    assert calibration.validation is not None
    assert calibration.validation.within > 0.85


@pytest.mark.parametrize("off", [0.0, 3e-3])
def test_zeros_that_residuals_hide_are_weighed(off: float) -> None:
    """Of a delta everything else shifts the tool alike: the zeros leave only noise, and parts far out of tolerance."""
    errors, generator = pm.GeometricErrors(pm.load("linear_delta")), np.random.default_rng(2)
    machine, zeros = errors.apply(errors.sample(generator)), off * np.array([1.0, -1.0, 0.5])
    commands = pm.reachable_poses(errors.robot, 25, generator).commands
    seen = pm.Measurements.from_poses(commands, machine.forward(commands + zeros).transforms, Instrument("position"))
    seen = replace(seen, positions=seen.positions + 1e-5 * generator.standard_normal(seen.positions.shape))
    calibration = pm.calibrate(seen, errors, "lm", on_refusal="keep")
    freed = any("taken as unknown" in warning for warning in calibration.warnings)
    assert freed == (off > 0.0)
    assert calibration.identification.noise_factor < 1.5
    assert calibration.identification.prior.k < 2.0


def _delta_seen(errors: pm.GeometricErrors, values: Array) -> pm.Measurements:
    commands = pm.reachable_poses(errors.robot, 15, np.random.default_rng(4)).commands
    reached = errors.apply(values).forward(commands).transforms
    return pm.Measurements.from_poses(commands, reached, Instrument("position"))


def test_zeros_alone_are_identified() -> None:
    """No part is left that k could scale: its value is that of the tolerances, 1."""
    free = with_free_zeros(pm.GeometricErrors.load("linear_delta"))
    errors = free.select(f"carriage{k}_joint.tz" for k in (1, 2, 3))
    true = np.array([2e-3, -1e-3, 3e-3])
    found = pm.calibrate(_delta_seen(errors, true), errors, "lm").identification
    np.testing.assert_allclose(found.values, true, atol=1e-6)
    assert found.prior.k == 1.0


def test_a_given_prior_is_identified_with_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Undeclared zeros are weighed by rough identifications; that of the better ones goes on from there."""
    errors = pm.GeometricErrors(pm.load("linear_delta"))
    seen, starts = _delta_seen(errors, 0.3 * errors.sample(np.random.default_rng(1))), list[bool]()

    def counted(*given: Any, **options: Any) -> Identification:
        starts.append(options.get("start") is not None)
        return identify(*given, **options)

    monkeypatch.setattr("pm3dof_pin.calibration.fit.identify", counted)
    pm.calibrate(seen, errors, Options("lm", prior=1.0), on_refusal="keep")
    assert starts == [False, False, True]
