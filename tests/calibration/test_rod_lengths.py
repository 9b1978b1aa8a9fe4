"""Rods that are closures are calibrated as a textbook does it, simulated, and written with their lengths."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pm3dof_pin as pm
from pm3dof_pin.calibration.calibrated_urdf import write_calibrated_robot
from pm3dof_pin.description.yaml_file import read_mapping
from pm3dof_pin.errors.error_parameters import GeometricErrors
from pm3dof_pin.kinematics.robot import Robot
from pm3dof_pin.measuring.instrument import Instrument
from pm3dof_pin.simulation.simulated_machine import SimulatedMachine

SIGMA, TURN = 5e-6, 5e-5


def _lengths(robot: Robot, commands: np.ndarray, tool: np.ndarray) -> np.ndarray:
    """Distances of the balls of measured platforms from the tips of the arms at commands, shape=(n, 6) [m]."""
    placed, found = robot.home.frame_placement, []
    to_ball = [placed("platform").actInv(placed(f"ball{k}")).translation for k in range(6)]
    for row, at in zip(commands, tool, strict=True):
        found.append([])
        for k, angle in enumerate(row):
            motor, tip = (placed(f"{name}{k}") for name in ("m", "tip"))
            tip_at = motor.act(pin.exp3(np.array([0.0, 0.0, angle])) @ motor.actInv(tip).translation)
            found[-1].append(np.linalg.norm(at[:3, :3] @ to_ball[k] + at[:3, 3] - tip_at))
    return np.array(found)


def test_lengths_are_those_of_a_textbook(six_rods: Path, tmp_path: Path) -> None:
    """Each length is the mean distance of its ends at the measured poses, uncertain by a root of the 60 poses."""
    errors = GeometricErrors.load(six_rods)
    rods = GeometricErrors(errors.robot, [p for p in errors.parameters if p.name.endswith("t_along")])
    generator = np.random.default_rng(4)
    truth = 4e-4 * generator.standard_normal(6)
    machine, poses = rods.apply(truth), pm.reachable_poses(rods.robot, 60, np.random.default_rng(1))
    tool = np.array(machine.forward(poses.commands, guess=poses.q).transforms)
    for at in tool:
        at[:3, 3] += SIGMA * generator.standard_normal(3)
        at[:3, :3] = pin.exp3(TURN * generator.standard_normal(3)) @ at[:3, :3]
    nominal = np.array([loop.length for loop in rods.robot.closures])
    textbook = (_lengths(rods.robot, poses.commands, tool) - nominal).mean(axis=0)
    noise = np.hypot(SIGMA, 0.1 * TURN) / np.sqrt(60)  # the balls are 0.1 m from the tool
    assert np.abs(textbook - truth).max() < 4.0 * noise
    measured = pm.Measurements.from_poses(poses.commands, tool, Instrument(position_sigma=SIGMA, angle_sigma=TURN))
    calibration = pm.calibrate(measured, rods, "lm", on_refusal="keep")
    found = calibration.identification.values
    assert np.abs(found - truth).max() < 4.0 * noise  # of 0.2 to 1 mm
    assert np.abs(found - textbook).max() < 4.0 * noise
    written = pm.load(calibration.save(tmp_path / "calibration") / "calibrated" / "six_rods.urdf")
    np.testing.assert_allclose([loop.length for loop in written.closures], nominal + found, rtol=1e-15)


@pytest.mark.parametrize("in_tree", [False, True])
def test_files_have_the_lengths(six_rods: Path, tmp_path: Path, in_tree: bool) -> None:
    """Whether the rods are in a closures file or, as Drake writes them, in the URDF."""
    path = tmp_path / "six_rods.urdf"
    text, entries = six_rods.read_text(), read_mapping(six_rods.with_suffix(".closures.yaml"))
    if in_tree:
        tag = "drake:distance_constraint"
        rods = "".join(
            f'<{tag}><{tag}_body_A name="tip{k}"/><{tag}_body_B name="ball{k}"/>'
            f'<{tag}_distance value="{length!r}"/></{tag}>'
            for k, length in enumerate(entries["closure_lengths"])
        )
        text = text.replace("<robot", '<robot xmlns:drake="http://drake.mit.edu"').replace(
            "</robot>", f"{rods}</robot>"
        )
        entries = {key: entries[key] for key in ("name_mot", "tool_frame")}
    path.write_text(text)
    path.with_suffix(".closures.yaml").write_text("\n".join(f"{key}: {value}" for key, value in entries.items()))
    errors = GeometricErrors.load(path)
    values = 10.0 * errors.sample(np.random.default_rng(3))
    written = pm.load(write_calibrated_robot(errors, values, tmp_path / "written"))
    commands = np.random.default_rng(4).uniform(-0.1, 0.1, (5, 6))
    expected = errors.apply(values).forward(commands, guess=errors.robot.home.q).transforms
    np.testing.assert_allclose(written.forward(commands).transforms, expected, atol=1e-12)
    assert max(abs(a.length - b.length) for a, b in zip(written.closures, errors.robot.closures, strict=True)) > 1e-4  # type: ignore[operator]


def test_simulated_machines_have_rods_of_other_lengths(six_rods: Path) -> None:
    """Of a world with everything, and of one with what a file lists."""
    errors = GeometricErrors.load(six_rods)
    motor = GeometricErrors(errors.robot, [p for p in errors.parameters if p.place == "m0"])
    drawn = SimulatedMachine.random(motor, np.random.default_rng(0)).geometric
    assert drawn is not None
    lengths = [loop.length for loop in drawn.errors.apply(drawn.values).closures]
    assert all(a != b.length for a, b in zip(lengths, errors.robot.closures, strict=True))
