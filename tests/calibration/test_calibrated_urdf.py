"""A calibrated URDF moves as the mechanism with the same errors does."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from pm3dof_pin.calibration.calibrated_urdf import write_calibrated_robot
from pm3dof_pin.description.robots import find_robot
from pm3dof_pin.errors.error_parameters import GeometricErrors, GeometricParameter
from pm3dof_pin.exceptions import DescriptionError
from pm3dof_pin.kinematics.robot import Robot


@pytest.mark.parametrize("robot", ["pm3dof", "hexapod"])
def test_the_file_is_the_mechanism(robot: str, tmp_path: Path) -> None:
    errors = GeometricErrors(Robot.load(robot))
    values = 10.0 * errors.sample(np.random.default_rng(3))
    written = Robot.load(write_calibrated_robot(errors, values, tmp_path))
    home = errors.robot.home.commands
    commands = home + np.random.default_rng(4).uniform(-0.002, 0.002, (5, len(home)))
    expected = errors.apply(values).forward(commands, guess=errors.robot.home.q)
    np.testing.assert_allclose(written.forward(commands).transforms, expected.transforms, atol=1e-12)
    assert written.closures == errors.robot.closures
    assert GeometricErrors.load(tmp_path / f"{robot}.urdf").names == GeometricErrors.load(robot).names


def test_named_configurations_keep_their_commands_with_loops_closed(tmp_path: Path) -> None:
    errors = GeometricErrors.load("pm3dof")
    written = Robot.load(write_calibrated_robot(errors, errors.sample(np.random.default_rng(5)), tmp_path))
    assert written.home.closure_residual < 1e-12
    assert set(written.named_configurations) == set(errors.robot.named_configurations)
    for name, q in written.named_configurations.items():
        configuration = written.configuration(q)
        described = errors.robot.configuration(errors.robot.named_configurations[name])
        assert configuration.closure_residual < 1e-12
        np.testing.assert_array_equal(configuration.commands, described.commands)
        assert 1e-6 < np.abs(q - described.q).max() < 1e-2


def test_gimbal_lock_loses_nothing(tmp_path: Path) -> None:
    """At a pitch of 90 deg roll and yaw coincide; small rotations there must round-trip to the last digits."""
    source = find_robot("pm3dof").urdf
    text = re.sub(
        r'(<joint name="O_e_fixed".*?rpy=)"0 0 0"', rf'\1"0.3 {np.pi / 2} 0.2"', source.read_text(), flags=re.S
    )
    path = tmp_path / "pm3dof.urdf"
    path.write_text(text)
    path.with_suffix(".closures.yaml").write_text(find_robot("pm3dof").closures.read_text())
    errors = GeometricErrors(Robot.load(path))
    values = errors.values({"O_e.rx": 1e-9, "O_e.ry": 2e-9, "O_e.rz": -3e-9})
    written = Robot.load(write_calibrated_robot(errors, values, tmp_path / "out"))
    expected = errors.apply(values).home.tool_placement.rotation
    assert not np.allclose(expected, errors.robot.home.tool_placement.rotation, atol=1e-9)
    np.testing.assert_allclose(written.home.tool_placement.rotation, expected, atol=1e-15)


def test_nothing_else_changes(tmp_path: Path) -> None:
    errors = GeometricErrors.load("pm3dof")
    source = find_robot("pm3dof").urdf
    text = write_calibrated_robot(errors, errors.zeros, tmp_path).read_text()
    assert text.count("<link") == source.read_text().count("<link")
    nominal = {place: errors.robot.home.frame_placement(place) for place in ("E1", "link3_tip", "O_e")}
    assert 'xyz="0.0 0.0 0.353"' in text
    assert nominal["O_e"].translation[2] == pytest.approx(0.49299, abs=1e-5)


def test_a_place_without_an_origin_is_named(tmp_path: Path) -> None:
    mechanism = Robot.load("pm3dof")
    errors = GeometricErrors(
        mechanism, [GeometricParameter("p", "slider1", "translation", (1.0, 0.0, 0.0), "legs", 1e-4)]
    )
    with pytest.raises(DescriptionError, match="slider1"):
        write_calibrated_robot(errors, [1e-4], tmp_path)
